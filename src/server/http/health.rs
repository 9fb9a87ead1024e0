//! `/healthz` and `/readyz`: alive, and able to take work now. Neither stands behind the queue.

use axum::extract::State;
use axum::response::Response;
use serde_json::json;

use super::answer;
use crate::problem::Problem;
use crate::{App, Ready};

/// The process answers.
pub(super) async fn alive() -> Response {
    answer::json(&json!({"status": "alive", "version": env!("CARGO_PKG_VERSION")}))
}

/// Work that arrives now would be admitted; 503 while the queue is full, before the store was ever there, and while the service stops.
pub(super) async fn ready(State(app): State<App>) -> Result<Response, Problem> {
    let store = match app.ready().await? {
        Ready::Whole => "there",
        Ready::WithoutStore => "away",
    };
    Ok(answer::json(&json!({"status": "ready", "store": store})))
}
