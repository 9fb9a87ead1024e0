//! Freed memory goes back to the system. glibc keeps what is freed in the arenas of its threads, for as long as anything above it is in use: after
//! some minutes of mixed requests several times what is in use was resident, and it grew. Trimming walks the free blocks and hands their pages
//! back, some milliseconds each time; what is needed again is faulted in again.

use std::ffi::c_int;
use std::time::Duration;

/// Between two trims: seldom beside requests, soon beside a crowd that has left.
const PAUSE: Duration = Duration::from_secs(3);

unsafe extern "C" {
    /// `malloc_trim(3)`; any thread may call it at any time.
    safe fn malloc_trim(pad: usize) -> c_int;
}

/// Trims as long as the process lives.
pub(crate) fn trim_now_and_then() {
    let trims = || {
        loop {
            std::thread::sleep(PAUSE);
            // Whether anything was given back does not matter.
            let _ = malloc_trim(0);
        }
    };
    // Without it the service runs, and holds more.
    if let Err(error) = std::thread::Builder::new().name("heap".to_owned()).spawn(trims) {
        tracing::warn!(%error, "memory that is freed is not given back");
    }
}
