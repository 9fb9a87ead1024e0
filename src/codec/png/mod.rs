//! STUB: the PNG writer.

use std::ops::Range;

use crate::pixmap::{Channels, Depth, Extent};

/// How hard to squeeze.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Compression {
    /// Stored.
    None,
    /// The drag's encoder: filter and Huffman coding, no match search.
    #[default]
    Fast,
    /// Smallest.
    Best,
}

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PngShape {
    /// Size.
    pub extent: Extent,
    /// RGB or RGBA.
    pub channels: Channels,
    /// 8 or 16 bit.
    pub depth: Depth,
}

/// One encoded strip: complete PNG chunks, and what the trailer needs to know of it.
#[derive(Debug, Clone)]
pub struct Strip {
    /// The bytes to send.
    pub bytes: Vec<u8>,
    /// Adler-32 of the filtered rows.
    pub adler: u32,
    /// Length of the filtered rows, bytes.
    pub filtered_len: u64,
}

/// Writes one PNG in strips that are independent of each other: `head`, every strip in order, `tail`.
#[derive(Debug, Clone)]
pub struct PngWriter {
    shape: PngShape,
}

impl PngWriter {
    /// A writer for one picture. The strip layout depends on the shape and the compression alone.
    #[must_use]
    pub fn new(shape: PngShape, _compression: Compression, _icc: Option<&[u8]>) -> Self {
        Self { shape }
    }

    /// Number of strips.
    #[must_use]
    pub fn strips(&self) -> usize {
        1
    }

    /// Rows of a strip.
    #[must_use]
    pub fn rows(&self, _strip: usize) -> Range<u32> {
        0..self.shape.extent.height()
    }

    /// Signature, IHDR, and the colour profile.
    #[must_use]
    pub fn head(&self) -> Vec<u8> {
        todo!()
    }

    /// Encodes one strip. `samples: [rows][width][channels]`, PNG order (16-bit big-endian).
    #[must_use]
    pub fn strip(&self, _index: usize, _samples: &[u8]) -> Strip {
        todo!()
    }

    /// No more than this many bytes come out, head and tail included.
    #[must_use]
    pub fn max_bytes(&self) -> u64 {
        todo!()
    }

    /// What follows the last strip: the checksum of all (given `(adler, filtered_len)` of every strip in order) and IEND.
    #[must_use]
    pub fn tail(&self, _checksums: &[(u32, u64)]) -> Vec<u8> {
        todo!()
    }
}
