//! A label image in memory: numbers instead of colours.

use std::sync::{Arc, OnceLock};

#[cfg(feature = "codec")]
use super::Limits;
use super::digest::Collector;
use super::{Digest, WarpError};
#[cfg(feature = "codec")]
use crate::codec::{self, Metadata, Opened, StepCounter};
#[cfg(feature = "codec")]
use crate::deform::IsCancelled;
use crate::format::Repairs;
use crate::pixmap::{Channels, Depth, Extent, Labels, PixelLayout, extent_of};

/// An upright label image. Its labels are those of a file (indices of a palette, grey values of up
/// to 16 bit, or whole colours), or numbers of 8, 16 or 32 bit.
#[derive(Debug)]
pub struct LabelImage {
    /// Of the file, or of the labels when it is needed.
    digest: OnceLock<Digest>,
    pub(super) labels: Arc<Labels>,
    #[cfg(feature = "codec")]
    pub(super) metadata: Arc<Metadata>,
    /// What of the file was mended.
    pub(super) repairs: Repairs,
}

/// Reads files.
#[cfg(feature = "codec")]
impl LabelImage {
    /// Upper bound of the memory for decoding a file opened by [`codec::open_labels`], bytes.
    #[must_use]
    pub fn peak_bytes(opened: &Opened<'_>) -> u64 {
        opened.label_bytes()
    }

    /// Decodes a file within limits. CPU work; do not call it on async threads. Stops when
    /// `cancelled` returns true.
    ///
    /// # Errors
    /// See [`codec::CodecError`]; cancelled.
    pub fn decode(
        file: &[u8],
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let steps = StepCounter::new(cancelled);
        let opened = codec::open_labels(file, &limits.image, &steps)?;
        Self::decode_as(Digest::of(file), &opened)
    }

    /// Like [`Self::decode`], for a file opened by [`codec::open_labels`] whose digest is known.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode_as(digest: Digest, opened: &Opened<'_>) -> Result<Self, WarpError> {
        let decoded = opened.decode_labels()?;
        Ok(Self {
            metadata: Arc::new(decoded.metadata),
            repairs: decoded.repairs,
            ..Self::new(OnceLock::from(digest), decoded.labels)
        })
    }
}

impl LabelImage {
    fn new(digest: OnceLock<Digest>, labels: Labels) -> Self {
        Self {
            digest,
            labels: Arc::new(labels),
            #[cfg(feature = "codec")]
            metadata: Arc::default(),
            repairs: Repairs::default(),
        }
    }

    /// Labels that no file has.
    #[cfg(test)]
    pub(super) fn of(labels: Labels) -> Self {
        Self::new(OnceLock::from(Digest::of(&labels.values)), labels)
    }

    /// Labels of 8 bit, row by row.
    ///
    /// # Errors
    /// Another number of labels than that of the pixels.
    ///
    /// ```
    /// use mlswarp::LabelImage;
    /// assert!(LabelImage::from_labels8(2, 2, &[0, 1, 1, 0]).is_ok());
    /// assert!(LabelImage::from_labels8(2, 2, &[0, 1, 1]).is_err());
    /// ```
    pub fn from_labels8(width: u32, height: u32, labels: &[u8]) -> Result<Self, WarpError> {
        let extent = extent_of(width, height, labels.len())?;
        let layout = grey(extent, Depth::Eight);
        Ok(Self::of_values(layout, labels.to_vec(), false))
    }

    /// Labels of 16 bit, row by row.
    ///
    /// # Errors
    /// Another number of labels than that of the pixels.
    pub fn from_labels16(width: u32, height: u32, labels: &[u16]) -> Result<Self, WarpError> {
        let extent = extent_of(width, height, labels.len())?;
        let values = labels.iter().flat_map(|label| label.to_be_bytes());
        let layout = grey(extent, Depth::Sixteen);
        Ok(Self::of_values(layout, values.collect(), false))
    }

    /// Labels of 32 bit, row by row. They are warped to labels of 32 bit; no file format that is
    /// written here stores them.
    ///
    /// # Errors
    /// Another number of labels than that of the pixels.
    pub fn from_labels32(width: u32, height: u32, labels: &[u32]) -> Result<Self, WarpError> {
        let extent = extent_of(width, height, labels.len())?;
        // Four bytes that are never mixed: drawn like one pixel of four samples.
        let layout = PixelLayout {
            channels: Channels::Rgba,
            grey: false,
            ..grey(extent, Depth::Eight)
        };
        let values = labels.iter().flat_map(|label| label.to_be_bytes());
        Ok(Self::of_values(layout, values.collect(), true))
    }

    fn of_values(shape: PixelLayout, values: Vec<u8>, is_32_bit: bool) -> Self {
        let labels = Labels {
            shape,
            palette: None,
            values,
            is_32_bit,
        };
        Self::new(OnceLock::new(), labels)
    }

    /// The digest of the file; of labels in memory, that of their size and values, which is
    /// computed when it is asked for first.
    #[must_use]
    pub fn digest(&self) -> Digest {
        *self.digest.get_or_init(|| {
            let Labels {
                shape,
                values,
                is_32_bit,
                palette: _,
            } = &*self.labels;
            Collector::new("mlswarp label values 1")
                .integer(shape.extent.width().into())
                .integer(shape.pixel_bytes() as u64)
                .integer((*is_32_bit).into())
                .bytes(values)
                .finish()
        })
    }

    /// What of the file was mended.
    #[must_use]
    pub const fn repairs(&self) -> Repairs {
        self.repairs
    }

    /// Upright size.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.labels.shape.extent
    }

    /// Memory of the labels, bytes: their weight in a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let used = self.labels.shape.sample_bytes();
        #[cfg(feature = "codec")]
        let used = used + self.metadata.bytes() as u64;
        used
    }
}

const fn grey(extent: Extent, depth: Depth) -> PixelLayout {
    PixelLayout {
        extent,
        channels: Channels::Rgb,
        grey: true,
        depth,
    }
}
