//! The bodies of requests, put together by the subcommands from several JSON objects: files, and
//! options of the command line.

use mlswarp::pixmap::Extent;

use super::json::{self, Kind, Node, optional};
use super::rest::require_no_handles;
use super::{fields, size};
use crate::problem::Problem;

/// An object, and what messages call its place.
#[derive(Clone, Debug)]
pub struct NamedObject {
    /// What messages call it: a file or an option.
    pub name: String,
    /// Its text.
    pub json: Vec<u8>,
    /// An option replaces fields of files without a word.
    pub is_option: bool,
}

/// One field of all objects; those of `output` one by one.
#[derive(Debug)]
struct MergedField<'a> {
    is_output: bool,
    /// In its quotes.
    name: &'a str,
    value: &'a str,
    source: usize,
}

/// An object with the fields of several ones.
#[derive(Debug)]
pub struct Merged {
    /// The text.
    pub json: Vec<u8>,
    /// Which field of which place does not count, and why: sentences.
    pub replaced: Vec<String>,
    /// The pointer to each field, and its place.
    places: Vec<(String, String)>,
}

impl Merged {
    /// An object with the fields of all `sources`. Of two that give a field the later one counts,
    /// for each field of `output` apart; `null` is no field. A field that one object gives twice is
    /// kept twice, which its parser reports. Errors: A text that is not a JSON object, and its
    /// index.
    pub fn of(sources: &[NamedObject]) -> Result<Self, (usize, Problem)> {
        let (mut merged, mut replaced): (Vec<MergedField<'_>>, Vec<String>) =
            (Vec::new(), Vec::new());
        for (
            source,
            NamedObject {
                name: place,
                json,
                is_option,
            },
        ) in sources.iter().enumerate()
        {
            let root = json::root(json).map_err(|problem| (source, problem))?;
            for field in fields_of(&root, source) {
                let is_same = |other: &&mut MergedField<'_>| {
                    (other.is_output, other.name) == (field.is_output, field.name)
                };
                match merged.iter_mut().find(is_same) {
                    Some(earlier) if earlier.source != source => {
                        let (is_other, is_given) = (
                            earlier.value != field.value,
                            ![earlier.value, field.value].contains(&"null"),
                        );
                        if is_other && is_given && !is_option {
                            let name = field.pointer().replace('/', ".");
                            let (loser, name) = (&sources[earlier.source].name, &name[1..]);
                            replaced.push(format!("{place} replaces `{name}` of {loser}"));
                        }
                        if field.value != "null" {
                            *earlier = field;
                        }
                    }
                    _ => merged.push(field),
                }
            }
        }
        let text = |is_output: bool| {
            let fields = merged.iter().filter(|field| field.is_output == is_output);
            fields
                .map(|MergedField { name, value, .. }| format!("{name}:{value}"))
                .collect::<Vec<_>>()
                .join(",")
        };
        let json = match (text(false), text(true)) {
            (all, output) if output.is_empty() => format!("{{{all}}}"),
            (rest, output) if rest.is_empty() => format!("{{\"output\":{{{output}}}}}"),
            (rest, output) => format!("{{{rest},\"output\":{{{output}}}}}"),
        };
        let given = merged.iter().filter(|field| field.value != "null");
        let places = given
            .map(|field| (field.pointer(), sources[field.source].name.clone()))
            .collect();
        Ok(Self {
            json: json.into_bytes(),
            replaced,
            places,
        })
    }

    /// The place of the field that a problem points to.
    pub fn place(&self, pointer: &str) -> Option<&str> {
        let is_in = |field: &str| {
            pointer
                .strip_prefix(field)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        self.places
            .iter()
            .find(|(field, _)| is_in(field))
            .map(|(_, place)| place.as_str())
    }

    /// The text of a field.
    pub fn value(&self, name: &str) -> Option<&str> {
        let root = json::root(&self.json).ok()?;
        let value = root
            .pairs()
            .find(|(own, _)| own.trim_matches('"') == name)
            .map(|(_, value)| value);
        value.filter(|value| *value != "null")
    }

    /// The text with one more field.
    pub fn with(&self, name: &str, value: Option<String>) -> Vec<u8> {
        let inside = self.json.strip_prefix(b"{").unwrap_or_default();
        match value {
            None => self.json.clone(),
            Some(value) if inside == b"}" => format!("{{\"{name}\":{value}}}").into_bytes(),
            Some(value) => [format!("{{\"{name}\":{value},").as_bytes(), inside].concat(),
        }
    }

    /// For a request whose handles are in landmark files.
    /// Errors: A field that says the same.
    pub fn require_no_handles(&self) -> Result<(), Problem> {
        require_no_handles(|name| self.has(name))
    }

    /// Whether a field is given.
    pub fn has(&self, name: &str) -> bool {
        self.places
            .iter()
            .any(|(field, _)| field.strip_prefix('/') == Some(name))
    }
}

impl MergedField<'_> {
    fn pointer(&self) -> String {
        let name = self.name.trim_matches('"');
        if self.is_output {
            format!("/output/{name}")
        } else {
            format!("/{name}")
        }
    }
}

