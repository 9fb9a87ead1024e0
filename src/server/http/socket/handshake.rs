//! The opening handshake of a WebSocket (RFC 6455, section 4.2), and the check of its origin.

use axum::body::{Body, HttpBody as _};
use axum::extract::Request;
use axum::http::header::{
    ALLOW, CONNECTION, HeaderName, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL,
    SEC_WEBSOCKET_VERSION, UPGRADE,
};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Version};
use axum::response::{IntoResponse as _, Response};
use data_encoding::BASE64;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

use crate::auth::cors::Origins;
use crate::http::headers::elements;
use crate::http::middleware::authentication::{PROTOCOL, protocols};
use crate::http::middleware::cross_origin::{is_listed, is_same_origin};
use crate::http::response::Refusal;
use crate::http::routes::fallbacks::not_allowed;
use crate::problem::{Code, Problem};

const WEBSOCKET: HeaderValue = HeaderValue::from_static("websocket");
const VERSION: HeaderValue = HeaderValue::from_static("13");
/// Bytes of a `Sec-WebSocket-Key`.
const KEY_BYTES: usize = 16;

/// The response to a request that opens a WebSocket. Pages of the listed origins may open one.
/// Errors: the response to another request: 405 to another method, 426 without an upgrade, 400 if
/// malformed, 403 to pages of other sites.
pub(crate) fn accept(request: &Request, origins: &Origins) -> Result<Response, Response> {
    let headers = request.headers();
    if request.method() != Method::GET {
        let problem = not_allowed(request, "");
        return Err(([(ALLOW, HeaderValue::from_static("GET"))], Refusal(problem)).into_response());
    }
    let has = |name: HeaderName, element: &str| {
        elements(headers, name).any(|other| other.eq_ignore_ascii_case(element))
    };
    if request.version() != Version::HTTP_11
        || !has(CONNECTION, "upgrade")
        || !has(UPGRADE, "websocket")
    {
        return Err(upgrade_required(
            "this route is a WebSocket: connect with a WebSocket client (an upgrade of an \
                HTTP/1.1 connection)",
        ));
    }
    if headers.get(SEC_WEBSOCKET_VERSION) != Some(&VERSION) {
        return Err(upgrade_required(
            "this route is a WebSocket of version 13: send `Sec-WebSocket-Version: 13`",
        ));
    }
    let malformed = |detail| Refusal(Problem::new(Code::MalformedRequest, detail)).into_response();
    let mut keys = headers
        .get_all(SEC_WEBSOCKET_KEY)
        .iter()
        .map(HeaderValue::as_bytes);
    let is_key = |key: &&[u8]| BASE64.decode(key).is_ok_and(|key| key.len() == KEY_BYTES);
    let key = keys.next().filter(is_key).filter(|_| keys.next().is_none());
    let key = key
        .ok_or_else(|| malformed("Sec-WebSocket-Key must be given once, as 16 bytes in base64"))?;
    if !request.body().is_end_stream() {
        return Err(malformed("a request that opens a WebSocket has no body"));
    }
    check_origin(headers, request.uri().authority(), origins)
        .map_err(|problem| Refusal(problem).into_response())?;
    let accept = HeaderValue::from_str(&derive_accept_key(key)).expect("base64 is visible ASCII");
    let upgrade = [
        (CONNECTION, HeaderValue::from_static("upgrade")),
        (UPGRADE, WEBSOCKET),
        (SEC_WEBSOCKET_ACCEPT, accept),
    ];
    let mut response = (StatusCode::SWITCHING_PROTOCOLS, upgrade, Body::empty()).into_response();
    if protocols(headers).any(|protocol| protocol == PROTOCOL) {
        response
            .headers_mut()
            .insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(PROTOCOL));
    }
    Ok(response)
}

fn upgrade_required(detail: &str) -> Response {
    let headers = [
        (UPGRADE, WEBSOCKET),
        (CONNECTION, HeaderValue::from_static("upgrade")),
        (SEC_WEBSOCKET_VERSION, VERSION),
    ];
    (
        headers,
        Refusal(Problem::new(Code::UpgradeRequired, detail)),
    )
        .into_response()
}

/// Browsers let a page of any site open a WebSocket to any other site, and send the page's origin.
fn check_origin(
    headers: &HeaderMap,
    target: Option<&Authority>,
    origins: &Origins,
) -> Result<(), Problem> {
    if is_same_origin(headers, target) || is_listed(headers, origins) {
        return Ok(());
    }
    Err(Problem::new(
        Code::Forbidden,
        "a page of another site may not open this socket: Origin and Host differ, and the origin \
            is not among those of --cors-origin",
    ))
}

#[cfg(test)]
mod tests {
    use axum::http::header::{HOST, ORIGIN};

    use super::*;

    #[test]
    fn pages_of_the_same_host_and_clients_without_a_page_may() {
        let others = Origins::parse("https://other.example").unwrap();
        let may = |host: &str, origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(ORIGIN, origin.parse().unwrap());
            }
            check_origin(&headers, None, &others).is_ok()
        };
        assert!(may("warp.example", None));
        for (host, origin) in [
            ("127.0.0.1:8080", "http://127.0.0.1:8080"),
            ("warp.example", "https://warp.example"),
            ("Warp.example:443", "https://warp.example"),
            ("warp.example", "http://warp.example:80"),
            ("[::1]:8080", "http://[::1]:8080"),
            ("warp.example", "https://other.example"),
        ] {
            assert!(may(host, Some(origin)), "{host} {origin}");
        }
        for (host, origin) in [
            ("127.0.0.1:8080", "http://127.0.0.1:8081"),
            ("warp.example", "https://warp.example.evil"),
            ("warp.example", "https://evil"),
            ("warp.example:443", "http://warp.example"),
            ("warp.example", "null"),
            ("warp.example", "http://other.example"),
            ("warp.example", "warp.example"),
        ] {
            assert!(!may(host, Some(origin)), "{host} {origin}");
        }
    }
}
