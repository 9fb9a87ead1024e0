//! The compressed data of a strip or tile as a stream. Every stream ends with its data, and
//! cancellation is checked as it is read.

use std::io::{self, BufReader, Read};

use flate2::bufread::ZlibDecoder;
use weezl::{BitOrder, LzwStatus, decode};

use super::fax::Group4;
use crate::codec::work::{Pieces, StepCounter};

/// Bytes that the LZW decoder gets at once.
const LZW_INPUT_BYTES: usize = 1 << 15;

/// How strips and tiles are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TiffCompression {
    None,
    Lzw,
    Deflate,
    PackBits,
    Group4,
    Jpeg,
}

impl TiffCompression {
    pub(super) const fn from_number(number: u32) -> Option<Self> {
        Some(match number {
            1 => Self::None,
            4 => Self::Group4,
            5 => Self::Lzw,
            7 => Self::Jpeg,
            8 | 32_946 => Self::Deflate,
            32_773 => Self::PackBits,
            _ => return None,
        })
    }

    /// The name of a compression that is not read.
    pub(super) fn name_of(number: u32) -> String {
        match number {
            2 | 3 => "the compression CCITT group 3".to_owned(),
            6 => "JPEG compression of the old kind".to_owned(),
            34_712 | 33_003 | 33_005 => "JPEG 2000 compression".to_owned(),
            50_000 => "Zstandard compression".to_owned(),
            50_001 => "WebP compression".to_owned(),
            _ => format!("compression {number}"),
        }
    }

    /// Upper bound of what a byte of data expands to.
    pub(super) const fn expansion(self) -> u64 {
        match self {
            Self::None => 1,
            // Codes of at least 9 bits for strings of at most 4096 bytes.
            Self::Lzw => 4096,
            Self::Deflate => 1032,
            Self::PackBits => 64,
            // A bit for each line, or for some blocks of 64 samples: the lines and blocks are
            // counted as they are decoded.
            Self::Group4 | Self::Jpeg => 1 << 16,
        }
    }

    /// The data of a part `width` pixels wide; `reversed`: whether its bytes begin with their
    /// lowest bit. Not of JPEG.
    pub(super) fn reader<'a>(
        self,
        data: &'a [u8],
        (width, reversed): (u32, bool),
        work: &'a StepCounter<'a>,
    ) -> io::Result<Box<dyn Read + 'a>> {
        let pieces = Pieces::new(data, work);
        Ok(match self {
            Self::Group4 if reversed => Box::new(Group4::new(padded(Reversed(pieces)), width)?),
            Self::Group4 => Box::new(Group4::new(padded(pieces), width)?),
            Self::None if reversed => Box::new(Reversed(pieces)),
            Self::None | Self::Jpeg => Box::new(pieces),
            Self::Deflate => Box::new(ZlibDecoder::new(pieces)),
            Self::Lzw => Box::new(Lzw {
                decoder: decode::Decoder::with_tiff_size_switch(BitOrder::Msb, 8),
                data,
                work,
            }),
            Self::PackBits => Box::new(PackBits {
                pieces,
                literal: 0,
                repeats: 0,
                byte: 0,
            }),
        })
    }
}

/// The code tables look at more bits than a last code has; behind the data they see zeros, which
/// begin no code.
fn padded(data: impl Read) -> impl Iterator<Item = io::Result<u8>> {
    const ZEROS: usize = 4;
    BufReader::new(data)
        .bytes()
        .chain(std::iter::repeat_with(|| Ok(0)).take(ZEROS))
}

/// Bytes with their bits in reverse order.
struct Reversed<R>(R);

impl<R: Read> Read for Reversed<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let read = self.0.read(into)?;
        into[..read]
            .iter_mut()
            .for_each(|byte| *byte = byte.reverse_bits());
        Ok(read)
    }
}

struct Lzw<'a> {
    decoder: decode::Decoder,
    data: &'a [u8],
    work: &'a StepCounter<'a>,
}

impl Read for Lzw<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        loop {
            self.work.check().map_err(io::Error::other)?;
            let piece = &self.data[..self.data.len().min(LZW_INPUT_BYTES)];
            let result = self.decoder.decode_bytes(piece, into);
            self.data = &self.data[result.consumed_in..];
            let status = result.status.map_err(io::Error::other)?;
            if result.consumed_out > 0
                || !matches!(status, LzwStatus::Ok)
                || result.consumed_in == 0
            {
                return Ok(result.consumed_out);
            }
        }
    }
}

/// Runs (TIFF 6.0, section 9).
struct PackBits<R> {
    pieces: R,
    literal: usize,
    repeats: usize,
    byte: u8,
}

impl<R: Read> Read for PackBits<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        while self.literal == 0 && self.repeats == 0 {
            let mut head = [0];
            if self.pieces.read(&mut head)? == 0 {
                return Ok(0);
            }
            match head[0] {
                count @ 0..=127 => self.literal = 1 + usize::from(count),
                128 => {}
                count => {
                    self.repeats = 257 - usize::from(count);
                    let mut byte = [0];
                    self.pieces.read_exact(&mut byte)?;
                    self.byte = byte[0];
                }
            }
        }
        if self.literal > 0 {
            let count = into.len().min(self.literal);
            let read = self.pieces.read(&mut into[..count])?;
            self.literal -= read;
            return Ok(read);
        }
        let count = into.len().min(self.repeats);
        into[..count].fill(self.byte);
        self.repeats -= count;
        Ok(count)
    }
}
