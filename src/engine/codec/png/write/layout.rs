//! The division of an image's rows into strips, and the largest size of a strip.
//!
//! The layout depends on shape and compression alone, so an image has the same bytes whatever
//! encodes it. A row is `1 + row_bytes` bytes of the zlib stream (its filter byte and its samples);
//! a strip of `f` such bytes never takes more than the stored form: `f + 5` per deflate block of
//! 65535, the zlib header in the first strip, and the overhead of one chunk.

use std::ops::Range;

use super::{Compression, PixelLayout, chunk, stored};

/// Target size of a strip, filtered bytes. Below, the code table of every strip costs too much (0.1
/// % and 40 us a strip, `notes.md`); above, two threads share a 500 x 500 image unevenly and the
/// first bytes of a large one are late.
const STRIP_BYTES: u64 = 512 << 10;

/// Target size for `Compression::Best`, which resets its window at every strip.
const BEST_STRIP_BYTES: u64 = 1 << 20;

/// Images with fewer filtered bytes are one strip, because sharing the work costs more than it
/// saves.
const ONE_STRIP_BYTES: u64 = 96 << 10;

/// Longest row in bytes: an IDAT chunk, and so a strip of a single row in its stored form, must
/// stay below 2^31.
const MAX_ROW_BYTES: u64 = 1 << 30;

/// Strips of one image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    height: u32,
    strips: u32,
    row_bytes: usize,
}

impl Layout {
    /// # Panics
    /// If a row is longer than 1 GiB.
    pub(super) fn new(shape: PixelLayout, compression: Compression) -> Self {
        let row = u64::from(shape.extent.width()) * pixel_bytes(shape) as u64;
        assert!(
            row <= MAX_ROW_BYTES,
            "a row is at most {MAX_ROW_BYTES} bytes: {row}"
        );
        let row_bytes = usize::try_from(row).expect("MAX_ROW_BYTES fits an address");
        let height = shape.extent.height();
        let filtered = (row + 1) * u64::from(height);
        let aim = match compression {
            Compression::None | Compression::Fast => STRIP_BYTES,
            Compression::Best => BEST_STRIP_BYTES,
        };
        // An even number, so that two threads have equal work.
        let strips = if filtered <= ONE_STRIP_BYTES {
            1
        } else {
            2 * filtered.div_ceil(2 * aim)
        };
        let strips = u32::try_from(strips).map_or(height, |strips| strips.min(height));
        Self {
            height,
            strips,
            row_bytes,
        }
    }

    pub(super) const fn strips(self) -> u32 {
        self.strips
    }

    /// Bytes of a row's samples.
    pub(super) const fn row_bytes(self) -> usize {
        self.row_bytes
    }

    /// Rows of one strip; strips differ by at most one row.
    pub(super) fn rows(self, strip: u32) -> Range<u32> {
        assert!(strip < self.strips, "strip {strip} of {}", self.strips);
        let edge = |k: u32| {
            let row = u64::from(k) * u64::from(self.height) / u64::from(self.strips);
            u32::try_from(row).expect("an edge is at most the height")
        };
        edge(strip)..edge(strip + 1)
    }

    /// Upper bound of all strips together, in bytes.
    pub(super) fn max_bytes(self) -> u64 {
        let (strips, height) = (u64::from(self.strips), u64::from(self.height));
        let taller = height % strips;
        let strip = |rows: u64| {
            let filtered = rows * (self.row_bytes as u64 + 1);
            filtered + stored::overhead(filtered) + chunk::CHUNK_OVERHEAD_BYTES as u64
        };
        super::ZLIB_HEADER.len() as u64
            + taller * strip(height / strips + 1)
            + (strips - taller) * strip(height / strips)
    }
}

/// Bytes per pixel, the distance of the PNG filters: 1, 2, 3, 4, 6 or 8.
pub(super) const fn pixel_bytes(shape: PixelLayout) -> usize {
    shape.samples() * shape.depth.bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixmap::{Channels, Depth, Extent};

    fn layout(width: u32, height: u32, channels: Channels) -> Layout {
        let extent = Extent::new(width, height).unwrap();
        Layout::new(
            PixelLayout {
                extent,
                channels,
                grey: false,
                depth: Depth::Eight,
            },
            Compression::Fast,
        )
    }

    #[test]
    fn strips_partition_the_rows_evenly() {
        for (width, height) in [
            (1, 1),
            (500, 500),
            (1920, 1080),
            (16384, 1),
            (16384, 7),
            (1, 1_000_000),
            (3, 99_991),
        ] {
            let layout = layout(width, height, Channels::Rgba);
            let mut next = 0;
            let (mut low, mut high) = (u32::MAX, 0);
            for strip in 0..layout.strips() {
                let rows = layout.rows(strip);
                assert_eq!(rows.start, next);
                low = low.min(rows.end - rows.start);
                high = high.max(rows.end - rows.start);
                next = rows.end;
            }
            assert_eq!(next, height);
            assert!(
                low > 0 && high - low <= 1,
                "{width} x {height}: {low}..={high}"
            );
        }
    }

    #[test]
    fn strips_are_even_in_number_and_one_when_tiny() {
        assert_eq!(layout(100, 100, Channels::Rgba).strips(), 1);
        for channels in [Channels::Rgb, Channels::Rgba] {
            for (width, height) in [(200, 200), (500, 500), (1920, 1080), (3840, 2160)] {
                assert_eq!(layout(width, height, channels).strips() % 2, 0);
            }
        }
    }
}
