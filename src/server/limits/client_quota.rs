//! Memory that one client may hold: answers that it has not read, however slowly it reads, and requests that it is sending, however
//! slowly it sends. Neither can be taken back, so each has a limit for every client.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::client::{Client, Tenant};

/// Clients that are known before those who hold nothing are looked for and forgotten.
const MANY: usize = 1024;

/// What memory is held by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QuotaKind {
    /// Answers, until they have left.
    Responses,
    /// Requests while they are received and read, and the files that sessions in memory keep of them.
    Requests,
}

/// What each client holds.
#[derive(Debug)]
pub struct ClientQuotas {
    quota: QuotaKind,
    limit: u64,
    held: Mutex<HashMap<Tenant, Arc<AtomicU64>>>,
}

/// What one client holds. Cloning shares it.
#[derive(Clone, Debug)]
pub struct ClientQuota {
    quota: QuotaKind,
    limit: u64,
    held: Arc<AtomicU64>,
}

impl ClientQuotas {
    /// `limit`: bytes that one client may hold.
    pub fn new(quota: QuotaKind, limit: u64) -> Self {
        Self { quota, limit, held: Mutex::default() }
    }

    /// This client's.
    pub fn of(&self, client: Client) -> ClientQuota {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if held.len() >= MANY && held.len().is_power_of_two() {
            // Whoever holds something, or is about to, has another reference.
            held.retain(|_, held| Arc::strong_count(held) > 1);
        }
        ClientQuota { quota: self.quota, limit: self.limit, held: Arc::clone(held.entry(client.tenant()).or_default()) }
    }
}

impl ClientQuota {
    /// What it is held by.
    pub const fn quota(&self) -> QuotaKind {
        self.quota
    }

    /// The most that the client may hold.
    pub const fn limit(&self) -> u64 {
        self.limit
    }

    /// What the client holds.
    pub fn held(&self) -> u64 {
        self.held.load(Ordering::Relaxed)
    }

    /// Takes `more` bytes for something that has `own` already. One answer alone may exceed the share; requests may not.
    /// Errors: What the client holds: there is no room for more.
    pub(crate) fn take(&self, own: u64, more: u64) -> Result<(), u64> {
        let is_alone = |held: u64| self.quota == QuotaKind::Responses && held <= own;
        let fits = |held: u64| held.checked_add(more).filter(|sum| *sum <= self.limit || is_alone(held));
        self.held.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).map(drop)
    }

    /// Gives back.
    pub(crate) fn give(&self, bytes: u64) {
        self.held.fetch_sub(bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use super::*;
    use crate::client::Owner;

    fn client(owner: u8, last: u8) -> Client {
        Client { owner: Owner::from_bytes([owner; 16]), address: IpAddr::from([127, 0, 0, last]) }
    }

    #[test]
    fn one_request_alone_may_not_exceed_the_share() {
        let share = ClientQuotas::new(QuotaKind::Requests, 100).of(client(0, 1));
        assert_eq!(share.take(0, 101), Err(0));
        share.take(0, 100).unwrap();
        assert_eq!(share.take(100, 1), Err(100));
    }

    #[test]
    fn a_name_has_one_share_and_so_has_an_address_without_one() {
        let shares = ClientQuotas::new(QuotaKind::Responses, 100);
        shares.of(client(1, 1)).take(0, 70).unwrap();
        assert_eq!([client(1, 9), client(2, 1), client(0, 1), client(0, 2)].map(|client| shares.of(client).held()), [70, 0, 0, 0]);
        shares.of(client(0, 1)).take(0, 60).unwrap();
        assert_eq!([client(0, 1), client(0, 2)].map(|client| shares.of(client).held()), [60, 0]);
        let v6 = |address: &str| shares.of(Client { owner: Owner::ANYBODY, address: address.parse().unwrap() });
        v6("2001:db8::1").take(0, 50).unwrap();
        assert_eq!(["2001:db8::2:3", "2001:db8:0:1::1", "::ffff:127.0.0.1"].map(|address| v6(address).held()), [50, 0, 60]);
    }

    #[test]
    fn an_answer_alone_may_be_larger_and_every_other_waits_for_room() {
        let share = ClientQuotas::new(QuotaKind::Responses, 100).of(client(0, 1));
        share.take(0, 300).unwrap();
        share.take(300, 50).unwrap();
        assert_eq!(share.take(0, 1), Err(350));
        share.give(260);
        share.take(0, 10).unwrap();
        assert_eq!((share.take(0, 1), share.held()), (Err(100), 100));
    }

    #[test]
    fn who_holds_nothing_is_forgotten() {
        let shares = ClientQuotas::new(QuotaKind::Responses, 100);
        let holds = shares.of(client(0, 1));
        holds.take(0, 5).unwrap();
        for n in 0..=u8::MAX {
            for owner in 1..=6 {
                let _ = shares.of(client(owner, n));
                let _ = shares.of(Client { owner: Owner::ANYBODY, address: IpAddr::from([10, 0, owner, n]) });
            }
        }
        assert!(shares.held.lock().unwrap().len() <= MANY + 512);
        assert_eq!(shares.of(client(0, 1)).held(), 5);
    }
}
