//! Who asks: whose sessions are meant, and where the request comes from.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr};

/// Whose sessions are meant. Sessions of one owner do not exist for another, not even their names.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Owner([u8; 16]);

impl Owner {
    /// Everybody who needs no key.
    pub const ANYBODY: Self = Self([0; 16]);

    /// An owner by what names it.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// What names it.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; 16] {
        self.0
    }
}

impl fmt::Debug for Owner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Self::ANYBODY {
            return f.write_str("anybody");
        }
        self.0[..4].iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Who sent a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Client {
    /// Whose sessions it may use.
    pub owner: Owner,
    /// Where it comes from.
    pub address: IpAddr,
}

impl Default for Client {
    fn default() -> Self {
        Self { owner: Owner::ANYBODY, address: IpAddr::V4(Ipv4Addr::UNSPECIFIED) }
    }
}
