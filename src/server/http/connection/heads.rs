//! What hyper answers by itself: a head that is none, or too large a one, has no request that a service could be asked about, and hyper has no
//! hook. Its answer is an empty body; here the problem document takes its place.
//!
//! It is told from an answer of the service by counting, never by its bytes alone: when everything that was handed to the service has been
//! answered and has left, and nothing was handed over since, whatever comes next is hyper's own.

use std::convert::Infallible;
use std::fmt;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::http::{Request, Response};
use bytes::Bytes;
use futures_util::FutureExt as _;
use http_body::Frame;
use http_body_util::BodyExt as _;
use hyper::body::Incoming;
use hyper::service::{Service, service_fn};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

use crate::app::App;
use crate::http::middleware::refused;
use crate::problem::{Code, Problem};

/// Largest head: bytes, and on HTTP/1.1 fields. Over it a problem on HTTP/1.1 (`heads.rs`); on HTTP/2 an empty 431, which h2 answers by itself.
pub(crate) const HEAD: usize = 64 << 10;
pub(crate) const FIELDS: usize = 100;

/// The longest target that hyper reads.
const URI: usize = (u16::MAX - 1) as usize;
/// How long, and for how many bytes, a client that was refused is heard to its end: closing with unread bytes would reset the connection and
/// take the answer with it.
const LINGER: Duration = Duration::from_secs(3);
const UNHEARD: usize = 8 << 20;

/// The requests of one connection.
#[derive(Debug, Default)]
pub(crate) struct Turns {
    handed: AtomicU64,
    answered: AtomicU64,
}

impl Turns {
    /// A request goes to the service.
    fn hand(self: &Arc<Self>) -> Turn {
        self.handed.fetch_add(1, Ordering::Relaxed);
        Turn(Arc::clone(self))
    }

    fn handed(&self) -> u64 {
        self.handed.load(Ordering::Relaxed)
    }

    fn are_over(&self) -> bool {
        self.answered.load(Ordering::Relaxed) == self.handed()
    }
}

/// A service whose requests are counted.
pub(crate) fn counted<S>(
    turns: Arc<Turns>,
    service: S,
) -> impl Service<Request<Incoming>, Response = Response<Body>, Error = Infallible, Future: Send>
where
    S: Service<Request<Incoming>, Response = Response<Body>, Error = Infallible, Future: Send>,
{
    service_fn(move |request| {
        let (turn, answer) = (turns.hand(), service.call(request));
        async move { answer.await.map(|answer| answer.map(|body| turn.of(body))) }
    })
}

/// A request until hyper has all of its answer.
#[derive(Debug)]
struct Turn(Arc<Turns>);

impl Drop for Turn {
    fn drop(&mut self) {
        self.0.answered.fetch_add(1, Ordering::Relaxed);
    }
}

impl Turn {
    /// An answer's body, with which the turn ends.
    fn of(self, body: Body) -> Body {
        if body.is_end_stream() { body } else { Body::new(Answer { body, _turn: self }) }
    }
}

struct Answer {
    body: Body,
    _turn: Turn,
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> http_body::SizeHint {
        self.body.size_hint()
    }
}

/// What goes over one connection of HTTP/1.1, as far as it tells whose words they are.
pub(crate) struct Heads {
    app: App,
    turns: Arc<Turns>,
    /// How many requests had been handed over when everything had left, and nothing was written since.
    left: Option<u64>,
    /// Bytes that came of the next head: since then, and at last before it, when its beginning may have come too.
    read: usize,
    last: usize,
    ours: Option<Ours>,
}

impl fmt::Debug for Heads {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Heads").field("turns", &self.turns).field("left", &self.left).field("ours", &self.ours).finish_non_exhaustive()
    }
}

/// The answer that takes the place of hyper's.
#[derive(Debug)]
enum Ours {
    Leaving(Bytes),
    Left,
    /// The client is heard to its end.
    Lingering(Pin<Box<Sleep>>, usize),
}

impl Heads {
    pub(crate) fn new(app: App, turns: Arc<Turns>) -> Self {
        Self { app, turns, left: Some(0), read: 0, last: 0, ours: None }
    }

    /// Bytes have come: of a head, or of a body, which is no matter here.
    pub(crate) fn came(&mut self, bytes: usize) {
        if self.turns.are_over() {
            (self.read, self.last) = (self.read.saturating_add(bytes), bytes);
        }
    }

