//! A picture as an answer: the headers of the contract, and a body that ends the drawing when it is dropped.

pub(crate) mod problem;

use std::fmt::Write as _;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, TE, TRAILER, VARY};
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use http_body::Frame;
use mlswarp::warp::Report;
use tokio::sync::mpsc::UnboundedReceiver;

use crate::app::draw::{Drawn, Picture, Piece};
use crate::observe::stages::Cost;
use crate::observe::stages::Timing;

const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
const WARP_PLAN: HeaderName = HeaderName::from_static("warp-plan");
const WARP_FOLDS: HeaderName = HeaderName::from_static("warp-folds");
const WARP_RESIDUAL: HeaderName = HeaderName::from_static("warp-residual");
const WARP_WARNING: HeaderName = HeaderName::from_static("warp-warning");

/// The client takes trailers.
pub(crate) fn takes_trailers(headers: &HeaderMap) -> bool {
    headers.get_all(TE).iter().filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(',')).any(|t| t.trim().eq_ignore_ascii_case("trailers"))
}

/// What is told of a posed grid.
fn told(report: &Report, plan_built: bool) -> HeaderMap {
    let mut headers = HeaderMap::with_capacity(16);
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(WARP_PLAN, HeaderValue::from_static(if plan_built { "built" } else { "hit" }));
    headers.insert(WARP_FOLDS, report.folds.into());
    headers.insert(WARP_RESIDUAL, text(format!("{:.4}", report.residual)));
    if !report.warnings.is_empty() {
        headers.insert(WARP_WARNING, text(report.warnings.iter().map(|w| w.code()).collect::<Vec<_>>().join(", ")));
    }
    headers
}

fn text(text: String) -> HeaderValue {
    HeaderValue::from_str(&text).expect("numbers and codes are visible ASCII")
}

/// A posed grid as an answer: `body` is its JSON or its numbers.
pub(crate) fn mesh(report: &Report, timing: Timing, plan_built: bool, media_type: &'static str, body: Bytes) -> Response {
    let mut headers = told(report, plan_built);
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    headers.insert(SERVER_TIMING, text(timing_text(Some(timing), None)));
    (headers, body).into_response()
}

/// A picture as an answer.
pub(crate) fn picture(drawn: Drawn, trailers: bool) -> Response {
    let Drawn { report, etag, format, timing, plan_built, picture, .. } = drawn;
    let mut headers = told(&report, plan_built);
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    headers.insert(VARY, HeaderValue::from_static("accept"));
    headers.insert(ETAG, text(format!("\"{etag}\"")));
    let body = match picture {
        Picture::Whole { bytes, cost } => {
            headers.insert(SERVER_TIMING, text(timing_text(Some(timing), Some(cost))));
            Body::from(bytes)
        }
        Picture::Strips(strips) => {
            headers.insert(SERVER_TIMING, text(timing_text(Some(timing), None)));
            if trailers {
                headers.insert(TRAILER, HeaderValue::from_static("server-timing"));
            }
            Body::new(Strips { strips, trailers, ended: false })
        }
    };
    (headers, body).into_response()
}

/// `name;dur=ms, ...`
fn timing_text(timing: Option<Timing>, cost: Option<Cost>) -> String {
    let mut text = String::new();
    let mut put = |name: &str, duration: Duration| {
        let comma = if text.is_empty() { "" } else { ", " };
        // Writing to a string does not fail.
        let _ = write!(text, "{comma}{name};dur={:.3}", duration.as_secs_f64() * 1e3);
    };
    if let Some(Timing { queue, decode, plan, deform }) = timing {
        put("queue", queue);
        put("decode", decode);
        put("plan", plan);
        put("deform", deform);
    }
    if let Some(Cost { render, encode }) = cost {
        put("render", render);
        put("encode", encode);
    }
    text
}

/// The strips of a picture that is being made.
struct Strips {
    strips: UnboundedReceiver<Piece>,
    trailers: bool,
    ended: bool,
}

/// The drawing stopped before its end.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the picture was not finished")]
struct Unfinished;

impl HttpBody for Strips {
    type Data = Bytes;
    type Error = Unfinished;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Unfinished>>> {
        if self.ended {
            return Poll::Ready(None);
        }
        Poll::Ready(match ready!(self.strips.poll_recv(cx)) {
            Some(Piece::Bytes(bytes)) => Some(Ok(Frame::data(bytes))),
            Some(Piece::End(cost)) => {
                self.ended = true;
                let text = HeaderValue::from_str(&timing_text(None, Some(cost)));
                match text {
                    Ok(text) if self.trailers => Some(Ok(Frame::trailers(HeaderMap::from_iter([(SERVER_TIMING, text)])))),
                    _ => None,
                }
            }
            // The status has left already: breaking the connection is all that tells the client.
            None => {
                self.ended = true;
                Some(Err(Unfinished))
            }
        })
    }

    fn is_end_stream(&self) -> bool {
        self.ended
    }
}

/// JSON of the contract.
pub(crate) fn json(value: &impl serde::Serialize) -> Response {
    json_text(serde_json::to_vec(value).expect("objects of the contract have string keys").into())
}

/// JSON of the contract that is written already.
pub(crate) fn json_text(body: Bytes) -> Response {
    let headers = [(CONTENT_TYPE, HeaderValue::from_static("application/json")), (CACHE_CONTROL, HeaderValue::from_static("no-store"))];
    (headers, body).into_response()
}
