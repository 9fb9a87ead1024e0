//! Byte-weighted caches in which concurrent requests for one value share its build. `holdings.rs`
//! says which value makes room.
//!
//! A value holds its reservation of memory as long as anyone uses it, also after it was evicted. A
//! value larger than its cache is used but not cached. Each build is a task. It goes on while at
//! least one request waits for it, and is dropped when the last one has left: that takes it out of
//! the workers' queue, or cancels its computation (`Pool::run`). A later request then begins a new
//! build.

mod holdings;

use std::collections::HashMap;
use std::convert::Infallible;
use std::future::Future;
use std::ops::Deref;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Instant;

use holdings::Holdings;
use mlswarp::warp::Digest;
use tokio::sync::{oneshot, watch};

use crate::client::{Owner, Tenant};
use crate::limits::free::free;
use crate::limits::memory::Reservation;
use crate::observe::Scope;
use crate::problem::{Code, Problem};

/// The key of a value. Owners share no values: a hit would tell one of them what another has sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CacheKey {
    owner: Owner,
    digest: Digest,
}

impl CacheKey {
    /// `digest` covers everything that the value depends on.
    pub const fn new(owner: Owner, digest: Digest) -> Self {
        Self { owner, digest }
    }
}

/// A value and the memory that it takes.
#[derive(Debug)]
pub struct CacheEntry<V> {
    value: V,
    memory: Reservation,
}

impl<V> CacheEntry<V> {
    /// The value weighs what is reserved.
    pub const fn new(value: V, memory: Reservation) -> Self {
        Self { value, memory }
    }

    /// Bytes of its memory.
    pub const fn bytes(&self) -> u64 {
        self.memory.bytes()
    }
}

impl<V> Deref for CacheEntry<V> {
    type Target = V;

    fn deref(&self) -> &V {
        &self.value
    }
}

/// Frees a value that has left a cache, unless it is in use.
fn free_entry<V: Send + Sync + 'static>(entry: Arc<CacheEntry<V>>) {
    let bytes = entry.bytes();
    free(entry, bytes);
}

/// The result of [`Cache::get`].
#[derive(Debug)]
pub struct Fetched<V> {
    /// The value.
    pub value: Arc<CacheEntry<V>>,
    /// This call began the build.
    pub built: bool,
}

/// What a cache has done and what it holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// Values that were found.
    pub hits: u64,
    /// Values that were built.
    pub built: u64,
    /// Values that were evicted.
    pub evicted: u64,
    /// Bytes of the cached values.
    pub bytes: u64,
    /// The number of cached values.
    pub values: u64,
}

type Outcome<V> = Option<Result<Arc<CacheEntry<V>>, Problem>>;

/// Held by every request that waits for a build. The build stops when the last one is dropped.
type Interest = Arc<oneshot::Sender<Infallible>>;

tokio::task_local! {
    static RETAINED: Retained;
}

/// Keeps builds going whose requests have ended, until it is dropped itself: a newer request of the
/// same session supersedes an older one and needs the same values, but may still be waiting for a
/// worker.
#[derive(Clone, Debug, Default)]
pub struct Retained(Arc<Mutex<Vec<Interest>>>);

impl Retained {
    /// Keeps the builds going that `work` waits for.
    pub fn during<F: Future>(&self, work: F) -> impl Future<Output = F::Output> {
        RETAINED.scope(self.clone(), work)
    }

    fn retain(&self, interest: &Interest) {
        let mut interests = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // Closed: the build has ended.
        interests.retain(|interest| !interest.is_closed());
        interests.push(Arc::clone(interest));
    }
}

/// A cache of built values. Cloning shares it.
#[derive(Debug)]
pub struct Cache<V>(Arc<CacheState<V>>);

#[derive(Debug)]
struct CacheState<V> {
    capacity: u64,
    entries: Mutex<Entries<V>>,
}

#[derive(Debug)]
struct Entries<V> {
    values: Holdings<Arc<CacheEntry<V>>>,
    builds: HashMap<CacheKey, Build<V>>,
    /// All but the number of values and their bytes.
    stats: CacheStats,
}

