//! What browsers are told: which other sites' pages may ask (CORS), and what every answer says against being misread or embedded.

use axum::body::Body;
use axum::extract::Request;
use axum::http::header::{
    ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS, ACCESS_CONTROL_ALLOW_ORIGIN, ACCESS_CONTROL_EXPOSE_HEADERS,
    ACCESS_CONTROL_MAX_AGE, ACCESS_CONTROL_REQUEST_METHOD, HeaderName, ORIGIN, REFERRER_POLICY, STRICT_TRANSPORT_SECURITY, VARY,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse as _, Response};

use crate::auth::cors::Origins;
use crate::config::AuthConfig;
use crate::http::socket::handshake::is_of_this_site;
use crate::problem::{Code, Problem};

const METHODS: HeaderValue = HeaderValue::from_static("GET, HEAD, POST, PUT, DELETE");
const REQUEST_HEADERS: HeaderValue =
    HeaderValue::from_static("accept, authorization, content-type, if-none-match, te, traceparent, x-request-id");
/// Every header of the contract that a page's script may want to read.
const EXPOSED: HeaderValue = HeaderValue::from_static(
    "allow, etag, location, retry-after, server-timing, warp-folds, warp-offset, warp-plan, warp-residual, warp-session, warp-warning, \
     www-authenticate, x-request-id",
);
/// Seconds for which a browser need not ask again.
const PREFLIGHT_AGE: HeaderValue = HeaderValue::from_static("600");
const RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
/// One year: once reached by TLS, the host is not to be reached without.
const TRANSPORT: HeaderValue = HeaderValue::from_static("max-age=31536000");

/// What one request's answer tells a browser.
#[derive(Debug)]
pub(crate) struct Site {
    /// What `Access-Control-Allow-Origin` says, if the page that asks may.
    allowed: Option<HeaderValue>,
    /// Other origins are answered otherwise.
    varies: bool,
    is_shared: bool,
    is_tls: bool,
    /// A page of another site asks that may not.
    is_foreign: bool,
}

impl Site {
    pub(crate) fn new(config: &AuthConfig, request: &Request) -> Self {
        let headers = request.headers();
        let origins = &config.cors_origin;
        let allowed = match headers.get(ORIGIN) {
            _ if *origins == Origins::Any => Some(HeaderValue::from_static("*")),
            Some(origin) if origin.to_str().is_ok_and(|origin| origins.has(origin)) => Some(origin.clone()),
            _ => None,
        };
        let is_shared = *origins != Origins::Own;
        // Browsers say so, and no script can say otherwise (https://www.w3.org/TR/fetch-metadata/). To a server that is reached neither by TLS nor on
        // the loopback they say the page's origin and no more; a key is nothing that a browser would send by itself.
        let elsewhere = match headers.get(FETCH_SITE) {
            Some(site) => site != "same-origin" && site != "none",
            None => config.keys.is_none() && !is_of_this_site(headers, request.uri().authority()),
        };
        let is_foreign = elsewhere && allowed.is_none();
        Self { allowed, varies: is_shared && *origins != Origins::Any, is_shared, is_tls: config.tls.is_some(), is_foreign }
    }

    /// Refuses what the page of another site would do here. A browser sends such a request and only hides the answer: on a server without keys it
    /// would open sessions for whoever has lured somebody to a page.
    pub(crate) fn check(&self, request: &Request) -> Result<(), Problem> {
        if self.is_foreign && !request.method().is_safe() {
            return Err(Problem::new(Code::Forbidden, "a page of another site may not ask this; --cors-origin lists those that may"));
        }
        Ok(())
    }

    /// The answer to a browser that asks whether it may ask. It carries no key, so it is given before any is wanted.
    pub(crate) fn preflight(&self, request: &Request) -> Option<Response> {
        let asks = request.method() == Method::OPTIONS && request.headers().contains_key(ACCESS_CONTROL_REQUEST_METHOD);
        if !asks || self.allowed.is_none() {
            return None;
        }
        let headers = [
            (ACCESS_CONTROL_ALLOW_METHODS, METHODS),
            (ACCESS_CONTROL_ALLOW_HEADERS, REQUEST_HEADERS),
            (ACCESS_CONTROL_MAX_AGE, PREFLIGHT_AGE),
        ];
        Some((StatusCode::NO_CONTENT, headers, Body::empty()).into_response())
    }

    pub(crate) fn tell(self, headers: &mut HeaderMap) {
        headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
        headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
        headers.insert(RESOURCE_POLICY, HeaderValue::from_static(if self.is_shared { "cross-origin" } else { "same-origin" }));
        if self.is_tls {
            headers.insert(STRICT_TRANSPORT_SECURITY, TRANSPORT);
        }
        if self.varies {
            headers.append(VARY, HeaderValue::from_static("origin"));
        }
        if let Some(allowed) = self.allowed {
            headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, allowed);
            headers.insert(ACCESS_CONTROL_EXPOSE_HEADERS, EXPOSED);
        }
    }
}
