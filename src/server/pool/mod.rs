//! Admission and the compute threads. A request goes through one of two gates: work on a session that is warm (a drag), and everything that
//! decodes or fills tables first (an upload). Each has as many turns and threads as there are workers, so that milliseconds never wait behind
//! seconds, and either may use the whole machine while the other is idle; and one turn and thread more, for a client that would otherwise
//! wait for the long requests of others. A request runs at once, waits for its turn at most for the gate's `max_wait`, or is refused;
//! which request is next is decided by `queue`, fairly between clients. No async thread ever computes, no compute thread ever waits for a
//! client.
//!
//! A third gate has no threads: a request passes it while it waits for a session's file, to the store or from it, and holds no worker.
//!
//! A closure runs on one thread. What is worth splitting (tables of coefficients, many places) goes on to rayon's threads,
//! [`Pool::run_parallel`]; the strips of a picture are taken by helpers, as many as no other picture wants (`recent_concurrency`). A helper
//! leaves after its strip when a request waits for a thread.
//!
//! A ticket is shared by everything that computes for the request: it is given back when the last closure has ended, also when the
//! request's future was dropped before.

mod admission;
mod queue;
mod recent_concurrency;
mod worker_threads;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, TryLockError};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};
use tokio::sync::oneshot;

pub use admission::Load;
use admission::{AdmissionPermit, AdmissionQueue};
pub use queue::QueueKey;
pub use recent_concurrency::DrawGuard;
use recent_concurrency::RecentConcurrency;
use worker_threads::WorkerThreads;

use crate::observe::Scope;
use crate::observe::scope::stage;

/// The operating system gives no threads.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct NoThreads(String);

/// Why nothing was computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PoolError {
    /// All workers are busy and the queue is full, or became so with requests that come first.
    #[error("all workers are busy and the queue is full")]
    Full,
    /// The turn did not come in time.
    #[error("no worker was free within the {} ms that this may wait", .max_wait.as_millis())]
    Late {
        /// The longest wait.
        max_wait: Duration,
    },
    /// A computation panicked; its message is in the log.
    #[error("a computation failed")]
    Panicked,
}

/// Uploads get a third of the time that drags get where both want the same processor, and all of it where no drag does.
const UPLOADS_NICE: i32 = 5;

/// Files of sessions that are sent to the store or fetched from it at one time, and one more of a client that has none: a slow store holds the
/// memory of that many files, and no worker. No more than the connections for files to a Redis, so none of them waits for another there.
const TRANSFERS: usize = 6;

/// Which gate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// On what is warm: milliseconds.
    Drag,
    /// Decodes, or fills tables.
    Upload,
    /// Waits for a session's file, to the store or from it, and computes nothing.
    Transfer,
}

/// What a pool is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Threads and turns of each gate; each has one of both in reserve, for a client that has no turn.
    pub workers: usize,
    /// Requests that may wait before each gate.
    pub queue: usize,
    /// Longest wait of a drag.
    pub drag_wait: Duration,
    /// Longest wait of an upload.
    pub upload_wait: Duration,
}

/// Compute threads behind bounded queues. Cloning shares them.
#[derive(Clone, Debug)]
pub struct Pool {
    drags: Arc<AdmissionQueue>,
    uploads: Arc<AdmissionQueue>,
    transfers: Arc<AdmissionQueue>,
    /// For what is split, while the thread that split it sleeps; one thing at a time.
    wide: Arc<Mutex<ThreadPool>>,
    crowd: RecentConcurrency,
    workers: usize,
    running: Arc<AtomicUsize>,
}

/// The right to compute, for the request that has waited for it.
#[derive(Clone, Debug)]
pub struct Ticket {
    gate: Arc<AdmissionQueue>,
    _turn: Arc<AdmissionPermit>,
    scope: Scope,
    waited: Duration,
}

impl Ticket {
    /// A job waits for a thread of the same gate.
    #[must_use]
    pub fn is_thread_wanted(&self) -> bool {
        self.gate.crew.is_thread_wanted()
    }