/// A build that requests can join.
#[derive(Debug)]
struct Build<V> {
    outcome: watch::Receiver<Outcome<V>>,
    /// Dead when all requests have left: the build is being stopped.
    interest: Weak<oneshot::Sender<Infallible>>,
}

/// The task of a build. Dropping it ends the build for those who wait, whatever the outcome.
struct BuildTask<V> {
    cache: Cache<V>,
    key: CacheKey,
    holder: Tenant,
    outcome: watch::Sender<Outcome<V>>,
    interest: Weak<oneshot::Sender<Infallible>>,
    /// Resolves when the last request has left.
    abandoned: oneshot::Receiver<Infallible>,
}

impl<V> Clone for Cache<V> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<V> Entries<V> {
    fn get(&mut self, key: CacheKey) -> Option<Arc<CacheEntry<V>>> {
        let value = self.values.get(key, Instant::now()).cloned();
        self.stats.hits += u64::from(value.is_some());
        value
    }

    /// Removes the value that makes room, of those that `may_go`.
    fn evict(
        &mut self,
        may_go: impl Fn(CacheKey, &Arc<CacheEntry<V>>) -> bool,
    ) -> Option<Arc<CacheEntry<V>>> {
        let evicted = self
            .values
            .next_to_go(Instant::now(), may_go)
            .and_then(|key| self.values.remove(key));
        self.stats.evicted += u64::from(evicted.is_some());
        evicted
    }
}

impl<V> Cache<V> {
    /// A cache of `capacity` bytes.
    pub fn new(capacity: u64) -> Self {
        let entries = Entries {
            values: Holdings::default(),
            builds: HashMap::new(),
            stats: CacheStats::default(),
        };
        Self(Arc::new(CacheState {
            capacity,
            entries: Mutex::new(entries),
        }))
    }

    fn lock(&self) -> MutexGuard<'_, Entries<V>> {
        // No operation leaves the entries half-changed where it could panic.
        self.0
            .entries
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the value is cached. It counts as used, not as found.
    pub fn touch(&self, key: CacheKey) -> bool {
        self.lock().values.get(key, Instant::now()).is_some()
    }

    /// Makes the value the next one to be evicted, unless it is used before.
    pub fn demote(&self, key: CacheKey) {
        self.lock().values.demote(key);
    }

    /// The value, if it is cached.
    pub fn peek(&self, key: CacheKey) -> Option<Arc<CacheEntry<V>>> {
        self.lock().get(key)
    }

    /// Removes the value.
    pub fn remove(&self, key: CacheKey) -> Option<Arc<CacheEntry<V>>> {
        self.lock().values.remove(key)
    }
}

/// What concerns the caches of all kinds of values.
pub trait AnyCache: std::fmt::Debug + Send + Sync {
    /// What it has done and what it holds.
    fn usage(&self) -> CacheStats;

    /// Whether [`AnyCache::evict_idle`] would find a value.
    fn is_any_idle(&self) -> bool;

    /// Evicts a value that is not in use. `false`: all are in use.
    fn evict_idle(&self) -> bool;

    /// Removes all values.
    fn clear(&self);
}

impl<V: std::fmt::Debug + Send + Sync + 'static> AnyCache for Cache<V> {
    fn usage(&self) -> CacheStats {
        let entries = self.lock();
        CacheStats {
            values: entries.values.len() as u64,
            bytes: entries.values.bytes(),
            ..entries.stats
        }
    }

    fn is_any_idle(&self) -> bool {
        self.lock()
            .values
            .iter()
            .any(|value| Arc::strong_count(value) == 1)
    }

    fn evict_idle(&self) -> bool {
        // Dropped without the lock.
        let evicted = self.lock().evict(|_, value| Arc::strong_count(value) == 1);
        let is_evicted = evicted.is_some();
        evicted.into_iter().for_each(free_entry);
        is_evicted
    }

    fn clear(&self) {
        // The values are dropped without the lock.
        let values = std::mem::take(&mut self.lock().values);
        drop(values);
    }
}

