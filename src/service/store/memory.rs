//! Sessions in memory, bounded in number and bytes. A full store refuses newcomers; it never throws out a living session.
//! Every operation is a few map accesses under one lock; a sweep walks all sessions.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use bytes::Bytes;

use super::{Answer, Bounds, Put, Record, Session, Store, StoreError};
use crate::service::session::{Revision, SessionId};
use crate::warp::Digest;

/// The store that is built in.
#[derive(Debug)]
pub struct MemoryStore {
    bounds: Bounds,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    sessions: HashMap<SessionId, Entry>,
    files: HashMap<Digest, File>,
    bytes: u64,
    /// Expired sessions, to be told from unknown ones for one idle period. At most as many as there may be sessions.
    graves: HashMap<SessionId, Instant>,
    graves_by_age: VecDeque<SessionId>,
}

#[derive(Debug)]
struct Entry {
    record: Arc<Record>,
    bytes: u64,
    seq: Option<u64>,
    used: Instant,
}

#[derive(Debug)]
struct File {
    bytes: Bytes,
    sessions: usize,
}

impl MemoryStore {
    /// An empty store.
    #[must_use]
    pub fn new(bounds: Bounds) -> Self {
        Self { bounds, held: Mutex::default() }
    }

    /// Bytes of files and records now held.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.lock().bytes
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        // No operation leaves the maps half-changed where it could panic.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn session(&self, entry: &Entry) -> Session {
        let left = self.bounds.idle.saturating_sub(entry.used.elapsed());
        Session { record: Arc::clone(&entry.record), seq: entry.seq, expires: SystemTime::now() + left }
    }

    fn create_now(&self, record: Arc<Record>, image: Bytes) -> Result<Session, StoreError> {
        self.insert(&mut self.lock(), record, image)
    }

    /// A new session, or another one of its name.
    fn insert(&self, held: &mut Held, record: Arc<Record>, image: Bytes) -> Result<Session, StoreError> {
        let now = Instant::now();
        let bytes = record_bytes(&record);
        if held.room(&self.bounds, &record, bytes, image.len() as u64).is_err() {
            held.sweep(self.bounds, now);
        }
        held.room(&self.bounds, &record, bytes, image.len() as u64)?;
        // The new file is counted before the old one is let go: it may be the same.
        let file = held.files.entry(record.image).or_insert_with(|| {
            held.bytes += image.len() as u64;
            File { bytes: image, sessions: 0 }
        });
        file.sessions += 1;
        held.remove(record.id);
        held.graves.remove(&record.id);
        held.bytes += bytes;
        let entry = Entry { record: Arc::clone(&record), bytes, seq: None, used: now };
        let session = self.session(&entry);
        held.sessions.insert(record.id, entry);
        Ok(session)
    }

    fn put_now(&self, record: Arc<Record>, image: Bytes) -> Result<Put, StoreError> {
        let held = &mut *self.lock();
        self.bury_if_expired(held, record.id);
        match held.sessions.get_mut(&record.id) {
            None => self.insert(held, record, image).map(Put::Created),
            Some(entry) if entry.record.is_made_like(&record) => {
                entry.used = Instant::now();
                Ok(Put::Same(self.session(entry)))
            }
            Some(entry) => {
                let old = Arc::clone(&entry.record);
                self.insert(held, record, image).map(|session| Put::Replaced(session, old))
            }
        }
    }

    fn revise_now(&self, old: Revision, new: Arc<Record>) -> Result<Option<Session>, StoreError> {
        self.with(new.id, |held| {
            let Some(entry) = held.sessions.get(&new.id).filter(|entry| entry.record.revision == old) else { return Ok(None) };
            let bytes = record_bytes(&new);
            let all = held.bytes - entry.bytes + bytes;
            if all > self.bounds.bytes {
                return Err(StoreError::Full { what: "store_bytes", limit: self.bounds.bytes, actual: all });
            }
            held.bytes = all;
            let entry = Entry { record: Arc::clone(&new), bytes, seq: entry.seq, used: Instant::now() };
            let session = self.session(&entry);
            held.sessions.insert(new.id, entry);
            Ok(Some(session))
        })?
    }

    fn bury_if_expired(&self, held: &mut Held, id: SessionId) {
        if held.sessions.get(&id).is_some_and(|entry| entry.used.elapsed() >= self.bounds.idle) {
            held.bury(id, self.bounds);
        }
    }

    /// The living session, after those who are not have been told apart.
    fn with<T>(&self, id: SessionId, use_it: impl FnOnce(&mut Held) -> T) -> Result<T, StoreError> {
        let now = Instant::now();
        let held = &mut *self.lock();
        self.bury_if_expired(held, id);
        if held.sessions.contains_key(&id) {
            return Ok(use_it(held));
        }
        match held.graves.get(&id) {
            Some(until) if now < *until => Err(StoreError::Expired),
            _ => Err(StoreError::NoSuchSession),
        }
    }
}

