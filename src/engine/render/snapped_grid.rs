//! The posed grid as the rasteriser uses it: vertices snapped to a lattice of 1/256 target px, so
//! that integers compare edges exactly, and the sampler's coordinate of every column and row.
//! Structure of arrays `[rows][pitch]`; the pitch is a multiple of [`BLOCK_COLUMNS`] (the last
//! vertex of a row is repeated). Ranges of y bound each row of cells and each block of cells, so
//! that a strip of target rows finds the cells that it meets. Memory and time: O(vertices).

use std::sync::Arc;

pub(super) use super::fixed_point::{
    BLOCK_COLUMNS, Corner, HALF_PX, LONGEST_SIDE_STEPS, MAX_STEPS, PX_PER_STEP, STEPS_PER_PX,
    YRange, column_centre, first_row, row_centre,
};
use super::snapped_cut::SnappedCut;
use super::subdivided_cells::SnappedSubdividedCells;
use crate::geometry::DrawingOrder;

/// The posed grid on the lattice.
#[derive(Debug)]
pub(super) struct SnappedGrid {
    /// Vertices in a row.
    pub(super) columns: usize,
    /// Vertices in a column.
    pub(super) rows: usize,
    /// `columns` rounded up to whole blocks.
    pub(super) pitch: usize,
    /// Lattice x, `[rows][pitch]` and one block more.
    pub(super) x: Vec<i32>,
    /// Lattice y, `[rows][pitch]` and one block more.
    pub(super) y: Vec<i32>,
    /// The sampler's coordinate of each column, `[pitch + BLOCK_COLUMNS]`.
    pub(super) u: Vec<f32>,
    /// The sampler's coordinate of each row.
    pub(super) v: Vec<f32>,
    /// Growth of the sampler's coordinates per px of the sampled image.
    pub(super) unit: f32,
    /// Cells with longer sides are drawn in double precision, lattice steps.
    pub(super) longest_side: i32,
    /// Largest error of column crossings relative to the patch, px of the sampled image.
    pub(super) crossing_error: f32,
    /// The y that each row of cells reaches.
    pub(super) row_ranges: Vec<YRange>,
    /// The y that each block of cells reaches, `[rows - 1][pitch / BLOCK_COLUMNS]`.
    pub(super) block_ranges: Vec<YRange>,
    /// The cells that are drawn as smaller ones.
    pub(super) fine: SnappedSubdividedCells,
    /// The quads that are drawn instead of the cells, if the grid is cut.
    pub(super) cut: Option<SnappedCut>,
    /// The order in which cells are drawn where they overlap, if it is not row by row.
    pub(super) order: Option<Arc<DrawingOrder>>,
}

impl SnappedGrid {
    /// Extends the ranges of y to the subdivided cells.
    pub(super) fn cover_fine_cells(&mut self) {
        let blocks = self.pitch / BLOCK_COLUMNS;
        for cell in self.fine.cells() {
            let (row, block) = (
                &mut self.row_ranges[cell.j],
                &mut self.block_ranges[cell.j * blocks + cell.i / BLOCK_COLUMNS],
            );
            (*row, *block) = (row.join(cell.y), block.join(cell.y));
        }
    }

    /// The vertex at a column and row.
    pub(super) fn corner(&self, column: usize, row: usize) -> Corner {
        let index = row * self.pitch + column;
        Corner {
            x: self.x[index],
            y: self.y[index],
            u: self.u[column],
            v: self.v[row],
        }
    }

    /// The corners of a cell: 00, 10, 11, 01.
    pub(super) fn corners(&self, i: usize, j: usize) -> [Corner; 4] {
        [
            self.corner(i, j),
            self.corner(i + 1, j),
            self.corner(i + 1, j + 1),
            self.corner(i, j + 1),
        ]
    }

    /// Range of y of a cell.
    pub(super) fn cell_range(&self, i: usize, j: usize) -> YRange {
        let above = j * self.pitch + i;
        let below = above + self.pitch;
        let (a, b, c, d) = (
            self.y[above],
            self.y[above + 1],
            self.y[below],
            self.y[below + 1],
        );
        let range = YRange {
            top: a.min(b).min(c).min(d),
            bottom: a.max(b).max(c).max(d),
        };
        self.fine
            .find(i, j)
            .map_or(range, |cell| range.join(cell.y))
    }

    /// Extent of a cell in x.
    pub(super) fn cell_extent(&self, i: usize, j: usize) -> (i32, i32) {
        let x = self.corners(i, j).map(|c| c.x);
        let (left, right) = x.iter().fold((i32::MAX, i32::MIN), |(left, right), &x| {
            (left.min(x), right.max(x))
        });
        self.fine.find(i, j).map_or((left, right), |cell| {
            (left.min(cell.x.0), right.max(cell.x.1))
        })
    }

    /// The rows of cells that may touch target rows.
    pub(super) fn rows_touching(
        &self,
        rows: &std::ops::Range<u32>,
    ) -> impl DoubleEndedIterator<Item = usize> + '_ {
        let rows = rows.clone();
        (0..self.rows - 1).filter(move |&j| self.row_ranges[j].meets(&rows))
    }

    /// Blocks of cells per row of cells.
    pub(super) fn blocks(&self) -> usize {
        (self.columns - 1).div_ceil(BLOCK_COLUMNS)
    }

    /// Whether some cell of a block may touch target rows.
    pub(super) fn block_touches(
        &self,
        j: usize,
        block: usize,
        rows: &std::ops::Range<u32>,
    ) -> bool {
        self.block_ranges[j * (self.pitch / BLOCK_COLUMNS) + block].meets(rows)
    }

    #[cfg(test)]
    /// The cells that may touch target rows, in drawing order: row by row, `(column, row)`.
    pub(super) fn cells_touching(
        &self,
        rows: std::ops::Range<u32>,
    ) -> impl DoubleEndedIterator<Item = (usize, usize)> + '_ {
        let blocks = self.pitch / BLOCK_COLUMNS;
        let meets = move |range: &YRange| range.meets(&rows);
        let rows = meets.clone();
        (0..self.rows - 1)
            .filter(move |&j| rows(&self.row_ranges[j]))
            .flat_map(move |j| {
                let meets = meets.clone();
                let cells = self.columns - 1;
                (0..blocks)
                    .filter(move |&b| meets(&self.block_ranges[j * blocks + b]))
                    .flat_map(move |b| {
                        (b * BLOCK_COLUMNS..((b + 1) * BLOCK_COLUMNS).min(cells))
                            .map(move |i| (i, j))
                    })
            })
    }
}
