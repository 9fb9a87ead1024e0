//! The sessions of one process: which are alive, what they take, when they expire. Shared by the
//! memory store and the file store.
//!
//! A full index refuses new sessions and never drops a living one. A change is checked first
//! (`check_*`), which changes nothing, and then applied, which cannot fail: in between a store
//! writes to its disk. Operations are a few map accesses; a sweep visits what has expired.

mod files;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use lru::LruCache;
use mlswarp::warp::Digest;

use super::{NamedFile, Put, Record, Session, StoreError, StoreLimits};
use crate::client::Owner;
use crate::session::{Revision, SessionId};
use files::IndexedFile;

/// The sessions of one process.
#[derive(Debug)]
pub(crate) struct Index {
    bounds: StoreLimits,
    /// The files' contents are kept here. Otherwise only their sizes are.
    keeps_contents: bool,
    /// In the order in which they were used: those that expire first are at the end.
    sessions: LruCache<SessionId, Entry>,
    /// The files of each owner.
    files: HashMap<(Owner, Digest), IndexedFile>,
    /// How many owners have each file.
    owners: HashMap<Digest, usize>,
    bytes: u64,
    /// Ended sessions, in the order in which they ended; at most as many as there may be sessions.
    tombstones: LruCache<SessionId, Tombstone>,
}

#[derive(Debug)]
struct Entry {
    /// `None`: another version of the program has written it. Such a session does not expire.
    record: Option<Arc<Record>>,
    /// The files that it names.
    files: Vec<Digest>,
    bytes: u64,
    seq: Option<u64>,
    used: Instant,
}

#[derive(Clone, Copy, Debug)]
struct Tombstone {
    end: End,
    until: Instant,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// Remembered for one idle period after it expired.
    Expired,
    /// Remembered for one idle period.
    Deleted,
}

/// What putting a record will do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PutOutcome {
    /// There is no such session.
    Create,
    /// The session was made from the same.
    Stay,
    /// The session was made from something else.
    Replace,
}

impl Index {
    pub(crate) fn new(bounds: StoreLimits, keeps_contents: bool) -> Self {
        let (files, owners) = Default::default();
        let (sessions, tombstones) = (LruCache::unbounded(), LruCache::unbounded());
        Self {
            bounds,
            keeps_contents,
            sessions,
            files,
            owners,
            bytes: 0,
            tombstones,
        }
    }

    /// The number of sessions, expired ones included that are not swept yet.
    pub(crate) fn len(&self) -> usize {
        self.sessions.len()
    }

    /// Bytes of files and records, each file once for each owner.
    pub(crate) const fn bytes(&self) -> u64 {
        self.bytes
    }

    fn left(&self, entry: &Entry) -> Duration {
        self.bounds.idle.saturating_sub(entry.used.elapsed())
    }

    fn session(&self, entry: &Entry, record: &Arc<Record>) -> Session {
        Session {
            record: Arc::clone(record),
            seq: entry.seq,
            expires: SystemTime::now() + self.left(entry),
        }
    }

    /// The living session, or why it does not exist.
    fn living(&self, id: SessionId) -> Result<(&Entry, &Arc<Record>), StoreError> {
        let until = match self.sessions.peek(&id) {
            Some(entry) => {
                let record = entry.record.as_ref().ok_or(StoreError::OtherVersion)?;
                if !self.left(entry).is_zero() {
                    return Ok((entry, record));
                }
                Some(entry.used + 2 * self.bounds.idle)
            }
            None => self
                .tombstones
                .peek(&id)
                .filter(|tombstone| tombstone.end == End::Expired)
                .map(|tombstone| tombstone.until),
        };
        if until.is_some_and(|until| Instant::now() < until) {
            Err(StoreError::Expired {
                idle: self.bounds.idle,
            })
        } else {
            Err(StoreError::NoSuchSession)
        }
    }

    pub(crate) fn peek(&self, id: SessionId) -> Result<Session, StoreError> {
        self.living(id)
            .map(|(entry, record)| self.session(entry, record))
    }

    pub(crate) fn touch(&mut self, id: SessionId, seq: Option<u64>) -> Result<Session, StoreError> {
        self.living(id)?;
        if let Some(entry) = self.sessions.get_mut(&id) {
            entry.used = Instant::now();
            entry.seq = entry.seq.max(seq);
        }
        self.peek(id)
    }

