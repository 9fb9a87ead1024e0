//! Where sessions and the files of their pictures live. The trait is asynchronous and object safe; three stores keep its promises, and one suite
//! of tests holds all of them to it:
//!
//! | store | what was answered is there | when it does not answer |
//! |---|---|---|
//! | [`memory`] | until the process ends | never |
//! | [`mod@file`] | after a kill or a power cut: it has reached the disk before | looking and dragging go on, changes are refused |
//! | [`redis`] | for as long as that server keeps it; for every process that uses it | sessions that were used here go on for one idle period |
//!
//! A record never changes: a session whose handles or picture are replaced has another one, with another revision. The time of its last use and
//! the highest `seq` seen move by [`Store::touch`] alone, in one step. A session's name is opaque here: whose it is, is a part of it.
//!
//! A session whose record another version of the program has written ([`record`]) is kept: nothing but a `delete` of its owner changes it, and every
//! other request for it is refused ([`StoreError::OtherVersion`]).

pub mod file;
mod index;
pub mod memory;
pub mod record;
pub mod redis;
#[cfg(test)]
mod tests;
mod url;

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
pub use url::{Address, StoreUrl};

use crate::client::Owner;
use crate::problem::{Code, Problem};
use crate::session::{Revision, SessionId};

/// What a store answers, later.
pub type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, StoreError>> + Send + 'a>>;

/// An answer that needs no waiting.
fn known<'a, T: Send + 'a>(answer: Result<T, StoreError>) -> Answer<'a, T> {
    Box::pin(std::future::ready(answer))
}

/// What stays while q moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// The session's name.
    pub id: SessionId,
    /// Changes with everything below.
    pub revision: Revision,
    /// Digest of the picture's file.
    pub image: Digest,
    /// Upright size of the picture.
    pub extent: Extent,
    /// Handles at rest and everything that stays with them, as the client said it.
    pub rest: RestSpec,
    /// What to do about folds.
    pub folds: Folds,
    /// How pictures are made unless a drag says otherwise.
    pub output: OutputSpec,
    /// When the session was made, or made anew with another picture: its numbers start there.
    pub created: SystemTime,
}

impl Record {
    /// Made from the same file and the same handles.
    #[must_use]
    pub fn is_made_like(&self, other: &Self) -> bool {
        let made = |record: &Self| (record.image, record.folds, record.output);
        made(self) == made(other) && self.rest == other.rest
    }
}

/// Bounds of a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// How long a session lives without being used.
    pub idle: Duration,
    /// Most sessions.
    pub sessions: usize,
    /// Most bytes of files and records.
    pub bytes: u64,
}

/// What became of a record that was put.
#[derive(Clone, Debug)]
pub enum Put {
    /// There was no such session.
    Created(Session),
    /// The session that was there had been made from the same: it stays as it is.
    Same(Session),
    /// The session is made anew; its old record.
    Replaced(Session, Arc<Record>),
}

/// A living session.
#[derive(Clone, Debug)]
pub struct Session {
    /// What stays while q moves.
    pub record: Arc<Record>,
    /// Highest sequence number seen.
    pub seq: Option<u64>,
    /// When it ends unless it is used before.
    pub expires: SystemTime,
}

