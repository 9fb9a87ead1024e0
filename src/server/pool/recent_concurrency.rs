//! How many pictures were drawn at once of late. Threads are shared among so many: a lone picture gets them all, pictures side by side get one
//! each, which is a fifth faster for all of them together than splitting every one.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A picture that was drawn within the last one or two of these still counts: a client that comes again at once is no idle processor.
const LATE: Duration = Duration::from_millis(5);

/// Pictures that are drawn now and were of late. Cloning shares them.
#[derive(Clone, Debug)]
pub(crate) struct RecentConcurrency(Arc<Mutex<Seen>>);

#[derive(Debug)]
struct Seen {
    now: usize,
    most: usize,
    most_before: usize,
    since: Instant,
}

/// One of the crowd, until dropped.
#[derive(Debug)]
pub struct DrawGuard(RecentConcurrency);

impl Default for RecentConcurrency {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Seen { now: 0, most: 0, most_before: 0, since: Instant::now() })))
    }
}

impl RecentConcurrency {
    /// Joins; the number is the most there were at once of late, the newcomer included.
    pub(crate) fn join(&self) -> (DrawGuard, usize) {
        let mut seen = self.lock();
        seen.now += 1;
        let age = seen.since.elapsed();
        if age >= LATE {
            // Who was here at the end of a period was here through what followed without a newcomer.
            seen.most_before = if age >= 2 * LATE { seen.now } else { seen.most };
            seen.most = seen.now;
            seen.since = Instant::now();
        }
        seen.most = seen.most.max(seen.now);
        let most = seen.most.max(seen.most_before);
        drop(seen);
        (DrawGuard(self.clone()), most)
    }

    fn lock(&self) -> MutexGuard<'_, Seen> {
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
        let crowd = RecentConcurrency::default();
        let (alone, most) = crowd.join();
        assert_eq!(most, 1);
        let (second, most) = crowd.join();
        assert_eq!(most, 2);
        drop((alone, second));
        // At once after: still two, unless this machine has slept meanwhile.
        let began = Instant::now();
        let (third, most) = crowd.join();
        assert!(most == 2 || began.elapsed() >= LATE);
        drop(third);
        std::thread::sleep(2 * LATE);
        assert_eq!(crowd.join().1, 1);
    }
}