impl Held {
    /// Whether there is room for the record, and for its file where that is new.
    fn room(&self, bounds: &Bounds, record: &Record, bytes: u64, image: u64) -> Result<(), StoreError> {
        let old = self.sessions.get(&record.id);
        let sessions = self.sessions.len() + usize::from(old.is_none());
        if sessions > bounds.sessions {
            return Err(StoreError::Full { what: "sessions", limit: bounds.sessions as u64, actual: sessions as u64 });
        }
        let file = if self.files.contains_key(&record.image) { 0 } else { image };
        // A replaced session's file is held until the new one is there.
        let bytes = self.bytes - old.map_or(0, |old| old.bytes) + bytes + file;
        if bytes > bounds.bytes {
            return Err(StoreError::Full { what: "store_bytes", limit: bounds.bytes, actual: bytes });
        }
        Ok(())
    }

    fn remove(&mut self, id: SessionId) -> Option<Entry> {
        let entry = self.sessions.remove(&id)?;
        self.bytes -= entry.bytes;
        if let Some(file) = self.files.get_mut(&entry.record.image) {
            file.sessions -= 1;
            if file.sessions == 0 {
                self.bytes -= file.bytes.len() as u64;
                self.files.remove(&entry.record.image);
            }
        }
        Some(entry)
    }

    fn bury(&mut self, id: SessionId, bounds: Bounds) {
        if let Some(entry) = self.remove(id) {
            self.graves.insert(id, entry.used + 2 * bounds.idle);
            self.graves_by_age.push_back(id);
            while self.graves_by_age.len() > bounds.sessions {
                if let Some(oldest) = self.graves_by_age.pop_front() {
                    self.graves.remove(&oldest);
                }
            }
        }
    }

    fn sweep(&mut self, bounds: Bounds, now: Instant) -> usize {
        let mut ended: Vec<(Instant, SessionId)> =
            self.sessions.iter().filter(|(_, e)| now.duration_since(e.used) >= bounds.idle).map(|(id, e)| (e.used, *id)).collect();
        ended.sort_unstable();
        for (_, id) in &ended {
            self.bury(*id, bounds);
        }
        self.graves.retain(|_, until| now < *until);
        let graves = &self.graves;
        self.graves_by_age.retain(|id| graves.contains_key(id));
        ended.len()
    }
}

/// What a record costs beside its picture's file.
fn record_bytes(record: &Record) -> u64 {
    let places: usize = record.rest.p.iter().map(|h| 1 + h.places().len()).sum();
    512 + 32 * places as u64 + 8 * record.rest.weights.as_ref().map_or(0, Vec::len) as u64
}

/// Wraps what is already known.
fn ready<'a, T: Send + 'a>(answer: Result<T, StoreError>) -> Answer<'a, T> {
    Box::pin(std::future::ready(answer))
}

impl Store for MemoryStore {
    fn create(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Session> {
        ready(self.create_now(record, image))
    }

    fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put> {
        ready(self.put_now(record, image))
    }

    fn revise(&self, old: Revision, new: Arc<Record>) -> Answer<'_, Option<Session>> {
        ready(self.revise_now(old, new))
    }

