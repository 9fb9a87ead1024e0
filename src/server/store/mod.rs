//! Stores: they keep sessions, and the files of their images and layers. There is one trait with
//! three implementations, and one test suite for all of them.
//!
//! | store | an answered change lasts | when the store fails |
//! |---|---|---|
//! | `memory` | until the process ends | never |
//! | `file` | beyond a kill or a power cut: it has reached the disk | reads and drags go on, changes are refused |
//! | `redis` | as long as that server keeps it, for every process that uses it | sessions used in this process go on for one idle period |
//!
//! What can be lost: the highest `seq` of the numbered requests of a session. The file store writes
//! it with the next sweep; the Redis store, if its server did not answer, with the next request of
//! the session that reaches it. A drag over a socket stores nothing: its poses and its `seq` end
//! with it.
//!
//! A record never changes: new handles, layers or another image make a new record with a new
//! revision. Only [`Store::touch`] changes the time of the last use and the highest `seq`, both
//! atomically.
//!
//! A session whose record another version of the program has written ([`record`]) is kept: only its
//! owner's `delete` changes it, and every other request for it is refused
//! ([`StoreError::OtherVersion`]).

#[cfg(feature = "file-store")]
pub mod file;
#[cfg_attr(
    not(feature = "file-store"),
    allow(dead_code, reason = "only the file store uses all of it")
)]
mod index;
pub mod memory;
#[cfg(any(feature = "file-store", feature = "redis"))]
#[cfg_attr(
    not(all(feature = "file-store", feature = "redis")),
    allow(dead_code, reason = "each store uses a part of it")
)]
pub mod record;
#[cfg(feature = "redis")]
pub mod redis;
// Random warp objects are values of the contract's own laws, and no part of its library.
#[cfg(test)]
#[path = "../../contract/wire/arbitrary.rs"]
mod arbitrary;
#[cfg(test)]
mod tests;
mod url;

#[cfg(test)]
use crate::wire::{EnumName, WarpObject};
use std::collections::BTreeMap;
use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Digest, Folds, OutputSpec, RestSpec};
use thiserror::Error;

pub use index::record_bytes;
#[cfg(feature = "redis")]
pub use redis::RedisAddress;
pub use url::StoreUrl;

use crate::client::Owner;
use crate::layer::{LayerKind, LayerName};
use crate::limits::free::SharedHandles;
use crate::problem::words::period;
use crate::problem::{Code, Problem};
use crate::session::{Revision, SessionId};
use crate::wire::Pose;

/// The answer of a store.
pub type StoreFuture<'a, T> = Pin<Box<dyn Future<Output = Result<T, StoreError>> + Send + 'a>>;

/// An answer that needs no waiting.
fn ready<'a, T: Send + 'a>(answer: Result<T, StoreError>) -> StoreFuture<'a, T> {
    Box::pin(std::future::ready(answer))
}

/// Sessions that a sweep removes at once: about 0.1 ms. Others may use the store, and the thread of
/// the sweep, before it goes on.
pub(crate) const SWEPT_AT_ONCE: usize = 64;

/// A sweep in pieces; `piece` sweeps at most [`SWEPT_AT_ONCE`] sessions, and returns how many.
pub(crate) async fn in_pieces(piece: impl Fn() -> usize) -> usize {
    let mut swept = 0;
    loop {
        let now = piece();
        swept += now;
        if now < SWEPT_AT_ONCE {
            return swept;
        }
        tokio::task::yield_now().await;
    }
}

/// A session without its progress: what stays the same while q moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// The session's name.
    pub id: SessionId,
    /// Changes with everything below.
    pub revision: Revision,
    /// Digest of the image's file.
    pub image: Digest,
    /// The layers, at most [`MAX_LAYERS`].
    ///
    /// [`MAX_LAYERS`]: crate::layer::MAX_LAYERS
    pub layers: BTreeMap<LayerName, StoredLayer>,
    /// Digest of the mask that the session was made with. The layer `region` may have changed
    /// since.
    pub made_with_region: Option<Digest>,
    /// Upright size of the image.
    pub extent: Extent,
    /// Handles at rest and the parameters of the deformation, as the client gave them.
    pub rest: SharedHandles<RestSpec>,
    /// Where the handles are in requests without `q`.
    pub pose: Option<SharedHandles<Pose>>,
    /// How folds are handled.
    pub folds: Folds,
    /// How images are drawn unless a drag says otherwise.
    pub output: OutputSpec,
    /// When the session was created or replaced; its numbers start again then.
    pub created: SystemTime,
}

