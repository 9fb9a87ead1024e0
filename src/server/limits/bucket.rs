//! A token bucket: limits the rate and the burst of messages. The caller passes the time.

use std::time::Instant;

/// One message takes one token; tokens are refilled with time.
#[derive(Clone, Copy, Debug)]
pub struct Bucket {
    tokens: f64,
    capacity: f64,
    per_second: f64,
    updated: Instant,
}

impl Bucket {
    /// A full bucket.
    pub const fn new(per_second: f64, capacity: f64, now: Instant) -> Self {
        Self {
            tokens: capacity,
            capacity,
            per_second,
            updated: now,
        }
    }

    /// Takes a token; false if the bucket is empty.
    pub fn take(&mut self, now: Instant) -> bool {
        self.tokens = self.tokens(now);
        self.updated = self.updated.max(now);
        let is_available = self.tokens >= 1.0;
        if is_available {
            self.tokens -= 1.0;
        }
        is_available
    }

    /// The tokens at this time.
    pub fn tokens(&self, now: Instant) -> f64 {
        let passed = now.saturating_duration_since(self.updated).as_secs_f64();
        (self.tokens + passed * self.per_second).min(self.capacity)
    }

    /// Whole seconds from the last [`Bucket::take`] until there is a token, at least 1.
    pub fn seconds_to_one(&self) -> u32 {
        let seconds = ((1.0 - self.tokens) / self.per_second)
            .ceil()
            .clamp(1.0, 3600.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between 1 and 3600"
        )]
        let seconds = seconds as u32;
        seconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_steady_hand_loses_nothing_and_a_flood_is_seen() {
        let start = Instant::now();
        let at = |n: u32, a_second: u32| start + Duration::from_secs(1) * n / a_second;
        let lasts = |a_second: u32| {
            let mut bucket = Bucket::new(1000.0, 2000.0, start);
            (0..60 * a_second)
                .take_while(|n| bucket.take(at(*n, a_second)))
                .count()
        };
        assert_eq!(lasts(125), 60 * 125);
        assert_eq!(lasts(990), 60 * 990);
        let flood = lasts(10_000);
        assert!((2000..2300).contains(&flood), "{flood}");
    }

    #[test]
    fn a_pause_fills_it_no_further_than_full() {
        let start = Instant::now();
        let mut bucket = Bucket::new(10.0, 5.0, start);
        let later = start + Duration::from_secs(3600);
        assert_eq!((0..100).take_while(|_| bucket.take(later)).count(), 5);
        // A clock that is behind gives nothing back.
        assert!(!bucket.take(start));
        assert!(bucket.take(later + Duration::from_millis(150)));
    }
}
