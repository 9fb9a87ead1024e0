//! JSON text as nodes with an address.
//!
//! [`root`] lets `serde_json` check the syntax of the whole text first (400). A [`Node`] is a part
//! of that text, so only its meaning can be wrong (422). No tree is built, and memory is allocated
//! for problems only: every level of the document is one more scan of its text, and the messages
//! have at most four levels. Numbers stay text until `number.rs` reads them: `1e999` is out of
//! range, not a syntax error.

mod scan;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::fmt;

use serde::Deserialize;
use serde_json::value::RawValue;

use super::work::Work;
use super::{fields, shape, suggest, syntax};
use crate::problem::words::{LONGEST_QUOTE, advice, is_unseen, list, quote};
use crate::problem::{Code, Problem};
use scan::next;
pub(crate) use scan::next_value;

/// Texts of at most this many bytes are read without asking whether anybody wants the result: one
/// pass takes less than a millisecond.
const SHORT_BYTES: usize = 256 << 10;
/// Members of an object of another kind that are looked at.
const MOST_MEMBERS: usize = 64;

/// The address of a node: a linked list on the stack, written as a JSON pointer only for a problem.
#[derive(Clone, Copy, Debug)]
pub(crate) enum At<'p> {
    Root,
    Field(&'p At<'p>, &'static str),
    /// A field whose name the client has chosen.
    Member(&'p At<'p>, &'p str),
    Item(&'p At<'p>, usize),
}

impl fmt::Display for At<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Root => Ok(()),
            // Known names contain neither `~` nor `/`: nothing to escape.
            Self::Field(parent, name) => write!(f, "{parent}/{name}"),
            // The pointer ends before a name that a reader could not see.
            Self::Member(parent, name) if is_unreadable(name) => write!(f, "{parent}"),
            Self::Member(parent, name) => write!(f, "{parent}/{}", step(name)),
            Self::Item(parent, index) => write!(f, "{parent}/{index}"),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Null,
    Bool,
    Number,
    String,
    Array,
    Object,
}

impl Kind {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Null => "null",
            Self::Bool => "a boolean",
            Self::Number => "a number",
            Self::String => "a string",
            Self::Array => "an array",
            Self::Object => "an object",
        }
    }
}

/// One value of the document. `'j`: the text of the request; `'p`: the path to the value.
#[derive(Clone, Copy)]
pub(crate) struct Node<'j, 'p> {
    /// The value as the client wrote it.
    pub text: &'j str,
    pub at: At<'p>,
    /// Where scans of a long text are counted, and end when it is cancelled.
    pub work: Option<&'p Work<'p>>,
}

/// A field of an object, if the client gave it.
pub(crate) type OptionalNode<'j, 'p> = Option<Node<'j, 'p>>;

/// The values of known fields, and the first name that is not known.
type KnownFields<'j, 'q, const N: usize> = ([Option<Node<'j, 'q>>; N], Option<Cow<'j, str>>);

/// A field name; allocated only if it contains escapes.
#[derive(Deserialize)]
struct Name<'j>(#[serde(borrow)] Cow<'j, str>);

/// Checks that the text is one JSON object and nothing else.
pub(crate) fn root(body: &[u8]) -> Result<Node<'_, 'static>, Problem> {
    root_by(body, value)
}

/// As [`root`], for a text that may be long: the work is counted, and may be cancelled.
pub(crate) fn long_root<'j, 'w>(
    body: &'j [u8],
    work: &'w Work<'w>,
) -> Result<Node<'j, 'w>, Problem> {
    if body.len() <= SHORT_BYTES {
        return root(body);
    }
    root_by(body, |text| long_value(text, work))
}

