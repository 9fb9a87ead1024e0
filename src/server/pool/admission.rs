//! Admission to one class of work: a request runs, waits up to `max_wait`, or is rejected.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::PoolError;
use super::queue::{Arrival, FairQueue, QueueKey};
use super::worker_threads::WorkerThreads;
use crate::client::Tenant;

/// Receives the permit of a waiting request; dropped when the request is rejected.
type Waiter = oneshot::Sender<AdmissionPermit>;

/// The threads of one class and the queue in front of them.
#[derive(Debug)]
pub(crate) struct AdmissionQueue {
    pub(crate) threads: WorkerThreads,
    queue: Mutex<FairQueue<Waiter>>,
    max_wait: Duration,
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
pub(crate) struct AdmissionPermit(Option<(Arc<AdmissionQueue>, Tenant)>);

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
    pub(crate) fn new(threads: WorkerThreads, permits: usize, queue: usize, max_wait: Duration) -> Arc<Self> {
        let queue = Mutex::new(FairQueue::new(permits, queue));
        Arc::new(Self { threads, queue, max_wait, full: AtomicU64::new(0), late: AtomicU64::new(0) })
    }

    fn lock(&self) -> MutexGuard<'_, FairQueue<Waiter>> {
        // No change panics half-way.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
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
        Load { running: queue.running(), waiting: queue.waiting(), full: count(&self.full), late: count(&self.late) }
    }

    /// Waits for a permit. Dropping the future leaves the queue.
    pub(crate) async fn enter(self: &Arc<Self>, key: QueueKey) -> Result<AdmissionPermit, PoolError> {
        let (waiter, permit) = oneshot::channel();
        let arrival = self.lock().arrive(key, Instant::now(), waiter);
        let id = match arrival {
            Arrival::Runs => return Ok(AdmissionPermit(Some((Arc::clone(self), key.tenant())))),
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
        let _position = QueuePosition { queue: self, key, id };
        match tokio::time::timeout(self.max_wait, permit).await {
            Ok(permit) => permit.map_err(|_| PoolError::Full),
            Err(_) => {
                self.late.fetch_add(1, Ordering::Relaxed);
                Err(PoolError::Late { max_wait: self.max_wait })
            }
        }
    }
}

impl Drop for AdmissionPermit {
    fn drop(&mut self) {
        let Some((queue, tenant)) = self.0.take() else { return };
        let mut ended = Some(tenant);
        loop {
            let next = {
                let (mut queue, now) = (queue.lock(), Instant::now());
                if let Some(tenant) = ended.take() {
                    queue.end(tenant, now);
                }
                queue.next(now)
            };
            let Some((tenant, waiter)) = next else { return };
            if let Err(mut returned) = waiter.send(Self(Some((Arc::clone(&queue), tenant)))) {
                // The request left at this moment: its permit ends here, not by being dropped.
                returned.0 = None;
                ended = Some(tenant);
            }
        }
    }
}