impl<V: Send + Sync + 'static> Cache<V> {
    /// Removes the value, and frees it when it is no longer in use.
    pub fn drop_value(&self, key: CacheKey) {
        self.remove(key).into_iter().for_each(free_entry);
    }

    /// Caches a value for the client that holds it.
    pub fn put(&self, key: CacheKey, holder: Tenant, value: &Arc<CacheEntry<V>>) {
        let bytes = value.memory.bytes();
        if bytes > self.0.capacity {
            return;
        }
        let mut entries = self.lock();
        // Dropped after the lock.
        let mut removed = Vec::from_iter(entries.values.insert(
            key,
            holder,
            (Arc::clone(value), bytes),
            Instant::now(),
        ));
        while entries.values.bytes() > self.0.capacity {
            let Some(evicted) = entries.evict(|other, _| other != key) else {
                break;
            };
            removed.push(evicted);
        }
        drop(entries);
        removed.into_iter().for_each(free_entry);
    }

    /// The value of `key`. `build` runs if the value is neither cached nor being built; then
    /// `holder` holds the value. Errors: Those of the build, for every request that waits; they are
    /// not cached. A build that was torn down is an internal error.
    pub async fn get<B>(
        &self,
        key: CacheKey,
        holder: Tenant,
        build: B,
    ) -> Result<Fetched<V>, Problem>
    where
        B: Future<Output = Result<CacheEntry<V>, Problem>> + Send + 'static,
    {
        let (mut outcome, interest, task) = {
            let mut entries = self.lock();
            if let Some(value) = entries.get(key) {
                return Ok(Fetched {
                    value,
                    built: false,
                });
            }
            let running = entries
                .builds
                .get(&key)
                .and_then(|build| Some((build.outcome.clone(), build.interest.upgrade()?)));
            match running {
                Some((outcome, interest)) => (outcome, interest, None),
                None => {
                    let (sender, outcome) = watch::channel(None);
                    let (interest, abandoned) = oneshot::channel();
                    let interest = Arc::new(interest);
                    let weak = Arc::downgrade(&interest);
                    entries.builds.insert(
                        key,
                        Build {
                            outcome: outcome.clone(),
                            interest: weak.clone(),
                        },
                    );
                    let task = BuildTask {
                        cache: self.clone(),
                        key,
                        holder,
                        outcome: sender,
                        interest: weak,
                        abandoned,
                    };
                    (outcome, interest, Some(task))
                }
            }
        };
        let _ = RETAINED.try_with(|retained| retained.retain(&interest));
        let built = task.is_some();
        match task {
            Some(task) => drop(tokio::spawn(Scope::current().wrap(task.run(build)))),
            None => drop(build),
        }
        // The sender is dropped without an outcome when the build was torn down.
        let outcome = outcome
            .wait_for(Option::is_some)
            .await
            .map(|outcome| outcome.clone());
        let lost = || Problem::new(Code::Internal, "internal error");
        let value = outcome.ok().flatten().ok_or_else(lost)??;
        drop(interest);
        Ok(Fetched { value, built })
    }
}

impl<V: Send + Sync + 'static> BuildTask<V> {
    async fn run(mut self, build: impl Future<Output = Result<CacheEntry<V>, Problem>>) {
        let outcome = tokio::select! {
            biased;
            outcome = build => outcome.map(Arc::new),
            _ = &mut self.abandoned => return,
        };
        if let Ok(value) = &outcome {
            self.cache.lock().stats.built += 1;
            self.cache.put(self.key, self.holder, value);
        }
        self.outcome.send_replace(Some(outcome));
    }
}

impl<V> Drop for BuildTask<V> {
    fn drop(&mut self) {
        let mut entries = self.cache.lock();
        // A build that was stopped may have been replaced by a new one.
        if entries
            .builds
            .get(&self.key)
            .is_some_and(|build| build.interest.ptr_eq(&self.interest))
        {
            entries.builds.remove(&self.key);
        }
    }
}

#[cfg(test)]
mod tests;
