//! Admission and compute threads: `README.md` describes both, with a diagram.
//!
//! Async tasks compute nothing but small JSON bodies, and compute threads never wait for a client.
//! A request waits for a [`Ticket`]; everything that computes for it holds a clone, so that the
//! ticket is returned when the last closure has ended, even if the request's future was dropped
//! before.

mod admission;
mod queue;
mod worker_threads;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, TryLockError};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};
use tokio::sync::oneshot;

pub use admission::Load;
use admission::{AdmissionPermit, AdmissionQueue};
pub use queue::QueueKey;
use worker_threads::{WorkerThreads, lower_priority};

use crate::observe::Scope;
use crate::observe::scope::stage;

/// The operating system refused to start threads.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct NoThreads(String);

/// Why nothing was computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PoolError {
    /// All workers are busy and the queue is full, or became full with requests that take
    /// precedence.
    #[error("all workers are busy and the queue is full")]
    Full,
    /// No worker became free in time.
    #[error("no worker became free within {} ms", .max_wait.as_millis())]
    Late {
        /// The longest wait.
        max_wait: Duration,
    },
    /// A computation panicked; its message is in the log.
    #[error("a computation failed")]
    Panicked,
}

/// Niceness of upload threads, and of the threads of parallel computations: beside a drag thread on
/// the same processor they get about a quarter of the processor, otherwise all of it.
const UPLOAD_NICENESS: i32 = 5;

/// How long a job runs before it gives way to a client that has used less. Drags that are drawn in
/// a turn are not interrupted; most are.
const DRAG_TURN: Duration = Duration::from_millis(50);
const UPLOAD_TURN: Duration = Duration::from_millis(100);

/// Simultaneous transfers of files from and to the store, not counting the spare permit. Not more
/// than the Redis connections for files, so that no transfer waits for a connection.
const MAX_TRANSFERS: usize = 6;

/// The classes of work, each with a queue of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkClass {
    /// Uses a cached image and plan: milliseconds.
    Drag,
    /// Decodes an image or builds a plan.
    Upload,
    /// Transfers a file from or to the store; uses no thread.
    Transfer,
}

/// The size of a pool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolConfig {
    /// Threads and permits of each class; each class has one more of both for a client without a
    /// permit.
    pub workers: usize,
    /// Requests that may wait in each queue.
    pub queue: usize,
    /// Longest wait of a drag.
    pub drag_wait: Duration,
    /// Longest wait of an upload.
    pub upload_wait: Duration,
}

/// Compute threads behind bounded queues. Clones share them.
#[derive(Clone, Debug)]
pub struct Pool {
    drags: Arc<AdmissionQueue>,
    uploads: Arc<AdmissionQueue>,
    transfers: Arc<AdmissionQueue>,
    /// For one parallel computation at a time, while the thread that started it sleeps.
    parallel: Arc<Mutex<ThreadPool>>,
    workers: usize,
}

/// The right to compute, for the request that has waited for it.
#[derive(Clone, Debug)]
pub struct Ticket {
    queue: Arc<AdmissionQueue>,
    permit: Arc<AdmissionPermit>,
    scope: Scope,
    waited: Duration,
}

impl Ticket {
    /// Runs `work` on a compute thread. When the future is dropped, the [`Cancel`] of `work` is
    /// set. Errors: [`PoolError::Panicked`].
    pub async fn run<T, F>(&self, work: F) -> Result<T, PoolError>
    where
        T: Send + 'static,
        F: FnOnce(&Cancel) -> T + Send + 'static,
    {
        let guard = CancelOnDrop(Arc::default());
        let cancel = Cancel {
            is_cancelled: Arc::clone(&guard.0),
            permit: Arc::clone(&self.permit),
        };
        let (sender, result) = oneshot::channel();
        self.start(move || {
            // The receiver is gone when the request was dropped.
            let _ = sender.send(work(&cancel));
        });
        result.await.map_err(|_| PoolError::Panicked)
    }