    /// Time spent in the queue.
    #[must_use]
    pub const fn waited(&self) -> Duration {
        self.waited
    }
}

/// Whether anyone still wants the result; long work asks between its steps.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Nobody waits for the result any more.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Cancels when dropped.
struct CancelOnDrop(Cancel);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.0.store(true, Ordering::Relaxed);
    }
}

/// Counts a computation for as long as it lives.
struct Running(Arc<AtomicUsize>);

impl Running {
    fn begin(counter: &Arc<AtomicUsize>) -> Self {
        counter.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(counter))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Pool {
    /// Starts the threads.
    ///
    /// # Errors
    /// The operating system gives no threads.
    pub fn new(shape: Shape) -> Result<Self, NoThreads> {
        let Shape { workers, queue, drag_wait, upload_wait } = shape;
        let wide = ThreadPoolBuilder::new()
            .num_threads(workers)
            .thread_name(|i| format!("split-{i}"))
            // Without a handler a panic that reaches a rayon thread aborts the process.
            .panic_handler(|_| tracing::error!("a panic reached a compute thread"))
            .build()
            .map_err(|e| NoThreads(e.to_string()))?;
        let gate = |name: &str, max_wait: Duration, nice: i32| {
            let crew = WorkerThreads::start(name, workers + queue::SPARE, nice).map_err(|e| NoThreads(e.to_string()))?;
            Ok(AdmissionQueue::new(crew, workers, queue, max_wait))
        };
        Ok(Self {
            drags: gate("drag", drag_wait, 0)?,
            uploads: gate("upload", upload_wait, UPLOADS_NICE)?,
            transfers: AdmissionQueue::new(WorkerThreads::default(), TRANSFERS, queue, upload_wait),
            wide: Arc::new(Mutex::new(wide)),
            crowd: RecentConcurrency::default(),
            workers,
            running: Arc::new(AtomicUsize::new(0)),
        })
    }

    const fn gate(&self, work: Work) -> &Arc<AdmissionQueue> {
        match work {
            Work::Drag => &self.drags,
            Work::Upload => &self.uploads,
            Work::Transfer => &self.transfers,
        }
    }

    /// A request of somebody who has none here yet would be refused now.
    #[must_use]
    pub fn is_full(&self, work: Work) -> bool {
        self.gate(work).is_full()
    }

    /// A request of this lane would be refused now.
    #[must_use]
    pub fn refuses(&self, work: Work, lane: QueueKey) -> bool {
        self.gate(work).refuses(lane)
    }

    /// Who runs and waits at a gate.
    #[must_use]
    pub fn load(&self, work: Work) -> Load {
        self.gate(work).load()
    }

    /// Computations that go on now, those of clients that have left included.
    #[must_use]
    pub fn running(&self) -> usize {
        self.running.load(Ordering::Relaxed)
    }

    /// Waits for a turn. Dropping the future gives the place in the queue back.
    ///
    /// # Errors
    /// [`PoolError::Full`], [`PoolError::Late`].
    pub async fn admit(&self, work: Work, lane: QueueKey) -> Result<Ticket, PoolError> {
        let began = Instant::now();
        let gate = self.gate(work);
        let turn = gate.enter(lane).await;
        // The stage of that name is the wait for a worker.
        if work != Work::Transfer {
            stage("queue", began);
        }
        Ok(Ticket { gate: Arc::clone(gate), _turn: Arc::new(turn?), scope: Scope::current(), waited: began.elapsed() })
    }

    /// Runs `work` on a compute thread. When the future is dropped, `work` finds its [`Cancel`] set.
    ///
    /// # Errors
    /// [`PoolError::Panicked`].
    pub async fn run<T, F>(&self, ticket: &Ticket, work: F) -> Result<T, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(&Cancel) -> T + Send + 'static,
    {
        let guard = CancelOnDrop(Cancel::default());
        let cancel = guard.0.clone();
        let (answer, result) = oneshot::channel();
        self.start(ticket, move || {
            // Nobody listens when the request was dropped meanwhile.
            let _ = answer.send(work(&cancel));
        });
        result.await.map_err(|_| PoolError::Panicked)
    }

    /// Starts `work` on a compute thread and does not wait. A panic ends `work` alone, and drops what it holds.
    pub fn start(&self, ticket: &Ticket, work: impl FnOnce() + Send + 'static) {
        ticket.gate.crew.submit([self.job(ticket, work)]);
    }

    /// The same with `helpers` more threads that are woken at the same time, each of which calls `help`.
    pub fn start_with(
        &self,
        ticket: &Ticket,
        work: impl FnOnce() + Send + 'static,
        helpers: usize,
        help: impl Fn() + Clone + Send + 'static,
    ) {
        let help = (0..helpers).map(|_| self.job(ticket, help.clone()));
        ticket.gate.crew.submit(std::iter::once(self.job(ticket, work)).chain(help));
    }

    fn job(&self, ticket: &Ticket, work: impl FnOnce() + Send + 'static) -> Box<dyn FnOnce() + Send> {
        let ticket = ticket.clone();
        let running = Running::begin(&self.running);
        Box::new(move || {
            // What a panic leaves half-done is owned by `work` and dropped with it.
            ticket.scope.enter(|| {
                if let Err(panic) = catch_unwind(AssertUnwindSafe(work)) {
                    tracing::error!(message = panic_text(panic.as_ref()), "a computation panicked");
                }
            });
            // In this order: nothing that has ended still holds a place.
            drop((ticket, running));
        })
    }

    /// Runs `work` on as many threads as it splits into, while this compute thread sleeps; on this thread alone when they are taken (a thread
    /// that waits for a part of one thing would take up all of another). A panic comes through.
    pub fn run_parallel<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match self.wide.try_lock() {
            Ok(wide) => wide.install(work),
            // Nothing of the pool is broken by a panic that went through it.
            Err(TryLockError::Poisoned(wide)) => wide.into_inner().install(work),
            Err(TryLockError::WouldBlock) => work(),
        }
    }

