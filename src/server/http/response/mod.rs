//! Responses: images, meshes and JSON, with the headers of the contract. Dropping an image's
//! body cancels the drawing.

pub(crate) mod problem;

pub(crate) use problem::Refusal;

use std::convert::Infallible;
use std::io;
use std::task::{Poll, ready};

use axum::body::Body;
use axum::http::header::{CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, ETAG, TE, TRAILER, VARY};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use futures_util::stream::{Stream, StreamExt as _, empty, iter, once, poll_fn, unfold};
use http_body::Frame;
use http_body_util::StreamBody;
use mlswarp::warp::Report;
use tokio::sync::mpsc::UnboundedReceiver;

use crate::app::batch::{Batch, BatchForm};
use crate::app::draw::{Drawn, Piece};
use crate::app::map::MapFile;
use crate::app::mesh::PoseResponse;
use crate::app::plan::{PlanContent, PlanFile};
use crate::app::points::MappedFile;
use crate::app::session_object::ShownSession;
use crate::http::headers::elements;
use crate::observe::stages::{Cost, Timing};
use crate::problem::Problem;
use crate::wire::canvas_text;

const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
const WARP_CANVAS: HeaderName = HeaderName::from_static("warp-canvas");
const WARP_FRAMES: HeaderName = HeaderName::from_static("warp-frames");
const WARP_METHOD: HeaderName = HeaderName::from_static("warp-method");
const WARP_PLAN: HeaderName = HeaderName::from_static("warp-plan");
const WARP_FOLDS: HeaderName = HeaderName::from_static("warp-folds");
const WARP_RESIDUAL: HeaderName = HeaderName::from_static("warp-residual");
const WARP_WARNING: HeaderName = HeaderName::from_static("warp-warning");

/// Mapped annotations, of which later parts are mapped as they are sent.
pub(crate) fn mapped(file: MappedFile) -> Response {
    let MappedFile {
        warnings,
        canvas,
        method,
        first,
        rest,
    } = file;
    let mut headers = HeaderMap::new();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/json"));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    if let Some(canvas) = canvas {
        headers.insert(WARP_CANVAS, text(canvas_text(canvas)));
    }
    insert_warnings(&mut headers, &warnings);
    let response = match rest {
        None => (headers, first).into_response(),
        Some(rest) => streamed(
            headers,
            first,
            unfold(rest, async |mut rest| Some((rest.next().await?, rest))),
        ),
    };
    with_method(response, method)
}

/// A response with the warnings of its handles.
pub(crate) fn with_warnings(
    mut response: Response,
    warnings: &[mlswarp::warp::Warning],
) -> Response {
    insert_warnings(response.headers_mut(), warnings);
    response
}

/// A response with the method that was chosen, if that was requested.
pub(crate) fn with_method(mut response: Response, method: Option<String>) -> Response {
    if let Some(method) = method {
        response.headers_mut().insert(WARP_METHOD, text(method));
    }
    response
}

fn insert_warnings(headers: &mut HeaderMap, warnings: &[mlswarp::warp::Warning]) {
    if !warnings.is_empty() {
        headers.insert(
            WARP_WARNING,
            text(
                warnings
                    .iter()
                    .map(|w| w.code())
                    .collect::<Vec<_>>()
                    .join(", "),
            ),
        );
    }
}

/// Whether the client accepts trailers.
pub(crate) fn takes_trailers(headers: &HeaderMap) -> bool {
    elements(headers, TE).any(|coding| coding.eq_ignore_ascii_case("trailers"))
}

/// The headers of a posed grid.
fn report_headers(report: &Report, plan_built: bool) -> HeaderMap {
    let mut headers = HeaderMap::with_capacity(16);
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(
        WARP_PLAN,
        HeaderValue::from_static(if plan_built { "built" } else { "hit" }),
    );
    headers.insert(WARP_FOLDS, report.folds.into());
    headers.insert(WARP_RESIDUAL, text(format!("{:.4}", report.residual)));
    insert_warnings(&mut headers, &report.warnings);
    headers
}

