//! One connection: the choice of its protocol, its HTTP settings, and its end. Every step has a
//! deadline.

use std::convert::Infallible;
use std::future::{Future, pending};
use std::io;
use std::mem::MaybeUninit;
use std::net::{IpAddr, SocketAddr};
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::{Request, Response};
use hyper::body::Incoming;
use hyper::server::conn::{http1, http2};
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket2::SockRef;
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

use super::stream_stall::{Streams, with_stall_timeout};
use super::transport::{Transport, WriteTimeoutStream};
use super::turns::{AddressTurns, RequestTurns, Turns};
use super::unless;
use crate::app::App;
use crate::auth::tls::{ServerConfig, accept};
use crate::config::Timeouts;
use crate::http::{ops_router, router, tls_required_router};
use crate::limits::connections::{ConnectionLimiter, ConnectionPermit};

/// Maximum size of an HTTP/1.1 request head; hyper rejects a larger one.
const HTTP1_HEAD_BYTES: usize = 64 << 10;
/// Maximum size of an HTTP/2 header list; h2 rejects a larger one.
const HTTP2_HEADER_BYTES: u32 = 16 << 10;
/// Maximum number of open streams of one HTTP/2 connection.
const MAX_STREAMS: u32 = 64;
/// Streams that the client has reset and that are not accepted yet; one more ends the connection
/// (CVE-2023-44487).
const PENDING_RESETS: usize = 20;
/// Streams that this side has reset for the client's errors; one more ends the connection
/// (CVE-2025-8671).
const LOCAL_RESETS: usize = 1024;
/// Bytes that an HTTP/2 client may send ahead on one stream and on all streams; they stay in memory
/// until they are read.
const STREAM_WINDOW_BYTES: u32 = 256 << 10;
const CONNECTION_WINDOW: u32 = 512 << 10;
/// Bytes of one stream's response that may wait for the client's window.
const STREAM_SEND_BYTES: usize = 64 << 10;
/// Connections of the ops listener, in all and per address.
const OPS_CONNECTIONS: (usize, usize) = (64, 32);
/// The first bytes of an HTTP/2 connection (RFC 9113, section 3.4).
const PREFACE: &[u8; 24] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// Pause between two looks at an incomplete preface.
const PREFACE_PAUSE: Duration = Duration::from_millis(20);
/// How long a stopping server waits for the rest of a handshake or of a connection's first request
/// head.
const FIRST_HEAD_GRACE: Duration = Duration::from_millis(500);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Protocol {
    Http1,
    Http2,
    /// Plain HTTP on a TLS listener.
    NotTls,
}

/// The shared state of a listener's connections.
pub(crate) struct Connections {
    app: App,
    router: Router,
    /// Answers plain HTTP on a TLS listener.
    tls_required: Router,
    tls: Option<watch::Receiver<Arc<ServerConfig>>>,
    limiter: ConnectionLimiter,
    turns: Turns,
    /// The ops listener serves until the process ends.
    is_ops: bool,
}

impl Connections {
    /// Connections of the service.
    pub(crate) fn new(app: &App, tls: Option<watch::Receiver<Arc<ServerConfig>>>) -> Self {
        Self {
            app: app.clone(),
            router: router(app.clone()),
            tls_required: tls_required_router(app),
            tls,
            limiter: app.access().connections().clone(),
            turns: Turns::default(),
            is_ops: false,
        }
    }

    /// Connections of the listener for metrics and health.
    pub(crate) fn ops(app: &App) -> Self {
        let limiter = ConnectionLimiter::new(OPS_CONNECTIONS.0, OPS_CONNECTIONS.1);
        Self {
            app: app.clone(),
            router: ops_router(app),
            tls_required: Router::new(),
            tls: None,
            limiter,
            turns: Turns::default(),
            is_ops: true,
        }
    }

    /// Admits another connection, if the limits allow it.
    pub(crate) fn admit(&self, peer: IpAddr) -> Option<ConnectionPermit> {
        self.limiter.acquire(peer, self.is_proxy(peer))
    }

