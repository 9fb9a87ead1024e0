//! The store in a file of this machine: an embedded transactional database (`disk.rs`) with
//! records, numbers and files.
//!
//! A change is one transaction that has reached the disk before it is answered; it is finished even
//! if its request is dropped. An index in memory answers everything that changes no record. After a
//! start every session lives for another idle period. The highest numbers (`seq`) and the end of
//! expired sessions are written by the next sweep, numbers also when the store is closed: after a
//! crash they may be some seconds old. One process opens the file. After a disk error the change is
//! refused and the database closed; the next change opens it again, and until then reads go on.

mod backend;
mod disk;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use mlswarp::warp::Digest;
use redb::ReadableTable as _;

use super::index::{Index, PutOutcome};
use super::record;
use super::record::Unreadable;
use super::{
    NamedFile, NotOpened, Put, Record, Session, Store, StoreError, StoreFuture, StoreLimits,
    StoreStats, ready,
};
use crate::client::Owner;
use crate::observe::Scope;
use crate::session::{Revision, SessionId};
use disk::{Change, Disk};

/// Longest wait of a `ready` for a database that is opened again.
const READY_TIMEOUT: Duration = Duration::from_secs(1);

/// The highest numbers as they are on the disk.
type Numbers = HashMap<SessionId, u64>;

/// A store in a file. Cloning shares it.
#[derive(Clone)]
pub struct FileStore(Arc<FileStoreState>);

struct FileStoreState {
    bounds: StoreLimits,
    index: Mutex<Index>,
    /// Locked from the check of a change until the index has it: one change at a time.
    written: Mutex<Numbers>,
    disk: Disk,
    damaged: AtomicU64,
    other_version: AtomicU64,
}

impl fmt::Debug for FileStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FileStore").finish_non_exhaustive()
    }
}

impl FileStore {
    /// Opens the file, or creates it. Damaged records are logged and left out. Errors: The file
    /// cannot be opened, is not a session file, is damaged beyond reading, or is open in another
    /// process.
    pub fn open(path: &Path, bounds: StoreLimits) -> Result<Self, NotOpened> {
        let store = Self::on(Disk::open(path)?, bounds)?;
        let StoreStats {
            sessions,
            bytes,
            damaged,
            ..
        } = store.figures();
        store.0.disk.compact(bytes)?;
        tracing::info!(sessions, bytes, damaged, "the session file is open");
        Ok(store)
    }

    fn on(disk: Disk, bounds: StoreLimits) -> Result<Self, NotOpened> {
        let not_opened = disk.not_opened("it cannot be read; the log has more");
        let state = FileStoreState {
            bounds,
            index: Mutex::new(Index::new(bounds, false)),
            written: Mutex::default(),
            disk,
            damaged: AtomicU64::new(0),
            other_version: AtomicU64::new(0),
        };
        state
            .read_all(&mut state.written())
            .map_err(|_| not_opened)?;
        Ok(Self(Arc::new(state)))
    }

    #[cfg(test)]
    fn over(disk: impl redb::StorageBackend, bounds: StoreLimits) -> Result<Self, NotOpened> {
        Self::on(Disk::over(disk)?, bounds)
    }

    /// Runs on a blocking thread, to its end even if the answer is dropped.
    fn blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce(&FileStoreState) -> Result<T, StoreError> + Send + 'static,
    ) -> StoreFuture<'_, T> {
        let (state, scope) = (Arc::clone(&self.0), Scope::current());
        let task = tokio::task::spawn_blocking(move || scope.enter(|| work(&state)));
        Box::pin(async move { task.await.unwrap_or(Err(StoreError::Away)) })
    }
}

/// The files that records name: the size of each, or what is wrong with it.
type Files = HashMap<Digest, Result<u64, &'static str>>;

