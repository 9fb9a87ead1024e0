//! The system's allocator with counters: bytes that live, and the sum of all that was ever asked
//! for. A thread may be left out: the client's.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

#[global_allocator]
static COUNTING: Counting = Counting;

static LIVE: AtomicI64 = AtomicI64::new(0);
static ASKED: AtomicU64 = AtomicU64::new(0);
static CALLS: AtomicU64 = AtomicU64::new(0);

thread_local! {
    /// This thread's allocations are not counted. A plain cell: reading it allocates nothing.
    static LEFT_OUT: Cell<bool> = const { Cell::new(false) };
}

struct Counting;

/// What this thread allocates and frees is not counted from now on.
pub(crate) fn leave_this_thread_out() {
    LEFT_OUT.set(true);
}

/// Bytes that live now.
pub(crate) fn live() -> i64 {
    LIVE.load(Ordering::SeqCst)
}

/// Bytes asked for so far, and in how many calls. A buffer that grows counts again.
pub(crate) fn asked() -> (u64, u64) {
    (ASKED.load(Ordering::SeqCst), CALLS.load(Ordering::SeqCst))
}

fn count(grows: i64, asked: usize) {
    if LEFT_OUT.get() {
        return;
    }
    LIVE.fetch_add(grows, Ordering::SeqCst);
    if asked > 0 {
        ASKED.fetch_add(asked as u64, Ordering::SeqCst);
        CALLS.fetch_add(1, Ordering::SeqCst);
    }
}

// SAFETY: every call is handed to `System` as it came; counting touches no memory of the caller's
// and does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64, layout.size());
        // SAFETY: the caller's promise is `System`'s.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64, layout.size());
        // SAFETY: the caller's promise is `System`'s.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, old: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size as i64 - layout.size() as i64, size);
        // SAFETY: the caller's promise is `System`'s.
        unsafe { System.realloc(old, layout, size) }
    }

    unsafe fn dealloc(&self, old: *mut u8, layout: Layout) {
        count(-(layout.size() as i64), 0);
        // SAFETY: the caller's promise is `System`'s.
        unsafe { System.dealloc(old, layout) }
    }
}
