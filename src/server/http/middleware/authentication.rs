//! Authentication: the client's address, key or token, and the owner whose sessions it may use. A
//! browser cannot give a WebSocket a header, so both travel as a subprotocol that is offered beside
//! `mlswarp`, never in the address.

use std::convert::Infallible;
use std::net::SocketAddr;

use axum::extract::{ConnectInfo, FromRequestParts, MatchedPath, RawPathParams, Request, State};
use axum::http::header::{
    AUTHORIZATION, HeaderName, SEC_WEBSOCKET_PROTOCOL, UPGRADE, WWW_AUTHENTICATE,
};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use data_encoding::BASE64URL_NOPAD;

use super::token_routes::operation;
use crate::app::App;
use crate::auth::Admitted;
use crate::auth::tokens::Wanted;
use crate::client::Client;
use crate::http::capped_body::{CappedBody, too_large};
use crate::http::headers::{content_length, elements};
use crate::http::response::Refusal;
use crate::limits::networks::client_ip;
use crate::problem::{Code, Problem};

/// The subprotocol of the drag socket.
pub(crate) const PROTOCOL: &str = "mlswarp";
/// The prefix of a key in base64url without padding.
const KEY_PROTOCOL: &str = "mlswarp.bearer.";
const FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");
const BEARER: HeaderValue = HeaderValue::from_static("Bearer");

/// Who may use a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Everybody: the route shows no user data and computes nothing.
    Open,
    /// Clients with a key, where keys are configured, within their rate.
    Keyed,
}

/// The application and the client of a request, for handlers.
pub(crate) struct Caller {
    pub(crate) app: App,
    pub(crate) client: Client,
}

impl FromRequestParts<App> for Caller {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Infallible> {
        Ok(Self {
            app: app.clone(),
            client: parts.extensions.get().copied().unwrap_or_default(),
        })
    }
}

/// The client of a request before its key is known.
pub(super) fn client(app: &App, request: &Request) -> Client {
    let Some(ConnectInfo(peer)) = request.extensions().get::<ConnectInfo<SocketAddr>>() else {
        return Client::default();
    };
    let forwarded = request
        .headers()
        .get_all(FORWARDED_FOR)
        .iter()
        .map(|value| value.to_str().unwrap_or_default());
    // Several headers are one list (RFC 9110, section 5.3).
    let hops = forwarded.flat_map(|value| value.split(','));
    Client {
        address: client_ip(peer.ip(), hops, &app.config().auth.trusted_proxies),
        ..Client::default()
    }
}

/// Checks the key and the rate, and passes the owner on to the handler instead of the key.
pub(crate) async fn authenticate(
    State(app): State<App>,
    Caller { client, .. }: Caller,
    path: RawPathParams,
    mut request: Request,
    next: Next,
) -> Response {
    let key = key(request.headers());
    let authorization = request.headers_mut().remove(AUTHORIZATION);
    let route = request.extensions().get::<MatchedPath>();
    let wanted = Wanted {
        op: route.and_then(|route| operation(request.method(), route.as_str())),
        session: path
            .iter()
            .find(|(name, _)| *name == "id")
            .map(|(_, id)| id),
    };
    match app.access().admit(client.address, key.as_deref(), wanted) {
        Ok(Admitted { credential, token }) => {
            let grant = credential.grant();
            request.extensions_mut().insert(Client {
                owner: credential.owner(),
                visit: grant.map(|grant| grant.session()),
                ..client
            });
            request.extensions_mut().insert(credential);
            let limited = match grant.and_then(|grant| grant.max_bytes) {
                Some(max_bytes) => limit_body(request, max_bytes),
                None => Ok(request),
            };
            let mut response = match limited {
                Ok(request) => next.run(request).await,
                Err(problem) => Refusal(problem).into_response(),
            };
            if let Some(token) = token {
                response.extensions_mut().insert(token);
            }
            response
        }
        Err(mut problem) if matches!(problem.code, Code::Unauthorized | Code::TokenExpired) => {
            if let Some(field) = authorization.filter(|_| key.is_none()) {
                problem.detail = unreadable(field.as_bytes()).to_owned();
            }
            ([(WWW_AUTHENTICATE, BEARER)], Refusal(problem)).into_response()
        }
        Err(mut problem) => {
            // Nothing of the key is repeated.
            if problem.code == Code::Forbidden
                && key.is_some_and(|key| key.starts_with(['"', '\'', '<', '`']))
            {
                problem
                    .detail
                    .push_str("; send the key without quotes or brackets");
            }
            Refusal(problem).into_response()
        }
    }
}