fn text(text: String) -> HeaderValue {
    HeaderValue::try_from(text).expect("numbers and codes are visible ASCII")
}

/// A posed grid, or what was measured of it.
pub(crate) fn mesh(response: PoseResponse, media_type: &'static str) -> Response {
    let PoseResponse {
        report,
        timing,
        plan_built,
        body,
        ..
    } = response;
    let mut headers = report_headers(&report, plan_built);
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(media_type));
    headers.insert(SERVER_TIMING, text(timing_text(Some(timing), None)));
    (headers, body).into_response()
}

/// An image.
pub(crate) fn picture(drawn: Drawn, trailers: bool) -> Response {
    let Drawn {
        report,
        etag,
        target,
        format,
        timing,
        plan_built,
        first,
        rest,
    } = drawn;
    let mut headers = report_headers(&report, plan_built);
    if let Some(canvas) = target.canvas {
        headers.insert(WARP_CANVAS, text(canvas_text(canvas)));
    }
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    headers.insert(VARY, HeaderValue::from_static("accept"));
    headers.insert(ETAG, text(format!("\"{etag}\"")));
    let body = match rest {
        None => {
            headers.insert(SERVER_TIMING, text(timing_text(Some(timing), first.end)));
            Body::from(first.bytes)
        }
        Some(rest) => {
            headers.insert(SERVER_TIMING, text(timing_text(Some(timing), None)));
            if trailers {
                headers.insert(TRAILER, HeaderValue::from_static("server-timing"));
            }
            strip_body(first, rest, trailers)
        }
    };
    (headers, body).into_response()
}

/// A table of coefficients, its length, or 304 if the client has it.
pub(crate) fn plan(PlanFile { etag, content }: PlanFile) -> Response {
    let headers = [
        (ETAG, text(etag)),
        (CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    let media_type = (
        CONTENT_TYPE,
        HeaderValue::from_static("application/octet-stream"),
    );
    match content {
        PlanContent::Known => (StatusCode::NOT_MODIFIED, headers).into_response(),
        PlanContent::Length(length) => {
            (headers, [media_type, (CONTENT_LENGTH, length.into())]).into_response()
        }
        PlanContent::File(timing, bytes) => (
            headers,
            [
                media_type,
                (SERVER_TIMING, text(timing_text(Some(timing), None))),
            ],
            bytes,
        )
            .into_response(),
    }
}

/// A coordinate map, computed as it is sent.
pub(crate) fn map(file: MapFile) -> Response {
    let MapFile {
        report,
        timing,
        plan_built,
        etag,
        canvas,
        format,
        length,
        first,
        rest,
    } = file;
    let mut headers = report_headers(&report, plan_built);
    if let Some(canvas) = canvas {
        headers.insert(WARP_CANVAS, text(canvas_text(canvas)));
    }
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    headers.insert(CONTENT_LENGTH, length.into());
    headers.insert(VARY, HeaderValue::from_static("accept"));
    headers.insert(ETAG, text(format!("\"{etag}\"")));
    headers.insert(SERVER_TIMING, text(timing_text(Some(timing), None)));
    let rest = unfold(rest, async |mut rest| Some((rest.next().await?, rest)));
    streamed(headers, first, rest)
}

/// The value of `Server-Timing`.
fn timing_text(timing: Option<Timing>, cost: Option<Cost>) -> String {
    let mut stages = Vec::with_capacity(7);
    if let Some(Timing {
        queue,
        decode,
        plan,
        reduce,
        deform,
    }) = timing
    {
        stages.extend([("queue", queue), ("decode", decode), ("plan", plan)]);
        stages.extend((!reduce.is_zero()).then_some(("reduce", reduce)));
        stages.push(("deform", deform));
    }
    if let Some(Cost { render, encode }) = cost {
        stages.extend([("render", render), ("encode", encode)]);
    }
    let texts = stages
        .into_iter()
        .map(|(name, duration)| format!("{name};dur={:.3}", duration.as_secs_f64() * 1e3));
    texts.collect::<Vec<_>>().join(", ")
}

/// The body of an image that is still being drawn.
fn strip_body(first: Piece, mut rest: UnboundedReceiver<Piece>, trailers: bool) -> Body {
    let (mut first, mut is_ended, mut trailer) = (Some(first), false, None);
    Body::new(StreamBody::new(poll_fn(move |cx| {
        if is_ended {
            let timing =
                |cost| HeaderMap::from_iter([(SERVER_TIMING, text(timing_text(None, Some(cost))))]);
            return Poll::Ready(trailer.take().map(|cost| Ok(Frame::trailers(timing(cost)))));
        }
        let piece = match first.take() {
            Some(first) => Some(first),
            None => ready!(rest.poll_recv(cx)),
        };
        let end = piece.as_ref().map(|piece| piece.end);
        is_ended = end.is_none_or(|end| end.is_some());
        trailer = end.flatten().filter(|_| trailers);
        // The status was sent already: only a broken connection tells the client.
        Poll::Ready(Some(
            piece
                .map(|piece| Frame::data(piece.bytes))
                .ok_or_else(|| io::Error::other("the picture was not finished")),
        ))
    })))
}

/// The headers of a blend in a file of several parts.
pub(crate) fn blend_headers(form: BatchForm, frames: usize) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(form.media_type()));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(VARY, HeaderValue::from_static("accept"));
    headers.insert(WARP_FRAMES, frames.into());
    headers
}

