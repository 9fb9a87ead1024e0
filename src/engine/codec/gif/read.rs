//! Reads GIF (89a): walks the blocks for the frames; the `gif` crate decodes the indices of one
//! frame, some rows at a time. Pixels that the frame does not cover, or marks, are transparent. A
//! file that ends behind its frame without a trailer is read.

use std::borrow::Cow;
use std::ops::Range;

use gif::DecodeOptions;

use crate::codec::alloc::{room, sample_count, zeros};
use crate::codec::metadata::{
    DroppedKind, Found, METADATA_BYTES, Ratio, Resolution, ResolutionUnit,
};
use crate::codec::profile::{MAX_ICC, keep_profile};
use crate::codec::work::{Pieces, StepCounter};
use crate::codec::{CodecError, Format, Repairs};
use crate::pixmap::{Channels, Extent, Samples};

/// A GIF whose blocks have been walked.
#[derive(Debug)]
pub(in crate::codec) struct GifFile<'a> {
    bytes: &'a [u8],
    pub(in crate::codec) extent: Extent,
    transparency: bool,
    /// Whether the frame is as large as the screen.
    covered: bool,
    pub(in crate::codec) found: Found<'a>,
    /// The sub-blocks of a colour profile.
    profile: Option<Range<usize>>,
    /// Of a file that ends before its trailer.
    open: Option<Truncation>,
    /// Whether there are bytes between its blocks.
    has_gap: bool,
}

/// Where a file is cut off, and what completes it.
#[derive(Clone, Copy, Debug)]
struct Truncation {
    /// The beginning of a block or sub-block that is cut off, or the end of the file.
    at: usize,
    /// Whether the data of a frame have no end.
    in_frame: bool,
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::Gif.name(), detail)
}

fn cut_off() -> CodecError {
    bad("it is cut off before its end")
}

/// Bytes of the colour table that follows.
fn table(flags: u8) -> usize {
    if flags & 0x80 == 0 {
        0
    } else {
        6 << (flags & 7)
    }
}

/// The end of a run of sub-blocks, and whether the run is whole; of one that is not, where its last
/// sub-block begins, or the end.
fn skip(bytes: &[u8], mut at: usize, work: &StepCounter<'_>) -> Result<(usize, bool), CodecError> {
    loop {
        work.step(1)?;
        let Some(length) = bytes.get(at) else {
            return Ok((bytes.len(), false));
        };
        let end = at + 1 + usize::from(*length);
        if *length == 0 {
            return Ok((end, true));
        }
        if end > bytes.len() {
            return Ok((at, false));
        }
        at = end;
    }
}

/// The data of a run of sub-blocks, at most `most` bytes.
fn joined(mut blocks: &[u8], most: u64, work: &StepCounter<'_>) -> Option<Vec<u8>> {
    let mut data = Vec::new();
    while let Some((&length @ 1.., rest)) = blocks.split_first() {
        work.step(1).ok()?;
        let (block, rest) = rest.split_at_checked(length.into())?;
        data.extend_from_slice(block);
        if data.len() as u64 > most {
            return None;
        }
        blocks = rest;
    }
    Some(data)
}

