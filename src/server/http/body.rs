//! Request bodies behind a limit and one deadline for the whole of them. A body that is dropped before its end is drained, for as long again and
//! into nothing, so that a client which writes first and reads later finds the answer instead of a broken connection, however large its body is.

use std::future::Future as _;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::extract::Request;
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE};
use bytes::Bytes;
use http_body::Frame;
use http_body_util::BodyExt as _;
use tokio::time::{Sleep, sleep};

use crate::app::App;
use crate::client::Client;
use crate::limits::memory::{Purpose, Reservation};
use crate::problem::{Code, Problem};

/// Why a body ended early.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(crate) enum ReadError {
    /// More bytes than the limit.
    #[error("the body is larger than {limit} bytes")]
    TooLarge {
        /// The limit.
        limit: u64,
    },
    /// What a multipart body says beside its parts.
    #[error("the heads of the parts, and what lies between the parts, are longer than {limit} bytes")]
    PartOverheadTooLarge {
        /// The limit.
        limit: u64,
    },
    /// Not whole in time.
    #[error("the body was not whole within {} s", .within.as_secs_f64())]
    TooSlow {
        /// The deadline.
        within: Duration,
    },
}

impl From<ReadError> for Problem {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::TooLarge { limit } => too_large("body_bytes", limit, limit.saturating_add(1)),
            ReadError::PartOverheadTooLarge { .. } => Self::new(Code::MalformedRequest, error.to_string()),
            ReadError::TooSlow { .. } => Self::new(Code::Timeout, error.to_string()),
        }
    }
}

/// 413.
pub(crate) fn too_large(what: &'static str, limit: u64, actual: u64) -> Problem {
    let of = match what {
        "warp_json_bytes" => "the part `warp`",
        "drag_json_bytes" => "the JSON of a drag",
        _ => "the body",
    };
    Problem::new(Code::TooLarge, format!("{of} has at least {actual} bytes; at most {limit}")).limit(what, limit, actual)
}

/// What went wrong while a body was read; `doing` says what it was read for.
pub(crate) fn read_problem(error: &(dyn std::error::Error + 'static), doing: &str) -> Problem {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(ours) = error.downcast_ref::<ReadError>() {
            return (*ours).into();
        }
        cause = error.source();
    }
    Problem::new(Code::MalformedRequest, format!("{doing}: {error}"))
}

/// Whether a request waits for bytes of its body, that is, for its client.
#[derive(Clone, Debug, Default)]
pub(crate) struct Waiting(Arc<AtomicBool>);

impl Waiting {
    pub(crate) fn is_for_client(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn set(&self, is_for_client: bool) {
        self.0.store(is_for_client, Ordering::Relaxed);
    }
}

/// A body with a limit and a deadline.
#[derive(Debug)]
pub(crate) struct LimitedBody {
    body: Option<Body>,
    left: u64,
    limit: u64,
    within: Duration,
    deadline: Pin<Box<Sleep>>,
    waiting: Waiting,
}

impl LimitedBody {
    /// `waits`: the client asked for permission first (`Expect: 100-continue`); there is nothing to drain.
    pub(crate) fn wrap(body: Body, limit: u64, within: Duration, waits: bool, waiting: Waiting) -> Body {
        if body.is_end_stream() {
            return body;
        }
        let guard = Self { body: Some(body), left: limit, limit, within, deadline: Box::pin(sleep(within)), waiting };
        if waits { Body::new(ExpectContinueBody(guard)) } else { Body::new(guard) }
    }
}

impl HttpBody for LimitedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        let Some(body) = &mut this.body else { return Poll::Ready(None) };
        if this.deadline.as_mut().poll(cx).is_ready() {
            this.body = None;
            return Poll::Ready(Some(Err(axum::Error::new(ReadError::TooSlow { within: this.within }))));
        }
        let polled = Pin::new(body).poll_frame(cx);
        this.waiting.set(polled.is_pending());
        let frame = ready!(polled);
        match &frame {
            None | Some(Err(_)) => this.body = None,
            Some(Ok(frame)) => {
                let read = frame.data_ref().map_or(0, |data| data.len() as u64);
                if read > this.left {
                    // Dropping `self` drains what is left of the body.
                    this.left = 0;
                    return Poll::Ready(Some(Err(axum::Error::new(ReadError::TooLarge { limit: this.limit }))));
                }
                this.left -= read;
            }
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.as_ref().is_none_or(HttpBody::is_end_stream)
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.body.as_ref().map(HttpBody::size_hint).unwrap_or_default()
    }
}

