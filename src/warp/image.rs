//! A decoded picture, shared by everyone who uploads the same bytes.

use std::sync::Arc;

use super::{Digest, WarpError};
use crate::codec::{self, Limits, Profile};
use crate::pixmap::Extent;
use crate::render::Source;

/// A decoded, upright picture with the copies that samplers read, and its colour profile as every answer carries it.
#[derive(Debug)]
pub struct Image {
    digest: Digest,
    pub(super) source: Arc<Source>,
    pub(super) icc: Option<Profile>,
}

impl Image {
    /// Digest of the file's bytes: the key under which the picture is cached.
    #[must_use]
    pub fn digest_of(file: &[u8]) -> Digest {
        Digest::of(file)
    }

    /// The most memory that decoding the file and using its picture will take, bytes, from its header alone: what to reserve before.
    ///
    /// # Errors
    /// Those of [`codec::probe`], and a picture over the limits.
    pub fn peak_bytes(file: &[u8], limits: &Limits) -> Result<u64, WarpError> {
        let header = codec::probe(file)?;
        limits.check(header.extent)?;
        let used = Source::bytes(header.extent, header.channels, header.depth);
        Ok(header.decode_bytes.max(used).saturating_add(codec::PROFILE_BYTES))
    }

    /// Decodes a file behind limits. CPU work; call it off the async threads.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode(file: &[u8], limits: &Limits) -> Result<Self, WarpError> {
        Self::decode_as(Self::digest_of(file), file, limits)
    }

    /// The same where the digest is known already.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode_as(digest: Digest, file: &[u8], limits: &Limits) -> Result<Self, WarpError> {
        let decoded = codec::decode(file, limits)?;
        Ok(Self { digest, source: Arc::new(Source::new(decoded.pixmap)), icc: decoded.icc.as_deref().map(Profile::new) })
    }

    /// The digest of the file.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// Upright size.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.source.pixmap().extent()
    }

    /// The most memory that the picture may come to hold, all sampling copies included, bytes: its weight in a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let pixmap = self.source.pixmap();
        let profile = self.icc.as_ref().map_or(0, Profile::bytes);
        Source::bytes(pixmap.extent(), pixmap.channels(), pixmap.depth()) + profile as u64
    }
}
