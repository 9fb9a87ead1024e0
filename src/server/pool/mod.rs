//! Admission and compute threads: `README.md` describes both, with a diagram.
//!
//! Async tasks compute nothing but small JSON bodies, and compute threads never wait for a client.
//! A request waits for a [`Ticket`]; everything that computes for it holds a clone, so that the
//! ticket is returned when the last closure has ended, even if the request's future was dropped
//! before.

mod admission;
pub mod arena;
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
use arena::Arena;
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
    /// The result is no longer needed. Always returns at once: for work that other jobs wait for.
    pub fn is_gone(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }

    /// The result is no longer needed. Returns later if other clients come first.
    pub fn is_cancelled(&self) -> bool {
        self.permit.give_way(&|| self.is_gone());
        self.is_gone()
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
            .spawn_handler(|thread| {
                arena::spawn(&format!("parallel-{}", thread.index()), Arena::Main, || {
                    lower_priority(UPLOAD_NICENESS);
                    thread.run();
                })
            })
            // Without a handler, a panic that reaches a rayon thread aborts the process.
            .panic_handler(|_| tracing::error!("a panic reached a compute thread"))
            .build()
            .map_err(|e| NoThreads(e.to_string()))?;
        let threads = |name: &str, niceness: i32, arena: Arena| {
            WorkerThreads::start(name, workers + queue::SPARE_PERMITS, niceness, arena)
                .map_err(|e| NoThreads(e.to_string()))
        };
        let drags = AdmissionQueue::new(
            threads("drag", 0, Arena::Other)?,
            workers,
            queue,
            drag_wait,
            DRAG_TURN,
            None,
        );
        Ok(Self {
            uploads: AdmissionQueue::new(
                threads("upload", UPLOAD_NICENESS, Arena::Main)?,
                workers,
                queue,
                upload_wait,
                UPLOAD_TURN,
                Some(&drags),
            ),
            drags,
            transfers: AdmissionQueue::new(
                WorkerThreads::default(),
                MAX_TRANSFERS,
                queue,
                upload_wait,
                UPLOAD_TURN,
                None,
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
mod tests;
