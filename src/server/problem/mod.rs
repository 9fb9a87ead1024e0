//! Problem documents (RFC 9457): what a client is told when something is wrong. A [`Problem`] knows no HTTP but the status of its
//! [`Code`]; every error of the layers below becomes one in a single exhaustive conversion (`from.rs`).
//! JSON pointers (RFC 6901) point into the JSON of the request: the body, or the part `warp` of a multipart body.

mod code;
mod from;

use std::fmt;

use serde_json::{Map, Value};

pub use code::Code;

/// What went wrong, for the client: HTTP-agnostic but for the status that its code has.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// The code.
    pub code: Code,
    /// One sentence for people: what was wrong and where; a value after a colon.
    pub detail: String,
    /// JSON pointer into the request.
    pub pointer: Option<String>,
    /// Index of the handle.
    pub handle: Option<usize>,
    /// Which limit.
    pub what: Option<&'static str>,
    /// The limit.
    pub limit: Option<Value>,
    /// What was asked for.
    pub actual: Option<Value>,
    /// Seconds after which a retry makes sense.
    pub retry_after: Option<u32>,
}

impl Problem {
    /// The media type of a problem document.
    pub const MEDIA_TYPE: &'static str = "application/problem+json";

    /// A problem without a place.
    #[must_use]
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        Self { code, detail: detail.into(), pointer: None, handle: None, what: None, limit: None, actual: None, retry_after: None }
    }

    /// Where in the request's JSON.
    #[must_use]
    pub fn pointer(mut self, pointer: impl Into<String>) -> Self {
        self.pointer = Some(pointer.into());
        self
    }

    /// Which handle.
    #[must_use]
    pub const fn handle(mut self, index: usize) -> Self {
        self.handle = Some(index);
        self
    }

    /// Which limit, its value, and what was asked for.
    #[must_use]
    pub fn limit(mut self, what: &'static str, limit: impl Into<Value>, actual: impl Into<Value>) -> Self {
        self.what = Some(what);
        self.limit = Some(limit.into());
        self.actual(actual)
    }

    /// What was asked for, or found.
    #[must_use]
    pub fn actual(mut self, actual: impl Into<Value>) -> Self {
        self.actual = Some(actual.into());
        self
    }

    /// Seconds after which a retry makes sense.
    #[must_use]
    pub const fn retry_after(mut self, seconds: u32) -> Self {
        self.retry_after = Some(seconds);
        self
    }

    /// The HTTP status.
    #[must_use]
    pub const fn status(&self) -> u16 {
        self.code.status()
    }

    /// The document, with the request's id where there is one.
    #[must_use]
    pub fn to_json(&self, request_id: Option<&str>) -> Value {
        let mut document = Map::new();
        let mut put = |name: &str, value: Value| {
            document.insert(name.to_owned(), value);
        };
        put("type", self.code.type_uri().into());
        put("title", self.code.title().into());
        put("status", self.status().into());
        put("detail", self.detail.as_str().into());
        put("code", self.code.as_str().into());
        let fields = [
            ("pointer", self.pointer.as_deref().map(Value::from)),
            ("handle", self.handle.map(Value::from)),
            ("limit_name", self.what.map(Value::from)),
            ("limit", self.limit.clone()),
            ("actual", self.actual.clone()),
            ("retry_after", self.retry_after.map(Value::from)),
            ("request_id", request_id.map(Value::from)),
        ];
        for (name, value) in fields {
            if let Some(value) = value {
                put(name, value);
            }
        }
        Value::Object(document)
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
            Problem::new(Code::NoSuchSession, "no such session: abc").to_json(None),
            json!({"type": "/problems/no_such_session", "title": "No such session", "status": 404,
                   "detail": "no such session: abc", "code": "no_such_session"})
        );
    }

    #[test]
    fn document_names_place_limit_and_request() {
        let problem = Problem::new(Code::TooLarge, "too much").pointer("/p").handle(3).limit("handle_columns", 10, 11).retry_after(2);
        assert_eq!(
            problem.to_json(Some("r-1")),
            json!({"type": "/problems/too_large", "title": "Too large", "status": 413, "detail": "too much", "code": "too_large",
                   "pointer": "/p", "handle": 3, "limit_name": "handle_columns", "limit": 10, "actual": 11, "retry_after": 2,
                   "request_id": "r-1"})
        );
    }
}
