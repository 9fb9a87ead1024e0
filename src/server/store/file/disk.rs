//! The database under the file store: created, opened, changed, read, and opened again after a disk
//! error.
//!
//! Every change is one transaction in two phases (the data, then the switch to it), each of which
//! waits for the disk. The allocator's state is stored with it, so that an opening after a crash
//! does not scan the file. An image's file is cut into pieces that fill their pages; in one value
//! it would take the next power of two.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _};
use std::ops::Deref;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use mlswarp::warp::Digest;
use redb::backends::FileBackend;
use redb::{
    Database, DatabaseError, ReadableDatabase as _, ReadableTable, Table, TableDefinition,
    TableHandle as _, WriteTransaction,
};

use super::backend::DurableLength;
use crate::store::{NotOpened, StoreError};

/// Session to record.
const RECORDS: TableDefinition<'static, [u8; 32], &[u8]> = TableDefinition::new("records");
/// Session to highest number.
const NUMBERS: TableDefinition<'static, [u8; 32], u64> = TableDefinition::new("numbers");
/// Digest of a file and number of a piece to that piece.
const PIECES: TableDefinition<'static, ([u8; 32], u32), &[u8]> = TableDefinition::new("pieces");
/// Bytes of a piece: with its key and the page header it fills a page of 64 KiB.
pub(crate) const PIECE_BYTES: usize = (64 << 10) - 128;
/// Memory for the database's pages, bytes.
const PAGE_CACHE: usize = 16 << 20;
/// The first bytes of every database.
const MAGIC: &[u8; 4] = b"redb";
/// Pause between attempts to open a database that has failed.
const REOPEN_PAUSE: Duration = Duration::from_secs(1);
/// The file is compacted when it is larger than this and twice its content.
pub(crate) const COMPACTION_BYTES: u64 = 16 << 20;

/// The tables, within one transaction.
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
        for (number, piece) in (0..).zip(bytes.chunks(PIECE_BYTES)) {
            self.pieces.insert((digest.0, number), piece)?;
        }
        Ok(())
    }

    pub(crate) fn remove_file(&mut self, digest: Digest) -> Result<(), redb::Error> {
        Ok(self
            .pieces
            .retain_in((digest.0, 0)..=(digest.0, u32::MAX), |_, _| false)?)
    }

    pub(crate) fn remove_files(&mut self, digests: &[Digest]) -> Result<(), redb::Error> {
        digests
            .iter()
            .try_for_each(|digest| self.remove_file(*digest))
    }

    /// Digests of all files.
    pub(crate) fn files(&self) -> Result<Vec<Digest>, redb::Error> {
        let mut files = Vec::new();
        for piece in self.pieces.iter()? {
            files.push(Digest(piece?.0.value().0));
        }
        // The table is sorted.
        files.dedup();
        Ok(files)
    }

    /// All pieces of a file, complete or not.
    pub(crate) fn file(&self, digest: Digest) -> Result<Vec<u8>, redb::Error> {
        join(&self.pieces, digest, 0)
    }
}

fn join(
    pieces: &impl ReadableTable<([u8; 32], u32), &'static [u8]>,
    digest: Digest,
    len: usize,
) -> Result<Vec<u8>, redb::Error> {
    let mut file = Vec::with_capacity(len);
    for piece in pieces.range((digest.0, 0)..=(digest.0, u32::MAX))? {
        file.extend_from_slice(piece?.1.value());
    }
    Ok(file)
}

/// The database's file.
pub(crate) struct Disk {
    path: PathBuf,
    state: Mutex<DiskState>,
}

struct DiskState {
    /// `None` after a failure: what is on the disk is uncertain until it is opened again.
    database: Option<Arc<OpenDatabase>>,
    /// The last attempt to open it.
    tried: Instant,
    failures: u64,
}

/// A database whose closing may panic, as it does when the file is damaged. The panic is caught:
/// the thread that happens to close it must not fail.
struct OpenDatabase<T = Database>(Option<T>);

impl<T> OpenDatabase<T> {
    fn new(database: T) -> Arc<Self> {
        Arc::new(Self(Some(database)))
    }
}

impl<T> Deref for OpenDatabase<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0.as_ref().expect("it is there until it is dropped")
    }
}

impl<T> Drop for OpenDatabase<T> {
    fn drop(&mut self) {
        let database = self.0.take();
        if catch_unwind(AssertUnwindSafe(|| drop(database))).is_err() {
            tracing::error!("the session file was damaged when it was closed");
        }
    }
}

impl Disk {
    /// Opens the database, or creates it.
    pub(crate) fn open(path: &Path) -> Result<Self, NotOpened> {
        let database = open_or_create(path).map_err(|why| not_opened(path, why))?;
        Ok(Self::of(path, database))
    }

