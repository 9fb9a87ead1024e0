//! One connection from its first byte to its end, every step of it within a time: the TLS handshake or the first bytes, which tell the version;
//! the head; the body (`body.rs`); the answer (`steady.rs`, `streams.rs`); and what lies between two requests.

use std::convert::Infallible;
use std::io;
use std::mem::MaybeUninit;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::header::EXPECT;
use axum::http::{Request, Response};
use hyper::body::Incoming;
use hyper::server::conn::{http1, http2};
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket2::SockRef;
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::time::timeout;

use super::heads::{HEAD, Heads, Turns, counted};
use super::stream_stall::{Streams, with_stall_timeout};
use super::transport::Transport;
use super::write_timeout::WriteTimeoutStream;
use crate::app::App;
use crate::auth::tls::{ServerConfig, accept};
use crate::config::AccessConfig;
use crate::http::body::{LimitedBody, Waiting};
use crate::http::middleware::refused;
use crate::http::{router, watched};
use crate::limits::connections::{ConnectionLimiter, ConnectionPermit};
use crate::problem::{Code, Problem};

/// Streams that one HTTP/2 connection may have open.
const STREAMS: u32 = 64;
/// Streams that a client has reset and that are not yet accepted: one more ends the connection (CVE-2023-44487).
const PENDING_RESETS: usize = 20;
/// Streams that were reset from here for the client's mistakes: one more ends the connection (CVE-2025-8671).
const LOCAL_RESETS: usize = 1024;

const HEAD_H2: u32 = 16 << 10;
/// What an HTTP/2 client may send ahead on a stream, and on all of them: bytes that are kept until they are read.
const STREAM_WINDOW: u32 = 256 << 10;
const CONNECTION_WINDOW: u32 = 512 << 10;
/// What waits of a stream's answer for the client's window.
const STREAM_SEND: usize = 64 << 10;

/// Connections of those who watch the service, and of one address among them.
const WATCHERS: (usize, usize) = (64, 32);

/// What an HTTP/2 connection begins with (RFC 9113, section 3.4).
const PREFACE: &[u8; 24] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// Whoever has sent a part of its first head, or of a handshake, when the service stops has so long for the rest: it may be on its way.
const LATE: Duration = Duration::from_millis(500);
/// How often a connection that has sent a part of the preface is looked at again.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Version {
    Http1,
    Http2,
    /// HTTP/1.1, or something like it, where TLS is spoken.
    Unencrypted,
}

/// What all connections share.
pub(crate) struct Connections {
    app: App,
    router: Router,
    config: AccessConfig,
    tls: Option<watch::Receiver<Arc<ServerConfig>>>,
    places: ConnectionLimiter,
    /// They go on while the service stops, to its very end.
    are_last: bool,
}

impl Connections {
    /// Of the service.
    pub(crate) fn new(app: &App, tls: Option<watch::Receiver<Arc<ServerConfig>>>) -> Self {
        let places = app.access().places().clone();
        Self { app: app.clone(), router: router(app.clone()), config: app.config().access.clone(), tls, places, are_last: false }
    }

    /// Of those who watch it.
    pub(crate) fn of_watchers(app: &App) -> Self {
        let places = ConnectionLimiter::new(WATCHERS.0, WATCHERS.1);
        Self { app: app.clone(), router: watched(app.clone()), config: app.config().access.clone(), tls: None, places, are_last: true }
    }

    /// A place for another connection, if there is one.
    pub(crate) fn place(&self, peer: IpAddr) -> Option<ConnectionPermit> {
        self.places.take(peer, self.config.trusted_proxies.iter().any(|network| network.contains(peer)))
    }