/// A layer of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredLayer {
    /// How its pixels are read.
    pub kind: LayerKind,
    /// Digest of its file.
    pub digest: Digest,
}

impl Record {
    /// Whether both were made from the same files and the same handles. Layers that were added or
    /// removed since do not count.
    pub fn is_made_like(&self, other: &Self) -> bool {
        let made = |record: &Self| {
            (
                record.image,
                record.made_with_region,
                record.folds,
                record.output,
            )
        };
        made(self) == made(other) && self.rest == other.rest && self.pose == other.pose
    }

    /// The digests of the files that it names: the image's first, then those of the layers. Two
    /// may be the same.
    pub fn files(&self) -> impl Iterator<Item = Digest> + '_ {
        std::iter::once(self.image).chain(self.layers.values().map(|layer| layer.digest))
    }
}

/// A file that a record names.
#[derive(Clone, Debug)]
pub struct NamedFile {
    /// Digest of the bytes.
    pub digest: Digest,
    /// Its content.
    pub bytes: Bytes,
}

impl NamedFile {
    fn len(&self) -> u64 {
        self.bytes.len() as u64
    }
}

/// The limits of a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoreLimits {
    /// A session expires after this time without use.
    pub idle: Duration,
    /// Most sessions.
    pub sessions: usize,
    /// Most bytes of files and records.
    pub bytes: u64,
}

/// The result of [`Store::put`].
#[derive(Clone, Debug)]
pub enum Put {
    /// There was no such session.
    Created(Session),
    /// The session had been made from the same and stays as it is.
    Same(Session),
    /// The session was replaced; its old record.
    Replaced(Session, Arc<Record>),
}

/// A living session.
#[derive(Clone, Debug)]
pub struct Session {
    /// Its record.
    pub record: Arc<Record>,
    /// Highest sequence number seen.
    pub seq: Option<u64>,
    /// When it expires unless it is used before.
    pub expires: SystemTime,
}

/// Why an operation failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum StoreError {
    /// It never existed, was deleted, or expired more than one idle period ago.
    #[error(
        "there is no such session: it was deleted, expired a while ago, or never existed; open a \
            new one with POST /sessions"
    )]
    NoSuchSession,
    /// Expired less than one idle period ago.
    #[error("the session has expired: it was idle for {}; open a new one with POST /sessions",
        period(*idle))]
    Expired {
        /// The idle period.
        idle: Duration,
    },
    /// A limit is reached; no living session is evicted.
    #[error("the session store is full: {what} would be {actual}; the limit is {limit}")]
    Full {
        /// Which limit: `sessions`, `store_bytes`.
        what: &'static str,
        /// The limit.
        limit: u64,
        /// What it would have been.
        actual: u64,
    },
    /// The disk is full, or the other server's memory is.
    #[error("the session store is full")]
    NoRoom,
    /// Every attempt collided with another request's change.
    #[error("other requests changed the session at the same time; send the request again")]
    Contended,
    /// Another version of the program has written the record, with something that this one does not
    /// know.
    #[error("another version of the program has stored this session, and this one cannot read it")]
    OtherVersion,
    /// The store fails at the moment. The cause is only in the log: it may contain paths and
    /// addresses.
    #[error("the session store is unavailable")]
    Away,
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let new = |code, seconds| Self::new(code, error.to_string()).retry_after(seconds);
        match error {
            StoreError::NoSuchSession => Self::new(Code::NoSuchSession, error.to_string()),
            StoreError::Expired { .. } => Self::new(Code::SessionExpired, error.to_string()),
            StoreError::Full {
                what,
                limit,
                actual,
            } => new(Code::Overloaded, 30).limit(what, limit, actual),
            StoreError::NoRoom => new(Code::Overloaded, 30),
            // A rolling update takes minutes.
            StoreError::OtherVersion => new(Code::StoredByAnotherVersion, 30),
            StoreError::Contended => new(Code::Overloaded, 1),
            StoreError::Away => new(Code::Overloaded, 2),
        }
    }
}

