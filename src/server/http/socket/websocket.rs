//! A WebSocket as the drag sees it: what comes is a message at a time, what goes is queued. A picture leaves in fragments, so that no more than a
//! fragment of it is ever copied, and every fragment that leaves is progress. One task reads and writes, neither waits for the other.

use std::collections::VecDeque;
use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures_util::{Sink, Stream};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::frame::coding::{CloseCode, Data, OpCode};
use tokio_tungstenite::tungstenite::protocol::frame::{CloseFrame, Frame};
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Error, Message, Utf8Bytes};

use super::metered::Metered;

/// Largest fragment: what a picture's bytes are copied through.
const FRAGMENT: usize = 128 << 10;
/// Smaller writes wait for the next, or for the end of what is queued.
const GATHER: usize = 16 << 10;
/// What the heads of a message's frames may add to its bytes: hundreds of fragments.
const HEADS: usize = 4 << 10;
/// What is read at once, at most: poses are small.
const READ: usize = 16 << 10;
/// Messages and fragments that wait for a client; while there are more, nothing of its own is read.
const UNREAD: usize = 256;
/// How long a connection that is being closed is waited for.
const FAREWELL: Duration = Duration::from_secs(1);
/// What a peer may send of which nobody hears before its connection is cut.
const UNHEARD: usize = 8 << 20;

/// Why a socket ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The client has closed it, or the connection is lost.
    Gone,
    /// It is closed from here.
    Close(CloseCode, &'static str),
}

const TOO_LARGE: Ending = Ending::Close(CloseCode::Size, "the message is too large");

/// What a client said.
#[derive(Debug)]
pub(crate) enum Heard {
    /// A text message.
    Text(Utf8Bytes),
    /// A binary message.
    Binary,
    /// A ping, or the answer to one.
    Life,
    /// Nothing more.
    End(Ending),
}

/// One WebSocket.
#[derive(Debug)]
pub(crate) struct WebSocketConnection<S> {
    socket: WebSocketStream<Metered<S>>,
    queue: VecDeque<Message>,
    /// What is said before the connection is closed from here, where there is room for it.
    last_words: Option<Message>,
    is_flushed: bool,
    /// Since when the client has taken nothing of what there is for it.
    blocked: Option<Instant>,
    /// When the last of the queue left.
    wrote: Instant,
}

impl<S: AsyncRead + AsyncWrite + Unpin> WebSocketConnection<S> {
    /// `read`: what the client has sent already. Messages are at most `most` bytes, with their frames' heads at most [`HEADS`] more.
    pub(crate) async fn new(stream: S, read: Bytes, most: usize) -> Self {
        let config = WebSocketConfig::default()
            .read_buffer_size(READ)
            .write_buffer_size(GATHER)
            // Fragments are queued here, one more only when there is room; pongs and the like come on top.
            .max_write_buffer_size(2 * (GATHER + FRAGMENT))
            .max_message_size(Some(most))
            .max_frame_size(Some(most));
        let stream = Metered::new(stream, most.saturating_add(HEADS));
        let socket = WebSocketStream::from_partially_read(stream, read.into(), Role::Server, Some(config)).await;
        Self { socket, queue: VecDeque::new(), last_words: None, is_flushed: true, blocked: None, wrote: Instant::now() }
    }

    pub(crate) fn text(&mut self, text: String) {
        self.queue.push_back(Message::text(text));
    }

    /// Says this before it closes the connection, whatever waits.
    pub(crate) fn last_words(&mut self, text: String) {
        self.last_words = Some(Message::text(text));
    }

    pub(crate) fn ping(&mut self) {
        self.queue.push_back(Message::Ping(Bytes::new()));
    }

    /// A binary message that begins with `head`.
    pub(crate) fn binary(&mut self, head: Bytes, pieces: Vec<Bytes>) {
        let mut opcode = OpCode::Data(Data::Binary);
        let mut fragment = |data: Bytes, is_last: bool| {
            self.queue.push_back(Message::Frame(Frame::message(data, opcode, is_last)));
            opcode = OpCode::Data(Data::Continue);
        };
        fragment(head, pieces.is_empty());
        let last = pieces.len().saturating_sub(1);
        for (index, mut piece) in pieces.into_iter().enumerate() {
            while piece.len() > FRAGMENT {
                fragment(piece.split_to(FRAGMENT), false);
            }
            fragment(piece, index == last);
        }
    }

