//! The recent number of simultaneous drawings. The threads are shared among that number: a lone drawing gets all of them; simultaneous
//! drawings get one each, which makes all of them together a fifth faster than splitting each (measured; see README.md).

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A drawing of this or the previous period counts: a client that returns immediately leaves no idle processor.
const PERIOD: Duration = Duration::from_millis(5);

/// Drawings in progress, and their largest number of the current and the previous period. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct RecentConcurrency(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    now: usize,
    most: usize,
    most_before: usize,
    since: Instant,
}

/// A drawing in progress, until dropped.
#[derive(Debug)]
pub struct DrawGuard(RecentConcurrency);

impl Default for RecentConcurrency {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(State { now: 0, most: 0, most_before: 0, since: Instant::now() })))
    }
}

impl RecentConcurrency {
    /// Begins a drawing; the number is the largest recent number of simultaneous drawings, this one included.
    pub(crate) fn begin(&self) -> (DrawGuard, usize) {
        let mut state = self.lock();
        state.now += 1;
        let age = state.since.elapsed();
        if age >= PERIOD {
            // The drawings at the end of a period lasted through the following periods without a newcomer.
            state.most_before = if age >= 2 * PERIOD { state.now } else { state.most };
            state.most = state.now;
            state.since = Instant::now();
        }
        state.most = state.most.max(state.now);
        let most = state.most.max(state.most_before);
        drop(state);
        (DrawGuard(self.clone()), most)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for DrawGuard {
    fn drop(&mut self) {
        self.0.lock().now -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_of_late_counts_and_is_forgotten() {
        let recent = RecentConcurrency::default();
        let (alone, most) = recent.begin();
        assert_eq!(most, 1);
        let (second, most) = recent.begin();
        assert_eq!(most, 2);
        drop((alone, second));
        // At once after: still two, unless this machine has slept meanwhile.
        let began = Instant::now();
        let (third, most) = recent.begin();
        assert!(most == 2 || began.elapsed() >= PERIOD);
        drop(third);
        std::thread::sleep(2 * PERIOD);
        assert_eq!(recent.begin().1, 1);
    }
}
