//! A WebSocket connection: reads whole messages, and writes from a queue. Pictures leave in
//! fragments, so that at most one fragment is copied and each one counts as progress. One task
//! reads and writes; neither blocks the other.

use std::collections::VecDeque;
use std::future::poll_fn;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures_util::{Sink, Stream};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::frame::coding::{CloseCode, Data, OpCode};
use tokio_tungstenite::tungstenite::protocol::frame::{CloseFrame, Frame};
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Error, Message, Utf8Bytes};
use tokio_util::io::InspectReader;

use crate::http::connection::transport::Transport;

/// Maximum size of a fragment, which is the buffer that a picture is copied through.
const MAX_FRAGMENT_BYTES: usize = 64 << 10;
/// Smaller writes are collected.
const WRITE_BUFFER: usize = 16 << 10;
/// Bytes that the frame heads of a message may add to it: hundreds of fragments.
const FRAME_HEADS: usize = 4 << 10;
/// Bytes of a client's control frame before its payload: 2 bytes and the mask.
const CONTROL_HEAD: usize = 6;
/// Maximum size of a read; poses are small.
const READ_BUFFER: usize = 16 << 10;
/// Length of the queue from which on nothing is read from the client.
const MAX_QUEUE: usize = 256;
/// Maximum time of a closing handshake.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);
/// Bytes that are discarded from a client while its connection is closed.
const MAX_DISCARDED: usize = 8 << 20;

/// Why a socket ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// The client has closed it, or the connection is lost.
    Disconnected,
    /// The server closes it.
    Close(CloseCode, &'static str),
}

const TOO_LARGE: Ending = Ending::Close(CloseCode::Size, "the message is too large");

/// What was read.
#[derive(Debug)]
pub(crate) enum Event {
    Text(Utf8Bytes),
    Binary(Bytes),
    /// A ping, or the answer to one.
    Ping,
    Ended(Ending),
}

/// A transport that counts the bytes that are read.
type CountingTransport = InspectReader<Transport, Box<dyn FnMut(&[u8]) + Send>>;

/// A WebSocket.
pub(crate) struct WebSocketConnection {
    socket: WebSocketStream<CountingTransport>,
    /// Bytes read since the last whole message. tungstenite's limit counts payloads alone, and
    /// permits any number of empty fragments.
    unread: Arc<AtomicUsize>,
    max_unread: usize,
    queue: VecDeque<Message>,
    /// Sent before a close if no picture is half sent.
    before_close: Option<Message>,
    is_flushed: bool,
    blocked_since: Option<Instant>,
    last_written: Instant,
}

impl WebSocketConnection {
    /// `read`: bytes that were read already. Messages have at most `max_message` bytes.
    pub(crate) async fn new(transport: Transport, read: Bytes, max_message: usize) -> Self {
        let config = WebSocketConfig::default()
            .read_buffer_size(READ_BUFFER)
            .write_buffer_size(WRITE_BUFFER)
            // One fragment is written when the buffer is below its size; pongs come on top.
            .max_write_buffer_size(2 * (WRITE_BUFFER + MAX_FRAGMENT_BYTES))
            .max_message_size(Some(max_message))
            .max_frame_size(Some(max_message));
        let unread = Arc::new(AtomicUsize::new(0));
        let counter = Arc::clone(&unread);
        let count = move |bytes: &[u8]| {
            counter.fetch_add(bytes.len(), Ordering::Relaxed);
        };
        let stream: CountingTransport = InspectReader::new(transport, Box::new(count));
        Self {
            socket: WebSocketStream::from_partially_read(
                stream,
                read.into(),
                Role::Server,
                Some(config),
            )
            .await,
            unread,
            max_unread: max_message.saturating_add(FRAME_HEADS),
            queue: VecDeque::new(),
            before_close: None,
            is_flushed: true,
            blocked_since: None,
            last_written: Instant::now(),
        }
    }

    pub(crate) fn send_text(&mut self, text: String) {
        self.queue.push_back(Message::text(text));
    }

    /// Sends a text in place of the queue when the server closes the connection.
    pub(crate) fn send_before_close(&mut self, text: String) {
        self.before_close = Some(Message::text(text));
    }

    pub(crate) fn send_ping(&mut self) {
        self.queue.push_back(Message::Ping(Bytes::new()));
    }

    /// Sends a binary message that begins with `head`.
    pub(crate) fn send_binary(&mut self, head: Bytes, pieces: Vec<Bytes>) {
        let fragments = pieces.into_iter().flat_map(|mut piece| {
            std::iter::from_fn(move || {
                (!piece.is_empty()).then(|| piece.split_to(piece.len().min(MAX_FRAGMENT_BYTES)))
            })
        });
        let mut fragments = std::iter::once(head).chain(fragments).peekable();
        let mut opcode = OpCode::Data(Data::Binary);
        while let Some(fragment) = fragments.next() {
            let is_last = fragments.peek().is_none();
            self.queue
                .push_back(Message::Frame(Frame::message(fragment, opcode, is_last)));
            opcode = OpCode::Data(Data::Continue);
        }
    }

