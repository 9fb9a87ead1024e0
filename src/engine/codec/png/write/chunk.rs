//! PNG chunks: length, type, payload, CRC-32 of type and payload (PNG 3rd edition, section 5.3),
//! and the chunks of the head. A chunk is opened in its output buffer, so payloads are never moved.
//! CRC: one pass, about 0.02 ms per megabyte.

use std::io::Write;

use crate::pixmap::{Channels, Depth};

use super::{PixelLayout, Profile};
use crate::codec::{Carried, Palette};

/// The eight bytes every PNG begins with.
pub(super) const SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// Bytes of a chunk without its payload.
pub(super) const CHUNK_OVERHEAD_BYTES: usize = 12;

/// A chunk whose payload is being appended.
#[derive(Debug)]
#[must_use = "a chunk must be closed"]
pub(super) struct OpenChunk {
    start: usize,
}

/// Begins a chunk at the end of `out`.
pub(super) fn open(out: &mut Vec<u8>, kind: [u8; 4]) -> OpenChunk {
    let start = out.len();
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(&kind);
    OpenChunk { start }
}

impl OpenChunk {
    /// Index of the payload's first byte.
    pub(super) const fn payload(&self) -> usize {
        self.start + 8
    }

    /// Fills in the length and appends the checksum.
    pub(super) fn close(self, out: &mut Vec<u8>) {
        let length =
            u32::try_from(out.len() - self.payload()).expect("Layout keeps chunks below 2^31");
        out[self.start..self.start + 4].copy_from_slice(&length.to_be_bytes());
        let crc = crc32fast::hash(&out[self.start + 4..]);
        out.extend_from_slice(&crc.to_be_bytes());
    }
}

/// Appends a whole chunk.
pub(super) fn write(out: &mut Vec<u8>, kind: [u8; 4], payload: &[u8]) {
    let chunk = open(out, kind);
    out.extend_from_slice(payload);
    chunk.close(out);
}

/// Signature, IHDR, the chunks of colour, PLTE and tRNS when there is a palette, and the other
/// metadata.
pub(super) fn head(
    shape: PixelLayout,
    metadata: Option<&Carried>,
    palette: Option<&Palette>,
) -> Vec<u8> {
    let mut out = SIGNATURE.to_vec();
    let mut header = Vec::with_capacity(13);
    header.extend_from_slice(&shape.extent.width().to_be_bytes());
    header.extend_from_slice(&shape.extent.height().to_be_bytes());
    header.push(match shape.depth {
        Depth::Eight => 8,
        Depth::Sixteen => 16,
    });
    header.push(match (shape.channels, shape.grey) {
        (Channels::Rgb, true) if palette.is_some() => 3,
        (Channels::Rgb, true) => 0,
        (Channels::Rgb, false) => 2,
        (Channels::Rgba, true) => 4,
        (Channels::Rgba, false) => 6,
    });
    // Deflate, the five filters, no interlacing.
    header.extend_from_slice(&[0, 0, 0]);
    write(&mut out, *b"IHDR", &header);
    if let Some(metadata) = metadata {
        let (profile, others) = metadata.chunks_of_colour(shape.grey && palette.is_none());
        if let Some(Profile { chunk, .. }) = profile {
            out.extend_from_slice(chunk);
        }
        others
            .iter()
            .for_each(|(kind, data)| write(&mut out, *kind, data));
    }
    if let Some(Palette { colours, alpha }) = palette {
        write(&mut out, *b"PLTE", colours.as_flattened());
        if !alpha.is_empty() {
            write(&mut out, *b"tRNS", alpha);
        }
    }
    for (kind, data) in metadata.map_or_else(Vec::new, Carried::chunks) {
        write(&mut out, kind, &data);
    }
    out
}

/// iCCP: a name and its terminator, the method (deflate), and the compressed profile.
pub(super) fn profile(icc: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let chunk = open(&mut out, *b"iCCP");
    out.extend_from_slice(b"ICC profile\0\0");
    let mut zlib = flate2::write::ZlibEncoder::new(&mut out, flate2::Compression::default());
    zlib.write_all(icc).expect("a Vec takes every write");
    zlib.finish().expect("a Vec takes every write");
    chunk.close(&mut out);
    out
}
