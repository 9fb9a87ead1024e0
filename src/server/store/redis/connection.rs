//! One connection to the server, with a bound on every wait: for many requests at a time, or, of those for files, for one. A connection that broke is
//! made anew by the next request. A server to which none can be made, or which does not answer, is left alone for a second, in which all who ask are
//! told so at once. A file that does not come in time says nothing of the server, and ends its own connection alone.

use std::future::Future;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex as SyncMutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use redis::aio::MultiplexedConnection;
use redis::{AsyncConnectionConfig, Client, ErrorKind, RedisError, RedisResult};
use tokio::sync::Mutex;
use tokio::time::timeout;

use crate::observe::Scope;
use crate::store::{Address, StoreError};

/// Longest wait for a connection.
const CONNECT: Duration = Duration::from_secs(1);
/// How long a server that does not answer is left alone.
const PAUSE: Duration = Duration::from_secs(1);
/// Requests that wait to be written.
const WAITING: usize = 1024;

/// A connection, or the want of one. Cloning shares it.
#[derive(Clone)]
pub(crate) struct RedisConnection(Arc<RedisConnectionState>);

struct RedisConnectionState {
    peer: Arc<Peer>,
    slot: Mutex<Slot>,
}

/// What is known of the server from one kind of requests.
pub(crate) struct Peer {
    /// Which kind, for the log.
    name: &'static str,
    /// An answer that does not come in time is the server's fault, not that request's alone.
    is_prompt: bool,
    client: Client,
    not_before: SyncMutex<Option<Instant>>,
    failures: AtomicU64,
    is_away: AtomicBool,
    was_heard: AtomicBool,
}

#[derive(Default)]
struct Slot {
    connection: Option<MultiplexedConnection>,
    /// Counts connections: a failure is of one of them.
    made: u64,
}

impl Peer {
    pub(crate) fn new(name: &'static str, address: &Address, is_prompt: bool) -> Result<Arc<Self>, RedisError> {
        Ok(Arc::new(Self {
            name,
            is_prompt,
            client: Client::open(address.info().clone())?,
            not_before: SyncMutex::default(),
            failures: AtomicU64::new(0),
            is_away: AtomicBool::new(false),
            was_heard: AtomicBool::new(false),
        }))
    }

    /// Requests that were not answered, or answered that there is no room.
    pub(crate) fn failures(&self) -> u64 {
        self.failures.load(Ordering::Relaxed)
    }

    /// It did not answer what was asked last.
    pub(crate) fn is_away(&self) -> bool {
        self.is_away.load(Ordering::Relaxed)
    }

    /// It has answered at some time.
    pub(crate) fn was_heard(&self) -> bool {
        self.was_heard.load(Ordering::Relaxed)
    }

    /// The server was heard by others: it is not left alone any longer.
    pub(crate) fn relent(&self) {
        *self.not_before() = None;
    }

    fn not_before(&self) -> MutexGuard<'_, Option<Instant>> {
        self.not_before.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_left_alone(&self) -> bool {
        self.not_before().is_some_and(|not_before| Instant::now() < not_before)
    }

    fn leave_alone(&self) {
        *self.not_before() = Some(Instant::now() + PAUSE);
    }

    /// Told once, until it is back.
    fn away(&self, why: &str) {
        self.failures.fetch_add(1, Ordering::Relaxed);
        if !self.is_away.swap(true, Ordering::Relaxed) {
            tracing::error!("the session store is away ({}): {why}", self.name);
        }
    }

    fn is_here(&self) {
        self.was_heard.store(true, Ordering::Relaxed);
        if self.is_away() && self.is_away.swap(false, Ordering::Relaxed) {
            tracing::info!("the session store is back ({})", self.name);
        }
    }
}

impl RedisConnection {
    pub(crate) fn new(peer: &Arc<Peer>) -> Self {
        Self(Arc::new(RedisConnectionState { peer: Arc::clone(peer), slot: Mutex::default() }))
    }

    /// Ends the connection. Only while nothing is asked.
    pub(crate) fn close(&self) {
        if let Ok(mut slot) = self.0.slot.try_lock() {
            slot.connection = None;
        }
    }