    /// Joins those who draw; the number is how many threads beside its own the picture may take.
    #[must_use]
    pub fn draws(&self) -> (DrawGuard, usize) {
        let (drawer, most) = self.crowd.join();
        (drawer, (self.workers / most).saturating_sub(1))
    }
}

/// The words of a panic.
pub(crate) fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("a panic without words")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::Client;
    use crate::session::SessionId;
    use std::sync::mpsc;

    fn pool(queue: usize, wait: Duration) -> Pool {
        Pool::new(Shape { workers: 1, queue, drag_wait: wait, upload_wait: wait }).unwrap()
    }

    const LONG: Duration = Duration::from_secs(600);

    /// A session of one client.
    fn lane(n: u8) -> QueueKey {
        QueueKey::session(Client::default(), SessionId::from_bytes(&[n; 32]))
    }

    async fn drag(pool: &Pool, n: u8) -> Result<Ticket, PoolError> {
        pool.admit(Work::Drag, lane(n)).await
    }

    #[tokio::test]
    async fn a_full_queue_refuses_at_once_and_a_freed_place_is_given_again() {
        let pool = pool(1, LONG);
        let first = drag(&pool, 1).await.unwrap();
        let waiting = tokio::spawn({
            let pool = pool.clone();
            async move { drag(&pool, 2).await }
        });
        while !pool.refuses(Work::Drag, lane(3)) {
            tokio::task::yield_now().await;
        }
        assert_eq!(drag(&pool, 3).await.unwrap_err(), PoolError::Full);
        assert_eq!(pool.load(Work::Drag), Load { running: 1, waiting: 1, full: 1, late: 0 });
        pool.admit(Work::Upload, lane(3)).await.unwrap();
        waiting.abort();
        let _ = waiting.await;
        assert!(!pool.refuses(Work::Drag, lane(3)), "a waiter that left gives its place back");
        drop(first);
        drag(&pool, 4).await.unwrap();
        assert_eq!(pool.load(Work::Drag), Load { running: 0, waiting: 0, full: 1, late: 0 });
    }

    #[tokio::test]
    async fn whoever_waits_too_long_is_told_and_nothing_is_left_of_it() {
        let pool = pool(8, Duration::from_millis(20));
        let first = drag(&pool, 1).await.unwrap();
        assert_eq!(drag(&pool, 2).await.unwrap_err(), PoolError::Late { max_wait: Duration::from_millis(20) });
        assert_eq!(pool.load(Work::Drag), Load { running: 1, waiting: 0, full: 0, late: 1 });
        drop(first);
        drag(&pool, 3).await.unwrap();
    }

    #[tokio::test]
    async fn whoever_is_sent_away_for_another_is_told_at_once() {
        let pool = pool(2, LONG);
        let first = drag(&pool, 1).await.unwrap();
        let wait = |n: u8| {
            let pool = pool.clone();
            tokio::spawn(async move { drag(&pool, n).await })
        };
        let mut same = Vec::new();
        for waiting in 1..=2 {
            same.push(wait(2));
            while pool.load(Work::Drag).waiting < waiting {
                tokio::task::yield_now().await;
            }
        }
        let newcomer = wait(3);
        assert_eq!(same.remove(0).await.unwrap().unwrap_err(), PoolError::Full);
        drop(first);
        drop(same.remove(0).await.unwrap().unwrap());
        newcomer.await.unwrap().unwrap();
    }

    #[tokio::test]
    async fn another_client_does_not_wait_for_the_end_of_a_long_request() {
        let pool = pool(0, LONG);
        let (go, wait) = mpsc::channel::<()>();
        let long = drag(&pool, 1).await.unwrap();
        let (wait, began) = (Arc::new(Mutex::new(wait)), Arc::new(AtomicUsize::new(0)));
        let hold = {
            let began = Arc::clone(&began);
            move || {
                began.fetch_add(1, Ordering::Relaxed);
                let _ = wait.lock().map(|wait| wait.recv());
            }
        };
        pool.start(&long, hold);
        while began.load(Ordering::Relaxed) == 0 {
            tokio::task::yield_now().await;
        }
        let other = Client { address: [192, 0, 2, 1].into(), ..Client::default() };
        let ticket = pool.admit(Work::Drag, QueueKey::client(other)).await.unwrap();
        assert_eq!(pool.run(&ticket, |_| 7).await, Ok(7), "it has a turn and a thread");
        assert!(pool.refuses(Work::Drag, lane(2)) && pool.is_full(Work::Drag));
        drop((go, long, ticket));
    }

    #[tokio::test]
    async fn a_panic_ends_its_own_work_alone() {
        let pool = pool(0, LONG);
        let ticket = drag(&pool, 1).await.unwrap();
        assert_eq!(pool.run(&ticket, |_| panic!("on purpose")).await.map(|()| 0), Err(PoolError::Panicked));
        assert_eq!(pool.run(&ticket, |_| 7).await, Ok(7));
    }

    #[tokio::test]
    async fn a_dropped_request_cancels_its_work_and_keeps_its_turn_until_the_work_has_ended() {
        let pool = pool(0, LONG);
        let (seen, sees) = mpsc::channel();
        let (go, wait) = mpsc::channel::<()>();
        let task = tokio::spawn({
            let pool = pool.clone();
            async move {
                let ticket = drag(&pool, 1).await.unwrap();
                pool.run(&ticket, move |cancel| {
                    seen.send("began").unwrap();
                    wait.recv().unwrap();
                    seen.send(if cancel.is_cancelled() { "cancelled" } else { "wanted" }).unwrap();
                })
                .await
            }
        });
        let sees = tokio::task::spawn_blocking(move || {
            assert_eq!(sees.recv().unwrap(), "began");
            sees
        });
        let sees = sees.await.unwrap();
        task.abort();
        assert!(task.await.unwrap_err().is_cancelled());
        assert!(pool.refuses(Work::Drag, lane(1)), "the work holds the client's only place");
        go.send(()).unwrap();
        let seen = tokio::task::spawn_blocking(move || sees.recv().unwrap());
        assert_eq!(seen.await.unwrap(), "cancelled");
        while pool.refuses(Work::Drag, lane(1)) {
            tokio::task::yield_now().await;
        }
    }
}
