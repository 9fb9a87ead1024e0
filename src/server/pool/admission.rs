//! Admission to one class of work: a request runs, waits up to `max_wait`, or is rejected. A long
//! job gives way to other clients.

use std::cell::Cell;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::PoolError;
use super::queue::{Arrival, FairQueue, QueueKey};
use super::worker_threads::WorkerThreads;
use crate::client::Tenant;

/// How long until a job looks again if there was no client that has used less.
const LOOK_AGAIN: Duration = Duration::from_millis(10);
/// A job goes on without a permit after this time: permits may be held by requests that wait for
/// what it builds.
const MAX_PAUSE: Duration = Duration::from_secs(1);
/// A thread of a lower class that makes way for a drag looks this often whether it has ended.
const STAND_ASIDE_LOOK: Duration = Duration::from_micros(100);
/// The longest time for which it stands aside; afterwards it works for as long as it has stood.
const MAX_STAND_ASIDE: Duration = Duration::from_millis(4);
/// A paused job looks this often whether it is cancelled.
const PAUSED_LOOK: Duration = Duration::from_millis(5);

/// What gets the permit.
#[derive(Debug)]
enum Waiter {
    /// A waiting request; dropped when the request is rejected.
    Request(oneshot::Sender<AdmissionPermit>),
    /// A job that has given way, on its sleeping thread.
    Job(Arc<PausedJob>),
}

#[derive(Debug)]
struct PausedJob {
    has_permit: AtomicBool,
    thread: Thread,
}

/// The threads of one class and the queue in front of them.
#[derive(Debug)]
pub(crate) struct AdmissionQueue {
    pub(crate) threads: WorkerThreads,
    queue: Mutex<FairQueue<Waiter>>,
    /// Waiting requests and paused jobs, for jobs that look without the lock.
    waiting: AtomicUsize,
    /// Requests that run, for threads of a lower class.
    running: Arc<AtomicUsize>,
    /// Those of the class above, for which the threads of this one stand aside.
    above: Option<Arc<AtomicUsize>>,
    max_wait: Duration,
    /// How long a job runs before it gives way to a client that has used less.
    turn: Duration,
    /// The origin of the times of turns.
    began: Instant,
    full: AtomicU64,
    late: AtomicU64,
}

/// The state of an admission queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Requests that run.
    pub running: usize,
    /// Requests that wait.
    pub waiting: usize,
    /// Requests rejected so far because the queue was full.
    pub full: u64,
    /// Requests rejected so far because no worker was free in time.
    pub late: u64,
}

/// A client's right to run; passed to the next request when dropped.
#[derive(Debug)]
pub(crate) struct AdmissionPermit {
    queue: Arc<AdmissionQueue>,
    tenant: Tenant,
    /// When the job may give way, nanoseconds since the queue began.
    turn_ends: AtomicU64,
    /// Held by the thread of the job that waits until the job goes on; other threads of the job
    /// wait for it.
    pause: Mutex<()>,
    is_paused: AtomicBool,
    /// It was never used: its request had left.
    is_returned: bool,
}

/// The lock of the queue. When it is dropped, jobs see whether anybody waits.
struct QueueGuard<'a> {
    queue: MutexGuard<'a, FairQueue<Waiter>>,
    waiting: &'a AtomicUsize,
    running: &'a AtomicUsize,
}

impl Deref for QueueGuard<'_> {
    type Target = FairQueue<Waiter>;

    fn deref(&self) -> &Self::Target {
        &self.queue
    }
}

impl DerefMut for QueueGuard<'_> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.queue
    }
}

impl Drop for QueueGuard<'_> {
    fn drop(&mut self) {
        self.waiting.store(
            self.queue.waiting() + self.queue.paused(),
            Ordering::Relaxed,
        );
        self.running.store(self.queue.running(), Ordering::Relaxed);
    }
}

/// A place in the queue; leaves the queue when dropped.
struct QueuePosition<'a> {
    queue: &'a AdmissionQueue,
    key: QueueKey,
    id: u64,
}

impl Drop for QueuePosition<'_> {
    fn drop(&mut self) {
        self.queue.lock().leave(self.key, self.id);
    }
}

