//! Freed memory goes back to the system. glibc gives every thread an arena of its own and keeps what is freed in it: after a minute of mixed requests 27 MiB
//! were in use and 150 to 200 resident (it grew), trimmed every three seconds or not, because the free end of an arena is not trimmed but for the
//! first one's. So there are few arenas; large blocks are the system's and go back at once; and what is free in between is handed back now and then: 41 MiB
//! are resident then. Trimming walks the free blocks, some milliseconds each time; what is needed again is faulted in again.

use std::ffi::c_int;
use std::num::NonZero;
use std::time::Duration;

/// Between two trims: seldom beside requests, soon beside a crowd that has left.
const PAUSE: Duration = Duration::from_secs(3);
/// Processors that share an arena. Threads keep small blocks to themselves and meet there seldom.
const PROCESSORS: usize = 4;
/// A block as large as this is mapped by itself. Frames of a drag are made of smaller ones.
const LARGE: c_int = 4 << 20;

/// The end of an arena goes back only by trimming: a drag that frees its frame would otherwise give back what the next one takes.
const END: c_int = 64 << 20;

/// Of `malloc.h`.
const M_TRIM_THRESHOLD: c_int = -1;
const M_MMAP_THRESHOLD: c_int = -3;
const M_ARENA_MAX: c_int = -8;

unsafe extern "C" {
    /// `malloc_trim(3)`; any thread may call it at any time.
    safe fn malloc_trim(pad: usize) -> c_int;
    /// `mallopt(3)`; called before there is another thread.
    safe fn mallopt(option: c_int, value: c_int) -> c_int;
}

/// Trims as long as the process lives. To be called first: arenas are there as soon as threads are.
pub(crate) fn start() {
    let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
    let arenas = c_int::try_from(processors.div_ceil(PROCESSORS)).unwrap_or(c_int::MAX);
    // Where glibc refuses, the service runs, and holds more.
    let _ = (mallopt(M_ARENA_MAX, arenas), mallopt(M_MMAP_THRESHOLD, LARGE), mallopt(M_TRIM_THRESHOLD, END));
    let trims = || {
        loop {
            std::thread::sleep(PAUSE);
            // Whether anything was given back does not matter.
            let _ = malloc_trim(0);
        }
    };
    if let Err(error) = std::thread::Builder::new().name("heap".to_owned()).spawn(trims) {
        tracing::warn!(%error, "memory that is freed is not given back");
    }
}
