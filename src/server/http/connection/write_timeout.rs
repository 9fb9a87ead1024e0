//! A connection that must be taken from: where its client takes nothing for a while of what there is to send, writing fails. A client that is
//! slow but steady is never cut.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use socket2::SockRef;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

use crate::limits::connections::ConnectionPermit;

/// What the kernel may hold for a client that reads slowly, bytes (it takes twice this). Enough for 100 Mbit/s over 40 ms.
const SEND_BUFFER: usize = 512 << 10;
/// How often a client that takes nothing is looked at within its time.
const LOOKS: u32 = 8;

/// A connection under a write deadline. It holds its place among the connections as long as it is there, also after an upgrade.
#[derive(Debug)]
pub(crate) struct WriteTimeoutStream {
    io: TcpStream,
    within: Option<Duration>,
    blocked: Option<Blocked>,
    _place: ConnectionPermit,
}

#[derive(Debug)]
struct Blocked {
    since: Instant,
    look: Pin<Box<Sleep>>,
}

impl WriteTimeoutStream {
    pub(crate) fn new(io: TcpStream, within: Duration, place: ConnectionPermit) -> io::Result<Self> {
        // Strips leave when they are made; waiting to fill a segment would hold back the last one.
        io.set_nodelay(true)?;
        // Without it the kernel holds what it likes, and nothing else changes.
        let _ = SockRef::from(&io).set_send_buffer_size(SEND_BUFFER);
        Ok(Self { io, within: Some(within), blocked: None, _place: place })
    }

    pub(crate) const fn socket(&self) -> &TcpStream {
        &self.io
    }

    pub(crate) const fn socket_mut(&mut self) -> &mut TcpStream {
        &mut self.io
    }

    /// Whoever takes the connection over has deadlines of its own.
    pub(crate) fn without_deadline(&mut self) {
        self.within = None;
    }

    /// The kernel has no room. It tells of room only when a third of its buffer is free, which takes a slow client longer than its deadline; so
    /// now and then it is asked.
    fn poll_blocked(&mut self, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let Some(within) = self.within else { return Poll::Pending };
        let pause = within / LOOKS;
        let blocked = self.blocked.get_or_insert_with(|| Blocked { since: Instant::now(), look: Box::pin(sleep(pause)) });
        while blocked.look.as_mut().poll(cx).is_ready() {
            match SockRef::from(&self.io).send(bytes) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                sent => {
                    self.blocked = None;
                    return Poll::Ready(sent);
                }
            }
            if blocked.since.elapsed() >= within {
                // What the kernel holds goes too: nobody will take it.
                let _ = SockRef::from(&self.io).set_linger(Some(Duration::ZERO));
                tracing::debug!("a client took nothing within {within:?}: its connection is cut");
                return Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the client does not take what it is sent")));
            }
            blocked.look.as_mut().reset(tokio::time::Instant::now() + pause);
        }
        Poll::Pending
    }
}

impl AsyncRead for WriteTimeoutStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_read(cx, into)
    }
}

impl AsyncWrite for WriteTimeoutStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match Pin::new(&mut self.io).poll_write(cx, bytes) {
            Poll::Ready(written) => {
                self.blocked = None;
                Poll::Ready(written)
            }
            Poll::Pending => self.poll_blocked(cx, bytes),
        }
    }

    fn poll_write_vectored(mut self: Pin<&mut Self>, cx: &mut Context<'_>, pieces: &[IoSlice<'_>]) -> Poll<io::Result<usize>> {
        match Pin::new(&mut self.io).poll_write_vectored(cx, pieces) {
            Poll::Ready(written) => {
                self.blocked = None;
                Poll::Ready(written)
            }
            Poll::Pending => match pieces.iter().find(|piece| !piece.is_empty()) {
                Some(first) => self.poll_blocked(cx, first),
                None => Poll::Pending,
            },
        }
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
