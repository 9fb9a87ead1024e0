//! The strips and tiles of a TIFF: their size, where they are, and whether the file can hold them.

use super::data::Compression;
use super::read::TiffFile;
use crate::codec::ifd::read::{Directory, Values, bad, cut_off};
use crate::codec::{CodecError, StepCounter};
use crate::pixmap::Extent;

/// Additional width of a tile beyond twice the picture's, and height of one of JPEG, which is decoded as a whole.
const FREE_TILE: u64 = 4096;

/// Strips or tiles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parts<'a> {
    pub(super) width: u32,
    pub(super) height: u32,
    offsets: Values<'a>,
    lengths: Values<'a>,
}

impl<'a> Parts<'a> {
    pub(super) fn of(page: &Directory<'a>, extent: Extent, compression: Compression, work: &StepCounter<'_>) -> Result<Self, CodecError> {
        let tiles = page.values(324, work)?;
        let ((width, height), offsets, lengths) = match tiles {
            Some(offsets) => {
                let side = |tag| page.number(tag, 0, work);
                ((side(322)?, side(323)?), Some(offsets), page.values(325, work)?)
            }
            None => {
                let rows = page.number(278, u32::MAX, work)?.min(extent.height());
                ((extent.width(), rows), page.values(273, work)?, page.values(279, work)?)
            }
        };
        let (Some(offsets), Some(lengths)) = (offsets, lengths) else { return Err(bad("no strips or tiles")) };
        let is_long = |side: u32, whole: u32| u64::from(side) > 2 * u64::from(whole) + FREE_TILE;
        let is_too_high = compression == Compression::Jpeg && is_long(height, extent.height());
        if width == 0 || height == 0 || is_long(width, extent.width()) || is_too_high {
            return Err(bad(format!("strips or tiles of {width} x {height} pixels")));
        }
        Ok(Self { width, height, offsets, lengths })
    }

    /// The length of the longest one, bytes, as far as the file has it.
    pub(super) fn longest(&self, work: &StepCounter<'_>) -> Result<u64, CodecError> {
        work.step(self.lengths.len() as u64)?;
        Ok((0..self.lengths.len()).filter_map(|index| self.lengths.get(index)).max().unwrap_or(0))
    }
}

impl<'a> TiffFile<'a> {
    /// Strips or tiles in a row and in a column.
    pub(super) const fn grid(&self) -> (u32, u32) {
        (self.extent.width().div_ceil(self.parts.width), self.extent.height().div_ceil(self.parts.height))
    }

    /// Strips or tiles of a plane.
    pub(super) fn parts_of_plane(&self) -> u64 {
        let (across, down) = self.grid();
        u64::from(across) * u64::from(down)
    }

    /// The data of a strip or tile.
    pub(super) fn data(&self, index: usize) -> Result<&'a [u8], CodecError> {
        let range = self.parts.offsets.get(index).zip(self.parts.lengths.get(index)).ok_or_else(|| bad("too few strips or tiles"))?;
        let (at, length) = (usize::try_from(range.0).ok(), usize::try_from(range.1).ok());
        let range = at.zip(length).and_then(|(at, length)| Some(at..at.checked_add(length)?));
        range.and_then(|range| self.file.bytes.get(range)).ok_or_else(cut_off)
    }

    /// Checks that the parts are there, that they can hold the picture, and that they are not the same bytes again and again, so that
    /// the work is in proportion to the file and the picture.
    pub(super) fn weigh_data(&self, work: &StepCounter<'_>) -> Result<(), CodecError> {
        let parts = self.parts_of_plane() * self.planes() as u64;
        if parts > self.parts.offsets.len() as u64 {
            return Err(bad("too few strips or tiles"));
        }
        let mut total = 0;
        for index in 0..usize::try_from(parts).unwrap_or(usize::MAX) {
            work.step(1)?;
            total += self.data(index)?.len() as u64;
        }
        if total > self.file.bytes.len() as u64 {
            return Err(bad("strips or tiles that overlap"));
        }
        let row = (u64::from(self.extent.width()) * self.stored as u64 * u64::from(self.bits)).div_ceil(8);
        if total.saturating_mul(self.compression.expansion()) < row * u64::from(self.extent.height()) {
            return Err(bad(format!("{total} bytes of data cannot hold the picture")));
        }
        Ok(())
    }
}
