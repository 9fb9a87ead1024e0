//! Reads BMP through the `image` crate: 1 to 32 bit, palettes and runs included.

use std::borrow::Cow;

use image::codecs::bmp::BmpDecoder;
use image::error::UnsupportedErrorKind;
use image::{ColorType, ImageDecoder as _, ImageError};

use super::alloc::{room, sample_count, zeros};
use super::work::{Pieces, StepCounter};
use super::{CodecError, Palette, SourceFormat};
use crate::pixmap::{Channels, Extent, Samples};

/// A BMP whose header has been read.
#[derive(Debug)]
pub(super) struct BmpFile<'a> {
    bytes: &'a [u8],
    pub(super) extent: Extent,
    channels: Channels,
    /// The number of colours, if the palette's indices are read.
    indexed: Option<usize>,
}

fn refused(error: ImageError) -> CodecError {
    match error {
        ImageError::Unsupported(error) => match error.kind() {
            UnsupportedErrorKind::GenericFeature(feature) => CodecError::unsupported(format!("a BMP of another kind: {feature}")),
            _ => CodecError::unsupported(format!("a BMP of another kind: {error}")),
        },
        error => CodecError::bad(SourceFormat::Bmp.name(), error),
    }
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(SourceFormat::Bmp.name(), detail)
}

impl<'a> BmpFile<'a> {
    pub(super) fn parse(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        work.step(1)?;
        let wanted = |error| if work.is_cancelled() { CodecError::Cancelled } else { refused(error) };
        let decoder = BmpDecoder::new(Pieces::new(bytes, work)).map_err(wanted)?;
        let (width, height) = decoder.dimensions();
        let extent = Extent::new(width, height).ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        let channels = match decoder.color_type() {
            ColorType::Rgb8 => Channels::Rgb,
            ColorType::Rgba8 => Channels::Rgba,
            kind => return Err(CodecError::unsupported(format!("a BMP of {kind:?}"))),
        };
        Ok(Self { bytes, extent, channels, indexed: None })
    }

    /// From now on, a palette's indices are read instead of its colours.
    pub(super) fn read_labels(&mut self) {
        let long = |at: usize| self.bytes.get(at..at + 4).and_then(|bytes| bytes.try_into().ok()).map_or(0, u32::from_le_bytes);
        // The size of the header, bits per pixel, and colours.
        let (size, bits, used) = (long(14), long(28) & 0xFFFF, long(46));
        if size >= 40 && matches!(bits, 1 | 2 | 4 | 8) && self.channels == Channels::Rgb {
            self.indexed = Some(if used == 0 { 1 << bits } else { used.min(256) as usize });
        }
    }

    /// The file; for indices, with a palette in which every colour is its own index, three times.
    fn file(&self) -> Result<Cow<'a, [u8]>, CodecError> {
        let Some(colours) = self.indexed else { return Ok(Cow::Borrowed(self.bytes)) };
        let mut file = room(self.bytes.len() as u64)?;
        file.extend_from_slice(self.bytes);
        let size = self.bytes.get(14..18).and_then(|size| size.try_into().ok()).map_or(0, u32::from_le_bytes) as usize;
        let palette = file.get_mut(14 + size..).unwrap_or_default();
        for (index, colour) in (0..=u8::MAX).zip(palette.as_chunks_mut::<4>().0).take(colours) {
            *colour = [index, index, index, 0];
        }
        Ok(Cow::Owned(file))
    }

    pub(super) const fn is_indexed(&self) -> bool {
        self.indexed.is_some()
    }

    pub(super) fn label_palette(&self, work: &StepCounter<'_>) -> Result<Option<Palette>, CodecError> {
        let Some(length) = self.indexed else { return Ok(None) };
        let decoder = BmpDecoder::new(Pieces::new(self.bytes, work)).map_err(refused)?;
        Ok(decoder.get_palette().map(|colours| Palette { colours: colours.iter().copied().take(length).collect(), alpha: Vec::new() }))
    }

    pub(super) const fn channels(&self) -> Channels {
        self.channels
    }

    /// Memory beside the picture: a row or two.
    pub(super) fn decoder_bytes(&self) -> u64 {
        (512 << 10) + 8 * u64::from(self.extent.width()) + if self.is_indexed() { self.bytes.len() as u64 } else { 0 }
    }

    pub(super) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let decoder = BmpDecoder::new(Pieces::new(self.file()?, work)).map_err(refused)?;
        let mut out = zeros::<u8>(sample_count(self.extent.pixels(), self.channels), work)?;
        decoder.read_image(&mut out).map_err(refused)?;
        Ok(Samples::Eight(out))
    }
}
