//! `GET /docs` in a build without the feature `docs`: 404.

use axum::Router;

use crate::app::App;
use crate::problem::{Code, Problem};

pub(crate) async fn page() -> Problem {
    Problem::new(Code::NotFound, "this build has no documentation page (feature `docs`); the contract is at /openapi.json")
}

pub(crate) fn files() -> Router<App> {
    Router::new()
}