/// The fields of an object, and those of `output` in it.
fn fields_of<'j>(root: &Node<'j, '_>, source: usize) -> Vec<MergedField<'j>> {
    let field = |is_output| {
        move |(name, value)| MergedField {
            is_output,
            name,
            value,
            source,
        }
    };
    let fields = root.pairs().flat_map(|(name, value)| {
        let node = Node::new(value, json::At::Root);
        let is_output = name == "\"output\"" && node.kind() == Kind::Object;
        let inner: Vec<_> = if is_output {
            node.pairs().map(field(true)).collect()
        } else {
            vec![field(false)((name, value))]
        };
        inner
    });
    fields.collect()
}

/// An object without some of its fields.
/// Errors: A text that is not a JSON object.
fn without(object: &[u8], names: &[&str]) -> Result<Vec<u8>, Problem> {
    Ok(spliced_into(&json::root(object)?, names, b"{}"))
}

/// An object without some of its fields, and with those of another object, which come first.
pub(crate) fn spliced_into(object: &Node<'_, '_>, without: &[&str], more: &[u8]) -> Vec<u8> {
    let more = more.trim_ascii().strip_suffix(b"}").unwrap_or_default();
    let mut text = Vec::with_capacity(object.text.len() + more.len() + 1);
    text.extend_from_slice(more.trim_ascii_end());
    for (name, value) in object
        .pairs()
        .filter(|(name, _)| !without.contains(&name.trim_matches('"')))
    {
        text.extend_from_slice(if text == b"{" { b"" } else { b"," });
        for part in [name, ":", value] {
            text.extend_from_slice(part.as_bytes());
        }
    }
    text.push(b'}');
    text
}

/// A warp object as the body of `/fit`: without what says how it is drawn.
/// Errors: A text that is not a JSON object.
pub fn of_fit(object: &[u8]) -> Result<Vec<u8>, Problem> {
    let others: Vec<&str> = fields::WARP
        .into_iter()
        .filter(|name| !fields::FIT.contains(name))
        .collect();
    without(object, &others)
}

/// Splits an object with the fields of both into the warp object of a session and the body of a
/// batch. `keeps_pose`: whether the session gets the pose; otherwise the batch does. Errors: Not a
/// JSON object.
pub fn split_batch(object: &[u8], keeps_pose: bool) -> Result<[Vec<u8>; 2], Problem> {
    let root = json::root(object)?;
    let is_of_batch =
        |name: &str| name == "output" || !keeps_pose && ["q", "strength"].contains(&name);
    let is_of_session = |name: &str| fields::WARP.contains(&name) && !is_of_batch(name);
    let text = |is_session: bool| {
        let fields = root
            .pairs()
            .filter(|(name, _)| is_of_session(name.trim_matches('"')) == is_session);
        let fields: Vec<String> = fields
            .map(|(name, value)| format!("{name}:{value}"))
            .collect();
        format!("{{{}}}", fields.join(",")).into_bytes()
    };
    Ok([text(true), text(false)])
}