    /// Starts `work` on a compute thread and does not wait. A panic ends `work` only, and drops
    /// what it owns.
    pub fn start(&self, work: impl FnOnce() + Send + 'static) {
        self.queue.threads.submit(job(self, work));
    }

    /// Offers a part of a computation to `helpers` more threads, each of which calls `help`.
    /// Threads that are busy call it later, so `help` returns at once when nothing is left to do.
    pub fn offer(&self, helpers: usize, help: impl Fn() + Clone + Send + 'static) {
        self.queue
            .threads
            .offer((0..helpers).map(|_| job(self, help.clone())));
    }

    /// Whether a job waits for a thread of the same class.
    pub fn is_thread_wanted(&self) -> bool {
        self.queue.threads.is_thread_wanted()
    }

    /// Whether a long job is cancelled that learns it in another way than by a [`Cancel`]. Returns
    /// later if other clients come first.
    pub fn is_over(&self, is_cancelled: &dyn Fn() -> bool) -> bool {
        self.permit.give_way(is_cancelled);
        is_cancelled()
    }

    /// Whether the job has given way and waits until it is next.
    pub fn is_paused(&self) -> bool {
        self.permit.is_paused()
    }

    /// Time spent in the queue.
    pub const fn waited(&self) -> Duration {
        self.waited
    }
}

/// Whether a result is no longer needed; long computations check it between their steps, at least
/// every 10 ms. A job gives way to other clients there.
#[derive(Clone, Debug)]
pub struct Cancel {
    is_cancelled: Arc<AtomicBool>,
    permit: Arc<AdmissionPermit>,
}

impl Cancel {
    /// The result is no longer needed. Returns later if other clients come first.
    pub fn is_cancelled(&self) -> bool {
        let is_cancelled = || self.is_cancelled.load(Ordering::Relaxed);
        self.permit.give_way(&is_cancelled);
        is_cancelled()
    }
}

/// Cancels when dropped.
struct CancelOnDrop(Arc<AtomicBool>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Pool {
    /// Starts the threads.
    /// Errors: The operating system refused to start threads.
    pub fn new(shape: PoolConfig) -> Result<Self, NoThreads> {
        let PoolConfig {
            workers,
            queue,
            drag_wait,
            upload_wait,
        } = shape;
        let parallel = ThreadPoolBuilder::new()
            .num_threads(workers)
            .thread_name(|i| format!("parallel-{i}"))
            .start_handler(|_| lower_priority(UPLOAD_NICENESS))
            // Without a handler, a panic that reaches a rayon thread aborts the process.
            .panic_handler(|_| tracing::error!("a panic reached a compute thread"))
            .build()
            .map_err(|e| NoThreads(e.to_string()))?;
        let class = |name: &str, max_wait: Duration, niceness: i32, turn: Duration| {
            let threads = WorkerThreads::start(name, workers + queue::SPARE_PERMITS, niceness)
                .map_err(|e| NoThreads(e.to_string()))?;
            Ok(AdmissionQueue::new(threads, workers, queue, max_wait, turn))
        };
        Ok(Self {
            drags: class("drag", drag_wait, 0, DRAG_TURN)?,
            uploads: class("upload", upload_wait, UPLOAD_NICENESS, UPLOAD_TURN)?,
            transfers: AdmissionQueue::new(
                WorkerThreads::default(),
                MAX_TRANSFERS,
                queue,
                upload_wait,
                UPLOAD_TURN,
            ),
            parallel: Arc::new(Mutex::new(parallel)),
            workers,
        })
    }

    const fn queue(&self, class: WorkClass) -> &Arc<AdmissionQueue> {
        match class {
            WorkClass::Drag => &self.drags,
            WorkClass::Upload => &self.uploads,
            WorkClass::Transfer => &self.transfers,
        }
    }

    /// Whether a request of a client without requests here would be rejected now.
    pub fn is_full(&self, class: WorkClass) -> bool {
        self.queue(class).is_full()
    }

    /// Whether a request with this key would be rejected now.
    pub fn rejects(&self, class: WorkClass, key: QueueKey) -> bool {
        self.queue(class).rejects(key)
    }

    /// Running and waiting requests of a class.
    pub fn load(&self, class: WorkClass) -> Load {
        self.queue(class).load()
    }

    /// Requests that hold a worker, those of disconnected clients included.
    pub fn running(&self) -> usize {
        self.drags.load().running + self.uploads.load().running
    }

    /// Waits for a permit. Dropping the future leaves the queue.
    /// Errors: [`PoolError::Full`], [`PoolError::Late`].
    pub async fn admit(&self, class: WorkClass, key: QueueKey) -> Result<Ticket, PoolError> {
        let began = Instant::now();
        let queue = self.queue(class);
        let permit = queue.enter(key).await;
        // The stage `queue` is the wait for a worker.
        if class != WorkClass::Transfer {
            stage("queue", began);
        }
        Ok(Ticket {
            queue: Arc::clone(queue),
            permit: Arc::new(permit?),
            scope: Scope::current(),
            waited: began.elapsed(),
        })
    }

    /// Runs `work` on the parallel threads while this compute thread sleeps; on this thread only,
    /// if they are in use (a thread that waits for its part of one computation would otherwise
    /// execute all of another). A panic is propagated.
    pub fn run_parallel<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match self.parallel.try_lock() {
            Ok(threads) => threads.install(work),
            // A panic that was propagated through the pool breaks nothing in it.
            Err(TryLockError::Poisoned(threads)) => threads.into_inner().install(work),
            Err(TryLockError::WouldBlock) => work(),
        }
    }

    /// Number of requests of a class that run at the same time.
    pub(crate) const fn workers(&self) -> usize {
        self.workers
    }

    /// The number of helper threads that a drawing may use.
    pub(crate) const fn helpers(&self) -> usize {
        self.workers.saturating_sub(1)
    }
}

