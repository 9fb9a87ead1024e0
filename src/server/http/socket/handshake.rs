//! The opening handshake of a WebSocket (RFC 6455, section 4.2) and who may open one.

use axum::body::{Body, HttpBody as _};
use axum::extract::Request;
use axum::http::header::{
    ALLOW, CONNECTION, HOST, HeaderName, ORIGIN, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_PROTOCOL, SEC_WEBSOCKET_VERSION,
    UPGRADE,
};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Version};
use axum::response::{IntoResponse as _, Response};
use data_encoding::BASE64;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

use crate::auth::cors::Origins;
use crate::http::middleware::keyed::{PROTOCOL, protocols};
use crate::problem::{Code, Problem};

const WEBSOCKET: HeaderValue = HeaderValue::from_static("websocket");
const THIRTEEN: HeaderValue = HeaderValue::from_static("13");
/// Bytes of a `Sec-WebSocket-Key`.
const KEY: usize = 16;

/// The answer to a request that opens a WebSocket; pages of these other sites may open one.
///
/// # Errors
/// What to answer instead: 405 to another method than GET, 426 to a request for something else, 400 to a malformed one, 403 to a page of
/// another site.
pub(crate) fn accept(request: &Request, others: &Origins) -> Result<Response, Response> {
    let headers = request.headers();
    if request.method() != Method::GET {
        let detail = format!("{} is not served on a WebSocket's route; see Allow", request.method());
        return Err(([(ALLOW, HeaderValue::from_static("GET"))], Problem::new(Code::MethodNotAllowed, detail)).into_response());
    }
    if request.version() != Version::HTTP_11 || !names(headers, &CONNECTION, "upgrade") || !names(headers, &UPGRADE, "websocket") {
        return Err(required("this route is a WebSocket: it takes an upgrade of an HTTP/1.1 connection"));
    }
    if headers.get(SEC_WEBSOCKET_VERSION) != Some(&THIRTEEN) {
        return Err(required("this route is a WebSocket of version 13"));
    }
    let malformed = |detail| Problem::new(Code::MalformedRequest, detail).into_response();
    let mut keys = headers.get_all(SEC_WEBSOCKET_KEY).iter();
    let key = keys.next().filter(|key| keys.next().is_none() && is_key(key.as_bytes()));
    let key = key.ok_or_else(|| malformed("Sec-WebSocket-Key must be given once, as 16 bytes in base64"))?;
    if !request.body().is_end_stream() {
        return Err(malformed("a request that opens a WebSocket has no body"));
    }
    same_site(headers, request.uri().authority(), others).map_err(axum::response::IntoResponse::into_response)?;
    let accept = HeaderValue::from_str(&derive_accept_key(key.as_bytes())).expect("base64 is visible ASCII");
    let mut answer = HeaderMap::with_capacity(16);
    answer.insert(CONNECTION, HeaderValue::from_static("upgrade"));
    answer.insert(UPGRADE, WEBSOCKET);
    answer.insert(SEC_WEBSOCKET_ACCEPT, accept);
    if protocols(headers).any(|protocol| protocol == PROTOCOL) {
        answer.insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(PROTOCOL));
    }
    Ok((StatusCode::SWITCHING_PROTOCOLS, answer, Body::empty()).into_response())
}

fn is_key(text: &[u8]) -> bool {
    BASE64.decode(text).is_ok_and(|key| key.len() == KEY)
}

fn required(detail: &str) -> Response {
    let headers = [(UPGRADE, WEBSOCKET), (CONNECTION, HeaderValue::from_static("upgrade")), (SEC_WEBSOCKET_VERSION, THIRTEEN)];
    (headers, Problem::new(Code::UpgradeRequired, detail)).into_response()
}

/// Whether a header's list holds this word.
fn names(headers: &HeaderMap, name: &HeaderName, word: &str) -> bool {
    let mut words = headers.get_all(name).iter().filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(','));
    words.any(|w| w.trim().eq_ignore_ascii_case(word))
}

/// A browser lets the page of any site open a WebSocket to any other, and says where the page is from.
fn same_site(headers: &HeaderMap, target: Option<&Authority>, others: &Origins) -> Result<(), Problem> {
    let origin = headers.get(ORIGIN).and_then(|origin| origin.to_str().ok());
    if is_of_this_site(headers, target) || origin.is_some_and(|origin| others.has(origin)) {
        return Ok(());
    }
    Err(Problem::new(
        Code::Forbidden,
        "a page of another site may not open this socket: Origin and Host differ, and the origin is not among those of --cors-origin",
    ))
}

/// No page asks, or one of the host that is asked. `target`: the host of the request's target, which counts before the header.
pub(crate) fn is_of_this_site(headers: &HeaderMap, target: Option<&Authority>) -> bool {
    let Some(origin) = headers.get(ORIGIN) else { return true };
    let ours = target.map(Authority::as_str).or_else(|| headers.get(HOST)?.to_str().ok());
    let theirs = origin.to_str().ok().and_then(|origin| origin.split_once("://"));
    ours.zip(theirs).is_some_and(|(ours, (scheme, theirs))| authority(ours, scheme) == authority(theirs, scheme))
}

/// Host and port in lower case; a scheme's own port need not be written.
fn authority(text: &str, scheme: &str) -> String {
    let own = if scheme == "https" { ":443" } else { ":80" };
    text.strip_suffix(own).unwrap_or(text).to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
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
            same_site(&headers, None, &others).is_ok()
        };
        assert!(may("bend.example", None));
        for (host, origin) in [
            ("127.0.0.1:8080", "http://127.0.0.1:8080"),
            ("bend.example", "https://bend.example"),
            ("Bend.example:443", "https://bend.example"),
            ("bend.example", "http://bend.example:80"),
            ("[::1]:8080", "http://[::1]:8080"),
            ("bend.example", "https://other.example"),
        ] {
            assert!(may(host, Some(origin)), "{host} {origin}");
        }
        for (host, origin) in [
            ("127.0.0.1:8080", "http://127.0.0.1:8081"),
            ("bend.example", "https://bend.example.evil"),
            ("bend.example", "https://evil"),
            ("bend.example:443", "http://bend.example"),
            ("bend.example", "null"),
            ("bend.example", "http://other.example"),
            ("bend.example", "bend.example"),
        ] {
            assert!(!may(host, Some(origin)), "{host} {origin}");
        }
    }
}
