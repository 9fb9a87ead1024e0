//! Cells that follow one another in a row of the grid, interpolated together: the numbers of
//! [`Interpolated`](super::interpolated::Interpolated) for each, bit for bit, as loops over the
//! cells that compilers vectorise. Neighbours share what lies on and beside their common edges.

use super::interpolated::{
    AxisStencil, EvenLines, MIDDLE_POSITION, NODE_WEIGHTS, QUINTIC_NODES, STENCIL_VERTICES,
    interpolation_error,
};
use crate::geometry::Mesh;

/// Cells of a block.
const CELLS: usize = 16;
/// Numbers of a line of vertices of all stencils, x and y in turn.
const STENCIL_NUMBERS: usize = 2 * (CELLS - 1 + STENCIL_VERTICES);
/// The same from the first node of the first cell to the last node of the last.
const NODE_NUMBERS: usize = 2 * (CELLS - 1 + QUINTIC_NODES);
/// The same of the vertices of the cells.
const VERTEX_NUMBERS: usize = 2 * (CELLS + 1);
/// The first node among the vertices of a stencil in the middle, and the first cell.
const FIRST_NODE: usize = 1;
const FIRST_CELL: usize = FIRST_NODE + MIDDLE_POSITION;

type Line<'a> = &'a [f32; STENCIL_NUMBERS];

/// A block of cells, all of them in the middle of their stencils across.
#[derive(Debug)]
pub(super) struct InterpolatedBlock {
    /// Index of the first cell.
    first: u32,
    off: [f32; CELLS],
    errors: [f32; CELLS],
    /// Vertices between two columns: on the line above, in the middle, on the line below.
    between: [[f32; 2 * CELLS]; 3],
    /// Vertices on the columns, in the middle between both lines.
    middle: [f32; NODE_NUMBERS],
}

impl InterpolatedBlock {
    /// A block with the cell at a column and row, which is the first of it where the row has room;
    /// `None` if the cell is not in the middle of its stencil across.
    pub(super) fn new(mesh: &Mesh, even: EvenLines, i: u32, j: u32) -> Option<Self> {
        let (y, columns) = (even.row(j)?, mesh.grid().columns() as usize);
        // Moved to the left at the end of a row.
        let left = (i as usize)
            .checked_sub(FIRST_CELL)?
            .min(even.columns().checked_sub(STENCIL_NUMBERS / 2)?);
        let first = left + FIRST_CELL;
        if i as usize >= first + CELLS {
            return None;
        }
        let d = mesh.displacement().as_flattened();
        let lines: [Line<'_>; STENCIL_VERTICES] = std::array::from_fn(|k| {
            d[2 * ((y.first + k) * columns + left)..]
                .first_chunk()
                .expect("room for all stencils")
        });
        let (top, bottom) = (lines[y.cell()], lines[y.cell() + 1]);
        let middle = down(&lines, &y);
        let between = [nodes(top), &middle, nodes(bottom)].map(across);
        Some(Self {
            first: u32::try_from(first).expect("a column") + j * (mesh.grid().columns() - 1),
            off: off(&lines, &y),
            errors: errors([top, bottom], &middle, &between),
            between,
            middle,
        })
    }

    /// The place of a cell in the block.
    pub(super) fn place(&self, cell: u32) -> Option<usize> {
        let place = cell.wrapping_sub(self.first) as usize;
        (place < CELLS).then_some(place)
    }

    /// [`Interpolated::off`](super::interpolated::Interpolated::off) of a cell of the block.
    pub(super) fn off(&self, place: usize) -> f32 {
        self.off[place]
    }

    /// [`Interpolated::error`](super::interpolated::Interpolated::error) of it.
    pub(super) fn error(&self, place: usize) -> f32 {
        self.errors[place]
    }

    /// [`Interpolated::halves`](super::interpolated::Interpolated::halves) of it.
    pub(super) fn halves(&self, place: usize) -> [[f32; 2]; 5] {
        let at = |numbers: &[f32], vertex: usize| [numbers[2 * vertex], numbers[2 * vertex + 1]];
        let [above, centre, below] = &self.between;
        [
            at(above, place),
            at(&self.middle, MIDDLE_POSITION + place),
            at(centre, place),
            at(&self.middle, MIDDLE_POSITION + place + 1),
            at(below, place),
        ]
    }
}

