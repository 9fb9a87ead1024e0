//! The compute threads of one class, behind one queue of jobs. A thread finishes its job before it
//! takes the next one, so that no request waits for a part of another's. Idle threads sleep: one
//! that polled would not get its processor back in time once others want it (`README.md`).

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::arena::{Arena, spawn};

type Job = Box<dyn FnOnce() + Send>;

/// Compute threads; they end when this is dropped, after the queued jobs. The default has none.
#[derive(Debug, Default)]
pub(crate) struct WorkerThreads {
    state: Arc<WorkerState>,
    name: String,
    niceness: i32,
    arena: Arena,
    /// Threads that work, and those beyond them that have been started in the place of sleeping
    /// ones.
    threads: usize,
    more: Mutex<usize>,
}

#[derive(Default)]
struct WorkerState {
    queue: Mutex<JobQueue>,
    /// Number of queued jobs, to be read without the lock.
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
    is_closed: bool,
}

impl JobQueue {
    /// Adds jobs; returns the threads to wake for them, at most `most`.
    fn push(&mut self, jobs: impl IntoIterator<Item = Job>, most: usize) -> Vec<Thread> {
        let before = self.jobs.len();
        self.jobs.extend(jobs);
        let wanted = (self.jobs.len() - before).min(most);
        self.asleep
            .split_off(self.asleep.len().saturating_sub(wanted))
    }
}

impl WorkerThreads {
    /// Starts `threads` threads with this name and niceness (0 to 19; Linux only).
    /// Errors: The operating system refused to start a thread.
    pub(crate) fn start(
        name: &str,
        threads: usize,
        niceness: i32,
        arena: Arena,
    ) -> Result<Self, std::io::Error> {
        let started = Self {
            state: Arc::default(),
            name: name.to_owned(),
            niceness,
            arena,
            threads,
            more: Mutex::default(),
        };
        (0..threads).try_for_each(|index| started.start_one(index))?;
        Ok(started)
    }

    fn start_one(&self, index: usize) -> Result<(), std::io::Error> {
        let (state, niceness) = (Arc::clone(&self.state), self.niceness);
        spawn(&format!("{}-{index}", self.name), self.arena, move || {
            lower_priority(niceness);
            state.run();
        })
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
        let most = wakes(queue.asleep.len());
        let woken = queue.push(jobs, most);
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
        let threads = WorkerThreads::start("test", 3, 0, Arena::Other).unwrap();
        for _ in 0..50 {
            let meet = Arc::new(Barrier::new(4));
            for _ in 0..3 {
                let meet = Arc::clone(&meet);
                threads.submit(Box::new(move || _ = meet.wait()));
            }
            meet.wait();
        }
    }

    /// Waits until this number of threads sleep.
    fn wait_for_sleepers(threads: &WorkerThreads, count: usize) {
        while threads.state.lock().asleep.len() != count {
            std::thread::yield_now();
        }
    }

    #[test]
    fn a_thread_that_does_not_work_sleeps_and_each_job_wakes_one() {
        let nothing = || -> Job { Box::new(|| ()) };
        let threads = WorkerThreads::start("test", 3, 0, Arena::Other).unwrap();
        let state = &threads.state;
        for _ in 0..20 {
            wait_for_sleepers(&threads, 3);
            let mut queue = state.lock();
            let mut woken = queue.push([nothing()], 1);
            assert_eq!((woken.len(), queue.asleep.len()), (1, 2));
            // The one that was woken may not have its processor yet: it is not counted upon.
            woken.append(&mut queue.push([nothing(), nothing()], 1));
            assert_eq!((woken.len(), queue.asleep.len()), (2, 1));
            drop(queue);
            woken.iter().for_each(Thread::unpark);
        }
    }

    #[test]
    fn jobs_of_one_thread_run_in_order_and_sleepers_are_woken() {
        let threads = WorkerThreads::start("test", 1, 0, Arena::Other).unwrap();
        let (done, order) = channel();
        for k in 0..20 {
            let done = done.clone();
            threads.submit(Box::new(move || done.send(k).unwrap()));
            if k % 5 == 0 {
                wait_for_sleepers(&threads, 1);
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
        let threads = WorkerThreads::start("test", 2, 0, Arena::Other).unwrap();
        for _ in 0..10 {
            let done = done.clone();
            threads.submit(Box::new(move || done.send(()).unwrap()));
        }
        drop((threads, done));
        assert_eq!(all.iter().count(), 10);
    }
}
