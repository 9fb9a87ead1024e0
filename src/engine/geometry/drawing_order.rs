//! The order in which cells are drawn where a posed grid overlaps itself, if it is not row by row
//! (mathematics 11.4).

use super::{CutCells, Grid};

/// Depths are compared in shares of the range of the handles: what differs by rounding alone has
/// one depth.
const DEPTH_STEPS: f64 = 4_194_304.0;

/// An order of the cells of a grid, or of the quads of a cut grid, other than row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrawingOrder {
    /// The cells, the one behind all others first.
    cells: Vec<u32>,
    /// The place of each cell among them.
    ranks: Vec<u32>,
}

impl DrawingOrder {
    /// The cells of a grid by the depth of their vertices. `range`: the least and the largest depth
    /// of a handle. `None` if cells are drawn row by row. Shapes: `depth: [rows][columns]`.
    #[must_use]
    pub fn of_grid(grid: &Grid, depth: &[f32], range: [f64; 2]) -> Option<Self> {
        let columns = grid.columns() as usize;
        let cells = (0..grid.len() - columns).filter(|at| (at + 1) % columns != 0);
        let corners = |at: usize| [at, at + 1, at + columns + 1, at + columns];
        Self::of_cells(cells.map(|at| corners(at).map(|at| depth[at])), range)
    }

    /// The quads of a cut grid by the depth of their vertices; those that belong to nothing stay
    /// behind all others. Shapes: `depth: [vertices]`.
    #[must_use]
    pub fn of_quads(cells: &CutCells, depth: &[f32], range: [f64; 2]) -> Option<Self> {
        let quads = cells.cells().iter();
        let corners = quads.map(|quad| {
            let behind = if quad.is_loose {
                f32::NEG_INFINITY
            } else {
                0.0
            };
            quad.vertices.map(|vertex| depth[vertex as usize] + behind)
        });
        Self::of_cells(corners, range)
    }

    /// By the mean depth of four corners; cells of one depth keep their order.
    fn of_cells(corners: impl Iterator<Item = [f32; 4]>, [least, most]: [f64; 2]) -> Option<Self> {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "float to integer saturates"
        )]
        let step = |corners: [f32; 4]| {
            let [a, b, c, d] = corners.map(f64::from);
            ((((a + b) + (c + d)) / 4.0 - least) / (most - least) * DEPTH_STEPS).round() as i32
        };
        let steps: Vec<i32> = corners.map(step).collect();
        if steps.is_sorted() {
            return None;
        }
        let mut cells: Vec<u32> = (0..u32::try_from(steps.len()).ok()?).collect();
        cells.sort_by_key(|cell| steps[*cell as usize]);
        let mut ranks = vec![0; cells.len()];
        for (rank, cell) in (0..).zip(&cells) {
            ranks[*cell as usize] = rank;
        }
        Some(Self { cells, ranks })
    }

    /// The cells, counted row by row, in the order in which they are drawn.
    #[must_use]
    pub fn cells(&self) -> &[u32] {
        &self.cells
    }

    /// The place of a cell in that order.
    #[must_use]
    pub fn rank(&self, cell: usize) -> u32 {
        self.ranks[cell]
    }

    /// Memory for this number of cells, bytes.
    #[must_use]
    pub const fn bytes_for(cells: u64) -> u64 {
        cells.saturating_mul(2 * size_of::<u32>() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_ordered_by_depth_and_keep_their_order_where_it_is_equal() {
        let grid = Grid::with_counts(30.0, 20.0, 4, 3);
        let of = |depth: [f32; 12]| DrawingOrder::of_grid(&grid, &depth, [0.0, 1.0]);
        assert_eq!(of([0.5; 12]), None);
        // Deeper from left to right and downwards: as it is anyway.
        assert_eq!(
            of([0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 0.1, 0.1, 0.2, 0.2, 0.2, 0.2]),
            None
        );
        let order = of([1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        assert_eq!(order.cells(), [2, 5, 4, 1, 3, 0]);
        assert_eq!(
            [0, 1, 2, 3, 4, 5].map(|cell| order.rank(cell)),
            [5, 3, 0, 4, 2, 1]
        );
        // Rounding is no depth.
        assert_eq!(of([1.0; 12].map(|depth| depth - f32::EPSILON)), None);
    }
}