fn root_by<'j, 'w>(
    body: &'j [u8],
    read: impl FnOnce(&'j str) -> Result<Node<'j, 'w>, serde_json::Error>,
) -> Result<Node<'j, 'w>, Problem> {
    let malformed = |detail| Problem::new(Code::MalformedRequest, detail);
    let not_json = |e: &dyn fmt::Display| malformed(format!("not JSON: {e}"));
    if let Some(what) = syntax::not_text(body) {
        return Err(not_json(&what));
    }
    let text = std::str::from_utf8(body).map_err(|e| {
        not_json(&format_args!(
            "the text is not UTF-8 after byte {}",
            e.valid_up_to()
        ))
    })?;
    let node = read(text).map_err(|e| not_json(&format_args!("{e}{}", syntax::hint(text, &e))))?;
    match node.kind() {
        Kind::Object => Ok(node),
        other => {
            let hint = if other == Kind::Array {
                list_hint(&node)
            } else {
                ""
            };
            Err(malformed(format!(
                "the request must be a JSON object, {{...}}; found {}{hint}",
                other.name()
            )))
        }
    }
}

/// Where the items of a list go that is sent instead of an object.
fn list_hint(list: &Node<'_, '_>) -> &'static str {
    let first = next(&mut &list.text[1..], list.work).map(|text| Node::new(text, At::Root));
    match first {
        Some(first) if first.kind() == Kind::Array => "; handles are {\"p\": [...], \"q\": [...]}",
        Some(first) if shape::geojson(&first.members()).is_some() => {
            "; GeoJSON goes in the field `geojson`: \
                {\"type\": \"FeatureCollection\", \"features\": [...]}"
        }
        _ => "",
    }
}

/// Checks that the text is one JSON value and nothing else.
pub(crate) fn value(text: &str) -> Result<Node<'_, 'static>, serde_json::Error> {
    let raw: &RawValue = serde_json::from_str(text)?;
    Ok(Node::new(raw.get(), At::Root))
}

/// As [`value`], for a long text: the work is counted, and may be cancelled.
pub(crate) fn long_value<'j, 'w>(
    text: &'j str,
    work: &'w Work<'w>,
) -> Result<Node<'j, 'w>, serde_json::Error> {
    work.check_json(text)?;
    Ok(Node {
        work: Some(work),
        ..Node::new(text.trim_matches([' ', '\t', '\n', '\r']), At::Root)
    })
}

/// Reads a field if it was given.
pub(crate) fn optional<'j, 'p, T>(
    field: Option<Node<'j, 'p>>,
    read: impl FnOnce(&Node<'j, 'p>) -> Result<T, Problem>,
) -> Result<Option<T>, Problem> {
    field.map(|node| read(&node)).transpose()
}

impl<'j, 'p> Node<'j, 'p> {
    /// A value of a text that is short, or was scanned before.
    pub(crate) const fn new(text: &'j str, at: At<'p>) -> Self {
        Self {
            text,
            at,
            work: None,
        }
    }