impl FileStoreState {
    fn index(&self) -> MutexGuard<'_, Index> {
        // No operation leaves the index half-changed where it could panic.
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn written(&self) -> MutexGuard<'_, Numbers> {
        self.written.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a change: the database is open and no other change is under way.
    fn begin(&self) -> Result<MutexGuard<'_, Numbers>, StoreError> {
        let mut written = self.written();
        if self.disk.reopen()? {
            // The change that failed may be on the disk or not.
            self.read_all(&mut written)?;
        }
        Ok(written)
    }

    /// Builds the index from the disk and deletes files that no session names. Damaged records are
    /// left where they are; records of another version, and the files that they name, are kept.
    fn read_all(&self, written: &mut Numbers) -> Result<(), StoreError> {
        let mut index = Index::new(self.bounds, false);
        written.clear();
        self.disk.change(|change| {
            let mut files = Files::new();
            for entry in change.records.iter()? {
                let (name, bytes) = entry?;
                let id = SessionId::from_bytes(&name.value());
                let why = match record::read(bytes.value()) {
                    Ok(record) => {
                        match (checked_files(change, &mut files, &record)?, record.id == id) {
                            (Ok(sizes), true) => {
                                let number = change
                                    .numbers
                                    .get(&name.value())?
                                    .map(|number| number.value());
                                written.extend(number.map(|number| (id, number)));
                                index.restore(record, &sizes, number);
                                continue;
                            }
                            (Ok(_), false) => "its record is another session's",
                            (Err(why), _) => why,
                        }
                    }
                    Err(Unreadable::OtherVersion(why)) => {
                        self.other_version.fetch_add(1, Ordering::Relaxed);
                        tracing::warn!(session = ?id, why, "a session is kept and not served: \
                            another version of the program has stored it");
                        let mut named = Vec::new();
                        for digest in record::named_files(bytes.value()) {
                            named.extend(
                                checked_file(change, &mut files, digest)?
                                    .ok()
                                    .map(|len| (digest, len)),
                            );
                        }
                        index.restore_unread(id, bytes.value().len() as u64, &named);
                        continue;
                    }
                    Err(Unreadable::Damaged(why)) => why,
                };
                self.damaged.fetch_add(1, Ordering::Relaxed);
                tracing::error!(session = ?id, why, "a damaged session record is left out");
            }
            for digest in change
                .files()?
                .iter()
                .filter(|digest| !files.contains_key(digest))
            {
                change.remove_file(*digest)?;
            }
            Ok(())
        })?;
        let mut current = self.index();
        let old = std::mem::replace(&mut *current, index);
        current.carry_over(old);
        Ok(())
    }

    fn put(&self, record: Arc<Record>, files: &[NamedFile]) -> Result<Put, StoreError> {
        let mut written = self.begin()?;
        let is_full = self.index().check_put(&record, files).is_err();
        if is_full {
            self.sweep(&mut written)?;
        }
        let outcome = self.index().check_put(&record, files)?;
        if outcome != PutOutcome::Stay {
            self.write_record(&record, files, |change| {
                Ok(change.numbers.remove(&record.id.to_bytes()).map(drop)?)
            })?;
            written.remove(&record.id);
        }
        Ok(self.index().put(record, files, outcome))
    }

    fn revise(
        &self,
        old: Revision,
        new: Arc<Record>,
        layer: &[NamedFile],
    ) -> Result<Option<Session>, StoreError> {
        let _written = self.begin()?;
        if !self.index().check_revise(old, &new, layer)? {
            return Ok(None);
        }
        self.write_record(&new, layer, |_| Ok(()))?;
        Ok(self.index().revise(new, layer))
    }

    /// Writes a record and its new files, and removes those that no record names any more, in one
    /// transaction with `more`.
    fn write_record(
        &self,
        record: &Record,
        files: &[NamedFile],
        more: impl FnOnce(&mut Change<'_>) -> Result<(), redb::Error>,
    ) -> Result<(), StoreError> {
        let (name, bytes, kept) = (
            record.id.to_bytes(),
            record::write(record),
            record.files().collect::<Vec<_>>(),
        );
        let (added, freed) = {
            let index = self.index();
            // A file that only another owner has is written again: a faster answer would reveal it.
            let is_new = |file: &&NamedFile| !index.names(record.id.owner(), file.digest);
            (
                files.iter().filter(is_new).collect::<Vec<_>>(),
                index.freed(&[record.id], &kept),
            )
        };
        self.disk.change(|change| {
            change.records.insert(&name, bytes.as_slice())?;
            for file in added {
                // Pieces of a damaged file may be there.
                change.remove_file(file.digest)?;
                change.add_file(file.digest, &file.bytes)?;
            }
            change.remove_files(&freed)?;
            more(change)
        })
    }

    fn delete(&self, id: SessionId) -> Result<(), StoreError> {
        let mut written = self.begin()?;
        if self.index().check_delete(id)? {
            self.remove(&[id], &mut written)?;
            self.index().delete(id);
        }
        Ok(())
    }

    /// Removes sessions from the disk. The index follows: a session whose end was answered must not
    /// come back after a crash.
    fn remove(&self, ids: &[SessionId], written: &mut Numbers) -> Result<(), StoreError> {
        let freed = self.index().freed(ids, &[]);
        self.disk.change(|change| {
            for id in ids {
                change.records.remove(&id.to_bytes())?;
                change.numbers.remove(&id.to_bytes())?;
            }
            change.remove_files(&freed)
        })?;
        for id in ids {
            written.remove(id);
        }
        Ok(())
    }

    /// Removes what has expired, and writes new numbers.
    fn sweep(&self, written: &mut Numbers) -> Result<usize, StoreError> {
        let expired = self.index().expired(usize::MAX);
        if !expired.is_empty() {
            self.remove(&expired, written)?;
        }
        // Also when nothing has expired: old tombstones are removed here.
        self.index().expire(&expired);
        self.write_numbers(written)?;
        Ok(expired.len())
    }

    fn write_numbers(&self, written: &mut Numbers) -> Result<(), StoreError> {
        let newer: Vec<(SessionId, u64)> = self
            .index()
            .numbers()
            .filter(|(id, number)| written.get(id) != Some(number))
            .collect();
        if newer.is_empty() {
            return Ok(());
        }
        self.disk.change(|change| {
            for (id, number) in &newer {
                change.numbers.insert(&id.to_bytes(), number)?;
            }
            Ok(())
        })?;
        written.extend(newer);
        Ok(())
    }

    /// Reads a file. A damaged one ends the sessions that name it.
    fn file(&self, owner: Owner, digest: Digest) -> Result<Bytes, StoreError> {
        if let Some(file) = self.undamaged(owner, digest)? {
            return Ok(file);
        }
        let mut written = self.begin()?;
        // Between the read and the lock the file may have been removed and stored again.
        if let Some(file) = self.undamaged(owner, digest)? {
            return Ok(file);
        }
        let names = |record: &&Arc<Record>| record.files().any(|file| file == digest);
        let lost: Vec<SessionId> = self
            .index()
            .records()
            .filter(names)
            .map(|record| record.id)
            .collect();
        tracing::error!(sessions = ?lost, "sessions have ended: the file of their picture or of a \
            layer is damaged");
        self.remove(&lost, &mut written)?;
        self.damaged.fetch_add(lost.len() as u64, Ordering::Relaxed);
        let mut index = self.index();
        for id in lost {
            index.remove(id);
        }
        index.lose_file(digest);
        Err(StoreError::NoSuchSession)
    }

    /// The file of a living session, unless it is damaged.
    fn undamaged(&self, owner: Owner, digest: Digest) -> Result<Option<Bytes>, StoreError> {
        let len = self
            .index()
            .file_bytes(owner, digest)
            .ok_or(StoreError::NoSuchSession)?;
        let bytes = self.disk.file(digest, len)?;
        Ok((check_file(&bytes, digest) == Ok(len)).then(|| bytes.into()))
    }
}

