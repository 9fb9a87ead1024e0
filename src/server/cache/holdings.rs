//! The values of a cache with the clients that hold them, and which value makes room for another
//! one. One client cannot empty the cache of the others: a value that has not been used for a while
//! goes first, and after those one of the client that holds the most.
//!
//! Times are arguments; there is no clock here.

use std::collections::{BTreeSet, HashMap};
use std::time::{Duration, Instant};

use lru::LruCache;

use super::CacheKey;
use crate::client::Tenant;

/// A value that has not been used for this long goes before all others, whichever client holds it.
const UNUSED_TIME: Duration = Duration::from_secs(60);

/// A value, and who holds it.
#[derive(Debug)]
struct Holding<T> {
    value: T,
    bytes: u64,
    holder: Tenant,
    /// `None`: it is the next to go.
    used: Option<Instant>,
}

/// What one client holds.
#[derive(Debug)]
struct Share {
    bytes: u64,
    keys: LruCache<CacheKey, ()>,
}

/// Values by key. The client that had a value built holds it.
#[derive(Debug)]
pub(super) struct Holdings<T> {
    values: LruCache<CacheKey, Holding<T>>,
    shares: HashMap<Tenant, Share>,
    /// The clients by what they hold.
    by_bytes: BTreeSet<(u64, Tenant)>,
    bytes: u64,
}

impl<T> Default for Holdings<T> {
    fn default() -> Self {
        Self {
            values: LruCache::unbounded(),
            shares: HashMap::new(),
            by_bytes: BTreeSet::new(),
            bytes: 0,
        }
    }
}

impl<T> Holdings<T> {
    pub(super) fn len(&self) -> usize {
        self.values.len()
    }

    /// Bytes of all values.
    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The value, which counts as used.
    pub(super) fn get(&mut self, key: CacheKey, now: Instant) -> Option<&T> {
        let holding = self.values.get_mut(&key)?;
        holding.used = Some(now);
        if let Some(share) = self.shares.get_mut(&holding.holder) {
            share.keys.promote(&key);
        }
        Some(&holding.value)
    }

    /// Makes the value the next to go.
    pub(super) fn demote(&mut self, key: CacheKey) {
        let Some(holding) = self.values.peek_mut(&key) else {
            return;
        };
        holding.used = None;
        if let Some(share) = self.shares.get_mut(&holding.holder) {
            share.keys.demote(&key);
        }
        self.values.demote(&key);
    }

    /// Inserts a value that takes the place of an old one.
    pub(super) fn insert(
        &mut self,
        key: CacheKey,
        holder: Tenant,
        (value, bytes): (T, u64),
        now: Instant,
    ) -> Option<T> {
        let old = self.remove(key);
        self.values.put(
            key,
            Holding {
                value,
                bytes,
                holder,
                used: Some(now),
            },
        );
        let new = || Share {
            bytes: 0,
            keys: LruCache::unbounded(),
        };
        self.shares
            .entry(holder)
            .or_insert_with(new)
            .keys
            .put(key, ());
        self.change(holder, bytes, 0);
        old
    }

    pub(super) fn remove(&mut self, key: CacheKey) -> Option<T> {
        let Holding {
            value,
            bytes,
            holder,
            ..
        } = self.values.pop(&key)?;
        if let Some(share) = self.shares.get_mut(&holder) {
            share.keys.pop(&key);
        }
        self.change(holder, 0, bytes);
        Some(value)
    }

    /// Adds to what a client holds, and subtracts from it. Who holds nothing is forgotten.
    fn change(&mut self, holder: Tenant, more: u64, less: u64) {
        self.bytes = self.bytes + more - less;
        let Some(share) = self.shares.get_mut(&holder) else {
            return;
        };
        self.by_bytes.remove(&(share.bytes, holder));
        share.bytes = share.bytes + more - less;
        if share.keys.is_empty() {
            self.shares.remove(&holder);
        } else {
            self.by_bytes.insert((share.bytes, holder));
        }
    }

    /// The values, the least recently used first.
    pub(super) fn iter(&self) -> impl Iterator<Item = &T> {
        self.values.iter().rev().map(|(_, holding)| &holding.value)
    }

    /// The value that makes room, of those that `may_go`.
    pub(super) fn next_to_go(
        &self,
        now: Instant,
        may_go: impl Fn(CacheKey, &T) -> bool,
    ) -> Option<CacheKey> {
        let is_unused = |holding: &Holding<T>| {
            holding
                .used
                .is_none_or(|used| now.saturating_duration_since(used) >= UNUSED_TIME)
        };
        let unused = self
            .values
            .iter()
            .rev()
            .take_while(|(_, holding)| is_unused(holding));
        let unused = unused
            .filter(|(key, holding)| may_go(**key, &holding.value))
            .map(|(key, _)| *key)
            .next();
        let of_share = |(_, holder): &(u64, Tenant)| {
            let mut keys = self
                .shares
                .get(holder)?
                .keys
                .iter()
                .rev()
                .map(|(key, ())| *key);
            keys.find(|key| {
                self.values
                    .peek(key)
                    .is_some_and(|holding| may_go(*key, &holding.value))
            })
        };
        unused.or_else(|| self.by_bytes.iter().rev().find_map(of_share))
    }
}

#[cfg(test)]
mod tests {
    use mlswarp::warp::Digest;
    use proptest::prelude::*;

    use super::*;
    use crate::client::Owner;

