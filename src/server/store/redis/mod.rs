//! Sessions on a Redis or Valkey that several processes share: what one answers, the others see at once. Every operation is one script on the
//! server (`script.rs` has the keys), and a step of a drag one way there and back; life spans are the server's own expiry, and how much there may be is
//! its `maxmemory`. A picture's file is kept once a session, and transferred on a connection of its own (`files.rs`).
//!
//! What is known of sessions that were used here is remembered (`warm.rs`). While the server does not answer, those sessions go on for one idle
//! period, with numbers that rise in this process alone; the server learns the highest one from the next pose. Everything else is refused.

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
use redis::{Cmd, FromRedisValue};

use super::record;
use super::record::Unreadable;
use super::{Address, Answer, Bounds, Figures, NotOpened, Put, Record, Session, Store, StoreError};
use crate::client::Owner;
use crate::observe::Scope;
use crate::session::{Revision, SessionId};
use connection::{Peer, RedisConnection};
use files::Files;
use script::{Replaces, number, status};
use session_cache::{Known, SessionCache, Warm};

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longest wait for an answer that can be done without.
const IMPATIENCE: Duration = Duration::from_millis(200);
/// Longest wait for a file.
const PATIENCE_FOR_FILES: Duration = Duration::from_secs(10);
/// Attempts to put a session that others replace at the same time.
const PUTS: usize = 8;
/// A file is held by the buffer that it comes in, which grows by doubling, and by itself.
const COPIES: u64 = 3;
/// Longest wait of those who ask whether the server is there, and how long its answer is believed.
const READINESS: Duration = Duration::from_secs(1);

/// A store on a server that others share. Cloning shares the connections.
#[derive(Clone)]
pub struct RedisStore(Arc<RedisStoreState>);

struct RedisStoreState {
    idle: Duration,
    peer: Arc<Peer>,
    line: RedisConnection,
    files_peer: Arc<Peer>,
    files: Files,
    memory: SessionCache,
    /// A server that made a drag wait is not asked by drags before.
    spared: Mutex<Option<Instant>>,
    seen: Mutex<Option<(Instant, bool)>>,
    damaged: AtomicU64,
    other_version: AtomicU64,
}

impl fmt::Debug for RedisStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RedisStore").finish_non_exhaustive()
    }
}

impl RedisStore {
    /// A store on the server of that address, which need not be there yet.
    ///
    /// # Errors
    /// The client library does not take the address.
    pub fn new(address: &Address, bounds: Bounds) -> Result<Self, NotOpened> {
        let not_opened = |e: redis::RedisError| NotOpened { what: address.to_string(), why: e.to_string() };
        let peer = Peer::new("records", address, true).map_err(not_opened)?;
        let files_peer = Peer::new("files", address, false).map_err(not_opened)?;
        Ok(Self(Arc::new(RedisStoreState {
            idle: bounds.idle,
            line: RedisConnection::new(&peer),
            peer,
            files: Files::new(&files_peer),
            files_peer,
            memory: SessionCache::new(bounds.idle, bounds.bytes),
            spared: Mutex::default(),
            seen: Mutex::default(),
            damaged: AtomicU64::new(0),
            other_version: AtomicU64::new(0),
        })))
    }
}

impl RedisStoreState {
    async fn run<T: FromRedisValue>(&self, patience: Duration, command: &Cmd) -> Result<T, StoreError> {
        self.line.ask(patience, |mut connection| async move { command.query_async(&mut connection).await }).await
    }

    fn session(&self, record: Arc<Record>, seq: Option<u64>, left: Duration) -> Session {
        Session { record, seq, expires: SystemTime::now() + left.min(self.idle) }
    }

    /// There is no such session, says the server.
    fn gone(&self, id: SessionId, status: i64) -> StoreError {
        self.memory.forget(id);
        if status == status::EXPIRED { StoreError::Expired } else { StoreError::NoSuchSession }
    }

