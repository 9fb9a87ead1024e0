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

/// The quotas of all clients, and of the visitors below them.
#[derive(Debug)]
pub(crate) struct ClientQuotas {
    kind: QuotaKind,
    limit: ClientLimit,
    /// Bytes of one visitor.
    visitor_limit: u64,
    used: Mutex<HashMap<Tenant, Arc<AtomicU64>>>,
}

/// The quota of one client. Clones share it.
#[derive(Clone, Debug)]
pub struct ClientQuota {
    kind: QuotaKind,
    of_client: QuotaLevel,
    /// Of a visitor: its own, which also counts in that of its client.
    of_visitor: Option<QuotaLevel>,
}

#[derive(Clone, Debug)]
struct QuotaLevel {
    limit: ClientLimit,
    used: Arc<AtomicU64>,
}

impl ClientQuotas {
    /// `limit`: bytes per client.
    pub(crate) fn new(kind: QuotaKind, limit: impl Into<ClientLimit>) -> Self {
        Self {
            kind,
            limit: limit.into(),
            visitor_limit: u64::MAX,
            used: Mutex::default(),
        }
    }

    pub(crate) fn of(&self, client: Client) -> ClientQuota {
        let mut used = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        if used.len() >= MANY_CLIENTS && used.len().is_power_of_two() {
            // A client that uses memory, or is about to, holds another reference.
            used.retain(|_, used| Arc::strong_count(used) > 1);
        }
        let mut level = |tenant: Tenant, limit: ClientLimit| QuotaLevel {
            limit,
            used: Arc::clone(used.entry(tenant).or_default()),
        };
        let (tenant, payer) = (client.tenant(), client.payer());
        ClientQuota {
            kind: self.kind,
            of_client: level(payer, self.limit.clone()),
            of_visitor: (tenant != payer).then(|| level(tenant, self.visitor_limit.into())),
        }
    }

    /// With a limit for each visitor, bytes.
    pub(crate) fn with_visitors(self, visitor_limit: u64) -> Self {
        Self {
            visitor_limit,
            ..self
        }
    }
}

impl ClientQuota {
    pub(crate) const fn kind(&self) -> QuotaKind {
        self.kind
    }

    /// Maximum number of bytes: the client's, or the visitor's.
    pub fn limit(&self) -> u64 {
        self.levels()
            .map(|level| level.limit.get())
            .min()
            .unwrap_or(u64::MAX)
    }

    /// Bytes in use by the client, with its visitors.
    pub fn held(&self) -> u64 {
        self.of_client.used.load(Ordering::Relaxed)
    }

    fn levels(&self) -> impl Iterator<Item = &QuotaLevel> {
        std::iter::once(&self.of_client).chain(&self.of_visitor)
    }

    /// Reserves `more` bytes for an owner of `own` bytes. A single response may exceed the quota;
    /// requests may not. Errors: The limit that is exceeded, and the bytes in use.
    pub(crate) fn reserve(&self, own: u64, more: u64) -> Result<(), (u64, u64)> {
        let is_alone = |used: u64| self.kind == QuotaKind::Responses && used <= own;
        for (n, level) in self.levels().enumerate() {
            let limit = level.limit.get();
            let fits = |used: u64| {
                used.checked_add(more)
                    .filter(|sum| *sum <= limit || is_alone(used))
            };
            let taken = level
                .used
                .fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits);
            if let Err(used) = taken {
                for level in self.levels().take(n) {
                    level.used.fetch_sub(more, Ordering::Relaxed);
                }
                return Err((limit, used));
            }
        }
        Ok(())
    }

    pub(crate) fn release(&self, bytes: u64) {
        for level in self.levels() {
            level.used.fetch_sub(bytes, Ordering::Relaxed);
        }
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
        assert_eq!(share.reserve(0, 101), Err((100, 0)));
        share.reserve(0, 100).unwrap();
        assert_eq!(share.reserve(100, 1), Err((100, 100)));
    }

    #[test]
    fn a_visitor_has_a_part_of_the_share_of_its_client() {
        let shares = ClientQuotas::new(QuotaKind::Requests, 100).with_visitors(40);
        let visitor = |session: u8| {
            shares.of(Client {
                visit: Some([session; 16]),
                ..client(1, session)
            })
        };
        let [one, two, three] = [1, 2, 3].map(visitor);
        one.reserve(0, 40).unwrap();
        assert_eq!((one.reserve(40, 1), one.limit()), (Err((40, 40)), 40));
        // From another address it is the same visitor.
        let elsewhere = shares.of(Client {
            visit: Some([1; 16]),
            ..client(1, 9)
        });
        assert_eq!(elsewhere.reserve(0, 1), Err((40, 40)));
        two.reserve(0, 40).unwrap();
        // All together have what the client has, and what is refused takes nothing.
        assert_eq!(three.reserve(0, 30), Err((100, 80)));
        three.reserve(0, 20).unwrap();
        assert_eq!((three.held(), shares.of(client(1, 1)).held()), (100, 100));
        assert_eq!(shares.of(client(1, 1)).reserve(0, 1), Err((100, 100)));
        shares.of(client(2, 1)).reserve(0, 100).unwrap();
        one.release(40);
        shares.of(client(1, 1)).reserve(0, 40).unwrap();
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
        assert_eq!(share.reserve(0, 1), Err((100, 350)));
        share.release(260);
        share.reserve(0, 10).unwrap();
        assert_eq!((share.reserve(0, 1), share.held()), (Err((100, 100)), 100));
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
