//! `GET /docs` in a build without the feature `docs`: 404.

use axum::Router;
use axum::extract::State;

use crate::app::App;
use crate::http::response::Refusal;
use crate::problem::{Code, Problem};

pub(crate) async fn page(State(app): State<App>) -> Refusal {
    let public = &app.config().public_path;
    let detail = format!(
        "this build has no documentation page (feature `docs`); the contract is at \
            {public}/openapi.json"
    );
    Problem::new(Code::NotFound, detail).into()
}

pub(crate) fn files() -> Router<App> {
    Router::new()
}