    /// What the server says to `ask` within `patience`. A connection that turns out to be broken, as after a pause in which the server was started
    /// anew, is made anew and asked once more: whatever is asked comes to the same when it is done twice.
    pub(crate) async fn ask<T, F>(&self, patience: Duration, ask: impl Fn(MultiplexedConnection) -> F) -> Result<T, StoreError>
    where
        F: Future<Output = RedisResult<T>>,
    {
        // Which connection was asked last: by the time that nobody waits any more there may be a newer one.
        let used = AtomicU64::new(0);
        let asked = timeout(patience, async {
            let (made, connection) = self.connection().await?;
            used.store(made, Ordering::Relaxed);
            match ask(connection).await {
                Err(error) if is_broken(&error) => {
                    self.lose(made).await;
                    let (made, connection) = self.connection().await?;
                    used.store(made, Ordering::Relaxed);
                    Ok((made, ask(connection).await))
                }
                answered => Ok((made, answered)),
            }
        });
        match asked.await {
            Ok(Ok((_, Ok(answer)))) => {
                self.0.peer.is_here();
                Ok(answer)
            }
            Ok(Ok((made, Err(error)))) => Err(self.fail(made, &error).await),
            Ok(Err(away)) => Err(away),
            Err(_) => {
                self.0.peer.away(&format!("no answer within {patience:?}"));
                if self.lose(used.into_inner()).await && self.0.peer.is_prompt {
                    self.0.peer.leave_alone();
                }
                Err(StoreError::Away)
            }
        }
    }

    /// The connection that is there, or another one. Connecting goes on when the one who asked for it leaves.
    async fn connection(&self) -> Result<(u64, MultiplexedConnection), StoreError> {
        let slot = self.0.slot.lock().await;
        if let Some(connection) = &slot.connection {
            return Ok((slot.made, connection.clone()));
        }
        if self.0.peer.is_left_alone() {
            self.0.peer.failures.fetch_add(1, Ordering::Relaxed);
            return Err(StoreError::Away);
        }
        drop(slot);
        let line = self.clone();
        tokio::spawn(Scope::current().wrap(async move { line.connect().await })).await.unwrap_or(Err(StoreError::Away))
    }

    async fn connect(&self) -> Result<(u64, MultiplexedConnection), StoreError> {
        // Those who come meanwhile wait here.
        let mut slot = self.0.slot.lock().await;
        if let Some(connection) = &slot.connection {
            return Ok((slot.made, connection.clone()));
        }
        if self.0.peer.is_left_alone() {
            return Err(StoreError::Away);
        }
        // Waits for answers are bounded by who asks.
        let config = AsyncConnectionConfig::new().set_connection_timeout(None).set_response_timeout(None).set_pipeline_buffer_size(WAITING);
        let why = match timeout(CONNECT, self.0.peer.client.get_multiplexed_async_connection_with_config(&config)).await {
            Ok(Ok(connection)) => {
                slot.made += 1;
                slot.connection = Some(connection.clone());
                return Ok((slot.made, connection));
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("no connection within {CONNECT:?}"),
        };
        self.0.peer.leave_alone();
        drop(slot);
        self.0.peer.away(&why);
        Err(StoreError::Away)
    }

    /// That connection is not used again. `false`: it had been lost before.
    async fn lose(&self, made: u64) -> bool {
        let mut slot = self.0.slot.lock().await;
        slot.made == made && slot.connection.take().is_some()
    }

    /// What an error means. A server that is full goes on answering; any other one may have become another server's replica, or be starting.
    async fn fail(&self, made: u64, error: &RedisError) -> StoreError {
        let text = error.to_string();
        let failures = &self.0.peer.failures;
        if text.contains("OOM") {
            failures.fetch_add(1, Ordering::Relaxed);
            tracing::warn!("the session store has no room: {text}");
            return StoreError::NoRoom;
        }
        // What somebody else has put under one key is no outage of all of them.
        if text.contains("WRONGTYPE") || error.kind() == ErrorKind::UnexpectedReturnType {
            failures.fetch_add(1, Ordering::Relaxed);
            tracing::error!("the session store holds something else under a session's key: {text}");
            return StoreError::Away;
        }
        self.0.peer.away(&text);
        if self.lose(made).await && !is_broken(error) {
            self.0.peer.leave_alone();
        }
        StoreError::Away
    }
}

/// The connection was closed, perhaps in the middle of an answer.
fn is_broken(error: &RedisError) -> bool {
    error.is_connection_dropped() || error.kind() == ErrorKind::Parse
}
