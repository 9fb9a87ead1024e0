//! Health, metrics and the OpenAPI document. None of them waits for the queue.

use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use serde_json::json;

use crate::app::{App, Ready};
use crate::http::response;
use crate::problem::Problem;

const OPENAPI: &str = include_str!("../../../../api/openapi.json");

/// `GET /healthz`: the process is alive.
pub(crate) async fn healthz() -> Response {
    response::json(&json!({"status": "alive", "version": env!("CARGO_PKG_VERSION")}))
}

/// `GET /readyz`: work would be admitted now. 503 while the queue is full, until the store has been reachable, and while the server stops.
pub(crate) async fn readyz(State(app): State<App>) -> Result<Response, Problem> {
    let store = match app.ready().await? {
        Ready::Whole => "there",
        Ready::WithoutStore => "away",
    };
    Ok(response::json(&json!({"status": "ready", "store": store})))
}

/// `GET /metrics`.
pub(crate) async fn metrics(State(app): State<App>) -> impl IntoResponse {
    let headers = [(CONTENT_TYPE, "application/openmetrics-text; version=1.0.0; charset=utf-8"), (CACHE_CONTROL, "no-store")];
    (headers, app.metrics_text())
}

/// `GET /openapi.json`.
pub(crate) async fn openapi() -> impl IntoResponse {
    ([(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-cache")], OPENAPI)
}