impl Drop for FileStoreState {
    fn drop(&mut self) {
        let mut written = std::mem::take(&mut *self.written());
        if let Err(error) = self.write_numbers(&mut written) {
            tracing::warn!(%error, "the sessions' last numbers were not written");
        }
    }
}

/// The size of a file, if it has that digest.
fn check_file(file: &[u8], digest: Digest) -> Result<u64, &'static str> {
    match file.len() {
        0 => Err("a file of its picture or layers is not there"),
        len if Digest::of(file) == digest => Ok(len as u64),
        _ => Err("a file of its picture or layers is damaged"),
    }
}

/// As [`check_file`], once for each file.
fn checked_file(
    change: &Change<'_>,
    files: &mut Files,
    digest: Digest,
) -> Result<Result<u64, &'static str>, redb::Error> {
    Ok(match files.get(&digest) {
        Some(file) => *file,
        None => *files
            .entry(digest)
            .or_insert(check_file(&change.file(digest)?, digest)),
    })
}

/// The sizes of a record's files in their order, or what is wrong with one of them.
fn checked_files(
    change: &Change<'_>,
    files: &mut Files,
    record: &Record,
) -> Result<Result<Vec<u64>, &'static str>, redb::Error> {
    record
        .files()
        .map(|digest| checked_file(change, files, digest))
        .collect()
}

