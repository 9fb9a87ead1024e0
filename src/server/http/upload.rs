//! Multipart uploads: the parts `image` (the file) and `warp` (the warp object), each once, in any order. The parser keeps what it has not yet
//! understood, as much as there is: so it is fed a frame at a time, and no more before it has come to something.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, ready};

use axum::body::{Body, HttpBody};
use axum::extract::multipart::Field;
use axum::extract::{DefaultBodyLimit, FromRequest as _, Multipart, Request};
use bytes::Bytes;
use http_body::Frame;

use super::body::{BodyBuffer, ReadError, media_type, read_problem, too_large};
use crate::app::App;
use crate::client::Client;
use crate::limits::memory::Purpose;
use crate::problem::{Code, Problem};

/// What the parser may keep of which nothing has come: the head of a part, and what lies before the first.
const HEADS: u64 = 16 << 10;
/// What it takes with that: a frame before, a frame after, and room to grow.
const PARSER: u64 = 128 << 10;

/// The two parts.
#[derive(Debug)]
pub(crate) struct Upload {
    /// The file.
    pub(crate) image: Bytes,
    /// The warp object.
    pub(crate) warp: Bytes,
}

/// The request has a multipart body.
pub(crate) fn is_multipart(request: &Request) -> bool {
    media_type(request).as_deref() == Some("multipart/form-data")
}

/// Reads both parts. The whole body is limited before this; `warp` has a limit of its own.
pub(crate) async fn read(app: &App, client: Client, mut request: Request) -> Result<Upload, Problem> {
    if !is_multipart(&request) {
        return Err(Problem::new(Code::UnsupportedMediaType, "this route takes multipart/form-data with the parts `image` and `warp`"));
    }
    // The guard around every body has the limit; axum's own default is below it.
    DefaultBodyLimit::disable().apply(&mut request);
    let _parser = app.reserve_for(Purpose::Upload, &app.request_quota(client), PARSER)?;
    let unread = Unread::default();
    let request = request.map(|body| Body::new(FrameGate { body, unread: unread.clone(), fed: false }));
    let mut parts = Multipart::from_request(request, &()).await.map_err(|e| malformed(e.body_text()))?;
    let (mut image, mut warp) = (None, None);
    while let Some(part) = parts.next_field().await.map_err(|e| read_problem(&e, "the multipart body could not be read"))? {
        unread.begin();
        let name = part.name().unwrap_or_default().to_owned();
        let (slot, limit) = match name.as_str() {
            "image" => (&mut image, u64::MAX),
            "warp" => (&mut warp, app.config().max_warp_json_bytes),
            _ => {
                let name: String = name.chars().take(60).collect();
                return Err(malformed(format!("a part is named `{name}`; the parts are `image` and `warp`")));
            }
        };
        if slot.is_some() {
            return Err(malformed(format!("the part `{name}` comes twice")));
        }
        *slot = Some(part_bytes(app, client, part, limit, &unread).await?);
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

async fn part_bytes(app: &App, client: Client, mut part: Field<'_>, limit: u64, unread: &Unread) -> Result<Bytes, Problem> {
    let mut read = BodyBuffer::new(app, client, Purpose::Upload)?;
    while let Some(chunk) = part.chunk().await.map_err(|e| read_problem(&e, "the multipart body could not be read"))? {
        unread.begin();
        let length = read.len() + chunk.len() as u64;
        if length > limit {
            return Err(too_large("warp_json_bytes", limit, length));
        }
        read.push(&chunk)?;
    }
    Ok(read.fit())
}

/// Bytes that the parser was fed since something came of them.
#[derive(Clone, Default)]
struct Unread(Arc<AtomicU64>);

impl Unread {
    fn begin(&self) {
        self.0.store(0, Ordering::Relaxed);
    }
}

/// A body that is handed over a frame at a time, as long as something comes of it.
struct FrameGate {
    body: Body,
    unread: Unread,
    /// The parser has a frame that it has not looked at: it asks until there is none.
    fed: bool,
}

impl HttpBody for FrameGate {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        if std::mem::take(&mut this.fed) {
            cx.waker().wake_by_ref();
            return Poll::Pending;
        }
        if this.unread.0.load(Ordering::Relaxed) > HEADS {
            return Poll::Ready(Some(Err(axum::Error::new(ReadError::PartOverheadTooLarge { limit: HEADS }))));
        }
        let frame = ready!(Pin::new(&mut this.body).poll_frame(cx));
        if let Some(data) = frame.as_ref().and_then(|frame| frame.as_ref().ok()).and_then(Frame::data_ref) {
            this.unread.0.fetch_add(data.len() as u64, Ordering::Relaxed);
            this.fed = true;
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.body.size_hint()
    }
}
