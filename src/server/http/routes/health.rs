//! `/healthz` and `/readyz`: alive, and able to take work now. Neither stands behind the queue.

use axum::extract::State;
use axum::response::Response;
use serde_json::json;

use crate::app::{App, Ready};
use crate::http::response;
use crate::problem::Problem;

/// The process answers.
pub(crate) async fn alive() -> Response {
    response::json(&json!({"status": "alive", "version": env!("CARGO_PKG_VERSION")}))
}

/// Work that arrives now would be admitted; 503 while the queue is full, before the store was ever there, and while the service stops.
pub(crate) async fn ready(State(app): State<App>) -> Result<Response, Problem> {
    let store = match app.ready().await? {
        Ready::Whole => "there",
        Ready::WithoutStore => "away",
    };
    Ok(response::json(&json!({"status": "ready", "store": store})))
}