/// The nodes on a line of all stencils.
fn nodes<'a>(line: Line<'a>) -> &'a [f32; NODE_NUMBERS] {
    line[2 * FIRST_NODE..].first_chunk().expect("the nodes")
}

/// The vertices of the cells on a line of all stencils.
fn vertices<'a>(line: Line<'a>) -> &'a [f32; VERTEX_NUMBERS] {
    line[2 * FIRST_CELL..].first_chunk().expect("the cells")
}

/// The nodes of all columns in the middle of the row of cells.
fn down(lines: &[Line<'_>; STENCIL_VERTICES], y: &AxisStencil) -> [f32; NODE_NUMBERS] {
    let mut sums = [0.0; NODE_NUMBERS];
    for (weight, line) in NODE_WEIGHTS[y.position][1].iter().zip(&lines[y.nodes..]) {
        for (sum, d) in sums.iter_mut().zip(nodes(line)) {
            *sum += weight * d;
        }
    }
    sums
}

/// The vertices in the middle of each cell of a line of nodes.
fn across(nodes: &[f32; NODE_NUMBERS]) -> [f32; 2 * CELLS] {
    let mut sums = [0.0; 2 * CELLS];
    for (node, weight) in NODE_WEIGHTS[MIDDLE_POSITION][1].iter().enumerate() {
        for (sum, d) in sums.iter_mut().zip(&nodes[2 * node..]) {
            *sum += weight * d;
        }
    }
    sums
}

/// Second differences of three lines of numbers.
fn second<const N: usize>(a: &[f32], b: &[f32], c: &[f32]) -> [f32; N] {
    let mut out = [0.0; N];
    let (a, b, c) = (&a[..N], &b[..N], &c[..N]);
    for k in 0..N {
        out[k] = a[k] - 2.0 * b[k] + c[k];
    }
    out
}

/// The larger of a bound and the squared length of each vector; `numbers` are x and y in turn.
fn raise<const N: usize>(bounds: &mut [f32; N], numbers: &[f32]) {
    let numbers = &numbers[..2 * N];
    for k in 0..N {
        let square = numbers[2 * k] * numbers[2 * k] + numbers[2 * k + 1] * numbers[2 * k + 1];
        bounds[k] = bounds[k].max(square);
    }
}

/// How far the vertices of each cell may be from f.
fn off(lines: &[Line<'_>; STENCIL_VERTICES], y: &AxisStencil) -> [f32; CELLS] {
    const SECONDS: usize = STENCIL_NUMBERS - 4;
    const FOURTHS: usize = SECONDS - 4;
    const SIXTHS: usize = FOURTHS - 4;
    let (mut fourth_x, mut sixth_x) = ([0.0; FOURTHS / 2], [0.0; SIXTHS / 2]);
    for line in [lines[y.cell()], lines[y.cell() + 1]] {
        let along = second::<SECONDS>(line, &line[2..], &line[4..]);
        let fourth = second::<FOURTHS>(&along, &along[2..], &along[4..]);
        raise(&mut fourth_x, &fourth);
        raise(
            &mut sixth_x,
            &second::<SIXTHS>(&fourth, &fourth[2..], &fourth[4..]),
        );
    }
    let lines = lines.map(vertices);
    let down: [[f32; VERTEX_NUMBERS]; STENCIL_VERTICES - 2] =
        std::array::from_fn(|k| second(lines[k], lines[k + 1], lines[k + 2]));
    let fourth: [[f32; VERTEX_NUMBERS]; STENCIL_VERTICES - 4] =
        std::array::from_fn(|k| second(&down[k], &down[k + 1], &down[k + 2]));
    let (mut fourth_y, mut sixth_y) = ([0.0; CELLS + 1], [0.0; CELLS + 1]);
    for k in 0..2 {
        raise(&mut fourth_y, &fourth[k + 1]);
        raise(
            &mut sixth_y,
            &second::<VERTEX_NUMBERS>(&fourth[k], &fourth[k + 1], &fourth[k + 2]),
        );
    }
    // Two differences along each line of the cell, or along each column.
    let mut lengths = [[0.0; CELLS]; 4];
    let [of_fourth_x, of_fourth_y, of_sixth_x, of_sixth_y] = &mut lengths;
    for k in 0..CELLS {
        of_fourth_x[k] = fourth_x[k + 1].max(fourth_x[k + 2]).sqrt();
        of_fourth_y[k] = fourth_y[k].max(fourth_y[k + 1]).sqrt();
        of_sixth_x[k] = sixth_x[k].max(sixth_x[k + 1]).sqrt();
        of_sixth_y[k] = sixth_y[k].max(sixth_y[k + 1]).sqrt();
    }
    let mut off = [0.0; CELLS];
    for k in 0..CELLS {
        let (fourth, sixth) = (
            [of_fourth_x[k], of_fourth_y[k]],
            [of_sixth_x[k], of_sixth_y[k]],
        );
        off[k] = interpolation_error(fourth, sixth, [MIDDLE_POSITION, y.position]);
    }
    off
}

/// The largest distance between the vertices of each halved cell and its patch.
fn errors(
    lines: [Line<'_>; 2],
    middle: &[f32; NODE_NUMBERS],
    [above, centre, below]: &[[f32; 2 * CELLS]; 3],
) -> [f32; CELLS] {
    let [top, bottom] = lines.map(vertices);
    let mut sides = [0.0; VERTEX_NUMBERS];
    for (k, off) in sides.iter_mut().enumerate() {
        *off = middle[2 * MIDDLE_POSITION + k] - 0.5 * (top[k] + bottom[k]);
    }
    let mut others = [[0.0; 2 * CELLS]; 3];
    let [off_above, off_centre, off_below] = &mut others;
    for k in 0..2 * CELLS {
        let patch = (
            0.5 * (top[k] + top[k + 2]),
            0.5 * (bottom[k] + bottom[k + 2]),
        );
        off_above[k] = above[k] - patch.0;
        off_below[k] = below[k] - patch.1;
        off_centre[k] = centre[k] - 0.5 * (patch.0 + patch.1);
    }
    let mut squares = [0.0; CELLS + 1];
    raise(&mut squares, &sides);
    let mut worst = [0.0; CELLS];
    for off in &others {
        raise(&mut worst, off);
    }
    for (k, worst) in worst.iter_mut().enumerate() {
        *worst = worst.max(squares[k]).max(squares[k + 1]).sqrt();
    }
    worst
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::interpolated::Interpolated;
    use crate::geometry::Grid;

    #[test]
    fn a_block_has_the_bits_of_its_cells() {
        let grid = Grid::with_counts(400.0, 90.0, 41, 10);
        let mut random = 1_u32;
        let mut noise = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 8) as f32 / (1 << 24) as f32
        };
        for roughness in [0.0, 1e-4, 1e-2, 1.0] {
            let bent = |k: u32| {
                let (x, y) = ((k % 41) as f32, (k / 41) as f32);
                [(0.3 * x + 0.2 * y).sin(), (0.1 * x - 0.4 * y).cos()]
            };
            let d = (0..410).map(|k| bent(k).map(|d| d + roughness * noise()));
            let mesh = Mesh::new(grid, d.collect());
            let even = EvenLines::of(&grid);
            let mut compared = 0;
            for (i, j) in (0..9).flat_map(|j| (0..40).map(move |i| (i, j))) {
                let Some(block) = InterpolatedBlock::new(&mesh, even, i, j) else {
                    assert!(!(3..=36).contains(&i), "{i} {j}");
                    continue;
                };
                let first = i.min(21);
                for k in first..first + 16 {
                    let (cell, at) = (j * 40 + k, (k - first) as usize);
                    assert_eq!(block.place(cell), Some(at));
                    let one = Interpolated::new(&mesh, even, k, j).expect("has its stencil");
                    let corners = [(k, j), (k + 1, j), (k, j + 1), (k + 1, j + 1)]
                        .map(|(i, j)| mesh.displacement()[(j * 41 + i) as usize]);
                    assert_eq!(block.halves(at), one.halves(), "{k} {j}");
                    assert_eq!(block.off(at).to_bits(), one.off().to_bits(), "{k} {j}");
                    let error = Interpolated::error(corners, &one.halves());
                    assert_eq!(block.error(at).to_bits(), error.to_bits(), "{k} {j}");
                    compared += 1;
                }
                assert_eq!(block.place(j * 40 + first + 16), None);
                assert_eq!(block.place(j * 40 + first - 1), None);
            }
            assert!(compared > 2000, "{compared}");
        }
    }
}
