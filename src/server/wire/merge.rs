//! The bodies of requests, put together by the subcommands from several JSON files: handles, annotations, the size of the image.

use mlswarp::pixmap::Extent;

use super::json::{self, optional};
use super::{fields, size};
use crate::problem::Problem;

/// An object with the fields of all objects. A field of two of them is kept twice, which its parser reports.
/// Errors: A text that is not a JSON object.
pub(crate) fn merged(objects: &[&[u8]]) -> Result<Vec<u8>, Problem> {
    let mut fields = Vec::new();
    for object in objects {
        let text = json::root(object)?.text;
        // Without its braces.
        let inside = text.get(1..text.len() - 1).unwrap_or_default().trim();
        fields.extend((!inside.is_empty()).then_some(inside));
    }
    Ok(format!("{{{}}}", fields.join(",")).into_bytes())
}

/// An object in which a field has this value, whatever it had; `value`: JSON.
/// Errors: Not a JSON object.
pub(crate) fn with_field(object: &[u8], name: &str, value: &str) -> Result<Vec<u8>, Problem> {
    let others = json::root(object)?.pairs().filter(|(other, _)| other.trim_matches('"') != name);
    let fields: Vec<String> = others.map(|(name, value)| format!("{name}:{value}")).chain([format!("\"{name}\":{value}")]).collect();
    Ok(format!("{{{}}}", fields.join(",")).into_bytes())
}

/// An object without some of its fields.
/// Errors: A text that is not a JSON object.
pub(crate) fn without(object: &[u8], names: &[&str]) -> Result<Vec<u8>, Problem> {
    let root = json::root(object)?;
    let kept = root.pairs().filter(|(name, _)| !names.contains(&name.trim_matches('"')));
    let fields: Vec<String> = kept.map(|(name, value)| format!("{name}:{value}")).collect();
    Ok(format!("{{{}}}", fields.join(",")).into_bytes())
}

/// Splits an object with the fields of both into the warp object of a session and the body of a batch. `q` and `strength` go into both.
/// Errors: Not a JSON object.
pub(crate) fn split_batch(object: &[u8]) -> Result<[Vec<u8>; 2], Problem> {
    let root = json::root(object)?;
    let name = |pair: &(&str, &str)| pair.0.trim_matches('"').to_owned();
    let is_posed = |name: &str| ["q", "strength"].contains(&name);
    let is_of_session = |name: &str| fields::WARP.contains(&name) && name != "output";
    let text = |belongs: &dyn Fn(&str) -> bool| {
        let fields: Vec<String> = root.pairs().filter(|pair| belongs(&name(pair))).map(|(name, value)| format!("{name}:{value}")).collect();
        format!("{{{}}}", fields.join(",")).into_bytes()
    };
    Ok([text(&is_of_session), text(&|name| !is_of_session(name) || is_posed(name))])
}

/// The field `extent` of an object.
/// Errors: Not a size.
pub(crate) fn extent_in(object: &[u8]) -> Result<Option<Extent>, Problem> {
    let root = json::root(object)?;
    let [extent] = root.find(&["extent"])?;
    optional(extent, size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_all_objects_stay_as_they_are_written() {
        let merged = |objects: &[&str]| merged(&objects.iter().map(|text| text.as_bytes()).collect::<Vec<_>>());
        let text = |objects: &[&str]| String::from_utf8(merged(objects).unwrap()).unwrap();
        assert_eq!(text(&[]), "{}");
        assert_eq!(text(&["{}", " { } \n"]), "{}");
        assert_eq!(text(&["{\"a\": {\"b\": {}}}", "{}", "{\"c\": 1e0 , \"d\": {}}"]), "{\"a\": {\"b\": {}},\"c\": 1e0 , \"d\": {}}");
        assert!(merged(&["[]"]).is_err() && merged(&["{}", "{"]).is_err() && merged(&["{} {}"]).is_err());
        assert_eq!(extent_in(b"{\"extent\": [4, 3]}").unwrap(), Extent::new(4, 3));
        assert_eq!(extent_in(b"{\"extent\": null, \"p\": []}").unwrap(), None);
        assert!(extent_in(b"{\"extent\": [4]}").is_err());
        let field = |object: &str| String::from_utf8(with_field(object.as_bytes(), "align", "\"affine\"").unwrap()).unwrap();
        assert_eq!(field("{}"), r#"{"align":"affine"}"#);
        assert_eq!(field(r#"{"align": "none", "p": [[1, 2]]}"#), r#"{"p":[[1, 2]],"align":"affine"}"#);
        assert!(with_field(b"[]", "align", "1").is_err());
        let split = split_batch(br#"{"p": [[1, 2]], "steps": 2, "q": [[3, 4]], "output": {}, "other": "}"}"#).unwrap();
        let [session, batch] = split.map(|text| String::from_utf8(text).unwrap());
        assert_eq!(session, r#"{"p":[[1, 2]],"q":[[3, 4]]}"#);
        assert_eq!(batch, r#"{"steps":2,"q":[[3, 4]],"output":{},"other":"}"}"#);
    }
}
