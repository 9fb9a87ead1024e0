//! Where large values are freed. Unmapping takes a millisecond for every few tens of megabytes, for
//! which the runtime's thread would not serve anybody.

use std::ops::Deref;
use std::sync::Arc;

use mlswarp::warp::RestSpec;
use tokio::runtime::Handle;

use crate::wire::Pose;

/// Values of fewer bytes are freed where they are dropped: handing them to another thread would
/// take longer.
const MIN_ASIDE_BYTES: u64 = 2 << 20;
/// Bytes that are freed in the time of a handle, which may have an allocation of its own.
const HANDLE_BYTES: u64 = 512;

/// Drops a value of this number of bytes: on a blocking thread, if this may be a thread of the
/// runtime.
pub fn free<T: Send + 'static>(value: T, bytes: u64) {
    match Handle::try_current() {
        Ok(runtime) if bytes >= MIN_ASIDE_BYTES => {
            drop(runtime.spawn_blocking(move || drop(value)))
        }
        _ => drop(value),
    }
}

/// A value that [`free`] drops.
#[derive(Debug)]
pub struct FreedAside<T: Send + 'static> {
    value: Option<T>,
    bytes: u64,
}

impl<T: Send> FreedAside<T> {
    /// Takes a value of many small parts.
    pub const fn new(value: T) -> Self {
        Self::of(value, u64::MAX)
    }

    /// Takes a value that is freed in the time of this number of bytes.
    const fn of(value: T, bytes: u64) -> Self {
        let value = Some(value);
        Self { value, bytes }
    }
}

impl<T: Send> Deref for FreedAside<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.value
            .as_ref()
            .expect("it is taken only when it is dropped")
    }
}

impl<T: Send> Drop for FreedAside<T> {
    fn drop(&mut self) {
        free(self.value.take(), self.bytes);
    }
}

/// A value with handles, which may be many. A copy is the same value, so that it takes no time, and
/// the last one [frees](free) it.
#[derive(Debug)]
pub struct SharedHandles<T: Send + Sync + 'static>(Arc<FreedAside<T>>);

impl<T: Send + Sync> SharedHandles<T> {
    fn new(value: T, handles: usize) -> Self {
        Self(Arc::new(FreedAside::of(
            value,
            HANDLE_BYTES * handles as u64,
        )))
    }
}

impl From<RestSpec> for SharedHandles<RestSpec> {
    fn from(rest: RestSpec) -> Self {
        let handles = rest.p.len();
        Self::new(rest, handles)
    }
}

impl From<Pose> for SharedHandles<Pose> {
    fn from(pose: Pose) -> Self {
        let handles = pose.q.len();
        Self::new(pose, handles)
    }
}

impl<T: Send + Sync> Clone for SharedHandles<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T: Send + Sync> Deref for SharedHandles<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T: Send + Sync + PartialEq> PartialEq for SharedHandles<T> {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || **self == **other
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread::{self, ThreadId};

    use super::*;

    struct Large(mpsc::Sender<ThreadId>);

    impl Drop for Large {
        fn drop(&mut self) {
            let _ = self.0.send(thread::current().id());
        }
    }

    #[test]
    fn large_values_are_freed_aside_of_the_runtime() {
        let (says, said) = mpsc::channel();
        let here = thread::current().id();
        free(Large(says.clone()), u64::MAX);
        assert_eq!(said.recv().unwrap(), here, "without a runtime");
        let runtime = tokio::runtime::Builder::new_current_thread()
            .build()
            .unwrap();
        runtime.block_on(async { free(Large(says.clone()), MIN_ASIDE_BYTES - 1) });
        assert_eq!(said.recv().unwrap(), here, "a small one");
        runtime.block_on(async { free(Large(says.clone()), MIN_ASIDE_BYTES) });
        assert_ne!(said.recv().unwrap(), here);
        runtime.block_on(async { drop(FreedAside::new(Large(says))) });
        assert_ne!(said.recv().unwrap(), here);
    }
}