    /// The record, if it is whole and of that session. A damaged one is no session.
    ///
    /// # Errors
    /// Another version of the program has written it.
    fn whole(&self, id: SessionId, bytes: &[u8]) -> Result<Option<Arc<Record>>, StoreError> {
        let why = match record::read(bytes) {
            Ok(record) if record.id == id => return Ok(Some(record)),
            Ok(_) => Unreadable::Damaged("it is another session's"),
            Err(why) => why,
        };
        // What is remembered of it is not so any more.
        self.memory.forget(id);
        match why {
            Unreadable::Damaged(why) => {
                self.damaged.fetch_add(1, Ordering::Relaxed);
                tracing::error!(session = ?id, why, "a session is left out: what is stored of it is damaged");
                Ok(None)
            }
            Unreadable::OtherVersion(why) => {
                // The requests that are refused for it are logged one by one.
                if self.other_version.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(session = ?id, why, "a session is kept and not served: another version of the program has stored it");
                }
                Err(StoreError::OtherVersion)
            }
        }
    }

    async fn put(&self, record: Arc<Record>, image: Bytes) -> Result<Put, StoreError> {
        for _ in 0..PUTS {
            // A file that is there need not be sent, and what cannot be read is not replaced.
            let (status, bytes, seq, revision): (i64, Vec<u8>, String, String) =
                self.run(PATIENCE, &script::same(&record, self.idle)).await?;
            let old = if status == status::NOTHING { None } else { self.whole(record.id, &bytes)? };
            if status == status::HERE
                && let Some(old) = old
            {
                return self.same(old, &seq);
            }
            self.files_peer.relent();
            // 4 MB a second.
            let patience = PATIENCE + Duration::from_micros(image.len() as u64 / 4);
            let replaces = Replaces { revision, is_whole: old.is_some() };
            let transaction = script::put(&record, &image, &replaces, self.idle);
            let ask = |mut connection| {
                let transaction = &transaction;
                async move { transaction.query_async(&mut connection).await }
            };
            let ((status, seq),): ((i64, String),) = self.files.ask(patience, |_| image.len(), ask).await?;
            match (status, old) {
                (status::OTHER, _) => {}
                // The file alone was missing.
                (status::HERE, Some(old)) => return self.same(old, &seq),
                (_, old) => {
                    self.memory.learn(Arc::clone(&record), None);
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

    fn same(&self, record: Arc<Record>, seq: &str) -> Result<Put, StoreError> {
        let seq = number(seq)?;
        self.memory.learn(Arc::clone(&record), seq);
        Ok(Put::Same(self.session(record, seq, self.idle)))
    }

    async fn revise(&self, old: Revision, new: Arc<Record>) -> Result<Option<Session>, StoreError> {
        let command = script::revise(&record::hex(old.as_bytes()), &new, self.idle);
        let (status, seq): (i64, String) = self.run(PATIENCE, &command).await?;
        match status {
            status::HERE => {
                let seq = number(&seq)?;
                self.memory.learn(Arc::clone(&new), seq);
                Ok(Some(self.session(new, seq, self.idle)))
            }
            status::OTHER => {
                // Who asks again must see what is there now.
                self.memory.forget(new.id);
                Ok(None)
            }
            status => Err(self.gone(new.id, status)),
        }
    }

    async fn touch(self: &Arc<Self>, id: SessionId, seq: Option<u64>) -> Result<Session, StoreError> {
        let Some(warm) = self.memory.warm(id) else { return Arc::clone(self).ask_touch(id, seq, None).await };
        match self.briefly(Arc::clone(self).ask_touch(id, seq, Some(Arc::clone(&warm)))).await {
            // The server does not answer: what is known here goes on.
            Err(StoreError::Away | StoreError::NoRoom) => {
                let known = {
                    let mut known = warm.known();
                    known.seq = known.seq.max(seq);
                    *known
                };
                Ok(self.session(Arc::clone(&warm.record), known.seq, self.idle.saturating_sub(known.asked.elapsed())))
            }
            answer => answer,
        }
    }

    async fn ask_touch(self: Arc<Self>, id: SessionId, seq: Option<u64>, warm: Option<Arc<Warm>>) -> Result<Session, StoreError> {
        let command = script::touch(id, seq, warm.as_deref().map(Warm::given), self.idle);
        let (status, bytes, seq): (i64, Vec<u8>, String) = self.run(PATIENCE, &command).await?;
        if status != status::HERE {
            return Err(self.gone(id, status));
        }
        let seq = number(&seq)?;
        let (record, seq) = match warm {
            Some(warm) if bytes.is_empty() => {
                let mut known = warm.known();
                // Higher ones may have been seen here while the server did not answer: it is told with the next question.
                *known = Known { seq: seq.max(known.seq), asked: Instant::now() };
                (Arc::clone(&warm.record), known.seq)
            }
            _ => {
                let record = self.whole(id, &bytes)?.ok_or(StoreError::NoSuchSession)?;
                self.memory.learn(Arc::clone(&record), seq);
                (record, seq)
            }
        };
        Ok(self.session(record, seq, self.idle))
    }

    /// Waits for a server that has not made anybody wait just now, and does not wait long. What it says later is heard all the same: otherwise a
    /// server that is slow, and not away, would not be believed for as long as it is.
    async fn briefly<T: Send + 'static>(
        &self,
        asked: impl Future<Output = Result<T, StoreError>> + Send + 'static,
    ) -> Result<T, StoreError> {
        let spared = || self.spared.lock().unwrap_or_else(PoisonError::into_inner);
        if spared().is_some_and(|until| Instant::now() < until) {
            return Err(StoreError::Away);
        }
        let mut asked = Box::pin(asked);
        if let Ok(answer) = tokio::time::timeout(IMPATIENCE, &mut asked).await {
            return answer;
        }
        *spared() = Some(Instant::now() + READINESS);
        tokio::spawn(Scope::current().answered().wrap(asked));
        Err(StoreError::Away)
    }

    async fn peek(self: &Arc<Self>, id: SessionId) -> Result<Session, StoreError> {
        let Some(warm) = self.memory.warm(id) else { return Arc::clone(self).ask_peek(id, None).await };
        match self.briefly(Arc::clone(self).ask_peek(id, Some(Arc::clone(&warm)))).await {
            Err(StoreError::Away) => {
                let known = *warm.known();
                Ok(self.session(Arc::clone(&warm.record), known.seq, self.idle.saturating_sub(known.asked.elapsed())))
            }
            answer => answer,
        }
    }

    async fn ask_peek(self: Arc<Self>, id: SessionId, warm: Option<Arc<Warm>>) -> Result<Session, StoreError> {
        let command = script::peek(id, warm.as_deref().map(|warm| warm.record.as_ref()), self.idle);
        let (status, bytes, seq, left): (i64, Vec<u8>, String, i64) = self.run(PATIENCE, &command).await?;
        if status != status::HERE {
            return Err(self.gone(id, status));
        }
        let record = match &warm {
            Some(warm) if bytes.is_empty() => Arc::clone(&warm.record),
            _ => {
                // What is remembered is not so any more.
                self.memory.forget(id);
                self.whole(id, &bytes)?.ok_or(StoreError::NoSuchSession)?
            }
        };
        // Higher ones may have been seen here while the server did not answer.
        let here = warm.filter(|warm| warm.record.created == record.created).and_then(|warm| warm.known().seq);
        Ok(self.session(record, number(&seq)?.max(here), Duration::from_millis(u64::try_from(left).unwrap_or(0))))
    }

    async fn delete(&self, id: SessionId) -> Result<(), StoreError> {
        let status: i64 = self.run(PATIENCE, &script::delete(id, self.idle)).await?;
        let gone = self.gone(id, status);
        if status == status::HERE { Ok(()) } else { Err(gone) }
    }

    async fn image_bytes(&self, id: SessionId) -> Result<u64, StoreError> {
        Ok(COPIES * self.run::<u64>(PATIENCE, &script::file_bytes(id)).await?)
    }

    async fn image(&self, id: SessionId, digest: Digest) -> Result<Bytes, StoreError> {
        let command = script::file(id);
        let ask = |mut connection| {
            let command = &command;
            async move { command.query_async(&mut connection).await }
        };
        let file: Option<Vec<u8>> =
            self.files.ask(PATIENCE_FOR_FILES, |file: &Option<Vec<u8>>| file.as_ref().map_or(0, Vec::len), ask).await?;
        let file = Bytes::from(file.ok_or(StoreError::NoSuchSession)?);
        let theirs = file.clone();
        let found = tokio::task::spawn_blocking(move || Digest::of(&theirs)).await.map_err(|_| StoreError::Away)?;
        // Another one is another picture's: the session has been made anew.
        if found == digest { Ok(file) } else { Err(StoreError::NoSuchSession) }
    }

    async fn ready(&self) -> Result<(), StoreError> {
        let seen = || self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let known = seen().filter(|(at, _)| at.elapsed() < READINESS);
        let here = match known {
            Some((_, here)) => here,
            None => {
                let here = self.run::<String>(READINESS, &redis::cmd("PING")).await.is_ok();
                *seen() = Some((Instant::now(), here));
                here
            }
        };
        if here { Ok(()) } else { Err(StoreError::Away) }
    }
}

impl Store for RedisStore {
    fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put> {
        Box::pin(self.0.put(record, image))
    }

    fn revise(&self, old: Revision, new: Arc<Record>) -> Answer<'_, Option<Session>> {
        Box::pin(self.0.revise(old, new))
    }

    fn peek(&self, id: SessionId) -> Answer<'_, Session> {
        Box::pin(self.0.peek(id))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session> {
        Box::pin(self.0.touch(id, seq))
    }

    fn delete(&self, id: SessionId) -> Answer<'_, ()> {
        Box::pin(self.0.delete(id))
    }

    fn image_bytes(&self, id: SessionId, _: Digest) -> Answer<'_, u64> {
        Box::pin(self.0.image_bytes(id))
    }

    fn image(&self, id: SessionId, digest: Digest) -> Answer<'_, Bytes> {
        Box::pin(self.0.image(id, digest))
    }

    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.0.memory.names(owner, digest)
    }

    /// The server drops what has expired; here it is what is remembered of it.
    fn sweep(&self) -> Answer<'_, usize> {
        Box::pin(std::future::ready(Ok(self.0.memory.sweep())))
    }

    fn ready(&self) -> Answer<'_, ()> {
        Box::pin(self.0.ready())
    }

    fn figures(&self) -> Figures {
        let (sessions, bytes) = self.0.memory.size();
        Figures {
            sessions,
            bytes,
            damaged: self.0.damaged.load(Ordering::Relaxed),
            other_version: self.0.other_version.load(Ordering::Relaxed),
            failures: self.0.peer.failures() + self.0.files_peer.failures(),
            is_away: self.0.peer.is_away(),
            is_unknown: !self.0.peer.was_heard(),
        }
    }
}