    fn is_proxy(&self, peer: IpAddr) -> bool {
        self.app
            .config()
            .auth
            .trusted_proxies
            .iter()
            .any(|network| network.contains(peer))
    }

    /// The turns of a peer's connections; none of a proxy, whose requests are those of many
    /// clients.
    pub(crate) fn turns(&self, peer: IpAddr) -> Option<AddressTurns> {
        (!self.is_proxy(peer)).then(|| self.turns.of(peer))
    }

    fn timeouts(&self) -> Timeouts {
        self.app.config().timeouts
    }

    /// Serves a connection until it ends.
    pub(crate) async fn serve(
        &self,
        socket: TcpStream,
        peer: SocketAddr,
        permit: ConnectionPermit,
        turns: Option<AddressTurns>,
    ) {
        let opening = async {
            let stream = WriteTimeoutStream::new(socket, self.timeouts().write, permit)?;
            let opened = unless(
                self.first_head_grace(),
                timeout(self.timeouts().header, self.open(stream)),
            )
            .await;
            opened
                .and_then(Result::ok)
                .unwrap_or_else(|| Err(io::ErrorKind::TimedOut.into()))
        };
        match opening.await {
            Ok((transport, Protocol::Http1)) => {
                self.http1(transport, peer, &self.router, true).await
            }
            Ok((transport, Protocol::NotTls)) => {
                self.http1(transport, peer, &self.tls_required, false).await
            }
            Ok((transport, Protocol::Http2)) => self.http2(transport, peer, turns).await,
            Err(error) => tracing::debug!(%error, "a connection ended before its first request"),
        }
    }

    /// Reads the first bytes or makes the TLS handshake, and chooses the protocol.
    async fn open(&self, stream: WriteTimeoutStream) -> io::Result<(Transport, Protocol)> {
        // Browsers and proxies open connections in advance; a stopping server ends those that have
        // sent nothing.
        let (mut first, mut unread) = ([0], [MaybeUninit::uninit()]);
        match unless(self.stopping(), stream.socket().peek(&mut first)).await {
            Some(peeked) => peeked?,
            None => SockRef::from(stream.socket()).peek(&mut unread)?,
        };
        let Some(tls) = &self.tls else {
            let protocol = plain_protocol(stream.socket()).await?;
            return Ok((Transport::Left(stream), protocol));
        };
        // HTTP methods begin with a letter; TLS records do not.
        if first[0].is_ascii_uppercase() {
            return Ok((Transport::Left(stream), Protocol::NotTls));
        }
        let config = Arc::clone(&tls.borrow());
        let (stream, is_http2) = accept(config, stream).await?;
        Ok((
            Transport::Right(Box::new(stream)),
            if is_http2 {
                Protocol::Http2
            } else {
                Protocol::Http1
            },
        ))
    }

    async fn http1(
        &self,
        transport: Transport,
        peer: SocketAddr,
        router: &Router,
        keep_alive: bool,
    ) {
        let mut builder = http1::Builder::new();
        builder
            .timer(TokioTimer::new())
            .header_read_timeout(self.timeouts().header)
            .max_buf_size(HTTP1_HEAD_BYTES)
            .keep_alive(keep_alive);
        let has_request = Arc::default();
        let connection = builder
            .serve_connection(
                TokioIo::new(transport),
                self.service(router, peer, &has_request),
            )
            .with_upgrades();
        self.drive(
            pin!(connection),
            http1::UpgradeableConnection::graceful_shutdown,
            &has_request,
            pending(),
        )
        .await;
    }

