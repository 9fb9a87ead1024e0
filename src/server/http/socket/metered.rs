//! A stream that limits the bytes read for one message. It counts bytes on the wire: tungstenite's limit counts payloads alone, and permits any
//! number of empty fragments.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Bytes of a client's control frame before its payload: 2 bytes and the mask.
const CONTROL_HEAD: usize = 6;

#[derive(Debug)]
pub(super) struct Metered<S> {
    pub(super) stream: S,
    limit: usize,
    left: usize,
}

impl<S> Metered<S> {
    pub(super) const fn new(stream: S, limit: usize) -> Self {
        Self { stream, limit, left: limit }
    }

    /// A message was read to its end.
    pub(super) const fn message(&mut self) {
        self.left = self.limit;
    }

    /// A control frame with this payload was read. It may come between the fragments of a message and does not count.
    pub(super) fn control(&mut self, payload: &[u8]) {
        self.left = self.limit.min(self.left + CONTROL_HEAD + payload.len());
    }

    pub(super) const fn is_exhausted(&self) -> bool {
        self.left == 0
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Metered<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.is_exhausted() {
            return Poll::Ready(Err(io::Error::other("the message takes more bytes than it may")));
        }
        let before = into.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(cx, into);
        self.left = self.left.saturating_sub(into.filled().len() - before);
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Metered<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_write_vectored(mut self: Pin<&mut Self>, cx: &mut Context<'_>, slices: &[IoSlice<'_>]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(cx, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
