//! What browsers may do for pages of other sites: CORS, and the rejection of requests that change
//! something.

use std::time::Duration;

use axum::extract::Request;
use axum::http::header::{HOST, ORIGIN};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method};
use tower_http::cors::{AllowOrigin, CorsLayer, Vary};

use crate::auth::cors::Origins;
use crate::config::AuthConfig;
use crate::problem::{Code, Problem};

const METHODS: [Method; 5] = [
    Method::GET,
    Method::HEAD,
    Method::POST,
    Method::PUT,
    Method::DELETE,
];
const REQUEST_HEADERS: [&str; 7] = [
    "accept",
    "authorization",
    "content-type",
    "if-none-match",
    "te",
    "traceparent",
    "x-request-id",
];
const RESPONSE_HEADERS: [&str; 15] = [
    "allow",
    "etag",
    "location",
    "retry-after",
    "server-timing",
    "warp-canvas",
    "warp-folds",
    "warp-frames",
    "warp-method",
    "warp-plan",
    "warp-residual",
    "warp-session",
    "warp-warning",
    "www-authenticate",
    "x-request-id",
];
/// How long a browser may remember a preflight.
const PREFLIGHT_AGE: Duration = Duration::from_secs(600);
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// The CORS headers; none where only pages of this server may use it.
pub(super) fn cors_layer(origins: &Origins) -> Option<CorsLayer> {
    let (allowed, vary) = match origins {
        Origins::Own => return None,
        Origins::Listed(listed) => (
            AllowOrigin::list(listed.iter().flat_map(|origin| origin.parse())),
            vec![ORIGIN],
        ),
        Origins::Any => (AllowOrigin::any(), vec![]),
    };
    let layer = CorsLayer::new()
        .allow_origin(allowed)
        .vary(Vary::list(vary))
        .allow_methods(METHODS)
        .max_age(PREFLIGHT_AGE);
    let names = layer.allow_headers(REQUEST_HEADERS.map(HeaderName::from_static));
    Some(names.expose_headers(RESPONSE_HEADERS.map(HeaderName::from_static)))
}

/// Rejects requests by which a page of another site would change something. A browser sends them
/// and only hides the response; on a server without keys they would open sessions for any site that
/// a user visits.
///
/// tower-http's `csrf` cannot replace this: it compares `Origin` and `Host` byte for byte, so it
/// rejects pages of this server behind a proxy that sends `Host: warp.example:443`, and it has no
/// exemption for servers with keys, which browsers do not send by themselves.
pub(super) fn check(config: &AuthConfig, request: &Request) -> Result<(), Problem> {
    let headers = request.headers();
    // Browsers send Sec-Fetch-Site to servers that they reach by TLS or on the loopback, and no
    // script can change it (W3C Fetch Metadata).
    let is_cross_origin = match headers.get(FETCH_SITE) {
        Some(site) => site != "same-origin" && site != "none",
        None => config.keys.is_none() && !is_same_origin(headers, request.uri().authority()),
    };
    if is_cross_origin && !request.method().is_safe() && !is_listed(headers, &config.cors_origin) {
        return Err(Problem::new(
            Code::Forbidden,
            "cross-origin request rejected; --cors-origin lists the sites whose pages may send it",
        ));
    }
    Ok(())
}

/// Which pages may embed a response (`Cross-Origin-Resource-Policy`): those of a listed site, if
/// the request is from one. A listed site opens nothing for others, whose pages send no `Origin`
/// when they embed an image; so a listed one embeds it with `crossorigin`.
pub(super) fn resource_policy(headers: &HeaderMap, origins: &Origins) -> HeaderValue {
    let is_open = *origins == Origins::Any || is_listed(headers, origins);
    HeaderValue::from_static(if is_open {
        "cross-origin"
    } else {
        "same-origin"
    })
}

/// Whether the page that sends a request is of a listed site.
pub(crate) fn is_listed(headers: &HeaderMap, origins: &Origins) -> bool {
    let origin = headers.get(ORIGIN).and_then(|origin| origin.to_str().ok());
    origins.has(origin.unwrap_or_default())
}

/// Whether a request is sent by no page, or by one of this server. The authority of the `target`
/// takes precedence over the `Host` header.
pub(crate) fn is_same_origin(headers: &HeaderMap, target: Option<&Authority>) -> bool {
    let Some(origin) = headers.get(ORIGIN) else {
        return true;
    };
    let own = target
        .map(Authority::as_str)
        .or_else(|| headers.get(HOST)?.to_str().ok());
    let origin = HeaderValue::to_str(origin)
        .ok()
        .and_then(|origin| origin.split_once("://"));
    own.zip(origin).is_some_and(|(own, (scheme, origin))| {
        normalized(own, scheme) == normalized(origin, scheme)
    })
}

/// An authority in lower case, without the scheme's default port.
fn normalized(authority: &str, scheme: &str) -> String {
    let default_port = if scheme == "https" { ":443" } else { ":80" };
    authority
        .strip_suffix(default_port)
        .unwrap_or(authority)
        .to_ascii_lowercase()
}