    fn key(n: u8) -> CacheKey {
        CacheKey::new(Owner::ANYBODY, Digest([n; 32]))
    }

    fn client(n: u8) -> Tenant {
        Tenant::of_address([192, 0, 2, n].into())
    }

    /// A cache of 100 bytes, at a time that stands still.
    struct Full {
        holdings: Holdings<u8>,
        now: Instant,
    }

    impl Full {
        fn new() -> Self {
            Self {
                holdings: Holdings::default(),
                now: Instant::now(),
            }
        }

        /// Inserts a value, and removes what must go for it.
        fn put(&mut self, n: u8, holder: u8, bytes: u64) -> Vec<u8> {
            self.holdings
                .insert(key(n), client(holder), (n, bytes), self.now);
            let mut gone = Vec::new();
            while self.holdings.bytes() > 100 {
                let next = self
                    .holdings
                    .next_to_go(self.now, |other, _| other != key(n))
                    .unwrap();
                gone.extend(self.holdings.remove(next));
            }
            gone
        }
    }

    #[test]
    fn one_client_alone_has_all_of_it_and_its_oldest_values_go_first() {
        let mut full = Full::new();
        for n in 0..10 {
            assert!(full.put(n, 1, 10).is_empty());
        }
        full.holdings.get(key(0), full.now);
        assert_eq!(full.put(10, 1, 25), [1, 2, 3]);
        assert_eq!((full.holdings.bytes(), full.holdings.len()), (95, 8));
    }

    #[test]
    fn who_holds_the_most_makes_room_and_a_flood_only_replaces_itself() {
        let mut full = Full::new();
        for n in 0..9 {
            full.put(n, 1, 10);
        }
        // Another client needs room: that of the first, until both hold as much.
        assert_eq!(
            (full.put(20, 2, 10), full.put(21, 2, 20)),
            (vec![], vec![0, 1])
        );
        assert_eq!(full.put(22, 2, 20), [2, 3]);
        assert_eq!(
            full.put(23, 2, 10),
            [20],
            "both hold half; now its own make room"
        );
        for n in 24..200 {
            assert!(
                full.put(n, 2, 10).iter().all(|gone| *gone > 20),
                "the first keeps its half"
            );
        }
        // A third one gets a third.
        let gone: Vec<u8> = (200..210).flat_map(|n| full.put(n, 3, 10)).collect();
        assert!(gone.iter().filter(|gone| (200..).contains(*gone)).count() >= 6);
        assert!(
            (4..9)
                .filter(|n| full.holdings.get(key(*n), full.now).is_some())
                .count()
                >= 3
        );
    }

    #[test]
    fn what_nobody_has_used_for_a_while_goes_before_what_others_use() {
        let mut full = Full::new();
        full.put(1, 1, 10);
        full.put(2, 2, 80);
        full.now += UNUSED_TIME;
        full.holdings.get(key(2), full.now);
        assert_eq!(
            full.put(3, 2, 15),
            [1],
            "its holder has the least, and does not use it"
        );
        full.put(4, 3, 5);
        full.holdings.demote(key(4));
        assert_eq!(full.put(5, 2, 5), [4], "a demoted value is the next to go");
        full.holdings.demote(key(5));
        full.holdings.get(key(5), full.now);
        assert_eq!(full.put(6, 3, 5), [2], "unless it is used before");
        full.holdings.demote(key(77));
    }

    #[test]
    fn values_that_may_not_go_stay() {
        let mut full = Full::new();
        full.put(1, 1, 50);
        full.put(2, 2, 20);
        assert_eq!(
            full.holdings
                .next_to_go(full.now, |key, _| key != self::key(1)),
            Some(key(2))
        );
        assert_eq!(
            full.holdings
                .next_to_go(full.now + UNUSED_TIME, |_, value| *value == 2),
            Some(key(2))
        );
        assert_eq!(full.holdings.next_to_go(full.now, |_, _| false), None);
    }

    proptest! {
        /// Whatever happens, every value is counted once, for the client that holds it.
        #[test]
        fn everything_is_accounted_for(steps in prop::collection::vec(
            (0_u8..5, 0_u8..12, 0_u8..4, 0_u64..40), 1..200)) {
            let (mut full, mut wanted) = (Full::new(), HashMap::new());
            for (what, n, holder, bytes) in steps {
                match what {
                    0 | 1 => {
                        wanted.insert(n, (holder, bytes));
                        for gone in full.put(n, holder, bytes) {
                            wanted.remove(&gone);
                        }
                    }
                    2 => prop_assert_eq!(full.holdings.remove(key(n)),
                        wanted.remove(&n).map(|_| n)),
                    3 => full.holdings.demote(key(n)),
                    _ => prop_assert_eq!(full.holdings.get(key(n), full.now).copied(),
                        wanted.get(&n).map(|_| n)),
                }
                let of = |client: u8| wanted.values().filter(|(holder, _)| *holder == client).map(
                    |(_, bytes)| bytes).sum::<u64>();
                prop_assert_eq!((full.holdings.len(), full.holdings.bytes()),
                    (wanted.len(), (0..4).map(of).sum()));
                for holder in 0..4 {
                    let held = full.holdings.shares.get(&client(holder));
                    prop_assert_eq!(held.map_or(0, |share| share.bytes), of(holder));
                    prop_assert_eq!(held.is_some(),
                        wanted.values().any(|(other, _)| *other == holder));
                }
                prop_assert_eq!(full.holdings.by_bytes.len(), full.holdings.shares.len());
            }
        }
    }
}
