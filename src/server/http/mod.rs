//! HTTP: routes, and the layers around them. Every answer that is not a success is a problem document, whoever refused
//! (also of heads that are none: `server/heads.rs`; of HTTP/2 only those that have become requests).
//!
//! From the outside in: `fence` (request id, body limits and deadline, panics, the request's own deadline, problem documents, what browsers are
//! told, one log line a request), then `keyed` on every route that is not open (key, rate, whose sessions are meant), then `shed` on the routes
//! that upload (a full queue answers before a body is read), then the handlers.

mod accept;
pub(crate) mod assets;
mod body;
pub mod connection;
pub(crate) mod middleware;
pub(crate) mod response;
mod routes;
mod socket;
mod upload;

use axum::extract::{Request, State};
use axum::http::{Method, Uri};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::Response;
use axum::routing::{MethodRouter, any, get, post, put};
use axum::{Extension, Router};

use middleware::Fence;
pub use middleware::keyed::Access;

use crate::app::App;
use crate::client::Client;
use crate::problem::{Code, Problem};

/// Every route of the contract and who may use it; the OpenAPI document lists the same (tested). The page's files are not of it, and open.
fn routes(app: &App) -> Vec<(&'static str, Access, MethodRouter<App>)> {
    use Access::{Keyed, Open};
    let scraped = if app.config().auth.open_metrics { Open } else { Keyed };
    let uploads = |route: MethodRouter<App>| route.layer(from_fn_with_state(app.clone(), shed));
    vec![
        ("/warp", Keyed, post(routes::warp::warp)),
        ("/sessions", Keyed, uploads(post(routes::sessions::create))),
        ("/sessions/{id}", Keyed, get(routes::sessions::read).delete(routes::sessions::delete).merge(uploads(put(routes::sessions::put)))),
        ("/sessions/{id}/handles", Keyed, uploads(put(routes::sessions::handles))),
        ("/sessions/{id}/warp", Keyed, post(routes::warp::drag)),
        ("/sessions/{id}/mesh", Keyed, post(routes::mesh::mesh)),
        ("/sessions/{id}/drag", Keyed, any(socket::drag)),
        ("/sessions/{id}/points", Keyed, uploads(post(routes::points::of_session))),
        ("/points", Keyed, uploads(post(routes::points::once))),
        ("/healthz", Open, get(routes::health::alive)),
        ("/readyz", Open, get(routes::health::ready)),
        ("/metrics", scraped, get(routes::metrics::text)),
        ("/openapi.json", Open, get(routes::openapi::document)),
        ("/docs", Open, get(routes::docs::page)),
        ("/problems/{code}", Open, get(routes::problems::section)),
    ]
}

/// The paths of the contract and who may use them.
#[must_use]
pub fn paths(app: &App) -> Vec<(&'static str, Access)> {
    routes(app).into_iter().map(|(path, access, _)| (path, access)).collect()
}

/// The service.
pub fn router(app: App) -> Router {
    routes(&app)
        .into_iter()
        .map(|(path, access, route)| match access {
            Access::Open => (path, route),
            Access::Keyed => (path, route.layer(from_fn_with_state(app.clone(), middleware::keyed::keyed))),
        })
        .fold(assets::routes(&app).merge(routes::docs::files()), |router, (path, route)| router.route(path, route))
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .layer(from_fn_with_state(Fence::of_service(&app), middleware::fence))
        .with_state(app)
}

/// What those who watch the service may ask on a listener of their own, without a key.
fn watched(app: App) -> Router {
    Router::new()
        .route("/healthz", get(routes::health::alive))
        .route("/readyz", get(routes::health::ready))
        .route("/metrics", get(routes::metrics::text))
        .fallback(no_such_route)
        .method_not_allowed_fallback(no_such_method)
        .layer(from_fn_with_state(Fence::of_watchers(&app), middleware::fence))
        .with_state(app)
}

/// Refuses an upload at once, before its body is read, when there is no place for it. A drag is small; the queue itself decides about it.
async fn shed(State(app): State<App>, Extension(client): Extension<Client>, request: Request, next: Next) -> Result<Response, Problem> {
    app.require_queue_place(client)?;
    Ok(next.run(request).await)
}

async fn no_such_route(uri: Uri) -> Problem {
    Problem::new(Code::NotFound, format!("nothing is served at {}", uri.path()))
}

/// axum adds `Allow`.
async fn no_such_method(method: Method, uri: Uri) -> Problem {
    Problem::new(Code::MethodNotAllowed, format!("{method} is not served at {}; see Allow", uri.path()))
}
