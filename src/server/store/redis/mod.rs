//! The store on a Redis or Valkey server that several processes share.
//!
//! Every operation is one script (`script.rs` describes the keys), and every change is visible to
//! all processes at once. Sessions expire by the server's own expiry; its `maxmemory` bounds their
//! size. Each session has a copy of its image's file and of those of its layers, transferred on
//! separate connections (`files.rs`).
//!
//! While the server does not answer, sessions that this process has used (`session_cache.rs`) go on
//! for one idle period, with numbers that rise in this process alone; the server learns the highest
//! one from the next request of the session that reaches it. Everything else is refused.

mod address;
mod connection;
mod files;
mod script;
mod session_cache;
#[cfg(test)]
mod tests;

use std::fmt;
use std::future::Future;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use mlswarp::warp::Digest;
use redis::{Cmd, FromRedisValue, Pipeline};

use super::record;
use super::record::Unreadable;
use super::{
    NamedFile, NotOpened, Put, Record, Session, Store, StoreError, StoreFuture, StoreLimits,
    StoreStats,
};
use crate::client::Owner;
use crate::observe::Scope;
use crate::session::{Revision, SessionId};
pub use address::RedisAddress;
use connection::{Endpoint, RedisConnection};
use files::FileConnections;
use script::{Call, Replaces, number, status};
use session_cache::{CachedSession, SessionCache};

/// Longest wait for an answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest wait for an answer about a cached session.
const CACHED_TIMEOUT: Duration = Duration::from_millis(200);
/// Longest wait for a file.
const FILE_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest wait for an answer to `ready`, and how long that answer is reused.
const READY_TIMEOUT: Duration = Duration::from_secs(1);
/// How long the server is not asked about cached sessions after one answer was late.
const BACK_OFF: Duration = Duration::from_secs(1);
/// Attempts to put a session that other processes replace at the same time.
const PUT_ATTEMPTS: usize = 8;
/// Bytes of a stored record that are read at once: a few microseconds.
const MAX_READ_INLINE_BYTES: usize = 4 << 10;
/// The memory for a fetched file, in files: itself, and a receive buffer that grows by doubling.
const FILE_COPIES: u64 = 3;

/// A store on a shared server. Cloning shares the connections.
#[derive(Clone)]
pub struct RedisStore(Arc<RedisStoreState>);

struct RedisStoreState {
    idle: Duration,
    endpoint: Arc<Endpoint>,
    connection: RedisConnection,
    files_endpoint: Arc<Endpoint>,
    files: FileConnections,
    sessions: SessionCache,
    backed_off_until: Mutex<Option<Instant>>,
    /// The last answer to `ready`.
    readiness: Mutex<Option<(Instant, bool)>>,
    damaged: AtomicU64,
    other_version: AtomicU64,
}

/// How a session is looked up.
#[derive(Clone, Copy)]
enum Lookup {
    Peek,
    Touch(Option<u64>),
}

impl fmt::Debug for RedisStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RedisStore").finish_non_exhaustive()
    }
}

impl RedisStore {
    /// A store on the server of that address, which may be down at this moment.
    /// Errors: The client library rejects the address.
    pub fn new(address: &RedisAddress, bounds: StoreLimits) -> Result<Self, NotOpened> {
        let not_opened = |e: redis::RedisError| NotOpened {
            what: address.to_string(),
            why: e.to_string(),
        };
        let endpoint = Endpoint::new("records", address, true).map_err(not_opened)?;
        let files_endpoint = Endpoint::new("files", address, false).map_err(not_opened)?;
        Ok(Self(Arc::new(RedisStoreState {
            idle: bounds.idle,
            connection: RedisConnection::new(&endpoint),
            endpoint,
            files: FileConnections::new(&files_endpoint),
            files_endpoint,
            sessions: SessionCache::new(bounds.idle, bounds.bytes),
            backed_off_until: Mutex::default(),
            readiness: Mutex::default(),
            damaged: AtomicU64::new(0),
            other_version: AtomicU64::new(0),
        })))
    }
}

/// Does what grows with a session on a blocking thread: records are read, written and digested
/// there, not on the thread of the runtime.
async fn aside<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, StoreError> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|_| StoreError::Away)
}

impl RedisStoreState {
    async fn call<T: FromRedisValue>(&self, call: Call) -> Result<T, StoreError> {
        let call = &call;
        self.connection
            .ask(ANSWER_TIMEOUT, |mut connection| async move {
                call.invoke_async(&mut connection).await
            })
            .await
    }

