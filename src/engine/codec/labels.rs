//! Label images: files whose samples are numbers instead of colours. They are read as they are
//! stored: indices of a palette stay indices, grey of 1, 2 and 4 bit keeps its numbers in 8 bit,
//! and colours stay whole. Transparency beside the samples (a PNG's tRNS chunk) and colour profiles
//! are not applied.

use super::alloc::room;
use super::decode::{Decoded, Opened, open_any};
use super::metadata::METADATA_BYTES;
use super::probe::Parsed;
use super::profile::PROFILE_BYTES;
use super::{CodecError, ImageLimits, Metadata, Repairs, StepCounter};
use crate::pixmap::{Labels, Palette, PixelLayout, Samples};

/// An upright label image, and what its file says about it.
#[derive(Debug)]
pub struct DecodedLabels {
    /// The labels.
    pub labels: Labels,
    /// What is written back.
    pub metadata: Metadata,
    /// What of the file was mended.
    pub repairs: Repairs,
}

/// Reads the header of a label image; as [`super::open`].
///
/// # Errors
/// Those of [`super::open`].
pub fn open_labels<'a>(
    bytes: &'a [u8],
    limits: &ImageLimits,
    work: &'a StepCounter<'a>,
) -> Result<Opened<'a>, CodecError> {
    let mut opened = open_any(bytes, limits, work)?;
    opened.parsed.read_labels();
    opened.header = opened.parsed.header();
    Ok(opened)
}

impl Parsed<'_> {
    /// From now on, samples are read as they are stored.
    fn read_labels(&mut self) {
        match self {
            Self::Png(file) => file.labels = true,
            Self::Tiff(file) => file.labels = true,
            Self::Bmp(file) => file.read_labels(),
            Self::Jpeg(_) | Self::WebP(_) | Self::Gif(_) => {}
        }
    }

    fn palette(&self, work: &StepCounter<'_>) -> Result<Option<Palette>, CodecError> {
        match self {
            Self::Png(file) => file.label_palette(),
            Self::Tiff(file) => Ok(file.label_palette()),
            Self::Bmp(file) => file.label_palette(work),
            Self::Jpeg(_) | Self::WebP(_) | Self::Gif(_) => Ok(None),
        }
    }
}

impl Opened<'_> {
    /// Upper bound of the memory for decoding labels, bytes.
    #[must_use]
    pub fn label_bytes(&self) -> u64 {
        let metadata = PROFILE_BYTES + METADATA_BYTES;
        self.header
            .decode_bytes
            .saturating_add(self.label_shape().sample_bytes())
            .saturating_add(metadata)
    }

    /// The shape of a label image.
    const fn label_shape(&self) -> PixelLayout {
        let header = self.header;
        PixelLayout {
            extent: header.extent,
            channels: header.channels,
            grey: header.grey,
            depth: header.depth,
        }
    }

    /// Decodes a label image that was opened as one.
    ///
    /// # Errors
    /// Those of [`Opened::decode`].
    pub fn decode_labels(&self) -> Result<DecodedLabels, CodecError> {
        let palette = self.parsed.palette(self.work)?;
        let Decoded {
            pixmap,
            metadata,
            repairs,
        } = self.decode()?;
        let shape = self.label_shape();
        let mut values = room(shape.sample_bytes())?;
        // The first of three equal colours, and alpha.
        let kept: &[usize] = match (shape.channels.count(), shape.samples()) {
            (3, 1) => &[0],
            (4, 2) => &[0, 3],
            (3, _) => &[0, 1, 2],
            _ => &[0, 1, 2, 3],
        };
        match pixmap.samples() {
            Samples::Eight(samples) => self.keep(samples, kept, &mut values, |sample| [sample])?,
            Samples::Sixteen(samples) => self.keep(samples, kept, &mut values, u16::to_be_bytes)?,
        }
        Ok(DecodedLabels {
            labels: Labels {
                shape,
                palette,
                values,
                is_32_bit: false,
            },
            metadata,
            repairs,
        })
    }

    /// Appends these samples of each pixel as bytes.
    fn keep<S: Copy, const BYTES: usize>(
        &self,
        samples: &[S],
        kept: &[usize],
        values: &mut Vec<u8>,
        to_bytes: impl Fn(S) -> [u8; BYTES],
    ) -> Result<(), CodecError> {
        let header = self.header;
        for row in samples.chunks_exact(header.extent.width() as usize * header.channels.count()) {
            self.work.step(header.extent.width().into())?;
            for pixel in row.chunks_exact(header.channels.count()) {
                kept.iter()
                    .for_each(|index| values.extend_from_slice(&to_bytes(pixel[*index])));
            }
        }
        Ok(())
    }
}