/// The headers of a batch.
pub(crate) fn batch_headers(batch: &Batch, form: BatchForm) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(form.media_type()));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(VARY, HeaderValue::from_static("accept"));
    headers.insert(WARP_FRAMES, batch.frames.into());
    headers.insert(
        WARP_PLAN,
        HeaderValue::from_static(if batch.plan_built { "built" } else { "hit" }),
    );
    if let Some(canvas) = batch.canvas {
        headers.insert(WARP_CANVAS, text(canvas_text(canvas)));
    }
    insert_warnings(&mut headers, &batch.warnings);
    headers
}

/// A response whose body is computed as the client takes it: the next piece when hyper asks for it.
/// The first piece is known, so that its problems are problem documents. A later problem ends the
/// connection, which is all that can still be said.
pub(crate) fn streamed(
    headers: HeaderMap,
    first: Bytes,
    rest: impl Stream<Item = Result<Bytes, Problem>> + Send + 'static,
) -> Response {
    let failed = |problem: Problem| {
        tracing::warn!(%problem, "a response ends before it is complete");
        io::Error::other(problem)
    };
    let rest = rest.map(move |piece| piece.map_err(failed));
    (
        headers,
        Body::from_stream(once(async { Ok(first) }).chain(rest)),
    )
        .into_response()
}

/// The session object, with the warnings of its handles.
pub(crate) fn session(shown: ShownSession) -> Response {
    let mut headers = json_headers();
    insert_warnings(&mut headers, shown.warnings());
    let pieces = shown.into_json();
    let length: usize = pieces.iter().map(Bytes::len).sum();
    headers.insert(CONTENT_LENGTH, length.into());
    (
        headers,
        Body::from_stream(iter(pieces.map(Ok::<_, Infallible>))),
    )
        .into_response()
}

/// The head of a JSON response whose content is not wanted.
pub(crate) fn json_head() -> Response {
    // Without `Content-Length`: the length is known only when the content has been made.
    (
        json_headers(),
        Body::from_stream(empty::<Result<Bytes, Infallible>>()),
    )
        .into_response()
}

/// A JSON value.
pub(crate) fn json(value: &impl serde::Serialize) -> Response {
    json_text(
        serde_json::to_vec(value)
            .expect("objects of the contract have string keys")
            .into(),
    )
}

/// Serialized JSON.
pub(crate) fn json_text(body: Bytes) -> Response {
    (json_headers(), body).into_response()
}

fn json_headers() -> HeaderMap {
    let media_type = HeaderValue::from_static("application/json");
    HeaderMap::from_iter([
        (CONTENT_TYPE, media_type),
        (CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ])
}
