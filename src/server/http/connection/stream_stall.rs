//! The streams of one HTTP/2 connection, with a write timeout for each. A client may answer pings
//! and grant a stream no window, which the socket does not show. So bodies leave in small pieces; a
//! stream whose client takes none within the timeout is reset, and the others go on.

use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http_body::{Frame, SizeHint};
use hyper::rt::Executor;
use tokio::sync::watch;
use tokio::time::{Sleep, sleep};

use super::turns::AddressTurns;

/// Maximum size of a piece: a DATA frame of the size that every client accepts.
const MAX_PIECE_BYTES: usize = 16 << 10;

tokio::task_local! {
    /// The stream of the current task.
    static CURRENT: Arc<StreamProgress>;
}

/// When hyper took the last piece of a stream, if it has not asked for another one since.
type StreamProgress = Mutex<Option<Instant>>;

fn lock(progress: &StreamProgress) -> MutexGuard<'_, Option<Instant>> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs and counts the streams of a connection.
#[derive(Clone, Debug)]
pub(crate) struct Streams {
    open: watch::Sender<usize>,
    timeout: Duration,
    /// Those of the client's address, unless it is a proxy's.
    turns: Option<AddressTurns>,
}

impl Streams {
    pub(crate) fn new(timeout: Duration, turns: Option<AddressTurns>) -> Self {
        Self {
            open: watch::Sender::new(0),
            timeout,
            turns,
        }
    }

    /// Completes when no stream has been open for this time.
    pub(crate) async fn idle(&self, time: Duration) {
        let mut open = self.open.subscribe();
        loop {
            // Waiting cannot fail: `self` owns the sender.
            if *open.borrow_and_update() > 0 {
                let _ = open.changed().await;
            } else if tokio::time::timeout(time, open.changed()).await.is_err() {
                return;
            }
        }
    }
}

impl<F: Future<Output = ()> + Send + 'static> Executor<F> for Streams {
    fn execute(&self, stream: F) {
        self.open.send_modify(|open| *open += 1);
        let progress = Arc::<StreamProgress>::default();
        let (open, timeout) = (self.open.clone(), self.timeout);
        let stream = StreamStallTimeout {
            stream: Box::pin(stream),
            progress: Arc::clone(&progress),
            deadline: None,
            timeout,
            open,
        };
        let stream = CURRENT.scope(progress, stream);
        match &self.turns {
            Some(turns) => tokio::spawn(turns.take(stream)),
            None => tokio::spawn(stream),
        };
    }
}

/// A stream until it ends or stalls. hyper resets a stream that is dropped.
struct StreamStallTimeout<F> {
    stream: Pin<Box<F>>,
    progress: Arc<StreamProgress>,
    deadline: Option<Pin<Box<Sleep>>>,
    timeout: Duration,
    open: watch::Sender<usize>,
}

impl<F: Future<Output = ()>> Future for StreamStallTimeout<F> {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<()> {
        if self.stream.as_mut().poll(cx).is_ready() {
            return Poll::Ready(());
        }
        let this = &mut *self;
        loop {
            let Some(taken) = *lock(&this.progress) else {
                return Poll::Pending;
            };
            let left = this.timeout.saturating_sub(taken.elapsed());
            if left.is_zero() {
                tracing::debug!(
                    "a client read nothing of a stream for {:?}: the stream is reset",
                    this.timeout
                );
                return Poll::Ready(());
            }
            ready!(
                this.deadline
                    .get_or_insert_with(|| Box::pin(sleep(left)))
                    .as_mut()
                    .poll(cx)
            );
            // It may have been set for an earlier piece.
            this.deadline = None;
        }
    }
}

impl<F> Drop for StreamStallTimeout<F> {
    fn drop(&mut self) {
        self.open.send_modify(|open| *open -= 1);
    }
}

/// Adds the stall timeout to a response's body. On HTTP/1.1 the body is unchanged.
pub(crate) fn with_stall_timeout(body: Body) -> Body {
    match CURRENT.try_with(Arc::clone) {
        Ok(progress) if !body.is_end_stream() => Body::new(PiecewiseBody {
            body,
            progress,
            rest: Bytes::new(),
        }),
        _ => body,
    }
}

struct PiecewiseBody {
    body: Body,
    progress: Arc<StreamProgress>,
    rest: Bytes,
}

impl HttpBody for PiecewiseBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        *lock(&this.progress) = None;
        if this.rest.is_empty() {
            match ready!(Pin::new(&mut this.body).poll_frame(cx)) {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(data) => this.rest = data,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                ended => return Poll::Ready(ended),
            }
        }
        let piece = this.rest.split_to(this.rest.len().min(MAX_PIECE_BYTES));
        *lock(&this.progress) = Some(Instant::now());
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    /// Exact sizes become `Content-Length`, which is asked for before the first piece.
    fn size_hint(&self) -> SizeHint {
        if self.rest.is_empty() {
            self.body.size_hint()
        } else {
            SizeHint::default()
        }
    }
}
