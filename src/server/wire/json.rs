//! JSON text to nodes with an address. Syntax is `serde_json`'s alone and comes first: [`root`] checks the whole text (400), after which a
//! [`Node`] is well-formed text, cut out but not copied, and only its meaning can be wrong (422). Objects are taken apart by `serde_json`,
//! arrays by looking for commas, which well-formed text allows. No tree is built and nothing is allocated but for a problem: a level of
//! the document is one more scan of its text, and the forms read here are at most four levels deep. Numbers stay as they were written until `number.rs` reads them, so `1e999` is a number out of range, not a syntax error.

use std::fmt;

use serde::Deserializer as _;
use serde::de::{DeserializeSeed, IgnoredAny, MapAccess, Visitor};
use serde_json::value::RawValue;

use crate::problem::{Code, Problem};

/// Longest name or value of the client's that is repeated in a problem, characters.
const LONGEST_QUOTE: usize = 60;

/// Where a node stands: a list that lives on the stack and becomes a JSON pointer only when something is wrong.
#[derive(Clone, Copy)]
pub(crate) enum At<'p> {
    Root,
    Field(&'p At<'p>, &'static str),
    Item(&'p At<'p>, usize),
}

impl fmt::Display for At<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Root => Ok(()),
            // Known names hold neither `~` nor `/`: nothing to escape.
            Self::Field(parent, name) => write!(f, "{parent}/{name}"),
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
    const fn name(self) -> &'static str {
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

/// One value of the document. `'j`: the request's text; `'p`: the path to here.
#[derive(Clone, Copy)]
pub(crate) struct Node<'j, 'p> {
    json: &'j str,
    pub(crate) at: At<'p>,
}

/// Checks that the text is one JSON object and nothing else.
pub(crate) fn root(body: &[u8]) -> Result<Node<'_, 'static>, Problem> {
    let malformed = |detail| Problem::new(Code::MalformedRequest, detail);
    let text = std::str::from_utf8(body).map_err(|e| malformed(format!("not JSON: not UTF-8 after byte {}", e.valid_up_to())))?;
    let raw: &RawValue = serde_json::from_str(text).map_err(|e| malformed(format!("not JSON: {e}")))?;
    let node = Node { json: raw.get(), at: At::Root };
    match node.kind() {
        Kind::Object => Ok(node),
        other => Err(malformed(format!("the request must be a JSON object; found {}", other.name()))),
    }
}

/// A node that was cut out before and kept.
pub(crate) const fn kept<'j, 'p>(json: &'j str, at: At<'p>) -> Node<'j, 'p> {
    Node { json, at }
}

impl Node<'_, 'static> {
    /// An empty document, to say what it lacks.
    pub(crate) const fn nowhere() -> Self {
        Self { json: "{}", at: At::Root }
    }
}

