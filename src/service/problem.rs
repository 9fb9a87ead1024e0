//! STUB: problem documents (RFC 9457).

use serde_json::Value;

/// A stable error code; its status and title stand in one table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Code {
    /// 400.
    MalformedRequest,
    /// 500.
    Internal,
}

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
