//! Tests of the caches.

use super::*;
use crate::client::Client;
use crate::limits::memory::{Budget, MemoryClass};
use crate::pool::{Cancel, Pool, PoolConfig, QueueKey, WorkClass};
use crate::problem::Code;
use futures_util::FutureExt as _;
use tokio::sync::{Semaphore, mpsc};

const KEY: CacheKey = key(1);

const fn key(n: u8) -> CacheKey {
    CacheKey::new(Owner::ANYBODY, Digest([n; 32]))
}

fn holder() -> Tenant {
    Client::default().tenant()
}

fn budget() -> Budget {
    Budget::new(1 << 30)
}

fn kept(budget: &Budget, bytes: u64) -> Result<CacheEntry<u64>, Problem> {
    Ok(CacheEntry::new(
        bytes,
        budget.take(MemoryClass::Plan, bytes).unwrap(),
    ))
}

fn lost() -> Problem {
    Problem::new(Code::Internal, "internal error")
}

async fn put(cache: &Cache<u64>, budget: &Budget, key: u8, bytes: u64) -> Arc<CacheEntry<u64>> {
    let built = kept(budget, bytes);
    cache
        .get(self::key(key), holder(), async { built })
        .await
        .unwrap()
        .value
}

#[tokio::test]
async fn many_requests_share_one_build() {
    let (cache, budget) = (Cache::new(1 << 20), budget());
    let requests = (0..16).map(|_| {
        let built = kept(&budget, 7);
        cache.get(KEY, holder(), async { built })
    });
    let fetched = futures_util::future::try_join_all(requests).await.unwrap();
    assert!(fetched.iter().all(|f| **f.value == 7));
    assert_eq!(fetched.iter().filter(|f| f.built).count(), 1);
    assert_eq!(
        cache.usage(),
        CacheStats {
            hits: 0,
            built: 1,
            evicted: 0,
            bytes: 7,
            values: 1
        }
    );
    assert_eq!(budget.taken(), 7);
    assert!(cache.lock().builds.is_empty());
}

#[tokio::test]
async fn owners_share_neither_values_nor_builds() {
    let (cache, budget) = (Cache::new(1 << 20), budget());
    let owner = |n: u8| CacheKey::new(Owner::from_bytes([n; 16]), Digest([1; 32]));
    let requests = [owner(1), owner(2), owner(1), KEY].map(|key| {
        let built = kept(&budget, 7);
        cache.get(key, holder(), async { built })
    });
    let fetched = futures_util::future::try_join_all(requests).await.unwrap();
    assert_eq!(
        fetched.iter().map(|f| f.built).collect::<Vec<_>>(),
        [true, true, false, true]
    );
    assert_eq!(
        (cache.usage().bytes, budget.taken()),
        (21, 21),
        "what two have is there twice, and counted twice"
    );
    cache.remove(owner(1));
    assert!(!cache.touch(owner(1)) && cache.touch(owner(2)) && cache.touch(KEY));
}

#[tokio::test]
async fn a_builder_that_leaves_serves_those_who_wait() {
    let (cache, budget) = (Cache::new(1 << 20), budget());
    let gate = Arc::new(Semaphore::new(0));
    let build = {
        let (gate, built) = (Arc::clone(&gate), kept(&budget, 7));
        async move {
            let _ = gate.acquire().await;
            built
        }
    };
    let first = tokio::spawn({
        let cache = cache.clone();
        async move { cache.get(KEY, holder(), build).await.map(|f| f.built) }
    });
    tokio::task::yield_now().await;
    let second = tokio::spawn({
        let (cache, built) = (cache.clone(), kept(&budget, 8));
        async move {
            cache
                .get(KEY, holder(), async { built })
                .await
                .map(|f| **f.value)
        }
    });
    tokio::task::yield_now().await;
    first.abort();
    tokio::task::yield_now().await;
    gate.add_permits(1);
    assert_eq!(second.await.unwrap(), Ok(7));
}

