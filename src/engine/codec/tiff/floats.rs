//! Writes TIFF (6.0) of 32-bit floating-point samples, not compressed, piece by piece: a head, rows
//! from the top, and a tail with the directory, all of whose values are known before the first row.

use crate::codec::Carried;
use crate::codec::ifd::write::{DirectoryWriter, TYPE_SHORT};
use crate::pixmap::Extent;

/// Bytes before the first row.
const HEADER_BYTES: u64 = 8;
const FLOAT_BYTES: u64 = 4;

/// A file of floating-point samples, big-endian.
#[derive(Clone, Copy, Debug)]
pub struct FloatTiff {
    extent: Extent,
    samples: u16,
    rows: u32,
}

impl FloatTiff {
    /// Rows of this number of samples a pixel in strips of `rows`; `None` if the file would need
    /// offsets of more than 32 bits.
    #[must_use]
    pub fn new(extent: Extent, samples: u16, rows: u32) -> Option<Self> {
        /// The directory and its values, beside two offsets of a strip.
        const DIRECTORY: u64 = 1024;
        let this = Self {
            extent,
            samples,
            rows,
        };
        let strips = u64::from(extent.height().div_ceil(rows));
        (HEADER_BYTES + this.data_bytes() + 8 * strips + DIRECTORY <= u64::from(u32::MAX))
            .then_some(this)
    }

    const fn row_bytes(&self) -> u64 {
        self.extent.width() as u64 * self.samples as u64 * FLOAT_BYTES
    }

    const fn data_bytes(&self) -> u64 {
        self.row_bytes() * self.extent.height() as u64
    }

    /// The bytes before the first row.
    ///
    /// # Panics
    /// Never: the size was checked.
    #[must_use]
    pub fn head(&self) -> Vec<u8> {
        let directory = self.directory();
        let at = u32::try_from(directory.0).expect("checked");
        [b"MM\0*", at.to_be_bytes().as_slice()].concat()
    }

    /// The bytes after the last row.
    #[must_use]
    pub fn tail(&self) -> Vec<u8> {
        self.directory().1
    }

    /// Where the directory begins, and the bytes that follow the rows.
    fn directory(&self) -> (u64, Vec<u8>) {
        let number = |value: u64| u32::try_from(value).expect("the size was checked");
        let (rows, strip) = (
            u64::from(self.rows),
            self.row_bytes() * u64::from(self.rows),
        );
        let strips: Vec<u64> = (0..u64::from(self.extent.height()).div_ceil(rows)).collect();
        let offsets: Vec<u32> = strips
            .iter()
            .map(|k| number(HEADER_BYTES + k * strip))
            .collect();
        let lengths: Vec<u32> = strips
            .iter()
            .map(|k| number(strip.min(self.data_bytes() - k * strip)))
            .collect();
        let each = |value: u16| value.to_be_bytes().repeat(self.samples.into());
        let mut out = Vec::new();
        let mut directory = DirectoryWriter::after(
            &mut out,
            usize::try_from(HEADER_BYTES + self.data_bytes()).expect("an offset of 32 bits"),
        );
        directory.longs(256, &[self.extent.width()]);
        directory.longs(257, &[self.extent.height()]);
        directory.entry(258, TYPE_SHORT, self.samples.into(), &each(32));
        // Not compressed; 0 is black.
        directory.short(259, 1);
        directory.short(262, 1);
        directory.longs(273, &offsets);
        directory.short(277, self.samples);
        directory.longs(278, &[self.rows.min(self.extent.height())]);
        directory.longs(279, &lengths);
        if let more @ 1.. = self.samples - 1 {
            // Samples beyond the first mean nothing to a viewer.
            directory.entry(
                338,
                TYPE_SHORT,
                more.into(),
                &0_u16.to_be_bytes().repeat(more.into()),
            );
        }
        Carried::put_resolution(None, &mut directory);
        // IEEE numbers.
        directory.entry(339, TYPE_SHORT, self.samples.into(), &each(3));
        let at = directory.finish();
        (at as u64, out)
    }
}
