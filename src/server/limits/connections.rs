//! Connections: how many there may be, and how many from one address. Whoever has no place is told at once by a closed connection: in the backlog
//! it would wait for one of those to end that keep the others out, and would not even learn that it waits.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::client::Tenant;

/// Places for connections.
#[derive(Clone, Debug)]
pub struct ConnectionLimiter(Arc<LimiterState>);

#[derive(Debug)]
struct LimiterState {
    most: usize,
    most_of_one: usize,
    taken: Mutex<Taken>,
    refused: AtomicU64,
}

#[derive(Debug, Default)]
struct Taken {
    all: usize,
    by_client: HashMap<Tenant, usize>,
}

/// The place of one connection; given back when dropped.
#[derive(Debug)]
pub struct ConnectionPermit {
    places: ConnectionLimiter,
    client: Tenant,
}

impl ConnectionLimiter {
    /// So many, and so many from one address (from one /64 of IPv6).
    pub fn new(most: usize, most_of_one: usize) -> Self {
        Self(Arc::new(LimiterState { most, most_of_one, taken: Mutex::default(), refused: AtomicU64::new(0) }))
    }

    /// A place, if there is one. A proxy that is trusted to count by itself may have all.
    pub fn take(&self, peer: IpAddr, is_proxy: bool) -> Option<ConnectionPermit> {
        let client = Tenant::of_address(peer);
        let mut taken = self.taken();
        let of_one = taken.by_client.get(&client).copied().unwrap_or(0);
        if taken.all >= self.0.most || (!is_proxy && of_one >= self.0.most_of_one) {
            self.0.refused.fetch_add(1, Ordering::Relaxed);
            return None;
        }
        taken.all += 1;
        taken.by_client.insert(client, of_one + 1);
        Some(ConnectionPermit { places: self.clone(), client })
    }

    /// Connections that there are.
    pub fn open(&self) -> usize {
        self.taken().all
    }

    /// Connections that found no place so far.
    pub fn refused(&self) -> u64 {
        self.0.refused.load(Ordering::Relaxed)
    }

    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.0.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for ConnectionPermit {
    fn drop(&mut self) {
        let mut taken = self.places.taken();
        taken.all = taken.all.saturating_sub(1);
        match taken.by_client.get_mut(&self.client) {
            Some(of_one @ 2..) => *of_one -= 1,
            _ => {
                taken.by_client.remove(&self.client);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_counted_and_come_back() {
        let places = ConnectionLimiter::new(4, 2);
        let ip = |text: &str| text.parse::<IpAddr>().unwrap();
        let first = places.take(ip("192.0.2.1"), false);
        let second = places.take(ip("192.0.2.1"), false);
        assert!(first.is_some() && second.is_some());
        assert!(places.take(ip("192.0.2.1"), false).is_none());
        let proxy = places.take(ip("192.0.2.1"), true);
        assert!(proxy.is_some());
        let v6 = places.take(ip("2001:db8::1"), false);
        assert!(v6.is_some());
        assert!(places.take(ip("192.0.2.2"), false).is_none(), "there are four");
        assert_eq!((places.open(), places.refused()), (4, 2));
        drop((first, second, proxy, v6));
        assert_eq!(places.open(), 0);
        assert!(places.taken().by_client.is_empty(), "an address that has left is forgotten");
    }
}
