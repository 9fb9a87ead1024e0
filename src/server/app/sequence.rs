//! The newest pose wins: a request with a lower `seq` than another one of its session is not drawn.
//! The store enforces this across processes; this module cancels requests that wait in this
//! process.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use tokio::sync::watch;

use crate::cache::Retained;
use crate::session::SessionId;

/// One incarnation of a session; `seq` restarts with each.
pub type Incarnation = (SessionId, SystemTime);

/// The sessions with numbered requests in progress.
#[derive(Clone, Debug, Default)]
pub struct Sequencer(Arc<Mutex<HashMap<Incarnation, Arc<SessionSequence>>>>);

/// The numbered requests of one incarnation of a session.
#[derive(Debug)]
struct SessionSequence {
    newest: watch::Sender<u64>,
    /// Builds of superseded requests, which the newer request needs.
    builds: Retained,
}

/// A numbered request in progress.
#[derive(Debug)]
pub struct SequencePosition {
    sequencer: Sequencer,
    incarnation: Incarnation,
    sequence: Arc<SessionSequence>,
    seq: u64,
}

impl Sequencer {
    /// Enters a request, which supersedes those with lower numbers.
    pub fn enter(&self, incarnation: Incarnation, seq: u64) -> SequencePosition {
        let new = || {
            Arc::new(SessionSequence {
                newest: watch::Sender::new(seq),
                builds: Retained::default(),
            })
        };
        let sequence = Arc::clone(self.lock().entry(incarnation).or_insert_with(new));
        sequence.newest.send_if_modified(|newest| {
            let higher = seq > *newest;
            *newest = seq.max(*newest);
            higher
        });
        SequencePosition {
            sequencer: self.clone(),
            incarnation,
            sequence,
            seq,
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Incarnation, Arc<SessionSequence>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SequencePosition {
    /// Whether a higher number has been entered.
    pub fn is_superseded(&self) -> bool {
        self.newest() > self.seq
    }

    /// The highest number that has been entered.
    pub fn newest(&self) -> u64 {
        *self.sequence.newest.borrow()
    }

    /// Waits until a higher number is entered.
    pub async fn superseded(&self) {
        let mut newest = self.sequence.newest.subscribe();
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = newest.wait_for(|newest| *newest > self.seq).await;
    }

    /// Builds that continue as long as a numbered request of the session is in progress.
    pub fn builds(&self) -> &Retained {
        &self.sequence.builds
    }
}

impl Drop for SequencePosition {
    fn drop(&mut self) {
        let mut sequencer = self.sequencer.lock();
        // One reference is the map's, one is this. References are only cloned under the lock.
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
        let sequencer = Sequencer::default();
        let id = (SessionId::random(Owner::ANYBODY), SystemTime::now());
        let old = sequencer.enter(id, 4);
        let retry = sequencer.enter(id, 4);
        let other = sequencer.enter((SessionId::random(Owner::ANYBODY), id.1), 1);
        let replaced = sequencer.enter((id.0, id.1 + Duration::from_nanos(1)), 1);
        assert!(!old.is_superseded() && !retry.is_superseded());
        let waiting = tokio::spawn(async move {
            old.superseded().await;
            old.seq
        });
        let new = sequencer.enter(id, 5);
        assert_eq!(waiting.await.unwrap(), 4);
        assert!(
            retry.is_superseded()
                && !new.is_superseded()
                && !other.is_superseded()
                && !replaced.is_superseded()
        );
        assert!(sequencer.enter(id, 3).is_superseded());
    }

    #[test]
    fn a_sequence_ends_with_its_last_request() {
        let sequencer = Sequencer::default();
        let id = (SessionId::random(Owner::ANYBODY), SystemTime::now());
        let (a, b) = (sequencer.enter(id, 1), sequencer.enter(id, 2));
        drop(a);
        assert_eq!(sequencer.lock().len(), 1);
        drop(b);
        assert_eq!(sequencer.lock().len(), 0);
    }
}
