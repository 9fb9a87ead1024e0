//! Cells that overlap, drawn in another order than row by row.

use std::ops::Range;

use super::Drawing;
use crate::geometry::DrawingOrder;
use crate::render::cell;
use crate::render::kernel::Raster;
use crate::render::snapped_grid::BLOCK_COLUMNS;

/// Cells after which the uncovered pixels are counted again.
const CELLS_PER_LOOK: usize = 64;
/// Ranks whose bits are in one number.
const RANKS: usize = u64::BITS as usize;

impl Drawing {
    /// Draws the columns of cells whose bits are set, each in the rows whose bits are set, from the
    /// last cell back and into uncovered pixels only. What is drawn by crossings overlaps nothing,
    /// so that no order shows there. Memory: a bit for each cell of the grid, which is a small part
    /// of what a posed vertex takes.
    pub(super) fn draw_in_order(
        &self,
        order: &DrawingOrder,
        strip: &Range<u32>,
        (blocks, rows): (&[u8], &[u32]),
        raster: &mut Raster<'_>,
        cancelled: &dyn Fn() -> bool,
    ) {
        let across = self.lattice.columns - 1;
        let mut ranks = vec![0_u64; order.cells().len().div_ceil(RANKS)];
        for j in self.lattice.rows_touching(strip) {
            if cancelled() {
                return;
            }
            for (b, block) in blocks.iter().enumerate() {
                if *block == 0 || !self.lattice.block_touches(j, b, strip) {
                    continue;
                }
                for k in (0..BLOCK_COLUMNS).filter(|k| block >> k & 1 != 0) {
                    let rank = order.rank(j * across + b * BLOCK_COLUMNS + k) as usize;
                    ranks[rank / RANKS] |= 1 << (rank % RANKS);
                }
            }
        }
        let mut drawn = 0;
        for (first, mut ranks) in ranks.into_iter().enumerate().rev() {
            while ranks != 0 {
                let last = ranks.ilog2() as usize;
                ranks ^= 1 << last;
                if drawn % CELLS_PER_LOOK == 0 {
                    raster.shrink();
                    if raster.open == 0 || cancelled() {
                        return;
                    }
                }
                drawn += 1;
                let cell = order.cells()[first * RANKS + last] as usize;
                let (i, j) = (cell % across, cell / across);
                cell::draw_cell(self.kernel, &self.lattice, (i, j), rows[i], raster);
            }
        }
        raster.shrink();
    }
}
