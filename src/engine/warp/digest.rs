//! SHA-256 digests of files, of the inputs of a plan, and of an output.

use std::fmt;

#[cfg(not(feature = "codec"))]
use super::sha256::Sha256;
#[cfg(feature = "codec")]
use sha2::{Digest as _, Sha256};

/// A SHA-256 digest; displays as lower-case hex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Digest(pub [u8; 32]);

impl Digest {
    /// The digest of bytes.
    ///
    /// ```
    /// use mlswarp::warp::Digest;
    /// assert!(Digest::of(b"abc").to_string().starts_with("ba7816bf"));
    /// ```
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        let mut hash = Sha256::new();
        hash.update(bytes);
        finish(hash)
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Digests numbers bit for bit, each with a fixed width, so that different lists have different
/// inputs.
#[derive(Debug, Default)]
pub(super) struct Collector(Sha256);

impl Collector {
    /// `domain` keeps digests of different kinds apart.
    pub(super) fn new(domain: &str) -> Self {
        Self(Sha256::new()).bytes(domain.as_bytes())
    }

    pub(super) fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.update((bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    pub(super) fn integer(mut self, n: u64) -> Self {
        self.0.update(n.to_le_bytes());
        self
    }

    pub(super) fn float(self, x: f64) -> Self {
        // -0 and 0 give the same deformation.
        self.integer((x + 0.0).to_bits())
    }

    pub(super) fn finish(self) -> Digest {
        finish(self.0)
    }
}

#[cfg(feature = "codec")]
fn finish(hash: Sha256) -> Digest {
    Digest(hash.finalize().into())
}

#[cfg(not(feature = "codec"))]
fn finish(hash: Sha256) -> Digest {
    Digest(hash.finish())
}
