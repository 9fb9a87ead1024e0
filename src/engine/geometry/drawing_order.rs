//! The order in which cells are drawn where a posed grid overlaps itself, if it is not row by row
//! (mathematics 11.4).

use super::{CutCells, Grid};

/// Depths are compared in steps of a share of their range: what differs by rounding alone has one
/// depth.
const DEPTH_STEPS: f64 = 4_194_304.0;
/// Cells between two checks of cancellation: about a millisecond.
const CELLS_PER_LOOK: usize = 1 << 16;
/// The digits by which steps are sorted, and their bits.
const DIGITS: u32 = 2;
const DIGIT_BITS: u32 = u32::BITS / DIGITS;
/// The number of values of a digit.
const VALUES: usize = 1 << DIGIT_BITS;

/// An order of the cells of a grid, or of the quads of a cut grid, other than row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrawingOrder {
    /// The cells, the one behind all others first.
    cells: Vec<u32>,
    /// The place of each cell among them.
    ranks: Vec<u32>,
}

impl DrawingOrder {
    /// The cells of a grid by the depth of their vertices, as shares of the range of the handles'
    /// depths; `None` within if cells are drawn row by row. `None` when cancelled. O(cells).
    /// Shapes: `depth: [rows][columns]`.
    #[must_use]
    pub fn of_grid(
        grid: &Grid,
        depth: &[f32],
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Option<Self>> {
        let columns = grid.columns() as usize;
        let cells = (0..grid.len() - columns).filter(|at| (at + 1) % columns != 0);
        let corners = |at: usize| [at, at + 1, at + columns + 1, at + columns];
        let depths = cells.map(|at| corners(at).map(|at| depth[at]));
        let count = (columns - 1) * (grid.rows() as usize - 1);
        Self::of_cells(count, depths, cancelled)
    }

    /// The quads of a cut grid in the same way; those that belong to nothing stay behind all
    /// others. Shapes: `depth: [vertices]`.
    #[must_use]
    pub fn of_quads(
        cells: &CutCells,
        depth: &[f32],
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Option<Self>> {
        let quads = cells.cells();
        let corners = quads.iter().map(|quad| {
            let behind = if quad.is_loose {
                f32::NEG_INFINITY
            } else {
                0.0
            };
            quad.vertices.map(|vertex| depth[vertex as usize] + behind)
        });
        Self::of_cells(quads.len(), corners, cancelled)
    }

    /// By the mean depth of four corners; cells of one depth keep their order.
    fn of_cells(
        count: usize,
        corners: impl Iterator<Item = [f32; 4]>,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Option<Self>> {
        let mut keys = Vec::with_capacity(count);
        for (k, corners) in corners.enumerate() {
            if k % CELLS_PER_LOOK == 0 && cancelled() {
                return None;
            }
            keys.push(key(corners));
        }
        if keys.is_sorted() {
            return Some(None);
        }
        let mut cells: Vec<u32> = (0..).take(keys.len()).collect();
        let mut ranks = vec![0; keys.len()];
        for digit in 0..DIGITS {
            sort_by_digit(&cells, &keys, digit, &mut ranks, cancelled)?;
            std::mem::swap(&mut cells, &mut ranks);
        }
        for (part, cells) in cells.chunks(CELLS_PER_LOOK).enumerate() {
            if cancelled() {
                return None;
            }
            for (rank, cell) in (part * CELLS_PER_LOOK..).zip(cells) {
                ranks[*cell as usize] = u32::try_from(rank).ok()?;
            }
        }
        Some(Some(Self { cells, ranks }))
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

    /// The most memory while it is made of the depths of this number of vertices, themselves
    /// included, bytes.
    #[must_use]
    pub const fn peak_bytes_for(vertices: u64, cells: u64) -> u64 {
        let keys = cells.saturating_mul(size_of::<u32>() as u64);
        let depths = vertices.saturating_mul(size_of::<f32>() as u64);
        let next = size_of::<usize>() as u64 * VALUES as u64;
        Self::bytes_for(cells)
            .saturating_add(keys)
            .saturating_add(depths)
            .saturating_add(next)
    }
}

/// The step of the mean depth of four corners, as a number without a sign that is ordered alike.
fn key(corners: [f32; 4]) -> u32 {
    let [a, b, c, d] = corners.map(f64::from);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "float to integer saturates"
    )]
    let step = (((a + b) + (c + d)) / 4.0 * DEPTH_STEPS).round() as i32;
    step.cast_unsigned() ^ 1 << (u32::BITS - 1)
}

/// Writes cells to `sorted` by a digit of their keys, the least digit first; those of one digit
/// keep their order. `None` when cancelled.
fn sort_by_digit(
    cells: &[u32],
    keys: &[u32],
    digit: u32,
    sorted: &mut [u32],
    cancelled: &dyn Fn() -> bool,
) -> Option<()> {
    let value = |cell: u32| {
        let value = keys[cell as usize] >> (digit * DIGIT_BITS);
        value as usize & (VALUES - 1)
    };
    // How many cells have each value; then where the next of them belongs.
    let mut next = vec![0_usize; VALUES];
    for cells in cells.chunks(CELLS_PER_LOOK) {
        if cancelled() {
            return None;
        }
        cells.iter().for_each(|cell| next[value(*cell)] += 1);
    }
    let mut before = 0;
    for next in &mut next {
        before += std::mem::replace(next, before);
    }
    for cells in cells.chunks(CELLS_PER_LOOK) {
        if cancelled() {
            return None;
        }
        for cell in cells {
            let next = &mut next[value(*cell)];
            sorted[*next] = *cell;
            *next += 1;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_ordered_by_depth_and_keep_their_order_where_it_is_equal() {
        let grid = Grid::with_counts(30.0, 20.0, 4, 3);
        let of = |depth: [f32; 12]| DrawingOrder::of_grid(&grid, &depth, &|| false).unwrap();
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

    /// Depths of every size and sign, many of them equal.
    fn depths(count: usize) -> Vec<f32> {
        let mut state = 7_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 8
        };
        (0..count)
            .map(|_| match next() % 4 {
                0 => 0.5,
                1 => f32::from_bits(next() << 9),
                2 => (next() % 1000) as f32 / -10.0,
                _ => (next() % 4096) as f32 / 4095.0,
            })
            .map(|depth| if depth.is_nan() { 0.0 } else { depth })
            .collect()
    }

    #[test]
    fn the_order_is_that_of_a_stable_sort() {
        let grid = Grid::with_counts(300.0, 200.0, 301, 201);
        let depth = depths(grid.len());
        let order = DrawingOrder::of_grid(&grid, &depth, &|| false).unwrap();
        let columns = grid.columns() as usize;
        let keys: Vec<i64> = (0..grid.len() - columns)
            .filter(|at| (at + 1) % columns != 0)
            .map(|at| [at, at + 1, at + columns + 1, at + columns].map(|at| depth[at]))
            .map(|corners| i64::from(key(corners)))
            .collect();
        let mut expected: Vec<u32> = (0..).take(keys.len()).collect();
        expected.sort_by_key(|cell| keys[*cell as usize]);
        assert_eq!(order.unwrap().cells(), expected);
    }

    #[test]
    fn it_is_given_up_at_every_look() {
        use std::cell::Cell;
        let grid = Grid::with_counts(600.0, 500.0, 601, 501);
        let depth = depths(grid.len());
        let asked = Cell::new(0);
        let of = |after: usize| {
            asked.set(0);
            DrawingOrder::of_grid(&grid, &depth, &|| {
                asked.set(asked.get() + 1);
                asked.get() > after
            })
        };
        assert!(of(usize::MAX).is_some());
        let looks = asked.get();
        // Keys, two digits twice, and ranks: each of all cells.
        assert_eq!(looks, 6 * (600_usize * 500).div_ceil(CELLS_PER_LOOK));
        for after in 0..looks {
            assert_eq!((of(after), asked.get()), (None, after + 1));
        }
    }
}
