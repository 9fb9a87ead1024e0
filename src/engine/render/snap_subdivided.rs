//! Conversion of the subdivided cells of a mesh to the lattice. Cost: O(their vertices).

use super::fixed_point::{BLOCK_COLUMNS, Corner, YRange};
use super::kernel::Kernel;
use super::subdivided_cells::{SnappedSubdividedCell, SnappedSubdividedCells};
use crate::geometry::{Grid, Mesh, SubdividedCell};

/// Converts a position at rest to the sampler's coordinates.
pub(super) trait SamplerCoordinates {
    fn u(&self, x: f64) -> f32;
    fn v(&self, y: f64) -> f32;
}

impl SnappedSubdividedCells {
    /// Snaps the subdivided cells of a mesh; `scale`: lattice steps per px, `origin`: the position
    /// of the window, px of the source.
    pub(super) fn new(
        mesh: &Mesh,
        (scale, origin): ([f64; 2], [f64; 2]),
        sampled: &impl SamplerCoordinates,
        kernel: Kernel,
    ) -> Self {
        let subdivision = mesh.subdivision();
        if subdivision.is_empty() {
            return Self::default();
        }
        let grid = mesh.grid();
        let (cell_rows, blocks) = (
            grid.rows() as usize - 1,
            (grid.columns() as usize).div_ceil(BLOCK_COLUMNS),
        );
        let mut fine = Self {
            cells: Vec::with_capacity(subdivision.cells().len()),
            corners: Vec::with_capacity(subdivision.vertices()),
            blocks,
            bits: vec![0; cell_rows * blocks],
            firsts: vec![0; cell_rows * blocks],
            ..Self::default()
        };
        let (mut rest_x, mut u, mut x, mut y) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for cell in subdivision.cells() {
            let (i, j, side) = (cell.column as usize, cell.row as usize, cell.side());
            fine.rows.resize(j + 1, fine.cells.len());
            let block = j * blocks + i / BLOCK_COLUMNS;
            if fine.bits[block] == 0 {
                fine.firsts[block] = fine.cells.len();
            }
            fine.bits[block] |= 1 << (i % BLOCK_COLUMNS);
            let (start, mut range) = (fine.corners.len(), YRange::NOWHERE);
            let mut across = (i32::MAX, i32::MIN);
            let at_rest = |a| between(grid.x(cell.column), grid.x(cell.column + 1), a, side);
            rest_x.clear();
            rest_x.extend((0..side).map(|a| at_rest(a) - origin[0]));
            u.clear();
            u.extend((0..side).map(|a| sampled.u(at_rest(a))));
            x.resize(side, 0);
            y.resize(side, 0);
            for (b, displacement) in subdivision
                .displacement(cell)
                .chunks_exact(side)
                .enumerate()
            {
                let rest_y = between(grid.y(cell.row), grid.y(cell.row + 1), b, side);
                kernel.snap(
                    &rest_x,
                    rest_y - origin[1],
                    displacement,
                    scale,
                    &mut x,
                    &mut y,
                );
                let v = sampled.v(rest_y);
                for ((&u, &x), &y) in u.iter().zip(&x).zip(&y) {
                    fine.corners.push(Corner { x, y, u, v });
                    range = range.join(YRange { top: y, bottom: y });
                    across = (across.0.min(x), across.1.max(x));
                }
            }
            let is_ragged = outer_edges(grid, cell)
                .zip(cell.edges)
                .any(|(is_outer, level)| is_outer && level > 0);
            fine.cells.push(SnappedSubdividedCell {
                i,
                j,
                level: cell.level,
                edges: cell.edges,
                y: range,
                x: across,
                is_ragged,
                start,
            });
        }
        fine.rows.resize(cell_rows + 1, fine.cells.len());
        fine
    }
}

/// The k-th of `side` positions at equal distances.
fn between(from: f64, to: f64, k: usize, side: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few vertices")]
    let share = k as f64 / (side - 1) as f64;
    if k + 1 == side {
        to
    } else {
        from + (to - from) * share
    }
}

/// Whether each edge lies on the border of the grid.
fn outer_edges(grid: &Grid, cell: &SubdividedCell) -> std::array::IntoIter<bool, 4> {
    [
        cell.row == 0,
        cell.column + 2 == grid.columns(),
        cell.row + 2 == grid.rows(),
        cell.column == 0,
    ]
    .into_iter()
}
