//! Request bodies: a limit and a deadline for the whole body, and buffers whose memory is reserved
//! before they grow.

use std::future::Future as _;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::extract::Request;
use axum::http::HeaderMap;
use bytes::Bytes;
use http_body::Frame;
use http_body_util::BodyExt as _;
use tokio::time::{Sleep, sleep, timeout_at};

pub(crate) use super::capped_body::too_large;
use super::headers::{content_length, media_type};
use super::middleware::authentication::Caller;
use crate::app::App;
use crate::client::Client;
use crate::limits::free::free;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::pool::aside;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};

/// The problem of a failed read: that of [`LimitedBody`] or of the multipart gate among the causes,
/// or a malformed body with `context`.
pub(crate) fn read_problem(error: &(dyn std::error::Error + 'static), context: &str) -> Problem {
    let causes = std::iter::successors(Some(error), |error| error.source());
    let problem = causes
        .filter_map(|error| error.downcast_ref::<Problem>())
        .next()
        .cloned();
    problem.unwrap_or_else(|| Problem::new(Code::MalformedRequest, format!("{context}: {error}")))
}

/// The time for which the rest of a body is read and discarded that is too large, or may have no
/// end.
const LINGER_TIME: Duration = Duration::from_secs(2);

/// A body with a limit and a deadline. When it is dropped early, the rest is read and discarded, so
/// that a client which sends its whole body before it reads finds the response instead of a reset
/// connection: until the deadline if the rest has a length within the limit, and otherwise for
/// [`LINGER_TIME`] at most, as the rest could be endless.
#[derive(Debug)]
pub(crate) struct LimitedBody {
    body: Option<Body>,
    left: u64,
    limit: u64,
    timeout: Duration,
    deadline: Pin<Box<Sleep>>,
    expects_continue: bool,
    /// Whether the request is waiting for bytes of its body, that is, for its client.
    waits: Arc<AtomicBool>,
}

impl LimitedBody {
    /// `expects_continue`: the client sends the body only after `100 Continue`, which the first
    /// read makes hyper send.
    pub(crate) fn wrap(
        body: Body,
        limit: u64,
        timeout: Duration,
        expects_continue: bool,
        waits: Arc<AtomicBool>,
    ) -> Body {
        if body.is_end_stream() {
            return body;
        }
        let deadline = Box::pin(sleep(timeout));
        Body::new(Self {
            body: Some(body),
            left: limit,
            limit,
            timeout,
            deadline,
            expects_continue,
            waits,
        })
    }
}

impl HttpBody for LimitedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        let Some(body) = &mut this.body else {
            return Poll::Ready(None);
        };
        if this.deadline.as_mut().poll(cx).is_ready() {
            this.body = None;
            let detail = format!(
                "the body was not complete after {} s",
                this.timeout.as_secs_f64()
            );
            return Poll::Ready(Some(Err(axum::Error::new(Problem::new(
                Code::Timeout,
                detail,
            )))));
        }
        let polled = Pin::new(body).poll_frame(cx);
        this.waits.store(polled.is_pending(), Ordering::Relaxed);
        let frame = ready!(polled);
        match &frame {
            None | Some(Err(_)) => this.body = None,
            Some(Ok(frame)) => {
                let length = frame.data_ref().map_or(0, |data| data.len() as u64);
                let Some(left) = this.left.checked_sub(length) else {
                    // The body stays: it is drained when `self` is dropped.
                    this.left = 0;
                    let problem = too_large("body_bytes", this.limit, this.limit.saturating_add(1));
                    return Poll::Ready(Some(Err(axum::Error::new(problem))));
                };
                this.left = left;
            }
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.body.as_ref().is_none_or(HttpBody::is_end_stream)
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.body
            .as_ref()
            .map(HttpBody::size_hint)
            .unwrap_or_default()
    }
}

impl Drop for LimitedBody {
    fn drop(&mut self) {
        self.waits.store(false, Ordering::Relaxed);
        let is_withheld = self.expects_continue && self.left == self.limit;
        if let Some(mut body) = self
            .body
            .take()
            .filter(|body| !is_withheld && !body.is_end_stream())
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            let ends = body
                .size_hint()
                .upper()
                .is_some_and(|rest| rest <= self.left);
            let until = tokio::time::Instant::now() + LINGER_TIME;
            let until = if ends {
                self.deadline.deadline()
            } else {
                until.min(self.deadline.deadline())
            };
            runtime.spawn(timeout_at(until, async move {
                while let Some(Ok(_)) = body.frame().await {}
            }));
        }
    }
}

/// Buffers of more bytes are moved on a blocking thread. To move as many takes 0.05 ms, with the
/// pages of the new buffer; the two hand-overs to a thread and back take 0.1 ms.
const MAX_COPIED_INLINE_BYTES: usize = 256 << 10;
/// A buffer that a session keeps may have this share of unused bytes: one in this number.
const MAX_UNUSED_SHARE: usize = 64;
/// Memory of a request beside its body: its head, its task, its stream.
const REQUEST_BYTES: u64 = 16 << 10;

/// A growing buffer. Its memory is reserved before it is allocated.
pub(crate) struct BodyBuffer<'a> {
    app: &'a App,
    bytes: Vec<u8>,
    held: Reservation,
    /// The client has announced no more bytes than these.
    announced: usize,
}

