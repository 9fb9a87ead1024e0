//! Quotas of memory per client, for responses that it reads slowly and for requests that it sends
//! slowly: this memory cannot be reclaimed.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::client_limit::ClientLimit;
use crate::client::{Client, Tenant};

/// Number of clients from which those that use nothing are removed from the map.
const MANY_CLIENTS: usize = 1024;

/// The kind of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum QuotaKind {
    /// Responses, until they are sent.
    Responses,
    /// Requests while they are received and parsed, and the files that sessions in memory keep of
    /// them.
    Requests,
}

impl QuotaKind {
    /// The end of a sentence about memory that is taken.
    pub(crate) const fn used_by(self) -> &'static str {
        match self {
            Self::Responses => " by responses that this client has not read",
            Self::Requests => {
                " by requests of this client, and by files that its sessions keep in memory"
            }
        }
    }
}

/// The quotas of all clients.
#[derive(Debug)]
pub(crate) struct ClientQuotas {
    kind: QuotaKind,
    limit: ClientLimit,
    used: Mutex<HashMap<Tenant, Arc<AtomicU64>>>,
}

/// The quota of one client. Clones share it.
#[derive(Clone, Debug)]
pub struct ClientQuota {
    kind: QuotaKind,
    limit: ClientLimit,
    used: Arc<AtomicU64>,
}

impl ClientQuotas {
    /// `limit`: bytes per client.
    pub(crate) fn new(kind: QuotaKind, limit: impl Into<ClientLimit>) -> Self {
        Self {
            kind,
            limit: limit.into(),
            used: Mutex::default(),
        }
    }

    pub(crate) fn of(&self, client: Client) -> ClientQuota {
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        if used.len() >= MANY_CLIENTS && used.len().is_power_of_two() {
            // A client that uses memory, or is about to, holds another reference.
            used.retain(|_, used| Arc::strong_count(used) > 1);
        }
        let used = Arc::clone(used.entry(client.tenant()).or_default());
        ClientQuota {
            kind: self.kind,
            limit: self.limit.clone(),
            used,
        }
    }
}

impl ClientQuota {
    pub(crate) const fn kind(&self) -> QuotaKind {
        self.kind
    }

    /// Maximum number of bytes.
    pub fn limit(&self) -> u64 {
        self.limit.get()
    }

    /// Bytes in use.
    pub fn held(&self) -> u64 {
        self.used.load(Ordering::Relaxed)
    }

    /// Reserves `more` bytes for an owner of `own` bytes. A single response may exceed the quota;
    /// requests may not. Errors: The bytes in use, if the quota is exceeded.
    pub(crate) fn reserve(&self, own: u64, more: u64) -> Result<(), u64> {
        let is_alone = |used: u64| self.kind == QuotaKind::Responses && used <= own;
        let fits = |used: u64| {
            used.checked_add(more)
                .filter(|sum| *sum <= self.limit() || is_alone(used))
        };
        self.used
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits)
            .map(drop)
    }

    pub(crate) fn release(&self, bytes: u64) {
        self.used.fetch_sub(bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use super::*;
    use crate::client::Owner;

    fn client(owner: u8, last: u8) -> Client {
        Client {
            owner: Owner::from_bytes([owner; 16]),
            address: IpAddr::from([127, 0, 0, last]),
            visit: None,
        }
    }

    #[test]
    fn one_request_alone_may_not_exceed_the_share() {
        let share = ClientQuotas::new(QuotaKind::Requests, 100).of(client(0, 1));
        assert_eq!(share.reserve(0, 101), Err(0));
        share.reserve(0, 100).unwrap();
        assert_eq!(share.reserve(100, 1), Err(100));
    }

    #[test]
    fn a_name_has_one_share_and_so_has_an_address_without_one() {
        let shares = ClientQuotas::new(QuotaKind::Responses, 100);
        shares.of(client(1, 1)).reserve(0, 70).unwrap();
        assert_eq!(
            [client(1, 9), client(2, 1), client(0, 1), client(0, 2)]
                .map(|client| shares.of(client).held()),
            [70, 0, 0, 0]
        );
        shares.of(client(0, 1)).reserve(0, 60).unwrap();
        assert_eq!(
            [client(0, 1), client(0, 2)].map(|client| shares.of(client).held()),
            [60, 0]
        );
        let v6 = |address: &str| {
            shares.of(Client {
                owner: Owner::ANYBODY,
                address: address.parse().unwrap(),
                visit: None,
            })
        };
        v6("2001:db8::1").reserve(0, 50).unwrap();
        assert_eq!(
            ["2001:db8::2:3", "2001:db8:0:1::1", "::ffff:127.0.0.1"]
                .map(|address| v6(address).held()),
            [50, 0, 60]
        );
    }

    #[test]
    fn an_answer_alone_may_be_larger_and_every_other_waits_for_room() {
        let share = ClientQuotas::new(QuotaKind::Responses, 100).of(client(0, 1));
        share.reserve(0, 300).unwrap();
        share.reserve(300, 50).unwrap();
        assert_eq!(share.reserve(0, 1), Err(350));
        share.release(260);
        share.reserve(0, 10).unwrap();
        assert_eq!((share.reserve(0, 1), share.held()), (Err(100), 100));
    }

    #[test]
    fn who_holds_nothing_is_forgotten() {
        let shares = ClientQuotas::new(QuotaKind::Responses, 100);
        let holds = shares.of(client(0, 1));
        holds.reserve(0, 5).unwrap();
        for n in 0..=u8::MAX {
            for owner in 1..=6 {
                let _ = shares.of(client(owner, n));
                let _ = shares.of(Client {
                    owner: Owner::ANYBODY,
                    address: IpAddr::from([10, 0, owner, n]),
                    visit: None,
                });
            }
        }
        assert!(shares.used.lock().unwrap().len() <= MANY_CLIENTS + 512);
        assert_eq!(shares.of(client(0, 1)).held(), 5);
    }
}