impl<'a> GifFile<'a> {
    pub(in crate::codec) fn parse(
        bytes: &'a [u8],
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let screen: [u8; 13] = *bytes.first_chunk().ok_or_else(cut_off)?;
        let short = |low: u8, high: u8| u32::from(u16::from_le_bytes([low, high]));
        let (width, height) = (short(screen[6], screen[7]), short(screen[8], screen[9]));
        let extent = Extent::new(width, height)
            .ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        let (mut frames, mut transparency, mut covered) = (0_u64, false, false);
        let (mut found, mut profile) = (
            Found {
                resolution: shape_of(screen[12]),
                ..Found::default()
            },
            None,
        );
        let (mut open, mut has_gap) = (None, false);
        let mut next_is_transparent = false;
        let mut at = 13 + table(screen[10]);
        loop {
            match bytes.get(at) {
                Some(0x21) => {
                    let label = bytes.get(at + 1).copied().unwrap_or_default();
                    // The graphic control of the next frame.
                    if label == 0xF9 {
                        next_is_transparent = bytes.get(at + 3).is_some_and(|flags| flags & 1 == 1);
                    }
                    let blocks = at + 2;
                    let (end, is_whole) = skip(bytes, blocks.min(bytes.len()), work)?;
                    if is_whole {
                        find(label, (bytes, blocks..end), &mut found, &mut profile, work);
                        at = end;
                    } else {
                        open = Some(Truncation {
                            at,
                            in_frame: false,
                        });
                    }
                }
                Some(0x2C) => {
                    frames += 1;
                    transparency = std::mem::take(&mut next_is_transparent);
                    let [_, x0, x1, y0, y1, w0, w1, h0, h1, flags] =
                        *bytes[at..].first_chunk::<10>().ok_or_else(cut_off)?;
                    let (x, y, w, h) = (short(x0, x1), short(y0, y1), short(w0, w1), short(h0, h1));
                    if w == 0 || h == 0 || x + w > width || y + h > height {
                        return Err(bad(format!(
                            "a frame of {w} x {h} pixels at {x}, {y} of {width} x {height}"
                        )));
                    }
                    covered = (w, h) == (width, height);
                    // The colour table, and the width of the first code.
                    let data = at + 10 + table(flags) + 1;
                    if data > bytes.len() {
                        return Err(cut_off());
                    }
                    let (end, is_whole) = skip(bytes, data, work)?;
                    at = end;
                    open = (!is_whole).then_some(Truncation { at, in_frame: true });
                }
                Some(0x3B) => break,
                Some(0) if frames > 0 => {
                    work.step(1)?;
                    has_gap = true;
                    at += 1;
                }
                Some(block) => return Err(bad(format!("an unknown block {block:#04x}"))),
                None => {
                    open = Some(Truncation {
                        at: bytes.len(),
                        in_frame: false,
                    })
                }
            }
            if open.is_some() {
                // What is missing of a frame shows when it is decoded.
                if frames == 0 {
                    return Err(cut_off());
                }
                break;
            }
        }
        match frames {
            0 => Err(bad("no frame")),
            1 => Ok(Self {
                bytes,
                extent,
                transparency,
                covered,
                found,
                profile,
                open,
                has_gap,
            }),
            _ => Err(CodecError::TooLarge {
                what: "image_frames",
                limit: 1,
                actual: frames,
            }),
        }
    }

    pub(in crate::codec) const fn channels(&self) -> Channels {
        if self.transparency || !self.covered {
            Channels::Rgba
        } else {
            Channels::Rgb
        }
    }

    /// Memory beside the image: the decoder's tables, and rows of indices.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        let copy = if self.open.is_some() {
            self.bytes.len() as u64 + 2
        } else {
            0
        };
        (512 << 10) + DECODED_INDICES as u64 + copy
    }

    /// The file with a trailer.
    fn whole(&self) -> Result<Cow<'a, [u8]>, CodecError> {
        let Some(Truncation { at, in_frame }) = self.open else {
            return Ok(Cow::Borrowed(self.bytes));
        };
        let mut whole = room(self.bytes.len() as u64 + 2)?;
        let (before, rest) = self.bytes.split_at(at.min(self.bytes.len()));
        whole.extend_from_slice(before);
        if let (true, [_, data @ ..]) = (in_frame, rest)
            && !data.is_empty()
        {
            whole.push(u8::try_from(data.len()).unwrap_or(u8::MAX));
            whole.extend_from_slice(data);
        }
        whole.extend_from_slice(if in_frame { &[0, 0x3B] } else { &[0x3B] });
        Ok(Cow::Owned(whole))
    }

    /// What was mended.
    pub(in crate::codec) const fn repairs(&self) -> Repairs {
        Repairs {
            end: self.open.is_some(),
            checksum: false,
            gap: self.has_gap,
        }
    }

    pub(in crate::codec) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let damaged = |_| {
            if self.open.is_some() {
                cut_off()
            } else {
                bad("its pixels are damaged or end too early")
            }
        };
        let mut decoder = DecodeOptions::new()
            .read_info(Pieces::new(self.whole()?, work))
            .map_err(damaged)?;
        let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
        let frame = decoder
            .next_frame_info()
            .map_err(damaged)?
            .ok_or_else(|| bad("no frame"))?;
        let (left, top, frame_width) = (
            usize::from(frame.left),
            usize::from(frame.top),
            usize::from(frame.width),
        );
        let (rows, transparent) = (
            frame_rows(usize::from(frame.height), frame.interlaced),
            frame.transparent,
        );
        if (width, height) != (self.extent.width() as usize, self.extent.height() as usize)
            || left + frame_width > width
        {
            return Err(bad("two headers that disagree"));
        }
        let colours = colours(decoder.palette().map_err(damaged)?, transparent);
        let count = self.channels().count();
        let mut out = zeros::<u8>(sample_count(self.extent.pixels(), self.channels()), work)?;
        // Several rows at once where they are short.
        let mut indices = vec![0; frame_width * (DECODED_INDICES / frame_width).max(1)];
        for rows in rows.chunks(indices.len() / frame_width) {
            work.step((rows.len() * frame_width) as u64)?;
            let indices = &mut indices[..rows.len() * frame_width];
            if !decoder.fill_buffer(indices).map_err(damaged)? {
                return Err(bad("the frame is cut off"));
            }
            for (row, indices) in rows.iter().zip(indices.chunks_exact(frame_width)) {
                let start = ((top + row) * width + left) * count;
                let line = out
                    .get_mut(start..start + frame_width * count)
                    .ok_or_else(|| bad("two headers that disagree"))?;
                for (pixel, index) in line.chunks_exact_mut(count).zip(indices) {
                    pixel.copy_from_slice(&colours[usize::from(*index)][..count]);
                }
            }
        }
        Ok(Samples::Eight(out))
    }

    pub(in crate::codec) const fn has_profile(&self) -> bool {
        self.profile.is_some()
    }

    pub(in crate::codec) fn icc(&self, work: &StepCounter<'_>) -> Option<Vec<u8>> {
        keep_profile(
            joined(&self.bytes[self.profile.clone()?], MAX_ICC as u64, work)?,
            false,
        )
    }
}

