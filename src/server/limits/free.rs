//! Where large values are freed. Unmapping takes a millisecond for every few tens of megabytes, for
//! which the runtime's thread would not serve anybody.

use std::ops::Deref;

use tokio::runtime::Handle;

/// Values of fewer bytes are freed where they are dropped: handing them to another thread would
/// take longer.
const MIN_ASIDE_BYTES: u64 = 2 << 20;

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

/// A value of many small parts, which [`free`] drops whatever its size.
#[derive(Debug)]
pub struct FreedAside<T: Send + 'static>(Option<T>);

impl<T: Send> FreedAside<T> {
    /// Takes the value.
    pub const fn new(value: T) -> Self {
        Self(Some(value))
    }
}

impl<T: Send> Deref for FreedAside<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0
            .as_ref()
            .expect("it is taken only when it is dropped")
    }
}

impl<T: Send> Drop for FreedAside<T> {
    fn drop(&mut self) {
        free(self.0.take(), u64::MAX);
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
