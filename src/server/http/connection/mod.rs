//! The listener and its end. Connections have tasks of their own (`connection.rs`); every wait for a client has an end. SIGTERM and Ctrl-C stop
//! asking for newcomers, then accepting them, let requests finish for the grace period, and end the server; a second one leaves them a moment. Keys and certificate are read again when their files change.

mod heads;
pub(crate) mod reload;
pub(crate) mod serve;
pub(crate) mod stream_stall;
pub(crate) mod transport;
pub(crate) mod write_timeout;

use std::future::Future;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::sync::watch;
use tokio::task::JoinSet;

use reload::Reloader;
use serve::Connections;
pub(crate) use transport::Transport;

use crate::app::{App, NotStarted};
use crate::auth::tls::TlsFiles;
use crate::config::Config;

/// Longest time for drag sockets to close when the service stops, and then for the last traces to leave.
const FAREWELL: Duration = Duration::from_secs(3);
/// What is left of all of that, the grace included, to whoever is told a second time.
const HURRY: Duration = Duration::from_secs(1);
/// Pause when the operating system has no room for another connection.
const NO_ROOM: Duration = Duration::from_millis(100);
/// Files beside connections: the runtime's, the store's, the log, those who watch.
const OTHER_FILES: u64 = 256;

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
    /// No threads, or no store.
    #[error("{0}")]
    NotStarted(#[from] NotStarted),
    /// The certificate or its key.
    #[error("{0}")]
    Tls(String),
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
        let stop = stop_signal(&app)?;
        serve(app, listener, stop).await
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
/// The listener failed, or the certificate cannot be read.
pub async fn serve(app: App, listener: TcpListener, stop: impl Future<Output = ()> + Send + 'static) -> Result<(), ServeError> {
    let config = app.config().clone();
    let (access, timeouts) = (&config.auth, config.timeouts);
    app.spawn_sweeper();
    let address = listener.local_addr()?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let watchers = config.telemetry.metrics_listen.map(listen).transpose()?;
    raise_open_files(config.clients.max_connections);
    let tls = access.tls.as_ref().map(TlsFiles::load).transpose().map_err(ServeError::Tls)?.map(watch::Sender::new);
    let connections = Arc::new(Connections::new(&app, tls.as_ref().map(watch::Sender::subscribe)));
    let reread = Reloader::new(&app, tls);
    let scheme = if access.tls.is_some() { "https" } else { "http" };
    let work = config.work;
    tracing::info!(
        workers = work.workers,
        queue = work.queue(),
        memory = work.memory_bytes,
        keys = reread.keys(),
        "listening on {scheme}://{address}"
    );
    reread.warn_of_readable_secrets();
    if access.has_keys_in_plain(address) {
        tracing::warn!(
            "keys travel unencrypted: {address} is not a loopback address, and --tls-cert (MLSWARP_TLS_CERT) is not set. Set --tls-cert and \
             --tls-key, or put a proxy that speaks TLS in front and let only that reach this address"
        );
    }
    // Until this function ends, whatever becomes of the others.
    let _watched = watchers.map(|listener| watched(&app, listener)).transpose()?;
    let mut tasks = JoinSet::new();
    let left = async {
        stop.await;
        app.leave();
        if !timeouts.drain_delay.is_zero() {
            tracing::info!(delay = ?timeouts.drain_delay, "leaving: not ready any more, still serving");
            tokio::select! {
                () = tokio::time::sleep(timeouts.drain_delay) => {}
                () = app.hurrying() => {}
            }
        }
    };
    tokio::select! {
        () = accept(&listener, &connections, &mut tasks) => {}
        () = reread.run() => {}
        () = left => {}
    }
    drop(listener);
    tracing::info!(grace = ?timeouts.shutdown_grace, connections = tasks.len(), "stopping");
    app.stop();
    let ending = async {
        let all_ended = async { while tasks.join_next().await.is_some() {} };
        // Those that go on after the grace are cut off.
        let _ = tokio::time::timeout(timeouts.shutdown_grace, all_ended).await;
        tasks.abort_all();
        // Drag sockets are no longer of these tasks; each says that it closes and waits for no one.
        let _ = tokio::time::timeout(FAREWELL, app.sockets_closed()).await;
        if let Some(tracer) = app.tracer() {
            tracer.shutdown(FAREWELL).await;
        }
    };
    let hurried = async {
        app.hurrying().await;
        tokio::time::sleep(HURRY).await;
    };
    tokio::select! {
        () = ending => {}
        () = hurried => tracing::warn!("told twice to stop: what has not ended within {HURRY:?} is cut off"),
    }
    tracing::info!("stopped");
    Ok(())
}

/// Answers those who watch the service, on a listener of their own, for as long as what comes back is kept.
fn watched(app: &App, listener: TcpListener) -> io::Result<JoinSet<()>> {
    let address = listener.local_addr()?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let connections = Arc::new(Connections::of_watchers(app));
    tracing::info!("metrics and health on http://{address}");
    let mut task = JoinSet::new();
    task.spawn(async move { accept(&listener, &connections, &mut JoinSet::new()).await });
    Ok(task)
}

/// Takes connections, one task each, for ever.
async fn accept(listener: &tokio::net::TcpListener, connections: &Arc<Connections>, tasks: &mut JoinSet<()>) {
    loop {
        let (socket, peer) = tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                // One that has left already.
                Err(error) if matches!(error.kind(), io::ErrorKind::ConnectionAborted | io::ErrorKind::ConnectionReset) => continue,
                Err(error) => {
                    // No file or no memory is left for another: it waits in the backlog until there is.
                    tracing::warn!(%error, "no connection can be taken");
                    tokio::time::sleep(NO_ROOM).await;
                    continue;
                }
            },
            Some(_) = tasks.join_next() => continue,
        };
        let Some(place) = connections.place(peer.ip()) else {
            tracing::debug!(peer = %peer.ip(), "no place for another connection: it is closed");
            continue;
        };
        let connections = Arc::clone(connections);
        tasks.spawn(async move { connections.serve(socket, peer, place).await });
    }
}

