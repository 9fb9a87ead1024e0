//! Multipart uploads: the parts `image` (the file) and `warp` (the warp object), each once, in any order.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Poll, ready};

use axum::body::Body;
use axum::extract::multipart::Field;
use axum::extract::{DefaultBodyLimit, FromRequest as _, Multipart, Request};
use bytes::Bytes;
use futures_util::StreamExt as _;
use futures_util::stream::poll_fn;

use super::body::{BodyBuffer, read_problem};
use super::headers::media_type;
use super::middleware::authentication::Caller;
use crate::limits::memory::Purpose;
use crate::problem::{Code, Problem};

/// Bytes that the parser may buffer without a result: the head of a part, and what precedes the first part.
const MAX_OVERHEAD: u64 = 16 << 10;
/// Memory of the parser: that, a frame before, a frame after, and capacity to grow.
const PARSER_BYTES: u64 = 128 << 10;

/// The two parts.
#[derive(Debug)]
pub(crate) struct Upload {
    /// The file.
    pub(crate) image: Bytes,
    /// The warp object.
    pub(crate) warp: Bytes,
}

/// Reads both parts. The limit of the whole body is checked before; `warp` has a limit of its own.
pub(crate) async fn read(caller: &Caller, mut request: Request) -> Result<Upload, Problem> {
    if media_type(request.headers()).as_deref() != Some("multipart/form-data") {
        let detail = format!(
            "{} {} takes multipart/form-data with the parts `image` and `warp`; to warp the picture of a session, send JSON to POST \
             /sessions/{{id}}/warp",
            request.method(),
            request.uri().path()
        );
        return Err(Problem::new(Code::UnsupportedMediaType, detail));
    }
    // axum's default limit is lower than that of `LimitedBody`.
    DefaultBodyLimit::disable().apply(&mut request);
    let Caller { app, client } = caller;
    let _parser = app.reserve_for(Purpose::Upload, &app.request_quota(*client), PARSER_BYTES)?;
    let buffered = Arc::new(AtomicU64::new(0));
    let request = request.map(|body| gated(body, Arc::clone(&buffered)));
    let mut parts = Multipart::from_request(request, &()).await.map_err(|error| malformed(error.body_text()))?;
    let (mut image, mut warp) = (None, None);
    while let Some(part) = parts.next_field().await.map_err(unreadable)? {
        buffered.store(0, Ordering::Relaxed);
        let name = part.name().unwrap_or_default().to_owned();
        let (slot, limit) = match name.as_str() {
            "image" => (&mut image, u64::MAX),
            "warp" => (&mut warp, app.config().max_warp_json_bytes),
            _ => {
                let name: String = name.chars().take(60).collect();
                return Err(malformed(format!("unknown part `{name}`; the parts are `image` and `warp`")));
            }
        };
        if slot.is_some() {
            return Err(malformed(format!("the part `{name}` occurs twice")));
        }
        *slot = Some(read_part(caller, part, limit, &buffered).await?);
    }
    match (image, warp) {
        (Some(image), Some(warp)) => Ok(Upload { image, warp }),
        (None, None) => Err(malformed("the parts `image` and `warp` are missing")),
        (None, _) => Err(malformed("the part `image` is missing")),
        (_, None) => Err(malformed("the part `warp` is missing")),
    }
}

fn malformed(detail: impl Into<String>) -> Problem {
    Problem::new(Code::MalformedRequest, detail)
}

fn unreadable(error: axum::extract::multipart::MultipartError) -> Problem {
    read_problem(&error, "the multipart body could not be read")
}

async fn read_part(caller: &Caller, mut part: Field<'_>, limit: u64, buffered: &AtomicU64) -> Result<Bytes, Problem> {
    let mut buffer = BodyBuffer::new(&caller.app, caller.client, Purpose::Upload)?;
    while let Some(chunk) = part.chunk().await.map_err(unreadable)? {
        buffered.store(0, Ordering::Relaxed);
        buffer.push(&chunk, "warp_json_bytes", limit)?;
    }
    Ok(buffer.finish_exact())
}

/// Passes data to the multipart parser one frame at a time, and fails when the parser buffers too much: it keeps everything that it cannot
/// parse yet. `buffered`: bytes passed to the parser since its last result.
fn gated(body: Body, buffered: Arc<AtomicU64>) -> Body {
    let mut frames = body.into_data_stream();
    // The parser polls until nothing is ready, and only then looks at what it has.
    let mut has_new_frame = false;
    Body::from_stream(poll_fn(move |cx| {
        if std::mem::take(&mut has_new_frame) {
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
        if buffered.load(Ordering::Relaxed) > MAX_OVERHEAD {
            let detail = format!("the heads of the parts, and what lies between the parts, are longer than {MAX_OVERHEAD} bytes");
            return Poll::Ready(Some(Err(axum::Error::new(malformed(detail)))));
        }
        let frame = ready!(frames.poll_next_unpin(cx));
        if let Some(Ok(data)) = &frame {
            buffered.fetch_add(data.len() as u64, Ordering::Relaxed);
            has_new_frame = true;
        }
        Poll::Ready(frame)
    }))
}
