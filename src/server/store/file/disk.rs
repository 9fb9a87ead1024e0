//! The database under the file store: made, opened, changed, read, and opened again after the disk has failed. No session is known here but by
//! its name's bytes.
//!
//! Every change is one transaction in two phases (data, then the switch to it; each waits for the disk), which also keeps the allocator's state: what is
//! committed needs no look at the rest of the file after a crash, and a start takes no longer for one.
//!
//! A picture's file is cut into pieces that fill their pages; whole, each would take the next power of two.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _};
use std::ops::{Deref, DerefMut};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use mlswarp::warp::Digest;
use redb::{Database, DatabaseError, ReadableDatabase as _, ReadableTable, Table, TableDefinition, TableHandle as _, WriteTransaction};

use crate::store::{NotOpened, StoreError};

/// A session's name to its record.
const RECORDS: TableDefinition<'static, [u8; 32], &[u8]> = TableDefinition::new("records");
/// A session's name to the highest number seen.
const NUMBERS: TableDefinition<'static, [u8; 32], u64> = TableDefinition::new("numbers");
/// Digest and place in the file to a piece of it.
const PIECES: TableDefinition<'static, ([u8; 32], u32), &[u8]> = TableDefinition::new("pieces");
/// Bytes of a piece: with its key and its page's head it fills a page of 64 KiB.
pub(crate) const PIECE: usize = (64 << 10) - 128;
/// Memory that the database may take for pages, bytes.
const PAGES: usize = 16 << 20;
/// What every database begins with.
const MAGIC: &[u8; 4] = b"redb";
/// Pause between two attempts to open a database that has failed.
const PAUSE: Duration = Duration::from_secs(1);
/// A file is made compact when it is larger than twice what is in it and this.
pub(crate) const SLACK: u64 = 16 << 20;

/// What stores and tests see of a change.
pub(crate) struct Change<'t> {
    pub(crate) records: Table<'t, [u8; 32], &'static [u8]>,
    pub(crate) numbers: Table<'t, [u8; 32], u64>,
    pieces: Table<'t, ([u8; 32], u32), &'static [u8]>,
}

impl<'t> Change<'t> {
    fn of(transaction: &'t WriteTransaction) -> Result<Self, redb::Error> {
        Ok(Self {
            records: transaction.open_table(RECORDS)?,
            numbers: transaction.open_table(NUMBERS)?,
            pieces: transaction.open_table(PIECES)?,
        })
    }

    pub(crate) fn add_file(&mut self, digest: Digest, bytes: &[u8]) -> Result<(), redb::Error> {
        for (place, piece) in (0..).zip(bytes.chunks(PIECE)) {
            self.pieces.insert((digest.0, place), piece)?;
        }
        Ok(())
    }

    pub(crate) fn remove_file(&mut self, digest: Digest) -> Result<(), redb::Error> {
        self.pieces.retain_in((digest.0, 0)..=(digest.0, u32::MAX), |_, _| false)?;
        Ok(())
    }

    /// Digests of all files, in order.
    pub(crate) fn files(&self) -> Result<Vec<Digest>, redb::Error> {
        let mut files: Vec<Digest> = Vec::new();
        for piece in self.pieces.iter()? {
            let (digest, _) = piece?.0.value();
            if files.last().is_none_or(|last| last.0 != digest) {
                files.push(Digest(digest));
            }
        }
        Ok(files)
    }

    /// The file, or whatever pieces of it there are.
    pub(crate) fn file(&self, digest: Digest) -> Result<Vec<u8>, redb::Error> {
        joined(&self.pieces, digest, 0)
    }
}

fn joined(pieces: &impl ReadableTable<([u8; 32], u32), &'static [u8]>, digest: Digest, len: usize) -> Result<Vec<u8>, redb::Error> {
    let mut file = Vec::with_capacity(len);
    for piece in pieces.range((digest.0, 0)..=(digest.0, u32::MAX))? {
        file.extend_from_slice(piece?.1.value());
    }
    Ok(file)
}

/// One file.
pub(crate) struct Disk {
    path: PathBuf,
    open: Mutex<Open>,
}

struct Open {
    /// `None` after a failure: what the disk holds is not certain before it has been opened again.
    database: Option<Arc<FileState>>,
    tried: Instant,
    failures: u64,
}

/// A database that may be closed by anybody: to close one that is damaged may well fail, and is nobody's failure.
struct FileState<T = Database>(Option<T>);

impl<T> FileState<T> {
    fn new(database: T) -> Arc<Self> {
        Arc::new(Self(Some(database)))
    }
}

impl<T> Deref for FileState<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0.as_ref().expect("it is there until it is dropped")
    }
}

impl<T> DerefMut for FileState<T> {
    fn deref_mut(&mut self) -> &mut T {
        self.0.as_mut().expect("it is there until it is dropped")
    }
}

