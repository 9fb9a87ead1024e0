//! Long work without Python's lock, on threads of this process.
//!
//! Nothing is started before the first work. A forked child has none of its parent's threads, so it
//! gets a pool of its own: pools are known by the number of their process. The parent's are left
//! alone, because to drop one would be to wait for threads that do not exist. All of this state is
//! read and changed under Python's lock only, which `os.fork` holds too: no child inherits the lock
//! of [`POOLS`] closed.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::available_parallelism;
use std::time::Duration;

use mlswarp::Cancel;
use mlswarp_contract::problem::{Code, Problem};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{exception, internal};

/// The variable with the number of threads.
const VARIABLE: &str = "MLSWARP_NUM_THREADS";
/// The most threads; each has a stack.
const MOST_THREADS: usize = 1024;
/// How long Python's signals wait while work goes on.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

#[derive(Debug)]
struct Pools {
    process: u32,
    /// What [`set_num_threads`] asked for.
    threads: Option<usize>,
    /// Pools of that many threads. Those of several threads are shared by all calls. Those of one
    /// thread are lent, one to each call: then the threads of Python work side by side.
    idle: Vec<Arc<ThreadPool>>,
}

static POOLS: Mutex<Pools> = Mutex::new(Pools {
    process: 0,
    threads: None,
    idle: Vec::new(),
});

/// `py` is the proof that Python's lock is held.
fn with_pools<T>(_py: Python<'_>, use_: impl FnOnce(&mut Pools) -> T) -> T {
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if pools.process != process {
        let inherited = std::mem::take(&mut pools.idle);
        #[expect(clippy::mem_forget, reason = "the threads are those of the parent")]
        std::mem::forget(inherited);
        pools.process = process;
    }
    use_(&mut pools)
}

impl Pools {
    fn threads(&self) -> Result<usize, Problem> {
        if let Some(threads) = self.threads {
            return Ok(threads);
        }
        match std::env::var(VARIABLE) {
            Ok(text) if !text.trim().is_empty() => text
                .trim()
                .parse()
                .ok()
                .filter(|threads| (1..=MOST_THREADS).contains(threads))
                .ok_or_else(|| wrong_number(&format!("{VARIABLE}={text}"))),
            _ => Ok(available_parallelism().map_or(1, std::num::NonZero::get)),
        }
    }

    /// The pool of a call, which [`Pools::give_back`] takes when that is over.
    fn lend(&mut self) -> Result<Arc<ThreadPool>, Problem> {
        let threads = self.threads()?;
        let idle = if threads == 1 {
            self.idle.pop()
        } else {
            self.idle.first().cloned()
        };
        if let Some(pool) = idle {
            return Ok(pool);
        }
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|k| format!("mlswarp-{k}"))
            .build()
            .map_err(|e| internal(&format!("cannot start {threads} compute threads: {e}")))?;
        let pool = Arc::new(pool);
        if threads > 1 {
            self.idle.push(Arc::clone(&pool));
        }
        Ok(pool)
    }

    fn give_back(&mut self, pool: Arc<ThreadPool>) {
        if pool.current_num_threads() == 1 && self.threads() == Ok(1) {
            self.idle.push(pool);
        }
    }
}

fn wrong_number(found: &str) -> Problem {
    let expected = format!("expected a number of threads, 1 to {MOST_THREADS}; found {found}");
    Problem::new(Code::BadValue, expected)
}

/// Runs work on the pool of this process. The calling thread looks after Python's signals: an
/// exception of one of them (Ctrl-C) ends the work and is raised.
pub(crate) fn run<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Cancel) -> Result<T, Problem> + Send + 'static,
) -> PyResult<T> {
    let pool = with_pools(py, Pools::lend).map_err(|problem| exception(py, &problem))?;
    let cancel = Cancel::new();
    let (done, mut results) = sync_channel(1);
    let of_work = cancel.clone();
    pool.spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| work(&of_work)));
        // Always received.
        let _ = done.send(result);
    });
    let mut interrupt = None;
    let result = loop {
        let waited;
        (waited, results) = py.detach(move || (results.recv_timeout(SIGNAL_INTERVAL), results));
        match waited {
            Ok(result) => break result.ok(),
            Err(RecvTimeoutError::Disconnected) => break None,
            Err(RecvTimeoutError::Timeout) => {
                if let Err(exception) = py.check_signals() {
                    cancel.cancel();
                    interrupt = Some(exception);
                }
            }
        }
    };
    with_pools(py, |pools| pools.give_back(pool));
    if let Some(interrupt) = interrupt {
        return Err(interrupt);
    }
    let panicked = || {
        Err(internal(
            "a computation failed; please report what caused it",
        ))
    };
    result
        .unwrap_or_else(panicked)
        .map_err(|problem| exception(py, &problem))
}

/// The number of threads that the next work uses.
#[pyfunction]
pub(crate) fn num_threads(py: Python<'_>) -> PyResult<usize> {
    with_pools(py, |pools| pools.threads()).map_err(|problem| exception(py, &problem))
}

/// Sets the number of threads of this process. Work that goes on keeps its own.
#[pyfunction]
pub(crate) fn set_num_threads(py: Python<'_>, threads: i64) -> PyResult<()> {
    let wanted = usize::try_from(threads)
        .ok()
        .filter(|threads| (1..=MOST_THREADS).contains(threads))
        .ok_or_else(|| exception(py, &wrong_number(&threads.to_string())))?;
    let former = with_pools(py, |pools| {
        pools.threads = Some(wanted);
        std::mem::take(&mut pools.idle)
    });
    drop(former);
    Ok(())
}
