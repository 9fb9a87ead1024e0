//! A decoded label image: numbers instead of colours.

use std::sync::Arc;

use super::{Digest, Limits, Target, WarpError};
use crate::codec::{self, Carried, Labels, Opened, StepCounter};
use crate::pixmap::Extent;

/// A decoded, upright label image. Its labels are those of the file: indices of a palette, grey
/// values of up to 16 bit, or whole colours.
#[derive(Debug)]
pub struct LabelImage {
    digest: Digest,
    pub(super) labels: Arc<Labels>,
}

impl LabelImage {
    /// Upper bound of the memory for decoding a file opened by [`codec::open_labels`], bytes.
    #[must_use]
    pub fn peak_bytes(opened: &Opened<'_>) -> u64 {
        opened.label_bytes()
    }

    /// Decodes a file within limits. CPU work; do not call it on async threads.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode(file: &[u8], limits: &Limits) -> Result<Self, WarpError> {
        Self::decode_as(
            Digest::of(file),
            &codec::open_labels(file, &limits.image, &StepCounter::new(&|| false))?,
        )
    }

    /// Like [`Self::decode`], for a file opened by [`codec::open_labels`] whose digest is known.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode_as(digest: Digest, opened: &Opened<'_>) -> Result<Self, WarpError> {
        Ok(Self {
            digest,
            labels: Arc::new(opened.decode_labels()?),
        })
    }

    /// Labels that no file has.
    #[cfg(test)]
    pub(super) fn of(labels: Labels) -> Self {
        Self {
            digest: Digest::of(&labels.values),
            labels: Arc::new(labels),
        }
    }

    /// The digest of the file.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// Upright size.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.labels.shape.extent
    }

    /// What an output has of the file's metadata.
    pub(super) fn carried(&self, target: &Target) -> Carried {
        target.carried(&self.labels.metadata, self.extent())
    }

    /// Memory of the labels, bytes: their weight in a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.labels.shape.sample_bytes() + self.labels.metadata.bytes() as u64
    }
}
