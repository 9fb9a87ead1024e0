//! Reads GIF (89a): walks the blocks for the frames; the `image` crate decodes one frame onto its screen. Pixels that the frame does not
//! cover, or marks, are transparent. Cost: RGBA, of which an opaque picture drops the alpha.

use image::ImageDecoder as _;
use image::codecs::gif::GifDecoder;

use super::alloc::zeros;
use super::work::{Pieces, StepCounter};
use super::{CodecError, SourceFormat};
use crate::pixmap::{Channels, Extent, Samples};

/// A GIF whose blocks have been walked.
#[derive(Debug)]
pub(super) struct GifFile<'a> {
    bytes: &'a [u8],
    pub(super) extent: Extent,
    transparency: bool,
    /// Whether the frame is as large as the screen.
    covered: bool,
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(SourceFormat::Gif.name(), detail)
}

fn cut_off() -> CodecError {
    bad("it is cut off before its end")
}

/// Bytes of the colour table that follows.
fn table(flags: u8) -> usize {
    if flags & 0x80 == 0 { 0 } else { 6 << (flags & 7) }
}

/// The end of a run of sub-blocks.
fn skip(bytes: &[u8], mut at: usize, work: &StepCounter<'_>) -> Result<usize, CodecError> {
    loop {
        work.step(1)?;
        let length = *bytes.get(at).ok_or_else(cut_off)?;
        at += 1 + usize::from(length);
        if length == 0 {
            return Ok(at);
        }
    }
}

impl<'a> GifFile<'a> {
    pub(super) fn parse(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        let screen: [u8; 13] = *bytes.first_chunk().ok_or_else(cut_off)?;
        let short = |low: u8, high: u8| u32::from(u16::from_le_bytes([low, high]));
        let (width, height) = (short(screen[6], screen[7]), short(screen[8], screen[9]));
        let extent = Extent::new(width, height).ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        let (mut frames, mut transparency, mut covered) = (0_u64, false, false);
        let mut next_is_transparent = false;
        let mut at = 13 + table(screen[10]);
        loop {
            match *bytes.get(at).ok_or_else(cut_off)? {
                0x21 => {
                    let label = *bytes.get(at + 1).ok_or_else(cut_off)?;
                    // The graphic control of the next frame.
                    if label == 0xF9 {
                        next_is_transparent = bytes.get(at + 3).is_some_and(|flags| flags & 1 == 1);
                    }
                    at = skip(bytes, at + 2, work)?;
                }
                0x2C => {
                    frames += 1;
                    transparency = std::mem::take(&mut next_is_transparent);
                    let [_, x0, x1, y0, y1, w0, w1, h0, h1, flags] = *bytes[at..].first_chunk::<10>().ok_or_else(cut_off)?;
                    let (x, y, w, h) = (short(x0, x1), short(y0, y1), short(w0, w1), short(h0, h1));
                    if w == 0 || h == 0 || x + w > width || y + h > height {
                        return Err(bad(format!("a frame of {w} x {h} pixels at {x}, {y} of {width} x {height}")));
                    }
                    covered = (w, h) == (width, height);
                    // The colour table, and the width of the first code.
                    at = skip(bytes, at + 10 + table(flags) + 1, work)?;
                }
                0x3B => break,
                block => return Err(bad(format!("an unknown block {block:#04x}"))),
            }
        }
        match frames {
            0 => Err(bad("no frame")),
            1 => Ok(Self { bytes, extent, transparency, covered }),
            _ => Err(CodecError::TooLarge { what: "image_frames", limit: 1, actual: frames }),
        }
    }

    pub(super) const fn channels(&self) -> Channels {
        if self.transparency || !self.covered { Channels::Rgba } else { Channels::Rgb }
    }

    /// Memory beside the picture: the alpha that is dropped, and a frame that is smaller than the screen.
    pub(super) fn decoder_bytes(&self) -> u64 {
        (512 << 10) + self.extent.pixels() * if self.covered { 4 } else { 5 }
    }

    pub(super) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let decoder = GifDecoder::new(Pieces::new(self.bytes, work)).map_err(bad)?;
        if decoder.dimensions() != (self.extent.width(), self.extent.height()) {
            return Err(bad("two headers that disagree"));
        }
        let mut rgba = zeros::<u8>(4 * self.extent.pixels(), work)?;
        decoder.read_image(&mut rgba).map_err(bad)?;
        if self.channels() == Channels::Rgb {
            let mut index = 0;
            rgba.retain(|_| {
                index += 1;
                index % 4 != 0
            });
            rgba.shrink_to_fit();
        }
        Ok(Samples::Eight(rgba))
    }
}
