//! How often one may ask: a token bucket for each of many, in a table that never grows. Where more ask than it has places, the one who has asked
//! least of late is forgotten and begins anew with a full bucket: a crowd is forgiven, one who floods is remembered.

use std::hash::{BuildHasher as _, Hash, RandomState};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use super::bucket::Bucket;

/// Places of the table: about 6 MB when rates are on, nothing when they are off.
const PLACES: usize = 1 << 16;
/// Places that one may lie in.
const NEIGHBOURS: usize = 8;
/// What may come at once, in seconds of the rate.
const BURST: f64 = 2.0;

/// Places that those lie in who share them.
type Row<K> = [Option<(K, Bucket)>; NEIGHBOURS];

/// Buckets by who asks.
pub struct RateLimit<K> {
    a_second: f64,
    // Keyed by the operating system's randomness: nobody can choose whom to meet in a place.
    hasher: RandomState,
    places: Vec<Mutex<Row<K>>>,
}

impl<K> std::fmt::Debug for RateLimit<K> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Rates").field("a_second", &self.a_second).finish_non_exhaustive()
    }
}

impl<K: Copy + Eq + Hash> RateLimit<K> {
    /// So many requests a second, and twice as many at once.
    pub fn new(a_second: u32) -> Self {
        let rows = (0..PLACES / NEIGHBOURS).map(|_| Mutex::new([None; NEIGHBOURS]));
        Self { a_second: f64::from(a_second), hasher: RandomState::new(), places: rows.collect() }
    }

    /// Takes one of whoever asks.
    /// Errors: There is none; the seconds after which there is one.
    pub fn take(&self, who: K, now: Instant) -> Result<(), u32> {
        let hash = usize::try_from(self.hasher.hash_one(who) % self.places.len() as u64).unwrap_or(0);
        let mut row = self.places[hash].lock().unwrap_or_else(PoisonError::into_inner);
        let known = row.iter().position(|place| place.is_some_and(|(name, _)| name == who));
        let index = known.unwrap_or_else(|| {
            let free = (0..NEIGHBOURS).max_by(|a, b| tokens(row[*a], now).total_cmp(&tokens(row[*b], now))).unwrap_or(0);
            row[free] = Some((who, Bucket::new(self.a_second, BURST * self.a_second, now)));
            free
        });
        let Some((_, bucket)) = &mut row[index] else { return Ok(()) };
        if bucket.take(now) { Ok(()) } else { Err(bucket.seconds_to_one()) }
    }
}

/// Nobody is as good as anybody with a full bucket.
fn tokens<K>(place: Option<(K, Bucket)>, now: Instant) -> f64 {
    place.map_or(f64::INFINITY, |(_, bucket)| bucket.tokens(now))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn each_has_its_own_rate() {
        let rates = RateLimit::new(10);
        let now = Instant::now();
        let taken = |who: u32, at: Instant| (0..1000).take_while(|_| rates.take(who, at).is_ok()).count();
        assert_eq!(taken(1, now), 20);
        assert_eq!(taken(2, now), 20);
        assert_eq!(rates.take(1, now), Err(1));
        assert_eq!(taken(1, now + Duration::from_millis(510)), 5);
    }

    /// A million others come between, and the table has no more places than before; one who floods among them is still held back.
    #[test]
    fn a_crowd_takes_no_more_places_and_hides_no_flood() {
        let rates = RateLimit::new(1);
        let now = Instant::now();
        let mut taken = 0;
        for other in 0..300_000_u64 {
            let _ = rates.take(other, now);
            taken += usize::from(rates.take(u64::MAX, now).is_ok());
        }
        assert_eq!(rates.places.len() * NEIGHBOURS, PLACES);
        assert_eq!(taken, 2);
    }
}