    /// Cuts the next value or field name off the inside of this array or object; `None` at its end.
    fn next(&self, rest: &mut &'j str) -> Option<&'j str> {
        next(rest, self.work)
    }

    pub(crate) fn kind(&self) -> Kind {
        match self.text.as_bytes().first() {
            Some(b'[') => Kind::Array,
            Some(b'{') => Kind::Object,
            Some(b'"') => Kind::String,
            Some(b't' | b'f') => Kind::Bool,
            Some(b'n') => Kind::Null,
            _ => Kind::Number,
        }
    }

    pub(crate) fn problem(&self, code: Code, detail: impl Into<String>) -> Problem {
        let problem = Problem::new(code, detail);
        match self.at {
            At::Root => problem,
            at => problem.pointer(at.to_string()),
        }
    }

    pub(crate) fn unexpected(&self, expected: &str, found: impl fmt::Display) -> Problem {
        self.problem(
            Code::BadValue,
            format!("expected {expected}; found {found}"),
        )
    }

    pub(crate) fn wrong_kind(&self, expected: &str) -> Problem {
        let hint = if self.is_quoted_value() {
            "; remove the quotes"
        } else {
            ""
        };
        self.unexpected(expected, format_args!("{}{hint}", self.kind().name()))
    }

    /// Whether this is a string that contains a number, `true` or `false`, or the beginning of an
    /// array or object.
    fn is_quoted_value(&self) -> bool {
        let Some(inside) = self
            .text
            .strip_prefix('"')
            .and_then(|text| text.strip_suffix('"'))
        else {
            return false;
        };
        let inside = inside.trim();
        let is_number = |text: &str| {
            text.len() <= LONGEST_QUOTE && text.parse::<f64>().is_ok_and(f64::is_finite)
        };
        inside.starts_with(['[', '{']) || matches!(inside, "true" | "false") || is_number(inside)
    }

    pub(crate) fn missing(&self, name: &str, expected: &str) -> Problem {
        let detail = match name {
            "q" => "`q` is missing: where do the handles go?".to_owned(),
            _ => format!("`{name}` is missing: expected {expected}"),
        };
        Problem::new(Code::BadValue, detail).pointer(format!("{}/{name}", self.at))
    }

    fn unknown(&self, name: &str, known: &[&str]) -> Problem {
        let pointer = self.pointer_to(name);
        if fields::is_unsupported(name, known) {
            return fields::unsupported(name, known).pointer(pointer);
        }
        let useful = fields::useful(known);
        let hint =
            shape::recognised(&self.members(), known).or_else(|| suggest::field(name, &useful));
        let advice = advice(hint, &format!("known fields: {}", list(&useful)));
        let detail = format!("unknown field: {}{advice}", quote(name));
        let problem = Problem::new(Code::UnknownField, detail);
        if pointer.is_empty() {
            problem
        } else {
            problem.pointer(pointer)
        }
    }

    /// The JSON pointer to an unknown field; to this object if the name is long or has characters
    /// that a reader would not see.
    fn pointer_to(&self, name: &str) -> String {
        if is_unreadable(name) {
            return self.at.to_string();
        }
        format!("{}/{}", self.at, step(name))
    }

    pub(crate) fn bool(&self) -> Result<bool, Problem> {
        if self.kind() == Kind::Bool {
            Ok(self.text == "true")
        } else {
            Err(self.wrong_kind("`true` or `false`"))
        }
    }

    pub(crate) fn string(&self, expected: &str) -> Result<String, Problem> {
        if self.kind() != Kind::String {
            return Err(self.wrong_kind(expected));
        }
        serde_json::from_str(self.text).map_err(|e| self.not_json(&e))
    }

    /// The values of the `known` fields, in that order. A field of the contract with the value
    /// `null` is absent; other fields are refused.
    pub(crate) fn fields<'q, const N: usize>(
        &'q self,
        known: &[&'static str; N],
    ) -> Result<[Option<Node<'j, 'q>>; N], Problem> {
        let (given, unknown) = self.split_fields(known)?;
        unknown.map_or(Ok(given), |name| Err(self.unknown(&name, known)))
    }

    /// As [`Node::fields`], of names that a table has: one at least, and eight at most.
    pub(crate) fn fields_of<'q>(
        &'q self,
        known: &[&'static str],
    ) -> Result<Vec<Option<Node<'j, 'q>>>, Problem> {
        let padded: [&'static str; 8] =
            std::array::from_fn(|k| known.get(k).or(known.first()).copied().unwrap_or_default());
        let (given, unknown) = self.split_fields(&padded)?;
        match unknown {
            Some(name) => Err(self.unknown(&name, known)),
            None => Ok(given[..known.len()].to_vec()),
        }
    }

    /// As [`Node::fields`], but other fields are ignored.
    pub(crate) fn find<'q, const N: usize>(
        &'q self,
        known: &[&'static str; N],
    ) -> Result<[Option<Node<'j, 'q>>; N], Problem> {
        self.split_fields(known).map(|(given, _)| given)
    }

    /// The values of the `known` fields, and the first name that is not known.
    fn split_fields<'q, const N: usize>(
        &'q self,
        known: &[&'static str; N],
    ) -> Result<KnownFields<'j, 'q, N>, Problem> {
        if self.kind() != Kind::Object {
            return Err(self.wrong_kind("an object"));
        }
        let (mut values, mut repeated, mut unknown) = ([None; N], None, None);
        let mut rest = &self.text[1..];
        while let Some(name) = self.next(&mut rest) {
            let Name(name) = serde_json::from_str(name).map_err(|e| self.not_json(&e))?;
            let Some(index) = known.iter().position(|known| *known == name) else {
                let value = self.next(&mut rest);
                if !(value == Some("null") && fields::is_unsupported(&name, known)) {
                    unknown.get_or_insert(name);
                }
                continue;
            };
            let text = self.next(&mut rest).unwrap_or_default();
            let node = Node {
                text,
                at: At::Field(&self.at, known[index]),
                work: self.work,
            };
            if values[index].replace(node).is_some() {
                repeated.get_or_insert(known[index]);
            }
        }
        if let Some(name) = repeated {
            let pointer = format!("{}/{name}", self.at);
            return Err(Problem::new(
                Code::MalformedRequest,
                format!("the field `{name}` is given twice"),
            )
            .pointer(pointer));
        }
        Ok((
            values.map(|value| value.filter(|node| node.kind() != Kind::Null)),
            unknown,
        ))
    }

    /// The name of a field as it is written, in its quotes, without them and without escapes.
    pub(crate) fn name(written: &'j str) -> Option<Cow<'j, str>> {
        serde_json::from_str(written).ok().map(|Name(name)| name)
    }

    /// The names, in their quotes, and the values of an object.
    pub(crate) fn pairs(&self) -> impl Iterator<Item = (&'j str, &'j str)> + use<'j, 'p> {
        let mut rest = self.text.get(1..).unwrap_or_default();
        let node = *self;
        std::iter::from_fn(move || Some((node.next(&mut rest)?, node.next(&mut rest)?)))
    }

    /// The first pairs, enough to tell what the object is; none if it is no object.
    pub(crate) fn members(&self) -> Vec<(&'j str, &'j str)> {
        if self.kind() == Kind::Object {
            self.pairs().take(MOST_MEMBERS).collect()
        } else {
            Vec::new()
        }
    }

    /// The first value of an array.
    pub(crate) fn first(&self) -> Option<Self> {
        let text = self.next(&mut self.text.get(1..).unwrap_or_default())?;
        Some(Node {
            text,
            at: At::Root,
            work: self.work,
        })
    }

    /// Calls `found` with the value that a JSON pointer leads to, or with the last one that exists
    /// on the way.
    pub(crate) fn resolve<T>(&self, pointer: &str, found: impl FnOnce(&Node<'_, '_>) -> T) -> T {
        let mut node = Node {
            at: At::Root,
            ..*self
        };
        for step in pointer.split('/').skip(1) {
            let mut rest = &node.text[1.min(node.text.len())..];
            let inner = match node.kind() {
                Kind::Array => step
                    .parse()
                    .ok()
                    .and_then(|index| std::iter::from_fn(|| self.next(&mut rest)).nth(index)),
                Kind::Object => node
                    .pairs()
                    .find(|(name, _)| name.trim_matches('"') == step)
                    .map(|(_, value)| value),
                _ => None,
            };
            let Some(text) = inner else { break };
            node.text = text;
        }
        found(&node)
    }

    /// Hands over the values of an array one by one; the first problem ends it.
    pub(crate) fn items<E: From<Problem>>(
        &self,
        expected: &str,
        mut each: impl FnMut(usize, Node<'j, '_>) -> Result<(), E>,
    ) -> Result<(), E> {
        if self.kind() != Kind::Array {
            return Err(self.wrong_kind(expected).into());
        }
        let (mut index, mut rest) = (0, &self.text[1..]);
        while let Some(text) = self.next(&mut rest) {
            each(
                index,
                Node {
                    text,
                    at: At::Item(&self.at, index),
                    work: self.work,
                },
            )?;
            index += 1;
        }
        Ok(())
    }

    /// Reads every value of an array. `text_length`: bytes of an ordinary value; the capacity of
    /// the list is estimated from it, and from the commas, of which there is one less than values.
    pub(crate) fn list<T>(
        &self,
        expected: &str,
        text_length: usize,
        mut read: impl FnMut(usize, Node<'j, '_>) -> Result<T, Problem>,
    ) -> Result<Vec<T>, Problem> {
        let commas = self.text.bytes().filter(|byte| *byte == b',').count();
        let mut list = Vec::with_capacity(1 + commas.min(self.text.len() / text_length));
        self.items::<Problem>(expected, |index, item| {
            list.push(read(index, item)?);
            Ok(())
        })?;
        Ok(list)
    }

    /// An error that decoding finds and [`root`] does not: half of a surrogate pair in a string.
    fn not_json(&self, error: &serde_json::Error) -> Problem {
        self.problem(Code::MalformedRequest, format!("not JSON: {error}"))
    }
}

fn is_unreadable(name: &str) -> bool {
    name.chars().nth(LONGEST_QUOTE).is_some() || name.contains(is_unseen)
}

/// A name as one step of a pointer (RFC 6901, section 3).
fn step(name: &str) -> String {
    name.replace('~', "~0").replace('/', "~1")
}