    fn of(path: &Path, database: Database) -> Self {
        let state = DiskState {
            database: Some(OpenDatabase::new(database)),
            tried: Instant::now(),
            failures: 0,
        };
        Self {
            path: path.to_owned(),
            state: Mutex::new(state),
        }
    }

    #[cfg(test)]
    pub(crate) fn over(disk: impl redb::StorageBackend) -> Result<Self, NotOpened> {
        let nowhere = Path::new("nowhere");
        let opened = guarded(|| Ok(builder().create_with_backend(DurableLength(disk))?));
        opened
            .map(|database| Self::of(nowhere, database))
            .map_err(|failed| not_opened(nowhere, failed.why))
    }

    pub(crate) fn not_opened(&self, why: &str) -> NotOpened {
        not_opened(&self.path, why.to_owned())
    }

    fn lock(&self) -> MutexGuard<'_, DiskState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Times that the disk failed.
    pub(crate) fn failures(&self) -> u64 {
        self.lock().failures
    }

    /// Whether the database is open.
    pub(crate) fn is_open(&self) -> bool {
        self.lock().database.is_some()
    }

    fn database(&self) -> Result<Arc<OpenDatabase>, StoreError> {
        self.lock().database.clone().ok_or(StoreError::Away)
    }

    /// Opens the database again if it had failed; returns whether it did. Only one caller at a
    /// time.
    pub(crate) fn reopen(&self) -> Result<bool, StoreError> {
        let mut state = self.lock();
        if state.database.is_some() {
            return Ok(false);
        }
        if state.tried.elapsed() < REOPEN_PAUSE {
            return Err(StoreError::Away);
        }
        state.tried = Instant::now();
        // Readers do not wait for the disk.
        drop(state);
        let opened = guarded(|| Ok(open_file(&self.path)?));
        let mut state = self.lock();
        match opened {
            Ok(database) => {
                state.database = Some(OpenDatabase::new(database));
                tracing::info!("the session file is open again");
                Ok(true)
            }
            Err(Failed { why, .. }) => {
                state.failures += 1;
                tracing::error!(why, "the session file cannot be opened again");
                Err(StoreError::Away)
            }
        }
    }

    /// Runs one transaction. When this returns, it has reached the disk, or the database is closed.
    pub(crate) fn change<T>(
        &self,
        change: impl FnOnce(&mut Change<'_>) -> Result<T, redb::Error>,
    ) -> Result<T, StoreError> {
        let database = self.database()?;
        let changed = guarded(|| {
            let mut transaction = database.begin_write()?;
            transaction.set_quick_repair(true);
            let changed = change(&mut Change::of(&transaction)?)?;
            transaction.commit()?;
            Ok(changed)
        });
        changed.map_err(|failed| self.fail(&database, &failed))
    }

    /// All pieces of a file, complete or not. `len` is its expected size.
    pub(crate) fn file(&self, digest: Digest, len: u64) -> Result<Vec<u8>, StoreError> {
        let database = self.database()?;
        let read = || {
            let pieces = database.begin_read()?.open_table(PIECES)?;
            join(&pieces, digest, usize::try_from(len).unwrap_or(0))
        };
        guarded(read).map_err(|failed| self.fail(&database, &failed))
    }

    /// Closes the database, unless it has been opened again since.
    fn fail(&self, database: &Arc<OpenDatabase>, failed: &Failed) -> StoreError {
        let mut state = self.lock();
        state.failures += 1;
        let closed = state.database.take_if(|open| Arc::ptr_eq(open, database));
        if closed.is_some() {
            state.tried = Instant::now();
        }
        // Closing waits for the disk: not under the lock.
        drop(state);
        drop(closed);
        tracing::error!(why = failed.why, "the session file does not do its work");
        if failed.is_full {
            StoreError::NoRoom
        } else {
            StoreError::Away
        }
    }

    /// Compacts the file when much of it is free. Only while nothing else uses it.
    pub(crate) fn compact(&self, content: u64) -> Result<(), NotOpened> {
        let size = || {
            fs::metadata(&self.path)
                .map(|file| file.len())
                .map_err(|e| self.not_opened(&e.to_string()))
        };
        let before = size()?;
        if before < 2 * content + COMPACTION_BYTES {
            return Ok(());
        }
        let mut state = self.lock();
        let Some(database) = state
            .database
            .as_mut()
            .and_then(Arc::get_mut)
            .and_then(|open| open.0.as_mut())
        else {
            return Ok(());
        };
        guarded(|| Ok(database.compact()?)).map_err(|failed| self.not_opened(&failed.why))?;
        drop(state);
        // Stores the allocator's state again.
        self.change(|_| Ok(()))
            .map_err(|e| self.not_opened(&e.to_string()))?;
        tracing::info!(before, after = size()?, "the session file was made compact");
        Ok(())
    }
}

/// A failure of the disk, or of the database on it.
struct Failed {
    why: String,
    is_full: bool,
}

impl From<redb::Error> for Failed {
    fn from(error: redb::Error) -> Self {
        let full = [
            io::ErrorKind::StorageFull,
            io::ErrorKind::QuotaExceeded,
            io::ErrorKind::FileTooLarge,
        ];
        let is_full = matches!(&error, redb::Error::Io(error) if full.contains(&error.kind()));
        Self {
            why: error.to_string(),
            is_full,
        }
    }
}

/// Catches panics: the database panics on some damaged files.
fn guarded<T>(work: impl FnOnce() -> Result<T, redb::Error>) -> Result<T, Failed> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(worked) => worked.map_err(Failed::from),
        Err(_) => Err(Failed {
            why: "it is damaged beyond reading".to_owned(),
            is_full: false,
        }),
    }
}

