//! Byte-weighted LRU shelves with one build for many waiting requests: decoded pictures by the digest of their file, plans by everything
//! that their coefficients depend on. An entry larger than its shelf is used but not kept. Weights are KiB (moka weighs in u32).
//!
//! A build is a task of its own: a client that leaves does not stop it, so those who wait for the same entry get theirs.

use std::fmt;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use moka::future::Cache;
use moka::policy::EvictionPolicy;

use crate::warp::Digest;

/// A cache of built values. Cloning shares it.
pub struct Shelf<V> {
    cache: Cache<Digest, Arc<V>>,
    built: Arc<AtomicU64>,
}

impl<V> fmt::Debug for Shelf<V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shelf").field("built", &self.built).finish_non_exhaustive()
    }
}

impl<V> Clone for Shelf<V> {
    fn clone(&self) -> Self {
        Self { cache: self.cache.clone(), built: Arc::clone(&self.built) }
    }
}

/// A value and whether this very call built it.
#[derive(Debug)]
pub struct Fetched<V> {
    /// The value.
    pub value: Arc<V>,
    /// It was not there before and nobody else was building it.
    pub built: bool,
}

impl<V: Send + Sync + 'static> Shelf<V> {
    /// Holds `capacity` bytes as measured by `bytes`.
    pub fn new(name: &str, capacity: u64, bytes: impl Fn(&V) -> u64 + Send + Sync + 'static) -> Self {
        let cache = Cache::builder()
            .name(name)
            .max_capacity(capacity / 1024)
            .weigher(move |_, value: &Arc<V>| u32::try_from(bytes(value).div_ceil(1024).max(1)).unwrap_or(u32::MAX))
            // The default policy refuses newcomers while old entries are hot: a new session would never be warm.
            .eviction_policy(EvictionPolicy::lru())
            .build();
        Self { cache, built: Arc::default() }
    }

    /// How many values were built so far.
    #[must_use]
    pub fn built(&self) -> u64 {
        self.built.load(Ordering::Relaxed)
    }

    /// The value of `key`, if it is there.
    pub async fn peek(&self, key: Digest) -> Option<Arc<V>> {
        self.cache.get(&key).await
    }

    /// Takes the value of `key` off the shelf.
    pub async fn remove(&self, key: Digest) -> Option<Arc<V>> {
        self.cache.remove(&key).await
    }

    /// Drops everything, as if it had been evicted.
    pub fn clear(&self) {
        self.cache.invalidate_all();
    }

    /// The value of `key`; `build` runs when it is not there and nobody else builds it.
    ///
    /// # Errors
    /// Those of the build; they are told to everyone who waits and then forgotten. `lost` makes the error of a build that was torn down.
    pub async fn get<E, B>(&self, key: Digest, build: B, lost: impl FnOnce() -> E) -> Result<Fetched<V>, E>
    where
        E: Clone + Send + Sync + 'static,
        B: Future<Output = Result<V, E>> + Send + 'static,
    {
        if let Some(value) = self.cache.get(&key).await {
            return Ok(Fetched { value, built: false });
        }
        let shelf = self.clone();
        let task = tokio::spawn(async move {
            let mut built = false;
            let init = async {
                let value = build.await?;
                built = true;
                shelf.built.fetch_add(1, Ordering::Relaxed);
                Ok(Arc::new(value))
            };
            let value = shelf.cache.try_get_with(key, init).await.map_err(|e: Arc<E>| (*e).clone())?;
            Ok(Fetched { value, built })
        });
        task.await.unwrap_or_else(|_| Err(lost()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::Semaphore;

    fn shelf(capacity: u64) -> Shelf<u64> {
        Shelf::new("test", capacity, |v| *v)
    }

    const KEY: Digest = Digest([1; 32]);

    #[tokio::test]
    async fn many_requests_share_one_build() {
        let shelf = shelf(1 << 20);
        let requests = (0..16).map(|_| shelf.get(KEY, async { Ok::<_, ()>(7) }, || ()));
        let fetched = futures_util::future::try_join_all(requests).await.unwrap();
        assert!(fetched.iter().all(|f| *f.value == 7));
        assert_eq!(fetched.iter().filter(|f| f.built).count(), 1);
        assert_eq!(shelf.built(), 1);
    }

    #[tokio::test]
    async fn a_builder_that_leaves_serves_those_who_wait() {
        let shelf = shelf(1 << 20);
        let gate = Arc::new(Semaphore::new(0));
        let build = {
            let gate = Arc::clone(&gate);
            async move {
                let _ = gate.acquire().await;
                Ok::<_, ()>(7)
            }
        };
        let first = tokio::spawn({
            let shelf = shelf.clone();
            async move { shelf.get(KEY, build, || ()).await.map(|f| f.built) }
        });
        tokio::task::yield_now().await;
        let second = tokio::spawn({
            let shelf = shelf.clone();
            async move { shelf.get(KEY, async { Ok(8) }, || ()).await.map(|f| *f.value) }
        });
        tokio::task::yield_now().await;
        first.abort();
        tokio::task::yield_now().await;
        gate.add_permits(1);
        assert_eq!(second.await.unwrap(), Ok(7));
    }

    #[tokio::test]
    async fn the_least_recently_used_goes_first_and_a_newcomer_is_kept() {
        let shelf = shelf(4 << 10);
        let key = |k: u8| Digest([k; 32]);
        for k in 0..4 {
            shelf.get(key(k), async { Ok::<_, ()>(1024) }, || ()).await.unwrap();
        }
        for _ in 0..50 {
            for k in 1..4 {
                shelf.get(key(k), async { Ok::<_, ()>(1024) }, || ()).await.unwrap();
            }
        }
        shelf.get(key(9), async { Ok::<_, ()>(1024) }, || ()).await.unwrap();
        shelf.cache.run_pending_tasks().await;
        assert!(shelf.cache.contains_key(&key(9)), "the newcomer is kept");
        assert!(!shelf.cache.contains_key(&key(0)), "the oldest has gone");
    }

    #[tokio::test]
    async fn an_entry_larger_than_the_shelf_is_used_but_not_kept() {
        let shelf = shelf(4 << 10);
        let small = shelf.get(Digest([2; 32]), async { Ok::<_, ()>(1024) }, || ()).await.unwrap();
        let large = shelf.get(KEY, async { Ok::<_, ()>(1 << 20) }, || ()).await.unwrap();
        shelf.cache.run_pending_tasks().await;
        assert_eq!((*small.value, *large.value), (1024, 1 << 20));
        assert!(!shelf.cache.contains_key(&KEY) && shelf.cache.contains_key(&Digest([2; 32])));
    }

    #[tokio::test]
    async fn a_failed_build_is_told_and_forgotten() {
        let shelf = shelf(1 << 20);
        assert_eq!(shelf.get(KEY, async { Err::<u64, _>("no") }, || "lost").await.unwrap_err(), "no");
        assert_eq!(*shelf.get(KEY, async { Ok::<_, &str>(3) }, || "lost").await.unwrap().value, 3);
    }
}
