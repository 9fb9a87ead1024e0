//! XML, as far as annotation files need it: elements, nested as they should be, and their
//! attributes. Text, comments and processing instructions are passed over. There are no entities
//! but the five of XML and numbers: a declaration of others is refused. One pass over the file, and
//! one more over the attributes that are asked for.

use std::borrow::Cow;

use super::SourceText;
use super::bad::Bad;
use super::collect::Located;
use super::item::LONGEST_NAME;
use crate::problem::words::quote;

/// The most elements inside one another.
const MAX_ELEMENT_DEPTH: usize = 64;

/// The name of the outermost element, if a text is XML, by its beginning.
pub(super) fn root(head: &str) -> Option<&str> {
    let mut rest = head.strip_prefix('<').map(|_| head)?;
    loop {
        rest = rest.trim_start();
        let end = if rest.starts_with("<?") {
            "?>"
        } else if rest.starts_with("<!--") {
            "-->"
        } else if rest.starts_with("<!") {
            ">"
        } else {
            return rest.strip_prefix('<').map(name);
        };
        rest = rest.split_once(end)?.1;
    }
}

/// The name at the beginning of the inside of a tag.
fn name(inside: &str) -> &str {
    let end = inside
        .find(|c: char| c.is_whitespace() || matches!(c, '/' | '>' | '<'))
        .unwrap_or(inside.len());
    &inside[..end]
}

/// A tag.
#[derive(Clone, Copy)]
pub(super) struct Tag<'t> {
    pub(super) at: usize,
    pub(super) name: &'t str,
    /// Whether it ends an element; `<a/>` begins one, and is followed by its end.
    pub(super) is_end: bool,
    attributes: Located<'t>,
    source: SourceText<'t>,
}

/// The tags of a file.
pub(super) struct Tags<'t> {
    source: SourceText<'t>,
    at: usize,
    open: Vec<&'t str>,
    /// Whether the newest element has no content.
    is_empty: bool,
}

impl<'t> Tags<'t> {
    pub(super) fn new(source: SourceText<'t>) -> Self {
        Self {
            source,
            at: source.start,
            open: Vec::new(),
            is_empty: false,
        }
    }

    /// The next tag; `None` at the end of the file.
    /// Errors: Elements that do not end, or not in their order; a declaration.
    pub(super) fn next_tag(&mut self) -> Result<Option<Tag<'t>>, Bad> {
        let SourceText { text, work, .. } = self.source;
        if std::mem::take(&mut self.is_empty)
            && let Some(name) = self.open.pop()
        {
            let attributes = Located {
                at: self.at,
                text: "",
            };
            return Ok(Some(Tag {
                at: self.at,
                name,
                is_end: true,
                attributes,
                source: self.source,
            }));
        }
        loop {
            self.at += work.find(&text.as_bytes()[self.at..], |byte| byte == b'<');
            let (at, rest) = (self.at, &text[self.at..]);
            if rest.is_empty() || work.is_stopped() {
                return match self.open.last() {
                    Some(name) => Err(Bad::new(
                        at,
                        format!("expected </{name}>; found the end of the file"),
                    )),
                    None => Ok(None),
                };
            }
            let passed = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")]
                .into_iter()
                .find(|(start, _)| rest.starts_with(start));
            match passed {
                Some((start, end)) => self.pass(start.len(), end)?,
                None if rest.starts_with("<!") => {
                    return Err(Bad::new(
                        at,
                        "expected elements; found a declaration, `<!`, which annotation files do \
                            not have",
                    ));
                }
                None => return self.tag().map(Some),
            }
        }
    }

    /// Passes over a text that begins here and has this end.
    fn pass(&mut self, start: usize, end: &str) -> Result<(), Bad> {
        let (text, from) = (self.source.text, self.at + start);
        let mut at = from;
        while at < text.len() && !self.source.work.is_stopped() {
            at += self
                .source
                .work
                .find(&text.as_bytes()[at..], |byte| byte == b'>')
                + 1;
            if at <= text.len() && text.as_bytes()[from..at].ends_with(end.as_bytes()) {
                self.at = at;
                return Ok(());
            }
        }
        Err(Bad::new(
            self.at,
            format!("expected `{end}`; found the end of the file"),
        ))
    }

    /// The tag that begins here.
    fn tag(&mut self) -> Result<Tag<'t>, Bad> {
        let (SourceText { text, work, .. }, at) = (self.source, self.at);
        let mut end = at + 1;
        loop {
            end += work.find(&text.as_bytes()[end..], |byte| {
                matches!(byte, b'>' | b'<' | b'"' | b'\'')
            });
            match text.as_bytes().get(end) {
                Some(b'>') => break,
                Some(b'<') => {
                    return Err(Bad::new(end, "expected `>`, the end of a tag; found `<`"));
                }
                Some(quote) => {
                    end += 1 + work.find(&text.as_bytes()[end + 1..], |byte| byte == *quote) + 1
                }
                None => {
                    return Err(Bad::new(
                        at,
                        "expected `>`, the end of a tag; found the end of the file",
                    ));
                }
            }
            if end > text.len() || work.is_stopped() {
                return Err(Bad::new(
                    at,
                    "expected a tag whose quotes end; found the end of the file",
                ));
            }
        }
        self.at = end + 1;
        let inside = &text[at + 1..end];
        let (is_end, inside) = inside
            .strip_prefix('/')
            .map_or((false, inside), |inside| (true, inside));
        let (is_empty, inside) = inside
            .strip_suffix('/')
            .filter(|_| !is_end)
            .map_or((false, inside), |inside| (true, inside));
        let name = name(inside);
        let attributes = &inside[name.len()..];
        let attributes_at = attributes.as_ptr().addr() - text.as_ptr().addr();
        if is_end {
            let open = self.open.pop();
            if open != Some(name) {
                let expected = open.map_or("the end of the file".to_owned(), |open| {
                    format!("</{open}>")
                });
                return Err(Bad::new(
                    at,
                    format!("expected {expected}; found the end of {}", quote(name)),
                ));
            }
        } else {
            if self.open.len() == MAX_ELEMENT_DEPTH {
                return Err(Bad::new(
                    at,
                    format!(
                        "expected at most {MAX_ELEMENT_DEPTH} elements inside one another; \
                         found more"
                    ),
                ));
            }
            self.open.push(name);
            self.is_empty = is_empty;
        }
        Ok(Tag {
            at,
            name,
            is_end,
            attributes: Located {
                at: attributes_at,
                text: attributes,
            },
            source: self.source,
        })
    }
}

