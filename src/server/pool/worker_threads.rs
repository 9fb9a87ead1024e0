//! The compute threads of one class, behind one queue of jobs. A thread finishes its job before it takes the next one, so that no request
//! waits for a part of another's. An idle thread polls for a short time before it sleeps: waking a sleeping thread takes a tenth of a
//! millisecond.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// How long an idle thread polls before it sleeps: a client on the same machine sends its next pose within half of this. At sixty poses a
/// second it costs each thread about 1 % of a processor.
const POLL_TIME: Duration = Duration::from_micros(200);

type Job = Box<dyn FnOnce() + Send>;

/// Compute threads; they end when this is dropped, after the queued jobs. The default has none.
#[derive(Debug, Default)]
pub(crate) struct WorkerThreads(Arc<WorkerState>);

#[derive(Default)]
struct WorkerState {
    queue: Mutex<JobQueue>,
    /// Number of queued jobs, for polling without the lock.
    waiting: AtomicUsize,
}

impl std::fmt::Debug for WorkerState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WorkerState").field("waiting", &self.waiting).finish_non_exhaustive()
    }
}

#[derive(Default)]
struct JobQueue {
    jobs: VecDeque<Job>,
    /// Threads that sleep, the last one to fall asleep last. It is woken first: two threads that take turns stay on their processors.
    asleep: Vec<Thread>,
    is_closed: bool,
}

impl WorkerThreads {
    /// Starts `threads` threads with this name and niceness (0 to 19; Linux only).
    /// Errors: The operating system refused to start a thread.
    pub(crate) fn start(name: &str, threads: usize, niceness: i32) -> Result<Self, std::io::Error> {
        let started = Self(Arc::default());
        for index in 0..threads {
            let state = Arc::clone(&started.0);
            std::thread::Builder::new().name(format!("{name}-{index}")).spawn(move || {
                lower_priority(niceness);
                state.run();
            })?;
        }
        Ok(started)
    }

    /// Whether a job waits for a thread.
    pub(crate) fn is_thread_wanted(&self) -> bool {
        self.0.waiting.load(Ordering::Relaxed) > 0
    }

    /// Queues jobs and wakes as many threads. A job that panics ends its thread, so jobs catch panics.
    pub(crate) fn submit(&self, jobs: impl IntoIterator<Item = Job>) {
        let mut queue = self.0.lock();
        let before = queue.jobs.len();
        queue.jobs.extend(jobs);
        let rest = queue.asleep.len().saturating_sub(queue.jobs.len() - before);
        let woken = queue.asleep.split_off(rest);
        self.0.waiting.store(queue.jobs.len(), Ordering::Release);
        drop(queue);
        woken.iter().rev().for_each(Thread::unpark);
    }
}

/// Sets the niceness of this thread. Linux only: elsewhere it would apply to the process. A refusal changes nothing.
fn lower_priority(niceness: i32) {
    #[cfg(target_os = "linux")]
    if niceness > 0 {
        let _ = rustix::process::nice(niceness);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = niceness;
}

impl Drop for WorkerThreads {
    fn drop(&mut self) {
        let mut queue = self.0.lock();
        queue.is_closed = true;
        queue.asleep.drain(..).for_each(|thread| thread.unpark());
    }
}

impl WorkerState {
    fn lock(&self) -> MutexGuard<'_, JobQueue> {
        // No code panics under the lock.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self) {
        // A rayon pool of this thread only: parallel iterators of a job run here instead of on the global pool.
        let _local: Option<ThreadPool> = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().ok();
        while let Some(job) = self.next() {
            job();
        }
    }

    /// The next job; `None` when the threads are dropped.
    fn next(&self) -> Option<Job> {
        let began = Instant::now();
        loop {
            if self.waiting.load(Ordering::Acquire) > 0
                && let Some(job) = self.take(&mut self.lock())
            {
                return Some(job);
            }
            if began.elapsed() >= POLL_TIME {
                return self.sleep();
            }
            // Other threads may use this processor.
            std::thread::yield_now();
        }
    }

    fn sleep(&self) -> Option<Job> {
        let this = std::thread::current();
        let mut queue = self.lock();
        loop {
            if let Some(job) = self.take(&mut queue) {
                return Some(job);
            }
            if queue.is_closed {
                return None;
            }
            queue.asleep.push(this.clone());
            drop(queue);
            std::thread::park();
            queue = self.lock();
            // It is still there if it was not woken by `submit`.
            queue.asleep.retain(|thread| thread.id() != this.id());
        }
    }

    fn take(&self, queue: &mut JobQueue) -> Option<Job> {
        let job = queue.jobs.pop_front();
        self.waiting.store(queue.jobs.len(), Ordering::Release);
        job
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Barrier;
    use std::sync::mpsc::channel;

    #[test]
    fn jobs_handed_over_together_run_together() {
        let threads = WorkerThreads::start("test", 3, 0).unwrap();
        for _ in 0..50 {
            let meet = Arc::new(Barrier::new(4));
            threads.submit((0..3).map(|_| {
                let meet = Arc::clone(&meet);
                Box::new(move || {
                    meet.wait();
                }) as Job
            }));
            meet.wait();
        }
    }

    #[test]
    fn jobs_of_one_thread_run_in_order_and_sleepers_are_woken() {
        let threads = WorkerThreads::start("test", 1, 0).unwrap();
        let (done, order) = channel();
        for k in 0..20 {
            let done = done.clone();
            threads.submit([Box::new(move || done.send(k).unwrap()) as Job]);
            if k % 5 == 0 {
                std::thread::sleep(2 * POLL_TIME);
            }
        }
        drop(done);
        assert_eq!(order.iter().collect::<Vec<_>>(), (0..20).collect::<Vec<_>>());
    }

    #[test]
    fn a_dismissed_pool_does_what_it_was_given_and_ends() {
        let (done, all) = channel();
        let threads = WorkerThreads::start("test", 2, 0).unwrap();
        threads.submit((0..10).map(|_| {
            let done = done.clone();
            Box::new(move || done.send(()).unwrap()) as Job
        }));
        drop((threads, done));
        assert_eq!(all.iter().count(), 10);
    }
}
