//! Reads BMP through the `image` crate: 1 to 32 bit, palettes and runs included.

use image::codecs::bmp::BmpDecoder;
use image::{ColorType, ImageDecoder as _, ImageError};

use super::alloc::{sample_count, zeros};
use super::work::{Pieces, StepCounter};
use super::{CodecError, SourceFormat};
use crate::pixmap::{Channels, Extent, Samples};

/// A BMP whose header has been read.
#[derive(Debug)]
pub(super) struct BmpFile<'a> {
    bytes: &'a [u8],
    pub(super) extent: Extent,
    channels: Channels,
}

fn refused(error: ImageError) -> CodecError {
    match error {
        ImageError::Unsupported(kind) => CodecError::unsupported(format!("a BMP of another kind: {kind}")),
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
        Ok(Self { bytes, extent, channels })
    }

    pub(super) const fn channels(&self) -> Channels {
        self.channels
    }

    /// Memory beside the picture: a row or two.
    pub(super) fn decoder_bytes(&self) -> u64 {
        (512 << 10) + 8 * u64::from(self.extent.width())
    }

    pub(super) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let decoder = BmpDecoder::new(Pieces::new(self.bytes, work)).map_err(refused)?;
        let mut out = zeros::<u8>(sample_count(self.extent.pixels(), self.channels), work)?;
        decoder.read_image(&mut out).map_err(refused)?;
        Ok(Samples::Eight(out))
    }
}