impl Store for FileStore {
    fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> StoreFuture<'_, Put> {
        self.blocking(move |state| state.put(record, &files))
    }

    fn revise(
        &self,
        old: Revision,
        new: Arc<Record>,
        layer: Option<NamedFile>,
    ) -> StoreFuture<'_, Option<Session>> {
        self.blocking(move |state| state.revise(old, new, layer.as_slice()))
    }

    fn peek(&self, id: SessionId) -> StoreFuture<'_, Session> {
        ready(self.0.index().peek(id))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> StoreFuture<'_, Session> {
        ready(self.0.index().touch(id, seq))
    }

    fn delete(&self, id: SessionId) -> StoreFuture<'_, ()> {
        self.blocking(move |state| state.delete(id))
    }

    fn was_deleted(&self, id: SessionId) -> StoreFuture<'_, bool> {
        ready(Ok(self.0.index().was_deleted(id)))
    }

    fn file_bytes(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, u64> {
        ready(
            self.0
                .index()
                .file_bytes(id.owner(), digest)
                .ok_or(StoreError::NoSuchSession),
        )
    }

    fn file(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, Bytes> {
        self.blocking(move |state| state.file(id.owner(), digest))
    }

    fn local_record(&self, id: SessionId) -> Option<Arc<Record>> {
        self.0.index().peek(id).ok().map(|session| session.record)
    }

    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.0.index().names(owner, digest)
    }

    fn sweep(&self) -> StoreFuture<'_, usize> {
        self.blocking(|state| {
            let mut written = state.begin()?;
            state.sweep(&mut written)
        })
    }

    fn ready(&self) -> StoreFuture<'_, ()> {
        if self.0.disk.is_open() {
            return ready(Ok(()));
        }
        let opened = self.blocking(|state| state.begin().map(drop));
        Box::pin(async {
            tokio::time::timeout(READY_TIMEOUT, opened)
                .await
                .unwrap_or(Err(StoreError::Away))
        })
    }

    fn figures(&self) -> StoreStats {
        let index = self.0.index();
        StoreStats {
            sessions: index.len() as u64,
            bytes: index.bytes(),
            damaged: self.0.damaged.load(Ordering::Relaxed),
            other_version: self.0.other_version.load(Ordering::Relaxed),
            failures: self.0.disk.failures(),
            is_away: !self.0.disk.is_open(),
            is_unknown: false,
        }
    }
}
