//! HTTP: routes, and the layers around them. Every answer that is not a success is a problem document, whoever refused
//! (but for heads that are no HTTP: hyper answers those, with an empty body).
//!
//! From the outside in: `fence` (request id, body limits and deadline, panics, the request's own deadline, problem documents, one log
//! line a request), then `shed` on the routes that upload (a full queue answers before a body is read), then the handlers.

mod accept;
mod answer;
mod body;
mod fence;
mod handshake;
mod health;
mod line;
mod mesh;
mod metrics;
mod openapi;
mod page;
mod points;
mod refuse;
pub mod server;
mod sessions;
mod socket;
mod upload;
mod warp;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{Method, Uri};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::Response;
use axum::routing::{MethodRouter, get, post, put};

use super::App;
use super::pool::Work;
use super::problem::{Code, Problem};

/// Every route of the contract; the OpenAPI document lists the same (tested). The page's files are not of it.
fn routes(app: &App) -> Vec<(&'static str, MethodRouter<App>)> {
    let uploads = |route: MethodRouter<App>| route.layer(from_fn_with_state(app.clone(), shed));
    vec![
        ("/warp", post(warp::warp)),
        ("/sessions", uploads(post(sessions::create))),
        ("/sessions/{id}", get(sessions::read).delete(sessions::delete).merge(uploads(put(sessions::put)))),
        ("/sessions/{id}/handles", uploads(put(sessions::handles))),
        ("/sessions/{id}/warp", post(warp::drag)),
        ("/sessions/{id}/mesh", post(mesh::mesh)),
        ("/sessions/{id}/drag", get(socket::drag)),
        ("/sessions/{id}/points", uploads(post(points::of_session))),
        ("/points", uploads(post(points::once))),
        ("/healthz", get(health::alive)),
        ("/readyz", get(health::ready)),
        ("/metrics", get(metrics::text)),
        ("/openapi.json", get(openapi::document)),
    ]
}

/// The paths of the contract.
#[must_use]
pub fn paths(app: &App) -> Vec<&'static str> {
    routes(app).into_iter().map(|(path, _)| path).collect()
}

/// The service.
pub fn router(app: App) -> Router {
    routes(&app)
        .into_iter()
        .fold(page::routes(&app), |router, (path, route)| router.route(path, route))
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .layer(from_fn_with_state(app.clone(), fence::fence))
        .with_state(app)
}

/// Refuses an upload at once, before its body is read, when there is no place for it. A drag is small; the queue itself decides about it.
async fn shed(State(app): State<App>, request: Request, next: Next) -> Result<Response, Problem> {
    app.admits(Work::Upload)?;
    Ok(next.run(request).await)
}

async fn no_such_route(uri: Uri) -> Problem {
    Problem::new(Code::NotFound, format!("nothing is served at {}", uri.path()))
}

/// axum adds `Allow`.
async fn no_such_method(method: Method, uri: Uri) -> Problem {
    Problem::new(Code::MethodNotAllowed, format!("{method} is not served at {}; see Allow", uri.path()))
}
