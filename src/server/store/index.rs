//! Which sessions live, what they weigh, when they end: what the stores of one process share. Bounded in number and bytes; a full index
//! refuses newcomers and never throws out a living session. Every operation is a few map accesses; a sweep walks all sessions.
//!
//! A change is weighed first, which changes nothing, and then applied, which cannot fail: in between a store does what may fail. Files are
//! counted here and held by their store; [`Index::freed`] says which of them a change leaves without a session.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use mlswarp::warp::Digest;

use super::{Bounds, Put, Record, Session, StoreError};
use crate::client::Owner;
use crate::session::{Revision, SessionId};

/// The sessions of one process.
#[derive(Debug)]
pub(crate) struct Index {
    bounds: Bounds,
    sessions: HashMap<SessionId, Entry>,
    files: HashMap<Digest, File>,
    bytes: u64,
    /// Sessions whose record another version of the program has written.
    unread: HashMap<SessionId, Unread>,
    /// Ended sessions, remembered for a while. At most as many as there may be sessions.
    tombstones: HashMap<SessionId, Grave>,
    /// In the order in which they were made.
    graves_by_age: VecDeque<(SessionId, Grave)>,
}

/// How a session has ended, and until when that is remembered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Grave {
    end: End,
    until: Instant,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// It was not used for one idle period: remembered for another one.
    Expired,
    /// Its owner deleted it: remembered for one idle period.
    Deleted,
}

/// A session that is kept unread.
#[derive(Debug)]
struct Unread {
    bytes: u64,
    files: Vec<Digest>,
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
    bytes: u64,
    sessions: usize,
}

/// What a record that is put will come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PutOutcome {
    /// There is no such session.
    Create,
    /// The session that is there was made from the same.
    Stay,
    /// Another one is there.
    Replace,
}

impl Index {
    pub(crate) fn new(bounds: Bounds) -> Self {
        Self {
            bounds,
            sessions: HashMap::new(),
            files: HashMap::new(),
            bytes: 0,
            unread: HashMap::new(),
            tombstones: HashMap::new(),
            graves_by_age: VecDeque::new(),
        }
    }

    /// Sessions, living or not yet swept, or unread.
    pub(crate) fn len(&self) -> usize {
        self.sessions.len() + self.unread.len()
    }

    /// Bytes of files and records.
    pub(crate) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// How long the file is that a session names.
    pub(crate) fn file(&self, digest: Digest) -> Option<u64> {
        self.files.get(&digest).map(|file| file.bytes)
    }

    fn told(&self, entry: &Entry) -> Session {
        let left = self.bounds.idle.saturating_sub(entry.used.elapsed());
        Session { record: Arc::clone(&entry.record), seq: entry.seq, expires: SystemTime::now() + left }
    }

    fn is_over(&self, entry: &Entry, now: Instant) -> bool {
        now.saturating_duration_since(entry.used) >= self.bounds.idle
    }

    /// The living session, or why there is none.
    fn living(&self, id: SessionId, now: Instant) -> Result<&Entry, StoreError> {
        let until = match self.sessions.get(&id) {
            Some(entry) if !self.is_over(entry, now) => return Ok(entry),
            Some(entry) => Some(entry.used + 2 * self.bounds.idle),
            None if self.unread.contains_key(&id) => return Err(StoreError::OtherVersion),
            None => self.tombstones.get(&id).filter(|grave| grave.end == End::Expired).map(|grave| grave.until),
        };
        if until.is_some_and(|until| now < until) { Err(StoreError::Expired) } else { Err(StoreError::NoSuchSession) }
    }