    /// Serves a connection until it ends.
    pub(crate) async fn serve(&self, socket: TcpStream, peer: SocketAddr, place: ConnectionPermit) {
        let opened = match WriteTimeoutStream::new(socket, self.config.write_timeout, place) {
            Ok(steady) => tokio::select! {
                opened = timeout(self.config.header_timeout, self.open(steady)) => opened.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into())),
                () = self.late() => Err(io::ErrorKind::TimedOut.into()),
            },
            Err(error) => Err(error),
        };
        match opened {
            Ok((wire, Version::Http1)) => {
                let begun = Arc::default();
                self.http1(wire, &self.http1_builder(), &begun, self.service(peer, &begun)).await;
            }
            Ok((wire, Version::Http2)) => self.http2(wire, peer).await,
            Ok((wire, Version::Unencrypted)) => self.unencrypted(wire).await,
            Err(error) => tracing::debug!(%error, "a connection ended before its first request"),
        }
    }

    async fn open(&self, steady: WriteTimeoutStream) -> io::Result<(Transport, Version)> {
        // Browsers and proxies open connections ahead: whoever has said nothing when the service stops is not waited for.
        let (mut first, mut late) = ([0], [MaybeUninit::uninit()]);
        tokio::select! {
            said = steady.socket().peek(&mut first) => said?,
            () = self.stopping() => SockRef::from(steady.socket()).peek(&mut late)?,
        };
        let Some(tls) = &self.tls else {
            let version = version(steady.socket()).await?;
            return Ok((Transport::plain(steady), version));
        };
        // No record of TLS begins with a letter; every method does.
        if first[0].is_ascii_uppercase() {
            return Ok((Transport::plain(steady), Version::Unencrypted));
        }
        let config = Arc::clone(&tls.borrow());
        let (stream, is_http2) = accept(config, steady).await?;
        Ok((Transport::tls(stream), if is_http2 { Version::Http2 } else { Version::Http1 }))
    }

    async fn http1<S>(&self, wire: Transport, builder: &http1::Builder, begun: &AtomicBool, service: S)
    where
        S: Service<Request<Incoming>, Response = Response<Body>, Error = Infallible, Future: Send>,
    {
        let turns = Arc::<Turns>::default();
        let wire = wire.with(Heads::new(self.app.clone(), Arc::clone(&turns)));
        let service = counted(turns, service);
        let mut connection = std::pin::pin!(builder.serve_connection(TokioIo::new(wire), service).with_upgrades());
        // The connection first: one that has not read anything when it is told to end does not read what has come.
        let ended = tokio::select! {
            biased;
            ended = connection.as_mut() => ended,
            () = self.stopping() => {
                connection.as_mut().graceful_shutdown();
                tokio::select! {
                    biased;
                    ended = connection.as_mut() => ended,
                    () = self.unbegun(begun) => return log_late(),
                }
            }
        };
        log_end(ended);
    }

    fn http1_builder(&self) -> http1::Builder {
        let mut builder = http1::Builder::new();
        builder.timer(TokioTimer::new()).header_read_timeout(self.config.header_timeout).max_buf_size(HEAD);
        builder
    }

    /// Whoever forgot the s of https learns of it, also by sending a whole picture before reading.
    async fn unencrypted(&self, wire: Transport) {
        let begun = AtomicBool::default();
        let refusing = service_fn(|request: Request<Incoming>| {
            begun.store(true, Ordering::Relaxed);
            let waits = request.headers().contains_key(EXPECT);
            drop(LimitedBody::wrap(Body::new(request.into_body()), 0, self.config.body_timeout, waits, Waiting::default()));
            let problem = Problem::new(Code::MalformedRequest, "plain HTTP where TLS is spoken: the address begins with https://");
            std::future::ready(Ok(refused(&self.app, problem)))
        });
        self.http1(wire, self.http1_builder().keep_alive(false), &begun, refusing).await;
    }

    async fn http2(&self, wire: Transport, peer: SocketAddr) {
        let streams = Streams::new(self.config.write_timeout);
        let mut builder = http2::Builder::new(streams.clone());
        builder
            .timer(TokioTimer::new())
            .max_concurrent_streams(STREAMS)
            .max_pending_accept_reset_streams(PENDING_RESETS)
            .max_local_error_reset_streams(LOCAL_RESETS)
            .max_header_list_size(HEAD_H2)
            .initial_stream_window_size(STREAM_WINDOW)
            .initial_connection_window_size(CONNECTION_WINDOW)
            .max_send_buf_size(STREAM_SEND)
            .keep_alive_interval(self.config.header_timeout)
            .keep_alive_timeout(self.config.header_timeout);
        let begun = Arc::<AtomicBool>::default();
        let service = self.service(peer, &begun);
        let mut connection = std::pin::pin!(builder.serve_connection(TokioIo::new(wire), service));
        let ended = tokio::select! {
            biased;
            ended = connection.as_mut() => ended,
            () = self.stopping() => {
                connection.as_mut().graceful_shutdown();
                tokio::select! {
                    biased;
                    ended = connection.as_mut() => ended,
                    () = self.unbegun(&begun) => return log_late(),
                }
            }
            () = streams.idle(self.config.header_timeout) => {
                connection.as_mut().graceful_shutdown();
                // What is left is in the hands of the client: the last bytes of an answer, or nothing.
                match timeout(self.config.write_timeout, connection).await {
                    Ok(ended) => ended,
                    Err(_) => return tracing::debug!("a connection without requests did not end: it is cut"),
                }
            }
        };
        log_end(ended);
    }

    /// Waits until they are to end.
    async fn stopping(&self) {
        if self.are_last {
            return std::future::pending().await;
        }
        self.app.stopping().await;
    }

    /// Ends a while after the service stops.
    async fn late(&self) {
        self.stopping().await;
        tokio::time::sleep(LATE).await;
    }

    /// Ends when nothing has come of a connection by then: hyper would wait for the rest of its first head as long as for any. After a first request
    /// hyper waits for nothing but the answer.
    async fn unbegun(&self, begun: &AtomicBool) {
        self.late().await;
        if begun.load(Ordering::Relaxed) {
            std::future::pending().await
        }
    }

    /// Answers a connection's requests, and notes that there was one.
    fn service(
        &self,
        peer: SocketAddr,
        begun: &Arc<AtomicBool>,
    ) -> impl Service<Request<Incoming>, Response = Response<Body>, Error = Infallible, Future: Send> + Clone + Send + use<> {
        let (router, begun) = (TowerToHyperService::new(self.router.clone()), Arc::clone(begun));
        service_fn(move |mut request: Request<Incoming>| {
            begun.store(true, Ordering::Relaxed);
            request.extensions_mut().insert(ConnectInfo(peer));
            let answer = router.call(request);
            async move { Ok(answer.await?.map(with_stall_timeout)) }
        })
    }
}

fn log_late() {
    tracing::debug!("a connection that had sent a part of its first head is closed: the service stops");
}

fn log_end(ended: hyper::Result<()>) {
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection ended early");
    }
}

/// Ends when the version is known: hyper's header timeout begins only then. `P` may be the beginning of `POST` or of the preface.
async fn version(stream: &TcpStream) -> io::Result<Version> {
    let mut first = [0; PREFACE.len()];
    loop {
        let seen = stream.peek(&mut first).await?;
        if seen == PREFACE.len() && first == *PREFACE {
            return Ok(Version::Http2);
        }
        if seen == 0 || first[..seen] != PREFACE[..seen] {
            return Ok(Version::Http1);
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}