    async fn http2(&self, transport: Transport, peer: SocketAddr, turns: Option<AddressTurns>) {
        let timeouts = self.timeouts();
        let streams = Streams::new(timeouts.write, turns);
        let mut builder = http2::Builder::new(streams.clone());
        builder
            .timer(TokioTimer::new())
            .max_concurrent_streams(MAX_STREAMS)
            .max_pending_accept_reset_streams(PENDING_RESETS)
            .max_local_error_reset_streams(LOCAL_RESETS)
            .max_header_list_size(HTTP2_HEADER_BYTES)
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW)
            .max_send_buf_size(STREAM_SEND_BYTES)
            .keep_alive_interval(timeouts.header)
            .keep_alive_timeout(timeouts.header);
        let has_request = Arc::default();
        let connection = builder.serve_connection(
            TokioIo::new(transport),
            self.service(&self.router, peer, &has_request),
        );
        self.drive(
            pin!(connection),
            http2::Connection::graceful_shutdown,
            &has_request,
            streams.idle(timeouts.header),
        )
        .await;
    }

    /// Runs a connection to its end. It is shut down gracefully when the service stops or when
    /// `idle` completes.
    async fn drive<C: Future<Output = hyper::Result<()>>>(
        &self,
        mut connection: Pin<&mut C>,
        shut_down: fn(Pin<&mut C>),
        has_request: &AtomicBool,
        idle: impl Future<Output = ()>,
    ) {
        // Polled first: a connection that is shut down before it has read anything does not read a
        // request that has arrived.
        let ended = tokio::select! {
            biased;
            ended = connection.as_mut() => Some(ended),
            () = self.stopping() => {
                shut_down(connection.as_mut());
                // hyper would wait for a first request head as long as for any other one.
                let no_request = async {
                    self.first_head_grace().await;
                    if has_request.load(Ordering::Relaxed) {
                        pending().await
                    }
                };
                unless(no_request, connection).await
            }
            () = idle => {
                shut_down(connection.as_mut());
                timeout(self.timeouts().write, connection).await.ok()
            }
        };
        match ended {
            Some(Ok(())) => {}
            Some(Err(error)) => tracing::debug!(%error, "a connection ended early"),
            None => tracing::debug!(
                "a connection did not end after its graceful shutdown: it is closed"
            ),
        }
    }

    /// Answers the requests of a connection, and records that there was one.
    fn service(
        &self,
        router: &Router,
        peer: SocketAddr,
        has_request: &Arc<AtomicBool>,
    ) -> impl Service<Request<Incoming>, Response = Response<Body>, Error = Infallible, Future: Send>
    + Clone
    + Send
    + use<> {
        let (router, has_request) = (
            TowerToHyperService::new(router.clone()),
            Arc::clone(has_request),
        );
        let turns = RequestTurns {
            turns: self.turns.clone(),
            is_of_proxy: self.is_proxy(peer.ip()),
        };
        service_fn(move |mut request: Request<Incoming>| {
            has_request.store(true, Ordering::Relaxed);
            request.extensions_mut().insert(ConnectInfo(peer));
            request.extensions_mut().insert(turns.clone());
            let response = router.call(request);
            async move { Ok(response.await?.map(with_stall_timeout)) }
        })
    }

    /// Completes when the service stops. The ops listener goes on.
    async fn stopping(&self) {
        if self.is_ops {
            pending().await
        }
        self.app.lifecycle.stopping().await;
    }

    /// Completes when a stopping server no longer waits for a first request head.
    async fn first_head_grace(&self) {
        self.stopping().await;
        sleep(FIRST_HEAD_GRACE).await;
    }
}

/// Tells HTTP/2 from HTTP/1 without reading: hyper's header timeout begins only afterwards. `P` may
/// begin `POST` or the preface.
async fn plain_protocol(socket: &TcpStream) -> io::Result<Protocol> {
    let mut first = [0; PREFACE.len()];
    loop {
        let read = socket.peek(&mut first).await?;
        if read == PREFACE.len() && first == *PREFACE {
            return Ok(Protocol::Http2);
        }
        if read == 0 || first[..read] != PREFACE[..read] {
            return Ok(Protocol::Http1);
        }
        sleep(PREFACE_PAUSE).await;
    }
}