impl<'j> Node<'j, '_> {
    pub(crate) fn kind(&self) -> Kind {
        match self.json.as_bytes().first() {
            Some(b'[') => Kind::Array,
            Some(b'{') => Kind::Object,
            Some(b'"') => Kind::String,
            Some(b't' | b'f') => Kind::Bool,
            Some(b'n') => Kind::Null,
            _ => Kind::Number,
        }
    }

    /// The value as the client wrote it.
    pub(crate) const fn text(&self) -> &'j str {
        self.json
    }

    pub(crate) fn problem(&self, code: Code, detail: impl Into<String>) -> Problem {
        let problem = Problem::new(code, detail);
        match self.at {
            At::Root => problem,
            at => problem.pointer(at.to_string()),
        }
    }

    /// `bad_value`: what is expected, and what kind of value stands there.
    pub(crate) fn wrong_kind(&self, expected: &str) -> Problem {
        self.problem(Code::BadValue, format!("expected {expected}; found {}", self.kind().name()))
    }

    /// `bad_value` for a field that must be given.
    pub(crate) fn missing(&self, name: &str, expected: &str) -> Problem {
        Problem::new(Code::BadValue, format!("`{name}` is missing: expected {expected}")).pointer(format!("{}/{name}", self.at))
    }

    pub(crate) fn unknown(&self, name: &str, known: &[&str]) -> Problem {
        let detail = format!("unknown field: {}; known: {}", quote(name), list(known));
        let short = name.chars().nth(LONGEST_QUOTE).is_none();
        if short {
            Problem::new(Code::UnknownField, detail).pointer(format!("{}/{}", self.at, escape(name)))
        } else {
            self.problem(Code::UnknownField, detail)
        }
    }

    pub(crate) fn bool(&self) -> Result<bool, Problem> {
        match self.kind() {
            Kind::Bool => Ok(self.json == "true"),
            _ => Err(self.wrong_kind("`true` or `false`")),
        }
    }

    pub(crate) fn string(&self, expected: &str) -> Result<String, Problem> {
        if self.kind() != Kind::String {
            return Err(self.wrong_kind(expected));
        }
        serde_json::from_str(self.json).map_err(|e| self.not_json(&e))
    }

    /// The values of the `known` fields, in that order; any other field is refused.
    pub(crate) fn fields<'q, const N: usize>(
        &'q self,
        expected: &str,
        known: &[&'static str; N],
    ) -> Result<[Option<Node<'j, 'q>>; N], Problem> {
        if self.kind() != Kind::Object {
            return Err(self.wrong_kind(expected));
        }
        let mut found = Found { values: [None; N], twice: None, unknown: None };
        serde_json::Deserializer::from_str(self.json)
            .deserialize_map(Fields { known, found: &mut found })
            .map_err(|e| self.not_json(&e))?;
        if let Some(name) = found.twice {
            let pointer = format!("{}/{name}", self.at);
            return Err(Problem::new(Code::MalformedRequest, format!("field given twice: `{name}`")).pointer(pointer));
        }
        if let Some(name) = found.unknown {
            return Err(self.unknown(&name, known));
        }
        let mut names = known.iter();
        Ok(found.values.map(|value| {
            let name = names.next().copied().unwrap_or_default();
            value.map(|json| Node { json, at: At::Field(&self.at, name) })
        }))
    }

    /// Hands over the values of an array one by one; the first problem ends it.
    pub(crate) fn items(&self, expected: &str, mut each: impl FnMut(usize, Node<'j, '_>) -> Result<(), Problem>) -> Result<(), Problem> {
        if self.kind() != Kind::Array {
            return Err(self.wrong_kind(expected));
        }
        let text = self.json;
        let bytes = text.as_bytes();
        let (mut index, mut start) = (0, 1);
        loop {
            start += spaces(&bytes[start..]);
            if matches!(bytes.get(start), None | Some(b']')) {
                return Ok(());
            }
            let end = start + length(&bytes[start..]);
            each(index, Node { json: text.get(start..end).unwrap_or_default(), at: At::Item(&self.at, index) })?;
            index += 1;
            // Past the comma; the bracket that ends the array may be stepped over as well, and then nothing is left.
            start = (end + spaces(&bytes[end..]) + 1).min(bytes.len());
        }
    }

    /// What [`root`] lets pass and decoding does not: half of a surrogate pair in a string.
    fn not_json(&self, error: &serde_json::Error) -> Problem {
        self.problem(Code::MalformedRequest, format!("not JSON: {error}"))
    }
}

/// A name or value of the client's, cut to what a sentence can bear.
pub(crate) fn quote(text: &str) -> String {
    match text.char_indices().nth(LONGEST_QUOTE) {
        Some((end, _)) => format!("`{}...`", &text[..end]),
        None => format!("`{text}`"),
    }
}

/// Names of the contract, in backticks, with commas.
pub(crate) fn list(names: &[&str]) -> String {
    names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")
}

/// One step of a JSON pointer (RFC 6901, section 3).
fn escape(name: &str) -> String {
    name.replace('~', "~0").replace('/', "~1")
}

struct Found<'j, const N: usize> {
    values: [Option<&'j str>; N],
    twice: Option<&'static str>,
    unknown: Option<String>,
}

struct Fields<'a, 'j, const N: usize> {
    known: &'a [&'static str; N],
    found: &'a mut Found<'j, N>,
}

impl<'j, const N: usize> Visitor<'j> for Fields<'_, 'j, N> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'j>>(self, mut map: A) -> Result<(), A::Error> {
        let Self { known, found } = self;
        while let Some(index) = map.next_key_seed(Name { known, unknown: &mut found.unknown })? {
            let Some(index) = index else {
                map.next_value::<IgnoredAny>()?;
                continue;
            };
            let value: &'j RawValue = map.next_value()?;
            if found.values[index].replace(value.get()).is_some() {
                found.twice = found.twice.or(Some(known[index]));
            }
        }
        Ok(())
    }
}

/// Which of the known names a key is; the first that is none of them is kept.
struct Name<'a> {
    known: &'a [&'static str],
    unknown: &'a mut Option<String>,
}