/// A build that never ends by itself, and says so when it begins and when it is dropped.
fn endless(
    said: &mpsc::UnboundedSender<&'static str>,
) -> impl Future<Output = Result<CacheEntry<u64>, Problem>> + Send + use<> {
    struct Dropped(mpsc::UnboundedSender<&'static str>);
    impl Drop for Dropped {
        fn drop(&mut self) {
            let _ = self.0.send("dropped");
        }
    }
    let dropped = Dropped(said.clone());
    async move {
        let _ = dropped.0.send("began");
        std::future::pending().await
    }
}

#[tokio::test]
async fn a_build_goes_on_for_its_last_waiter_and_stops_when_that_one_leaves() {
    let cache = Cache::new(1 << 20);
    let (said, mut hears) = mpsc::unbounded_channel();
    let wait = || {
        let (cache, build) = (cache.clone(), endless(&said));
        tokio::spawn(async move { cache.get(KEY, holder(), build).await })
    };
    let first = wait();
    assert_eq!(hears.recv().await, Some("began"));
    let others = [wait(), wait()];
    // Builds that are not needed are dropped at once.
    assert_eq!(
        [hears.recv().await, hears.recv().await],
        [Some("dropped"); 2]
    );
    for left in [first].into_iter().chain(others) {
        assert!(hears.try_recv().is_err(), "one still waits");
        left.abort();
        assert!(left.await.unwrap_err().is_cancelled());
    }
    assert_eq!(hears.recv().await, Some("dropped"));
    while !cache.lock().builds.is_empty() {
        tokio::task::yield_now().await;
    }
    assert_eq!(cache.usage(), CacheStats::default());
}

#[tokio::test]
async fn a_request_that_comes_while_a_build_is_stopped_gets_a_build_of_its_own() {
    let (cache, budget) = (Cache::new(1 << 20), budget());
    let (said, mut hears) = mpsc::unbounded_channel();
    let mut abandoned = Box::pin(cache.get(KEY, holder(), endless(&said)));
    assert!((&mut abandoned).now_or_never().is_none());
    assert_eq!(hears.recv().await, Some("began"));
    // One thread: the task of the build cannot have seen it when the next request comes.
    drop(abandoned);
    assert!(!cache.lock().builds.is_empty());
    let gate = Arc::new(Semaphore::new(0));
    let (opens, built) = (Arc::clone(&gate), kept(&budget, 7));
    let next = async move {
        let _ = opens.acquire().await;
        built
    };
    let mut next = Box::pin(cache.get(KEY, holder(), next));
    assert!((&mut next).now_or_never().is_none());
    assert_eq!(hears.recv().await, Some("dropped"));
    // The old build has gone, and has left the new one's entry alone: a third request shares it.
    let mut third = Box::pin(cache.get(KEY, holder(), async { Err(lost()) }));
    assert!((&mut third).now_or_never().is_none());
    gate.add_permits(1);
    assert_eq!(
        (
            next.await.map(|f| (**f.value, f.built)),
            third.await.map(|f| (**f.value, f.built))
        ),
        (Ok((7, true)), Ok((7, false)))
    );
    assert!(cache.lock().builds.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_that_stays_gets_the_value_while_others_come_and_leave() {
    let (cache, budget) = (Cache::new(0), budget());
    for round in 0..2000_u32 {
        let wait = || {
            let (cache, built) = (cache.clone(), kept(&budget, 7));
            let build = async move {
                tokio::task::yield_now().await;
                built
            };
            tokio::spawn(async move { cache.get(KEY, holder(), build).await.map(|f| **f.value) })
        };
        let leaves = wait();
        if round % 3 == 0 {
            tokio::task::yield_now().await;
        }
        leaves.abort();
        let stays = wait();
        assert_eq!(stays.await.unwrap(), Ok(7), "round {round}");
        let _ = leaves.await;
    }
}

#[tokio::test]
async fn a_build_that_is_retained_goes_on_until_that_ends_too() {
    let cache = Cache::new(1 << 20);
    let (said, mut hears) = mpsc::unbounded_channel();
    let retained = Retained::default();
    let mut waits = Box::pin(retained.during(cache.get(KEY, holder(), endless(&said))));
    assert!((&mut waits).now_or_never().is_none());
    assert_eq!(hears.recv().await, Some("began"));
    drop(waits);
    tokio::task::yield_now().await;
    assert!(hears.try_recv().is_err());
    drop(retained);
    assert_eq!(hears.recv().await, Some("dropped"));
}

#[tokio::test]
async fn a_build_that_nobody_waits_for_leaves_the_queue_or_is_cancelled() {
    let (cache, budget) = (Cache::new(1 << 20), budget());
    let long = std::time::Duration::from_secs(600);
    let pool = Pool::new(PoolConfig {
        workers: 1,
        queue: 4,
        drag_wait: long,
        upload_wait: long,
    })
    .unwrap();
    let admit = || pool.admit(WorkClass::Upload, QueueKey::client(Client::default()));
    let build = || {
        let (pool, built) = (pool.clone(), kept(&budget, 7));
        async move {
            let ticket = pool
                .admit(WorkClass::Upload, QueueKey::client(Client::default()))
                .await?;
            let until_cancelled = |cancel: &Cancel| {
                while !cancel.is_cancelled() {
                    std::thread::yield_now();
                }
            };
            ticket.run(until_cancelled).await?;
            built
        }
    };
    let ticket = admit().await.unwrap();
    let mut waits = Box::pin(cache.get(KEY, holder(), build()));
    assert!((&mut waits).now_or_never().is_none());
    while pool.load(WorkClass::Upload).waiting == 0 {
        tokio::task::yield_now().await;
    }
    drop(waits);
    while pool.load(WorkClass::Upload).waiting == 1 {
        tokio::task::yield_now().await;
    }
    drop(ticket);
    let mut waits = Box::pin(cache.get(KEY, holder(), build()));
    assert!((&mut waits).now_or_never().is_none());
    while pool.running() == 0 {
        tokio::task::yield_now().await;
    }
    drop(waits);
    // The only turn comes back.
    drop(admit().await.unwrap());
}

#[tokio::test]
async fn the_least_recently_used_goes_first_and_a_newcomer_is_kept() {
    let (cache, budget) = (Cache::new(4 << 10), budget());
    for key in 0..4 {
        put(&cache, &budget, key, 1024).await;
    }
    for key in 1..4 {
        assert!(cache.peek(self::key(key)).is_some());
    }
    put(&cache, &budget, 9, 1024).await;
    assert!(cache.touch(key(9)), "the newcomer is kept");
    assert!(!cache.touch(key(0)), "the oldest has gone");
    assert_eq!(
        cache.usage(),
        CacheStats {
            hits: 3,
            built: 5,
            evicted: 1,
            bytes: 4096,
            values: 4
        }
    );
    assert_eq!(budget.taken(), 4096);
    cache.remove(key(9));
    assert_eq!((cache.usage().bytes, budget.taken()), (3072, 3072));
    cache.clear();
    assert_eq!((cache.usage().bytes, budget.taken()), (0, 0));
}

#[tokio::test]
async fn what_is_wanted_stays_and_what_was_used_once_goes() {
    let (cache, budget) = (Cache::new(3 << 10), budget());
    for key in 0..3 {
        put(&cache, &budget, key, 1024).await;
    }
    assert!(cache.touch(key(0)));
    cache.demote(key(2));
    put(&cache, &budget, 8, 1024).await;
    put(&cache, &budget, 9, 1024).await;
    let there = [0, 1, 2].map(|key| cache.peek(self::key(key)).is_some());
    assert_eq!(there, [true, false, false]);
}

#[tokio::test]
async fn an_entry_larger_than_the_cache_is_used_but_not_kept() {
    let (cache, budget) = (Cache::new(4 << 10), budget());
    put(&cache, &budget, 2, 1024).await;
    let large = put(&cache, &budget, 1, 1 << 20).await;
    assert_eq!(**large, 1 << 20);
    assert!(!cache.touch(KEY) && cache.touch(key(2)));
    assert_eq!(
        budget.taken(),
        1024 + (1 << 20),
        "what is used is in the account, cached or not"
    );
    drop(large);
    assert_eq!(budget.taken(), 1024);
}

#[tokio::test]
async fn what_is_in_use_does_not_give_way() {
    let (cache, budget) = (Cache::new(1 << 20), budget());
    let used = put(&cache, &budget, 1, 100).await;
    put(&cache, &budget, 2, 10).await;
    assert!(cache.evict_idle());
    assert_eq!((cache.touch(KEY), budget.taken()), (true, 100));
    assert!(!cache.evict_idle());
    drop(used);
    assert!(cache.evict_idle());
    assert_eq!(budget.taken(), 0);
}

#[tokio::test]
async fn a_build_that_fails_or_panics_is_told_and_forgotten() {
    let (cache, budget) = (Cache::new(1 << 20), budget());
    let no = Problem::new(Code::BadImage, "no");
    let theirs = no.clone();
    assert_eq!(
        cache
            .get(KEY, holder(), async { Err(theirs) })
            .await
            .unwrap_err(),
        no
    );
    assert_eq!(
        cache
            .get(KEY, holder(), async { panic!("on purpose") })
            .await
            .unwrap_err(),
        lost()
    );
    assert_eq!(**put(&cache, &budget, 1, 3).await, 3);
}
