//! Why tables of coefficients are built: what a proxy that sends sessions hither and thither costs is seen in it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use lru::LruCache;

use crate::cache::Key;

/// Tables that are remembered to have been built here, some 100 bytes each.
const REMEMBERED: usize = 16_384;

/// Why a table was built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Picture and handles are new.
    New,
    /// It had been built here, and has made room for others since.
    Evicted,
    /// The session was opened by another process, or by this one before it was started anew.
    Elsewhere,
}

/// Who wants a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Origin {
    /// A request that brings its handles.
    Handles,
    /// A step of a session that has been opened.
    Session,
}

impl Cause {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::New, Self::Evicted, Self::Elsewhere];

    /// Its word in the metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::New => "new",
            Self::Evicted => "evicted",
            Self::Elsewhere => "elsewhere",
        }
    }
}

/// Tables that were built, by cause, and which.
#[derive(Debug)]
pub(crate) struct Causes {
    counts: [AtomicU64; Cause::ALL.len()],
    built: Mutex<LruCache<Key, ()>>,
}

impl Default for Causes {
    fn default() -> Self {
        Self { counts: [const { AtomicU64::new(0) }; Cause::ALL.len()], built: Mutex::new(LruCache::unbounded()) }
    }
}

impl Causes {
    /// A table was built.
    pub(crate) fn built(&self, key: Key, origin: Origin) -> Cause {
        let mut built = self.built.lock().unwrap_or_else(PoisonError::into_inner);
        let was_here = built.put(key, ()).is_some();
        if built.len() > REMEMBERED {
            built.pop_lru();
        }
        drop(built);
        let cause = match origin {
            _ if was_here => Cause::Evicted,
            Origin::Session => Cause::Elsewhere,
            Origin::Handles => Cause::New,
        };
        self.counts[cause as usize].fetch_add(1, Ordering::Relaxed);
        cause
    }

    /// Nobody has a session with it any more.
    pub(crate) fn forget(&self, key: Key) {
        self.built.lock().unwrap_or_else(PoisonError::into_inner).pop(&key);
    }

    /// How many were built for this cause.
    pub(crate) fn count(&self, cause: Cause) -> u64 {
        self.counts[cause as usize].load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::Owner;
    use mlswarp::warp::Digest;

    fn key(digest: Digest) -> Key {
        Key::new(Owner::ANYBODY, digest)
    }

    #[test]
    fn what_was_built_here_before_was_evicted_and_what_a_session_brings_was_elsewhere() {
        let causes = Causes::default();
        let (a, b) = (key(Digest([1; 32])), key(Digest([2; 32])));
        assert_eq!(causes.built(a, Origin::Handles), Cause::New);
        assert_eq!(causes.built(a, Origin::Session), Cause::Evicted);
        assert_eq!(causes.built(b, Origin::Session), Cause::Elsewhere);
        assert_eq!(causes.built(b, Origin::Handles), Cause::Evicted);
        causes.forget(a);
        assert_eq!(causes.built(a, Origin::Handles), Cause::New);
        assert_eq!(Cause::ALL.map(|cause| causes.count(cause)), [2, 2, 1]);
    }

    #[test]
    fn it_remembers_so_many_and_no_more() {
        let causes = Causes::default();
        for n in 0..REMEMBERED + 10 {
            causes.built(key(Digest::of(&n.to_le_bytes())), Origin::Handles);
        }
        assert_eq!(causes.built.lock().unwrap().len(), REMEMBERED);
        assert_eq!(causes.built(key(Digest::of(&0_usize.to_le_bytes())), Origin::Session), Cause::Elsewhere);
    }
}
