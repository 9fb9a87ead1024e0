//! Sockets: the listener, its deadlines, and stopping. A connection that sends nothing, a head that trickles in and an idle connection
//! are closed after the header timeout. SIGTERM and Ctrl-C stop accepting, let requests finish for the grace period, and end the server.

use std::future::Future;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::pin::Pin;
use std::time::Duration;

use axum_server::Handle;
use axum_server::accept::Accept;
use hyper_util::rt::TokioTimer;
use thiserror::Error;
use tokio::net::TcpStream;

use super::router;
use crate::service::App;
use crate::service::config::Config;
use crate::service::pool::NoThreads;

/// Streams that one HTTP/2 connection may have open.
const STREAMS: u32 = 64;

/// Longest time for drag sockets to close when the service stops.
const FAREWELL: Duration = Duration::from_secs(3);

/// Why the server did not start, or ended.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The address is not free, or not ours.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// No threads.
    #[error("cannot start compute threads: {0}")]
    Threads(#[from] NoThreads),
    /// The runtime or the listener failed.
    #[error("{0}")]
    Io(#[from] io::Error),
}

/// Serves until a signal, on a runtime of its own.
///
/// # Errors
/// See [`ServeError`].
pub fn run(config: Config) -> Result<(), ServeError> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let ended = runtime.block_on(async {
        let listener = listen(config.listen)?;
        let app = App::new(config)?;
        serve(app, listener, stop_signal()?).await
    });
    // What still runs belongs to clients that have been cut off.
    runtime.shutdown_timeout(Duration::from_millis(100));
    ended
}

/// Binds, before anything else is started.
///
/// # Errors
/// [`ServeError::Listen`].
pub fn listen(address: SocketAddr) -> Result<TcpListener, ServeError> {
    let bind = || {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(listener)
    };
    bind().map_err(|source| ServeError::Listen { address, source })
}

/// Serves on a bound socket until `stop` ends, then drains.
///
/// # Errors
/// The listener failed.
pub async fn serve(app: App, listener: TcpListener, stop: impl Future<Output = ()> + Send + 'static) -> Result<(), ServeError> {
    let config = app.config().clone();
    app.spawn_sweeper();
    let address = listener.local_addr()?;
    let handle = Handle::new();
    let mut server = axum_server::from_tcp(listener)?.handle(handle.clone()).acceptor(FirstByte { within: config.header_timeout });
    server.http_builder().http1().timer(TokioTimer::new()).header_read_timeout(config.header_timeout);
    server
        .http_builder()
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(STREAMS)
        .keep_alive_interval(config.header_timeout)
        .keep_alive_timeout(config.header_timeout);
    tracing::info!(
        workers = config.work.workers,
        queue = config.work.queue,
        memory = config.work.memory_bytes,
        "listening on http://{address}"
    );
    let (service, sockets) = (router(app.clone()).into_make_service_with_connect_info::<SocketAddr>(), app.clone());
    tokio::spawn(async move {
        stop.await;
        app.drain();
        tracing::info!(grace = ?config.shutdown_grace, connections = handle.connection_count(), "stopping");
        handle.graceful_shutdown(Some(config.shutdown_grace));
    });
    server.serve(service).await?;
    // Their connections are no longer the server's; each says that it closes and waits for no one.
    let _ = tokio::time::timeout(FAREWELL, sockets.drags_ended()).await;
    tracing::info!("stopped");
    Ok(())
}

/// Ends at SIGTERM or Ctrl-C. Listens from the moment it is made.
fn stop_signal() -> io::Result<impl Future<Output = ()> + Send + 'static> {
    #[cfg(unix)]
    let mut terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
    #[cfg(unix)]
    let mut interrupt = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::interrupt())?;
    Ok(async move {
        #[cfg(unix)]
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
        #[cfg(not(unix))]
        let _ = tokio::signal::ctrl_c().await;
    })
}

/// Closes a connection that does not say anything in time: the HTTP version is told by the first bytes, and hyper waits for them
/// without a deadline.
#[derive(Clone, Copy, Debug)]
struct FirstByte {
    within: Duration,
}

/// What an HTTP/2 connection begins with (RFC 9113, section 3.4).
const PREFACE: &[u8; 24] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// How often a connection that has sent a part of the preface is looked at again.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// Ends when the version is known: hyper's header timeout begins only then. `P` may be the beginning of `POST` or of the preface.
async fn version(stream: &TcpStream) -> io::Result<()> {
    let mut first = [0; PREFACE.len()];
    loop {
        let seen = stream.peek(&mut first).await?;
        if seen == 0 || seen == PREFACE.len() || first[..seen] != PREFACE[..seen] {
            return Ok(());
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

impl<S: Send + 'static> Accept<TcpStream, S> for FirstByte {
    type Stream = TcpStream;
    type Service = S;
    type Future = Pin<Box<dyn Future<Output = io::Result<(TcpStream, S)>> + Send>>;

    fn accept(&self, stream: TcpStream, service: S) -> Self::Future {
        let within = self.within;
        Box::pin(async move {
            // Strips leave when they are made; waiting to fill a segment would hold back the last one.
            stream.set_nodelay(true)?;
            tokio::time::timeout(within, version(&stream)).await.map_err(|_| io::ErrorKind::TimedOut)??;
            Ok((stream, service))
        })
    }
}