    fn peek(&self, id: SessionId) -> Answer<'_, Session> {
        ready(self.with(id, |held| self.session(&held.sessions[&id])))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session> {
        ready(
            self.with(id, |held| {
                held.sessions.get_mut(&id).map(|entry| {
                    entry.used = Instant::now();
                    // `None` is below every number.
                    entry.seq = entry.seq.max(seq);
                    self.session(entry)
                })
            })
            .and_then(|session| session.ok_or(StoreError::NoSuchSession)),
        )
    }

    fn delete(&self, id: SessionId) -> Answer<'_, ()> {
        ready(self.with(id, |held| drop(held.remove(id))))
    }

    fn image(&self, digest: Digest) -> Answer<'_, Bytes> {
        ready(self.lock().files.get(&digest).map(|f| f.bytes.clone()).ok_or(StoreError::NoSuchSession))
    }

    fn sweep(&self) -> Answer<'_, usize> {
        ready(Ok(self.lock().sweep(self.bounds, Instant::now())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixmap::Extent;
    use crate::service::client::Owner;
    use crate::warp::{Folds, OutputSpec, RestSpec};
    use std::time::Duration;

    const IDLE: Duration = Duration::from_millis(150);

    fn store(sessions: usize, bytes: u64) -> MemoryStore {
        MemoryStore::new(Bounds { idle: IDLE, sessions, bytes })
    }

    fn record(image: u8) -> Arc<Record> {
        Arc::new(Record {
            id: SessionId::random(Owner::ANYBODY),
            revision: Revision::random(),
            image: Digest([image; 32]),
            extent: Extent::new(4, 3).unwrap(),
            rest: RestSpec::default(),
            folds: Folds::default(),
            output: OutputSpec::default(),
            created: SystemTime::now(),
        })
    }

    fn file(len: usize) -> Bytes {
        Bytes::from(vec![0; len])
    }

    #[tokio::test]
    async fn a_file_is_held_once_and_goes_with_its_last_session() {
        let store = store(10, 1 << 20);
        let (a, b) = (record(1), record(1));
        store.create(Arc::clone(&a), file(1000)).await.unwrap();
        let one = store.bytes();
        store.create(Arc::clone(&b), file(1000)).await.unwrap();
        assert_eq!(store.bytes(), one + (one - 1000));
        store.delete(a.id).await.unwrap();
        assert_eq!(store.image(a.image).await.unwrap().len(), 1000);
        store.delete(b.id).await.unwrap();
        assert_eq!(store.image(a.image).await, Err(StoreError::NoSuchSession));
        assert_eq!(store.bytes(), 0);
        assert_eq!(store.delete(b.id).await, Err(StoreError::NoSuchSession));
    }

    #[tokio::test]
    async fn a_put_makes_a_session_once_and_makes_it_anew_from_something_else() {
        let store = store(1, 1 << 20);
        let a = record(1);
        assert!(matches!(store.put(Arc::clone(&a), file(1000)).await, Ok(Put::Created(_))));
        store.touch(a.id, Some(7)).await.unwrap();
        let (one, again) = (store.bytes(), Record { revision: Revision::random(), created: SystemTime::now(), ..(*a).clone() });
        let Ok(Put::Same(same)) = store.put(Arc::new(again), file(1000)).await else { panic!("the same file and handles") };
        assert_eq!((same.record.revision, same.seq, store.bytes()), (a.revision, Some(7), one));

        let other = Arc::new(Record { revision: Revision::random(), image: Digest([2; 32]), ..(*a).clone() });
        let Ok(Put::Replaced(session, old)) = store.put(Arc::clone(&other), file(300)).await else { panic!("another file") };
        assert_eq!((session.record, session.seq, old), (other, None, a.clone()));
        assert_eq!(store.bytes(), one - 700);
        assert_eq!(store.image(a.image).await, Err(StoreError::NoSuchSession));
        assert!(matches!(store.put(record(3), file(1)).await, Err(StoreError::Full { what: "sessions", .. })));

        tokio::time::sleep(IDLE + IDLE / 5).await;
        assert!(matches!(store.put(a, file(1000)).await, Ok(Put::Created(_))), "an expired session is not replaced");
    }

    #[tokio::test]
    async fn handles_are_revised_once_a_revision_and_numbers_go_on() {
        let store = store(1, 2000);
        let a = record(1);
        store.create(Arc::clone(&a), file(1000)).await.unwrap();
        store.touch(a.id, Some(7)).await.unwrap();
        let weights = |n: usize| RestSpec { weights: Some(vec![1.0; n]), ..RestSpec::default() };
        let b = Arc::new(Record { revision: Revision::random(), rest: weights(4), ..(*a).clone() });
        let before = store.bytes();
        let session = store.revise(a.revision, Arc::clone(&b)).await.unwrap().expect("the revision is there");
        assert_eq!((session.seq, store.peek(a.id).await.unwrap().record, store.bytes()), (Some(7), Arc::clone(&b), before + 32));
        assert!(store.revise(a.revision, Arc::clone(&a)).await.unwrap().is_none(), "someone was faster");
        let huge = Arc::new(Record { revision: Revision::random(), rest: weights(100), ..(*a).clone() });
        assert!(matches!(store.revise(b.revision, huge).await, Err(StoreError::Full { what: "store_bytes", .. })));
        let gone = record(2);
        assert_eq!(store.revise(gone.revision, gone).await.unwrap_err(), StoreError::NoSuchSession);
        store.delete(a.id).await.unwrap();
        assert_eq!(store.bytes(), 0);
    }

    #[tokio::test]
    async fn a_full_store_refuses_newcomers_and_keeps_the_living() {
        let store = store(2, 4000);
        let a = record(1);
        store.create(Arc::clone(&a), file(1000)).await.unwrap();
        let refused = store.create(record(2), file(4000)).await.unwrap_err();
        assert!(matches!(refused, StoreError::Full { what: "store_bytes", limit: 4000, .. }), "{refused:?}");
        store.create(record(3), file(100)).await.unwrap();
        let refused = store.create(record(4), file(1)).await.unwrap_err();
        assert_eq!(refused, StoreError::Full { what: "sessions", limit: 2, actual: 3 });
        assert!(store.peek(a.id).await.is_ok());
    }

    #[tokio::test]
    async fn a_session_expires_is_told_so_for_one_period_and_is_then_forgotten() {
        let store = store(2, 1 << 20);
        let a = record(1);
        store.create(Arc::clone(&a), file(10)).await.unwrap();
        tokio::time::sleep(IDLE + IDLE / 5).await;
        assert_eq!(store.peek(a.id).await.unwrap_err(), StoreError::Expired);
        assert_eq!(store.bytes(), 0);
        tokio::time::sleep(IDLE).await;
        assert_eq!(store.touch(a.id, None).await.unwrap_err(), StoreError::NoSuchSession);
    }

    #[tokio::test]
    async fn use_prolongs_a_life_and_looking_does_not() {
        let store = store(2, 1 << 20);
        let (used, seen) = (record(1), record(1));
        store.create(Arc::clone(&used), file(10)).await.unwrap();
        store.create(Arc::clone(&seen), file(10)).await.unwrap();
        for _ in 0..4 {
            tokio::time::sleep(IDLE / 3).await;
            store.touch(used.id, None).await.unwrap();
            let _ = store.peek(seen.id).await;
        }
        assert!(store.peek(used.id).await.is_ok());
        assert_eq!(store.peek(seen.id).await.unwrap_err(), StoreError::Expired);
    }

    #[tokio::test]
    async fn expired_sessions_make_room_for_newcomers() {
        let store = store(1, 1 << 20);
        store.create(record(1), file(10)).await.unwrap();
        tokio::time::sleep(IDLE + IDLE / 5).await;
        store.create(record(2), file(10)).await.unwrap();
        tokio::time::sleep(IDLE + IDLE / 5).await;
        assert_eq!(store.sweep().await, Ok(1));
        assert_eq!(store.bytes(), 0);
    }

    #[tokio::test]
    async fn the_highest_seq_is_remembered() {
        let store = store(1, 1 << 20);
        let a = record(1);
        store.create(Arc::clone(&a), file(10)).await.unwrap();
        for (seq, highest) in [(None, None), (Some(5), Some(5)), (Some(3), Some(5)), (None, Some(5)), (Some(9), Some(9))] {
            assert_eq!(store.touch(a.id, seq).await.unwrap().seq, highest);
        }
    }
}
