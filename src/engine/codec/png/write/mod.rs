//! The PNG writer: encodes an image as a head, independent strips and a tail (PNG 3rd edition).
//!
//! A strip is one IDAT chunk of whole deflate blocks that ends on a byte; its first row is filtered
//! without the row above, so strips can be encoded in any order and on any thread, and are sent in
//! order. The first strip begins with the zlib header; the tail ends the stream with the Adler-32
//! of all rows, combined from those of the strips. The bytes depend on the samples, the shape and
//! the compression alone. Shapes: samples `[rows][width][1 to 4]`, 16-bit ones big-endian.

#[forbid(unsafe_code)]
mod adler;
#[forbid(unsafe_code)]
mod animation;
#[forbid(unsafe_code)]
mod best;
#[forbid(unsafe_code)]
mod block;
#[forbid(unsafe_code)]
mod chunk;
#[forbid(unsafe_code)]
mod coder;
#[forbid(unsafe_code)]
mod fast;
mod kernel;
#[forbid(unsafe_code)]
mod layout;
#[forbid(unsafe_code)]
mod rows;
#[forbid(unsafe_code)]
mod stored;
#[cfg(test)]
#[expect(
    clippy::cast_possible_truncation,
    reason = "made-up samples are cut to their width on purpose"
)]
mod tests;

use std::ops::Range;
use std::sync::Arc;

use crate::codec::{Carried, Compression, Palette, PixelLayout};
use crate::level::SimdLevel;

pub use self::animation::Animation;
use self::layout::Layout;
use self::rows::StripRows;

/// A window of 32 KiB and no dictionary; the two bytes make a multiple of 31 (RFC 1950).
const ZLIB_HEADER: [u8; 2] = [0x78, 0x01];

/// Bytes of the tail: the checksum as an IDAT of its own, and IEND.
const TAIL_BYTES: u64 = 2 * chunk::CHUNK_OVERHEAD_BYTES as u64 + 4;

/// One encoded strip: complete PNG chunks, and the input of [`PngWriter::tail`].
#[derive(Debug, Clone)]
pub struct Strip {
    /// The bytes to send.
    pub bytes: Vec<u8>,
    /// Adler-32 of the filtered rows.
    pub adler: u32,
    /// Length of the filtered rows, bytes.
    pub filtered_len: u64,
}

/// A colour profile, and the PNG chunk that carries it, compressed once for all images.
#[derive(Debug, Clone)]
pub struct Profile {
    icc: Arc<[u8]>,
    chunk: Arc<[u8]>,
}

impl Profile {
    /// Compresses a profile. CPU work, 0.1 ms and more.
    #[must_use]
    pub fn new(icc: &[u8]) -> Self {
        Self {
            icc: icc.into(),
            chunk: chunk::profile(icc).into(),
        }
    }

    /// The profile as read.
    #[must_use]
    pub fn icc(&self) -> &[u8] {
        &self.icc
    }

    /// Whether it is for grey.
    #[must_use]
    pub fn is_grey(&self) -> bool {
        self.icc.get(16..20) == Some(b"GRAY")
    }

    /// Memory held, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.icc.len() + self.chunk.len()
    }
}

/// Input of [`PngWriter::tail`]: the Adler-32 and the length of a strip's filtered rows.
pub type StripChecksum = (u32, u64);

/// Writes one PNG in independent strips: `head`, every strip in order, `tail`. Cheap to create and
/// to clone.
#[derive(Debug, Clone)]
pub struct PngWriter {
    compression: Compression,
    level: SimdLevel,
    bpp: usize,
    layout: Layout,
    head: Arc<[u8]>,
}

impl PngWriter {
    /// A writer for one image. The strip layout depends on the shape and the compression alone.
    ///
    /// # Panics
    /// If a row is longer than 1 GiB.
    #[must_use]
    pub fn new(shape: PixelLayout, compression: Compression, metadata: Option<&Carried>) -> Self {
        Self::of_labels(shape, compression, None, metadata)
    }