    /// Everything that was queued has left.
    pub(crate) fn is_clear(&self) -> bool {
        self.queue.is_empty() && self.is_flushed
    }

    /// Since when the client has taken nothing of what there is for it.
    pub(crate) const fn blocked(&self) -> Option<Instant> {
        self.blocked
    }

    /// When something left last.
    pub(crate) const fn wrote(&self) -> Instant {
        self.wrote
    }

    /// Writes what is queued and waits for the client's next message, or for the connection's end. A client that sends and does not read is
    /// not heard before it has read. May be dropped and called again.
    pub(crate) async fn hear(&mut self) -> Heard {
        poll_fn(|cx| {
            if let Poll::Ready(Err(_)) = self.poll_write(cx) {
                return Poll::Ready(Heard::End(Ending::Gone));
            }
            if self.queue.len() < UNREAD { Pin::new(&mut self.socket).poll_next(cx).map(|next| self.counted(next)) } else { Poll::Pending }
        })
        .await
    }

    /// What came, counted towards the limit of a message.
    fn counted(&mut self, next: Option<Result<Message, Error>>) -> Heard {
        let meter = self.socket.get_mut();
        match &next {
            Some(Ok(Message::Ping(payload) | Message::Pong(payload))) => meter.control(payload),
            Some(Ok(_)) => meter.message(),
            Some(Err(Error::Io(_))) if meter.is_used_up() => return Heard::End(TOO_LARGE),
            _ => {}
        }
        heard(next)
    }

    fn poll_write(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), Error>> {
        loop {
            let socket = Pin::new(&mut self.socket);
            let polled = match self.queue.front() {
                Some(_) => socket.poll_ready(cx),
                None if self.is_flushed => return Poll::Ready(Ok(())),
                None => socket.poll_flush(cx),
            };
            let Poll::Ready(ready) = polled else {
                self.blocked.get_or_insert_with(Instant::now);
                return Poll::Pending;
            };
            ready?;
            self.blocked = None;
            self.wrote = Instant::now();
            match self.queue.pop_front() {
                Some(message) => {
                    self.is_flushed = false;
                    Pin::new(&mut self.socket).start_send(message)?;
                }
                None => self.is_flushed = true,
            }
        }
    }

    /// Ends the connection so that the client learns why, if it listens.
    pub(crate) async fn close(mut self, ending: Ending) {
        let farewell = async {
            if let Ending::Close(code, reason) = ending {
                if code != CloseCode::Normal {
                    // Between two fragments there is room for a close, and for nothing else.
                    let is_within =
                        matches!(self.queue.front(), Some(Message::Frame(frame)) if frame.header().opcode == OpCode::Data(Data::Continue));
                    self.queue.clear();
                    self.queue.extend(self.last_words.take().filter(|_| !is_within));
                }
                self.queue.push_back(Message::Close(Some(CloseFrame { code, reason: reason.into() })));
            }
            // The answer to a client's close is queued already.
            self.is_flushed = false;
            poll_fn(|cx| self.poll_write(cx)).await.ok();
            let stream = self.socket.get_mut().inner();
            stream.shutdown().await.ok();
            // Closing with unread bytes would reset the connection and take the last message with it.
            let (mut scratch, mut unheard) = ([0; 4096], 0);
            while let Ok(read @ 1..) = stream.read(&mut scratch).await {
                unheard += read;
                if unheard > UNHEARD {
                    break;
                }
            }
        };
        // Whoever does not take it in time is cut off.
        let _ = tokio::time::timeout(FAREWELL, farewell).await;
    }
}

fn heard(next: Option<Result<Message, Error>>) -> Heard {
    match next {
        Some(Ok(Message::Text(text))) => Heard::Text(text),
        Some(Ok(Message::Binary(_) | Message::Frame(_))) => Heard::Binary,
        Some(Ok(Message::Ping(_) | Message::Pong(_))) => Heard::Life,
        Some(Err(Error::Capacity(_))) => Heard::End(TOO_LARGE),
        Some(Err(Error::Utf8(_))) => Heard::End(Ending::Close(CloseCode::Invalid, "a text message is UTF-8")),
        Some(Err(Error::Protocol(_))) => Heard::End(Ending::Close(CloseCode::Protocol, "not the WebSocket protocol")),
        Some(Ok(Message::Close(_)) | Err(_)) | None => Heard::End(Ending::Gone),
    }
}
