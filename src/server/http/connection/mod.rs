//! The listener: accepts connections, reloads keys and certificate, and drains after SIGTERM or
//! Ctrl-C. A second signal shortens the drain.

pub(crate) mod reload;
pub(crate) mod serve;
pub(crate) mod signals;
pub(crate) mod stream_stall;
pub(crate) mod transport;
pub(crate) mod turns;

use std::future::Future;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use crate::app::App;
use crate::auth::tls::TlsFiles;
use crate::config::Config;
use reload::Reloader;
use serve::Connections;
use signals::Signals;

/// Maximum time for drag sockets to close after the grace, and then for the exporter of traces to
/// finish.
const FINISH_TIMEOUT: Duration = Duration::from_secs(3);
/// Maximum time for all of the shutdown after a second signal.
const HURRY_TIMEOUT: Duration = Duration::from_secs(1);
/// Pause after the operating system has refused another connection.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Async tasks compute little: a thread serves the tasks of this many workers. More threads wake
/// each other for every request.
const WORKERS_PER_ASYNC_THREAD: usize = 2;
/// Open files beside connections: of the runtime, the store, the log and the ops listener.
const OTHER_FILES: u64 = 256;

/// Serves until a signal, on its own runtime.
/// Errors: it cannot start, or the listener failed.
pub fn run(config: Config) -> io::Result<()> {
    let threads = config.work.workers.div_ceil(WORKERS_PER_ASYNC_THREAD);
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(threads)
        .enable_all()
        .build()?;
    // Not on this thread, whose allocations would wait for those of long work (`pool/arena.rs`).
    let serving = runtime.spawn(async {
        let listener = listen(config.listen)?;
        let app = App::new(config).map_err(io::Error::other)?;
        let stop = stop_signal(&app)?;
        serve(app, listener, stop).await
    });
    let ended = runtime.block_on(serving).map_err(io::Error::other);
    // Only tasks of clients that were cut off are left.
    runtime.shutdown_timeout(Duration::from_millis(100));
    ended?
}

/// Binds an address.
/// Errors: the address cannot be bound.
pub fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener));
    listener.map_err(|error| {
        io::Error::new(error.kind(), format!("cannot listen on {address}: {error}"))
    })
}

/// Serves on a bound socket until `stop` completes, then drains.
/// Errors: the listener failed, or the certificate cannot be read.
pub async fn serve(
    app: App,
    listener: TcpListener,
    stop: impl Future<Output = ()> + Send + 'static,
) -> io::Result<()> {
    let (access, work, timeouts) = (&app.config().auth, app.config().work, app.config().timeouts);
    app.sessions.spawn_sweeper();
    let address = listener.local_addr()?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let ops_listener = app
        .config()
        .telemetry
        .metrics_listen
        .map(listen)
        .transpose()?;
    raise_open_files(app.config().clients.max_connections);
    let tls = access
        .tls
        .as_ref()
        .map(TlsFiles::load)
        .transpose()
        .map_err(io::Error::other)?
        .map(watch::Sender::new);
    let connections = Arc::new(Connections::new(
        &app,
        tls.as_ref().map(watch::Sender::subscribe),
    ));
    let reloader = Reloader::new(&app, tls);
    let scheme = if access.tls.is_some() {
        "https"
    } else {
        "http"
    };
    let keys = access.keys.as_ref().map_or(0, |keys| keys.all.len());
    tracing::info!(
        workers = work.workers,
        queue = work.queue(),
        memory = work.memory_bytes,
        keys,
        "listening on {scheme}://{address}"
    );
    reloader.warn_of_readable_secrets();
    if access.has_keys_in_plain(address) {
        tracing::warn!(
            "keys travel unencrypted: {address} is not a loopback address, and --tls-cert \
                (MLSWARP_TLS_CERT) is not set. Set --tls-cert \
             and --tls-key, or put a proxy that speaks TLS in front and let only that reach this \
             address"
        );
    }
    // Serves until this function returns.
    let _ops = ops_listener
        .map(|listener| serve_ops(&app, listener))
        .transpose()?;
    let mut tasks = JoinSet::new();
    let leaving = async {
        stop.await;
        app.lifecycle.leave();
        if !timeouts.drain_delay.is_zero() {
            tracing::info!(delay = ?timeouts.drain_delay, "leaving: not ready any more, still \
                serving");
            unless(app.lifecycle.hurrying(), sleep(timeouts.drain_delay)).await;
        }
    };
    tokio::select! {
        () = accept(&listener, &connections, &mut tasks) => {}
        () = reloader.run() => {}
        () = leaving => {}
    }
    drop(listener);
    tracing::info!(grace = ?timeouts.shutdown_grace, connections = tasks.len(), "stopping");
    app.lifecycle.stop();
    let draining = async {
        // What has not ended after the grace is aborted.
        let _ = timeout(timeouts.shutdown_grace, async {
            while tasks.join_next().await.is_some() {}
        })
        .await;
        tasks.abort_all();
        // Drag sockets have tasks of their own.
        let _ = timeout(FINISH_TIMEOUT, app.admission.sockets.closed()).await;
        if let Some(tracer) = app.tracer() {
            tracer.shutdown(FINISH_TIMEOUT).await;
        }
    };
    let hurried = async {
        app.lifecycle.hurrying().await;
        sleep(HURRY_TIMEOUT).await;
    };
    if unless(hurried, draining).await.is_none() {
        tracing::warn!(
            "second signal to stop: connections that remain after {HURRY_TIMEOUT:?} are closed"
        );
    }
    tracing::info!("stopped");
    Ok(())
}