fn job(ticket: &Ticket, work: impl FnOnce() + Send + 'static) -> Box<dyn FnOnce() + Send> {
    let ticket = ticket.clone();
    Box::new(move || {
        // What a panic leaves unfinished is owned by `work` and dropped with it.
        ticket.scope.enter(|| {
            if let Err(panic) = catch_unwind(AssertUnwindSafe(work)) {
                tracing::error!(
                    message = panic_text(panic.as_ref()),
                    "a computation panicked"
                );
            }
        });
        // All of the ticket is moved here, not its scope alone.
        drop(ticket);
    })
}

/// Does long work that needs no permit, such as a copy, on a blocking thread; short work here. A
/// panic is propagated.
pub(crate) async fn aside<T: Send + 'static>(
    is_long: bool,
    work: impl FnOnce() -> T + Send + 'static,
) -> T {
    if !is_long {
        return work();
    }
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            // Tasks are not aborted before the runtime stops, which drops this one too.
            Err(_) => std::future::pending().await,
        },
    }
}

/// The message of a panic.
pub(crate) fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without a message")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::Client;
    use crate::session::SessionId;
    use std::sync::mpsc;

    fn pool(queue: usize, wait: Duration) -> Pool {
        Pool::new(PoolConfig {
            workers: 1,
            queue,
            drag_wait: wait,
            upload_wait: wait,
        })
        .unwrap()
    }

    const LONG_WAIT: Duration = Duration::from_secs(600);

    /// A session of one client.
    fn key(n: u8) -> QueueKey {
        QueueKey::session(Client::default(), SessionId::from_bytes(&[n; 32]))
    }

    async fn drag(pool: &Pool, n: u8) -> Result<Ticket, PoolError> {
        pool.admit(WorkClass::Drag, key(n)).await
    }

    #[tokio::test]
    async fn a_full_queue_refuses_at_once_and_a_freed_place_is_given_again() {
        let pool = pool(1, LONG_WAIT);
        let first = drag(&pool, 1).await.unwrap();
        let waiting = tokio::spawn({
            let pool = pool.clone();
            async move { drag(&pool, 2).await }
        });
        while !pool.rejects(WorkClass::Drag, key(3)) {
            tokio::task::yield_now().await;
        }
        assert_eq!(drag(&pool, 3).await.unwrap_err(), PoolError::Full);
        assert_eq!(
            pool.load(WorkClass::Drag),
            Load {
                running: 1,
                waiting: 1,
                full: 1,
                late: 0
            }
        );
        pool.admit(WorkClass::Upload, key(3)).await.unwrap();
        waiting.abort();
        let _ = waiting.await;
        assert!(
            !pool.rejects(WorkClass::Drag, key(3)),
            "a waiter that left gives its place back"
        );
        drop(first);
        drag(&pool, 4).await.unwrap();
        assert_eq!(
            pool.load(WorkClass::Drag),
            Load {
                running: 0,
                waiting: 0,
                full: 1,
                late: 0
            }
        );
    }

    #[tokio::test]
    async fn whoever_waits_too_long_is_told_and_nothing_is_left_of_it() {
        let pool = pool(8, Duration::from_millis(20));
        let first = drag(&pool, 1).await.unwrap();
        assert_eq!(
            drag(&pool, 2).await.unwrap_err(),
            PoolError::Late {
                max_wait: Duration::from_millis(20)
            }
        );
        assert_eq!(
            pool.load(WorkClass::Drag),
            Load {
                running: 1,
                waiting: 0,
                full: 0,
                late: 1
            }
        );
        drop(first);
        drag(&pool, 3).await.unwrap();
    }

    #[tokio::test]
    async fn whoever_is_sent_away_for_another_is_told_at_once() {
        let pool = pool(2, LONG_WAIT);
        let first = drag(&pool, 1).await.unwrap();
        let wait = |n: u8| {
            let pool = pool.clone();
            tokio::spawn(async move { drag(&pool, n).await })
        };
        let mut same = Vec::new();
        for waiting in 1..=2 {
            same.push(wait(2));
            while pool.load(WorkClass::Drag).waiting < waiting {
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
        let pool = pool(0, LONG_WAIT);
        let (go, wait) = mpsc::channel::<()>();
        let long = drag(&pool, 1).await.unwrap();
        let (wait, began) = (
            Arc::new(Mutex::new(wait)),
            Arc::new(std::sync::atomic::AtomicUsize::new(0)),
        );
        let hold = {
            let began = Arc::clone(&began);
            move || {
                began.fetch_add(1, Ordering::Relaxed);
                let _ = wait.lock().map(|wait| wait.recv());
            }
        };
        long.start(hold);
        while began.load(Ordering::Relaxed) == 0 {
            tokio::task::yield_now().await;
        }
        let other = Client {
            address: [192, 0, 2, 1].into(),
            ..Client::default()
        };
        let ticket = pool
            .admit(WorkClass::Drag, QueueKey::client(other))
            .await
            .unwrap();
        assert_eq!(ticket.run(|_| 7).await, Ok(7), "it has a turn and a thread");
        assert!(pool.rejects(WorkClass::Drag, key(2)) && pool.is_full(WorkClass::Drag));
        drop((go, long, ticket));
    }

    /// A job that works until its request is dropped, and counts its looks.
    fn endless(
        pool: &Pool,
        class: WorkClass,
        n: u8,
        looks: &Arc<std::sync::atomic::AtomicUsize>,
    ) -> tokio::task::JoinHandle<()> {
        let (pool, looks) = (pool.clone(), Arc::clone(looks));
        tokio::spawn(async move {
            let client = Client {
                address: [192, 0, 2, n].into(),
                ..Client::default()
            };
            let ticket = pool.admit(class, QueueKey::client(client)).await.unwrap();
            let work = move |cancel: &Cancel| {
                while !cancel.is_cancelled() {
                    looks.fetch_add(1, Ordering::Relaxed);
                    std::thread::sleep(Duration::from_millis(1));
                }
            };
            ticket.run(work).await.unwrap();
        })
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn jobs_that_never_end_give_way_to_another_client_and_go_on() {
        give_way(WorkClass::Drag).await;
        give_way(WorkClass::Upload).await;
    }

    async fn give_way(class: WorkClass) {
        let pool = pool(8, LONG_WAIT);
        let looks: [Arc<std::sync::atomic::AtomicUsize>; 4] = Default::default();
        let jobs: Vec<_> = (0_u8..)
            .zip(&looks)
            .map(|(n, looks)| endless(&pool, class, n, looks))
            .collect();
        let seen = || looks.each_ref().map(|looks| looks.load(Ordering::Relaxed));
        // More than the permit and the spare one: they take turns.
        while seen().contains(&0) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let ticket = pool.admit(class, key(9)).await.unwrap();
        assert_eq!(
            ticket.run(|_: &Cancel| 7).await,
            Ok(7),
            "there is a thread for it"
        );
        drop(ticket);
        let before = seen();
        while seen()
            .iter()
            .zip(before)
            .any(|(now, before)| *now == before)
        {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        jobs.iter().for_each(tokio::task::JoinHandle::abort);
        while pool.load(class).running > 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let (end, last) = (Instant::now(), seen());
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert!(
            seen() == last && end.elapsed() < LONG_WAIT,
            "paused jobs end when they are cancelled"
        );
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_job_for_which_the_permits_wait_goes_on_without_one() {
        let pool = pool(8, LONG_WAIT);
        let looks = Arc::default();
        let job = endless(&pool, WorkClass::Upload, 1, &looks);
        while looks.load(Ordering::Relaxed) == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let client = |n: u8| {
            QueueKey::client(Client {
                address: [192, 0, 2, n].into(),
                ..Client::default()
            })
        };
        let spare = pool.admit(WorkClass::Upload, client(2)).await.unwrap();
        // It gets the job's permit, and keeps it.
        let held = pool.admit(WorkClass::Upload, client(3)).await.unwrap();
        let before = looks.load(Ordering::Relaxed);
        while looks.load(Ordering::Relaxed) <= before + 1 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert_eq!(pool.load(WorkClass::Upload).running, 3);
        drop((spare, held));
        job.abort();
    }

    #[tokio::test]
    async fn a_panic_ends_its_own_work_alone() {
        let pool = pool(0, LONG_WAIT);
        let ticket = drag(&pool, 1).await.unwrap();
        assert_eq!(
            ticket.run(|_| panic!("on purpose")).await.map(|()| 0),
            Err(PoolError::Panicked)
        );
        assert_eq!(ticket.run(|_| 7).await, Ok(7));
    }

    #[tokio::test]
    async fn a_dropped_request_cancels_its_work_and_keeps_its_turn_until_the_work_has_ended() {
        let pool = pool(0, LONG_WAIT);
        let (seen, sees) = mpsc::channel();
        let (go, wait) = mpsc::channel::<()>();
        let task = tokio::spawn({
            let pool = pool.clone();
            async move {
                let ticket = drag(&pool, 1).await.unwrap();
                ticket
                    .run(move |cancel| {
                        seen.send("began").unwrap();
                        wait.recv().unwrap();
                        seen.send(if cancel.is_cancelled() {
                            "cancelled"
                        } else {
                            "wanted"
                        })
                        .unwrap();
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
        assert!(
            pool.rejects(WorkClass::Drag, key(1)),
            "the work holds the client's only place"
        );
        go.send(()).unwrap();
        let seen = tokio::task::spawn_blocking(move || sees.recv().unwrap());
        assert_eq!(seen.await.unwrap(), "cancelled");
        while pool.rejects(WorkClass::Drag, key(1)) {
            tokio::task::yield_now().await;
        }
    }
}
