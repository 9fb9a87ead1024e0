//! What the encoder of a format answers. `write.rs` has the table from encodings to encoders, and
//! nothing else asks which one it has.

use std::fmt;
use std::ops::Range;

use super::png::write::StripChecksum;
use super::{Carried, JpegWriter, PngWriter};
use crate::pixmap::{PixelLayout, sample_bytes};

/// Encodes one image: a head, strips in any order, a tail.
pub(super) trait FormatEncoder: Send + Sync {
    /// Number of strips.
    fn strips(&self) -> usize;

    /// Rows of a strip.
    ///
    /// # Panics
    /// If there is no such strip.
    fn rows(&self, strip: usize) -> Range<u32>;

    /// Upper bound of the whole file, bytes, whatever the samples.
    fn max_bytes(&self) -> u64;

    /// Upper bound of the memory for writing, the file included, bytes.
    fn work_bytes(&self) -> u64;

    /// The bytes before the first strip.
    fn head(&self) -> Vec<u8>;

    /// Encodes one strip and appends it. `samples: [rows][width][PixelLayout::samples]`, of 8 bit
    /// if the format has no more, otherwise of the depth of the image, 16-bit ones big-endian.
    /// During long strips `wanted` is called from time to time, and encoding stops when it returns
    /// false; the output is then incomplete.
    ///
    /// # Panics
    /// If there is no such strip or the samples are not its rows.
    fn strip_into(
        &self,
        index: usize,
        samples: &[u8],
        out: &mut Vec<u8>,
        wanted: &dyn Fn() -> bool,
    ) -> StripChecksum;

    /// The bytes after the last strip. `checksums`: what each strip has returned, in order.
    fn tail(&self, checksums: &[StripChecksum]) -> Vec<u8>;
}

impl FormatEncoder for PngWriter {
    fn strips(&self) -> usize {
        self.strips()
    }

    fn rows(&self, strip: usize) -> Range<u32> {
        self.rows(strip)
    }

    fn max_bytes(&self) -> u64 {
        self.max_bytes()
    }

    fn work_bytes(&self) -> u64 {
        self.max_bytes()
    }

    fn head(&self) -> Vec<u8> {
        self.head()
    }

    fn strip_into(
        &self,
        index: usize,
        samples: &[u8],
        out: &mut Vec<u8>,
        wanted: &dyn Fn() -> bool,
    ) -> StripChecksum {
        self.strip_while(index, samples, out, wanted)
    }

    fn tail(&self, checksums: &[StripChecksum]) -> Vec<u8> {
        self.tail(checksums)
    }
}

impl FormatEncoder for JpegWriter {
    fn strips(&self) -> usize {
        self.strips()
    }

    fn rows(&self, strip: usize) -> Range<u32> {
        self.rows(strip)
    }

    fn max_bytes(&self) -> u64 {
        self.max_bytes()
    }

    fn work_bytes(&self) -> u64 {
        self.work_bytes()
    }

    fn head(&self) -> Vec<u8> {
        self.head().to_vec()
    }

    fn strip_into(
        &self,
        index: usize,
        samples: &[u8],
        out: &mut Vec<u8>,
        wanted: &dyn Fn() -> bool,
    ) -> StripChecksum {
        self.strip_into(index, samples, out, wanted);
        StripChecksum::default()
    }

    fn tail(&self, _checksums: &[StripChecksum]) -> Vec<u8> {
        Self::tail().to_vec()
    }
}

/// Encodes the files of a format that is written as one strip.
pub(super) struct OneStrip<W> {
    layout: PixelLayout,
    /// Upper bound of the metadata in the file, bytes.
    metadata_bytes: u64,
    /// Memory of tables beside the samples and the file, bytes.
    table_bytes: u64,
    /// Appends the file.
    write: W,
}

impl<W> OneStrip<W> {
    pub(super) fn new(layout: PixelLayout, metadata: Option<&Carried>, write: W) -> Self {
        Self {
            layout,
            metadata_bytes: metadata.map_or(0, Carried::most_bytes),
            table_bytes: 0,
            write,
        }
    }

    /// With tables of this number of bytes beside the samples and the file.
    pub(super) fn with_tables(self, table_bytes: u64) -> Self {
        Self {
            table_bytes,
            ..self
        }
    }
}

impl fmt::Debug for dyn FormatEncoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FormatEncoder")
    }
}

impl<W> FormatEncoder for OneStrip<W>
where
    W: Fn(&[u8], &mut Vec<u8>, &dyn Fn() -> bool) + Send + Sync,
{
    fn strips(&self) -> usize {
        1
    }

    fn rows(&self, _strip: usize) -> Range<u32> {
        0..self.layout.extent.height()
    }

    fn max_bytes(&self) -> u64 {
        /// Markers and tables.
        const FRAME: u64 = 64 << 10;
        /// A sample of WebP takes less.
        const SAMPLE: u64 = 8;
        let samples = self.layout.extent.pixels() * self.layout.channels.count() as u64;
        samples * SAMPLE + self.metadata_bytes + FRAME
    }

    /// The file is no larger than the samples, because even noise compresses a little.
    fn work_bytes(&self) -> u64 {
        /// Multiples of the samples: themselves, a copy without alpha or in 8 bit, the encoder's
        /// buffers, the file.
        const COPIES: u64 = 4;
        let PixelLayout {
            extent,
            channels,
            depth,
            ..
        } = self.layout;
        self.table_bytes + sample_bytes(extent, channels, depth) * COPIES + 2 * self.metadata_bytes
    }

    fn head(&self) -> Vec<u8> {
        Vec::new()
    }

    fn strip_into(
        &self,
        _index: usize,
        samples: &[u8],
        out: &mut Vec<u8>,
        wanted: &dyn Fn() -> bool,
    ) -> StripChecksum {
        (self.write)(samples, out, wanted);
        StripChecksum::default()
    }

    fn tail(&self, _checksums: &[StripChecksum]) -> Vec<u8> {
        Vec::new()
    }
}
