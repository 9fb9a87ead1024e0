//! Reads GIF (89a): walks the blocks for the frames; the `gif` crate decodes the indices of one frame, some rows at a time. Pixels that the
//! frame does not cover, or marks, are transparent.

use gif::DecodeOptions;

use crate::codec::alloc::{sample_count, zeros};
use crate::codec::work::{Pieces, StepCounter};
use crate::codec::{CodecError, Format};
use crate::pixmap::{Channels, Extent, Samples};

/// A GIF whose blocks have been walked.
#[derive(Debug)]
pub(in crate::codec) struct GifFile<'a> {
    bytes: &'a [u8],
    pub(in crate::codec) extent: Extent,
    transparency: bool,
    /// Whether the frame is as large as the screen.
    covered: bool,
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::Gif.name(), detail)
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
    pub(in crate::codec) fn parse(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
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

    pub(in crate::codec) const fn channels(&self) -> Channels {
        if self.transparency || !self.covered { Channels::Rgba } else { Channels::Rgb }
    }

    /// Memory beside the picture: the decoder's tables, and rows of indices.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        (512 << 10) + ROWS as u64
    }

    pub(in crate::codec) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let mut decoder = DecodeOptions::new().read_info(Pieces::new(self.bytes, work)).map_err(bad)?;
        let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
        let frame = decoder.next_frame_info().map_err(bad)?.ok_or_else(|| bad("no frame"))?;
        let (left, top, frame_width) = (usize::from(frame.left), usize::from(frame.top), usize::from(frame.width));
        let (rows, transparent) = (frame_rows(usize::from(frame.height), frame.interlaced), frame.transparent);
        if (width, height) != (self.extent.width() as usize, self.extent.height() as usize) || left + frame_width > width {
            return Err(bad("two headers that disagree"));
        }
        let colours = colours(decoder.palette().map_err(bad)?, transparent);
        let count = self.channels().count();
        let mut out = zeros::<u8>(sample_count(self.extent.pixels(), self.channels()), work)?;
        // Several rows at once where they are short.
        let mut indices = vec![0; frame_width * (ROWS / frame_width).max(1)];
        for rows in rows.chunks(indices.len() / frame_width) {
            work.step((rows.len() * frame_width) as u64)?;
            let indices = &mut indices[..rows.len() * frame_width];
            if !decoder.fill_buffer(indices).map_err(bad)? {
                return Err(bad("the frame is cut off"));
            }
            for (row, indices) in rows.iter().zip(indices.chunks_exact(frame_width)) {
                let start = ((top + row) * width + left) * count;
                let line = out.get_mut(start..start + frame_width * count).ok_or_else(|| bad("two headers that disagree"))?;
                for (pixel, index) in line.chunks_exact_mut(count).zip(indices) {
                    pixel.copy_from_slice(&colours[usize::from(*index)][..count]);
                }
            }
        }
        Ok(Samples::Eight(out))
    }
}

/// Indices that are decoded at once, unless a row is longer.
const ROWS: usize = 1 << 16;

/// The rows of a frame in the order in which they are stored.
fn frame_rows(height: usize, interlaced: bool) -> Vec<usize> {
    let passes: &[(usize, usize)] = if interlaced { &[(0, 8), (4, 8), (2, 4), (1, 2)] } else { &[(0, 1)] };
    passes.iter().flat_map(|&(first, step)| (first..height).step_by(step)).collect()
}

/// The colour of each index; those beyond the palette are transparent black.
fn colours(palette: &[u8], transparent: Option<u8>) -> [[u8; 4]; 256] {
    let mut colours = [[0; 4]; 256];
    for (index, (colour, &[r, g, b])) in (0..=u8::MAX).zip(colours.iter_mut().zip(palette.as_chunks::<3>().0)) {
        *colour = [r, g, b, if transparent == Some(index) { 0 } else { u8::MAX }];
    }
    colours
}
