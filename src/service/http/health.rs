//! `/healthz` and `/readyz`: alive, and able to take work now. Neither stands behind the queue.

use axum::extract::State;
use axum::response::Response;
use serde_json::json;

use super::answer;
use crate::service::App;
use crate::service::problem::Problem;

/// The process answers.
pub(super) async fn alive() -> Response {
    answer::json(&json!({"status": "alive", "version": env!("CARGO_PKG_VERSION")}))
}

/// Work that arrives now would be admitted; 503 while the queue is full, while the store is away and while the service stops.
pub(super) async fn ready(State(app): State<App>) -> Result<Response, Problem> {
    app.ready().await?;
    Ok(answer::json(&json!({"status": "ready"})))
}
