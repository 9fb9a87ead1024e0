//! Names of sessions, and the rule that the newest pose wins: a request whose `seq` is lower than one already seen costs no rendering,
//! also while it waits. The rule across processes is the store's; the lanes here wake those who wait in this one.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use tokio::sync::watch;
use uuid::{Uuid, Variant};

use crate::cache::Retained;
use crate::client::Owner;

/// The name of a session: a UUID of version 4 (122 bits of the operating system's randomness, so that nobody guesses another's session)
/// among those of its owner. Written, it is the UUID alone.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SessionId {
    owner: Owner,
    uuid: Uuid,
}

impl SessionId {
    /// A new name.
    #[must_use]
    pub fn random(owner: Owner) -> Self {
        Self { owner, uuid: Uuid::new_v4() }
    }

    /// Reads a name, in the hyphenated form alone: one session has one name.
    ///
    /// # Errors
    /// It is no UUID of version 4.
    pub fn parse(owner: Owner, text: &str) -> Result<Self, NotASessionId> {
        let uuid = Uuid::try_parse(text).map_err(|_| NotASessionId)?;
        let version_4 = uuid.get_version_num() == 4 && uuid.get_variant() == Variant::RFC4122;
        if text.len() == 36 && version_4 { Ok(Self { owner, uuid }) } else { Err(NotASessionId) }
    }

    /// Whose session it is.
    #[must_use]
    pub const fn owner(&self) -> Owner {
        self.owner
    }

    /// Owner and name, for stores.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; 32] {
        let mut bytes = [0; 32];
        bytes[..16].copy_from_slice(&self.owner.to_bytes());
        bytes[16..].copy_from_slice(self.uuid.as_bytes());
        bytes
    }

    /// What [`SessionId::to_bytes`] gave.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; 32]) -> Self {
        let (owner, uuid) = bytes.split_at(16);
        let half = |half: &[u8]| half.try_into().expect("half of 32 bytes");
        Self { owner: Owner::from_bytes(half(owner)), uuid: Uuid::from_bytes(half(uuid)) }
    }
}

/// One state of a session: it changes whenever the session's handles or picture do, and never comes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Revision(Uuid);

impl Revision {
    /// A new one.
    #[must_use]
    pub fn random() -> Self {
        Self(Uuid::new_v4())
    }

    /// What [`Revision::as_bytes`] gave.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(Uuid::from_bytes(bytes))
    }

    /// Its 16 bytes.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; 16] {
        self.0.as_bytes()
    }
}

/// Not a UUID of version 4 in its usual form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a UUID of version 4")]
pub struct NotASessionId;

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.uuid.fmt(f)
    }
}

/// Shortened: whoever reads a log must not be able to use the session.
impl fmt::Debug for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.8}..", self.uuid.to_string())
    }
}

/// A life of a session: the numbers of its requests start anew with each.
pub type Incarnation = (SessionId, SystemTime);

/// The sessions for which numbered requests are under way.
#[derive(Clone, Debug, Default)]
pub struct Sequencer(Arc<Mutex<HashMap<Incarnation, Arc<SessionSequence>>>>);

/// The numbered requests of one life of a session.
#[derive(Debug)]
struct SessionSequence {
    newest: watch::Sender<u64>,
    /// What a superseded request was building, the newer one needs.
    builds: Retained,
}

/// A numbered request under way.
#[derive(Debug)]
pub struct SequencePosition {
    lanes: Sequencer,
    life: Incarnation,
    lane: Arc<SessionSequence>,
    seq: u64,
}

impl Sequencer {
    /// Enters a request; those with a lower number are superseded from now on.
    #[must_use]
    pub fn enter(&self, life: Incarnation, seq: u64) -> SequencePosition {
        let new = || Arc::new(SessionSequence { newest: watch::Sender::new(seq), builds: Retained::default() });
        let lane = Arc::clone(self.lock().entry(life).or_insert_with(new));
        lane.newest.send_if_modified(|newest| {
            let higher = seq > *newest;
            *newest = seq.max(*newest);
            higher
        });
        SequencePosition { lanes: self.clone(), life, lane, seq }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Incarnation, Arc<SessionSequence>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SequencePosition {
    /// A higher number has been seen.
    #[must_use]
    pub fn is_superseded(&self) -> bool {
        *self.lane.newest.borrow() > self.seq
    }

    /// Waits until a higher number is seen.
    pub async fn superseded(&self) {
        let mut newest = self.lane.newest.subscribe();
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = newest.wait_for(|newest| *newest > self.seq).await;
    }

    /// Builds that go on for as long as a numbered request of the session is under way.
    #[must_use]
    pub fn builds(&self) -> &Retained {
        &self.lane.builds
    }
}

impl Drop for SequencePosition {
    fn drop(&mut self) {
        let mut lanes = self.lanes.lock();
        // The map's and this one: arcs are cloned under the lock alone.
        if Arc::strong_count(&self.lane) <= 2 {
            lanes.remove(&self.life);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn names_are_hyphenated_uuids_of_version_4() {
        let parse = |text: &str| SessionId::parse(Owner::ANYBODY, text);
        let id = SessionId::random(Owner::ANYBODY);
        assert_eq!(parse(&id.to_string()), Ok(id));
        for text in ["", "x", "00000000-0000-0000-0000-000000000000", "6ba7b810-9dad-11d1-80b4-00c04fd430c8"] {
            assert_eq!(parse(text), Err(NotASessionId), "{text}");
        }
        assert!(parse(&id.to_string().replace('-', "")).is_err());
    }

    #[test]
    fn one_name_of_two_owners_is_two_sessions() {
        let other = Owner::from_bytes([7; 16]);
        let id = SessionId::random(other);
        assert_ne!(SessionId::parse(Owner::ANYBODY, &id.to_string()), Ok(id));
        assert_eq!(SessionId::parse(other, &id.to_string()), Ok(id));
        assert_eq!(SessionId::from_bytes(&id.to_bytes()), id);
    }

    #[test]
    fn a_log_does_not_give_a_session_away() {
        let id = SessionId::random(Owner::ANYBODY);
        assert!(format!("{id:?}").len() < 12);
    }

    #[tokio::test]
    async fn a_waiting_request_is_told_when_a_newer_one_arrives() {
        let lanes = Sequencer::default();
        let id = (SessionId::random(Owner::ANYBODY), SystemTime::now());
        let old = lanes.enter(id, 4);
        let retry = lanes.enter(id, 4);
        let other = lanes.enter((SessionId::random(Owner::ANYBODY), id.1), 1);
        let replaced = lanes.enter((id.0, id.1 + Duration::from_nanos(1)), 1);
        assert!(!old.is_superseded() && !retry.is_superseded());
        let waiting = tokio::spawn(async move {
            old.superseded().await;
            old.seq
        });
        let new = lanes.enter(id, 5);
        assert_eq!(waiting.await.unwrap(), 4);
        assert!(retry.is_superseded() && !new.is_superseded() && !other.is_superseded() && !replaced.is_superseded());
        assert!(lanes.enter(id, 3).is_superseded());
    }

    #[test]
    fn a_lane_goes_with_its_last_request() {
        let lanes = Sequencer::default();
        let id = (SessionId::random(Owner::ANYBODY), SystemTime::now());
        let (a, b) = (lanes.enter(id, 1), lanes.enter(id, 2));
        drop(a);
        assert_eq!(lanes.lock().len(), 1);
        drop(b);
        assert_eq!(lanes.lock().len(), 0);
    }
}
