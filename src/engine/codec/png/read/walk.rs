//! Walks the chunks of a PNG: which of them its pixels need, what the others say, and what is
//! wrong.

use std::borrow::Cow;

use super::{PngFile, cut_off, wrong_checksum};
use crate::codec::metadata::{DroppedKind, Resolution, ResolutionUnit, png_colour};
use crate::codec::{CodecError, StepCounter};

/// The keyword of XMP, and those of metadata in texts of hexadecimal digits.
const XMP: &[u8] = b"XML:com.adobe.xmp\0";
const RAW_PROFILE: &[u8] = b"Raw profile type ";

/// A whole chunk.
pub(super) struct Chunk<'a> {
    pub(super) kind: [u8; 4],
    pub(super) data: &'a [u8],
    pub(super) end: usize,
    /// Type and data, and their checksum.
    summed: &'a [u8],
    sum: u32,
}

impl Chunk<'_> {
    pub(super) fn is_intact(&self, work: &StepCounter<'_>) -> Result<bool, CodecError> {
        const PIECE: usize = 1 << 20;
        let mut crc = crc32fast::Hasher::new();
        for piece in self.summed.chunks(PIECE) {
            crc.update(piece);
            if piece.len() == PIECE {
                work.check()?;
            }
        }
        Ok(crc.finalize() == self.sum)
    }
}

/// The chunk at `at`, if it is complete.
pub(super) fn chunk_at(bytes: &[u8], at: usize) -> Option<Chunk<'_>> {
    let head = bytes.get(at..at.checked_add(8)?)?;
    let length = u32::from_be_bytes(head[..4].try_into().ok()?);
    let data_end = (at + 8).checked_add(usize::try_from(length).ok()?)?;
    let end = data_end.checked_add(4)?;
    let kind = head[4..].try_into().ok()?;
    let sum = u32::from_be_bytes(bytes.get(data_end..end)?.try_into().ok()?);
    Some(Chunk {
        kind,
        data: &bytes[at + 8..data_end],
        end,
        summed: &bytes[at + 4..data_end],
        sum,
    })
}

impl<'a> PngFile<'a> {
    pub(super) fn walk(&mut self, mut at: usize, work: &StepCounter<'_>) -> Result<(), CodecError> {
        let mut before_data = true;
        while let Some(chunk) = chunk_at(self.bytes, at) {
            work.step(1)?;
            let is_data = &chunk.kind == b"IDAT";
            if !is_data && !chunk.is_intact(work)? {
                if before_data && self.may_be_needed(chunk.kind) {
                    return Err(wrong_checksum(chunk.kind));
                }
                self.repairs.checksum = true;
                self.is_copied = true;
                if &chunk.kind == b"IEND" {
                    break;
                }
                at = chunk.end;
                self.end = at;
                continue;
            }
            at = chunk.end;
            self.end = at;
            match &chunk.kind {
                b"IDAT" => {
                    before_data = false;
                    self.idat_bytes += chunk.data.len() as u64;
                    self.idat_chunks += 1;
                }
                b"tRNS" if before_data => {
                    self.transparency = matches!(self.colour, 0 | 2 | 3);
                    self.alpha = chunk.data;
                }
                b"PLTE" if before_data && self.palette.is_none() => self.palette = Some(chunk.data),
                b"iCCP" if before_data && self.profile.is_none() => self.profile = Some(chunk.data),
                b"acTL" => {
                    self.is_copied = true;
                    let frames = chunk
                        .data
                        .first_chunk()
                        .map_or(0, |n| u64::from(u32::from_be_bytes(*n)));
                    if before_data && frames > 1 {
                        return Err(CodecError::TooLarge {
                            what: "image_frames",
                            limit: 1,
                            actual: frames,
                        });
                    }
                }
                b"fcTL" | b"fdAT" => self.is_copied = true,
                b"IEND" if chunk.data.is_empty() => return Ok(()),
                b"IEND" => break,
                _ => self.find(&chunk, before_data),
            }
        }
        self.repairs.end = true;
        self.is_copied = true;
        // The end of the data may be all that is missing.
        if let Some((head, data)) = self
            .bytes
            .get(at..)
            .and_then(|rest| rest.split_first_chunk::<8>())
            && head.ends_with(b"IDAT")
        {
            let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
            self.rest = &data[..data.len().min(length)];
            self.idat_bytes += self.rest.len() as u64;
            self.idat_chunks += 1;
        }
        if self.idat_chunks == 0 {
            Err(cut_off())
        } else {
            Ok(())
        }
    }

    /// Whether pixels may need a damaged chunk: the damage may be in its type or in the length of
    /// the one before.
    fn may_be_needed(&self, kind: [u8; 4]) -> bool {
        let is_like =
            |needed: &[u8; 4]| kind.iter().zip(needed).filter(|(a, b)| a == b).count() >= 3;
        let is_type = kind.iter().all(u8::is_ascii_alphabetic);
        !is_type
            || is_like(b"IDAT")
            || self.colour == 3 && is_like(b"PLTE")
            || matches!(self.colour, 0 | 2 | 3) && is_like(b"tRNS")
    }

    /// Looks at a chunk that no pixel needs.
    fn find(&mut self, chunk: &Chunk<'a>, before_data: bool) {
        let Self { found, bits, .. } = self;
        let (kind, data) = (chunk.kind, chunk.data);
        match &kind {
            // The second edition's extensions allow it behind the data too.
            b"eXIf" if found.exif.is_none() => found.exif = Some(data),
            b"pHYs" if before_data => {
                if let &[x0, x1, x2, x3, y0, y1, y2, y3, unit] = data {
                    let unit = if unit == 1 {
                        ResolutionUnit::Metre
                    } else {
                        ResolutionUnit::Unknown
                    };
                    let [x, y] = [[x0, x1, x2, x3], [y0, y1, y2, y3]].map(u32::from_be_bytes);
                    found.resolution = Resolution::whole(x, y, unit);
                }
            }
            b"iTXt" if data.starts_with(XMP) && found.xmp.is_none() => {
                found.xmp = Some(Cow::Borrowed(&data[XMP.len()..]))
            }
            b"tEXt" | b"zTXt" | b"iTXt" if data.starts_with(RAW_PROFILE) => {
                found.dropped.add(DroppedKind::Text)
            }
            b"tEXt" | b"zTXt" | b"iTXt" => found.add_text(kind, data),
            b"sBIT" => found.dropped.add_if(
                data.iter().any(|significant| significant < bits),
                DroppedKind::SignificantBits,
            ),
            b"sCAL" | b"pCAL" => found.dropped.add(DroppedKind::Calibration),
            b"caBX" => found.dropped.add(DroppedKind::Credentials),
            // They describe the stored file: its time, background, colours, data, virtual page,
            // signature.
            b"tIME" | b"bKGD" | b"hIST" | b"sPLT" | b"iDOT" | b"CgBI" | b"vpAg" | b"orNT"
            | b"gIFg" | b"gIFx" | b"dSIG" | b"tRNS" | b"PLTE" | b"iCCP" | b"eXIf" | b"pHYs" => {}
            _ => match png_colour::length_of(kind) {
                Some(length) if before_data && length == data.len() => {
                    if found.colour.iter().all(|(name, _)| *name != kind) {
                        found.colour.push((kind, data));
                    }
                }
                Some(_) => found.colour_dropped = true,
                None => found.dropped.add(DroppedKind::Application),
            },
        }
    }
}