/// Why a store did not do what it was asked.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum StoreError {
    /// Never heard of, deleted, or expired long ago.
    #[error("there is no such session")]
    NoSuchSession,
    /// Expired less than one idle period ago.
    #[error("the session has expired")]
    Expired,
    /// No room, and no living session is thrown out to make some.
    #[error("no room for another session: {what} would be {actual}; at most {limit}")]
    Full {
        /// Which limit: `sessions`, `store_bytes`.
        what: &'static str,
        /// The limit.
        limit: u64,
        /// What there would be.
        actual: u64,
    },
    /// The disk is full, or the other server's memory is.
    #[error("the session store has no room")]
    NoRoom,
    /// Other requests changed the session each time that this one was about to.
    #[error("other requests changed the session each time that this one was about to")]
    Contended,
    /// The session's record was written by another version of the program, and has something in it that this one does not know.
    #[error("another version of the program has stored this session, and this one cannot read it")]
    OtherVersion,
    /// The store does not do its work now; it may later. What it said is in the log: it may hold paths and addresses.
    #[error("the session store does not answer")]
    Away,
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let new = |code, seconds| Self::new(code, error.to_string()).retry_after(seconds);
        match error {
            StoreError::NoSuchSession => Self::new(Code::NoSuchSession, error.to_string()),
            StoreError::Expired => Self::new(Code::SessionExpired, error.to_string()),
            StoreError::Full { what, limit, actual } => new(Code::Overloaded, 30).limit(what, limit, actual),
            StoreError::NoRoom => new(Code::Overloaded, 30),
            // A rolling update takes minutes.
            StoreError::OtherVersion => new(Code::StoredByAnotherVersion, 30),
            StoreError::Contended => new(Code::Overloaded, 1),
            StoreError::Away => new(Code::Overloaded, 2),
        }
    }
}

/// What is in a store, for those who watch it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Figures {
    /// Sessions that this process knows of.
    pub sessions: u64,
    /// Bytes of their records, and of their files where those are this process's to keep.
    pub bytes: u64,
    /// Records that were left out since the process started, because they or their files were damaged.
    pub damaged: u64,
    /// Records read since the process started that another version of the program has written.
    pub other_version: u64,
    /// Times that the store did not do what it was asked, or had no room.
    pub failures: u64,
    /// It did not do what it was asked last.
    pub is_away: bool,
    /// It has never yet done what it was asked.
    pub is_unknown: bool,
}

/// Sessions and the files of their pictures.
pub trait Store: Send + Sync + fmt::Debug {
    /// Makes the session of that name, or makes it anew: its numbers start again, and it lives for another idle period.
    fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put>;

    /// Puts `new` in the place of the record of that revision, on the same picture; numbers go on. `None`: another revision is there.
    fn revise(&self, old: Revision, new: Arc<Record>) -> Answer<'_, Option<Session>>;

    /// Looks without using: the session does not live longer for it.
    fn peek(&self, id: SessionId) -> Answer<'_, Session>;

    /// Uses the session: it lives for another idle period, and `seq` is noted when it is the highest so far. The answer holds the highest.
    fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session>;

    /// Ends the session; the file goes with the last session that names it. A session that was deleted less than one idle period ago may be deleted
    /// again, with the same answer; otherwise there is no such session for anybody from now on.
    fn delete(&self, id: SessionId) -> Answer<'_, ()>;

    /// How much memory [`Store::image`] takes beyond what the store holds, bytes, at most.
    fn image_bytes(&self, id: SessionId, digest: Digest) -> Answer<'_, u64>;

    /// The file of that session's picture, if it is still the one of that digest.
    fn image(&self, id: SessionId, digest: Digest) -> Answer<'_, Bytes>;

    /// Some living session of that owner is known here whose picture has that file.
    fn names(&self, owner: Owner, digest: Digest) -> bool;

    /// Drops what has expired; says how many.
    fn sweep(&self) -> Answer<'_, usize>;

    /// Whether the store would do its work now. Answers within about a second.
    fn ready(&self) -> Answer<'_, ()>;

    /// What is in it, as this process knows it; without waiting.
    fn figures(&self) -> Figures;
}

/// Opens the store of that place. Another server need not be there yet.
///
/// # Errors
/// The file cannot be opened, is none of ours, is damaged beyond reading, or is another process's.
pub fn open(place: &StoreUrl, bounds: Bounds) -> Result<Arc<dyn Store>, NotOpened> {
    Ok(match place {
        StoreUrl::Memory => Arc::new(memory::MemoryStore::new(bounds)),
        StoreUrl::File(path) => Arc::new(file::FileStore::open(path, bounds)?),
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
