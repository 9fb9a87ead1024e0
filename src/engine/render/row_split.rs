//! Splits rows between column crossings and cells. Cells that are not upright, and cells at the
//! ends of columns that a row does not cross, may hide others. These cells and enough neighbouring
//! columns are drawn cell by cell, so that all of them lie between two columns that the row crosses
//! once. Upright cells outside are ordered, so neither part hides the other. Cost: O(cells touched
//! + rows * columns drawn by cells).

use std::ops::Range;

use super::row_strategy::RowStrategies;
use super::snapped_grid::PX_PER_STEP;
use super::snapped_grid::{BLOCK_COLUMNS, SnappedGrid, YRange};

/// The largest error of crossings in f32, px.
pub(super) const CROSSING_ERROR_PX: f32 = 1.0 / 32.0;

/// The identity of a union of ranges.
const EMPTY: Range<i32> = Range {
    start: i32::MAX,
    end: i32::MIN,
};

/// The split rows of a strip.
#[derive(Debug, Default)]
pub(super) struct RowSplit {
    /// For each column of cells, the rows in which it is drawn cell by cell, one bit each.
    pub(super) per_cell: Vec<u32>,
    /// The columns that are drawn cell by cell in some row, one bit each.
    pub(super) blocks: Vec<u8>,
    /// The parts of the last row that was split.
    pub(super) parts: Vec<Part>,
    /// For each column of cells, the rows in which a cell is folded, one bit each.
    folded: Vec<u32>,
    /// For each column of vertices, the rows in which it is not drawn straight, one bit each:
    /// subdivided cells beside it differ from crossings.
    bent: Vec<u32>,
    /// Rows that are not split: drawn entirely cell by cell.
    unsplit: u32,
    /// The columns with folded cells.
    columns: Vec<usize>,
    /// The extent of each of these columns in each row, lattice x.
    across: Vec<[Range<i32>; 32]>,
}

/// Neighbouring columns of cells that a row draws cell by cell.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) cells: Range<usize>,
    /// Extent of the folded cells, lattice x.
    across: Range<i32>,
}

impl RowSplit {
    /// Prepares the split rows of a strip.
    pub(super) fn prepare(
        &mut self,
        lattice: &SnappedGrid,
        strategies: &RowStrategies,
        strip: &Range<u32>,
        mixed: u32,
    ) {
        let (cells, pitch) = (lattice.columns - 1, lattice.pitch);
        self.blocks.clear();
        self.blocks.resize(lattice.blocks(), 0);
        self.per_cell.clear();
        self.per_cell.resize(pitch, 0);
        self.folded.clear();
        self.folded.resize(cells, 0);
        self.bent.clear();
        self.bent.resize(cells + 1, 0);
        self.columns.clear();
        self.unsplit = 0;
        if mixed == 0 {
            return;
        }
        // Rows that do not cross every column are not split.
        let unsplit = strip.clone().rev().fold(0, |rows, row| {
            rows << 1 | u32::from(!strategies.is_splittable(row))
        }) & mixed;
        self.unsplit = unsplit;
        if unsplit != 0 {
            self.per_cell[..cells].fill(unsplit);
            for (i, block) in (0..cells).step_by(BLOCK_COLUMNS).zip(&mut self.blocks) {
                // The last block may have fewer columns.
                *block = u8::MAX >> (BLOCK_COLUMNS - BLOCK_COLUMNS.min(cells - i));
            }
        }
        let mixed = mixed & !unsplit;
        if mixed == 0 {
            return;
        }
        // The rows of a range as bits. `before(x)` has those above x; a shift by 32 has no bits
        // left, which `checked_shl` says.
        let rows_of = |range: YRange| {
            let rows = range.rows(strip);
            let before = |row: u32| !u32::MAX.checked_shl(row - strip.start).unwrap_or(0);
            before(rows.end.max(rows.start)) & !before(rows.start) & mixed
        };
        for j in lattice.rows_touching(strip) {
            for (b, &folded) in strategies.folded(j).iter().enumerate() {
                let mut left = folded;
                while left != 0 {
                    let i = b * BLOCK_COLUMNS + left.trailing_zeros() as usize;
                    left &= left - 1;
                    // A folded cell hides others or is hidden: only drawing in order decides, so
                    // these rows are drawn by cells there.
                    self.folded[i] |= rows_of(lattice.cell_range(i, j));
                }
            }
            for cell in lattice.fine.row(j) {
                let [_, right, _, left] = cell
                    .edges
                    .map(|level| if level > 0 { rows_of(cell.y) } else { 0 });
                // The side of a subdivided cell is a chain of chords, while a crossing knows one
                // straight column: a part may not end there.
                self.bent[cell.i] |= left;
                self.bent[cell.i + 1] |= right;
            }
        }
        self.columns
            .extend((0..cells).filter(|&i| self.folded[i] != 0));
        if self.columns.is_empty() {
            return;
        }
        self.across.clear();
        self.across.resize(self.columns.len(), [EMPTY; 32]);
        for j in lattice.rows_touching(strip) {
            for (&i, across) in self.columns.iter().zip(&mut self.across) {
                if !lattice.block_touches(j, i / BLOCK_COLUMNS, strip) {
                    continue;
                }
                // Every cell of the column counts, not only the folded ones: in these rows all of
                // them are drawn by cells, and all must lie inside of the part.
                let mut rows = rows_of(lattice.cell_range(i, j)) & self.folded[i];
                if rows == 0 {
                    continue;
                }
                let (left, right) = lattice.cell_extent(i, j);
                while rows != 0 {
                    let known = &mut across[rows.trailing_zeros() as usize];
                    rows &= rows - 1;
                    *known = known.start.min(left)..known.end.max(right);
                }
            }
        }
    }

