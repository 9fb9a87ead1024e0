//! Problem documents as responses. A problem travels in the response's extensions until [`finish`] writes the document.

use axum::http::header::{ALLOW, CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, RETRY_AFTER};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};

use crate::http::headers::elements;
use crate::problem::words::series;
use crate::problem::{Code, Problem};

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = StatusCode::from_u16(self.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR).into_response();
        response.extensions_mut().insert(self);
        response
    }
}

/// Writes the problem document of a response that is not a success. Errors without a problem, such as axum's, get the one of their status.
pub(crate) fn finish(response: Response, public_path: &str, request_id: &str) -> Response {
    let status = response.status();
    if !status.is_client_error() && !status.is_server_error() {
        return response;
    }
    let (mut head, _) = response.into_parts();
    let mut problem = head.extensions.remove::<Problem>().unwrap_or_else(|| of_status(status));
    if problem.code == Code::MethodNotAllowed {
        problem.detail.push_str(&methods(&head.headers));
    }
    if let Some(seconds) = problem.retry_after {
        head.headers.insert(RETRY_AFTER, seconds.into());
    }
    head.status = StatusCode::from_u16(problem.status()).unwrap_or(status);
    head.headers.remove(CONTENT_LENGTH);
    head.headers.insert(CONTENT_TYPE, HeaderValue::from_static(Problem::MEDIA_TYPE));
    head.headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Response::from_parts(head, problem.to_json(public_path, Some(request_id)).to_string().into())
}

/// The methods of `Allow` as advice. `HEAD` is left out: whoever wants it knows that it goes with `GET`.
fn methods(headers: &HeaderMap) -> String {
    let methods: Vec<&str> = elements(headers, ALLOW).filter(|method| *method != "HEAD").collect();
    if methods.is_empty() { String::new() } else { format!("; use {}", series(&methods, "or")) }
}

/// axum rejects a request by itself only when an extractor fails: the router's fallbacks have problems of their own.
fn of_status(status: StatusCode) -> Problem {
    let code = if status.is_client_error() { Code::MalformedRequest } else { Code::Internal };
    Problem::new(code, status.canonical_reason().unwrap_or("refused"))
}
