//! Numbers that were given while the server did not answer in time. Whoever asks next for their session tells it too; but the last of a drag has
//! no next one, so each is told as soon as the server hears. A process that is killed before has given a number that nobody else knows.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tokio::sync::watch;

use super::script::Given;
use crate::session::SessionId;

/// Most sessions of which something is owed, some 100 bytes each. What is more is told with the next question, as all is.
const MOST: usize = 1 << 16;

/// A number that the server has not been told yet, and when nobody has a use for it any more.
#[derive(Clone, Copy)]
pub(crate) struct Debt {
    pub(crate) given: Given,
    pub(crate) until: Instant,
}

/// All of them.
#[derive(Default)]
pub(crate) struct Owed {
    all: Mutex<HashMap<SessionId, Debt>>,
    is_telling: watch::Sender<bool>,
}

impl Owed {
    /// Owes the highest number of a session's newest life: one that was told in vain may be of the life before.
    /// `true`: nobody tells yet, so the caller has to.
    #[must_use]
    pub(crate) fn owe(&self, id: SessionId, debt: Debt) -> bool {
        let mut all = self.lock();
        let owes_more = |before: &Debt| (before.given.created, before.given.seq) > (debt.given.created, debt.given.seq);
        if !all.get(&id).is_some_and(owes_more) && (all.len() < MOST || all.contains_key(&id)) {
            all.insert(id, debt);
        }
        // Under the lock, as in `take`: either that sees the newcomer, or the newcomer sees that nobody tells any more.
        self.is_telling.send_if_modified(|is| !std::mem::replace(is, true))
    }

    /// Some of them, to be told now; none when all have been told.
    pub(crate) fn take(&self, most: usize) -> Vec<(SessionId, Debt)> {
        let mut all = self.lock();
        let ids: Vec<SessionId> = all.keys().take(most).copied().collect();
        if ids.is_empty() {
            self.is_telling.send_replace(false);
        }
        ids.into_iter().filter_map(|id| Some((id, all.remove(&id)?))).collect()
    }

    /// Waits until nothing is owed.
    pub(crate) async fn nothing(&self) {
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = self.is_telling.subscribe().wait_for(|is| !is).await;
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<SessionId, Debt>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::Owner;
    use crate::session::Revision;
    use std::time::{Duration, SystemTime};

    #[test]
    fn the_highest_of_the_newest_life_is_owed_and_one_tells() {
        let (owed, id) = (Owed::default(), SessionId::random(Owner::ANYBODY));
        let (revision, created, until) = (Revision::random(), SystemTime::now(), Instant::now());
        let debt = |seq, created| Debt { given: Given { revision, created, seq: Some(seq) }, until };
        assert!(owed.owe(id, debt(5, created)) && !owed.owe(id, debt(3, created)));
        assert!(!owed.owe(SessionId::random(Owner::ANYBODY), debt(1, created)));
        assert_eq!(owed.take(9).iter().map(|(_, debt)| debt.given.seq.unwrap()).max(), Some(5));
        assert!(!owed.owe(id, debt(5, created)), "what was taken is still being told");
        let anew = created + Duration::from_nanos(1);
        assert!(!owed.owe(id, debt(2, anew)));
        assert!(!owed.owe(id, debt(9, created)), "of the life before, told in vain");
        assert_eq!(owed.take(9).iter().map(|(_, debt)| debt.given.seq).collect::<Vec<_>>(), [Some(2)]);
        assert!(owed.take(9).is_empty());
        assert!(owed.owe(id, debt(3, anew)), "somebody else tells");
    }
}