impl<T> Drop for FileState<T> {
    fn drop(&mut self) {
        let database = self.0.take();
        if catch_unwind(AssertUnwindSafe(|| drop(database))).is_err() {
            tracing::error!("the session file was damaged when it was closed");
        }
    }
}

/// Whether the database has just been opened again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Opened {
    /// It was open.
    Before,
    /// It has been opened again: the index is to be read anew.
    Again,
}

impl Disk {
    /// Opens the database, or makes it.
    pub(crate) fn open(path: &Path) -> Result<Self, NotOpened> {
        let database = open_or_make(path).map_err(|why| not_opened(path, why))?;
        Ok(Self::of(path, database))
    }

    fn of(path: &Path, database: Database) -> Self {
        let open = Open { database: Some(FileState::new(database)), tried: Instant::now(), failures: 0 };
        Self { path: path.to_owned(), open: Mutex::new(open) }
    }

    #[cfg(test)]
    pub(crate) fn over(disk: impl redb::StorageBackend) -> Result<Self, NotOpened> {
        let nowhere = Path::new("nowhere");
        let opened = guarded(|| Ok(builder().create_with_backend(disk)?));
        opened.map(|database| Self::of(nowhere, database)).map_err(|failed| not_opened(nowhere, failed.why))
    }

    pub(crate) fn not_opened(&self, why: &str) -> NotOpened {
        not_opened(&self.path, why.to_owned())
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Times that the disk failed.
    pub(crate) fn failures(&self) -> u64 {
        self.lock().failures
    }

    /// Whether changes would be made now, as far as is known.
    pub(crate) fn is_open(&self) -> bool {
        self.lock().database.is_some()
    }

    /// Opens the database again if it had failed. One at a time.
    pub(crate) fn revive(&self) -> Result<Opened, StoreError> {
        let mut open = self.lock();
        if open.database.is_some() {
            return Ok(Opened::Before);
        }
        if open.tried.elapsed() < PAUSE {
            return Err(StoreError::Away);
        }
        open.tried = Instant::now();
        // Those who only look do not wait for the disk.
        drop(open);
        let opened = guarded(|| Ok(builder().open(&self.path)?));
        let mut open = self.lock();
        match opened {
            Ok(database) => {
                open.database = Some(FileState::new(database));
                tracing::info!("the session file is open again");
                Ok(Opened::Again)
            }
            Err(Failed { why, .. }) => {
                open.failures += 1;
                tracing::error!(why, "the session file cannot be opened again");
                Err(StoreError::Away)
            }
        }
    }

    /// One transaction: all of it has reached the disk when this returns, or the database is closed.
    pub(crate) fn change<T>(&self, change: impl FnOnce(&mut Change<'_>) -> Result<T, redb::Error>) -> Result<T, StoreError> {
        let database = self.lock().database.clone().ok_or(StoreError::Away)?;
        let changed = guarded(|| {
            let mut transaction = database.begin_write()?;
            transaction.set_quick_repair(true);
            let mut tables = Change::of(&transaction)?;
            let changed = change(&mut tables)?;
            drop(tables);
            transaction.commit()?;
            Ok(changed)
        });
        changed.map_err(|failed| self.fail(&database, &failed))
    }

    /// The file, or whatever pieces of it there are. It should have `len` bytes.
    pub(crate) fn file(&self, digest: Digest, len: u64) -> Result<Vec<u8>, StoreError> {
        let database = self.lock().database.clone().ok_or(StoreError::Away)?;
        let read = || {
            let pieces = database.begin_read()?.open_table(PIECES)?;
            joined(&pieces, digest, usize::try_from(len).unwrap_or(0))
        };
        guarded(read).map_err(|failed| self.fail(&database, &failed))
    }

    /// Closes that database, unless it has been closed and opened again meanwhile.
    fn fail(&self, failing: &Arc<FileState>, failed: &Failed) -> StoreError {
        let mut open = self.lock();
        open.failures += 1;
        let closed = open.database.take_if(|database| Arc::ptr_eq(database, failing));
        if closed.is_some() {
            open.tried = Instant::now();
        }
        // Closing it, which the last one to hold it does, waits for the disk.
        drop(open);
        drop(closed);
        tracing::error!(why = failed.why, "the session file does not do its work");
        if failed.full { StoreError::NoRoom } else { StoreError::Away }
    }

    /// Gives space back when much of the file is free. Only while nobody else uses it.
    pub(crate) fn compact(&self, held: u64) -> Result<(), NotOpened> {
        let not_opened = |why: String| not_opened(&self.path, why);
        let before = self.size().map_err(|e| not_opened(e.to_string()))?;
        if before < 2 * held + SLACK {
            return Ok(());
        }
        let mut open = self.lock();
        let Some(database) = open.database.as_mut().and_then(Arc::get_mut) else { return Ok(()) };
        guarded(|| Ok(database.compact()?)).map_err(|failed| not_opened(failed.why))?;
        drop(open);
        // The allocator's state is kept again.
        self.change(|_| Ok(())).map_err(|e| not_opened(e.to_string()))?;
        let after = self.size().map_err(|e| not_opened(e.to_string()))?;
        tracing::info!(before, after, "the session file was made compact");
        Ok(())
    }

    /// Bytes of the file.
    pub(crate) fn size(&self) -> io::Result<u64> {
        Ok(fs::metadata(&self.path)?.len())
    }
}

/// What the disk, or the database on it, would not do.
struct Failed {
    why: String,
    full: bool,
}

impl From<redb::Error> for Failed {
    fn from(error: redb::Error) -> Self {
        let full = matches!(&error, redb::Error::Io(error) if is_full(error));
        Self { why: error.to_string(), full }
    }
}

fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge)
}