/// The field `extent` of an object.
/// Errors: Not a size.
pub fn extent_in(object: &[u8]) -> Result<Option<Extent>, Problem> {
    let root = json::root(object)?;
    let [extent] = root.find(&["extent"])?;
    optional(extent, size)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn merged(objects: &[&str]) -> Result<Merged, (usize, Problem)> {
        let source = |(k, text): (usize, &&str)| {
            let is_option = text.starts_with("{\"--");
            NamedObject {
                name: format!("{k}.json"),
                json: text.replace("--", "").into_bytes(),
                is_option,
            }
        };
        Merged::of(&objects.iter().enumerate().map(source).collect::<Vec<_>>())
    }

    #[test]
    fn fields_of_all_objects_stay_as_they_are_written() {
        let text = |objects: &[&str]| String::from_utf8(merged(objects).unwrap().json).unwrap();
        assert_eq!(text(&[]), "{}");
        assert_eq!(text(&["{}", " { } \n"]), "{}");
        assert_eq!(
            text(&["{\"a\": {\"b\": {}}}", "{}", "{\"c\": 1e0 , \"d\": {}}"]),
            "{\"a\":{\"b\": {}},\"c\":1e0,\"d\":{}}"
        );
        assert_eq!(
            text(&["{\"a\": 1, \"a\": 2}"]),
            "{\"a\":1,\"a\":2}",
            "its parser reports it"
        );
        assert!(merged(&["[]"]).is_err() && merged(&["{} {}"]).is_err());
        assert_eq!(merged(&["{}", "{"]).unwrap_err().0, 1);
        assert_eq!(
            extent_in(b"{\"extent\": [4, 3]}").unwrap(),
            Extent::new(4, 3)
        );
        assert_eq!(extent_in(b"{\"extent\": null, \"p\": []}").unwrap(), None);
        assert!(extent_in(b"{\"extent\": [4]}").is_err());
        assert_eq!(
            without(br#"{"p": [1], "item": 2}"#, &["item", "q"]).unwrap(),
            br#"{"p":[1]}"#
        );
        let fit = of_fit(
            br#"{"p": [], "method": "tps", "candidates": [], "output": {}, "align": "rigid",
              "more": 1}"#,
        )
        .unwrap();
        assert_eq!(fit, br#"{"p":[],"candidates":[],"align":"rigid","more":1}"#);
        let spliced = |object: &str, more: &str| {
            let root = json::root(object.as_bytes()).unwrap();
            String::from_utf8(spliced_into(&root, &["item"], more.as_bytes())).unwrap()
        };
        assert_eq!(spliced("{}", "{}"), "{}");
        assert_eq!(spliced(r#" {"item": 3} "#, r#"{"p": {} }"#), r#"{"p": {}}"#);
        assert_eq!(
            spliced(r#"{"a" : 1e0, "item": [3], "b": "}"}"#, " { } "),
            r#"{"a":1e0,"b":"}"}"#
        );
        assert_eq!(spliced(r#"{"a": 1}"#, r#"{"p": []}"#), r#"{"p": [],"a":1}"#);
        let split = |keeps_pose| {
            let split = split_batch(
                br#"{"p": [[1, 2]], "steps": 2, "q": [[3, 4]], "output": {}, "other": "}"}"#,
                keeps_pose,
            )
            .unwrap();
            split.map(|text| String::from_utf8(text).unwrap())
        };
        assert_eq!(
            split(false),
            [
                r#"{"p":[[1, 2]]}"#,
                r#"{"steps":2,"q":[[3, 4]],"output":{},"other":"}"}"#
            ]
        );
        let [session, batch] = split(true);
        assert_eq!(session, r#"{"p":[[1, 2]],"q":[[3, 4]]}"#);
        assert_eq!(batch, r#"{"steps":2,"output":{},"other":"}"}"#);
    }

    #[test]
    fn of_two_fields_the_later_one_counts_and_both_places_are_named() {
        let (warp, batch) = (
            r#"{"q": 1, "output": {"width": 5, "canvas": "fit"}}"#,
            r#"{"output": {"width": 6}, "q": 2, "steps": 3}"#,
        );
        let both = merged(&[warp, batch]).unwrap();
        assert_eq!(
            String::from_utf8(both.json.clone()).unwrap(),
            r#"{"q":2,"steps":3,"output":{"width":6,"canvas":"fit"}}"#
        );
        assert_eq!(
            both.replaced,
            [
                "1.json replaces `output.width` of 0.json",
                "1.json replaces `q` of 0.json"
            ]
        );
        for (pointer, place) in [
            ("/q/3/0", Some("1.json")),
            ("/output/width", Some("1.json")),
            ("/output/canvas/x", Some("0.json")),
            ("/output", None),
            ("/p", None),
            ("/steps", Some("1.json")),
            ("/qq", None),
        ] {
            assert_eq!(both.place(pointer), place, "{pointer}");
        }
        assert!(both.has("steps") && !both.has("width"));
        let silent = |objects: &[&str]| merged(objects).unwrap().replaced.is_empty();
        assert!(
            silent(&[warp, warp])
                && silent(&[r#"{"q": 1}"#, r#"{"q": null}"#])
                && silent(&[r#"{"q": null}"#, r#"{"q": 1}"#])
        );
        assert!(
            silent(&[r#"{"q": 1}"#, r#"{"--q": 2}"#]),
            "an option is meant"
        );
        assert_eq!(
            merged(&[r#"{"q": 1}"#, r#"{"q": null}"#]).unwrap().json,
            br#"{"q":1}"#
        );
        assert_eq!(
            merged(&[r#"{"output": 3}"#, "{}"]).unwrap().json,
            br#"{"output":3}"#,
            "its parser reports it"
        );
    }
}
