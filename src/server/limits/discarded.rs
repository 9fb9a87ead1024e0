//! What is read of an address only to be discarded. It costs a client nothing to send bodies of
//! requests that were answered early, so those of one address together are read slowly.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How fast bodies of an address are discarded, and for how long they may be ahead of that: 64 MiB
/// at once, so that the senders of a few large bodies find their answers soon. Without this, four
/// connections that sent 30 MiB again and again where there is no route took 74 % of the runtime's
/// thread over the loopback; with it, 5 %.
const BYTES_PER_SECOND: u32 = 16 << 20;
const MOST_AHEAD: Duration = Duration::from_secs(4);

/// How much of an address was discarded: the time at which its rate has come as far.
#[derive(Debug, Default)]
pub(crate) struct Discarded(Mutex<Option<Instant>>);

impl Discarded {
    /// Counts bytes. How long to wait before more are read.
    pub(crate) fn add(&self, bytes: usize, now: Instant) -> Duration {
        let mut reached = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes = u32::try_from(bytes).unwrap_or(u32::MAX);
        let until = reached.map_or(now, |reached| reached.max(now))
            + Duration::from_secs(1) * bytes / BYTES_PER_SECOND;
        *reached = Some(until);
        until
            .saturating_duration_since(now)
            .saturating_sub(MOST_AHEAD)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pieces of 64 KiB that this many connections discard in ten seconds.
    fn discarded(connections: usize) -> usize {
        let (address, start) = (Discarded::default(), Instant::now());
        let mut next = vec![start; connections];
        let mut pieces = 0;
        while let Some(at) = next
            .iter_mut()
            .min()
            .filter(|at| **at < start + Duration::from_secs(10))
        {
            *at += address.add(64 << 10, *at);
            pieces += 1;
        }
        pieces
    }

    #[test]
    fn many_bodies_of_an_address_are_discarded_no_faster_than_one() {
        // 64 MiB at once, and 160 in ten seconds.
        let of_one = discarded(1);
        assert!((3580..3600).contains(&of_one), "{of_one}");
        let of_many = discarded(100);
        assert!((of_one..of_one + 200).contains(&of_many), "{of_many}");
    }

    #[test]
    fn a_body_of_another_address_and_one_after_a_pause_do_not_wait() {
        let (address, start) = (Discarded::default(), Instant::now());
        assert!(address.add(64 << 20, start).is_zero());
        assert!(!address.add(16 << 20, start).is_zero());
        assert!(Discarded::default().add(64 << 20, start).is_zero());
        let later = start + Duration::from_secs(60);
        assert!(address.add(64 << 20, later).is_zero());
    }
}
