//! Request headers and queries as values.

use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE, IF_NONE_MATCH};
use axum::http::{HeaderMap, HeaderName};

use crate::problem::words::{advice, list, nearest, quote};
use crate::problem::{Code, Problem};
use crate::wire::fields;

/// The values of the `known` fields of a query, in that order; without `=` a value is empty.
/// Errors: 422 of another field, 400 of a field that is given twice.
pub(crate) fn query_fields<'q, const N: usize>(
    query: Option<&'q str>,
    known: [&str; N],
) -> Result<[Option<&'q str>; N], Problem> {
    let mut values = [None; N];
    for pair in query
        .unwrap_or_default()
        .split('&')
        .filter(|pair| !pair.is_empty())
    {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        let index = known
            .iter()
            .position(|known| *known == name)
            .ok_or_else(|| unknown_query_field(name, &known))?;
        if values[index].replace(value).is_some() {
            return Err(Problem::new(
                Code::MalformedRequest,
                format!("the field `{name}` is given twice in the query"),
            ));
        }
    }
    Ok(values)
}

fn unknown_query_field(name: &str, known: &[&str]) -> Problem {
    if fields::is_unsupported(name, known) {
        return fields::unsupported(name, known);
    }
    let hint = nearest(name, known.iter().copied()).map(|meant| format!("did you mean `{meant}`?"));
    let known = if known.is_empty() {
        "this route has none".to_owned()
    } else {
        format!("known fields: {}", list(known))
    };
    Problem::new(
        Code::UnknownField,
        format!(
            "unknown field in the query: {}{}",
            quote(name),
            advice(hint, &known)
        ),
    )
}

/// Reads `true` or `false`.
pub(crate) fn query_bool(name: &str, value: &str) -> Result<bool, Problem> {
    match value {
        "true" => Ok(true),
        "false" => Ok(false),
        _ => Err(bad_query_value(name, value, "`true` or `false`")),
    }
}

/// The problem of a value that a field of a query does not have.
pub(crate) fn bad_query_value(name: &str, value: &str, expected: &str) -> Problem {
    Problem::new(
        Code::BadValue,
        format!(
            "`{name}` in the query must be {expected}; found {}",
            quote(value)
        ),
    )
}

/// The elements of a list header (RFC 9110, section 5.6.1), of all its fields.
pub(crate) fn elements(headers: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    let fields = headers
        .get_all(name)
        .into_iter()
        .filter_map(|field| field.to_str().ok());
    fields
        .flat_map(|field| field.split(','))
        .map(str::trim)
        .filter(|element| !element.is_empty())
}

/// Whether the client has the response of this entity tag. Tags are compared weakly (RFC 9110,
/// section 13.1.2).
pub(crate) fn sends_tag(headers: &HeaderMap, tag: &str) -> bool {
    elements(headers, IF_NONE_MATCH)
        .any(|known| known == "*" || known.strip_prefix("W/").unwrap_or(known) == tag)
}

/// The length that a request declares for its body.
pub(crate) fn content_length(headers: &HeaderMap) -> Option<u64> {
    headers.get(CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// The media type of the body in lower case, without parameters.
pub(crate) fn media_type(headers: &HeaderMap) -> Option<String> {
    let text = headers.get(CONTENT_TYPE)?.to_str().ok()?;
    Some(
        text.split(';')
            .next()
            .unwrap_or_default()
            .trim()
            .to_ascii_lowercase(),
    )
}