    /// What putting the record will do, if there is room for it.
    pub(crate) fn check_put(
        &self,
        record: &Record,
        files: &[NamedFile],
    ) -> Result<PutOutcome, StoreError> {
        let outcome = match self.living(record.id) {
            Ok((_, old)) if old.is_made_like(record) => return Ok(PutOutcome::Stay),
            Ok(_) => PutOutcome::Replace,
            Err(StoreError::OtherVersion) => return Err(StoreError::OtherVersion),
            Err(_) => PutOutcome::Create,
        };
        let old = self.sessions.peek(&record.id);
        let sessions = self.len() + usize::from(old.is_none());
        if sessions > self.bounds.sessions {
            return Err(StoreError::Full {
                what: "sessions",
                limit: self.bounds.sessions as u64,
                actual: sessions as u64,
            });
        }
        self.check_bytes(
            self.bytes - old.map_or(0, |old| old.bytes)
                + record_bytes(record)
                + self.added_bytes(record.id, files),
        )?;
        Ok(outcome)
    }

    fn check_bytes(&self, bytes: u64) -> Result<(), StoreError> {
        let limit = self.bounds.bytes;
        if bytes > limit {
            Err(StoreError::Full {
                what: "store_bytes",
                limit,
                actual: bytes,
            })
        } else {
            Ok(())
        }
    }

    /// Puts a record that has been checked.
    pub(crate) fn put(
        &mut self,
        record: Arc<Record>,
        files: &[NamedFile],
        outcome: PutOutcome,
    ) -> Put {
        if outcome == PutOutcome::Stay
            && let Ok(session) = self.touch(record.id, None)
        {
            return Put::Same(session);
        }
        // Before the old session is removed, which may name the same files.
        let owner = record.id.owner();
        files
            .iter()
            .for_each(|file| self.name_file(owner, file.digest, file.len(), &file.bytes));
        let old = self.insert(Arc::clone(&record), None);
        let expires = SystemTime::now() + self.bounds.idle;
        let session = Session {
            record,
            seq: None,
            expires,
        };
        match old {
            Some(old) if outcome == PutOutcome::Replace => Put::Replaced(session, old),
            _ => Put::Created(session),
        }
    }

    /// Inserts a record whose files have been named.
    fn insert(&mut self, record: Arc<Record>, seq: Option<u64>) -> Option<Arc<Record>> {
        let old = self.remove(record.id);
        self.tombstones.pop(&record.id);
        let bytes = record_bytes(&record);
        self.bytes += bytes;
        let (id, files) = (record.id, record.files().collect());
        self.sessions.put(
            id,
            Entry {
                record: Some(record),
                files,
                bytes,
                seq,
                used: Instant::now(),
            },
        );
        old
    }

    /// Adds a session of an earlier process; it lives for another idle period. `sizes`: those of
    /// its files, in the order of the record.
    pub(crate) fn restore(&mut self, record: Arc<Record>, sizes: &[u64], seq: Option<u64>) {
        for (digest, len) in record.files().zip(sizes) {
            self.name_file(record.id.owner(), digest, *len, &Bytes::new());
        }
        self.insert(record, seq);
    }

    /// Adds a session whose record, of `bytes` bytes, another version of the program has written,
    /// and the files that it names.
    pub(crate) fn restore_unread(&mut self, id: SessionId, bytes: u64, files: &[(Digest, u64)]) {
        for (digest, len) in files {
            self.name_file(id.owner(), *digest, *len, &Bytes::new());
        }
        self.bytes += bytes;
        let files = files.iter().map(|(digest, _)| *digest).collect();
        self.sessions.put(
            id,
            Entry {
                record: None,
                files,
                bytes,
                seq: None,
                used: Instant::now(),
            },
        );
    }

    /// Whether the record may replace that revision. `false`: another revision is there.
    pub(crate) fn check_revise(
        &self,
        old: Revision,
        new: &Record,
        layer: &[NamedFile],
    ) -> Result<bool, StoreError> {
        let (entry, record) = self.living(new.id)?;
        if record.revision != old {
            return Ok(false);
        }
        self.check_bytes(
            self.bytes - entry.bytes + record_bytes(new) + self.added_bytes(new.id, layer),
        )
        .map(|()| true)
    }

    /// Replaces a record after the change has been checked. `layer`: the file that only the new one
    /// names.
    pub(crate) fn revise(&mut self, new: Arc<Record>, layer: &[NamedFile]) -> Option<Session> {
        for digest in new.files() {
            let added = layer.iter().find(|file| file.digest == digest);
            let content = added.map_or_else(Bytes::new, |file| file.bytes.clone());
            self.name_file(new.id.owner(), digest, content.len() as u64, &content);
        }
        let (id, bytes, files) = (new.id, record_bytes(&new), new.files().collect());
        let entry = self.sessions.get_mut(&id)?;
        self.bytes = self.bytes - entry.bytes + bytes;
        (entry.record, entry.bytes, entry.used) = (Some(new), bytes, Instant::now());
        let old = std::mem::replace(&mut entry.files, files);
        old.into_iter()
            .for_each(|digest| self.unname_file(id.owner(), digest));
        self.peek(id).ok()
    }

