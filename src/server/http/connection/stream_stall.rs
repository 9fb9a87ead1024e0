//! The streams of one HTTP/2 connection. Its socket says nothing about a single stream: a client may answer pings and grant no window, and then
//! nobody asks the answer's body for more. So bodies leave in small pieces and note when the last one was handed over; a stream whose client
//! takes none for the write deadline is reset, and the others go on.

use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::Frame;
use hyper::rt::Executor;
use tokio::sync::watch;
use tokio::time::{Sleep, sleep};

/// Largest piece: one DATA frame of the size that every client takes.
const PIECE: usize = 16 << 10;

tokio::task_local! {
    /// The stream whose request is being answered.
    static CURRENT: Arc<StreamStallTimeout>;
}

/// When the last piece was handed over, and nothing was asked for since.
#[derive(Debug, Default)]
struct StreamStallTimeout(Mutex<Option<Instant>>);

impl StreamStallTimeout {
    fn set(&self, at: Option<Instant>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = at;
    }

    fn get(&self) -> Option<Instant> {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// How many streams are open, and how many there have been.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    open: usize,
    begun: u64,
}

/// Runs the streams of a connection.
#[derive(Clone, Debug)]
pub(crate) struct Streams {
    count: watch::Sender<Count>,
    write_timeout: Duration,
}

impl Streams {
    pub(crate) fn new(write_timeout: Duration) -> Self {
        Self { count: watch::Sender::new(Count::default()), write_timeout }
    }

    /// Ends when no stream has been open for so long.
    pub(crate) async fn idle(&self, span: Duration) {
        let mut count = self.count.subscribe();
        loop {
            let now = *count.borrow_and_update();
            // The sender is ours, so waiting for a change does not fail.
            if now.open > 0 {
                let _ = count.changed().await;
            } else if tokio::time::timeout(span, count.changed()).await.is_err() {
                return;
            }
        }
    }
}

impl<F: Future<Output = ()> + Send + 'static> Executor<F> for Streams {
    fn execute(&self, stream: F) {
        let open = Open::new(self.count.clone());
        let handed = Arc::<StreamStallTimeout>::default();
        let watched = Watched { stream: Box::pin(stream), handed: Arc::clone(&handed), deadline: None, within: self.write_timeout };
        tokio::spawn(CURRENT.scope(handed, async move {
            let _open = open;
            watched.await;
        }));
    }
}

/// A stream that is counted.
struct Open(watch::Sender<Count>);

impl Open {
    fn new(count: watch::Sender<Count>) -> Self {
        count.send_modify(|count| *count = Count { open: count.open + 1, begun: count.begun + 1 });
        Self(count)
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.0.send_modify(|count| count.open -= 1);
    }
}

/// A stream until it ends or its client takes nothing for too long; dropped, it is reset.
struct Watched<F> {
    stream: Pin<Box<F>>,
    handed: Arc<StreamStallTimeout>,
    deadline: Option<Pin<Box<Sleep>>>,
    within: Duration,
}

impl<F: Future<Output = ()>> Future for Watched<F> {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<()> {
        if self.stream.as_mut().poll(cx).is_ready() {
            return Poll::Ready(());
        }
        let this = &mut *self;
        loop {
            let Some(handed) = this.handed.get() else { return Poll::Pending };
            let left = this.within.saturating_sub(handed.elapsed());
            if left.is_zero() {
                tracing::debug!("a client took nothing of a stream within {:?}: it is reset", this.within);
                return Poll::Ready(());
            }
            let deadline = this.deadline.get_or_insert_with(|| Box::pin(sleep(left)));
            ready!(deadline.as_mut().poll(cx));
            // It was set for a piece that has been taken, or is due now.
            this.deadline = None;
        }
    }
}

/// An answer's body as its stream may send it; on HTTP/1.1 as it is.
pub(crate) fn with_stall_timeout(body: Body) -> Body {
    match CURRENT.try_with(Arc::clone) {
        Ok(handed) if !body.is_end_stream() => Body::new(Paced { body, handed, rest: Bytes::new() }),
        _ => body,
    }
}

struct Paced {
    body: Body,
    handed: Arc<StreamStallTimeout>,
    rest: Bytes,
}

impl HttpBody for Paced {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        this.handed.set(None);
        if this.rest.is_empty() {
            match ready!(Pin::new(&mut this.body).poll_frame(cx)) {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(data) => this.rest = data,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                ended => return Poll::Ready(ended),
            }
        }
        let piece = this.rest.split_to(this.rest.len().min(PIECE));
        this.handed.set(Some(Instant::now()));
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        let (body, rest) = (self.body.size_hint(), self.rest.len() as u64);
        let mut hint = http_body::SizeHint::new();
        hint.set_lower(body.lower().saturating_add(rest));
        if let Some(upper) = body.upper() {
            hint.set_upper(upper.saturating_add(rest));
        }
        hint
    }
}
