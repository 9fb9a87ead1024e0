//! A connection to the server, with a time limit on every wait. A broken connection is replaced by
//! the next request. A server that does not answer is not asked for a second; requests in that
//! second fail at once. A file that is late says nothing about the server and closes only its own
//! connection.

use std::future::Future;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex as SyncMutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use redis::aio::MultiplexedConnection;
use redis::{AsyncConnectionConfig, Client, ErrorKind, RedisError, RedisResult};
use tokio::sync::Mutex;
use tokio::time::timeout;

use super::address::RedisAddress;
use crate::observe::Scope;
use crate::store::StoreError;

/// Longest wait for a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(1);
/// How long a server that does not answer is not asked.
const UNAVAILABLE_PAUSE: Duration = Duration::from_secs(1);
/// Requests that wait to be written.
const WRITE_QUEUE: usize = 1024;

/// The server, as seen by one kind of requests.
pub(crate) struct Endpoint {
    /// The kind of requests, for the log.
    name: &'static str,
    /// A late answer is a failure of the server, not of one request.
    is_prompt: bool,
    client: Client,
    health: SyncMutex<Health>,
}

#[derive(Default)]
pub(crate) struct Health {
    /// Requests that failed, or were answered that there is no room.
    pub(crate) failures: u64,
    /// The last request was not answered.
    pub(crate) is_away: bool,
    pub(crate) has_answered: bool,
    /// Until then requests that need a new connection fail at once.
    pub(crate) paused_until: Option<Instant>,
}

impl Endpoint {
    pub(crate) fn new(
        name: &'static str,
        address: &RedisAddress,
        is_prompt: bool,
    ) -> Result<Arc<Self>, RedisError> {
        Ok(Arc::new(Self {
            name,
            is_prompt,
            client: Client::open(address.info().clone())?,
            health: SyncMutex::default(),
        }))
    }

    pub(crate) fn health(&self) -> MutexGuard<'_, Health> {
        self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn pause(&self) {
        self.health().paused_until = Some(Instant::now() + UNAVAILABLE_PAUSE);
    }

    /// Logs an outage once, when it begins.
    fn report_away(&self, why: &str) {
        let mut health = self.health();
        health.failures += 1;
        if !std::mem::replace(&mut health.is_away, true) {
            tracing::error!("the session store is away ({}): {why}", self.name);
        }
    }

    fn report_answer(&self) {
        let mut health = self.health();
        health.has_answered = true;
        if std::mem::replace(&mut health.is_away, false) {
            tracing::info!("the session store is back ({})", self.name);
        }
    }
}

/// A connection that is made when it is needed. Cloning shares it.
#[derive(Clone)]
pub(crate) struct RedisConnection(Arc<RedisConnectionState>);

struct RedisConnectionState {
    endpoint: Arc<Endpoint>,
    slot: Mutex<Slot>,
}

#[derive(Default)]
struct Slot {
    connection: Option<MultiplexedConnection>,
    /// Counts connections, so that a failure closes the one that failed and no later one.
    generation: u64,
}

impl Slot {
    fn get(&self) -> Option<(u64, MultiplexedConnection)> {
        Some((self.generation, self.connection.clone()?))
    }
}

impl RedisConnection {
    pub(crate) fn new(endpoint: &Arc<Endpoint>) -> Self {
        Self(Arc::new(RedisConnectionState {
            endpoint: Arc::clone(endpoint),
            slot: Mutex::default(),
        }))
    }

    /// Closes the connection. Only while no request uses it.
    pub(crate) fn close(&self) {
        if let Ok(mut slot) = self.0.slot.try_lock() {
            slot.connection = None;
        }
    }