/// The figures of a store, for metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StoreStats {
    /// Sessions that this process knows of.
    pub sessions: u64,
    /// Bytes of their records, and of their files if this process keeps them.
    pub bytes: u64,
    /// Records left out since the process started because they or their files were damaged.
    pub damaged: u64,
    /// Records of another version of the program read since the process started.
    pub other_version: u64,
    /// Operations that failed or found no room.
    pub failures: u64,
    /// The last operation failed.
    pub is_away: bool,
    /// No operation has succeeded yet.
    pub is_unknown: bool,
}

/// Sessions and the files of their images and layers.
pub trait Store: Send + Sync + fmt::Debug {
    /// Creates or replaces a session. Its numbers start again, and it lives for another idle
    /// period. `files`: the image's, and those of the record's layers.
    fn put(&self, record: Arc<Record>, files: Vec<NamedFile>) -> StoreFuture<'_, Put>;

    /// Replaces the record of revision `old`, with the same image; numbers go on. `layer`: the
    /// file of the layer that only the new record names, if there is one. Files of layers that only
    /// the old record names are removed. `None`: another revision is there.
    fn revise(
        &self,
        old: Revision,
        new: Arc<Record>,
        layer: Option<NamedFile>,
    ) -> StoreFuture<'_, Option<Session>>;

    /// Reads a session without prolonging it.
    fn peek(&self, id: SessionId) -> StoreFuture<'_, Session>;

    /// Prolongs a session by another idle period and stores `seq` if it is the highest. The answer
    /// has the highest.
    fn touch(&self, id: SessionId, seq: Option<u64>) -> StoreFuture<'_, Session>;

    /// Deletes a session, and each of its files with the last session that names it. For one idle
    /// period another delete has the same answer.
    fn delete(&self, id: SessionId) -> StoreFuture<'_, ()>;

    /// Whether there is no such session because it was deleted, less than one idle period ago.
    fn was_deleted(&self, id: SessionId) -> StoreFuture<'_, bool>;

    /// The most memory that [`Store::file`] takes, beyond what the store holds, bytes.
    fn file_bytes(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, u64>;

    /// The file of that digest, of the session's image or of one of its layers, if the session
    /// still names it.
    fn file(&self, id: SessionId, digest: Digest) -> StoreFuture<'_, Bytes>;

    /// The record of a living session as this process knows it, without asking anybody: another
    /// process may have changed or ended the session since.
    fn local_record(&self, id: SessionId) -> Option<Arc<Record>>;

    /// Whether a session of that owner, known to this process, names that file.
    fn names(&self, owner: Owner, digest: Digest) -> bool;

    /// Removes expired sessions; returns how many.
    fn sweep(&self) -> StoreFuture<'_, usize>;

    /// Whether the store works. Answers within about a second.
    fn ready(&self) -> StoreFuture<'_, ()>;

    /// The figures, as far as this process knows them, without waiting.
    fn figures(&self) -> StoreStats;
}

/// Opens a store. A server may be down at this moment. Errors: The file cannot be opened, is not a
/// session file, is damaged beyond reading, or is open in another process.
pub fn open(url: &StoreUrl, bounds: StoreLimits) -> Result<Arc<dyn Store>, NotOpened> {
    Ok(match url {
        StoreUrl::Memory => Arc::new(memory::MemoryStore::new(bounds)),
        #[cfg(feature = "file-store")]
        StoreUrl::File(path) => Arc::new(file::FileStore::open(path, bounds)?),
        #[cfg(feature = "redis")]
        StoreUrl::Redis(address) => Arc::new(redis::RedisStore::new(address, bounds)?),
    })
}

/// Why a store was not opened.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{what}: {why}")]
pub struct NotOpened {
    /// Which store.
    pub what: String,
    /// Why.
    pub why: String,
}
