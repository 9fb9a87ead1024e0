//! Where sessions and the files of their pictures live. The trait is asynchronous and object safe, so that a store in a file or on
//! another machine takes the place of memory without a change elsewhere; [`memory`] is the one that is built in.
//!
//! A record never changes: a session whose handles or picture are replaced has another one, with another revision. The time of its last use and
//! the highest `seq` seen move by [`Store::touch`] alone, in one step. A picture's file is held once, by its digest, for as long as a session names it.

pub mod memory;

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use thiserror::Error;

use super::session::{Revision, SessionId};
use crate::pixmap::Extent;
use crate::warp::{Digest, Folds, OutputSpec, RestSpec};

/// What a store answers, later.
pub type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, StoreError>> + Send + 'a>>;

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
}

/// Sessions and the files of their pictures.
pub trait Store: Send + Sync + fmt::Debug {
    /// Keeps a new session and its picture's file.
    fn create(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Session>;

    /// Makes the session of that name, or makes it anew: its numbers start again, and it lives for another idle period.
    fn put(&self, record: Arc<Record>, image: Bytes) -> Answer<'_, Put>;

    /// Puts `new` in the place of the record of that revision, on the same picture; numbers go on. `None`: another revision is there.
    fn revise(&self, old: Revision, new: Arc<Record>) -> Answer<'_, Option<Session>>;

    /// Looks without using: the session does not live longer for it.
    fn peek(&self, id: SessionId) -> Answer<'_, Session>;

    /// Uses the session: it lives for another idle period, and `seq` is noted when it is the highest so far. The answer holds the highest.
    fn touch(&self, id: SessionId, seq: Option<u64>) -> Answer<'_, Session>;

    /// Ends the session; the file goes with the last session that names it.
    fn delete(&self, id: SessionId) -> Answer<'_, ()>;

    /// The file of a living session's picture.
    fn image(&self, digest: Digest) -> Answer<'_, Bytes>;

    /// Drops what has expired; says how many.
    fn sweep(&self) -> Answer<'_, usize>;
}
