//! Memory that was released, and that the allocator may still keep. It returns large blocks at
//! once and the others when it is told to, which the program does every few seconds; so the
//! process may have all of its budget in use, and beside it what the requests before have freed.
//! The thread that tells the allocator is woken early if that would be too much.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::Thread;

/// Most bytes above the budget that are in use or freed since the allocator was told.
const MAX_ABOVE: u64 = 24 << 20;

/// That of the process, which has one allocator.
pub static FREED: Freed = Freed::new();

/// Bytes that were released since the allocator was told to return what is free, and who tells it.
#[derive(Debug)]
pub struct Freed {
    bytes: AtomicU64,
    returner: OnceLock<Thread>,
}

impl Freed {
    const fn new() -> Self {
        Self {
            bytes: AtomicU64::new(0),
            returner: OnceLock::new(),
        }
    }

    /// Names the thread that tells the allocator: it is unparked when it should not wait.
    pub fn returned_by(&self, thread: Thread) {
        let _ = self.returner.set(thread);
    }

    /// What was released until now will have been returned.
    pub fn forget(&self) {
        self.bytes.store(0, Ordering::Relaxed);
    }

    pub(super) fn add(&self, bytes: u64) {
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
    }

    /// After a reservation, when `taken` bytes of a budget of `total` are reserved: wakes the
    /// returner if these and what was freed are too much.
    pub(super) fn wake_if_too_much(&self, taken: u64, total: u64) {
        let resident = taken.saturating_add(self.bytes.load(Ordering::Relaxed));
        if resident > total.saturating_add(MAX_ABOVE)
            && let Some(returner) = self.returner.get()
        {
            returner.unpark();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::mpsc;
    use std::thread;

    use super::*;

    #[test]
    fn the_returner_is_woken_when_use_and_freed_memory_are_above_the_budget() {
        const TOTAL: u64 = 100 << 20;
        let freed = Arc::new(Freed::new());
        // No task waits.
        freed.add(1 << 40);
        freed.wake_if_too_much(TOTAL, TOTAL);
        freed.forget();
        let (tells, told) = mpsc::channel();
        let returner = {
            let freed = Arc::clone(&freed);
            thread::spawn(move || {
                freed.returned_by(thread::current());
                tells.send(()).unwrap();
                thread::park();
                tells.send(()).unwrap();
            })
        };
        told.recv().unwrap();
        freed.add(MAX_ABOVE);
        freed.wake_if_too_much(TOTAL, TOTAL);
        freed.add(TOTAL / 2);
        freed.wake_if_too_much(TOTAL / 2, TOTAL);
        assert!(told.try_recv().is_err(), "as much as may be");
        freed.wake_if_too_much(TOTAL / 2 + 1, TOTAL);
        told.recv().unwrap();
        returner.join().unwrap();
    }
}
