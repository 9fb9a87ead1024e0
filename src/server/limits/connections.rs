//! Limits the number of connections, in total and per address. Further connections are closed
//! immediately: in the backlog they would wait without limit.

use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::counts::Counts;
use crate::client::Tenant;

/// Admits connections. Clones share the counts.
#[derive(Clone, Debug)]
pub struct ConnectionLimiter(Arc<LimiterState>);

#[derive(Debug)]
struct LimiterState {
    max: usize,
    max_per_address: usize,
    open: Mutex<Counts<Tenant>>,
    refused: AtomicU64,
}

/// The permit of one connection, returned when dropped.
#[derive(Debug)]
pub struct ConnectionPermit {
    limiter: ConnectionLimiter,
    address: Tenant,
}

impl ConnectionLimiter {
    /// An address is an IPv4 address or a /64 of IPv6.
    pub fn new(max: usize, max_per_address: usize) -> Self {
        Self(Arc::new(LimiterState {
            max,
            max_per_address,
            open: Mutex::default(),
            refused: AtomicU64::new(0),
        }))
    }

    /// A permit, if the limits allow it. The limit per address does not apply to a trusted proxy.
    pub fn acquire(&self, peer: IpAddr, is_proxy: bool) -> Option<ConnectionPermit> {
        let address = Tenant::of_address(peer);
        let mut open = self.lock();
        if open.total >= self.0.max || (!is_proxy && open.get(&address) >= self.0.max_per_address) {
            self.0.refused.fetch_add(1, Ordering::Relaxed);
            return None;
        }
        open.add(address);
        Some(ConnectionPermit {
            limiter: self.clone(),
            address,
        })
    }

    /// Open connections.
    pub fn open(&self) -> usize {
        self.lock().total
    }

    /// Connections that were refused since the start.
    pub fn refused(&self) -> u64 {
        self.0.refused.load(Ordering::Relaxed)
    }

    fn lock(&self) -> MutexGuard<'_, Counts<Tenant>> {
        self.0.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for ConnectionPermit {
    fn drop(&mut self) {
        self.limiter.lock().remove(&self.address);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_counted_and_come_back() {
        let places = ConnectionLimiter::new(4, 2);
        let ip = |text: &str| text.parse::<IpAddr>().unwrap();
        let first = places.acquire(ip("192.0.2.1"), false);
        let second = places.acquire(ip("192.0.2.1"), false);
        assert!(first.is_some() && second.is_some());
        assert!(places.acquire(ip("192.0.2.1"), false).is_none());
        let proxy = places.acquire(ip("192.0.2.1"), true);
        assert!(proxy.is_some());
        let v6 = places.acquire(ip("2001:db8::1"), false);
        assert!(v6.is_some());
        assert!(
            places.acquire(ip("192.0.2.2"), false).is_none(),
            "there are four"
        );
        assert_eq!((places.open(), places.refused()), (4, 2));
        drop((first, second, proxy, v6));
        assert_eq!(places.open(), 0);
        assert!(
            places.lock().by_key.is_empty(),
            "an address that has left is forgotten"
        );
    }
}