impl Drop for LimitedBody {
    fn drop(&mut self) {
        self.waiting.set(false);
        if let Some(body) = self.body.take().filter(|body| !body.is_end_stream())
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            runtime.spawn(drain(body, self.within));
        }
    }
}

async fn drain(mut body: Body, within: Duration) {
    let read = async { while let Some(Ok(_)) = body.frame().await {} };
    // Whether it ended or was given up, the body is dropped now.
    let _ = tokio::time::timeout(within, read).await;
}

/// A guarded body whose client sends nothing before it is told to.
#[derive(Debug)]
struct ExpectContinueBody(LimitedBody);

impl HttpBody for ExpectContinueBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.0).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.0.is_end_stream()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.0.size_hint()
    }
}

impl Drop for ExpectContinueBody {
    fn drop(&mut self) {
        // Reading would give the permission.
        if self.0.left == self.0.limit {
            self.0.body = None;
        }
    }
}

/// The media type of the body, lower case, without parameters.
pub(crate) fn media_type(request: &Request) -> Option<String> {
    let text = request.headers().get(CONTENT_TYPE)?.to_str().ok()?;
    Some(text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

/// What a request takes beside its body while that is read: its head, its task, its stream.
const BESIDE: u64 = 16 << 10;

/// Bytes that grow as they arrive; their memory is in the account before they are kept.
pub(crate) struct BodyBuffer<'a> {
    app: &'a App,
    bytes: Vec<u8>,
    held: Reservation,
}

impl<'a> BodyBuffer<'a> {
    pub(crate) fn new(app: &'a App, client: Client, purpose: Purpose) -> Result<Self, Problem> {
        Ok(Self { app, bytes: Vec::new(), held: app.reserve_for(purpose, &app.request_quota(client), BESIDE)? })
    }

    pub(crate) fn len(&self) -> u64 {
        self.bytes.len() as u64
    }

    pub(crate) fn push(&mut self, data: &[u8]) -> Result<(), Problem> {
        let needed = self.bytes.len() + data.len();
        if needed > self.bytes.capacity() {
            let room = needed.max(2 * self.bytes.capacity());
            // Both copies are there while it moves.
            self.app.reserve_more(&mut self.held, room as u64)?;
            self.bytes.reserve_exact(room - self.bytes.len());
            self.held.shrink_to(BESIDE + self.bytes.capacity() as u64);
        }
        self.bytes.extend_from_slice(data);
        Ok(())
    }

    /// As they are; a buffer that grew is up to twice as large as what it holds.
    pub(crate) fn finish(mut self) -> Bytes {
        self.held.shrink_to(self.bytes.capacity() as u64);
        self.held.attach(self.bytes)
    }

    /// Exactly: a session keeps them for minutes.
    pub(crate) fn fit(mut self) -> Bytes {
        self.bytes.shrink_to_fit();
        self.finish()
    }
}

/// A JSON body of at most `limit` bytes. A drag's is read for its frame: it is not kept out by uploads.
pub(crate) async fn json(
    app: &App,
    client: Client,
    request: Request,
    purpose: Purpose,
    what: &'static str,
    limit: u64,
) -> Result<Bytes, Problem> {
    if media_type(&request).as_deref() != Some("application/json") {
        return Err(Problem::new(Code::UnsupportedMediaType, "this route takes application/json"));
    }
    let length = request.headers().get(CONTENT_LENGTH).and_then(|n| n.to_str().ok()).and_then(|n| n.parse::<u64>().ok());
    if let Some(length) = length.filter(|n| *n > limit) {
        return Err(too_large(what, limit, length));
    }
    let mut body = request.into_body();
    let mut read = BodyBuffer::new(app, client, purpose)?;
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|e| read_problem(&e, "the body could not be read"))?;
        if let Ok(data) = frame.into_data() {
            let length = read.len() + data.len() as u64;
            if length > limit {
                return Err(too_large(what, limit, length));
            }
            read.push(&data)?;
        }
    }
    Ok(read.finish())
}
