//! Problem documents as responses. A problem travels in the response's extensions until [`finish`]
//! writes the document.

use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, RETRY_AFTER};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};

use crate::problem::{Code, Problem};

/// A problem as the error of a handler, of which axum makes a response.
#[derive(Debug)]
pub(crate) struct Refusal(pub(crate) Problem);

impl<E> From<E> for Refusal
where
    Problem: From<E>,
{
    fn from(error: E) -> Self {
        Self(error.into())
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let Self(problem) = self;
        let mut response = StatusCode::from_u16(problem.status())
            .unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
            .into_response();
        response.extensions_mut().insert(problem);
        response
    }
}

/// Writes the problem document of a response that is not a success. Errors without a problem, such
/// as axum's, get the one of their status.
pub(crate) fn finish(response: Response, public_path: &str, request_id: &str) -> Response {
    let status = response.status();
    if !status.is_client_error() && !status.is_server_error() {
        return response;
    }
    let (mut head, _) = response.into_parts();
    let problem = head
        .extensions
        .remove::<Problem>()
        .unwrap_or_else(|| of_status(status));
    if let Some(seconds) = problem.retry_after {
        head.headers.insert(RETRY_AFTER, seconds.into());
    }
    head.status = StatusCode::from_u16(problem.status()).unwrap_or(status);
    head.headers.remove(CONTENT_LENGTH);
    head.headers
        .insert(CONTENT_TYPE, HeaderValue::from_static(Problem::MEDIA_TYPE));
    head.headers
        .insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Response::from_parts(
        head,
        problem
            .to_json(public_path, Some(request_id))
            .to_string()
            .into(),
    )
}

/// axum rejects a request by itself only when an extractor fails: the router's fallbacks have
/// problems of their own.
fn of_status(status: StatusCode) -> Problem {
    let code = if status.is_client_error() {
        Code::MalformedRequest
    } else {
        Code::Internal
    };
    Problem::new(code, status.canonical_reason().unwrap_or("refused"))
}