    /// Whether everything is written.
    pub(crate) fn is_idle(&self) -> bool {
        self.queue.is_empty() && self.is_flushed
    }

    /// Since when the client has read nothing although something is queued.
    pub(crate) const fn blocked_since(&self) -> Option<Instant> {
        self.blocked_since
    }

    /// When something was written last.
    pub(crate) const fn last_written(&self) -> Instant {
        self.last_written
    }

    /// Writes the queue and waits for the client's next message. Nothing is read while the queue is
    /// full, and unless `reads`. Cancel safe.
    pub(crate) async fn next(&mut self, reads: bool) -> Event {
        poll_fn(|cx| {
            if let Poll::Ready(Err(_)) = self.poll_write(cx) {
                return Poll::Ready(Event::Ended(Ending::Disconnected));
            }
            if !reads || self.queue.len() >= MAX_QUEUE {
                return Poll::Pending;
            }
            match Pin::new(&mut self.socket).poll_next(cx) {
                Poll::Ready(next) => Poll::Ready(self.event(next)),
                Poll::Pending if self.unread.load(Ordering::Relaxed) >= self.max_unread => {
                    Poll::Ready(Event::Ended(TOO_LARGE))
                }
                Poll::Pending => Poll::Pending,
            }
        })
        .await
    }

    fn event(&mut self, next: Option<Result<Message, Error>>) -> Event {
        let counted = match &next {
            // Control frames come between the fragments of a message and do not count.
            Some(Ok(Message::Ping(payload) | Message::Pong(payload))) => {
                CONTROL_HEAD + payload.len()
            }
            _ => usize::MAX,
        };
        let unread = self.unread.load(Ordering::Relaxed);
        self.unread
            .store(unread.saturating_sub(counted), Ordering::Relaxed);
        Event::Ended(match next {
            Some(Ok(Message::Text(text))) => return Event::Text(text),
            Some(Ok(Message::Binary(bytes))) => return Event::Binary(bytes),
            // Read messages are whole.
            Some(Ok(Message::Frame(frame))) => return Event::Binary(frame.into_payload()),
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => return Event::Ping,
            Some(Err(Error::Capacity(_))) => TOO_LARGE,
            Some(Err(Error::Utf8(_))) => {
                Ending::Close(CloseCode::Invalid, "a text message is UTF-8")
            }
            Some(Err(Error::Protocol(_))) => {
                Ending::Close(CloseCode::Protocol, "not the WebSocket protocol")
            }
            Some(Ok(Message::Close(_)) | Err(_)) | None => Ending::Disconnected,
        })
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
                self.blocked_since.get_or_insert_with(Instant::now);
                return Poll::Pending;
            };
            ready?;
            self.blocked_since = None;
            self.last_written = Instant::now();
            match self.queue.pop_front() {
                Some(message) => {
                    self.is_flushed = false;
                    Pin::new(&mut self.socket).start_send(message)?;
                }
                None => self.is_flushed = true,
            }
        }
    }

    /// Ends the connection so that a client that reads learns why.
    pub(crate) async fn close(mut self, ending: Ending) {
        let closing = async {
            if let Ending::Close(code, reason) = ending {
                if code != CloseCode::Normal {
                    // Between two fragments only a control frame is allowed.
                    let is_continued = matches!(self.queue.front(),
                        Some(Message::Frame(frame)) if frame.header().opcode == OpCode::Data(
                            Data::Continue));
                    self.queue.clear();
                    self.queue
                        .extend(self.before_close.take().filter(|_| !is_continued));
                }
                self.queue.push_back(Message::Close(Some(CloseFrame {
                    code,
                    reason: reason.into(),
                })));
            }
            // tungstenite has queued the reply to a client's close.
            self.is_flushed = false;
            poll_fn(|cx| self.poll_write(cx)).await.ok();
            let stream = self.socket.get_mut();
            stream.shutdown().await.ok();
            // Closing with unread bytes would reset the connection and lose the last message.
            let (mut scratch, mut discarded) = ([0; 4096], 0);
            while let Ok(read @ 1..) = stream.read(&mut scratch).await {
                discarded += read;
                if discarded > MAX_DISCARDED {
                    break;
                }
            }
        };
        // A client that does not read in time is cut off.
        let _ = tokio::time::timeout(CLOSE_TIMEOUT, closing).await;
    }
}
