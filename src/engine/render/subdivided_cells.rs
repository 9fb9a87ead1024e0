//! The subdivided cells of a mesh on the lattice: each is drawn as smaller cells. Neighbours share
//! the vertices of their common edge, but a vertex that lies on a straight edge of a coarser
//! neighbour is snapped like any other, at most half a step beside it. The slivers that this leaves
//! are painted as well.

use super::fixed_point::{BLOCK_COLUMNS, Corner, YRange};

/// A subdivided cell.
#[derive(Debug)]
pub(super) struct SnappedSubdividedCell {
    pub(super) i: usize,
    pub(super) j: usize,
    pub(super) level: u8,
    pub(super) edges: [u8; 4],
    /// Extent of its vertices.
    pub(super) y: YRange,
    pub(super) x: (i32, i32),
    /// Some edge on the border of the grid is not straight.
    pub(super) is_ragged: bool,
    /// Index of its first corner.
    pub(super) start: usize,
}

/// The subdivided cells, row by row.
#[derive(Debug, Default)]
pub(super) struct SnappedSubdividedCells {
    pub(super) cells: Vec<SnappedSubdividedCell>,
    pub(super) corners: Vec<Corner>,
    /// For each row of cells the index of its first cell; at the end the number of all.
    pub(super) rows: Vec<usize>,
    /// The subdivided cells, one bit each, `[rows][pitch / BLOCK_COLUMNS]`.
    pub(super) bits: Vec<u8>,
    /// For each block with such cells the index of its first, in the same layout.
    pub(super) firsts: Vec<usize>,
    pub(super) blocks: usize,
}

impl SnappedSubdividedCells {
    pub(super) fn cells(&self) -> &[SnappedSubdividedCell] {
        &self.cells
    }

    /// The subdivided cells of a row of cells.
    pub(super) fn row(&self, j: usize) -> &[SnappedSubdividedCell] {
        if self.cells.is_empty() {
            &[]
        } else {
            &self.cells[self.rows[j]..self.rows[j + 1]]
        }
    }

    /// The subdivided cells of a block, one bit each.
    pub(super) fn in_block(&self, j: usize, block: usize) -> u8 {
        self.bits.get(j * self.blocks + block).copied().unwrap_or(0)
    }

    /// The subdivided cell at a column and row.
    pub(super) fn find(&self, i: usize, j: usize) -> Option<&SnappedSubdividedCell> {
        if self.cells.is_empty() {
            return None;
        }
        let (block, bit) = (
            j * self.blocks + i / BLOCK_COLUMNS,
            1 << (i % BLOCK_COLUMNS),
        );
        let bits = self.bits[block];
        (bits & bit != 0)
            .then(|| &self.cells[self.firsts[block] + (bits & (bit - 1)).count_ones() as usize])
    }

    /// The k-th of the cells that a subdivided cell is drawn as, in drawing order, corners in the
    /// order 00, 10, 11, 01.
    pub(super) fn part(&self, cell: &SnappedSubdividedCell, k: usize) -> [Corner; 4] {
        let side = (1_usize << cell.level) + 1;
        let at = cell.start + (k >> cell.level) * side + (k & (side - 2));
        let corners = &self.corners[at..at + side + 2];
        [corners[0], corners[1], corners[side + 1], corners[side]]
    }

    /// The slivers between a subdivided cell and the straight parts of its edges, as triangles of
    /// either orientation. `under`: whether the whole cell is painted under it, which covers those
    /// at edges that are straight as a whole.
    pub(super) fn slivers(
        &self,
        cell: &SnappedSubdividedCell,
        under: bool,
    ) -> impl Iterator<Item = [Corner; 3]> + '_ {
        let side = (1_usize << cell.level) + 1;
        let corners = &self.corners[cell.start..][..side * side];
        let (level, edges) = (cell.level, cell.edges);
        // With the cell under it, one that is halved once has none.
        let straight = u8::from(under);
        let coarse = (0..4).filter(move |&edge| (straight..level).contains(&edges[edge]));
        coarse.flat_map(move |edge| {
            let step = 1_usize << (level - edges[edge]);
            let part = move |first: usize| {
                (first + 1..first + step)
                    .map(move |k| [first, k, k + 1].map(|k| corners[along(edge, k, side)]))
            };
            (0..side - 1).step_by(step).flat_map(part)
        })
    }

    /// The vertices inside an edge of a cell, clockwise; none if the edge is straight.
    pub(super) fn edge(
        &self,
        i: usize,
        j: usize,
        edge: usize,
    ) -> impl Iterator<Item = Corner> + '_ {
        self.find(i, j).into_iter().flat_map(move |cell| {
            let side = (1_usize << cell.level) + 1;
            let step = 1_usize << (cell.level - cell.edges[edge]);
            (step..side - 1)
                .step_by(step)
                .map(move |k| self.corners[cell.start + along(edge, k, side)])
        })
    }
}

/// Index of the k-th vertex of an edge, clockwise: top, right, bottom, left.
const fn along(edge: usize, k: usize, side: usize) -> usize {
    let last = side - 1;
    match edge {
        0 => k,
        1 => k * side + last,
        2 => last * side + last - k,
        _ => (last - k) * side,
    }
}
