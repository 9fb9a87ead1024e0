//! Request rates: a token bucket per key in a table of fixed size. In a full row, a new key
//! replaces the key with the fullest bucket, the least active one: many clients with few requests
//! are not limited, one with many requests is.

use std::hash::{BuildHasher as _, Hash, RandomState};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use super::bucket::Bucket;

/// Buckets in the table, about 6 MB.
const BUCKET_COUNT: usize = 1 << 16;
/// Buckets in a row. The hash of a key chooses the row.
const BUCKETS_PER_ROW: usize = 8;
/// Burst, in seconds of the rate.
const BURST_SECONDS: f64 = 2.0;

type BucketRow<K> = [Option<(K, Bucket)>; BUCKETS_PER_ROW];

/// Token buckets by key.
#[derive(Debug)]
pub struct RateLimit<K> {
    per_second: f64,
    // Randomly keyed, so that clients cannot choose their row.
    hasher: RandomState,
    rows: Vec<Mutex<BucketRow<K>>>,
}

impl<K: Copy + Eq + Hash> RateLimit<K> {
    /// At most `per_second` requests per second, and twice as many at once.
    pub fn new(per_second: u32) -> Self {
        let rows = (0..BUCKET_COUNT / BUCKETS_PER_ROW)
            .map(|_| Mutex::new([None; BUCKETS_PER_ROW]))
            .collect();
        Self {
            per_second: f64::from(per_second),
            hasher: RandomState::new(),
            rows,
        }
    }

    /// Takes a token of the key.
    /// Errors: The seconds until there is one.
    pub fn take(&self, key: K, now: Instant) -> Result<(), u32> {
        let hash = usize::try_from(self.hasher.hash_one(key) % self.rows.len() as u64).unwrap_or(0);
        let mut row = self.rows[hash]
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let known = row
            .iter()
            .position(|place| place.is_some_and(|(other, _)| other == key));
        let index = known.unwrap_or_else(|| {
            // An empty place is better than a full bucket.
            let tokens =
                |index: usize| row[index].map_or(f64::INFINITY, |(_, bucket)| bucket.tokens(now));
            (0..BUCKETS_PER_ROW)
                .max_by(|a, b| tokens(*a).total_cmp(&tokens(*b)))
                .unwrap_or(0)
        });
        let place = row[index].take().filter(|_| known.is_some());
        let (_, bucket) = row[index].insert(place.unwrap_or_else(|| {
            (
                key,
                Bucket::new(self.per_second, BURST_SECONDS * self.per_second, now),
            )
        }));
        if bucket.take(now) {
            Ok(())
        } else {
            Err(bucket.seconds_to_one())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn each_has_its_own_rate() {
        let rates = RateLimit::new(10);
        let now = Instant::now();
        let taken = |who: u32, at: Instant| {
            (0..1000)
                .take_while(|_| rates.take(who, at).is_ok())
                .count()
        };
        assert_eq!(taken(1, now), 20);
        assert_eq!(taken(2, now), 20);
        assert_eq!(rates.take(1, now), Err(1));
        assert_eq!(taken(1, now + Duration::from_millis(510)), 5);
    }

    /// A million others come between, and the table has no more places than before; one who floods
    /// among them is still held back.
    #[test]
    fn a_crowd_takes_no_more_places_and_hides_no_flood() {
        let rates = RateLimit::new(1);
        let now = Instant::now();
        let mut taken = 0;
        for other in 0..300_000_u64 {
            let _ = rates.take(other, now);
            taken += usize::from(rates.take(u64::MAX, now).is_ok());
        }
        assert_eq!(rates.rows.len() * BUCKETS_PER_ROW, BUCKET_COUNT);
        assert_eq!(taken, 2);
    }
}
