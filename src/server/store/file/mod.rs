//! Sessions in one file of this machine: a session that was answered is there after the process was killed or the power went. Records, numbers and
//! pictures live in an embedded transactional database (`disk.rs`); every change of a session is one transaction that has reached the disk before it is
//! answered, and goes on to its end whoever waits for it. What sessions there are is also held in memory, so that looking and using take no disk.
//!
//! A session that was there lives for another idle period after a start. Numbers (`seq`) and ends of idle sessions are written by the next sweep, and
//! numbers when the store is closed: after a crash they may be those of some seconds before. One process opens the file; a second one is told so.
//!
//! When the disk fails or is full, the change is refused, the database is closed, and the next change opens it again; meanwhile looking and using go on.

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
use super::{Answer, Bounds, Figures, NotOpened, Put, Record, Session, Store, StoreError};
use crate::client::Owner;
use crate::observe::Scope;
use crate::session::{Revision, SessionId};
use disk::{Change, Disk, Opened};

/// Longest wait of those who ask whether the store is there.
const READINESS: Duration = Duration::from_secs(1);

/// A store in a file. Cloning shares it.
#[derive(Clone)]
pub struct FileStore(Arc<FileStoreState>);

struct FileStoreState {
    bounds: Bounds,
    index: Mutex<Index>,
    /// Numbers as they are on the disk. Held from the decision until the index knows of it: one change at a time.
    writing: Mutex<HashMap<SessionId, u64>>,
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
    /// Opens the file, or makes it. Records that are damaged are named in the log and left out.
    ///
    /// # Errors
    /// The file cannot be opened, is none of ours, is damaged beyond reading, or is another process's.
    pub fn open(path: &Path, bounds: Bounds) -> Result<Self, NotOpened> {
        let store = Self::on(Disk::open(path)?, bounds)?;
        let Figures { sessions, bytes, damaged, .. } = store.figures();
        store.0.disk.compact(bytes)?;
        tracing::info!(sessions, bytes, damaged, "the session file is open");
        Ok(store)
    }

    fn on(disk: Disk, bounds: Bounds) -> Result<Self, NotOpened> {
        let not_opened = disk.not_opened("it cannot be read; the log has more");
        let shared = FileStoreState {
            bounds,
            index: Mutex::new(Index::new(bounds)),
            writing: Mutex::default(),
            disk,
            damaged: AtomicU64::new(0),
            other_version: AtomicU64::new(0),
        };
        shared.read_all(&mut shared.writing()).map_err(|_| not_opened)?;
        Ok(Self(Arc::new(shared)))
    }

    /// A store on a disk that is none.
    #[cfg(test)]
    fn over(disk: impl redb::StorageBackend, bounds: Bounds) -> Result<Self, NotOpened> {
        Self::on(Disk::over(disk)?, bounds)
    }

    /// Off the async threads, and to its end whoever waits for it.
    fn blocking<T: Send + 'static>(&self, work: impl FnOnce(&FileStoreState) -> Result<T, StoreError> + Send + 'static) -> Answer<'_, T> {
        let shared = Arc::clone(&self.0);
        let scope = Scope::current();
        let task = tokio::task::spawn_blocking(move || scope.enter(|| work(&shared)));
        Box::pin(async move { task.await.unwrap_or(Err(StoreError::Away)) })
    }
}