    /// Sends a request by `ask` and waits at most `limit` for its answer. Over a connection that
    /// turns out to be broken it is sent once more: all requests are idempotent.
    pub(crate) async fn ask<T, F>(
        &self,
        limit: Duration,
        ask: impl Fn(MultiplexedConnection) -> F,
    ) -> Result<T, StoreError>
    where
        F: Future<Output = RedisResult<T>>,
    {
        let used = AtomicU64::new(0);
        let answer = timeout(limit, async {
            match self.try_once(&used, &ask).await? {
                Err(error) if is_broken(&error) => {
                    self.discard(used.load(Ordering::Relaxed)).await;
                    self.try_once(&used, &ask).await
                }
                answer => Ok(answer),
            }
        });
        let endpoint = &self.0.endpoint;
        match answer.await {
            Ok(Ok(Ok(answer))) => {
                endpoint.report_answer();
                Ok(answer)
            }
            Ok(Ok(Err(error))) => Err(self.fail(used.into_inner(), &error).await),
            Ok(Err(away)) => Err(away),
            Err(_) => {
                endpoint.report_away(&format!("no answer within {limit:?}"));
                if self.discard(used.into_inner()).await && endpoint.is_prompt {
                    endpoint.pause();
                }
                Err(StoreError::Away)
            }
        }
    }

    /// `used` is set to the generation of the connection.
    async fn try_once<T, F>(
        &self,
        used: &AtomicU64,
        ask: &impl Fn(MultiplexedConnection) -> F,
    ) -> Result<RedisResult<T>, StoreError>
    where
        F: Future<Output = RedisResult<T>>,
    {
        let open = self.0.slot.lock().await.get();
        let (generation, connection) = match open {
            Some(open) => open,
            None => {
                // In a task of its own, which goes on when this request is dropped: others wait for
                // the same connection.
                let this = self.clone();
                tokio::spawn(Scope::current().wrap(async move { this.connect().await }))
                    .await
                    .unwrap_or(Err(StoreError::Away))?
            }
        };
        used.store(generation, Ordering::Relaxed);
        Ok(ask(connection).await)
    }

    async fn connect(&self) -> Result<(u64, MultiplexedConnection), StoreError> {
        let endpoint = &self.0.endpoint;
        // Requests that arrive while it connects wait for the lock.
        let mut slot = self.0.slot.lock().await;
        if let Some(open) = slot.get() {
            return Ok(open);
        }
        if endpoint
            .health()
            .paused_until
            .is_some_and(|until| Instant::now() < until)
        {
            endpoint.health().failures += 1;
            return Err(StoreError::Away);
        }
        // Each request has a time limit of its own.
        let config = AsyncConnectionConfig::new()
            .set_connection_timeout(None)
            .set_response_timeout(None)
            .set_pipeline_buffer_size(WRITE_QUEUE);
        let why = match timeout(
            CONNECT_TIMEOUT,
            endpoint
                .client
                .get_multiplexed_async_connection_with_config(&config),
        )
        .await
        {
            Ok(Ok(connection)) => {
                slot.generation += 1;
                slot.connection = Some(connection.clone());
                return Ok((slot.generation, connection));
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("no connection within {CONNECT_TIMEOUT:?}"),
        };
        endpoint.pause();
        drop(slot);
        endpoint.report_away(&why);
        Err(StoreError::Away)
    }

    /// Drops the connection of that generation. `false`: it was dropped before.
    async fn discard(&self, generation: u64) -> bool {
        let mut slot = self.0.slot.lock().await;
        slot.generation == generation && slot.connection.take().is_some()
    }

    /// Classifies an error. Only a full server, and a foreign value under a session's key, leave
    /// the connection open: after any other error the server may have become a replica, or be
    /// starting.
    async fn fail(&self, generation: u64, error: &RedisError) -> StoreError {
        let (text, endpoint) = (error.to_string(), &self.0.endpoint);
        if text.contains("OOM") {
            endpoint.health().failures += 1;
            tracing::warn!("the session store has no room: {text}");
            return StoreError::NoRoom;
        }
        if text.contains("WRONGTYPE") || error.kind() == ErrorKind::UnexpectedReturnType {
            endpoint.health().failures += 1;
            tracing::error!("the session store holds something else under a session's key: {text}");
            return StoreError::Away;
        }
        endpoint.report_away(&text);
        if self.discard(generation).await && !is_broken(error) {
            endpoint.pause();
        }
        StoreError::Away
    }
}

/// The connection was closed, perhaps in the middle of an answer.
fn is_broken(error: &RedisError) -> bool {
    error.is_connection_dropped() || error.kind() == ErrorKind::Parse
}
