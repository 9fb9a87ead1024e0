//! Health, metrics and the OpenAPI document. None of them waits for the queue.

use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use serde_json::json;

use crate::app::service::{Readiness, ready};
use crate::app::{App, metrics_text};
use crate::http::assets::Asset;
use crate::http::response;
use crate::http::response::Refusal;
use crate::pool::aside;

pub(super) const OPENAPI: &str = include_str!("../../../../api/openapi.json");
/// The address of the service in the document.
const SERVERS: &str = r#""servers": [{"url": "/"}]"#;

/// `GET /healthz`: the process is alive.
pub(crate) async fn healthz() -> Response {
    response::json(&json!({"status": "alive", "version": env!("CARGO_PKG_VERSION")}))
}

/// `GET /readyz`: work would be admitted now. 503 while the queue is full, until the store has been
/// reachable, and while the server stops.
pub(crate) async fn readyz(State(app): State<App>) -> Result<Response, Refusal> {
    let store = match ready(&app).await? {
        Readiness::Whole => "available",
        Readiness::WithoutStore => "unavailable",
    };
    Ok(response::json(&json!({"status": "ready", "store": store})))
}

/// `GET /metrics`.
pub(crate) async fn metrics(State(app): State<App>) -> impl IntoResponse {
    let headers = [
        (
            CONTENT_TYPE,
            "application/openmetrics-text; version=1.0.0; charset=utf-8",
        ),
        (CACHE_CONTROL, "no-store"),
    ];
    // Reads a file of the system, and writes some hundred lines.
    (headers, aside(true, move || metrics_text::text(&app)).await)
}

/// The answer of `GET /openapi.json`, with the public path as the address of the service.
pub(crate) fn openapi(public_path: &str) -> Asset {
    let document = match public_path {
        "" => Bytes::from_static(OPENAPI.as_bytes()),
        path => OPENAPI
            .replacen(SERVERS, &SERVERS.replace('/', path), 1)
            .into(),
    };
    Asset::new("application/json", document)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_has_one_address_of_the_service() {
        assert_eq!(OPENAPI.matches(SERVERS).count(), 1);
        assert_eq!(OPENAPI.matches("\"servers\"").count(), 1);
    }
}
