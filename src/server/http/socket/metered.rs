//! A stream with a limit on the bytes that are read for one message. It counts what is on the wire: the WebSocket library counts payloads
//! alone, and accepts any number of empty fragments.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// The head of a control frame from a client: 2 bytes and the mask.
const CONTROL_HEAD: usize = 6;

#[derive(Debug)]
pub(crate) struct Metered<S> {
    io: S,
    most: usize,
    left: usize,
}

impl<S> Metered<S> {
    /// `most`: bytes that may be read for one message.
    pub(crate) const fn new(io: S, most: usize) -> Self {
        Self { io, most, left: most }
    }

    /// A whole message has come.
    pub(crate) const fn message(&mut self) {
        self.left = self.most;
    }

    /// A control frame with this payload has come. It may come between the fragments of a message and is no part of it.
    pub(crate) fn control(&mut self, payload: &[u8]) {
        self.left = self.most.min(self.left + CONTROL_HEAD + payload.len());
    }

    /// Nothing more can be read.
    pub(crate) const fn is_used_up(&self) -> bool {
        self.left == 0
    }

    /// The stream itself.
    pub(crate) const fn inner(&mut self) -> &mut S {
        &mut self.io
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Metered<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.is_used_up() {
            return Poll::Ready(Err(io::Error::other("the message takes more bytes than it may")));
        }
        let before = into.filled().len();
        let read = Pin::new(&mut self.io).poll_read(cx, into);
        self.left = self.left.saturating_sub(into.filled().len() - before);
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Metered<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write(cx, bytes)
    }

    fn poll_write_vectored(mut self: Pin<&mut Self>, cx: &mut Context<'_>, pieces: &[IoSlice<'_>]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.io).poll_write_vectored(cx, pieces)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(cx)
    }
}
