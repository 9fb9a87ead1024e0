//! The way to one crew: a request runs, waits for as long as it makes sense, or is sent away.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::PoolError;
use super::queue::{Arrival, Queue, QueueKey};
use super::worker_threads::WorkerThreads;
use crate::client::Tenant;

/// Who is told when its turn has come; dropped when it is sent away.
type Waiter = oneshot::Sender<AdmissionPermit>;

/// A crew and the queue before it.
#[derive(Debug)]
pub(crate) struct AdmissionQueue {
    pub(crate) crew: WorkerThreads,
    queue: Mutex<Queue<Waiter>>,
    /// Longest wait.
    max_wait: Duration,
    full: AtomicU64,
    late: AtomicU64,
}

/// What a gate knows of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Requests that run.
    pub running: usize,
    /// Requests that wait.
    pub waiting: usize,
    /// Requests that were sent away so far because the queue was full.
    pub full: u64,
    /// Requests that were sent away so far because their turn did not come in time.
    pub late: u64,
}

/// A client's right to run, passed on when it is dropped.
#[derive(Debug)]
pub(crate) struct AdmissionPermit(Option<(Arc<AdmissionQueue>, Tenant)>);

/// Someone who waits; leaves the queue when dropped.
struct QueuePosition<'a> {
    gate: &'a AdmissionQueue,
    lane: QueueKey,
    id: u64,
}

impl Drop for QueuePosition<'_> {
    fn drop(&mut self) {
        self.gate.lock().leave(self.lane, self.id);
    }
}

impl AdmissionQueue {
    pub(crate) fn new(crew: WorkerThreads, turns: usize, queue: usize, max_wait: Duration) -> Arc<Self> {
        let queue = Mutex::new(Queue::new(turns, queue));
        Arc::new(Self { crew, queue, max_wait, full: AtomicU64::new(0), late: AtomicU64::new(0) })
    }

    fn lock(&self) -> MutexGuard<'_, Queue<Waiter>> {
        // Nothing panics half-way through a change.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn is_full(&self) -> bool {
        self.lock().is_full()
    }

    pub(crate) fn refuses(&self, lane: QueueKey) -> bool {
        self.lock().refuses(lane)
    }

    pub(crate) fn load(&self) -> Load {
        let queue = self.lock();
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Load { running: queue.running(), waiting: queue.waiting(), full: count(&self.full), late: count(&self.late) }
    }

    /// Waits for a turn. Dropping the future leaves the queue.
    pub(crate) async fn enter(self: &Arc<Self>, lane: QueueKey) -> Result<AdmissionPermit, PoolError> {
        let mut called = None;
        let arrival = self.lock().arrive(lane, Instant::now(), || {
            let (waiter, turn) = oneshot::channel();
            called = Some(turn);
            waiter
        });
        let id = match arrival {
            Arrival::Runs => return Ok(AdmissionPermit(Some((Arc::clone(self), lane.tenant())))),
            Arrival::Refused => {
                self.full.fetch_add(1, Ordering::Relaxed);
                return Err(PoolError::Full);
            }
            Arrival::Waits(id) => id,
            // Dropped outside the lock, which tells whoever waited there.
            Arrival::Replaces(id, _sent_away) => {
                self.full.fetch_add(1, Ordering::Relaxed);
                id
            }
        };
        let place = QueuePosition { gate: self, lane, id };
        let Some(called) = called else { return Err(PoolError::Full) };
        let turn = match tokio::time::timeout(self.max_wait, called).await {
            Ok(turn) => turn.map_err(|_| PoolError::Full),
            Err(_) => {
                self.late.fetch_add(1, Ordering::Relaxed);
                Err(PoolError::Late { max_wait: self.max_wait })
            }
        };
        drop(place);
        turn
    }
}

impl Drop for AdmissionPermit {
    fn drop(&mut self) {
        let Some((gate, tenant)) = self.0.take() else { return };
        let mut ended = Some(tenant);
        loop {
            let called = {
                let (mut queue, now) = (gate.lock(), Instant::now());
                if let Some(tenant) = ended.take() {
                    queue.end(tenant, now);
                }
                queue.call(now)
            };
            let Some((tenant, waiter)) = called else { return };
            if let Err(mut unheard) = waiter.send(Self(Some((Arc::clone(&gate), tenant)))) {
                // It has left this moment: its turn ends here, and not by being dropped.
                unheard.0 = None;
                ended = Some(tenant);
            }
        }
    }
}