/// Runs `work` to its end, or until `stop` completes first.
async fn unless<T>(stop: impl Future<Output = ()>, work: impl Future<Output = T>) -> Option<T> {
    tokio::select! {
        biased;
        done = work => Some(done),
        () = stop => None,
    }
}

/// Serves metrics and health on their own listener, until the returned task is dropped.
fn serve_ops(app: &App, listener: TcpListener) -> io::Result<JoinSet<()>> {
    let address = listener.local_addr()?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let connections = Arc::new(Connections::ops(app));
    tracing::info!("metrics and health on http://{address}");
    let mut task = JoinSet::new();
    task.spawn(async move { accept(&listener, &connections, &mut JoinSet::new()).await });
    Ok(task)
}

/// Accepts connections forever, one task each.
async fn accept(
    listener: &tokio::net::TcpListener,
    connections: &Arc<Connections>,
    tasks: &mut JoinSet<()>,
) {
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = tasks.join_next() => continue,
        };
        match accepted {
            Ok((socket, peer)) => match connections.admit(peer.ip()) {
                Some(permit) => {
                    let connections = Arc::clone(connections);
                    let turns = connections.turns(peer.ip());
                    let take = turns.clone();
                    let serving =
                        async move { connections.serve(socket, peer, permit, turns).await };
                    match take {
                        Some(turns) => tasks.spawn(turns.take(serving)),
                        None => tasks.spawn(serving),
                    };
                }
                None => {
                    tracing::debug!(peer = %peer.ip(), "connection limit reached: the connection \
                        is closed")
                }
            },
            // The client has closed the connection already.
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::ConnectionAborted | io::ErrorKind::ConnectionReset
                ) => {}
            Err(error) => {
                // Out of files or memory: connections wait in the backlog.
                tracing::warn!(%error, "cannot accept a connection");
                sleep(ACCEPT_PAUSE).await;
            }
        }
    }
}

/// Raises the soft limit of open files to what the connections need, as far as the hard limit
/// allows.
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
        let set = setrlimit(
            Resource::Nofile,
            Rlimit {
                current: Some(raised),
                maximum,
            },
        );
        if set.is_err() || raised < wanted {
            tracing::warn!(
                limit = raised,
                wanted,
                "the limit of open files is too low for --max-connections: raise it (ulimit -n)"
            );
        }
    }
}

/// Completes at the first signal to stop. A second signal hurries; further ones do nothing.
fn stop_signal(app: &App) -> io::Result<impl Future<Output = ()> + Send + 'static> {
    let (mut signals, app) = (Signals::stop()?, app.clone());
    Ok(async move {
        signals.recv().await;
        tokio::spawn(async move {
            signals.recv().await;
            app.lifecycle.hurry();
        });
    })
}
