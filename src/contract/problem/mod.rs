//! Problem documents (RFC 9457): the errors that clients see.
//!
//! A [`Problem`] contains no HTTP except the status of its [`Code`]. `from.rs` converts every error
//! of the engine. JSON pointers (RFC 6901) point into the JSON of the request: the body, or the
//! part `warp` of a multipart body.

mod code;
mod from;
mod sentences;
pub mod words;

use std::fmt;

use serde_json::Value;

pub use code::Code;

/// An error for the client.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// The code.
    pub code: Code,
    /// One sentence for people: what is wrong and where; a value after a colon.
    pub detail: String,
    /// JSON pointer into the request.
    pub pointer: Option<String>,
    /// Index of the handle.
    pub handle: Option<usize>,
    /// Name of the limit.
    pub what: Option<&'static str>,
    /// Value of the limit.
    pub limit: Option<Value>,
    /// The value that was requested or found.
    pub actual: Option<Value>,
    /// Seconds after which the request may be repeated.
    pub retry_after: Option<u32>,
    /// Members that only one code has: their names and values.
    pub extra: Vec<(&'static str, Value)>,
}

impl Problem {
    /// The media type of a problem document.
    pub const MEDIA_TYPE: &'static str = "application/problem+json";

    /// A problem with a code and a sentence.
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        Self {
            code,
            detail: detail.into(),
            pointer: None,
            handle: None,
            what: None,
            limit: None,
            actual: None,
            retry_after: None,
            extra: Vec::new(),
        }
    }

    /// With the JSON pointer to the place.
    pub fn pointer(mut self, pointer: impl Into<String>) -> Self {
        self.pointer = Some(pointer.into());
        self
    }

    /// With the index of the handle.
    pub const fn handle(mut self, index: usize) -> Self {
        self.handle = Some(index);
        self
    }

    /// With the name and value of the limit that `actual` exceeds.
    pub fn limit(
        mut self,
        what: &'static str,
        limit: impl Into<Value>,
        actual: impl Into<Value>,
    ) -> Self {
        self.what = Some(what);
        self.limit = Some(limit.into());
        self.actual(actual)
    }

    /// With the value that was requested or found.
    pub fn actual(mut self, actual: impl Into<Value>) -> Self {
        self.actual = Some(actual.into());
        self
    }

    /// With the number of seconds after which the request may be repeated.
    pub const fn retry_after(mut self, seconds: u32) -> Self {
        self.retry_after = Some(seconds);
        self
    }

    /// With a member that only this code has.
    pub fn extra(mut self, name: &'static str, value: impl Into<Value>) -> Self {
        self.extra.push((name, value.into()));
        self
    }

    /// The HTTP status.
    pub const fn status(&self) -> u16 {
        self.code.status()
    }

    /// The document; with the id of the request if there is one. `public_path` precedes the path of
    /// the problem type.
    pub fn to_json(&self, public_path: &str, request_id: Option<&str>) -> Value {
        let fields = [
            (
                "type",
                Some(format!("{public_path}{}", self.code.type_uri()).into()),
            ),
            ("title", Some(self.code.title().into())),
            ("status", Some(self.status().into())),
            ("detail", Some(self.detail.as_str().into())),
            ("code", Some(self.code.as_str().into())),
            ("pointer", self.pointer.as_deref().map(Value::from)),
            ("handle", self.handle.map(Value::from)),
            ("limit_name", self.what.map(Value::from)),
            ("limit", self.limit.clone()),
            ("actual", self.actual.clone()),
            ("retry_after", self.retry_after.map(Value::from)),
            ("request_id", request_id.map(Value::from)),
        ];
        let extra = self
            .extra
            .iter()
            .map(|(name, value)| (*name, Some(value.clone())));
        fields
            .into_iter()
            .chain(extra)
            .filter_map(|(name, value)| Some((name, value?)))
            .collect()
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.pointer {
            Some(pointer) => write!(f, "{} at {pointer}: {}", self.code.as_str(), self.detail),
            None => write!(f, "{}: {}", self.code.as_str(), self.detail),
        }
    }
}

impl std::error::Error for Problem {}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn document_has_only_the_fields_that_apply() {
        assert_eq!(
            Problem::new(Code::NoSuchSession, "no such session: abc").to_json("", None),
            json!({"type": "/problems/no_such_session", "title": "No such session", "status": 404,
                   "detail": "no such session: abc", "code": "no_such_session"})
        );
    }

    #[test]
    fn document_names_place_limit_and_request() {
        let problem = Problem::new(Code::TooLarge, "too much")
            .pointer("/p")
            .handle(3)
            .limit("handle_columns", 10, 11)
            .retry_after(2);
        assert_eq!(
            problem.to_json("/tools/warp", Some("r-1")),
            json!({"type": "/tools/warp/problems/too_large", "title": "Too \
                large", "status": 413, "detail": "too much", "code": "too_large",
                   "pointer": "/p", "handle": 3, "limit_name": "handle_columns", "limit": 10,
                       "actual": 11, "retry_after": 2,
                   "request_id": "r-1"})
        );
    }
}
