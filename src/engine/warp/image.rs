//! A decoded picture, shared by everyone who uploads the same bytes.

use std::sync::Arc;

use super::{Digest, Warning, WarpError};
use crate::codec::{self, Limits, Opened, Profile, StepCounter};
use crate::pixmap::Extent;
use crate::render::Source;

/// A decoded, upright picture with the copies that samplers read, and its colour profile as every answer carries it.
#[derive(Debug)]
pub struct Image {
    digest: Digest,
    pub(super) source: Arc<Source>,
    pub(super) icc: Option<Profile>,
    profile_dropped: bool,
}

impl Image {
    /// Digest of the file's bytes: the key under which the picture is cached.
    #[must_use]
    pub fn digest_of(file: &[u8]) -> Digest {
        Digest::of(file)
    }

    /// The most memory that decoding an opened file and using its picture will take, bytes: what to reserve before.
    #[must_use]
    pub fn peak_bytes(opened: &Opened<'_>) -> u64 {
        let header = opened.header();
        let used = Source::bytes(header.extent, header.channels, header.depth);
        header.decode_bytes.max(used).saturating_add(codec::PROFILE_BYTES)
    }

    /// Decodes a file behind limits. CPU work; call it off the async threads.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode(file: &[u8], limits: &Limits) -> Result<Self, WarpError> {
        Self::decode_as(Self::digest_of(file), &codec::open(file, limits, &StepCounter::new(&|| false))?)
    }

    /// The same of an opened file whose digest is known already.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode_as(digest: Digest, opened: &Opened<'_>) -> Result<Self, WarpError> {
        let decoded = opened.decode()?;
        let icc = decoded.icc.as_deref().map(Profile::new);
        Ok(Self { digest, source: Arc::new(Source::new(decoded.pixmap)), icc, profile_dropped: decoded.profile_dropped })
    }

    /// What a client should know of every picture that is drawn from this one.
    #[must_use]
    pub fn warning(&self) -> Option<Warning> {
        self.profile_dropped.then_some(Warning::ProfileDropped)
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