impl<'de> DeserializeSeed<'de> for Name<'_> {
    type Value = Option<usize>;

    fn deserialize<D: serde::Deserializer<'de>>(self, key: D) -> Result<Option<usize>, D::Error> {
        key.deserialize_str(self)
    }
}

impl Visitor<'_> for Name<'_> {
    type Value = Option<usize>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a field name")
    }

    fn visit_str<E>(self, name: &str) -> Result<Option<usize>, E> {
        let index = self.known.iter().position(|k| *k == name);
        if index.is_none() && self.unknown.is_none() {
            *self.unknown = Some(name.to_owned());
        }
        Ok(index)
    }
}

/// How many bytes of white space `text` begins with.
fn spaces(text: &[u8]) -> usize {
    text.iter().take_while(|b| matches!(b, b' ' | b'\t' | b'\n' | b'\r')).count()
}

/// How many bytes the value takes that `text` begins with; `text` is well-formed, so that only its end has to be found.
fn length(text: &[u8]) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while let Some(byte) = text.get(at) {
        match byte {
            b'"' => {
                at += 1;
                while let Some(byte) = text.get(at).filter(|b| **b != b'"') {
                    at += if *byte == b'\\' { 2 } else { 1 };
                }
            }
            b'[' | b'{' => depth += 1,
            // The end of the array that the value stands in: the value was a scalar and is over.
            b',' | b']' | b'}' | b' ' | b'\t' | b'\n' | b'\r' if depth == 0 => return at,
            b']' | b'}' => depth -= 1,
            _ => {}
        }
        at += 1;
        if depth == 0 && matches!(byte, b'"' | b']' | b'}') {
            return at.min(text.len());
        }
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::Value;

    use super::*;

    fn texts(array: &str) -> Vec<String> {
        let body = format!("{{\"a\": {array}}}");
        let root = root(body.as_bytes()).unwrap();
        let [a] = root.fields("an object", &["a"]).unwrap();
        let mut texts = Vec::new();
        a.unwrap()
            .items("an array", |index, item| {
                assert_eq!(item.at.to_string(), format!("/a/{index}"));
                texts.push(item.text().to_owned());
                Ok(())
            })
            .unwrap();
        texts
    }

    #[test]
    fn items_are_found_between_spaces_strings_and_brackets() {
        assert_eq!(texts("[]"), [""; 0]);
        assert_eq!(texts("[ \n\t\r ]"), [""; 0]);
        assert_eq!(texts("[1]"), ["1"]);
        assert_eq!(texts("[ -1.5e+3 ,\r\n\ttrue , null]"), ["-1.5e+3", "true", "null"]);
        assert_eq!(texts("[[],{},\"\"]"), ["[]", "{}", "\"\""]);
        assert_eq!(texts("[[ 1 , [2] ] , {\"b\": [3, {}]} ]"), ["[ 1 , [2] ]", "{\"b\": [3, {}]}"]);
        assert_eq!(
            texts(r#"["]", "\"", "\\", "[\\\",", [",]"], {"}": "{"}]"#),
            [r#""]""#, r#""\"""#, r#""\\""#, r#""[\\\",""#, r#"[",]"]"#, r#"{"}": "{"}"#]
        );
        assert_eq!(texts("[\"\u{e9}]\", 2]"), ["\"\u{e9}]\"", "2"]);
    }

    fn json() -> impl Strategy<Value = Value> {
        let scalar = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            any::<f64>().prop_map(Value::from),
            any::<i32>().prop_map(Value::from),
            "[\\[\\]{},:\"\\\\ a\u{e9}]{0,6}".prop_map(Value::from),
        ];
        scalar.prop_recursive(4, 32, 4, |inner| {
            prop_oneof![
                prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
                prop::collection::vec(("[\\[\\]{},\"\\\\a]{0,3}", inner), 0..4).prop_map(|f| Value::Object(f.into_iter().collect())),
            ]
        })
    }

    proptest! {
        #[test]
        fn items_are_those_that_serde_finds(items in prop::collection::vec(json(), 0..5), pretty: bool) {
            let array = Value::from(items);
            let text = if pretty { serde_json::to_string_pretty(&array) } else { serde_json::to_string(&array) }.unwrap();
            let expected: Vec<&RawValue> = serde_json::from_str(&text).unwrap();
            prop_assert_eq!(texts(&text), expected.iter().map(|raw| raw.get()).collect::<Vec<_>>());
        }
    }
}