    /// hyper writes this. Whether it was a head of its own, whose place is taken.
    pub(crate) fn take(&mut self, bytes: &[u8]) -> io::Result<bool> {
        if self.ours.is_some() {
            // The answer is the connection's last.
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        let is_own = self.left.take().is_some_and(|handed| handed == self.turns.handed());
        let Some(problem) = is_own.then(|| problem(bytes, self.read)).flatten() else { return Ok(false) };
        self.ours = Some(Ours::Leaving(answer(&self.app, problem, bytes)));
        Ok(true)
    }

    /// Everything that was written has been taken by the kernel. Said also where nothing was written.
    pub(crate) fn flushed(&mut self) {
        if self.ours.is_none() && self.left.is_none() && self.turns.are_over() {
            self.left = Some(self.turns.handed());
            self.read = self.last;
        }
    }

    /// Sends what took the place of hyper's answer.
    pub(crate) fn poll_leave(&mut self, cx: &mut Context<'_>, mut io: Pin<&mut (impl AsyncWrite + ?Sized)>) -> Poll<io::Result<()>> {
        while let Some(Ours::Leaving(bytes)) = &mut self.ours {
            match ready!(io.as_mut().poll_write(cx, bytes))? {
                0 => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                // The last byte is gone.
                written if written == bytes.len() => self.ours = Some(Ours::Left),
                written => drop(bytes.split_to(written)),
            }
        }
        Poll::Ready(Ok(()))
    }

    /// Hears a client that was refused to its end, where it has one.
    pub(crate) fn poll_linger(&mut self, cx: &mut Context<'_>, socket: &mut TcpStream) -> Poll<()> {
        if matches!(self.ours, Some(Ours::Left)) {
            self.ours = Some(Ours::Lingering(Box::pin(sleep(LINGER)), 0));
        }
        let Some(Ours::Lingering(end, unheard)) = &mut self.ours else { return Poll::Ready(()) };
        let mut scratch = [0; 4096];
        while *unheard < UNHEARD && end.as_mut().poll(cx).is_pending() {
            let mut into = ReadBuf::new(&mut scratch);
            match ready!(Pin::new(&mut *socket).poll_read(cx, &mut into)) {
                Ok(()) if !into.filled().is_empty() => *unheard += into.filled().len(),
                _ => break,
            }
        }
        Poll::Ready(())
    }
}

/// What was wrong with a head that hyper refuses, of which so many bytes have come.
fn problem(refusal: &[u8], read: usize) -> Option<Problem> {
    let status = refusal.strip_prefix(b"HTTP/1.1 ").or_else(|| refusal.strip_prefix(b"HTTP/1.0 "))?.get(..3)?;
    let too_large = |detail: String, what, limit: usize| Problem {
        limit: Some(limit.into()),
        what: Some(what),
        ..Problem::new(Code::TooLarge, detail)
    };
    Some(match status {
        b"400" => Problem::new(Code::MalformedRequest, "the head of the request is not one of HTTP/1.1"),
        b"414" => too_large(format!("the target of the request is too long; at most {URI} bytes"), "uri_bytes", URI),
        b"431" if read < HEAD => too_large(format!("the head of the request has too many fields; at most {FIELDS}"), "head_fields", FIELDS),
        b"431" => too_large(format!("the head of the request is too large; at most {HEAD} bytes"), "head_bytes", HEAD),
        _ => return None,
    })
}

/// The whole answer. Of hyper's it keeps the date.
fn answer(app: &App, problem: Problem, refusal: &[u8]) -> Bytes {
    let (head, body) = refused(app, problem).into_parts();
    // A document is there as a whole.
    let body = body.collect().now_or_never().and_then(Result::ok).map(http_body_util::Collected::to_bytes).unwrap_or_default();
    let mut bytes = format!("HTTP/1.1 {}\r\ncontent-length: {}\r\nconnection: close\r\n", head.status, body.len()).into_bytes();
    let mut line = |name: &[u8], value: &[u8]| bytes.extend([name, b": ", value, b"\r\n"].into_iter().flatten());
    for (name, value) in &head.headers {
        line(name.as_ref(), value.as_bytes());
    }
    let date = refusal.split(|byte| *byte == b'\n').find_map(|line| line.strip_prefix(b"date: "));
    if let Some(date) = date {
        line(b"date", date.trim_ascii_end());
    }
    bytes.extend_from_slice(b"\r\n");
    bytes.extend_from_slice(&body);
    bytes.into()
}

#[cfg(test)]
mod tests {
    use hyper::server::conn::http1;
    use hyper_util::rt::TokioIo;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::net::TcpListener;

    use super::*;
    use crate::config::Config;
    use crate::http::connection::transport::Transport;
    use crate::http::connection::write_timeout::WriteTimeoutStream;
    use crate::limits::connections::ConnectionLimiter;

    /// To the byte what hyper writes when it refuses.
    const REFUSAL: &str = "HTTP/1.1 400 Bad Request\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";