impl<'a> BodyBuffer<'a> {
    pub(crate) async fn new(
        app: &'a App,
        client: Client,
        purpose: MemoryClass,
        announced: Option<u64>,
    ) -> Result<Self, Problem> {
        let quota = app.admission.request_quota(client);
        let held = app
            .admission
            .reserve_aside(|budget| budget.take_for(purpose, &quota, REQUEST_BYTES))
            .await?;
        Ok(Self {
            app,
            bytes: Vec::new(),
            held,
            announced: announced.map_or(usize::MAX, |bytes| {
                usize::try_from(bytes).unwrap_or(usize::MAX)
            }),
        })
    }

    /// Appends data. The buffer may have at most `limit` bytes; `what` names the limit.
    pub(crate) async fn push(
        &mut self,
        data: &[u8],
        what: &'static str,
        limit: u64,
    ) -> Result<(), Problem> {
        let needed = self.bytes.len() + data.len();
        if needed as u64 > limit {
            return Err(too_large(what, limit, needed as u64));
        }
        if needed > self.bytes.capacity() {
            // Several times as large, so that few bytes are moved often, and never larger than what
            // is announced, of which a quarter must have come.
            let factor = if self.announced == usize::MAX { 2 } else { 4 };
            let capacity = needed.max((factor * self.bytes.capacity()).min(self.announced));
            // While the bytes are moved, both allocations exist.
            self.app
                .admission
                .reserve_aside(|_| self.held.grow(capacity as u64))
                .await?;
            let mut bytes = std::mem::take(&mut self.bytes);
            let is_long = bytes.len() > MAX_COPIED_INLINE_BYTES;
            let grow = move || {
                bytes.reserve_exact(capacity - bytes.len());
                bytes
            };
            self.bytes = aside(is_long, grow).await;
            self.held
                .shrink_to(REQUEST_BYTES + self.bytes.capacity() as u64);
        }
        self.bytes.extend_from_slice(data);
        Ok(())
    }

    /// The bytes in the buffer as it is, which may be twice as large.
    pub(crate) fn finish(mut self) -> Bytes {
        let (bytes, mut held) = (std::mem::take(&mut self.bytes), self.held.split(u64::MAX));
        held.shrink_to(bytes.capacity() as u64);
        held.attach(bytes)
    }

    /// The bytes in a buffer of their size, for a session to keep.
    pub(crate) async fn finish_exact(mut self) -> Bytes {
        let mut bytes = std::mem::take(&mut self.bytes);
        let is_long = bytes.len() > MAX_COPIED_INLINE_BYTES;
        // A few unused bytes, which are counted, cost less than moving all others.
        let is_exact = bytes.capacity() - bytes.len() <= bytes.len() / MAX_UNUSED_SHARE;
        let shrink = move || {
            if !is_exact {
                bytes.shrink_to_fit();
            }
            bytes
        };
        self.bytes = aside(is_long && !is_exact, shrink).await;
        self.finish()
    }
}

impl Drop for BodyBuffer<'_> {
    fn drop(&mut self) {
        let bytes = std::mem::take(&mut self.bytes);
        let capacity = bytes.capacity() as u64;
        free(bytes, capacity);
    }
}

/// Describes the media type of a request.
pub(crate) fn sent(headers: &HeaderMap) -> String {
    media_type(headers).map_or_else(
        || "the request has no `Content-Type`".to_owned(),
        |found| format!("found {}", quote(&found)),
    )
}

/// Reads a JSON body of at most `limit` bytes; `what` names the limit. The `purpose` keeps uploads
/// from blocking the bodies of drags.
pub(crate) async fn json(
    caller: &Caller,
    request: Request,
    purpose: MemoryClass,
    what: &'static str,
    limit: u64,
) -> Result<Bytes, Problem> {
    if media_type(request.headers()).as_deref() != Some("application/json") {
        return Err(Problem::new(
            Code::UnsupportedMediaType,
            format!(
                "the body must be `application/json`, or `multipart/form-data` with landmark \
                    files; {}",
                sent(request.headers())
            ),
        ));
    }
    raw(caller, request, purpose, what, limit).await
}

/// Reads a body of any type, of at most `limit` bytes.
pub(crate) async fn raw(
    caller: &Caller,
    request: Request,
    purpose: MemoryClass,
    what: &'static str,
    limit: u64,
) -> Result<Bytes, Problem> {
    Ok(buffered(caller, request, purpose, what, limit)
        .await?
        .finish())
}

/// Reads a file for a session to keep.
pub(crate) async fn file(caller: &Caller, request: Request) -> Result<Bytes, Problem> {
    let limit = caller.app.config().max_body_bytes;
    Ok(
        buffered(caller, request, MemoryClass::Upload, "body_bytes", limit)
            .await?
            .finish_exact()
            .await,
    )
}

async fn buffered<'a>(
    caller: &'a Caller,
    request: Request,
    purpose: MemoryClass,
    what: &'static str,
    limit: u64,
) -> Result<BodyBuffer<'a>, Problem> {
    let announced = content_length(request.headers());
    if let Some(length) = announced.filter(|length| *length > limit) {
        return Err(too_large(what, limit, length));
    }
    let mut body = request.into_body();
    let mut buffer = BodyBuffer::new(&caller.app, caller.client, purpose, announced).await?;
    while let Some(frame) = body.frame().await {
        if let Ok(data) = frame
            .map_err(|error| read_problem(&error, "the body could not be read"))?
            .into_data()
        {
            buffer.push(&data, what, limit).await?;
        }
    }
    Ok(buffer)
}