/// A damaged file makes the database panic in places.
fn guarded<T>(work: impl FnOnce() -> Result<T, redb::Error>) -> Result<T, Failed> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(worked) => worked.map_err(Failed::from),
        Err(_) => Err(Failed { why: "it is damaged beyond reading".to_owned(), full: false }),
    }
}

fn not_opened(path: &Path, why: String) -> NotOpened {
    NotOpened { what: format!("the session file {}", path.display()), why }
}

fn builder() -> redb::Builder {
    let mut builder = Database::builder();
    builder.set_cache_size(PAGES);
    builder
}

fn open_or_make(path: &Path) -> Result<Database, String> {
    let failed = |failed: Failed| failed.why;
    match File::open(path) {
        Ok(mut file) => {
            let mut first = [0; MAGIC.len()];
            let read = file.read_exact(&mut first);
            if read.is_err() || first != *MAGIC {
                return Err("it is no session file; it was left as it is".to_owned());
            }
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => make(path)?,
        Err(error) => return Err(error.to_string()),
    }
    let database = guarded(|| match builder().open(path) {
        Err(DatabaseError::DatabaseAlreadyOpen) => Ok(None),
        opened => Ok(Some(opened?)),
    });
    let database = database.map_err(failed)?.ok_or("another process has it open")?;
    let ours = guarded(|| {
        let tables: Vec<_> = database.begin_read()?.list_tables()?.map(|table| table.name().to_owned()).collect();
        Ok(tables.iter().any(|name| name == RECORDS.name()))
    });
    if ours.map_err(failed)? { Ok(database) } else { Err("it is a database of something else; it was left as it is".to_owned()) }
}

/// Makes an empty database beside the place, and then puts it there as a whole: whenever this is interrupted, what is there is whole.
fn make(path: &Path) -> Result<(), String> {
    let told = |e: io::Error| e.to_string();
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".new-{}", uuid::Uuid::new_v4()));
    let made = (|| {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true);
        // The pictures are nobody else's business.
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let file = options.open(&beside).map_err(told)?;
        let empty = guarded(|| {
            let database = builder().create_file(file)?;
            let mut transaction = database.begin_write()?;
            transaction.set_quick_repair(true);
            Change::of(&transaction)?;
            Ok(transaction.commit()?)
        });
        empty.map_err(|failed| failed.why)?;
        File::open(&beside).and_then(|file| file.sync_all()).map_err(told)?;
        // A link does not take the place of a file that another process has put there meanwhile.
        match fs::hard_link(&beside, path) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(told(error)),
            _ => Ok(()),
        }
    })();
    let removed = fs::remove_file(&beside).map_err(told);
    made.and(removed)?;
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // The name is in the directory, which is a file of its own.
    File::open(directory).and_then(|directory| directory.sync_all()).map_err(told)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    /// Closing it fails, as redb's does where what it finds then is damaged.
    struct Damaged(Arc<AtomicU64>);

    impl Drop for Damaged {
        fn drop(&mut self) {
            self.0.fetch_add(1, Ordering::Relaxed);
            panic!("on purpose");
        }
    }

    #[test]
    fn closing_what_is_damaged_fails_nobody() {
        let closed = Arc::<AtomicU64>::default();
        let held = FileState::new(Damaged(Arc::clone(&closed)));
        let another = Arc::clone(&held);
        drop(held);
        assert_eq!(closed.load(Ordering::Relaxed), 0);
        drop(another);
        assert_eq!(closed.load(Ordering::Relaxed), 1);
        // Nor somebody who fails at that moment: two panics at once would end the program.
        let held = FileState::new(Damaged(Arc::clone(&closed)));
        let failed = catch_unwind(AssertUnwindSafe(|| {
            let _held = held;
            panic!("of another cause");
        }));
        assert_eq!(failed.unwrap_err().downcast_ref(), Some(&"of another cause"));
        assert_eq!(closed.load(Ordering::Relaxed), 2);
    }
}