/// The shape of a pixel, width to height: (n + 15) / 64.
fn shape_of(byte: u8) -> Option<Resolution> {
    // Resolutions are pixels per unit of length: the wider a pixel, the fewer in a row.
    let across = Ratio::new(64, 1).filter(|_| byte != 0 && byte != 49)?;
    Some(Resolution {
        x: across,
        y: Ratio::new(u32::from(byte) + 15, 1)?,
        unit: ResolutionUnit::Unknown,
    })
}

/// Looks at an extension that no pixel needs: its label, and its sub-blocks.
fn find<'a>(
    label: u8,
    (bytes, blocks): (&'a [u8], Range<usize>),
    found: &mut Found<'a>,
    profile: &mut Option<Range<usize>>,
    work: &StepCounter<'_>,
) {
    let data = &bytes[blocks.clone()];
    // The first sub-block of an application is its name.
    let name = data.get(1..12).unwrap_or_default();
    match (label, name) {
        (0xF9, _) | (0xFF, b"NETSCAPE2.0" | b"ANIMEXTS1.0") => {}
        (0xFE, _) => match joined(data, METADATA_BYTES, work) {
            Some(comment) => found.add_comment(Cow::Owned(comment)),
            None => found.dropped.add(DroppedKind::Comment),
        },
        (0xFF, b"XMP DataXMP") => {
            // The packet is not divided; behind it come bytes that lead any reader of sub-blocks to
            // their end: 1, and then 255 to 0, among which is that of `>`.
            let packet = &data[12..];
            let packet = &packet[..packet
                .windows(2)
                .rposition(|bytes| bytes == [1, 255])
                .unwrap_or(packet.len())];
            let end = packet
                .iter()
                .rposition(|byte| *byte == b'>')
                .map_or(0, |at| at + 1);
            found.xmp = Some(Cow::Borrowed(&packet[..end]));
        }
        (0xFF, b"ICCRGBG1012") => *profile = Some(blocks.start + 12..blocks.end),
        _ => found.dropped.add(DroppedKind::Application),
    }
}

/// Indices that are decoded at once, unless a row is longer.
const DECODED_INDICES: usize = 1 << 16;

/// The rows of a frame in the order in which they are stored.
fn frame_rows(height: usize, interlaced: bool) -> Vec<usize> {
    let passes: &[(usize, usize)] = if interlaced {
        &[(0, 8), (4, 8), (2, 4), (1, 2)]
    } else {
        &[(0, 1)]
    };
    passes
        .iter()
        .flat_map(|&(first, step)| (first..height).step_by(step))
        .collect()
}

/// The colour of each index; those beyond the palette are transparent black.
fn colours(palette: &[u8], transparent: Option<u8>) -> [[u8; 4]; 256] {
    let mut colours = [[0; 4]; 256];
    for (index, (colour, &[r, g, b])) in
        (0..=u8::MAX).zip(colours.iter_mut().zip(palette.as_chunks::<3>().0))
    {
        *colour = [
            r,
            g,
            b,
            if transparent == Some(index) {
                0
            } else {
                u8::MAX
            },
        ];
    }
    colours
}