    /// Whether a delete of this session removes something: `false` when it has been deleted already, less than one idle period ago.
    pub(crate) fn weigh_delete(&self, id: SessionId) -> Result<bool, StoreError> {
        let now = Instant::now();
        let is_deleted = |grave: &Grave| grave.end == End::Deleted && now < grave.until;
        match self.living(id, now) {
            Ok(_) | Err(StoreError::OtherVersion) => Ok(true),
            Err(StoreError::NoSuchSession) if self.tombstones.get(&id).is_some_and(is_deleted) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Takes a session out that its owner has deleted, and remembers that.
    pub(crate) fn delete(&mut self, id: SessionId) {
        self.remove(id);
        self.remember(id, Grave { end: End::Deleted, until: Instant::now() + self.bounds.idle });
    }

    /// Looks without using.
    pub(crate) fn peek(&self, id: SessionId) -> Result<Session, StoreError> {
        self.living(id, Instant::now()).map(|entry| self.told(entry))
    }

    /// Uses the session.
    pub(crate) fn touch(&mut self, id: SessionId, seq: Option<u64>) -> Result<Session, StoreError> {
        self.living(id, Instant::now())?;
        self.use_now(id, seq).ok_or(StoreError::NoSuchSession)
    }

    fn use_now(&mut self, id: SessionId, seq: Option<u64>) -> Option<Session> {
        let entry = self.sessions.get_mut(&id)?;
        entry.used = Instant::now();
        // `None` is below every number.
        entry.seq = entry.seq.max(seq);
        let entry = &self.sessions[&id];
        Some(self.told(entry))
    }

    /// What putting the record will come to, and whether there is room for it.
    pub(crate) fn weigh(&self, record: &Record, file: u64) -> Result<PutOutcome, StoreError> {
        let old = match self.living(record.id, Instant::now()) {
            Err(StoreError::OtherVersion) => return Err(StoreError::OtherVersion),
            living => living.ok(),
        };
        if old.is_some_and(|old| old.record.is_made_like(record)) {
            return Ok(PutOutcome::Stay);
        }
        let there = self.sessions.get(&record.id);
        let sessions = self.len() + usize::from(there.is_none());
        if sessions > self.bounds.sessions {
            return Err(StoreError::Full { what: "sessions", limit: self.bounds.sessions as u64, actual: sessions as u64 });
        }
        // Whether another owner has the same file must not be seen from the answer of a store that is almost full.
        let file = if self.names(record.id.owner(), record.image) { 0 } else { file };
        // A replaced session's file is held until the new one is there.
        self.room(self.bytes - there.map_or(0, |there| there.bytes) + record_bytes(record) + file)?;
        Ok(if old.is_some() { PutOutcome::Replace } else { PutOutcome::Create })
    }

    fn room(&self, bytes: u64) -> Result<(), StoreError> {
        let limit = self.bounds.bytes;
        if bytes > limit { Err(StoreError::Full { what: "store_bytes", limit, actual: bytes }) } else { Ok(()) }
    }

    /// Puts a record that has been weighed.
    pub(crate) fn put(&mut self, record: Arc<Record>, file: u64, will: PutOutcome) -> Put {
        if will == PutOutcome::Stay
            && let Some(session) = self.use_now(record.id, None)
        {
            return Put::Same(session);
        }
        let id = record.id;
        let old = self.insert(record, file, None);
        let session = self.told(&self.sessions[&id]);
        match old {
            Some(old) if will == PutOutcome::Replace => Put::Replaced(session, old),
            _ => Put::Created(session),
        }
    }

    /// A session that was there before the process was: it lives for another idle period.
    pub(crate) fn restore(&mut self, record: Arc<Record>, file: u64, seq: Option<u64>) {
        self.insert(record, file, seq);
    }

    /// A session whose record, of so many bytes, another version of the program has written, and the files that it names. It has no end here.
    pub(crate) fn restore_unread(&mut self, id: SessionId, bytes: u64, files: &[(Digest, u64)]) {
        for (digest, len) in files {
            self.name_file(*digest, *len);
        }
        self.bytes += bytes;
        self.unread.insert(id, Unread { bytes, files: files.iter().map(|(digest, _)| *digest).collect() });
    }

    fn name_file(&mut self, digest: Digest, len: u64) {
        let held = self.files.entry(digest).or_insert_with(|| {
            self.bytes += len;
            File { bytes: len, sessions: 0 }
        });
        held.sessions += 1;
    }

    fn unname_file(&mut self, digest: Digest) {
        if let Some(file) = self.files.get_mut(&digest) {
            file.sessions -= 1;
            if file.sessions == 0 {
                self.bytes -= file.bytes;
                self.files.remove(&digest);
            }
        }
    }

    /// The file cannot be read any more: no unread session names it.
    pub(crate) fn lose_file(&mut self, digest: Digest) {
        let named = self.unread.values_mut().filter_map(|unread| {
            let place = unread.files.iter().position(|file| *file == digest)?;
            Some(unread.files.swap_remove(place))
        });
        for digest in named.collect::<Vec<_>>() {
            self.unname_file(digest);
        }
    }

    fn insert(&mut self, record: Arc<Record>, file: u64, seq: Option<u64>) -> Option<Arc<Record>> {
        // The new file is counted before the old one is let go: it may be the same.
        self.name_file(record.image, file);
        let old = self.remove(record.id);
        if self.tombstones.remove(&record.id).is_some() {
            self.graves_by_age.retain(|(id, _)| *id != record.id);
        }
        let bytes = record_bytes(&record);
        self.bytes += bytes;
        self.sessions.insert(record.id, Entry { record, bytes, seq, used: Instant::now() });
        old
    }

    /// Whether the record may take the place of that revision: `false` when another one is there.
    pub(crate) fn weigh_revision(&self, old: Revision, new: &Record) -> Result<bool, StoreError> {
        let entry = self.living(new.id, Instant::now())?;
        if entry.record.revision != old {
            return Ok(false);
        }
        self.room(self.bytes - entry.bytes + record_bytes(new)).map(|()| true)
    }

    /// Puts a record that has been weighed in the place of its predecessor.
    pub(crate) fn revise(&mut self, new: Arc<Record>) -> Option<Session> {
        let (id, bytes) = (new.id, record_bytes(&new));
        let entry = self.sessions.get_mut(&id)?;
        self.bytes = self.bytes - entry.bytes + bytes;
        (entry.record, entry.bytes) = (new, bytes);
        self.use_now(id, None)
    }

    /// Files that no session names any more when these have gone and one names `kept`.
    pub(crate) fn freed(&self, gone: &[SessionId], kept: Option<Digest>) -> Vec<(Digest, u64)> {
        let mut fewer: HashMap<Digest, usize> = HashMap::new();
        for id in gone {
            let read = self.sessions.get(id).map(|entry| entry.record.image);
            let unread = self.unread.get(id).map_or(&[][..], |unread| &unread.files);
            for digest in read.iter().chain(unread) {
                *fewer.entry(*digest).or_default() += 1;
            }
        }
        fewer.retain(|digest, fewer| Some(*digest) != kept && self.files.get(digest).is_some_and(|file| file.sessions == *fewer));
        fewer.into_keys().map(|digest| (digest, self.files[&digest].bytes)).collect()
    }

    /// Takes a session out, living or not.
    pub(crate) fn remove(&mut self, id: SessionId) -> Option<Arc<Record>> {
        if let Some(unread) = self.unread.remove(&id) {
            self.bytes -= unread.bytes;
            unread.files.into_iter().for_each(|digest| self.unname_file(digest));
        }
        let entry = self.sessions.remove(&id)?;
        self.bytes -= entry.bytes;
        self.unname_file(entry.record.image);
        Some(entry.record)
    }

    /// Sessions that have expired, the oldest first.
    pub(crate) fn expired(&self) -> Vec<SessionId> {
        let now = Instant::now();
        let mut ended: Vec<(Instant, SessionId)> =
            self.sessions.iter().filter(|(_, e)| self.is_over(e, now)).map(|(id, e)| (e.used, *id)).collect();
        ended.sort_unstable();
        ended.into_iter().map(|(_, id)| id).collect()
    }

    /// Takes expired sessions out, to be told from unknown ones for a while.
    pub(crate) fn expire(&mut self, ended: &[SessionId]) {
        let now = Instant::now();
        for &id in ended {
            let Some(used) = self.sessions.get(&id).map(|entry| entry.used) else { continue };
            self.remove(id);
            self.remember(id, Grave { end: End::Expired, until: used + 2 * self.bounds.idle });
        }
        self.tombstones.retain(|_, grave| now < grave.until);
        let tombstones = &self.tombstones;
        self.graves_by_age.retain(|(id, grave)| tombstones.get(id) == Some(grave));
    }

    fn remember(&mut self, id: SessionId, grave: Grave) {
        self.tombstones.insert(id, grave);
        self.graves_by_age.push_back((id, grave));
        while self.graves_by_age.len() > self.bounds.sessions {
            if let Some((oldest, _)) = self.graves_by_age.pop_front() {
                self.tombstones.remove(&oldest);
            }
        }
    }

    /// A session of that owner names the file.
    pub(crate) fn names(&self, owner: Owner, digest: Digest) -> bool {
        let is_named = |entry: &Entry| entry.record.image == digest && entry.record.id.owner() == owner;
        self.files.contains_key(&digest) && self.sessions.values().any(is_named)
    }

    /// Sessions whose picture's file it is.
    pub(crate) fn named_by(&self, digest: Digest) -> Vec<SessionId> {
        self.sessions.iter().filter(|(_, entry)| entry.record.image == digest).map(|(id, _)| *id).collect()
    }

    /// Every record.
    #[cfg(test)]
    pub(crate) fn records(&self) -> impl Iterator<Item = Arc<Record>> + '_ {
        self.sessions.values().map(|entry| Arc::clone(&entry.record))
    }

    /// The highest number of every session that has one.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = (SessionId, u64)> + '_ {
        self.sessions.iter().filter_map(|(id, entry)| entry.seq.map(|seq| (*id, seq)))
    }

