//! The threads that compute, behind one queue. A job is taken by one thread and never by one that has begun another: a request waits for
//! nobody else's picture. An idle thread looks for work a little longer before it sleeps, because waking a sleeping one takes a tenth of a
//! millisecond, a tenth of a small picture.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// How long an idle thread looks for work before it sleeps: a client on the same machine is back with its next pose in half of this. Sixty
/// poses a second cost every thread about a hundredth of its processor.
const AWAKE: Duration = Duration::from_micros(200);

type Job = Box<dyn FnOnce() + Send>;

/// Threads that end when this is dropped, each after its job. The default has none.
#[derive(Debug, Default)]
pub(crate) struct WorkerThreads(Arc<WorkerState>);

#[derive(Default)]
struct WorkerState {
    queue: Mutex<Queue>,
    work: Condvar,
    /// Jobs that wait: what an idle thread looks at without the lock.
    waiting: AtomicUsize,
}

impl std::fmt::Debug for WorkerState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared").field("waiting", &self.waiting).finish_non_exhaustive()
    }
}

#[derive(Default)]
struct Queue {
    jobs: VecDeque<Job>,
    asleep: usize,
    over: bool,
}

impl WorkerThreads {
    /// Starts `threads` threads of that name. `nice`: how far they stand back for others of the process (Linux; 0 to 19).
    ///
    /// # Errors
    /// The operating system gives no more.
    pub(crate) fn start(name: &str, threads: usize, nice: i32) -> Result<Self, std::io::Error> {
        let crew = Self(Arc::default());
        for index in 0..threads {
            let shared = Arc::clone(&crew.0);
            std::thread::Builder::new().name(format!("{name}-{index}")).spawn(move || {
                lower_priority(nice);
                shared.run();
            })?;
        }
        Ok(crew)
    }

    /// A job waits for a thread.
    pub(crate) fn is_thread_wanted(&self) -> bool {
        self.0.waiting.load(Ordering::Relaxed) > 0
    }

    /// Hands over jobs at once, to as many threads. A job that panics ends its thread: jobs catch.
    pub(crate) fn submit(&self, jobs: impl IntoIterator<Item = Job>) {
        let mut queue = self.0.lock();
        let before = queue.jobs.len();
        queue.jobs.extend(jobs);
        let wake = queue.asleep.min(queue.jobs.len() - before);
        self.0.waiting.store(queue.jobs.len(), Ordering::Release);
        drop(queue);
        for _ in 0..wake {
            self.0.work.notify_one();
        }
    }
}

/// A thread's own niceness is Linux'; elsewhere it would be the process's. Where it is refused, all is as if it had not been asked.
fn lower_priority(nice: i32) {
    #[cfg(target_os = "linux")]
    if nice > 0 {
        let _ = rustix::process::nice(nice);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}

impl Drop for WorkerThreads {
    fn drop(&mut self) {
        self.0.lock().over = true;
        self.0.work.notify_all();
    }
}

impl WorkerState {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        // Nothing panics under the lock.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self) {
        // A pool of this thread alone: what a small job would split stays here instead of waiting for others.
        let _alone: Option<ThreadPool> = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().ok();
        while let Some(job) = self.next() {
            job();
        }
    }

    /// The next job; none when the crew is dismissed.
    fn next(&self) -> Option<Job> {
        let mut idle = None;
        loop {
            if self.waiting.load(Ordering::Acquire) > 0 {
                let mut queue = self.lock();
                if let Some(job) = self.take(&mut queue) {
                    return Some(job);
                }
            }
            if idle.get_or_insert_with(Instant::now).elapsed() >= AWAKE {
                return self.sleep();
            }
            // Whoever else wants this processor gets it.
            std::thread::yield_now();
        }
    }

    fn sleep(&self) -> Option<Job> {
        let mut queue = self.lock();
        loop {
            if let Some(job) = self.take(&mut queue) {
                return Some(job);
            }
            if queue.over {
                return None;
            }
            queue.asleep += 1;
            queue = self.work.wait(queue).unwrap_or_else(PoisonError::into_inner);
            queue.asleep -= 1;
        }
    }

    fn take(&self, queue: &mut Queue) -> Option<Job> {
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
        let crew = WorkerThreads::start("test", 3, 0).unwrap();
        for _ in 0..50 {
            let meet = Arc::new(Barrier::new(4));
            crew.submit((0..3).map(|_| {
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
        let crew = WorkerThreads::start("test", 1, 0).unwrap();
        let (done, order) = channel();
        for k in 0..20 {
            let done = done.clone();
            crew.submit([Box::new(move || done.send(k).unwrap()) as Job]);
            if k % 5 == 0 {
                std::thread::sleep(2 * AWAKE);
            }
        }
        drop(done);
        assert_eq!(order.iter().collect::<Vec<_>>(), (0..20).collect::<Vec<_>>());
    }

    #[test]
    fn a_dismissed_crew_does_what_it_was_given_and_ends() {
        let (done, all) = channel();
        let crew = WorkerThreads::start("test", 2, 0).unwrap();
        crew.submit((0..10).map(|_| {
            let done = done.clone();
            Box::new(move || done.send(()).unwrap()) as Job
        }));
        drop((crew, done));
        assert_eq!(all.iter().count(), 10);
    }
}
