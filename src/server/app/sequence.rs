//! The newest pose wins: a request whose `seq` is lower than one already seen costs no rendering, also while it waits. The rule across processes
//! is the store's; this wakes those that wait in this process.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use tokio::sync::watch;

use crate::cache::Retained;
use crate::session::SessionId;

/// One incarnation of a session; `seq` restarts with each.
pub type Incarnation = (SessionId, SystemTime);

/// The sessions for which numbered requests are under way.
#[derive(Clone, Debug, Default)]
pub struct Sequencer(Arc<Mutex<HashMap<Incarnation, Arc<SessionSequence>>>>);

/// The numbered requests of one incarnation of a session.
#[derive(Debug)]
struct SessionSequence {
    newest: watch::Sender<u64>,
    /// What a superseded request was building, the newer one needs.
    builds: Retained,
}

/// A numbered request under way.
#[derive(Debug)]
pub struct SequencePosition {
    sequencer: Sequencer,
    incarnation: Incarnation,
    sequence: Arc<SessionSequence>,
    seq: u64,
}

impl Sequencer {
    /// Enters a request; those with a lower number are superseded from now on.
    #[must_use]
    pub fn enter(&self, incarnation: Incarnation, seq: u64) -> SequencePosition {
        let new = || Arc::new(SessionSequence { newest: watch::Sender::new(seq), builds: Retained::default() });
        let sequence = Arc::clone(self.lock().entry(incarnation).or_insert_with(new));
        sequence.newest.send_if_modified(|newest| {
            let higher = seq > *newest;
            *newest = seq.max(*newest);
            higher
        });
        SequencePosition { sequencer: self.clone(), incarnation, sequence, seq }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Incarnation, Arc<SessionSequence>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SequencePosition {
    /// A higher number has been seen.
    #[must_use]
    pub fn is_superseded(&self) -> bool {
        *self.sequence.newest.borrow() > self.seq
    }

    /// Waits until a higher number is seen.
    pub async fn superseded(&self) {
        let mut newest = self.sequence.newest.subscribe();
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = newest.wait_for(|newest| *newest > self.seq).await;
    }

    /// Builds that go on for as long as a numbered request of the session is under way.
    #[must_use]
    pub fn builds(&self) -> &Retained {
        &self.sequence.builds
    }
}

impl Drop for SequencePosition {
    fn drop(&mut self) {
        let mut sequencer = self.sequencer.lock();
        // The map's and this one: arcs are cloned under the lock alone.
        if Arc::strong_count(&self.sequence) <= 2 {
            sequencer.remove(&self.incarnation);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::Owner;
    use std::time::Duration;

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
