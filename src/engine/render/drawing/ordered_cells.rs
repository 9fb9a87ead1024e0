//! Cells that overlap, drawn in another order than row by row.

use std::cmp::Reverse;
use std::ops::Range;

use super::Drawing;
use crate::geometry::DrawingOrder;
use crate::render::cell;
use crate::render::kernel::Raster;
use crate::render::snapped_grid::BLOCK_COLUMNS;

/// Cells after which the uncovered pixels are counted again.
const CELLS_PER_LOOK: usize = 64;

impl Drawing {
    /// Draws the columns of cells whose bits are set, each in the rows whose bits are set, from the
    /// last cell back and into uncovered pixels only. What is drawn by crossings overlaps nothing,
    /// so that no order shows there.
    pub(super) fn draw_in_order(
        &self,
        order: &DrawingOrder,
        strip: &Range<u32>,
        (blocks, rows): (&[u8], &[u32]),
        raster: &mut Raster<'_>,
    ) {
        let mut cells = Vec::new();
        for j in self.lattice.rows_touching(strip) {
            for (b, block) in blocks.iter().enumerate() {
                if *block == 0 || !self.lattice.block_touches(j, b, strip) {
                    continue;
                }
                let columns = (0..BLOCK_COLUMNS).filter(|k| block >> k & 1 != 0);
                cells.extend(columns.map(|k| {
                    let i = b * BLOCK_COLUMNS + k;
                    (order.rank(j * (self.lattice.columns - 1) + i), i, j)
                }));
            }
        }
        cells.sort_unstable_by_key(|(rank, ..)| Reverse(*rank));
        for (n, (_, i, j)) in cells.into_iter().enumerate() {
            if n % CELLS_PER_LOOK == 0 {
                raster.shrink();
            }
            if raster.open == 0 {
                break;
            }
            cell::draw_cell(self.kernel, &self.lattice, (i, j), rows[i], raster);
        }
        raster.shrink();
    }
}