    async fn run<T: FromRedisValue>(
        &self,
        limit: Duration,
        command: &Cmd,
    ) -> Result<T, StoreError> {
        self.connection
            .ask(limit, |mut connection| async move {
                command.query_async(&mut connection).await
            })
            .await
    }

    fn session(&self, record: Arc<Record>, seq: Option<u64>, left: Duration) -> Session {
        Session {
            record,
            seq,
            expires: SystemTime::now() + left.min(self.idle),
        }
    }

    /// Forgets a session that the server does not have.
    fn absent(&self, id: SessionId, status: i64) -> StoreError {
        self.sessions.forget(id);
        if status == status::EXPIRED {
            StoreError::Expired { idle: self.idle }
        } else {
            StoreError::NoSuchSession
        }
    }

    /// Reads a stored record. `None`: it is damaged, which counts as no session.
    /// Errors: Another version of the program has written it.
    async fn readable(
        &self,
        id: SessionId,
        bytes: Vec<u8>,
    ) -> Result<Option<Arc<Record>>, StoreError> {
        let read = if bytes.len() <= MAX_READ_INLINE_BYTES {
            record::read(&bytes)
        } else {
            aside(move || record::read(&bytes)).await?
        };
        let why = match read {
            Ok(record) if record.id == id => return Ok(Some(record)),
            Ok(_) => Unreadable::Damaged("it is another session's"),
            Err(why) => why,
        };
        self.sessions.forget(id);
        match why {
            Unreadable::Damaged(why) => {
                self.damaged.fetch_add(1, Ordering::Relaxed);
                tracing::error!(session = ?id, why, "a damaged session record is left out");
                Ok(None)
            }
            Unreadable::OtherVersion(why) => {
                // Each refused request is logged anyway.
                if self.other_version.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(session = ?id, why, "a session is kept and not served: another \
                        version of the program has stored it");
                }
                Err(StoreError::OtherVersion)
            }
        }
    }

    async fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> Result<Put, StoreError> {
        // Another process may store the same session between the question and the transaction: then
        // its revision is another one, and everything begins again.
        let idle = self.idle;
        for _ in 0..PUT_ATTEMPTS {
            // A file that is there is not sent, and an unreadable record is not replaced.
            let asked = Arc::clone(&record);
            let same = aside(move || script::same(&asked, idle)).await?;
            let (status, bytes, seq, revision): (i64, Vec<u8>, String, String) =
                self.call(same).await?;
            let old = if status == status::ABSENT {
                None
            } else {
                self.readable(record.id, bytes).await?
            };
            if status == status::FOUND
                && let Some(old) = old
            {
                return self.same(old, &seq);
            }
            // The server has just answered, so a pause of the connections for files is over.
            self.files_endpoint.health().paused_until = None;
            let replaces = Replaces {
                revision,
                is_readable: old.is_some(),
            };
            let (stored, sent) = (Arc::clone(&record), files.clone());
            let put = aside(move || script::put(&stored, &sent, &replaces, idle)).await?;
            let (status, seq) = self.send(&files, &put).await?;
            match (status, old) {
                // Not the revision that was looked at: look again.
                (status::OTHER, _) => {}
                // Only the file was missing.
                (status::FOUND, Some(old)) => return self.same(old, &seq),
                (_, old) => {
                    self.sessions.learn(Arc::clone(&record), None);
                    let session = self.session(record, None, self.idle);
                    return Ok(match old {
                        Some(old) => Put::Replaced(session, old),
                        None => Put::Created(session),
                    });
                }
            }
        }
        Err(StoreError::Contended)
    }

    /// Runs a transaction that stores files; returns its script's reply.
    async fn send(
        &self,
        files: &[NamedFile],
        transaction: &Pipeline,
    ) -> Result<(i64, String), StoreError> {
        let len: usize = files.iter().map(|file| file.bytes.len()).sum();
        // The time to send a file: 4 MB a second.
        let limit = ANSWER_TIMEOUT + Duration::from_micros(len as u64 / 4);
        let ask = |mut connection| async move { transaction.query_async(&mut connection).await };
        let (reply,): ((i64, String),) = self.files.ask(limit, |_| len, ask).await?;
        Ok(reply)
    }

    fn same(&self, record: Arc<Record>, seq: &str) -> Result<Put, StoreError> {
        let seq = number(seq)?;
        self.sessions.learn(Arc::clone(&record), seq);
        Ok(Put::Same(self.session(record, seq, self.idle)))
    }

    async fn revise(
        &self,
        old: Revision,
        new: Arc<Record>,
        layer: Option<NamedFile>,
    ) -> Result<Option<Session>, StoreError> {
        let (idle, stored) = (self.idle, Arc::clone(&new));
        let (status, seq): (i64, String) = match layer {
            Some(file) => {
                let sent = file.clone();
                let with = aside(move || script::revise_with(&sent, old, &stored, idle)).await?;
                self.send(&[file], &with).await?
            }
            None => {
                let alone = aside(move || script::revise(old, &stored, idle)).await?;
                self.call(alone).await?
            }
        };
        match status {
            status::FOUND => {
                let seq = number(&seq)?;
                self.sessions.learn(Arc::clone(&new), seq);
                Ok(Some(self.session(new, seq, self.idle)))
            }
            status::OTHER => {
                // The next attempt must see what is there now.
                self.sessions.forget(new.id);
                Ok(None)
            }
            status => Err(self.absent(new.id, status)),
        }
    }

    async fn look_up(
        self: &Arc<Self>,
        id: SessionId,
        lookup: Lookup,
    ) -> Result<Session, StoreError> {
        let Some(cached) = self.sessions.get(id) else {
            return Arc::clone(self).ask(id, lookup, None).await;
        };
        match self
            .ask_briefly(Arc::clone(self).ask(id, lookup, Some(Arc::clone(&cached))))
            .await
        {
            Err(StoreError::Away | StoreError::NoRoom) => {
                // The session goes on with what this process knows of it. Its numbers rise here
                // alone, and the script of the next touch takes the highest one along.
                let mut progress = cached.progress();
                if let Lookup::Touch(seq) = lookup {
                    progress.seq = progress.seq.max(seq);
                }
                Ok(self.session(
                    Arc::clone(&cached.record),
                    progress.seq,
                    self.idle.saturating_sub(progress.confirmed.elapsed()),
                ))
            }
            answer => answer,
        }
    }

    async fn ask(
        self: Arc<Self>,
        id: SessionId,
        lookup: Lookup,
        cached: Option<Arc<CachedSession>>,
    ) -> Result<Session, StoreError> {
        let known = cached
            .as_deref()
            .map(|cached| (cached.record.as_ref(), cached.progress().seq));
        let call = match lookup {
            Lookup::Peek => script::peek(id, known.map(|(record, _)| record), self.idle),
            Lookup::Touch(seq) => script::touch(id, seq, known, self.idle),
        };
        let (status, bytes, seq, left): (i64, Vec<u8>, String, i64) = self.call(call).await?;
        if status != status::FOUND {
            return Err(self.absent(id, status));
        }
        let (seq, left) = (
            number(&seq)?,
            Duration::from_millis(u64::try_from(left).unwrap_or(0)),
        );
        if let Some(cached) = cached.as_ref().filter(|_| bytes.is_empty()) {
            let mut progress = cached.progress();
            // This process may know of higher numbers, given while the server did not answer.
            progress.seq = progress.seq.max(seq);
            if matches!(lookup, Lookup::Touch(_)) {
                progress.confirmed = Instant::now();
            }
            return Ok(self.session(Arc::clone(&cached.record), progress.seq, left));
        }
        let record = self.readable(id, bytes).await?;
        let record = record.ok_or(StoreError::NoSuchSession)?;
        // A number of this process counts only within the same life of the session: one that was
        // made again starts from 0.
        let here = cached
            .filter(|cached| cached.record.created == record.created)
            .and_then(|cached| cached.progress().seq);
        let seq = seq.max(here);
        match lookup {
            Lookup::Touch(_) => self.sessions.learn(Arc::clone(&record), seq),
            // What is cached is outdated, and a peek does not prolong the session.
            Lookup::Peek => self.sessions.forget(id),
        }
        Ok(self.session(record, seq, left))
    }

    /// Waits briefly for an answer that the cache can replace. A late answer still updates the
    /// cache: otherwise a server that is slow, and not away, would never be believed.
    async fn ask_briefly<T: Send + 'static>(
        &self,
        answer: impl Future<Output = Result<T, StoreError>> + Send + 'static,
    ) -> Result<T, StoreError> {
        let backed_off_until = || {
            self.backed_off_until
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        if backed_off_until().is_some_and(|until| Instant::now() < until) {
            return Err(StoreError::Away);
        }
        let mut answer = Box::pin(answer);
        if let Ok(answer) = tokio::time::timeout(CACHED_TIMEOUT, &mut answer).await {
            return answer;
        }
        *backed_off_until() = Some(Instant::now() + BACK_OFF);
        tokio::spawn(Scope::current().answered().wrap(answer));
        Err(StoreError::Away)
    }

    async fn delete(&self, id: SessionId) -> Result<(), StoreError> {
        let status = self.call(script::delete(id, self.idle)).await?;
        let absent = self.absent(id, status);
        if status == status::FOUND {
            Ok(())
        } else {
            Err(absent)
        }
    }

    async fn file_bytes(&self, id: SessionId, digest: Digest) -> Result<u64, StoreError> {
        let both = &script::file_bytes(id, digest);
        let ask = |mut connection| async move { both.query_async(&mut connection).await };
        let (layer, picture): (u64, u64) = self.connection.ask(ANSWER_TIMEOUT, ask).await?;
        Ok(FILE_COPIES * if layer > 0 { layer } else { picture })
    }

    async fn file(&self, id: SessionId, digest: Digest) -> Result<Bytes, StoreError> {
        let (layer, picture) = (&script::layer_file(id, digest), &script::picture_file(id));
        let ask = |mut connection| async move {
            match layer.query_async(&mut connection).await? {
                None => picture.query_async(&mut connection).await,
                found => Ok(found),
            }
        };
        let len = |file: &Option<Vec<u8>>| file.as_ref().map_or(0, Vec::len);
        let file = Bytes::from(
            self.files
                .ask(FILE_TIMEOUT, len, ask)
                .await?
                .ok_or(StoreError::NoSuchSession)?,
        );
        let hashed = file.clone();
        let found = aside(move || Digest::of(&hashed)).await?;
        // A replaced session has another image's file, and so has one without that layer.
        if found == digest {
            Ok(file)
        } else {
            Err(StoreError::NoSuchSession)
        }
    }

    async fn ready(&self) -> Result<(), StoreError> {
        let readiness = || {
            self.readiness
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        let known = readiness().filter(|(at, _)| at.elapsed() < READY_TIMEOUT);
        let is_ready = match known {
            Some((_, is_ready)) => is_ready,
            None => {
                let is_ready = self
                    .run::<String>(READY_TIMEOUT, &redis::cmd("PING"))
                    .await
                    .is_ok();
                *readiness() = Some((Instant::now(), is_ready));
                is_ready
            }
        };
        if is_ready {
            Ok(())
        } else {
            Err(StoreError::Away)
        }
    }
}

impl Store for RedisStore {
    fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> StoreFuture<'_, Put> {
        Box::pin(self.0.put(record, files))
    }

    fn revise(
        &self,
        old: Revision,
        new: Arc<Record>,
        layer: Option<NamedFile>,
    ) -> StoreFuture<'_, Option<Session>> {
        Box::pin(self.0.revise(old, new, layer))
    }

    fn peek(&self, id: SessionId) -> StoreFuture<'_, Session> {
        Box::pin(self.0.look_up(id, Lookup::Peek))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> StoreFuture<'_, Session> {
        Box::pin(self.0.look_up(id, Lookup::Touch(seq)))
    }

    fn delete(&self, id: SessionId) -> StoreFuture<'_, ()> {
        Box::pin(self.0.delete(id))
    }

    fn was_deleted(&self, id: SessionId) -> StoreFuture<'_, bool> {
        let call = self.0.call::<bool>(script::was_deleted(id, self.0.idle));
        Box::pin(call)
    }

    fn file_bytes(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, u64> {
        Box::pin(self.0.file_bytes(id, digest))
    }

    fn file(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, Bytes> {
        Box::pin(self.0.file(id, digest))
    }

    fn local_record(&self, id: SessionId) -> Option<Arc<Record>> {
        let cached = self.0.sessions.get(id)?;
        Some(Arc::clone(&cached.record))
    }

    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.0.sessions.names(owner, digest)
    }

    /// Sweeps the cache; the server expires its keys itself.
    fn sweep(&self) -> StoreFuture<'_, usize> {
        Box::pin(async { Ok(super::in_pieces(|| self.0.sessions.sweep()).await) })
    }

    fn ready(&self) -> StoreFuture<'_, ()> {
        Box::pin(self.0.ready())
    }

    fn figures(&self) -> StoreStats {
        let (sessions, bytes) = self.0.sessions.size();
        let health = self.0.endpoint.health();
        StoreStats {
            sessions,
            bytes,
            damaged: self.0.damaged.load(Ordering::Relaxed),
            other_version: self.0.other_version.load(Ordering::Relaxed),
            failures: health.failures + self.0.files_endpoint.health().failures,
            is_away: health.is_away,
            is_unknown: !health.has_answered,
        }
    }
}