/// A request whose body may have at most as many bytes as its token allows.
fn limit_body(request: Request, max_bytes: u64) -> Result<Request, Problem> {
    const WHAT: &str = "token_max_bytes";
    match content_length(request.headers()).filter(|length| *length > max_bytes) {
        Some(length) => Err(too_large(WHAT, max_bytes, length)),
        None => Ok(request.map(|body| CappedBody::wrap(body, WHAT, max_bytes))),
    }
}

/// The key of a request; none if there are two, which would be ambiguous.
fn key(headers: &HeaderMap) -> Option<String> {
    let mut fields = headers.get_all(AUTHORIZATION).iter();
    if let Some(field) = fields.next() {
        let (scheme, key) = field.to_str().ok()?.split_once(' ')?;
        return (fields.next().is_none() && scheme.eq_ignore_ascii_case("bearer"))
            .then(|| key.trim().to_owned());
    }
    if !headers.contains_key(UPGRADE) {
        return None;
    }
    let mut offered = protocols(headers).filter_map(|protocol| protocol.strip_prefix(KEY_PROTOCOL));
    let key = BASE64URL_NOPAD.decode(offered.next()?.as_bytes()).ok()?;
    offered
        .next()
        .is_none()
        .then(|| String::from_utf8(key).ok())
        .flatten()
}

/// What is wrong with a field `Authorization` from which no key was read. Nothing of it is
/// repeated: it may be a key.
fn unreadable(field: &[u8]) -> &'static str {
    let is_bearer = field
        .split(|b| *b == b' ')
        .next()
        .is_some_and(|scheme| scheme.eq_ignore_ascii_case(b"bearer"));
    if is_bearer && !field.is_ascii() {
        "the key in `Authorization` has characters outside ASCII, which no key has: send \
            `Authorization: Bearer <key>`"
    } else if is_bearer {
        "`Authorization` must be given once, with one key: send `Authorization: Bearer <key>`"
    } else {
        "the scheme of `Authorization` must be `Bearer`: send `Authorization: Bearer <key>`"
    }
}

/// The subprotocols that a WebSocket client offers.
pub(crate) fn protocols(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    elements(headers, SEC_WEBSOCKET_PROTOCOL)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(headers: &[(HeaderName, &str)]) -> Option<String> {
        key(&headers
            .iter()
            .map(|(name, value)| (name.clone(), HeaderValue::from_str(value).unwrap()))
            .collect())
    }

    #[test]
    fn a_key_is_a_bearer_token_or_a_subprotocol() {
        assert_eq!(
            of(&[(AUTHORIZATION, "Bearer 0123456789abcdef")]).as_deref(),
            Some("0123456789abcdef")
        );
        assert_eq!(
            of(&[(AUTHORIZATION, "bearer  0123456789abcdef ")]).as_deref(),
            Some("0123456789abcdef")
        );
        let offered = "mlswarp, mlswarp.bearer.MDEyMzQ1Njc4OWFiY2RlZi8r";
        assert_eq!(
            of(&[(UPGRADE, "websocket"), (SEC_WEBSOCKET_PROTOCOL, offered)]).as_deref(),
            Some("0123456789abcdef/+")
        );
        for none in [
            &[][..],
            &[(AUTHORIZATION, "Basic dXNlcjpwYXNz")],
            &[(AUTHORIZATION, "0123456789abcdef")],
            &[(AUTHORIZATION, "Bearer one"), (AUTHORIZATION, "Bearer two")],
            &[(SEC_WEBSOCKET_PROTOCOL, offered)],
            &[
                (UPGRADE, "websocket"),
                (SEC_WEBSOCKET_PROTOCOL, "mlswarp.bearer.???"),
            ],
            &[
                (UPGRADE, "websocket"),
                (
                    SEC_WEBSOCKET_PROTOCOL,
                    "mlswarp.bearer.MDEy, mlswarp.bearer.MDEz",
                ),
            ],
        ] {
            assert_eq!(of(none), None, "{none:?}");
        }
    }
}