fn not_opened(path: &Path, why: String) -> NotOpened {
    NotOpened {
        what: format!("the session file {}", path.display()),
        why,
    }
}

fn builder() -> redb::Builder {
    let mut builder = Database::builder();
    builder.set_cache_size(PAGE_CACHE);
    builder
}

fn open_file(path: &Path) -> Result<Database, DatabaseError> {
    let file = OpenOptions::new().read(true).write(true).open(path)?;
    builder().create_with_backend(DurableLength(FileBackend::new(file)?))
}

fn open_or_create(path: &Path) -> Result<Database, String> {
    let failed = |failed: Failed| failed.why;
    match File::open(path) {
        Ok(mut file) => {
            let mut first = [0; MAGIC.len()];
            let read = file.read_exact(&mut first);
            if read.is_err() || first != *MAGIC {
                return Err("it is no session file; it was left as it is".to_owned());
            }
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => create(path)?,
        Err(error) => return Err(error.to_string()),
    }
    let database = guarded(|| match open_file(path) {
        Err(DatabaseError::DatabaseAlreadyOpen) => Ok(None),
        opened => Ok(Some(opened?)),
    });
    let database = database
        .map_err(failed)?
        .ok_or("another process has it open")?;
    let ours = guarded(|| {
        let tables: Vec<_> = database
            .begin_read()?
            .list_tables()?
            .map(|table| table.name().to_owned())
            .collect();
        Ok(tables.iter().any(|name| name == RECORDS.name()))
    });
    if ours.map_err(failed)? {
        Ok(database)
    } else {
        Err("it is a database of something else; it was left as it is".to_owned())
    }
}

/// Creates an empty database under a temporary name and links it to `path`, so that an interruption
/// leaves no half of it.
fn create(path: &Path) -> Result<(), String> {
    let why = |e: io::Error| e.to_string();
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(format!(".new-{}", uuid::Uuid::new_v4()));
    let created = (|| {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true);
        // Readable by the owner alone.
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let file = options.open(&temporary).map_err(why)?;
        let empty = guarded(|| {
            let database = builder().create_with_backend(DurableLength(FileBackend::new(file)?))?;
            let mut transaction = database.begin_write()?;
            transaction.set_quick_repair(true);
            Change::of(&transaction)?;
            Ok(transaction.commit()?)
        });
        empty.map_err(|failed| failed.why)?;
        File::open(&temporary)
            .and_then(|file| file.sync_all())
            .map_err(why)?;
        // Unlike a rename, a link does not replace a file that another process has put there.
        match fs::hard_link(&temporary, path) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(why(error)),
            _ => Ok(()),
        }
    })();
    let removed = fs::remove_file(&temporary).map_err(why);
    created.and(removed)?;
    let directory = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    // The new name is in the directory, which is synchronised separately.
    File::open(directory)
        .and_then(|directory| directory.sync_all())
        .map_err(why)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    /// Panics when it is closed.
    struct Damaged(Arc<AtomicU64>);

    impl Drop for Damaged {
        fn drop(&mut self) {
            self.0.fetch_add(1, Ordering::Relaxed);
            panic!("on purpose");
        }
    }

    #[test]
    fn closing_what_is_damaged_ends_no_thread() {
        let closed = Arc::<AtomicU64>::default();
        let held = OpenDatabase::new(Damaged(Arc::clone(&closed)));
        let another = Arc::clone(&held);
        drop(held);
        assert_eq!(closed.load(Ordering::Relaxed), 0);
        drop(another);
        assert_eq!(closed.load(Ordering::Relaxed), 1);
        // Nor does it panic in a thread that panics already: two panics end the program.
        let held = OpenDatabase::new(Damaged(Arc::clone(&closed)));
        let failed = catch_unwind(AssertUnwindSafe(|| {
            let _held = held;
            panic!("of another cause");
        }));
        assert_eq!(
            failed.unwrap_err().downcast_ref(),
            Some(&"of another cause")
        );
        assert_eq!(closed.load(Ordering::Relaxed), 2);
    }
}
