//! The outermost layer: everything that must hold for every request, in one place. A request id (the client's where it is sane) and
//! with it the scope of all that is told of the request, the host, the body's limit and deadline, panics, the request's own deadline, problem documents, what browsers are told, and one log line.

pub(crate) mod cross_origin;
pub(crate) mod host;
pub(crate) mod keyed;

use std::panic::AssertUnwindSafe;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::header::{CONNECTION, CONTENT_LENGTH, EXPECT};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Version};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt as _;
use opentelemetry::Context;
use opentelemetry::propagation::TextMapPropagator as _;
use opentelemetry_http::HeaderExtractor;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use uuid::Uuid;

use super::body::{LimitedBody, Waiting, too_large};
use super::response::problem::finish;
use crate::app::App;
use crate::auth::hosts::Hosts;
use crate::observe::metrics::known_method;
use crate::observe::{RequestInfo, Scope};
use crate::pool::panic_text;
use crate::problem::{Code, Problem};
use cross_origin::Site;
use keyed::client;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const LONGEST_REQUEST_ID: usize = 64;

/// Seconds after which a request that the server did not finish in time may be sent again.
const RETRY_LATE: u32 = 1;

/// Not traced: they are asked all the time, by machines.
const UNTRACED_ROUTES: [&str; 3] = ["/healthz", "/readyz", "/metrics"];

/// What the layer knows of its listener.
#[derive(Clone, Debug)]
pub(crate) struct Fence {
    app: App,
    /// The hosts that it serves; none: all.
    hosts: Option<Hosts>,
}

impl Fence {
    /// Of the service.
    pub(crate) fn of_service(app: &App) -> Self {
        Self { app: app.clone(), hosts: app.config().auth.hosts(app.config().listen).cloned() }
    }

    /// Of the listener for metrics and health.
    pub(crate) fn of_watchers(app: &App) -> Self {
        let config = app.config();
        let hosts = config.telemetry.metrics_listen.and_then(|listen| config.auth.hosts_without_keys(listen));
        Self { app: app.clone(), hosts: hosts.cloned() }
    }
}

pub(crate) async fn fence(State(Fence { app, hosts }): State<Fence>, request: Request, next: Next) -> Response {
    let began = Instant::now();
    let id = request_id(request.headers());
    // The pattern, never the path: neither a log nor a trace may hold session ids.
    let route = request.extensions().get::<MatchedPath>().cloned();
    let tracer = app.tracer().filter(|_| !route.as_ref().is_some_and(|route| UNTRACED_ROUTES.contains(&route.as_str())));
    let scope = match tracer {
        None => Scope::untraced(&id),
        Some(tracer) => {
            let info = RequestInfo {
                parent: TraceContextPropagator::new().extract_with_context(&Context::new(), &HeaderExtractor(request.headers())),
                began,
                method: known_method(request.method().as_str()),
                route: route.as_ref().map(MatchedPath::as_str),
                scheme: if app.config().auth.tls.is_some() { "https" } else { "http" },
            };
            Scope::request(&id, tracer, &info)
        }
    };
    let host = host::check(&request, hosts.as_ref());
    let fenced = fenced(app.clone(), request, next, host, Head { began, id, route });
    scope.wrap(fenced).await
}

/// What is known of a request before anything is done.
struct Head {
    began: Instant,
    id: String,
    route: Option<MatchedPath>,
}

async fn fenced(app: App, mut request: Request, next: Next, host: Result<(), Problem>, head: Head) -> Response {
    let Head { began, id, route } = head;
    let (method, version) = (request.method().clone(), request.version());
    let client = client(&app, &request);
    request.extensions_mut().insert(client);
    let site = Site::new(&app.config().auth, &request);
    let mut code = None;
    let preflight = host.is_ok().then(|| site.preflight(&request)).flatten();
    let mut response = match preflight {
        Some(response) => response,
        None => {
            let response = match host.and_then(|()| site.check(&request)) {
                Ok(()) => answer(&app, request, next).await,
                Err(problem) => problem.into_response(),
            };
            if let Some(problem) = response.extensions().get::<Problem>() {
                app.metrics().refused(problem);
                code = Some(problem.code);
            }
            finish(response, &id)
        }
    };
    // The next request of this connection would perhaps come when nobody listens any more.
    if app.is_leaving() && version < Version::HTTP_2 && response.status() != StatusCode::SWITCHING_PROTOCOLS {
        response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
    }
    let method = method.as_str();
    sent(&app, &mut response, site, &Sent { head: &Head { began, id, route }, method, code });
    response
}

/// The answer to what never was a request: the head could not be read, or came where it may not.
pub(crate) fn refused(app: &App, problem: Problem) -> Response {
    let head = Head { began: Instant::now(), id: Uuid::new_v4().to_string(), route: None };
    Scope::untraced(&head.id).enter(|| {
        app.metrics().refused(&problem);
        let code = Some(problem.code);
        let mut response = finish(problem.into_response(), &head.id);
        let site = Site::new(&app.config().auth, &Request::default());
        sent(app, &mut response, site, &Sent { head: &head, method: "", code });
        response
    })
}

