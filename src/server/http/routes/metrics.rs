//! `GET /metrics`, which never waits in the queue.

use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse as _, Response};

use crate::app::App;

/// All metrics as OpenMetrics text.
pub(crate) async fn text(State(app): State<App>) -> Response {
    let headers = [(CONTENT_TYPE, "application/openmetrics-text; version=1.0.0; charset=utf-8"), (CACHE_CONTROL, "no-store")];
    (headers, app.metrics_text()).into_response()
}
