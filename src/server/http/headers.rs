//! Request headers and queries as values.

use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderName};

use crate::problem::words::{advice, list, nearest, quote};
use crate::problem::{Code, Problem};

/// The fields of a query, each with its value; without `=` the value is empty.
pub(crate) fn query_fields(query: Option<&str>) -> impl Iterator<Item = (&str, &str)> {
    let pairs = query.unwrap_or_default().split('&').filter(|pair| !pair.is_empty());
    pairs.map(|pair| pair.split_once('=').unwrap_or((pair, "")))
}

/// The problem of a field that a query does not have.
pub(crate) fn unknown_query_field(name: &str, known: &[&str]) -> Problem {
    let hint = nearest(name, known.iter().copied()).map(|meant| format!("did you mean `{meant}`?"));
    let advice = advice(hint, &format!("known fields: {}", list(known)));
    Problem::new(Code::UnknownField, format!("unknown field in the query: {}{advice}", quote(name)))
}

/// The problem of a value that a field of a query does not have.
pub(crate) fn bad_query_value(name: &str, value: &str, expected: &str) -> Problem {
    Problem::new(Code::BadValue, format!("`{name}` in the query must be {expected}; found {}", quote(value)))
}

/// The elements of a list header (RFC 9110, section 5.6.1), of all its fields.
pub(crate) fn elements(headers: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    let fields = headers.get_all(name).into_iter().filter_map(|field| field.to_str().ok());
    fields.flat_map(|field| field.split(',')).map(str::trim).filter(|element| !element.is_empty())
}

/// The length that a request declares for its body.
pub(crate) fn content_length(headers: &HeaderMap) -> Option<u64> {
    headers.get(CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// The media type of the body in lower case, without parameters.
pub(crate) fn media_type(headers: &HeaderMap) -> Option<String> {
    let text = headers.get(CONTENT_TYPE)?.to_str().ok()?;
    Some(text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}