impl AdmissionQueue {
    /// `turn`: how long a job runs before it gives way to a client that has used less. `above`:
    /// the class for which the threads of this one stand aside.
    pub(crate) fn new(
        threads: WorkerThreads,
        permits: usize,
        queue: usize,
        max_wait: Duration,
        turn: Duration,
        above: Option<&Self>,
    ) -> Arc<Self> {
        Arc::new(Self {
            threads,
            queue: Mutex::new(FairQueue::new(permits, queue)),
            waiting: AtomicUsize::new(0),
            running: Arc::default(),
            above: above.map(|above| Arc::clone(&above.running)),
            max_wait,
            turn,
            began: Instant::now(),
            full: AtomicU64::new(0),
            late: AtomicU64::new(0),
        })
    }

    fn lock(&self) -> QueueGuard<'_> {
        // No change panics half-way.
        QueueGuard {
            queue: self.queue.lock().unwrap_or_else(PoisonError::into_inner),
            waiting: &self.waiting,
            running: &self.running,
        }
    }

    /// Nanoseconds since the queue began.
    fn nanos(&self, now: Instant) -> u64 {
        u64::try_from(now.saturating_duration_since(self.began).as_nanos()).unwrap_or(u64::MAX)
    }

    /// Passes free permits on.
    fn pass_on(self: &Arc<Self>) {
        let mut returned = None;
        loop {
            let next = {
                let (mut queue, now) = (self.lock(), Instant::now());
                if let Some(tenant) = returned.take() {
                    queue.end(tenant, now);
                }
                queue.next(now)
            };
            match next {
                None => return,
                Some((_, Waiter::Job(job))) => {
                    job.has_permit.store(true, Ordering::Release);
                    job.thread.unpark();
                }
                Some((tenant, Waiter::Request(waiter))) => {
                    if let Err(mut permit) =
                        waiter.send(AdmissionPermit::new(Arc::clone(self), tenant))
                    {
                        // The request left at this moment: its permit ends here, not by being
                        // dropped.
                        permit.is_returned = true;
                        returned = Some(tenant);
                    }
                }
            }
        }
    }

    pub(crate) fn is_full(&self) -> bool {
        self.lock().is_full()
    }

    pub(crate) fn rejects(&self, key: QueueKey) -> bool {
        self.lock().rejects(key)
    }

    pub(crate) fn load(&self) -> Load {
        let queue = self.lock();
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Load {
            running: queue.running(),
            waiting: queue.waiting(),
            full: count(&self.full),
            late: count(&self.late),
        }
    }

    /// Waits for a permit. Dropping the future leaves the queue.
    pub(crate) async fn enter(
        self: &Arc<Self>,
        key: QueueKey,
    ) -> Result<AdmissionPermit, PoolError> {
        let (waiter, permit) = oneshot::channel();
        let arrival = self
            .lock()
            .arrive(key, Instant::now(), Waiter::Request(waiter));
        let id = match arrival {
            Arrival::Runs => return Ok(AdmissionPermit::new(Arc::clone(self), key.tenant())),
            Arrival::Rejected => {
                self.full.fetch_add(1, Ordering::Relaxed);
                return Err(PoolError::Full);
            }
            Arrival::Waits(id) => id,
            // The rejected waiter is dropped outside of the lock, which wakes its request.
            Arrival::Replaces(id, _rejected) => {
                self.full.fetch_add(1, Ordering::Relaxed);
                id
            }
        };
        let _position = QueuePosition {
            queue: self,
            key,
            id,
        };
        match tokio::time::timeout(self.max_wait, permit).await {
            Ok(permit) => permit.map_err(|_| PoolError::Full),
            Err(_) => {
                self.late.fetch_add(1, Ordering::Relaxed);
                Err(PoolError::Late {
                    max_wait: self.max_wait,
                })
            }
        }
    }
}

impl AdmissionPermit {
    fn new(queue: Arc<AdmissionQueue>, tenant: Tenant) -> Self {
        let permit = Self {
            tenant,
            turn_ends: AtomicU64::new(0),
            pause: Mutex::new(()),
            is_paused: AtomicBool::new(false),
            is_returned: false,
            queue,
        };
        permit.begin_turn(permit.queue.turn);
        permit
    }