    /// Splits a row; `x` holds its crossings of the columns, px.
    pub(super) fn split(&mut self, index: usize, x: &[f32]) {
        let (bit, cells) = (1_u32 << index, self.folded.len());
        self.parts.clear();
        if self.unsplit & bit != 0 {
            self.parts.push(Part {
                cells: 0..cells,
                across: i32::MIN..i32::MAX,
            });
            return;
        }
        let px = |place: i32| place as f32 * PX_PER_STEP;
        let folded = |n: &usize| self.folded[self.columns[*n]] & bit != 0;
        // From left to right. A part grows until its end columns lie outside of everything that is
        // drawn in it; parts that then touch become one.
        let mut next = (0..self.columns.len()).find(folded);
        while let Some(n) = next {
            next = (n + 1..self.columns.len()).find(folded);
            let i = self.columns[n];
            let mut part = Part {
                cells: i..i + 1,
                across: self.across[n][index].clone(),
            };
            loop {
                // The column at the left end lies left of all folded cells, and the cell left of it
                // is upright.
                let before = self.parts.last().map_or(0, |part| part.cells.end);
                let end = (before + 1..=part.cells.start).rev().find(|c| {
                    x[*c] + CROSSING_ERROR_PX <= px(part.across.start) && self.bent[*c] & bit == 0
                });
                match (end, self.parts.pop()) {
                    (Some(end), last) => {
                        part.cells.start = end;
                        self.parts.extend(last);
                        break;
                    }
                    // No straight column is left of the fold: the part before joins it.
                    (None, Some(last)) => {
                        part.cells.start = last.cells.start;
                        part.across = last.across.start.min(part.across.start)
                            ..last.across.end.max(part.across.end);
                    }
                    (None, None) => {
                        part.cells.start = 0;
                        break;
                    }
                }
            }
            let last = next.map_or(cells, |next| self.columns[next]);
            // To the right up to the next fold only: if no column is free before it, the next turn
            // of the loop joins the two.
            let end = (part.cells.end..last).find(|c| {
                x[*c] - CROSSING_ERROR_PX >= px(part.across.end) && self.bent[*c] & bit == 0
            });
            part.cells.end = end.unwrap_or(last);
            self.parts.push(part);
        }
        for i in self.parts.iter().flat_map(|part| part.cells.clone()) {
            self.per_cell[i] |= bit;
            self.blocks[i / BLOCK_COLUMNS] |= 1 << (i % BLOCK_COLUMNS);
        }
    }
}
