//! Admission and the compute threads. A request takes a place (running or waiting; none left: refused at once), waits its turn in
//! order of arrival, and then runs closures on the crew's threads. No async thread ever computes, no compute thread ever waits for a client.
//!
//! A closure runs on one thread. What is worth splitting (tables of coefficients, many places) goes on to rayon's threads, `spread`; the strips of
//! a picture are taken by helpers, as many as no other picture wants (`crowd`).
//!
//! A ticket is shared by everything that computes for the request: it is given back when the last closure has ended, also when the
//! request's future was dropped before.

mod crew;
mod crowd;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, TryLockError};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use crew::Crew;
use crowd::Crowd;
pub use crowd::Drawer;

/// The operating system gives no threads.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct NoThreads(String);

/// Why nothing was computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PoolError {
    /// All workers are busy and the queue is full.
    #[error("all workers are busy and the queue is full")]
    Full,
    /// A computation panicked; its message is in the log.
    #[error("a computation failed")]
    Panicked,
}

/// Compute threads behind a bounded queue. Cloning shares them.
#[derive(Clone, Debug)]
pub struct Pool {
    crew: Arc<Crew>,
    /// For what is split, while the thread that split it sleeps; one thing at a time.
    wide: Arc<Mutex<ThreadPool>>,
    crowd: Crowd,
    workers: usize,
    /// One permit a request that runs or waits.
    places: Arc<Semaphore>,
    /// One permit a request that runs.
    turns: Arc<Semaphore>,
    running: Arc<AtomicUsize>,
}

/// The right to compute.
#[derive(Clone, Debug)]
pub struct Ticket {
    _held: Arc<Held>,
    waited: Duration,
}

/// Dropped from the top: whoever gets the turn finds the place free as well.
#[derive(Debug)]
struct Held {
    _place: OwnedSemaphorePermit,
    _turn: OwnedSemaphorePermit,
}

impl Ticket {
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
    /// Starts `workers` threads; `queue` requests may wait beside the `workers` that run.
    ///
    /// # Errors
    /// The operating system gives no threads.
    pub fn new(workers: usize, queue: usize) -> Result<Self, NoThreads> {
        let wide = ThreadPoolBuilder::new()
            .num_threads(workers)
            .thread_name(|i| format!("split-{i}"))
            // Without a handler a panic that reaches a rayon thread aborts the process.
            .panic_handler(|_| tracing::error!("a panic reached a compute thread"))
            .build()
            .map_err(|e| NoThreads(e.to_string()))?;
        Ok(Self {
            crew: Arc::new(Crew::start(workers).map_err(|e| NoThreads(e.to_string()))?),
            wide: Arc::new(Mutex::new(wide)),
            crowd: Crowd::default(),
            workers,
            places: Arc::new(Semaphore::new(workers.saturating_add(queue).min(Semaphore::MAX_PERMITS))),
            turns: Arc::new(Semaphore::new(workers)),
            running: Arc::new(AtomicUsize::new(0)),
        })
    }

    /// No request would be admitted now.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.places.available_permits() == 0
    }

    /// Computations that go on now, those of clients that have left included.
    #[must_use]
    pub fn running(&self) -> usize {
        self.running.load(Ordering::Relaxed)
    }

    /// Takes a place, at once or not at all, and waits for its turn. Dropping the future gives the place back.
    ///
    /// # Errors
    /// [`PoolError::Full`].
    pub async fn admit(&self) -> Result<Ticket, PoolError> {
        let began = Instant::now();
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| PoolError::Full)?;
        let turn = Arc::clone(&self.turns).acquire_owned().await.expect("the semaphore is never closed");
        Ok(Ticket { _held: Arc::new(Held { _place: place, _turn: turn }), waited: began.elapsed() })
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
        self.crew.hand_over([self.job(ticket, work)]);
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
        self.crew.hand_over(std::iter::once(self.job(ticket, work)).chain(help));
    }

    fn job(&self, ticket: &Ticket, work: impl FnOnce() + Send + 'static) -> Box<dyn FnOnce() + Send> {
        let ticket = ticket.clone();
        let running = Running::begin(&self.running);
        Box::new(move || {
            // What a panic leaves half-done is owned by `work` and dropped with it.
            if let Err(panic) = catch_unwind(AssertUnwindSafe(work)) {
                tracing::error!(message = panic_text(panic.as_ref()), "a computation panicked");
            }
            // In this order: nothing that has ended still holds a place.
            drop((ticket, running));
        })
    }

    /// Runs `work` on as many threads as it splits into, while this compute thread sleeps; on this thread alone when they are taken (a thread
    /// that waits for a part of one thing would take up all of another). A panic comes through.
    pub fn spread<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match self.wide.try_lock() {
            Ok(wide) => wide.install(work),
            // Nothing of the pool is broken by a panic that went through it.
            Err(TryLockError::Poisoned(wide)) => wide.into_inner().install(work),
            Err(TryLockError::WouldBlock) => work(),
        }
    }

    /// Joins those who draw; the number is how many threads beside its own the picture may take.
    #[must_use]
    pub fn draws(&self) -> (Drawer, usize) {
        let (drawer, most) = self.crowd.join();
        (drawer, (self.workers / most).saturating_sub(1))
    }
}

/// The words of a panic.
pub(super) fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("a panic without words")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    #[tokio::test]
    async fn a_full_queue_refuses_at_once_and_a_freed_place_is_given_again() {
        let pool = Pool::new(1, 1).unwrap();
        let first = pool.admit().await.unwrap();
        let waiting = tokio::spawn({
            let pool = pool.clone();
            async move { pool.admit().await }
        });
        while !pool.is_full() {
            tokio::task::yield_now().await;
        }
        assert_eq!(pool.admit().await.unwrap_err(), PoolError::Full);
        waiting.abort();
        let _ = waiting.await;
        assert!(!pool.is_full(), "a waiter that left gives its place back");
        drop(first);
        pool.admit().await.unwrap();
    }

    #[tokio::test]
    async fn a_panic_ends_its_own_work_alone() {
        let pool = Pool::new(1, 0).unwrap();
        let ticket = pool.admit().await.unwrap();
        assert_eq!(pool.run(&ticket, |_| panic!("on purpose")).await.map(|()| 0), Err(PoolError::Panicked));
        assert_eq!(pool.run(&ticket, |_| 7).await, Ok(7));
    }

    #[tokio::test]
    async fn a_dropped_request_cancels_its_work_and_keeps_its_turn_until_the_work_has_ended() {
        let pool = Pool::new(1, 0).unwrap();
        let (seen, sees) = mpsc::channel();
        let (go, wait) = mpsc::channel::<()>();
        let task = tokio::spawn({
            let pool = pool.clone();
            async move {
                let ticket = pool.admit().await.unwrap();
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
        assert!(pool.is_full(), "the work holds the only place");
        go.send(()).unwrap();
        let seen = tokio::task::spawn_blocking(move || sees.recv().unwrap());
        assert_eq!(seen.await.unwrap(), "cancelled");
        while pool.is_full() {
            tokio::task::yield_now().await;
        }
    }
}
