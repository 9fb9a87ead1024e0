//! The middleware of every request: id, log line, trace, host, CORS, cross-origin check, body
//! limit, deadline, panics, problem documents.

pub(crate) mod authentication;
pub(crate) mod cross_origin;
pub(crate) mod host;
pub(crate) mod token_routes;

use std::any::Any;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use axum::Router;
use axum::extract::{MatchedPath, Request, State};
use axum::http::header::{
    CONNECTION, EXPECT, REFERRER_POLICY, STRICT_TRANSPORT_SECURITY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Version};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use opentelemetry::Context;
use opentelemetry::propagation::TextMapPropagator as _;
use opentelemetry_http::HeaderExtractor;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use tower_http::catch_panic::CatchPanicLayer;
use uuid::Uuid;

use super::body::{LimitedBody, too_large};
use super::connection::turns::RequestTurns;
use super::headers::content_length;
use super::response::problem::finish;
use crate::app::App;
use crate::auth::hosts::Hosts;
use crate::auth::tokens::TokenName;
use crate::http::response::Refusal;
use crate::observe::metrics::known_method;
use crate::observe::{RequestInfo, Scope};
use crate::pool::panic_text;
use crate::problem::{Code, Problem};
use authentication::client;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const MAX_REQUEST_ID: usize = 64;
const RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");
/// Browsers use TLS alone for a year.
const HSTS: HeaderValue = HeaderValue::from_static("max-age=31536000");

/// `Retry-After` in seconds of a request that the server did not answer in time.
const RETRY_LATE: u32 = 1;

/// Probes and scrapers request these all the time.
const UNTRACED_ROUTES: [&str; 3] = ["/healthz", "/readyz", "/metrics"];

#[derive(Clone)]
struct MiddlewareState {
    app: App,
    hosts: Option<Hosts>,
}

/// Completes a router by its middleware. `hosts`: the hosts that requests may name; none: any host.
pub(crate) fn apply(router: Router<App>, app: &App, hosts: Option<&Hosts>) -> Router {
    let router = router
        .layer(CatchPanicLayer::custom(on_panic))
        .layer(from_fn_with_state(app.clone(), limit));
    let router = match cross_origin::cors_layer(&app.config().auth.cors_origin) {
        Some(cors) => router.layer(cors),
        None => router,
    };
    let state = MiddlewareState {
        app: app.clone(),
        hosts: hosts.cloned(),
    };
    router
        .layer(from_fn_with_state(state, outermost))
        .with_state(app.clone())
}

/// Identifies, logs and traces a request, checks its host, and completes its response.
async fn outermost(
    State(MiddlewareState { app, hosts }): State<MiddlewareState>,
    mut request: Request,
    next: Next,
) -> Response {
    let began = Instant::now();
    let id = request_id(request.headers());
    // The pattern, never the path: neither a log nor a trace may hold session ids.
    let route = request.extensions().get::<MatchedPath>().cloned();
    let tracer = app.tracer().filter(|_| {
        !route
            .as_ref()
            .is_some_and(|route| UNTRACED_ROUTES.contains(&route.as_str()))
    });
    let scope = match tracer {
        None => Scope::untraced(&id),
        Some(tracer) => {
            let info = RequestInfo {
                parent: TraceContextPropagator::new()
                    .extract_with_context(&Context::new(), &HeaderExtractor(request.headers())),
                began,
                method: known_method(request.method().as_str()),
                route: route.as_ref().map(MatchedPath::as_str),
                scheme: if app.config().auth.tls.is_some() {
                    "https"
                } else {
                    "http"
                },
            };
            Scope::request(&id, tracer, &info)
        }
    };
    let host = host::check(&request, hosts.as_ref());
    let (method, version) = (request.method().clone(), request.version());
    let policy = cross_origin::resource_policy(request.headers(), &app.config().auth.cors_origin);
    let client = client(&app, &request);
    let turns = request.extensions().get::<RequestTurns>().cloned();
    request.extensions_mut().insert(client);
    let answered = async {
        let response = match host {
            Ok(()) => next.run(request).await,
            Err(problem) => Refusal(problem).into_response(),
        };
        let code = response.extensions().get::<Problem>().map(|problem| {
            app.metrics().refused(problem);
            problem.code
        });
        let mut response = finish(response, &app.config().public_path, &id);
        // tower-http answers a preflight with 200.
        if method == Method::OPTIONS && response.status() == StatusCode::OK {
            *response.status_mut() = StatusCode::NO_CONTENT;
        }
        let status = response.status();
        let headers = response.headers_mut();
        set_security_headers(&app, headers, policy);
        // The server may have stopped before the connection's next request.
        if app.lifecycle.is_leaving()
            && version < Version::HTTP_2
            && status != StatusCode::SWITCHING_PROTOCOLS
        {
            headers.insert(CONNECTION, HeaderValue::from_static("close"));
        }
        if let Ok(id) = HeaderValue::from_str(&id) {
            headers.insert(REQUEST_ID, id);
        }
        let status = status.as_u16();
        Scope::current().set_response(status, code);
        let route = route.as_ref().map_or("-", MatchedPath::as_str);
        app.metrics()
            .answered(route, method.as_str(), status, began.elapsed());
        let ms = began.elapsed().as_secs_f64() * 1e3;
        // A client may send any word as its method, as long as a head may be.
        let method = known_method(method.as_str()).unwrap_or("other");
        let token = response.extensions().get::<TokenName>();
        let (kid, jti) = (token.map(|t| &*t.kid), token.map(|t| &*t.jti));
        tracing::info!(target: "mlswarp::http", method, route, status, ms = format_args!("{ms:.1}"),
            kid, jti, "answered");
        response
    };
    // A proxy's connection has the requests of many clients.
    match turns.filter(|turns| turns.is_of_proxy) {
        Some(RequestTurns { turns, .. }) => {
            turns.of(client.address).take(scope.wrap(answered)).await
        }
        None => scope.wrap(answered).await,
    }
}

