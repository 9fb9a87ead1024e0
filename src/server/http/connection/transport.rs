//! The byte stream of one connection: a TCP socket with a write timeout, plain or below TLS.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use socket2::SockRef;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::task::coop;
use tokio::time::{Sleep, sleep};
use tokio_util::either::Either;

use super::turns::is_poll_over;
use crate::auth::tls::{TlsStream, inner};
use crate::limits::connections::ConnectionPermit;

/// Bytes that the kernel buffers for a slow reader; Linux allocates twice this. Enough for 100
/// Mbit/s over 40 ms.
const SEND_BUFFER: usize = 512 << 10;
/// Bytes of a write: what one poll may move.
const MAX_WRITE_BYTES: usize = 64 << 10;
/// Slices of a write. A body in chunks has three for each, its head, its data and its end.
const MAX_SLICES: usize = 16;
/// Bytes that take one unit of a poll's budget, of which tokio gives 128: a poll moves 64 KiB at
/// most.
const BYTES_PER_BUDGET_UNIT: usize = 512;
/// Units for a call that moves few bytes or many: a body of small pieces, such as a batch of small
/// frames, takes a call for each, and the time of a call is that of some KiB.
const UNITS_PER_CALL: usize = 8;
/// How often a blocked write is tried again within the write timeout.
const WRITE_RETRIES: u32 = 8;

/// A connection, plain or encrypted.
pub(crate) type Transport = Either<WriteTimeoutStream, Box<TlsStream<WriteTimeoutStream>>>;

/// Removes the write timeout: a WebSocket has deadlines of its own.
pub(crate) fn without_write_timeout(mut transport: Transport) -> Transport {
    match &mut transport {
        Either::Left(stream) => stream.timeout = None,
        Either::Right(stream) => inner(stream).timeout = None,
    }
    transport
}

/// A socket whose writes fail when the client reads nothing for the write timeout. A slow but
/// steady client is never cut off.
#[derive(Debug)]
pub(crate) struct WriteTimeoutStream {
    socket: TcpStream,
    timeout: Option<Duration>,
    blocked: Option<Blocked>,
    _permit: ConnectionPermit,
}

#[derive(Debug)]
struct Blocked {
    since: Instant,
    retry: Pin<Box<Sleep>>,
}

impl WriteTimeoutStream {
    pub(crate) fn new(
        socket: TcpStream,
        timeout: Duration,
        permit: ConnectionPermit,
    ) -> io::Result<Self> {
        // Nagle's algorithm would delay the last strip of an image.
        socket.set_nodelay(true)?;
        // On failure the kernel keeps its own size, which only costs memory.
        let _ = SockRef::from(&socket).set_send_buffer_size(SEND_BUFFER);
        Ok(Self {
            socket,
            timeout: Some(timeout),
            blocked: None,
            _permit: permit,
        })
    }

    pub(crate) const fn socket(&self) -> &TcpStream {
        &self.socket
    }

    /// The kernel's buffer is full. The kernel reports the socket as writable only when a third of
    /// the buffer is free, which a slow client may not reach within the timeout; so the write is
    /// also retried on a timer.
    fn poll_blocked(&mut self, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let Some(timeout) = self.timeout else {
            return Poll::Pending;
        };
        let pause = timeout / WRITE_RETRIES;
        let blocked = self.blocked.get_or_insert_with(|| Blocked {
            since: Instant::now(),
            retry: Box::pin(sleep(pause)),
        });
        while blocked.retry.as_mut().poll(cx).is_ready() {
            match SockRef::from(&self.socket).send(bytes) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                sent => {
                    self.blocked = None;
                    return Poll::Ready(sent);
                }
            }
            if blocked.since.elapsed() >= timeout {
                // Discards what the kernel still holds.
                let _ = SockRef::from(&self.socket).set_linger(Some(Duration::ZERO));
                tracing::debug!("a client read nothing for {timeout:?}: its connection is closed");
                return Poll::Ready(Err(io::Error::new(
                    io::ErrorKind::TimedOut,
                    "the client reads nothing",
                )));
            }
            blocked
                .retry
                .as_mut()
                .reset(tokio::time::Instant::now() + pause);
        }
        Poll::Pending
    }
}

impl AsyncRead for WriteTimeoutStream {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        ready!(poll_turn(cx));
        let before = into.filled().len();
        let read = Pin::new(&mut self.socket).poll_read(cx, into);
        if read.is_ready() {
            charge(cx, into.filled().len() - before);
        }
        read
    }
}

/// Ready unless this poll has taken its time; the socket is used in the next one then.
fn poll_turn(cx: &Context<'_>) -> Poll<()> {
    if !is_poll_over() {
        return Poll::Ready(());
    }
    cx.waker().wake_by_ref();
    Poll::Pending
}