    /// What a client reads who sends this to a service that answers so.
    async fn served<F: Future<Output = Result<Response<Body>, Infallible>> + Send>(
        sent: &str,
        answer: impl Fn(String) -> F + Clone + Send + 'static,
    ) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let mut client = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let (socket, peer) = listener.accept().await.unwrap();
        let steady =
            WriteTimeoutStream::new(socket, Duration::from_secs(60), ConnectionLimiter::new(1, 1).take(peer.ip(), false).unwrap()).unwrap();
        let turns = Arc::<Turns>::default();
        let wire = Transport::plain(steady).with(Heads::new(App::new(Config::default()).unwrap(), Arc::clone(&turns)));
        let service = counted(turns, service_fn(move |request: Request<Incoming>| answer(request.uri().path().to_owned())));
        client.write_all(sent.as_bytes()).await.unwrap();
        let read = async move {
            let mut said = String::new();
            client.read_to_string(&mut said).await.unwrap();
            said
        };
        tokio::join!(read, async { drop(http1::Builder::new().serve_connection(TokioIo::new(wire), service).await) }).0
    }

    fn get(path: &str, more: &str) -> String {
        format!("GET {path} HTTP/1.1\r\nhost: x\r\n{more}\r\n")
    }

    /// A body that comes in pieces, each of which has left before the next is there.
    fn in_pieces(pieces: Vec<&'static str>) -> Body {
        Body::from_stream(futures_util::stream::unfold(pieces.into_iter(), |mut pieces| async {
            let piece = pieces.next()?;
            sleep(Duration::from_millis(30)).await;
            Some((Ok::<_, Infallible>(piece), pieces))
        }))
    }

    #[test]
    fn what_was_too_large_is_named() {
        let limit = |status: &str, read| {
            problem(format!("HTTP/1.1 {status} No\r\n\r\n").as_bytes(), read).map(|problem| (problem.what, problem.limit))
        };
        assert_eq!(limit("400", 9), Some((None, None)));
        assert_eq!(limit("414", 70_000), Some((Some("uri_bytes"), Some(65_534.into()))));
        assert_eq!(limit("431", 70_000), Some((Some("head_bytes"), Some(65_536.into()))));
        assert_eq!(limit("431", 9000), Some((Some("head_fields"), Some(100.into()))));
        assert_eq!((limit("200", 9), limit("500", 9), problem(b"", 0)), (None, None, None));
    }

    #[tokio::test]
    async fn no_answer_of_the_service_is_taken_for_one_of_hypers() {
        // An empty refusal of the service's own; one of a known length whose body looks like hyper's, from its first byte, and in pieces.
        let answer = |path: String| async move {
            let whole = |body: Body| Response::builder().header("content-length", (3 * REFUSAL.len()).to_string()).body(body).unwrap();
            Ok(match path.as_str() {
                "/empty" => Response::builder().status(400).body(Body::empty()).unwrap(),
                "/whole" => whole(REFUSAL.repeat(3).into()),
                _ => whole(in_pieces(vec![REFUSAL; 3])),
            })
        };
        let requests =
            [get("/empty", ""), get("/whole", ""), get("/pieces", ""), get("/empty", ""), get("/pieces", "connection: close\r\n")];
        let said = served(&requests.concat(), answer).await;
        assert!(!said.contains("problem+json"), "{said}");
        assert_eq!(said.matches(&REFUSAL.repeat(3)).count(), 3, "{said}");
        assert_eq!(said.matches("HTTP/1.1 200 OK").count(), 3, "{said}");
        assert_eq!(said.matches("HTTP/1.1 400 Bad Request").count(), 2 + 9, "{said}");
    }

    #[tokio::test]
    async fn hypers_own_is_replaced_also_behind_answers_that_look_like_it() {
        for before in [vec![], vec![get("/empty", "")], vec![get("/pieces", ""), get("/empty", ""), get("/pieces", "")]] {
            let answer = |path: String| async move {
                let body = if path == "/empty" { Body::empty() } else { in_pieces(vec![REFUSAL; 2]) };
                Ok(Response::builder().status(400).body(body).unwrap())
            };
            let said = served(&(before.concat() + "no head at all\r\n\r\n"), answer).await;
            let (rest, document) = said.rsplit_once("\r\n\r\n").unwrap();
            let (rest, head) = rest.rsplit_once("HTTP/1.1 ").unwrap();
            assert!(head.starts_with("400 Bad Request\r\n") && head.contains("content-type: application/problem+json"), "{said}");
            let length = head.lines().find_map(|line| line.strip_prefix("content-length: ")).unwrap();
            assert_eq!(length, document.len().to_string());
            assert_eq!(serde_json::from_str::<serde_json::Value>(document).unwrap()["code"], "malformed_request");
            let looks = before.iter().filter(|request| request.contains("/pieces")).count() * 2;
            assert_eq!(rest.matches(REFUSAL).count(), looks, "{said}");
            assert_eq!(rest.matches("HTTP/1.1 400").count(), looks + before.len(), "{said}");
        }
    }
}