/// What an answer was given to.
struct Sent<'a> {
    head: &'a Head,
    method: &'a str,
    code: Option<Code>,
}

/// The end of every answer: what all of them say, and what is told of them.
fn sent(app: &App, response: &mut Response, site: Site, to: &Sent<'_>) {
    let Sent { head: Head { began, id, route }, method, code } = to;
    site.tell(response.headers_mut());
    if let Ok(id) = HeaderValue::from_str(id) {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    let status = response.status().as_u16();
    Scope::current().set_response(status, *code);
    let route = route.as_ref().map_or("-", MatchedPath::as_str);
    app.metrics().answered(route, method, status, began.elapsed());
    let ms = began.elapsed().as_secs_f64() * 1e3;
    // A client may send any word as its method, as long as a head may be.
    let method = known_method(method).unwrap_or("other");
    tracing::info!(target: "mlswarp::http", method, route, status, ms = format_args!("{ms:.1}"), "answered");
}

async fn answer(app: &App, request: Request, next: Next) -> Response {
    let config = app.config();
    let length = request.headers().get(CONTENT_LENGTH).and_then(|n| n.to_str().ok()).and_then(|n| n.parse::<u64>().ok());
    let waits_for_permission = request.headers().contains_key(EXPECT);
    let waiting = Waiting::default();
    let request =
        request.map(|body| LimitedBody::wrap(body, config.max_body_bytes, config.timeouts.body, waits_for_permission, waiting.clone()));
    if let Some(length) = length.filter(|n| *n > config.max_body_bytes) {
        return too_large("body_bytes", config.max_body_bytes, length).into_response();
    }
    // The request's future is alive until the end: dropped, it waits for nothing.
    let mut run = std::pin::pin!(AssertUnwindSafe(next.run(request)).catch_unwind());
    match tokio::time::timeout(config.timeouts.request, run.as_mut()).await {
        Ok(Ok(response)) => response,
        Ok(Err(panic)) => {
            tracing::error!(message = panic_text(panic.as_ref()), "a handler panicked");
            Problem::new(Code::Internal, "the server made a mistake; its log has more").into_response()
        }
        Err(_) => {
            let seconds = config.timeouts.request.as_secs_f64();
            let problem = if waiting.is_for_client() {
                Problem::new(Code::Timeout, format!("the body was not whole within the {seconds} s that a request may take"))
            } else {
                let detail = format!("the server did not answer within the {seconds} s that a request may take");
                Problem::new(Code::Overloaded, detail).retry_after(RETRY_LATE)
            };
            problem.into_response()
        }
    }
}

/// The client's id where it is a short plain word, otherwise a new one.
fn request_id(headers: &HeaderMap) -> String {
    let plain = |id: &&str| {
        (1..=LONGEST_REQUEST_ID).contains(&id.len()) && id.bytes().all(|b| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.'))
    };
    headers.get(REQUEST_ID).and_then(|id| id.to_str().ok()).filter(plain).map_or_else(|| Uuid::new_v4().to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_handler_that_panics_is_a_problem_and_the_next_request_is_answered() {
        use tower::ServiceExt as _;
        async fn boom() -> &'static str {
            panic!("on purpose")
        }
        let app = App::new(crate::config::Config::default()).unwrap();
        let router = axum::Router::new()
            .route("/boom", axum::routing::get(boom))
            .route("/well", axum::routing::get(|| async { "well" }))
            .layer(axum::middleware::from_fn_with_state(Fence::of_service(&app), fence));
        let get =
            |path: &str| router.clone().oneshot(Request::get(path).header("host", "localhost").body(axum::body::Body::empty()).unwrap());
        let response = get("/boom").await.unwrap();
        assert_eq!(response.status(), 500);
        let id = response.headers()[REQUEST_ID].to_str().unwrap().to_owned();
        let body = axum::body::to_bytes(response.into_body(), 1 << 16).await.unwrap();
        let document: serde_json::Value = serde_json::from_slice(&body).unwrap();
        assert_eq!((&document["code"], &document["request_id"]), (&"internal".into(), &id.into()));
        assert!(!document.to_string().contains("purpose"), "a panic's words stay in the log");
        assert_eq!(get("/well").await.unwrap().status(), 200);
    }

    #[test]
    fn a_sane_request_id_is_kept_and_others_are_replaced() {
        let id = |text: &[u8]| {
            let mut headers = HeaderMap::new();
            headers.insert(REQUEST_ID, HeaderValue::from_bytes(text).unwrap());
            request_id(&headers)
        };
        assert_eq!(id(b"trace-1.A_z"), "trace-1.A_z");
        for bad in [&b""[..], b"two words", b"\"quoted\"", &[b'x'; 65], b"\xff"] {
            assert_eq!(id(bad).len(), 36, "{bad:?}");
        }
        assert_ne!(request_id(&HeaderMap::new()), request_id(&HeaderMap::new()));
    }
}