/// Takes a call and the bytes that it has moved from the budget of this poll. When it is used up,
/// the socket is not ready before the next one.
fn charge(cx: &mut Context<'_>, bytes: usize) {
    for _ in 0..UNITS_PER_CALL + bytes / BYTES_PER_BUDGET_UNIT {
        if !coop::has_budget_remaining() {
            return;
        }
        if let Poll::Ready(unit) = coop::poll_proceed(cx) {
            unit.made_progress();
        }
    }
}

/// Collects what one write takes: the beginning of the slices, [`MAX_WRITE_BYTES`] bytes at most.
/// The last one is cut, because its rest would otherwise leave alone, and so would the few bytes
/// before the next chunk of a body: packets of seven bytes, each a call and a wake-up of the
/// client. Returns the number of slices.
fn beginning<'s>(slices: &'s [IoSlice<'_>], into: &mut [IoSlice<'s>; MAX_SLICES]) -> usize {
    let (mut count, mut left) = (0, MAX_WRITE_BYTES);
    for slice in slices.iter().filter(|slice| !slice.is_empty()) {
        if left == 0 || count == MAX_SLICES {
            break;
        }
        let part = &slice[..slice.len().min(left)];
        into[count] = IoSlice::new(part);
        left -= part.len();
        count += 1;
    }
    count
}

impl AsyncWrite for WriteTimeoutStream {
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.poll_write_vectored(cx, &[IoSlice::new(bytes)])
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        // The turn is over, which says nothing of the client.
        ready!(poll_turn(cx));
        drop(ready!(coop::poll_proceed(cx)));
        let mut parts = [IoSlice::new(&[]); MAX_SLICES];
        let count = beginning(slices, &mut parts);
        let parts = &parts[..count];
        let written = match parts {
            [only] => Pin::new(&mut self.socket).poll_write(cx, only),
            _ => Pin::new(&mut self.socket).poll_write_vectored(cx, parts),
        };
        match (written, parts.first()) {
            (Poll::Pending, Some(first)) => self.poll_blocked(cx, first),
            (written, _) => {
                self.blocked = None;
                if let Poll::Ready(Ok(bytes)) = written {
                    charge(cx, bytes);
                }
                written
            }
        }
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::connections::ConnectionLimiter;

    fn lengths(slices: &[&[u8]]) -> Vec<usize> {
        let slices: Vec<_> = slices.iter().map(|slice| IoSlice::new(slice)).collect();
        let mut parts = [IoSlice::new(&[]); MAX_SLICES];
        let count = beginning(&slices, &mut parts);
        parts[..count].iter().map(|part| part.len()).collect()
    }

    /// Writes of that many bytes until the stream wants another turn; how many there were.
    async fn writes_in_a_turn(bytes: usize) -> usize {
        let listener = tokio::net::TcpListener::bind(("127.0.0.1", 0))
            .await
            .unwrap();
        let _client = TcpStream::connect(listener.local_addr().unwrap())
            .await
            .unwrap();
        let (socket, peer) = listener.accept().await.unwrap();
        let permit = ConnectionLimiter::new(1, 1).acquire(peer.ip(), false);
        let timeout = Duration::from_secs(9);
        let mut stream = WriteTimeoutStream::new(socket, timeout, permit.unwrap()).unwrap();
        stream.socket.writable().await.unwrap();
        let (piece, mut count) = (vec![0; bytes], 0);
        tokio::task::yield_now().await;
        std::future::poll_fn(|cx| {
            while Pin::new(&mut stream).poll_write(cx, &piece).is_ready() {
                count += 1;
            }
            Poll::Ready(())
        })
        .await;
        count
    }

    #[tokio::test]
    async fn small_writes_use_up_a_turn_too() {
        let small = tokio::spawn(writes_in_a_turn(128)).await.unwrap();
        assert!((8..=16).contains(&small), "{small}");
        let large = tokio::spawn(writes_in_a_turn(16 << 10)).await.unwrap();
        assert!((2..=4).contains(&large), "{large}");
    }

    #[test]
    fn a_write_takes_the_beginning_of_what_there_is() {
        let long = vec![0; 2 * MAX_WRITE_BYTES];
        assert!(lengths(&[]).is_empty());
        assert!(lengths(&[b"", b""]).is_empty());
        assert_eq!(lengths(&[b"7\r\n", b"", b"picture", b"\r\n"]), [3, 7, 2]);
        assert_eq!(
            lengths(&[b"head", &long, b"\r\n"]),
            [4, MAX_WRITE_BYTES - 4]
        );
        assert_eq!(
            lengths(&[&long[..MAX_WRITE_BYTES], b"\r\n"]),
            [MAX_WRITE_BYTES]
        );
        assert_eq!(lengths(&[&b"1"[..]; 2 * MAX_SLICES]), [1; MAX_SLICES]);
    }
}
