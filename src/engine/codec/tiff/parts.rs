//! The strips and tiles of a TIFF: their size, and where they are.

use super::data::TiffCompression;
use crate::codec::ifd::read::{Directory, Values, bad};
use crate::codec::{CodecError, StepCounter};
use crate::pixmap::Extent;

/// Additional width of a tile beyond twice the image's, and height of one of JPEG, which is
/// decoded as a whole.
const FREE_TILE: u64 = 4096;

/// Strips or tiles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parts<'a> {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) offsets: Values<'a>,
    pub(super) lengths: Values<'a>,
}

impl<'a> Parts<'a> {
    pub(super) fn of(
        page: &Directory<'a>,
        extent: Extent,
        compression: TiffCompression,
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let tiles = page.values(324, work)?;
        let ((width, height), offsets, lengths) = match tiles {
            Some(offsets) => {
                let side = |tag| page.number(tag, 0, work);
                (
                    (side(322)?, side(323)?),
                    Some(offsets),
                    page.values(325, work)?,
                )
            }
            None => {
                let rows = page.number(278, u32::MAX, work)?.min(extent.height());
                (
                    (extent.width(), rows),
                    page.values(273, work)?,
                    page.values(279, work)?,
                )
            }
        };
        let (Some(offsets), Some(lengths)) = (offsets, lengths) else {
            return Err(bad("no strips or tiles"));
        };
        let is_long = |side: u32, whole: u32| u64::from(side) > 2 * u64::from(whole) + FREE_TILE;
        let is_too_high = compression == TiffCompression::Jpeg && is_long(height, extent.height());
        if width == 0 || height == 0 || is_long(width, extent.width()) || is_too_high {
            return Err(bad(format!("strips or tiles of {width} x {height} pixels")));
        }
        Ok(Self {
            width,
            height,
            offsets,
            lengths,
        })
    }

    /// The length of the longest one, bytes, as far as the file has it.
    pub(super) fn longest(&self, work: &StepCounter<'_>) -> Result<u64, CodecError> {
        work.step(self.lengths.len() as u64)?;
        Ok((0..self.lengths.len())
            .filter_map(|index| self.lengths.get(index))
            .max()
            .unwrap_or(0))
    }
}
