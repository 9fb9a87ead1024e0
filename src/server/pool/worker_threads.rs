//! The compute threads of one class, behind one queue of jobs. A thread finishes its job before it
//! takes the next one, so that no request waits for a part of another's. One idle thread polls for
//! a short time before it sleeps, because waking a sleeping thread takes up to a tenth of a
//! millisecond; the other idle threads sleep.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// How long an idle thread polls before it sleeps: a client on the same machine sends its next pose
/// within half of this. At sixty poses a second it costs about 1 % of a processor.
const POLL_TIME: Duration = Duration::from_micros(200);

type Job = Box<dyn FnOnce() + Send>;

/// Compute threads; they end when this is dropped, after the queued jobs. The default has none.
#[derive(Debug, Default)]
pub(crate) struct WorkerThreads {
    state: Arc<WorkerState>,
    name: String,
    niceness: i32,
    /// Threads that work, and those beyond them that have been started in the place of sleeping
    /// ones.
    threads: usize,
    more: Mutex<usize>,
}

#[derive(Default)]
struct WorkerState {
    queue: Mutex<JobQueue>,
    /// Number of queued jobs, for polling without the lock.
    waiting: AtomicUsize,
}

impl std::fmt::Debug for WorkerState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WorkerState")
            .field("waiting", &self.waiting)
            .finish_non_exhaustive()
    }
}

#[derive(Default)]
struct JobQueue {
    jobs: VecDeque<Job>,
    /// Threads that sleep, the last one to fall asleep last. It is woken first: two threads that
    /// take turns stay on their processors.
    asleep: Vec<Thread>,
    /// Whether an idle thread polls.
    is_polled: bool,
    is_closed: bool,
}

impl JobQueue {
    /// Adds jobs; returns the threads to wake for them, at most `idle` of the idle ones. A thread
    /// that polls takes the first job.
    fn push(&mut self, jobs: impl IntoIterator<Item = Job>, idle: usize) -> Vec<Thread> {
        let before = self.jobs.len();
        self.jobs.extend(jobs);
        let is_polled = usize::from(self.is_polled && before == 0);
        let wanted = (self.jobs.len() - before)
            .min(idle)
            .saturating_sub(is_polled);
        self.asleep
            .split_off(self.asleep.len().saturating_sub(wanted))
    }
}

impl WorkerThreads {
    /// Starts `threads` threads with this name and niceness (0 to 19; Linux only).
    /// Errors: The operating system refused to start a thread.
    pub(crate) fn start(name: &str, threads: usize, niceness: i32) -> Result<Self, std::io::Error> {
        let started = Self {
            state: Arc::default(),
            name: name.to_owned(),
            niceness,
            threads,
            more: Mutex::default(),
        };
        (0..threads).try_for_each(|index| started.start_one(index))?;
        Ok(started)
    }

    fn start_one(&self, index: usize) -> Result<(), std::io::Error> {
        let (state, niceness) = (Arc::clone(&self.state), self.niceness);
        let thread = std::thread::Builder::new().name(format!("{}-{index}", self.name));
        thread.spawn(move || {
            lower_priority(niceness);
            state.run();
        })?;
        Ok(())
    }

    /// Makes sure that this number of threads may sleep in the middle of their jobs, and as many as
    /// before work. Returns false if the operating system refuses to start a thread.
    pub(crate) fn reserve(&self, sleeping: usize) -> bool {
        // No code panics under the lock.
        let mut more = self.more.lock().unwrap_or_else(PoisonError::into_inner);
        while *more < sleeping {
            if self.start_one(self.threads + *more).is_err() {
                return false;
            }
            *more += 1;
        }
        true
    }

    /// Whether a job waits for a thread.
    pub(crate) fn is_thread_wanted(&self) -> bool {
        self.state.waiting.load(Ordering::Relaxed) > 0
    }