/// Every connection is an open file. A soft limit that is too low is raised as far as the hard one allows.
fn raise_open_files(connections: usize) {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
        let wanted = connections as u64 + OTHER_FILES;
        let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
        if current.is_none_or(|current| current >= wanted) {
            return;
        }
        let raised = maximum.map_or(wanted, |maximum| maximum.min(wanted));
        let set = setrlimit(Resource::Nofile, Rlimit { current: Some(raised), maximum });
        if set.is_err() || raised < wanted {
            tracing::warn!(limit = raised, wanted, "the limit of open files is too low for --max-connections: raise it (ulimit -n)");
        }
    }
}

/// Ends at SIGTERM or Ctrl-C, listens from the moment it is made, and afterwards for a second one, which hurries. A third is nothing more.
fn stop_signal(app: &App) -> io::Result<impl Future<Output = ()> + Send + 'static> {
    let (mut signals, app) = (Signals::new()?, app.clone());
    Ok(async move {
        signals.next().await;
        tokio::spawn(async move {
            signals.next().await;
            app.hurry();
        });
    })
}

/// SIGTERM and Ctrl-C.
struct Signals {
    #[cfg(unix)]
    terminate: tokio::signal::unix::Signal,
    #[cfg(unix)]
    interrupt: tokio::signal::unix::Signal,
}

impl Signals {
    fn new() -> io::Result<Self> {
        #[cfg(unix)]
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            #[cfg(unix)]
            terminate: signal(SignalKind::terminate())?,
            #[cfg(unix)]
            interrupt: signal(SignalKind::interrupt())?,
        })
    }

    async fn next(&mut self) {
        #[cfg(unix)]
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
        #[cfg(not(unix))]
        let _ = tokio::signal::ctrl_c().await;
    }
}