    /// A writer for a label image; one sample per pixel if there is a palette.
    ///
    /// # Panics
    /// Like [`Self::new`].
    #[must_use]
    pub fn of_labels(
        shape: PixelLayout,
        compression: Compression,
        palette: Option<&Palette>,
        metadata: Option<&Carried>,
    ) -> Self {
        Self {
            compression,
            level: SimdLevel::detect(),
            bpp: layout::pixel_bytes(shape),
            layout: Layout::new(shape, compression),
            head: chunk::head(shape, metadata, palette).into(),
        }
    }

    /// Sets the level, which changes the speed but not the bytes; scalar if the machine lacks it.
    #[must_use]
    pub const fn with_level(mut self, level: SimdLevel) -> Self {
        self.level = level;
        self
    }

    /// Number of strips.
    #[must_use]
    pub const fn strips(&self) -> usize {
        self.layout.strips() as usize
    }

    /// Rows of a strip.
    ///
    /// # Panics
    /// If there is no such strip.
    #[must_use]
    pub fn rows(&self, strip: usize) -> Range<u32> {
        self.layout
            .rows(u32::try_from(strip).expect("strips are counted in u32"))
    }

    /// Upper bound of the whole file, bytes, whatever the samples.
    #[must_use]
    pub fn max_bytes(&self) -> u64 {
        self.head.len() as u64 + self.layout.max_bytes() + TAIL_BYTES
    }

    /// Signature, IHDR, metadata, and the palette.
    #[must_use]
    pub fn head(&self) -> Vec<u8> {
        self.head.to_vec()
    }

    /// Encodes one strip. `samples: [rows][width][PixelLayout::samples]`, PNG order (16-bit
    /// big-endian).
    ///
    /// # Panics
    /// If there is no such strip or the samples are not its rows.
    #[must_use]
    pub fn strip(&self, index: usize, samples: &[u8]) -> Strip {
        let mut bytes = Vec::new();
        let (adler, filtered_len) = self.strip_into(index, samples, &mut bytes);
        Strip {
            bytes,
            adler,
            filtered_len,
        }
    }

    /// Like [`Self::strip`], appended to `out`.
    ///
    /// # Panics
    /// Like [`Self::strip`].
    pub fn strip_into(&self, index: usize, samples: &[u8], out: &mut Vec<u8>) -> StripChecksum {
        self.strip_while(index, samples, out, &|| true)
    }

    /// Like [`Self::strip_into`]. With `Compression::Best`, which takes long, it stops when
    /// `wanted` returns false; the output is then incomplete.
    pub(crate) fn strip_while(
        &self,
        index: usize,
        samples: &[u8],
        out: &mut Vec<u8>,
        wanted: &dyn Fn() -> bool,
    ) -> StripChecksum {
        let rows = StripRows::new(samples, self.layout.row_bytes(), self.bpp);
        assert_eq!(
            rows.count(),
            self.rows(index).len(),
            "samples are the rows of strip {index}"
        );
        let last = index + 1 == self.strips();
        let chunk = chunk::open(out, *b"IDAT");
        if index == 0 {
            out.extend_from_slice(&ZLIB_HEADER);
        }
        let adler = match self.compression {
            Compression::None => stored::encode(rows, last, out),
            Compression::Fast => kernel::encode_fast(self.level, rows, last, out),
            Compression::Best => best::encode(rows, last, out, wanted),
        };
        chunk.close(out);
        (adler, rows.filtered_len() as u64)
    }

    /// The bytes after the last strip: the checksum of all strips (`(adler, filtered_len)` of each
    /// in order) and IEND.
    #[must_use]
    pub fn tail(&self, checksums: &[StripChecksum]) -> Vec<u8> {
        let adler = checksums
            .iter()
            .fold(adler::EMPTY_CHECKSUM, |sum, &(adler, len)| {
                adler::combine(sum, adler, len)
            });
        let mut out = Vec::new();
        chunk::write(&mut out, *b"IDAT", &adler.to_be_bytes());
        chunk::write(&mut out, *b"IEND", &[]);
        out
    }
}