    fn begin_turn(&self, turn: Duration) {
        self.turn_ends
            .store(self.queue.nanos(Instant::now() + turn), Ordering::Relaxed);
    }

    /// Whether the job has given way and waits.
    pub(crate) fn is_paused(&self) -> bool {
        self.is_paused.load(Ordering::Relaxed)
    }

    /// Called by a job between parts of its work: if its turn is over and another client that has
    /// used less waits, that client gets the permit, and this thread sleeps until the job is next
    /// or cancelled. Costs nothing while no request waits and none of the class above runs.
    #[inline]
    pub(crate) fn give_way(&self, is_cancelled: &dyn Fn() -> bool) {
        if let Some(above) = &self.queue.above
            && above.load(Ordering::Relaxed) > 0
        {
            stand_aside(above);
        }
        if self.queue.waiting.load(Ordering::Relaxed) > 0 {
            self.look_for_others(is_cancelled);
        }
    }

    #[cold]
    fn look_for_others(&self, is_cancelled: &dyn Fn() -> bool) {
        let is_over = || self.queue.nanos(Instant::now()) >= self.turn_ends.load(Ordering::Relaxed);
        if !self.is_paused() && !is_over() {
            return;
        }
        // Another thread of the job may have waited meanwhile.
        let _pause = self.pause.lock().unwrap_or_else(PoisonError::into_inner);
        if !is_over() || is_cancelled() {
            return;
        }
        let job = Arc::new(PausedJob {
            has_permit: AtomicBool::new(false),
            thread: std::thread::current(),
        });
        let id = {
            let (mut queue, now) = (self.queue.lock(), Instant::now());
            // The next job needs a thread in the place of this one.
            if !queue.gives_way(self.tenant, now) || !self.queue.threads.reserve(queue.paused() + 1)
            {
                drop(queue);
                return self.begin_turn(LOOK_AGAIN);
            }
            queue.pause(self.tenant, now, Waiter::Job(Arc::clone(&job)))
        };
        self.is_paused.store(true, Ordering::Relaxed);
        self.queue.pass_on();
        let began = Instant::now();
        while !job.has_permit.load(Ordering::Acquire)
            && !is_cancelled()
            && began.elapsed() < MAX_PAUSE
        {
            std::thread::park_timeout(PAUSED_LOOK);
        }
        self.queue.lock().resume(id, Instant::now());
        self.begin_turn(self.queue.turn);
        self.is_paused.store(false, Ordering::Relaxed);
    }
}

/// Sleeps while requests of the class above run. Niceness alone does not let them begin at once: a
/// scheduler that is fair over some milliseconds lets each busy thread have its slice first, and a
/// thread that was interrupted while it holds a lock keeps it until its next one.
///
/// Whether it stood aside.
#[cold]
fn stand_aside(above: &AtomicUsize) -> bool {
    thread_local! {
        /// When this thread may stand aside again.
        static AGAIN: Cell<Option<Instant>> = const { Cell::new(None) };
    }
    let began = Instant::now();
    if AGAIN.get().is_some_and(|again| began < again) {
        return false;
    }
    while above.load(Ordering::Relaxed) > 0 && began.elapsed() < MAX_STAND_ASIDE {
        std::thread::sleep(STAND_ASIDE_LOOK);
    }
    // So this class has half of the time beside any number of drags.
    let now = Instant::now();
    AGAIN.set(now.checked_add(now - began));
    true
}

impl Drop for AdmissionPermit {
    fn drop(&mut self) {
        if !self.is_returned {
            self.queue.lock().end(self.tenant, Instant::now());
            self.queue.pass_on();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_stands_aside_for_a_time_and_then_works_as_long() {
        let running = AtomicUsize::new(1);
        let began = Instant::now();
        assert!(stand_aside(&running));
        assert!(began.elapsed() >= MAX_STAND_ASIDE);
        assert!(
            (0..100_000).any(|_| !stand_aside(&running)),
            "it always sleeps"
        );
        running.store(0, Ordering::Relaxed);
        while !stand_aside(&running) {}
    }
}