    /// Queues a job and wakes a thread. A job that panics ends its thread, so jobs catch panics.
    pub(crate) fn submit(&self, job: Job) {
        self.queue([job], |_| 1);
    }

    /// Queues jobs that help another one. They wake idle threads as long as one is left for the
    /// next job; later ones wait until a thread is free.
    pub(crate) fn offer(&self, jobs: impl IntoIterator<Item = Job>) {
        self.queue(jobs, |idle| idle.saturating_sub(1));
    }

    fn queue(&self, jobs: impl IntoIterator<Item = Job>, wakes: impl FnOnce(usize) -> usize) {
        let mut queue = self.state.lock();
        let idle = queue.asleep.len() + usize::from(queue.is_polled);
        let woken = queue.push(jobs, wakes(idle));
        self.state
            .waiting
            .store(queue.jobs.len(), Ordering::Release);
        drop(queue);
        woken.iter().rev().for_each(Thread::unpark);
    }
}

/// Sets the niceness of this thread. Linux only: elsewhere it would apply to the process. A refusal
/// changes nothing.
pub(super) fn lower_priority(niceness: i32) {
    #[cfg(target_os = "linux")]
    if niceness > 0 {
        let _ = rustix::process::nice(niceness);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = niceness;
}

impl Drop for WorkerThreads {
    fn drop(&mut self) {
        let mut queue = self.state.lock();
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
        // A rayon pool of this thread only: parallel iterators of a job run here instead of on the
        // global pool.
        let _local: Option<ThreadPool> = ThreadPoolBuilder::new()
            .num_threads(1)
            .use_current_thread()
            .build()
            .ok();
        while let Some(job) = self.next() {
            job();
        }
    }

    /// The next job; `None` when the threads are dropped.
    fn next(&self) -> Option<Job> {
        let this = std::thread::current();
        let mut queue = self.lock();
        let mut may_poll = true;
        loop {
            if let Some(job) = self.take(&mut queue) {
                return Some(job);
            }
            if queue.is_closed {
                return None;
            }
            if may_poll && !queue.is_polled {
                may_poll = false;
                queue.is_polled = true;
                drop(queue);
                self.poll();
                queue = self.lock();
                queue.is_polled = false;
            } else {
                queue.asleep.push(this.clone());
                drop(queue);
                std::thread::park();
                queue = self.lock();
                // It is still there if it was not woken by `submit`.
                queue.asleep.retain(|thread| thread.id() != this.id());
            }
        }
    }

    /// Waits a short time for a job.
    fn poll(&self) {
        let began = Instant::now();
        while self.waiting.load(Ordering::Acquire) == 0 && began.elapsed() < POLL_TIME {
            // Other threads may use this processor.
            std::thread::yield_now();
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
            for _ in 0..3 {
                let meet = Arc::clone(&meet);
                threads.submit(Box::new(move || _ = meet.wait()));
            }
            meet.wait();
        }
    }

    #[test]
    fn jobs_of_one_thread_run_in_order_and_sleepers_are_woken() {
        let threads = WorkerThreads::start("test", 1, 0).unwrap();
        let (done, order) = channel();
        for k in 0..20 {
            let done = done.clone();
            threads.submit(Box::new(move || done.send(k).unwrap()));
            if k % 5 == 0 {
                std::thread::sleep(2 * POLL_TIME);
            }
        }
        drop(done);
        assert_eq!(
            order.iter().collect::<Vec<_>>(),
            (0..20).collect::<Vec<_>>()
        );
    }

    #[test]
    fn a_dismissed_pool_does_what_it_was_given_and_ends() {
        let (done, all) = channel();
        let threads = WorkerThreads::start("test", 2, 0).unwrap();
        for _ in 0..10 {
            let done = done.clone();
            threads.submit(Box::new(move || done.send(()).unwrap()));
        }
        drop((threads, done));
        assert_eq!(all.iter().count(), 10);
    }
}