impl FileStoreState {
    fn index(&self) -> MutexGuard<'_, Index> {
        // No operation leaves the index half-changed where it could panic.
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn writing(&self) -> MutexGuard<'_, HashMap<SessionId, u64>> {
        self.writing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The right to change; the database is open.
    fn begin(&self) -> Result<MutexGuard<'_, HashMap<SessionId, u64>>, StoreError> {
        let mut written = self.writing();
        if self.disk.revive()? == Opened::Again {
            // A change that failed may be there or not: the disk says.
            self.read_all(&mut written)?;
        }
        Ok(written)
    }

    /// Reads the index from the disk. What is damaged is named and left where it is, and so is what another version of the program has written, with
    /// the files that it names; files that no session names are taken away.
    fn read_all(&self, written: &mut HashMap<SessionId, u64>) -> Result<(), StoreError> {
        let mut index = Index::new(self.bounds);
        written.clear();
        let (damaged, other_version) = self.disk.change(|change| {
            let (mut damaged, mut other_version) = (0, 0);
            let mut files: HashMap<Digest, Result<u64, &str>> = HashMap::new();
            let mut whole = |change: &Change<'_>, digest: Digest| -> Result<Result<u64, &str>, redb::Error> {
                Ok(match files.get(&digest) {
                    Some(file) => *file,
                    None => *files.entry(digest).or_insert(checked(&change.file(digest)?, digest)),
                })
            };
            for entry in change.records.iter()? {
                let (name, bytes) = entry?;
                let id = SessionId::from_bytes(&name.value());
                let (record, file) = match record::read(bytes.value()) {
                    Ok(record) => {
                        let file = whole(change, record.image)?;
                        let file = if record.id == id { file } else { Err("its record is another session's") };
                        (Some(record), file.map_err(str::to_owned))
                    }
                    Err(Unreadable::OtherVersion(why)) => {
                        other_version += 1;
                        tracing::warn!(session = ?id, why, "a session is kept and not served: another version of the program has stored it");
                        let mut named = Vec::new();
                        for digest in record::named_files(bytes.value()) {
                            named.extend(whole(change, digest)?.ok().map(|len| (digest, len)));
                        }
                        index.restore_unread(id, bytes.value().len() as u64, &named);
                        continue;
                    }
                    Err(why) => (None, Err(why.to_string())),
                };
                match (record, file) {
                    (Some(record), Ok(file)) => {
                        let number = change.numbers.get(&name.value())?.map(|number| number.value());
                        written.extend(number.map(|number| (id, number)));
                        index.restore(record, file, number);
                    }
                    (_, why) => {
                        damaged += 1;
                        let why = why.err().unwrap_or_default();
                        tracing::error!(session = ?id, why, "a session is left out: what is stored of it is damaged");
                    }
                }
            }
            let unnamed: Vec<Digest> = change.files()?.into_iter().filter(|digest| !files.contains_key(digest)).collect();
            for digest in unnamed {
                change.remove_file(digest)?;
            }
            Ok((damaged, other_version))
        })?;
        self.damaged.fetch_add(damaged, Ordering::Relaxed);
        self.other_version.fetch_add(other_version, Ordering::Relaxed);
        let mut known = self.index();
        let old = std::mem::replace(&mut *known, index);
        known.go_on_from(old);
        Ok(())
    }

    fn put(&self, record: Arc<Record>, file: &Bytes) -> Result<Put, StoreError> {
        let mut written = self.begin()?;
        let len = file.len() as u64;
        let full = self.index().weigh(&record, len).is_err();
        if full {
            self.sweep(&mut written)?;
        }
        let (will, has, freed) = {
            let index = self.index();
            // What another owner has is written again: a faster answer would tell of it.
            let has = index.names(record.id.owner(), record.image);
            (index.weigh(&record, len)?, has, index.freed(&[record.id], Some(record.image)))
        };
        if will != PutOutcome::Stay {
            let (name, bytes) = (record.id.to_bytes(), record::write(&record));
            self.disk.change(|change| {
                change.records.insert(&name, bytes.as_slice())?;
                change.numbers.remove(&name)?;
                if !has {
                    // There may be pieces of a damaged one.
                    change.remove_file(record.image)?;
                    change.add_file(record.image, file)?;
                }
                free(change, &freed)
            })?;
            written.remove(&record.id);
        }
        Ok(self.index().put(record, len, will))
    }

    fn revise(&self, old: Revision, new: Arc<Record>) -> Result<Option<Session>, StoreError> {
        let _one = self.begin()?;
        if !self.index().weigh_revision(old, &new)? {
            return Ok(None);
        }
        let (name, bytes) = (new.id.to_bytes(), record::write(&new));
        self.disk.change(|change| Ok(change.records.insert(&name, bytes.as_slice()).map(drop)?))?;
        Ok(self.index().revise(new))
    }

    fn delete(&self, id: SessionId) -> Result<(), StoreError> {
        let mut written = self.begin()?;
        if !self.index().weigh_delete(id)? {
            return Ok(());
        }
        self.take_away(&[id])?;
        written.remove(&id);
        self.index().delete(id);
        Ok(())
    }

    /// From the disk first: a session whose end was answered is not there after a crash.
    fn take_away(&self, gone: &[SessionId]) -> Result<(), StoreError> {
        let freed = self.index().freed(gone, None);
        self.disk.change(|change| {
            for id in gone {
                change.records.remove(&id.to_bytes())?;
                change.numbers.remove(&id.to_bytes())?;
            }
            free(change, &freed)
        })
    }

    /// Buries what has expired, and writes numbers that are not on the disk.
    fn sweep(&self, written: &mut HashMap<SessionId, u64>) -> Result<usize, StoreError> {
        let ended = self.index().expired();
        if !ended.is_empty() {
            self.take_away(&ended)?;
        }
        // Also when nothing has ended: graves are forgotten here.
        self.index().expire(&ended);
        for id in &ended {
            written.remove(id);
        }
        self.write_numbers(written)?;
        Ok(ended.len())
    }

    fn write_numbers(&self, written: &mut HashMap<SessionId, u64>) -> Result<(), StoreError> {
        let newer: Vec<(SessionId, u64)> = self.index().numbers().filter(|(id, number)| written.get(id) != Some(number)).collect();
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

    fn file(&self, digest: Digest) -> Result<Bytes, StoreError> {
        if let Some(whole) = self.whole(digest)? {
            return Ok(whole);
        }
        let mut written = self.begin()?;
        // It may have gone in good order meanwhile, and come again: what nobody can change now is certain.
        if let Some(whole) = self.whole(digest)? {
            return Ok(whole);
        }
        let lost = self.index().named_by(digest);
        tracing::error!(sessions = ?lost, "sessions have ended: their picture's file is damaged");
        self.take_away(&lost)?;
        for id in lost {
            self.damaged.fetch_add(1, Ordering::Relaxed);
            written.remove(&id);
            self.index().remove(id);
        }
        self.index().lose_file(digest);
        Err(StoreError::NoSuchSession)
    }

    /// The file that some session names, if it is read as it was written.
    fn whole(&self, digest: Digest) -> Result<Option<Bytes>, StoreError> {
        let len = self.index().file(digest).ok_or(StoreError::NoSuchSession)?;
        let bytes = self.disk.file(digest, len)?;
        Ok((checked(&bytes, digest) == Ok(len)).then(|| bytes.into()))
    }
}

