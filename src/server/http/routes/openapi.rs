//! `GET /openapi.json`: the contract as it is kept in the repository.

use axum::http::HeaderValue;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse as _, Response};

/// Compiled in: the document is that of the build.
const DOCUMENT: &str = include_str!("../../../../api/openapi.json");

pub(crate) async fn document() -> Response {
    let headers = [(CONTENT_TYPE, HeaderValue::from_static("application/json")), (CACHE_CONTROL, HeaderValue::from_static("no-cache"))];
    (headers, DOCUMENT).into_response()
}
