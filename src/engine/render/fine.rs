//! The refined cells of a mesh on the lattice: each is drawn as smaller cells. Neighbours share the vertices of their common edge, but a
//! vertex that lies on a straight edge of a coarser neighbour is snapped like any other, at most half a step beside it. The slivers that
//! this leaves are painted as well.

use super::kernel::Kernel;
use super::lattice::{BLOCK, Corner, Lattice, YRange};
use crate::geometry::{Grid, Mesh, RefinedCell};

/// A refined cell.
#[derive(Debug)]
pub(super) struct FineCell {
    pub(super) i: usize,
    pub(super) j: usize,
    level: u8,
    pub(super) edges: [u8; 4],
    /// Extent of its vertices.
    pub(super) y: YRange,
    pub(super) x: (i32, i32),
    /// Some edge on the border of the grid is not straight.
    pub(super) is_ragged: bool,
    /// Index of its first corner.
    start: usize,
}

/// The refined cells, row by row.
#[derive(Debug, Default)]
pub(super) struct FineCells {
    cells: Vec<FineCell>,
    corners: Vec<Corner>,
    /// Index of the first cell of each row of cells, and the number of all.
    rows: Vec<usize>,
    /// The refined cells, one bit each, `[rows][pitch / BLOCK]`.
    bits: Vec<u8>,
    blocks: usize,
}

/// Converts a position at rest to the sampler's coordinates.
pub(super) trait Sampled {
    fn u(&self, x: f64) -> f32;
    fn v(&self, y: f64) -> f32;
}

impl FineCells {
    /// Snaps the refined cells of a mesh; `scale`: lattice steps per px.
    pub(super) fn new(mesh: &Mesh, scale: [f64; 2], sampled: &impl Sampled, kernel: Kernel) -> Self {
        let refinement = mesh.refinement();
        if refinement.is_empty() {
            return Self::default();
        }
        let grid = mesh.grid();
        let (cell_rows, blocks) = (grid.rows() as usize - 1, (grid.columns() as usize).div_ceil(BLOCK));
        let mut fine = Self { blocks, bits: vec![0; cell_rows * blocks], ..Self::default() };
        let (mut rest_x, mut x, mut y) = (Vec::new(), Vec::new(), Vec::new());
        for cell in refinement.cells() {
            let (i, j, side) = (cell.column as usize, cell.row as usize, cell.side());
            fine.rows.resize(j + 1, fine.cells.len());
            fine.bits[j * blocks + i / BLOCK] |= 1 << (i % BLOCK);
            let (start, mut range) = (fine.corners.len(), YRange::NOWHERE);
            let mut across = (i32::MAX, i32::MIN);
            rest_x.clear();
            rest_x.extend((0..side).map(|a| between(grid.x(cell.column), grid.x(cell.column + 1), a, side)));
            x.resize(side, 0);
            y.resize(side, 0);
            for (b, displacement) in refinement.displacement(cell).chunks_exact(side).enumerate() {
                let rest_y = between(grid.y(cell.row), grid.y(cell.row + 1), b, side);
                kernel.snap(&rest_x, rest_y, displacement, scale, &mut x, &mut y);
                let v = sampled.v(rest_y);
                for ((&rest_x, &x), &y) in rest_x.iter().zip(&x).zip(&y) {
                    fine.corners.push(Corner { x, y, u: sampled.u(rest_x), v });
                    range = range.join(YRange { top: y, bottom: y });
                    across = (across.0.min(x), across.1.max(x));
                }
            }
            let is_ragged = outer_edges(grid, cell).zip(cell.edges).any(|(is_outer, level)| is_outer && level > 0);
            fine.cells.push(FineCell { i, j, level: cell.level, edges: cell.edges, y: range, x: across, is_ragged, start });
        }
        fine.rows.resize(cell_rows + 1, fine.cells.len());
        fine
    }

    pub(super) fn cells(&self) -> &[FineCell] {
        &self.cells
    }

    /// The refined cells of a row of cells.
    pub(super) fn row(&self, j: usize) -> &[FineCell] {
        if self.cells.is_empty() { &[] } else { &self.cells[self.rows[j]..self.rows[j + 1]] }
    }

    /// The refined cell at a column and row.
    pub(super) fn find(&self, i: usize, j: usize) -> Option<&FineCell> {
        if self.cells.is_empty() || self.bits[j * self.blocks + i / BLOCK] >> (i % BLOCK) & 1 == 0 {
            return None;
        }
        let row = self.row(j);
        row.binary_search_by_key(&i, |cell| cell.i).ok().map(|index| &row[index])
    }

    /// The cells that a refined cell is drawn as, in drawing order, corners in the order 00, 10, 11, 01.
    pub(super) fn parts(&self, cell: &FineCell) -> impl DoubleEndedIterator<Item = [Corner; 4]> + '_ {
        let cells = 1_usize << cell.level;
        let corners = &self.corners[cell.start..][..(cells + 1) * (cells + 1)];
        (0..cells * cells).map(move |k| {
            let at = k / cells * (cells + 1) + k % cells;
            [corners[at], corners[at + 1], corners[at + cells + 2], corners[at + cells + 1]]
        })
    }

    /// The slivers between a refined cell and the straight parts of its edges, as triangles of either orientation. `under`: whether the
    /// whole cell is painted under it, which covers those at edges that are straight as a whole.
    pub(super) fn slivers(&self, cell: &FineCell, under: bool) -> impl Iterator<Item = [Corner; 3]> + '_ {
        let side = (1_usize << cell.level) + 1;
        let corners = &self.corners[cell.start..][..side * side];
        let (level, edges) = (cell.level, cell.edges);
        let coarse = (0..4).filter(move |&edge| edges[edge] < level && !(under && edges[edge] == 0));
        coarse.flat_map(move |edge| {
            let step = 1_usize << (level - edges[edge]);
            let part = move |first: usize| (first + 1..first + step).map(move |k| [first, k, k + 1].map(|k| corners[along(edge, k, side)]));
            (0..side - 1).step_by(step).flat_map(part)
        })
    }

    /// The vertices inside an edge of a cell, clockwise; none if the edge is straight.
    pub(super) fn edge(&self, i: usize, j: usize, edge: usize) -> impl Iterator<Item = Corner> + '_ {
        self.find(i, j).into_iter().flat_map(move |cell| {
            let side = (1_usize << cell.level) + 1;
            let step = 1_usize << (cell.level - cell.edges[edge]);
            (step..side - 1).step_by(step).map(move |k| self.corners[cell.start + along(edge, k, side)])
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

/// The k-th of `side` positions at equal distances.
fn between(from: f64, to: f64, k: usize, side: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few vertices")]
    let share = k as f64 / (side - 1) as f64;
    if k + 1 == side { to } else { from + (to - from) * share }
}

/// Whether each edge lies on the border of the grid.
fn outer_edges(grid: &Grid, cell: &RefinedCell) -> std::array::IntoIter<bool, 4> {
    [cell.row == 0, cell.column + 2 == grid.columns(), cell.row + 2 == grid.rows(), cell.column == 0].into_iter()
}

impl Lattice {
    /// Extends the ranges of y to the refined cells.
    pub(super) fn cover_fine_cells(&mut self) {
        let blocks = self.pitch / BLOCK;
        for cell in self.fine.cells() {
            let (row, block) = (&mut self.row_ranges[cell.j], &mut self.block_ranges[cell.j * blocks + cell.i / BLOCK]);
            (*row, *block) = (row.join(cell.y), block.join(cell.y));
        }
    }
}
