//! The identity of a client: the owner of its sessions, its address, and the tenant that limits and
//! queues count.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use data_encoding::HEXLOWER;

/// The owner of sessions. Sessions of one owner do not exist for another, not even their names.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Owner([u8; 16]);

impl Owner {
    /// Every client without a key.
    pub const ANYBODY: Self = Self([0; 16]);

    /// The owner with this id.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// The id.
    pub const fn to_bytes(self) -> [u8; 16] {
        self.0
    }
}

impl fmt::Debug for Owner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Self::ANYBODY {
            f.write_str("anybody")
        } else {
            f.write_str(&HEXLOWER.encode(&self.0[..4]))
        }
    }
}

/// The sender of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Client {
    /// The owner of its sessions.
    pub owner: Owner,
    /// Its address.
    pub address: IpAddr,
    /// With a token instead of the owner's key: the UUID of the only session that it may use.
    pub visit: Option<[u8; 16]>,
}

/// Low bits of an IPv6 address that are ignored: every customer of a provider gets at least a /64.
const V6_HOST_BITS: u32 = 64;

/// The unit that limits and fair queues count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Tenant {
    /// The name of a key, from any address.
    Key(Owner),
    /// Without keys: an IPv4 address, or the /64 of an IPv6 address.
    Address(IpAddr),
    /// Below a key: the holders of tokens for this session.
    Visitor(Owner, [u8; 16]),
}

impl Tenant {
    /// The tenant of a client without a key.
    pub fn of_address(address: IpAddr) -> Self {
        Self::Address(match address.to_canonical() {
            IpAddr::V6(v6) => IpAddr::V6(Ipv6Addr::from_bits(
                v6.to_bits() >> V6_HOST_BITS << V6_HOST_BITS,
            )),
            v4 @ IpAddr::V4(_) => v4,
        })
    }

    /// Who answers for it: the key of a visitor, otherwise itself.
    pub const fn payer(self) -> Self {
        match self {
            Self::Visitor(owner, _) => Self::Key(owner),
            Self::Key(_) | Self::Address(_) => self,
        }
    }
}

impl Client {
    /// The tenant that it counts as: a visitor is one of its own below its key.
    pub fn tenant(self) -> Tenant {
        match self.visit {
            _ if self.owner == Owner::ANYBODY => Tenant::of_address(self.address),
            Some(session) => Tenant::Visitor(self.owner, session),
            None => Tenant::Key(self.owner),
        }
    }

    /// The tenant that answers for it.
    pub fn payer(self) -> Tenant {
        self.tenant().payer()
    }
}

impl Default for Client {
    fn default() -> Self {
        Self {
            owner: Owner::ANYBODY,
            address: IpAddr::V4(Ipv4Addr::UNSPECIFIED),
            visit: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_counts_from_every_address_and_without_keys_the_address_counts() {
        let tenant = |owner: u8, address: &str| {
            Client {
                owner: Owner::from_bytes([owner; 16]),
                address: address.parse().unwrap(),
                visit: None,
            }
            .tenant()
        };
        assert_eq!(tenant(1, "192.0.2.1"), tenant(1, "2001:db8::1"));
        assert_ne!(tenant(1, "192.0.2.1"), tenant(2, "192.0.2.1"));
        assert_ne!(tenant(0, "192.0.2.1"), tenant(0, "192.0.2.2"));
        assert_eq!(
            tenant(0, "2001:db8:1:2:3:4:5:6"),
            Tenant::Address("2001:db8:1:2::".parse().unwrap())
        );
        assert_ne!(tenant(0, "2001:db8:1:2::1"), tenant(0, "2001:db8:1:3::1"));
        assert_eq!(tenant(0, "::ffff:192.0.2.1"), tenant(0, "192.0.2.1"));
    }
}
