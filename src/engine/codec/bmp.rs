//! Reads BMP through the `image` crate: 1 to 32 bit, palettes and runs included. The header states
//! resolution and colour (versions 4 and 5: sRGB, a calibrated colour space, or a profile).

use std::borrow::Cow;

use image::codecs::bmp::BmpDecoder;
use image::{ColorType, ImageDecoder as _, ImageError};

use super::alloc::{room, sample_count, zeros};
use super::metadata::{Found, Resolution, ResolutionUnit};
use super::profile::{MAX_ICC, keep_profile};
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

#[expect(clippy::wildcard_enum_match_arm, reason = "an enum of another crate")]
fn refused(error: ImageError) -> CodecError {
    match error {
        ImageError::Unsupported(_) => {
            CodecError::unsupported("a BMP of another kind than 1 to 32 bit, with or without runs")
        }
        ImageError::IoError(_) => bad("it is cut off before its end"),
        _ => bad("its header or its pixels are damaged"),
    }
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(SourceFormat::Bmp.name(), detail)
}

impl<'a> BmpFile<'a> {
    pub(super) fn parse(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        work.step(1)?;
        let wanted = |error| {
            if work.is_cancelled() {
                CodecError::Cancelled
            } else {
                refused(error)
            }
        };
        let decoder = BmpDecoder::new(Pieces::new(bytes, work)).map_err(wanted)?;
        let (width, height) = decoder.dimensions();
        let extent = Extent::new(width, height)
            .ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        #[expect(clippy::wildcard_enum_match_arm, reason = "an enum of another crate")]
        let channels = match decoder.color_type() {
            ColorType::Rgb8 => Channels::Rgb,
            ColorType::Rgba8 => Channels::Rgba,
            _ => {
                return Err(CodecError::unsupported(
                    "a BMP of other samples than 8 bit RGB or RGBA",
                ));
            }
        };
        Ok(Self {
            bytes,
            extent,
            channels,
            indexed: None,
        })
    }

    /// The number at a place of the file, 0 behind its end.
    fn long(&self, at: usize) -> u32 {
        self.bytes
            .get(at..at + 4)
            .and_then(|bytes| bytes.try_into().ok())
            .map_or(0, u32::from_le_bytes)
    }

    /// The number that names the colour space of a header of version 4 or 5.
    fn colour_space(&self) -> Option<[u8; 4]> {
        (self.long(14) >= 108).then(|| self.long(70).to_be_bytes())
    }

    pub(super) fn found(&self) -> Found<'a> {
        let resolution = Resolution::whole(self.long(38), self.long(42), ResolutionUnit::Metre)
            .filter(|_| self.long(14) >= 40);
        let colour_dropped = match self.colour_space().as_ref() {
            // Calibrated, if the end points or the gammas are stated.
            Some([0, 0, 0, 0]) => (74..122).step_by(4).any(|at| self.long(at) != 0),
            // A profile in another file.
            Some(b"LINK") => true,
            _ => false,
        };
        Found {
            resolution,
            colour_dropped,
            ..Found::default()
        }
    }

    pub(super) fn has_profile(&self) -> bool {
        self.colour_space() == Some(*b"MBED") && self.long(14) >= 124
    }

    pub(super) fn icc(&self) -> Option<Vec<u8>> {
        if !self.has_profile() {
            return None;
        }
        let (at, length) = (14 + self.long(126) as usize, self.long(130) as usize);
        let profile = self
            .bytes
            .get(at..at.checked_add(length)?)
            .filter(|profile| profile.len() <= MAX_ICC)?;
        keep_profile(profile.to_vec(), false)
    }

    /// From now on, a palette's indices are read instead of its colours.
    pub(super) fn read_labels(&mut self) {
        // The size of the header, bits per pixel, and colours.
        let (size, bits, used) = (self.long(14), self.long(28) & 0xFFFF, self.long(46));
        if size >= 40 && matches!(bits, 1 | 2 | 4 | 8) && self.channels == Channels::Rgb {
            self.indexed = Some(if used == 0 {
                1 << bits
            } else {
                used.min(256) as usize
            });
        }
    }

    /// The file; for indices, with a palette in which every colour is its own index, three times.
    fn file(&self) -> Result<Cow<'a, [u8]>, CodecError> {
        let Some(colours) = self.indexed else {
            return Ok(Cow::Borrowed(self.bytes));
        };
        let mut file = room(self.bytes.len() as u64)?;
        file.extend_from_slice(self.bytes);
        let palette = file
            .get_mut(14 + self.long(14) as usize..)
            .unwrap_or_default();
        for (index, colour) in (0..=u8::MAX)
            .zip(palette.as_chunks_mut::<4>().0)
            .take(colours)
        {
            *colour = [index, index, index, 0];
        }
        Ok(Cow::Owned(file))
    }

    pub(super) const fn is_indexed(&self) -> bool {
        self.indexed.is_some()
    }

    pub(super) fn label_palette(
        &self,
        work: &StepCounter<'_>,
    ) -> Result<Option<Palette>, CodecError> {
        let Some(length) = self.indexed else {
            return Ok(None);
        };
        let decoder = BmpDecoder::new(Pieces::new(self.bytes, work)).map_err(refused)?;
        Ok(decoder.get_palette().map(|colours| Palette {
            colours: colours.iter().copied().take(length).collect(),
            alpha: Vec::new(),
        }))
    }

    pub(super) const fn channels(&self) -> Channels {
        self.channels
    }

    /// Memory beside the image: a row or two.
    pub(super) fn decoder_bytes(&self) -> u64 {
        (512 << 10)
            + 8 * u64::from(self.extent.width())
            + if self.is_indexed() {
                self.bytes.len() as u64
            } else {
                0
            }
    }

    pub(super) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let decoder = BmpDecoder::new(Pieces::new(self.file()?, work)).map_err(refused)?;
        let mut out = zeros::<u8>(sample_count(self.extent.pixels(), self.channels), work)?;
        decoder.read_image(&mut out).map_err(refused)?;
        Ok(Samples::Eight(out))
    }
}