    /// Whether a delete removes something. `false`: the session was deleted less than one idle
    /// period ago.
    pub(crate) fn check_delete(&self, id: SessionId) -> Result<bool, StoreError> {
        match self.living(id) {
            Ok(_) | Err(StoreError::OtherVersion) => Ok(true),
            Err(StoreError::NoSuchSession) if self.was_deleted(id) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Whether the session was deleted less than one idle period ago. One that is stored again has
    /// no tombstone.
    pub(crate) fn was_deleted(&self, id: SessionId) -> bool {
        self.tombstones.peek(&id).is_some_and(|tombstone| {
            tombstone.end == End::Deleted && Instant::now() < tombstone.until
        })
    }

    /// Removes a session that its owner has deleted.
    pub(crate) fn delete(&mut self, id: SessionId) {
        self.remove(id);
        self.add_tombstone(
            id,
            Tombstone {
                end: End::Deleted,
                until: Instant::now() + self.bounds.idle,
            },
        );
    }

    /// Removes a session without a trace.
    pub(crate) fn remove(&mut self, id: SessionId) -> Option<Arc<Record>> {
        let entry = self.sessions.pop(&id)?;
        self.bytes -= entry.bytes;
        entry
            .files
            .into_iter()
            .for_each(|digest| self.unname_file(id.owner(), digest));
        entry.record
    }

    /// Sessions that have expired and are not swept yet, at most `most`, the oldest first.
    pub(crate) fn expired(&self, most: usize) -> Vec<SessionId> {
        let oldest = self.sessions.iter().rev();
        // Those of another version do not expire.
        let can_expire = oldest.filter(|(_, entry)| entry.record.is_some());
        let expired = can_expire.take_while(|(_, entry)| self.left(entry).is_zero());
        expired.take(most).map(|(id, _)| *id).collect()
    }

    /// Removes expired sessions, and the first tombstones, as far as their time is over: one that
    /// stays behind a later one says nothing any more.
    pub(crate) fn expire(&mut self, expired: &[SessionId]) {
        for id in expired {
            let Some(used) = self.sessions.peek(id).map(|entry| entry.used) else {
                continue;
            };
            self.remove(*id);
            self.add_tombstone(
                *id,
                Tombstone {
                    end: End::Expired,
                    until: used + 2 * self.bounds.idle,
                },
            );
        }
        let now = Instant::now();
        let is_over = |(_, tombstone): (&SessionId, &Tombstone)| tombstone.until <= now;
        while self.tombstones.peek_lru().is_some_and(is_over) {
            self.tombstones.pop_lru();
        }
    }

    fn add_tombstone(&mut self, id: SessionId, tombstone: Tombstone) {
        self.tombstones.put(id, tombstone);
        while self.tombstones.len() > self.bounds.sessions {
            self.tombstones.pop_lru();
        }
    }

    /// The records that can be read.
    pub(crate) fn records(&self) -> impl Iterator<Item = &Arc<Record>> {
        self.sessions
            .iter()
            .filter_map(|(_, entry)| entry.record.as_ref())
    }

    /// The highest number of every session that has one.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = (SessionId, u64)> + '_ {
        self.sessions
            .iter()
            .filter_map(|(id, entry)| entry.seq.map(|seq| (*id, seq)))
    }

    /// Keeps the expiry, the numbers and the tombstones of `old` after the sessions have been read
    /// again.
    pub(crate) fn carry_over(&mut self, old: Self) {
        let created = |entry: &Entry| entry.record.as_ref().map(|record| record.created);
        for (id, entry) in &mut self.sessions {
            if let Some(old) = old
                .sessions
                .peek(id)
                .filter(|old| created(old) == created(entry))
            {
                (entry.used, entry.seq) = (old.used, entry.seq.max(old.seq));
            }
        }
        let used = self.sessions.iter().map(|(id, entry)| (entry.used, *id));
        let mut used: Vec<(Instant, SessionId)> = used.collect();
        used.sort_unstable();
        for (_, id) in used {
            self.sessions.promote(&id);
        }
        self.tombstones = old.tombstones;
    }
}

/// The bytes that a record counts for, beside its files.
pub fn record_bytes(record: &Record) -> u64 {
    let posed = record.pose.iter().flat_map(|pose| &pose.q);
    let places: usize = record
        .rest
        .p
        .iter()
        .chain(posed)
        .map(|h| 1 + h.places().len())
        .sum();
    512 + 32 * places as u64
        + 8 * record.rest.weights.as_ref().map_or(0, Vec::len) as u64
        + 256 * record.layers.len() as u64
}