/// Tells browsers how a response may be used.
fn set_security_headers(app: &App, headers: &mut HeaderMap, policy: HeaderValue) {
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(RESOURCE_POLICY, policy);
    if app.config().auth.tls.is_some() {
        headers.insert(STRICT_TRANSPORT_SECURITY, HSTS);
    }
}

/// Rejects cross-origin requests, and limits the body and the time of the others.
///
/// tower-http's `limit` and `timeout` cannot replace this: they cannot tell a slow client (408)
/// from a slow server (503 with `Retry-After`), give no actual size, and do not drain the rest of a
/// body after an early response.
async fn limit(State(app): State<App>, request: Request, next: Next) -> Result<Response, Refusal> {
    let (timeouts, max_bytes) = (app.config().timeouts, app.config().max_body_bytes);
    cross_origin::check(&app.config().auth, &request)?;
    let length = content_length(request.headers());
    let expects_continue = request.headers().contains_key(EXPECT);
    let waits = Arc::<AtomicBool>::default();
    let request = request.map(|body| {
        LimitedBody::wrap(
            body,
            max_bytes,
            timeouts.body,
            expects_continue,
            Arc::clone(&waits),
        )
    });
    if let Some(length) = length.filter(|length| *length > max_bytes) {
        return Err(too_large("body_bytes", max_bytes, length).into());
    }
    // Not dropped before `waits` is read: dropping the body resets it.
    let mut response = pin!(next.run(request));
    if let Ok(response) = tokio::time::timeout(timeouts.request, response.as_mut()).await {
        return Ok(response);
    }
    let seconds = timeouts.request.as_secs_f64();
    let problem = if waits.load(Ordering::Relaxed) {
        Problem::new(
            Code::Timeout,
            format!("the body was not complete after {seconds} s, the time limit of a request"),
        )
    } else {
        let detail =
            format!("the server did not finish within {seconds} s, the time limit of a request");
        Problem::new(Code::Overloaded, detail).retry_after(RETRY_LATE)
    };
    Err(problem.into())
}

fn on_panic(panic: Box<dyn Any + Send>) -> Response {
    tracing::error!(message = panic_text(panic.as_ref()), "a handler panicked");
    Refusal(Problem::new(Code::Internal, "internal error")).into_response()
}

/// The client's id where it is a short plain word, otherwise a new one. tower-http's `request_id`
/// accepts any id.
fn request_id(headers: &HeaderMap) -> String {
    let is_plain = |id: &&str| {
        (1..=MAX_REQUEST_ID).contains(&id.len())
            && id
                .bytes()
                .all(|b| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.'))
    };
    let given = headers
        .get(REQUEST_ID)
        .and_then(|id| id.to_str().ok())
        .filter(is_plain);
    given.map_or_else(|| Uuid::new_v4().to_string(), str::to_owned)
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
        let router = Router::new()
            .route("/boom", axum::routing::get(boom))
            .route("/well", axum::routing::get(|| async { "well" }));
        let router = apply(router, &app, None);
        let get = |path: &str| {
            router.clone().oneshot(
                Request::get(path)
                    .header("host", "localhost")
                    .body(axum::body::Body::empty())
                    .unwrap(),
            )
        };
        let response = get("/boom").await.unwrap();
        assert_eq!(response.status(), 500);
        let id = response.headers()[REQUEST_ID].to_str().unwrap().to_owned();
        let body = axum::body::to_bytes(response.into_body(), 1 << 16)
            .await
            .unwrap();
        let document: serde_json::Value = serde_json::from_slice(&body).unwrap();
        assert_eq!(
            (&document["code"], &document["request_id"]),
            (&"internal".into(), &id.into())
        );
        assert!(
            !document.to_string().contains("purpose"),
            "a panic's words stay in the log"
        );
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