impl Drop for FileStoreState {
    fn drop(&mut self) {
        let written = std::mem::take(&mut *self.writing());
        if let Err(error) = self.write_numbers(&mut { written }) {
            tracing::warn!(%error, "the sessions' last numbers were not written");
        }
    }
}

/// How long the file is, if it is the one of that digest.
fn checked(file: &[u8], digest: Digest) -> Result<u64, &'static str> {
    match file.len() {
        0 => Err("its picture's file is not there"),
        len if Digest::of(file) == digest => Ok(len as u64),
        _ => Err("its picture's file is damaged"),
    }
}

fn free(change: &mut Change<'_>, files: &[(Digest, u64)]) -> Result<(), redb::Error> {
    files.iter().try_for_each(|(digest, _)| change.remove_file(*digest))
}

fn ready<'a, T: Send + 'a>(answer: Result<T, StoreError>) -> Answer<'a, T> {
    Box::pin(std::future::ready(answer))
}

impl Store for FileStore {
    fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put> {
        self.blocking(move |shared| shared.put(record, &image))
    }

    fn revise(&self, old: Revision, new: Arc<Record>) -> Answer<'_, Option<Session>> {
        self.blocking(move |shared| shared.revise(old, new))
    }

    fn peek(&self, id: SessionId) -> Answer<'_, Session> {
        ready(self.0.index().peek(id))
    }

    fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session> {
        ready(self.0.index().touch(id, seq))
    }

    fn delete(&self, id: SessionId) -> Answer<'_, ()> {
        self.blocking(move |shared| shared.delete(id))
    }

    fn image_bytes(&self, _: SessionId, digest: Digest) -> Answer<'_, u64> {
        ready(self.0.index().file(digest).ok_or(StoreError::NoSuchSession))
    }

    fn image(&self, _: SessionId, digest: Digest) -> Answer<'_, Bytes> {
        self.blocking(move |shared| shared.file(digest))
    }

    fn names(&self, owner: Owner, digest: Digest) -> bool {
        self.0.index().names(owner, digest)
    }

    fn sweep(&self) -> Answer<'_, usize> {
        self.blocking(|shared| {
            let mut written = shared.begin()?;
            shared.sweep(&mut written)
        })
    }

    fn ready(&self) -> Answer<'_, ()> {
        if self.0.disk.is_open() {
            return ready(Ok(()));
        }
        let opened = self.blocking(|shared| shared.begin().map(drop));
        Box::pin(async { tokio::time::timeout(READINESS, opened).await.unwrap_or(Err(StoreError::Away)) })
    }

    fn figures(&self) -> Figures {
        let index = self.0.index();
        Figures {
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
