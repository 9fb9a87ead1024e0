//! The doors of routes: where a request comes from, which key it has, whose sessions are meant. A browser cannot give a WebSocket a header; its
//! key travels as a subprotocol that is offered beside `mlswarp`, and never in the address.

use std::net::SocketAddr;

use axum::extract::{ConnectInfo, Request, State};
use axum::http::header::{AUTHORIZATION, HeaderName, SEC_WEBSOCKET_PROTOCOL, UPGRADE, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderValue};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use data_encoding::BASE64URL_NOPAD;

use crate::app::App;
use crate::client::Client;
use crate::limits::networks::client_ip;
use crate::problem::Code;

/// The subprotocol of the drag socket, for clients that name one.
pub(crate) const PROTOCOL: &str = "mlswarp";
/// Before the key in base64url, without padding.
const KEY_PROTOCOL: &str = "mlswarp.bearer.";
const FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");
const BEARER: HeaderValue = HeaderValue::from_static("Bearer");

/// Who may use a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Everybody: it tells nothing of anybody and computes nothing.
    Open,
    /// Whoever has a key, where there are keys; no more often than is allowed.
    Keyed,
}

/// Who asks, as far as the connection tells.
pub(crate) fn client(app: &App, request: &Request) -> Client {
    let Some(ConnectInfo(peer)) = request.extensions().get::<ConnectInfo<SocketAddr>>() else { return Client::default() };
    let forwarded = request.headers().get_all(FORWARDED_FOR).iter().map(|value| value.to_str().unwrap_or_default());
    // One header of many values or many headers: one list.
    let hops = forwarded.flat_map(|value| value.split(','));
    Client { address: client_ip(peer.ip(), hops, &app.config().auth.trusted_proxies), ..Client::default() }
}

/// Lets in who may come in, and says to the handler whose sessions are meant. The key goes no further.
pub(crate) async fn keyed(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let client = request.extensions().get::<Client>().copied().unwrap_or_default();
    let key = key(request.headers());
    request.headers_mut().remove(AUTHORIZATION);
    match app.access().admit(client.address, key.as_deref()) {
        Ok((owner, pass)) => {
            request.extensions_mut().insert(Client { owner, ..client });
            request.extensions_mut().insert(pass);
            next.run(request).await
        }
        Err(problem) if problem.code == Code::Unauthorized => ([(WWW_AUTHENTICATE, BEARER)], problem).into_response(),
        Err(problem) => problem.into_response(),
    }
}

/// The one key of a request. Two are none: nobody can say which is meant.
fn key(headers: &HeaderMap) -> Option<String> {
    let mut said = headers.get_all(AUTHORIZATION).iter();
    if let Some(said_first) = said.next() {
        let (scheme, key) = said_first.to_str().ok()?.split_once(' ')?;
        return (said.next().is_none() && scheme.eq_ignore_ascii_case("bearer")).then(|| key.trim().to_owned());
    }
    if !headers.contains_key(UPGRADE) {
        return None;
    }
    let mut offered = protocols(headers).filter_map(|protocol| protocol.strip_prefix(KEY_PROTOCOL));
    let key = BASE64URL_NOPAD.decode(offered.next()?.as_bytes()).ok()?;
    offered.next().is_none().then(|| String::from_utf8(key).ok()).flatten()
}

/// The subprotocols that a WebSocket's client offers.
pub(crate) fn protocols(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    headers.get_all(SEC_WEBSOCKET_PROTOCOL).iter().filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(',')).map(str::trim)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(headers: &[(HeaderName, &str)]) -> Option<String> {
        key(&headers.iter().map(|(name, value)| (name.clone(), HeaderValue::from_str(value).unwrap())).collect())
    }

    #[test]
    fn a_key_is_a_bearer_token_or_a_subprotocol() {
        assert_eq!(of(&[(AUTHORIZATION, "Bearer 0123456789abcdef")]).as_deref(), Some("0123456789abcdef"));
        assert_eq!(of(&[(AUTHORIZATION, "bearer  0123456789abcdef ")]).as_deref(), Some("0123456789abcdef"));
        let offered = "mlswarp, mlswarp.bearer.MDEyMzQ1Njc4OWFiY2RlZi8r";
        assert_eq!(of(&[(UPGRADE, "websocket"), (SEC_WEBSOCKET_PROTOCOL, offered)]).as_deref(), Some("0123456789abcdef/+"));
        for none in [
            &[][..],
            &[(AUTHORIZATION, "Basic dXNlcjpwYXNz")],
            &[(AUTHORIZATION, "0123456789abcdef")],
            &[(AUTHORIZATION, "Bearer one"), (AUTHORIZATION, "Bearer two")],
            &[(SEC_WEBSOCKET_PROTOCOL, offered)],
            &[(UPGRADE, "websocket"), (SEC_WEBSOCKET_PROTOCOL, "mlswarp.bearer.???")],
            &[(UPGRADE, "websocket"), (SEC_WEBSOCKET_PROTOCOL, "mlswarp.bearer.MDEy, mlswarp.bearer.MDEz")],
        ] {
            assert_eq!(of(none), None, "{none:?}");
        }
    }
}