    /// Lives and numbers go on where `old` knows of the same sessions.
    pub(crate) fn go_on_from(&mut self, old: Self) {
        for (id, entry) in &mut self.sessions {
            if let Some(known) = old.sessions.get(id).filter(|known| known.record.created == entry.record.created) {
                (entry.used, entry.seq) = (known.used, entry.seq.max(known.seq));
            }
        }
        (self.tombstones, self.graves_by_age) = (old.tombstones, old.graves_by_age);
    }
}

/// What a record costs beside its picture's file.
#[must_use]
pub fn record_bytes(record: &Record) -> u64 {
    let places: usize = record.rest.p.iter().map(|h| 1 + h.places().len()).sum();
    512 + 32 * places as u64 + 8 * record.rest.weights.as_ref().map_or(0, Vec::len) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::suite;

    #[test]
    fn a_name_that_is_used_again_has_one_grave() {
        let idle = std::time::Duration::from_millis(50);
        let mut index = Index::new(Bounds { idle, sessions: 1, bytes: 1 << 20 });
        let record = suite::record(1);
        for _ in 0..3 {
            index.put(Arc::clone(&record), 1000, PutOutcome::Create);
            std::thread::sleep(idle);
            index.expire(&index.expired());
            assert_eq!((index.tombstones.len(), index.graves_by_age.len()), (1, 1));
        }
    }

    #[test]
    fn no_more_deleted_sessions_are_remembered_than_there_may_be_sessions() {
        let mut index = Index::new(Bounds { sessions: 3, ..suite::bounds() });
        let ids: Vec<SessionId> = (0..5)
            .map(|_| {
                let record = suite::record(1);
                index.put(Arc::clone(&record), 1000, PutOutcome::Create);
                index.delete(record.id);
                record.id
            })
            .collect();
        assert_eq!((index.tombstones.len(), index.graves_by_age.len(), index.bytes()), (3, 3, 0));
        let again: Vec<_> = ids.iter().map(|id| index.weigh_delete(*id)).collect();
        assert_eq!(again, [Err(StoreError::NoSuchSession), Err(StoreError::NoSuchSession), Ok(false), Ok(false), Ok(false)]);
    }
}
