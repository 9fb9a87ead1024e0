//! Which arena of glibc's allocator a thread uses. Each arena has one lock, and a thread that is
//! interrupted while it holds it makes all others of its arena wait: long work has low priority, so
//! that it was seen to keep the async thread from a small block for 20 ms. So long work uses the
//! main arena, and drags another one.

use std::convert::Infallible;
use std::hint::black_box;
use std::ptr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

/// An address beside the main arena; 0 if arenas are not chosen.
static MAIN_ARENA: AtomicUsize = AtomicUsize::new(0);

/// glibc gives new threads its arenas in turns, and cannot be asked for one. A thread that gets
/// another one than it should starts the next in its place; the last works wherever it is.
const MAX_ATTEMPTS: u32 = 16;
/// One search at a time: several would take each other's turns.
static SEARCHES: Mutex<()> = Mutex::new(());
/// The other arenas are mapped near the stack, much farther away than this from the main one: 64
/// GiB of an address space of 64 bits.
const MAIN_ARENA_REACH: usize = usize::MAX >> 28;
/// So large that it comes from the thread's arena, and not from blocks that it has freed for
/// others.
const ASKED_BYTES: usize = 4096;

/// What a thread does, until it begins.
type Run = Arc<Mutex<Option<Box<dyn FnOnce() + Send>>>>;

/// The arena that a thread should use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arena {
    /// For long work.
    Main,
    /// For drags. The threads of the runtime, which are started first, have some of their own.
    #[default]
    Other,
}

impl Arena {
    /// Whether this thread uses it.
    pub fn is_of_this_thread(self) -> bool {
        let block = black_box(Box::new([0_u8; ASKED_BYTES]));
        let distance = ptr::from_ref(&*block)
            .addr()
            .abs_diff(MAIN_ARENA.load(Ordering::Relaxed));
        (distance < MAIN_ARENA_REACH) == (self == Self::Main)
    }
}

/// Says where the main arena is, and that there are others, few enough that threads meet in them.
pub fn choose(main_arena: usize) {
    MAIN_ARENA.store(main_arena, Ordering::Relaxed);
}

/// Starts a thread.
/// Errors: The operating system refused.
pub fn spawn(name: &str, arena: Arena, run: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    let attempts = if MAIN_ARENA.load(Ordering::Relaxed) == 0 {
        1
    } else {
        MAX_ATTEMPTS
    };
    // The closure of a thread that cannot be started is lost, so it is not moved into one.
    let run: Run = Arc::new(Mutex::new(Some(Box::new(run))));
    attempt(name.to_owned(), arena, attempts, run).map(drop)
}

/// Returns what ends when the thread, or another one in its place, has found its arena.
fn attempt(
    name: String,
    arena: Arena,
    attempts: u32,
    run: Run,
) -> std::io::Result<Receiver<Infallible>> {
    let (searches, search) = channel();
    let thread = thread::Builder::new().name(name.clone());
    thread.spawn(move || {
        let is_last = attempts <= 1 || arena.is_of_this_thread();
        if !is_last {
            let _turn = (attempts == MAX_ATTEMPTS)
                .then(|| SEARCHES.lock().unwrap_or_else(PoisonError::into_inner));
            if let Ok(next) = attempt(name, arena, attempts - 1, Arc::clone(&run)) {
                // An arena without a thread is given to the next thread: this one keeps its own.
                let _ = next.recv();
                return;
            }
        }
        drop(searches);
        let run = run.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(run) = run {
            run();
        }
    })?;
    Ok(search)
}
