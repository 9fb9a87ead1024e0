//! What a connection travels over: the socket as it is, or TLS upon it; and who it is that writes.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::heads::Heads;
use super::write_timeout::WriteTimeoutStream;
use crate::auth::tls::{TlsStream, inner};

/// A connection, plain or encrypted.
#[derive(Debug)]
pub(crate) struct Transport {
    io: Io,
    /// Who writes, on HTTP/1.1.
    heads: Option<Heads>,
}

#[derive(Debug)]
enum Io {
    /// The socket.
    Plain(WriteTimeoutStream),
    /// TLS upon it.
    Tls(Box<TlsStream<WriteTimeoutStream>>),
}

impl Transport {
    pub(crate) const fn plain(socket: WriteTimeoutStream) -> Self {
        Self { io: Io::Plain(socket), heads: None }
    }

    pub(crate) fn tls(stream: TlsStream<WriteTimeoutStream>) -> Self {
        Self { io: Io::Tls(Box::new(stream)), heads: None }
    }

    /// What hyper would answer by itself is answered by a problem document.
    pub(crate) fn with(self, heads: Heads) -> Self {
        Self { heads: Some(heads), ..self }
    }

    /// Whoever takes the connection over has deadlines and words of its own.
    pub(crate) fn without_deadline(mut self) -> Self {
        self.heads = None;
        self.io.steady().without_deadline();
        self
    }
}

impl Io {
    fn steady(&mut self) -> &mut WriteTimeoutStream {
        match self {
            Self::Plain(io) => io,
            Self::Tls(io) => inner(io),
        }
    }
}

macro_rules! over {
    ($wire:expr, $io:ident => $call:expr) => {
        match &mut $wire {
            Io::Plain(io) => {
                let $io = Pin::new(io);
                $call
            }
            Io::Tls(io) => {
                let $io = Pin::new(io.as_mut());
                $call
            }
        }
    };
}

impl AsyncRead for Transport {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = into.filled().len();
        let read = over!(self.io, io => io.poll_read(cx, into));
        if let Some(heads) = &mut self.heads {
            heads.came(into.filled().len() - before);
        }
        read
    }
}

impl AsyncWrite for Transport {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if let Some(heads) = &mut self.heads
            && heads.take(bytes)?
        {
            return Poll::Ready(Ok(bytes.len()));
        }
        over!(self.io, io => io.poll_write(cx, bytes))
    }

    fn poll_write_vectored(mut self: Pin<&mut Self>, cx: &mut Context<'_>, pieces: &[IoSlice<'_>]) -> Poll<io::Result<usize>> {
        // A head is one piece.
        let first = pieces.iter().find(|piece| !piece.is_empty());
        if let (Some(heads), Some(first)) = (&mut self.heads, first)
            && heads.take(first)?
        {
            return Poll::Ready(Ok(first.len()));
        }
        over!(self.io, io => io.poll_write_vectored(cx, pieces))
    }

    fn is_write_vectored(&self) -> bool {
        match &self.io {
            Io::Plain(io) => io.is_write_vectored(),
            Io::Tls(io) => io.is_write_vectored(),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Self { io, heads } = &mut *self;
        if let Some(heads) = heads {
            ready!(over!(*io, io => heads.poll_leave(cx, io)))?;
        }
        ready!(over!(*io, io => io.poll_flush(cx)))?;
        if let Some(heads) = heads {
            heads.flushed();
        }
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Self { io, heads } = &mut *self;
        if let Some(heads) = heads {
            ready!(over!(*io, io => heads.poll_leave(cx, io)))?;
        }
        ready!(over!(*io, io => io.poll_shutdown(cx)))?;
        if let Some(heads) = heads {
            ready!(heads.poll_linger(cx, io.steady().socket_mut()));
        }
        Poll::Ready(Ok(()))
    }
}
