//! A decoded picture, shared by all requests with the same file.

use std::sync::{Arc, OnceLock};

use super::region::{for_each_pixel, occupied_words};
use super::{Digest, Target, WarpError};
use crate::codec::{self, Carried, ImageLimits, Metadata, Opened, Repairs, StepCounter};
use crate::pixmap::{Channels, Depth, Extent, Pixmap};
use crate::render::Source;

/// A decoded, upright picture with its derived copies for sampling, and its metadata for every
/// output.
#[derive(Debug)]
pub struct Image {
    digest: Digest,
    pub(super) source: Arc<Source>,
    /// Which pixels have some of a mask, if the picture has been one.
    pub(super) occupied: Arc<OnceLock<Vec<u64>>>,
    metadata: Arc<Metadata>,
    /// What of the file was mended.
    pub(super) repairs: Repairs,
    /// Whether the file stores one sample for the three colours.
    pub(super) grey: bool,
}

impl Image {
    /// Digest of the file's bytes: the key under which the picture is cached.
    #[must_use]
    pub fn digest_of(file: &[u8]) -> Digest {
        Digest::of(file)
    }

    /// Upper bound of the memory for decoding an opened file and using its picture, bytes.
    #[must_use]
    pub fn peak_bytes(opened: &Opened<'_>) -> u64 {
        let header = opened.header();
        let used = used_bytes(header.extent, header.channels, header.depth);
        header
            .decode_bytes
            .max(used)
            .saturating_add(codec::PROFILE_BYTES + codec::METADATA_BYTES)
    }

    /// Decodes a file within limits. CPU work; do not call it on async threads.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    ///
    /// ```
    /// use mlswarp::warp::{Image, ImageLimits};
    /// let file = include_bytes!("../test_files/images/chelsea.png");
    /// let image = Image::decode(file, &ImageLimits::default())?;
    /// assert_eq!((image.extent().width(), image.extent().height()), (451, 300));
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn decode(file: &[u8], limits: &ImageLimits) -> Result<Self, WarpError> {
        Self::decode_as(
            Self::digest_of(file),
            &codec::open(file, limits, &StepCounter::new(&|| false))?,
        )
    }

    /// Like [`Self::decode`], for an opened file whose digest is known.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode_as(digest: Digest, opened: &Opened<'_>) -> Result<Self, WarpError> {
        let decoded = opened.decode()?;
        Ok(Self {
            digest,
            source: Arc::new(Source::new(decoded.pixmap)),
            occupied: Arc::default(),
            metadata: Arc::new(decoded.metadata),
            repairs: decoded.repairs,
            grey: opened.header().grey,
        })
    }

    /// A picture that no file has. `name`: of its digest.
    #[cfg(test)]
    pub(super) fn of_pixmap(name: &str, pixmap: Pixmap, grey: bool) -> Self {
        let (digest, metadata, repairs) = (
            Digest::of(name.as_bytes()),
            Arc::default(),
            Repairs::default(),
        );
        Self {
            digest,
            source: Arc::new(Source::new(pixmap)),
            occupied: Arc::default(),
            metadata,
            repairs,
            grey,
        }
    }

    /// A picture that was made of others, with the metadata of one of them.
    pub(super) fn of_parts(
        digest: Digest,
        pixmap: Pixmap,
        metadata: Arc<Metadata>,
        grey: bool,
    ) -> Self {
        Self {
            digest,
            source: Arc::new(Source::new(pixmap)),
            occupied: Arc::default(),
            metadata,
            repairs: Repairs::default(),
            grey,
        }
    }

    /// The metadata of the file.
    pub(super) const fn metadata(&self) -> &Arc<Metadata> {
        &self.metadata
    }

    /// What an output has of the file's metadata.
    pub(super) fn carried(&self, target: &Target) -> Carried {
        target.carried(&self.metadata, self.extent())
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

    /// The alpha of a row of pixels, up to [`FULL_WEIGHT`](crate::render::FULL_WEIGHT).
    pub(super) fn alpha_of_row(&self, y: u32, alpha: &mut Vec<u16>) {
        alpha.clear();
        for_each_pixel(self.source.pixmap(), y, |pixel| alpha.push(pixel[3]));
    }

    /// Whether the picture has an alpha channel.
    #[must_use]
    pub fn has_alpha(&self) -> bool {
        self.source.pixmap().channels() == Channels::Rgba
    }

    /// Upper bound of the memory of the picture, all sampling copies included, bytes: its weight in
    /// a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let pixmap = self.source.pixmap();
        used_bytes(pixmap.extent(), pixmap.channels(), pixmap.depth())
            + self.metadata.bytes() as u64
    }
}

/// Upper bound of the memory of a picture of this shape with all that is derived from it, bytes.
fn used_bytes(extent: Extent, channels: Channels, depth: Depth) -> u64 {
    Source::bytes(extent, channels, depth).saturating_add(8 * occupied_words(extent) as u64)
}
