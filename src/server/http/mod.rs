//! HTTP: the routers and their middleware. Every error is a problem document, except for request
//! heads that hyper itself rejects.
//!
//! A request passes `middleware` (all routes), `authenticate` (routes that need a key),
//! `reject_if_queue_full` (uploads, before their body is read), and its handler.

mod accept;
pub(crate) mod assets;
mod body;
mod capped_body;
pub mod connection;
mod headers;
pub(crate) mod middleware;
pub(crate) mod response;
mod routes;
mod socket;
mod upload;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, Uri};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::Response;
use axum::routing::{MethodRouter, any, get, post, put};

pub use middleware::authentication::Access;
use middleware::authentication::{Caller, authenticate};
pub use middleware::token_routes::rows as token_routes;

use crate::app::App;
use crate::http::response::Refusal;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};

const LAYER: &str = "/sessions/{id}/layers/{name}";

/// The routes of the contract and who may use them; a test compares them with the OpenAPI document.
/// The page's files are not among them.
fn routes(app: &App) -> Vec<(&'static str, Access, MethodRouter<App>)> {
    use Access::{Keyed, Open};
    let metrics_access = if app.config().auth.open_metrics {
        Open
    } else {
        Keyed
    };
    let openapi = routes::service::openapi(&app.config().public_path);
    let uploads = |route: MethodRouter<App>| {
        route.layer(from_fn_with_state(app.clone(), reject_if_queue_full))
    };
    vec![
        ("/warp", Keyed, uploads(post(routes::warp::warp))),
        ("/sessions", Keyed, uploads(post(routes::sessions::create))),
        (
            "/sessions/{id}",
            Keyed,
            get(routes::sessions::read)
                .delete(routes::sessions::delete)
                .merge(uploads(put(routes::sessions::put))),
        ),
        (
            "/sessions/{id}/handles",
            Keyed,
            uploads(put(routes::sessions::handles)),
        ),
        (
            LAYER,
            Keyed,
            get(routes::layers::read)
                .delete(routes::layers::delete)
                .merge(uploads(put(routes::layers::put))),
        ),
        (
            "/sessions/{id}/warp",
            Keyed,
            post(routes::warp::session_warp),
        ),
        ("/sessions/{id}/mesh", Keyed, post(routes::mesh::mesh)),
        ("/sessions/{id}/plan", Keyed, get(routes::plan::plan)),
        ("/sessions/{id}/drag", Keyed, any(socket::drag_socket)),
        ("/sessions/{id}/tokens", Keyed, post(routes::tokens::mint)),
        (
            "/sessions/{id}/batch",
            Keyed,
            uploads(post(routes::batch::batch)),
        ),
        (
            "/sessions/{id}/points",
            Keyed,
            uploads(post(routes::points::of_session)),
        ),
        ("/points", Keyed, uploads(post(routes::points::once))),
        (
            "/sessions/{id}/map",
            Keyed,
            uploads(post(routes::map::of_session)),
        ),
        ("/map", Keyed, uploads(post(routes::map::once))),
        (
            "/sessions/{id}/report",
            Keyed,
            uploads(post(routes::report::of_session)),
        ),
        ("/report", Keyed, uploads(post(routes::report::once))),
        (
            "/sessions/{id}/fit",
            Keyed,
            uploads(post(routes::fit::of_session)),
        ),
        ("/fit", Keyed, uploads(post(routes::fit::once))),
        ("/blend", Keyed, uploads(post(routes::blend::once))),
        (
            "/landmarks",
            Keyed,
            uploads(post(routes::landmarks::convert)),
        ),
        ("/healthz", Open, get(routes::service::healthz)),
        ("/readyz", Open, get(routes::service::readyz)),
        ("/metrics", metrics_access, get(routes::service::metrics)),
        (
            "/openapi.json",
            Open,
            get(async move |headers: HeaderMap| openapi.response(&headers)),
        ),
        ("/docs", Open, get(routes::docs::page)),
        ("/problems/{code}", Open, get(routes::problems::section)),
    ]
}

/// The paths of the contract and who may use them.
pub fn paths(app: &App) -> Vec<(&'static str, Access)> {
    routes(app)
        .into_iter()
        .map(|(path, access, _)| (path, access))
        .collect()
}

/// The service.
pub fn router(app: App) -> Router {
    let mut router = assets::routes(&app).merge(routes::docs::files());
    for (path, access, route) in routes(&app) {
        // These have fields of their own in the query.
        let route = if matches!(path, "/warp" | "/landmarks" | LAYER | "/sessions/{id}/drag") {
            route
        } else {
            route.layer(from_fn(reject_query))
        };
        let route = if access == Access::Keyed {
            route.layer(from_fn_with_state(app.clone(), authenticate))
        } else {
            route
        };
        router = router.route(path, route);
    }
    middleware::apply(
        with_fallbacks(router),
        &app,
        app.config().auth.hosts(app.config().listen),
    )
}

/// Metrics and health, without keys, for the ops listener.
fn ops_router(app: &App) -> Router {
    let router = Router::new()
        .route("/healthz", get(routes::service::healthz))
        .route("/readyz", get(routes::service::readyz))
        .route("/metrics", get(routes::service::metrics));
    let listen = app.config().telemetry.metrics_listen;
    let fallback = async |uri: Uri| {
        let detail = format!(
            "nothing is served at {}; this port serves /healthz, /readyz and /metrics",
            quote(uri.path())
        );
        Refusal(Problem::new(Code::NotFound, detail))
    };
    middleware::apply(
        with_fallbacks(router).fallback(fallback),
        app,
        listen.and_then(|listen| app.config().auth.hosts_without_keys(listen)),
    )
}

/// Answers plain HTTP on a TLS listener.
fn tls_required_router(app: &App) -> Router {
    let fallback = async || {
        Refusal(Problem::new(
            Code::MalformedRequest,
            "this port serves HTTPS: use https://",
        ))
    };
    middleware::apply(Router::new().fallback(fallback), app, None)
}

fn with_fallbacks(router: Router<App>) -> Router<App> {
    router
        .fallback(routes::fallbacks::not_found)
        .method_not_allowed_fallback(routes::fallbacks::method_not_allowed)
}

/// Rejects the query of a `POST` or `PUT` without fields in its query: none is ignored.
async fn reject_query(request: Request, next: Next) -> Result<Response, Refusal> {
    if matches!(*request.method(), Method::POST | Method::PUT) {
        let [] = headers::query_fields(request.uri().query(), [])?;
    }
    Ok(next.run(request).await)
}

/// Rejects an upload before its body is read when the queue is full. Drags are small: for them the
/// queue decides later.
async fn reject_if_queue_full(
    State(app): State<App>,
    caller: Caller,
    request: Request,
    next: Next,
) -> Result<Response, Refusal> {
    app.admission.require_queue_place(caller.client)?;
    Ok(next.run(request).await)
}
