//! Returns freed memory to the system. glibc keeps it in the arenas of threads and trims only the
//! end of the first one: after a minute of mixed requests 27 MiB were in use and 150 to 200
//! resident. With few arenas, mapped large blocks and regular trimming 41 MiB are resident. When
//! use and freed memory together exceed the budget (`limits/freed.rs`), it is trimmed more often.

use std::ffi::{c_int, c_void};
use std::num::NonZero;
use std::thread;
use std::time::Duration;

use mlswarp_server::limits::freed::FREED;
use mlswarp_server::pool::arena;

/// A trim takes some milliseconds. The least time holds then.
const TRIM_INTERVAL: Duration = Duration::from_secs(3);
const MIN_TRIM_INTERVAL: Duration = Duration::from_millis(50);
/// On machines with at most this many processors, long work uses the main arena only, and drags use
/// others (`pool/arena.rs`).
const MAX_CHOSEN: usize = 4;
/// On larger machines, any thread uses any arena.
const PROCESSORS_PER_ARENA: usize = 4;
/// Larger blocks are mapped by themselves, and returned as soon as they are freed: a trim of what
/// many request bodies have left keeps drags from their arena for 150 ms. Frames of a drag are made
/// of smaller ones.
const MMAP_THRESHOLD: c_int = 1 << 20;
/// High, or a drag that frees its frame would return what its next frame takes. But a trim leaves
/// that much of each arena but the main one.
const TRIM_THRESHOLD: c_int = 16 << 20;

// Of `malloc.h`.
const M_TRIM_THRESHOLD: c_int = -1;
const M_MMAP_THRESHOLD: c_int = -3;
const M_ARENA_MAX: c_int = -8;

unsafe extern "C" {
    /// `malloc_trim(3)`; any thread may call it at any time.
    safe fn malloc_trim(pad: usize) -> c_int;
    /// `mallopt(3)`; called before there is another thread.
    safe fn mallopt(option: c_int, value: c_int) -> c_int;
    /// `sbrk(3)`; with 0 it changes nothing.
    safe fn sbrk(increment: isize) -> *mut c_void;
}

/// Trims as long as the process lives. Call it first: threads create arenas.
pub(crate) fn start() {
    let processors = thread::available_parallelism().map_or(1, NonZero::get);
    let is_chosen = processors <= MAX_CHOSEN;
    if is_chosen {
        // The main arena ends there.
        arena::choose(sbrk(0).addr());
    }
    // The main one; that of the thread that trims, and of drags; one for each async thread, unless
    // the configuration, which is not read yet, asks for more of them.
    let arenas = if is_chosen {
        2 + processors.div_ceil(2)
    } else {
        processors.div_ceil(PROCESSORS_PER_ARENA)
    };
    let arenas = c_int::try_from(arenas).unwrap_or(c_int::MAX);
    // Without these options the service uses more memory.
    let _ = (
        mallopt(M_ARENA_MAX, arenas),
        mallopt(M_MMAP_THRESHOLD, MMAP_THRESHOLD),
        mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD),
    );
    let trims = || {
        FREED.returned_by(thread::current());
        loop {
            thread::sleep(MIN_TRIM_INTERVAL);
            thread::park_timeout(TRIM_INTERVAL - MIN_TRIM_INTERVAL);
            FREED.forget();
            malloc_trim(0);
        }
    };
    if let Err(error) = thread::Builder::new().name("heap".to_owned()).spawn(trims) {
        tracing::warn!(%error, "memory that is freed is not given back");
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::mpsc::channel;

    use mlswarp_server::pool::arena::{Arena, spawn};

    use super::*;

    #[test]
    fn long_work_and_drags_allocate_from_arenas_apart() -> io::Result<()> {
        start();
        let (tells, told) = channel();
        for arena in [Arena::Main, Arena::Other].repeat(6) {
            let tells = tells.clone();
            spawn("test", arena, move || {
                _ = tells.send(arena.is_of_this_thread());
            })?;
        }
        drop(tells);
        // On a large machine the arenas are shared.
        let processors = thread::available_parallelism()?.get();
        assert!(processors > MAX_CHOSEN || told.iter().all(|is_apart| is_apart));
        Ok(())
    }
}
