//! What the server last said about the sessions used in this process. Bounded in bytes; the least
//! recently used are forgotten first.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;
use mlswarp::warp::Digest;

use crate::client::Owner;
use crate::session::SessionId;
use crate::store::index::record_bytes;
use crate::store::{Record, SWEPT_AT_ONCE};

/// A session as this process knows it.
pub(crate) struct CachedSession {
    pub(crate) record: Arc<Record>,
    progress: Mutex<SessionProgress>,
}

/// What changes with every pose of a drag.
#[derive(Clone, Copy)]
pub(crate) struct SessionProgress {
    /// The highest number that this process knows of.
    pub(crate) seq: Option<u64>,
    /// When the server confirmed the session.
    pub(crate) confirmed: Instant,
}

impl CachedSession {
    pub(crate) fn progress(&self) -> MutexGuard<'_, SessionProgress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The sessions used in this process.
pub(crate) struct SessionCache {
    idle: Duration,
    limit: u64,
    state: Mutex<SessionCacheState>,
}

struct SessionCacheState {
    sessions: LruCache<SessionId, Arc<CachedSession>>,
    bytes: u64,
    /// How often sessions of an owner name a file. Without this, each image that leaves the cache
    /// of images would be sought in all sessions.
    names: HashMap<(Owner, Digest), usize>,
}

impl SessionCacheState {
    fn put(&mut self, cached: CachedSession) {
        let record = &cached.record;
        self.bytes += record_bytes(record);
        for file in record.files() {
            *self.names.entry((record.id.owner(), file)).or_default() += 1;
        }
        self.sessions.put(record.id, Arc::new(cached));
    }

    /// Takes away what [`Self::put`] has added for a session that is no longer cached.
    fn uncount(&mut self, record: &Record) {
        self.bytes -= record_bytes(record);
        for file in record.files() {
            if let Entry::Occupied(mut names) = self.names.entry((record.id.owner(), file)) {
                *names.get_mut() -= 1;
                if *names.get() == 0 {
                    names.remove();
                }
            }
        }
    }
}

impl SessionCache {
    pub(crate) fn new(idle: Duration, limit: u64) -> Self {
        Self {
            idle,
            limit,
            state: Mutex::new(SessionCacheState {
                sessions: LruCache::unbounded(),
                bytes: 0,
                names: HashMap::new(),
            }),
        }
    }

    fn lock(&self) -> MutexGuard<'_, SessionCacheState> {
        // No operation leaves the state half-changed where it could panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Remembers what the server has just said. Higher numbers of the same incarnation that it has
    /// not been told yet are kept.
    pub(crate) fn learn(&self, record: Arc<Record>, seq: Option<u64>) {
        let mut state = self.lock();
        let before = state.sessions.pop(&record.id);
        if let Some(before) = &before {
            state.uncount(&before.record);
        }
        let before = before.filter(|before| before.record.created == record.created);
        let seq = seq.max(before.and_then(|before| before.progress().seq));
        let progress = Mutex::new(SessionProgress {
            seq,
            confirmed: Instant::now(),
        });
        state.put(CachedSession { record, progress });
        while state.bytes > self.limit {
            let Some((_, oldest)) = state.sessions.pop_lru() else {
                break;
            };
            state.uncount(&oldest.record);
        }
    }

    /// The session, unless it has expired since the server confirmed it.
    pub(crate) fn get(&self, id: SessionId) -> Option<Arc<CachedSession>> {
        self.lock()
            .sessions
            .get(&id)
            .filter(|cached| cached.progress().confirmed.elapsed() < self.idle)
            .cloned()
    }

    pub(crate) fn forget(&self, id: SessionId) {
        let mut state = self.lock();
        if let Some(cached) = state.sessions.pop(&id) {
            state.uncount(&cached.record);
        }
    }

    /// Forgets some expired sessions; returns how many. One that was used while the server did not
    /// confirm it lies before others, and waits for them.
    pub(crate) fn sweep(&self) -> usize {
        let mut state = self.lock();
        let is_over = |(_, cached): (&SessionId, &Arc<CachedSession>)| {
            cached.progress().confirmed.elapsed() >= self.idle
        };
        let mut swept = 0;
        while swept < SWEPT_AT_ONCE
            && state.sessions.peek_lru().is_some_and(is_over)
            && let Some((_, cached)) = state.sessions.pop_lru()
        {
            state.uncount(&cached.record);
            swept += 1;
        }
        swept
    }

    /// Whether a cached session of that owner names that file.
    pub(crate) fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.lock().names.contains_key(&(owner, digest))
    }

    /// The number of sessions, and their bytes.
    pub(crate) fn size(&self) -> (u64, u64) {
        let state = self.lock();
        (state.sessions.len() as u64, state.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::suite;

    #[test]
    fn the_longest_unasked_are_forgotten_when_there_are_too_many() {
        let cache = SessionCache::new(Duration::from_secs(60), 14 * 512);
        let records: Vec<_> = (0..17).map(suite::record).collect();
        for record in &records {
            cache.learn(Arc::clone(record), Some(1));
        }
        assert_eq!(cache.size(), (14, 14 * 512));
        assert!(cache.get(records[2].id).is_none() && cache.get(records[3].id).is_some());
        cache.learn(Arc::clone(&records[16]), Some(2));
        assert_eq!(
            (
                cache.size(),
                cache.get(records[16].id).unwrap().progress().seq
            ),
            ((14, 14 * 512), Some(2))
        );
        cache.forget(records[16].id);
        assert!(
            !cache.names(records[16].id.owner(), records[16].image)
                && cache.names(records[15].id.owner(), records[15].image)
        );
        // One session that names a file is enough.
        let again = Arc::new(Record {
            id: SessionId::random(Owner::ANYBODY),
            ..Record::clone(&records[15])
        });
        cache.learn(Arc::clone(&again), None);
        cache.learn(Arc::clone(&again), None);
        cache.forget(again.id);
        assert!(cache.names(again.id.owner(), again.image));
        cache.forget(records[15].id);
        assert!(!cache.names(again.id.owner(), again.image));
        let brief = SessionCache::new(Duration::ZERO, 1 << 20);
        brief.learn(Arc::clone(&records[0]), None);
        assert!(brief.get(records[0].id).is_none());
        assert_eq!((brief.sweep(), brief.size()), (1, (0, 0)));
        for _ in 0..=SWEPT_AT_ONCE {
            brief.learn(suite::record(1), None);
        }
        assert_eq!((brief.sweep(), brief.size()), (SWEPT_AT_ONCE, (1, 512)));
        brief.sweep();
        assert!(brief.lock().names.is_empty());
    }
}