impl<'t> Tag<'t> {
    /// The values of attributes; other attributes are passed over.
    /// Errors: A text that is no attribute, or one that is given twice.
    pub(super) fn attributes<const N: usize>(
        &self,
        names: [&str; N],
    ) -> Result<[Option<Located<'t>>; N], Bad> {
        let mut values = [None; N];
        self.source.work.add(self.attributes.text.len());
        let (all, mut rest) = (self.attributes, self.attributes.text.trim_start());
        while !rest.is_empty() {
            let at = |part: &str| all.at + (part.as_ptr().addr() - all.text.as_ptr().addr());
            let wrong = || Bad::new(at(rest), "expected an attribute, name=\"value\"");
            let (name, value) = rest.split_once('=').ok_or_else(wrong)?;
            let value = value.trim_start();
            let mark = value
                .chars()
                .next()
                .filter(|mark| matches!(mark, '"' | '\''))
                .ok_or_else(wrong)?;
            let (value, after) = value[1..].split_once(mark).ok_or_else(wrong)?;
            if let Some(index) = names.iter().position(|wanted| *wanted == name.trim_end())
                && values[index]
                    .replace(Located {
                        at: at(value),
                        text: value,
                    })
                    .is_some()
            {
                return Err(Bad::new(
                    at(rest),
                    format!(
                        "expected each attribute once; found a second {}",
                        quote(names[index])
                    ),
                ));
            }
            rest = after.trim_start();
        }
        Ok(values)
    }

    /// The values of attributes that the element must have.
    pub(super) fn required<const N: usize>(
        &self,
        names: [&str; N],
    ) -> Result<[Located<'t>; N], Bad> {
        let values = self.attributes(names)?;
        if let Some((name, _)) = names.iter().zip(&values).find(|(_, value)| value.is_none()) {
            return Err(Bad::new(
                self.at,
                format!(
                    "expected the attribute `{name}` of <{}>; it is missing",
                    self.name
                ),
            ));
        }
        Ok(values.map(|value| {
            value.unwrap_or(Located {
                at: self.at,
                text: "",
            })
        }))
    }
}

impl<'t> Located<'t> {
    /// The value of an attribute, with its entities as characters.
    /// Errors: An entity that only a declaration could explain, or a long text.
    pub(super) fn unescaped(self) -> Result<Cow<'t, str>, Bad> {
        if self.text.len() > LONGEST_NAME {
            return Err(Bad::new(
                self.at,
                format!(
                    "expected a name of at most {LONGEST_NAME} bytes; found {}",
                    quote(self.text)
                ),
            ));
        }
        if !self.text.contains('&') {
            return Ok(Cow::Borrowed(self.text));
        }
        let (mut text, mut rest) = (String::with_capacity(self.text.len()), self.text);
        while let Some((before, after)) = rest.split_once('&') {
            let entity = after
                .split_once(';')
                .and_then(|(name, after)| Some((character(name)?, after)));
            let (character, after) = entity.ok_or_else(|| {
                Bad::new(
                    self.at,
                    "expected `&amp;` or another entity of XML after `&`",
                )
            })?;
            text.push_str(before);
            text.push(character);
            rest = after;
        }
        text.push_str(rest);
        Ok(Cow::Owned(text))
    }
}

fn character(entity: &str) -> Option<char> {
    let number = |digits: &str, radix| {
        u32::from_str_radix(digits, radix)
            .ok()
            .and_then(char::from_u32)
    };
    match entity {
        "amp" => Some('&'),
        "lt" => Some('<'),
        "gt" => Some('>'),
        "quot" => Some('"'),
        "apos" => Some('\''),
        _ => match entity.strip_prefix('#')? {
            hexadecimal if hexadecimal.starts_with('x') => number(&hexadecimal[1..], 16),
            decimal => number(decimal, 10),
        },
    }
}
