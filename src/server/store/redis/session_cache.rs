//! What the server said last of the sessions that are used here. Bounded in bytes: those that the server was asked about longest ago are forgotten
//! first, which costs another look at the server and nothing else.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use mlswarp::warp::Digest;

use super::script::Given;
use crate::client::Owner;
use crate::session::SessionId;
use crate::store::Record;
use crate::store::index::record_bytes;

/// A session as the server told it.
pub(crate) struct Warm {
    pub(crate) record: Arc<Record>,
    known: Mutex<Known>,
}

/// What changes with every step of a drag.
#[derive(Clone, Copy)]
pub(crate) struct Known {
    /// The highest number, as far as this process knows.
    pub(crate) seq: Option<u64>,
    /// When the server told it.
    pub(crate) asked: Instant,
}

impl Warm {
    pub(crate) fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the server may not know of it.
    pub(crate) fn given(&self) -> Given {
        Given { revision: self.record.revision, created: self.record.created, seq: self.known().seq }
    }
}

/// All of them.
pub(crate) struct SessionCache {
    idle: Duration,
    limit: u64,
    held: Mutex<SessionCacheState>,
}

#[derive(Default)]
struct SessionCacheState {
    sessions: HashMap<SessionId, Arc<Warm>>,
    bytes: u64,
}

impl SessionCacheState {
    fn remove(&mut self, id: SessionId) {
        if let Some(warm) = self.sessions.remove(&id) {
            self.bytes -= record_bytes(&warm.record);
        }
    }

    /// Forgets what was asked about longest ago, until a part of the room is free: a search each time would be one a request.
    fn make_room(&mut self, limit: u64) {
        let mut all: Vec<(Instant, SessionId)> = self.sessions.iter().map(|(id, warm)| (warm.known().asked, *id)).collect();
        all.sort_unstable();
        for (_, id) in all {
            if self.bytes <= limit - limit / 8 {
                return;
            }
            self.remove(id);
        }
    }
}

impl SessionCache {
    pub(crate) fn new(idle: Duration, limit: u64) -> Self {
        Self { idle, limit, held: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, SessionCacheState> {
        // No operation leaves the map half-changed where it could panic.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Remembers what the server said just now. Numbers of the same life that it has not been told yet are not forgotten.
    pub(crate) fn learn(&self, record: Arc<Record>, seq: Option<u64>) {
        let held = &mut *self.lock();
        let before = held.sessions.get(&record.id).filter(|warm| warm.record.created == record.created);
        let seq = seq.max(before.and_then(|warm| warm.known().seq));
        held.remove(record.id);
        held.bytes += record_bytes(&record);
        held.sessions.insert(record.id, Arc::new(Warm { record, known: Mutex::new(Known { seq, asked: Instant::now() }) }));
        if held.bytes > self.limit {
            held.make_room(self.limit);
        }
    }

    /// What is remembered, if the server can still know of it.
    pub(crate) fn warm(&self, id: SessionId) -> Option<Arc<Warm>> {
        self.lock().sessions.get(&id).filter(|warm| warm.known().asked.elapsed() < self.idle).cloned()
    }

    pub(crate) fn forget(&self, id: SessionId) {
        self.lock().remove(id);
    }

    /// Forgets what the server has dropped; says how many.
    pub(crate) fn sweep(&self) -> usize {
        let held = &mut *self.lock();
        let over: Vec<SessionId> =
            held.sessions.iter().filter(|(_, warm)| warm.known().asked.elapsed() >= self.idle).map(|(id, _)| *id).collect();
        for id in &over {
            held.remove(*id);
        }
        over.len()
    }

    /// Some session of that owner that is remembered has that picture.
    pub(crate) fn names(&self, owner: Owner, image: Digest) -> bool {
        self.lock().sessions.values().any(|warm| warm.record.image == image && warm.record.id.owner() == owner)
    }

    /// How many, and their bytes.
    pub(crate) fn size(&self) -> (u64, u64) {
        let held = self.lock();
        (held.sessions.len() as u64, held.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::suite;

    #[test]
    fn the_longest_unasked_are_forgotten_when_there_are_too_many() {
        let memory = SessionCache::new(Duration::from_secs(60), 16 * 512);
        let records: Vec<_> = (0..17).map(suite::record).collect();
        for record in &records {
            memory.learn(Arc::clone(record), Some(1));
        }
        assert_eq!(memory.size(), (14, 14 * 512));
        assert!(memory.warm(records[2].id).is_none() && memory.warm(records[3].id).is_some());
        memory.learn(Arc::clone(&records[16]), Some(2));
        assert_eq!((memory.size(), memory.warm(records[16].id).unwrap().known().seq), ((14, 14 * 512), Some(2)));
        memory.forget(records[16].id);
        assert!(!memory.names(records[16].id.owner(), records[16].image) && memory.names(records[15].id.owner(), records[15].image));
        let brief = SessionCache::new(Duration::ZERO, 1 << 20);
        brief.learn(Arc::clone(&records[0]), None);
        assert!(brief.warm(records[0].id).is_none());
        assert_eq!((brief.sweep(), brief.size()), (1, (0, 0)));
    }
}
