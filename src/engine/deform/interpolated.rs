//! The vertices that halving a cell once or twice adds, interpolated from the posed grid by tensor
//! quintics through six vertices along each axis (mathematics section 12, step 2), where
//! differences show that the grid resolves f. This takes a few taps instead of a row of
//! coefficients.

use crate::geometry::{Grid, Mesh};

/// Vertices of a quintic.
pub(super) const QUINTIC_NODES: usize = 6;
/// Vertices used along each axis: two sixth differences.
pub(super) const STENCIL_VERTICES: usize = 8;
/// Positions of a cell among the nodes of a quintic; the third is the middle.
const CELL_POSITIONS: usize = QUINTIC_NODES - 1;
pub(super) const MIDDLE_POSITION: usize = 2;
/// The weights of the nodes for the quarters of a cell.
pub(super) const NODE_WEIGHTS: [[[f32; QUINTIC_NODES]; 3]; CELL_POSITIONS] = weights();
/// The error of a quintic in a cell is at most about this share of the sixth differences, and that
/// of a cubic of the fourth.
const OF_SIXTH: [f32; CELL_POSITIONS] = shares();
const OF_FOURTH: f32 = 3.0 / 128.0;
/// The next order adds to the error where differences fall slowly; where they hardly fall, the grid
/// does not resolve f.
const NEXT_ORDER: f32 = 2.0;
const SLOWEST_DECAY: f32 = 0.6;

/// Lagrange's polynomials at the quarters of each cell.
#[expect(
    clippy::cast_possible_truncation,
    reason = "weights of f32 displacements"
)]
const fn weights() -> [[[f32; QUINTIC_NODES]; 3]; CELL_POSITIONS] {
    let mut weights = [[[0.0; QUINTIC_NODES]; 3]; CELL_POSITIONS];
    let mut at = 0;
    while at < CELL_POSITIONS * 3 * QUINTIC_NODES {
        let (position, quarter, node) = (
            at / QUINTIC_NODES / 3,
            at / QUINTIC_NODES % 3,
            at % QUINTIC_NODES,
        );
        // In units of the distance of two vertices, from the first node.
        let x = position as f64 + 0.25 * (quarter + 1) as f64;
        // Lagrange's formula; in f64, because the factors alternate in sign and are then rounded
        // once.
        let (mut weight, mut other) = (1.0, 0);
        while other < QUINTIC_NODES {
            if other != node {
                weight *= (x - other as f64) / (node as f64 - other as f64);
            }
            other += 1;
        }
        weights[position][quarter][node] = weight as f32;
        at += 1;
    }
    weights
}

/// The largest error of a quintic at the quarters of each cell, per sixth difference, and by how
/// much more than in the middle it increases the errors of the values that it interpolates.
#[expect(clippy::cast_possible_truncation, reason = "an estimate")]
const fn shares() -> [f32; CELL_POSITIONS] {
    /// 6!
    const FACTORIAL: f64 = 720.0;
    let mut shares = [0.0; CELL_POSITIONS];
    let mut at = 0;
    while at < CELL_POSITIONS * 3 {
        let x = (at / 3) as f64 + 0.25 * (at % 3 + 1) as f64;
        let (mut product, mut sum, mut of_middle, mut node) = (1.0 / FACTORIAL, 0.0, 0.0, 0);
        while node < QUINTIC_NODES {
            // The error of an interpolating polynomial is the product of the distances from its
            // nodes, times the derivative, over 6!.
            product *= (x - node as f64).abs();
            sum += NODE_WEIGHTS[at / 3][at % 3][node].abs();
            of_middle += NODE_WEIGHTS[MIDDLE_POSITION][at % 3][node].abs();
            node += 1;
        }
        // A lopsided stencil also enlarges the errors of the second direction, which interpolates
        // interpolated values: by the ratio of the sums of absolute weights.
        let share = product as f32 * sum / of_middle;
        if share > shares[at / 3] {
            shares[at / 3] = share;
        }
        at += 1;
    }
    shares
}

/// The vertices along one axis of the grid that are used for a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct AxisStencil {
    /// The first of the vertices.
    pub(super) first: usize,
    /// The first node among them.
    pub(super) nodes: usize,
    /// The position of the cell among the nodes.
    pub(super) position: usize,
}

impl AxisStencil {
    /// `lines`: grid lines at equal distances, from the first. `None` if there are too few for this
    /// cell.
    fn new(cell: usize, lines: usize) -> Option<Self> {
        let first = cell
            // Centred where there is room, moved inwards at the border of the grid. There is no
            // extrapolation: eight lines or none.
            .saturating_sub(3)
            .min(lines.checked_sub(STENCIL_VERTICES)?);
        let cell = cell - first;
        let nodes = cell
            .saturating_sub(MIDDLE_POSITION)
            .min(STENCIL_VERTICES - QUINTIC_NODES);
        // The last column may be narrower than the others; a cell that touches it lies outside of
        // the even lines.
        (cell + 1 < STENCIL_VERTICES).then_some(Self {
            first,
            nodes,
            position: cell - nodes,
        })
    }

    /// The position of the cell among the vertices.
    pub(super) const fn cell(&self) -> usize {
        self.nodes + self.position
    }
}

/// The grid lines along each axis that are at equal distances from their neighbours: all, or all
/// but the last.
#[derive(Clone, Copy, Debug)]
pub(super) struct EvenLines {
    columns: usize,
    rows: usize,
}

impl EvenLines {
    pub(super) fn of(grid: &Grid) -> Self {
        /// Distances that differ by a smaller share of a cell are equal.
        const EQUAL_DISTANCE_CELLS: f64 = 1e-6;
        let even = |count: u32, at: &dyn Fn(u32) -> f64, cell: f64| {
            // Grids end at the border of the picture, so the last cell is often a part of one.
            // Quintics need equal distances.
            let is_even = count > 1
                && (at(count - 1) - at(count - 2) - cell).abs() < EQUAL_DISTANCE_CELLS * cell;
            count as usize - usize::from(!is_even)
        };
        Self {
            columns: even(grid.columns(), &|i| grid.x(i), grid.cell().0),
            rows: even(grid.rows(), &|j| grid.y(j), grid.cell().1),
        }
    }

    /// The lines across at equal distances.
    pub(super) const fn columns(self) -> usize {
        self.columns
    }

    /// What a row of cells uses of the columns; `None` if too few lines are at equal distances.
    pub(super) fn row(self, j: u32) -> Option<AxisStencil> {
        AxisStencil::new(j as usize, self.rows)
    }
}

/// How far interpolated vertices of a cell may be from f, px, from the largest fourth and sixth
/// differences along each axis, and its positions; infinite where the grid does not resolve f.
#[inline]
pub(super) fn interpolation_error(fourth: [f32; 2], sixth: [f32; 2], positions: [usize; 2]) -> f32 {
    // Sixth differences estimate the error of a quintic, fourth ones that of a cubic (mathematics
    // section 12, step 2). If the former are not much smaller, the series does not converge here.
    let (cubic, quintic) = (
        OF_FOURTH * (fourth[0] + fourth[1]),
        OF_SIXTH[MIDDLE_POSITION] * (sixth[0] + sixth[1]),
    );
    let off = OF_SIXTH[positions[0]] * sixth[0] + OF_SIXTH[positions[1]] * sixth[1];
    let off = off * (1.0 + NEXT_ORDER * quintic / cubic.max(f32::MIN_POSITIVE));
    // Without an early return, so that blocks of cells are vectorised.
    if quintic > SLOWEST_DECAY * cubic {
        f32::INFINITY
    } else {
        off
    }
}

/// A cell whose vertices are interpolated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interpolated<'a> {
    lines: [&'a [[f32; 2]; STENCIL_VERTICES]; STENCIL_VERTICES],
    x: AxisStencil,
    y: AxisStencil,
}

impl<'a> Interpolated<'a> {
    /// The cell at a column and row; `None` if too few lines are at equal distances.
    pub(super) fn new(mesh: &'a Mesh, even: EvenLines, i: u32, j: u32) -> Option<Self> {
        let (x, y) = (
            AxisStencil::new(i as usize, even.columns)?,
            AxisStencil::new(j as usize, even.rows)?,
        );
        let (d, columns) = (mesh.displacement(), mesh.grid().columns() as usize);
        let line = |k: usize| {
            d[(y.first + k) * columns + x.first..]
                .first_chunk()
                .expect("a stencil")
        };
        Some(Self {
            lines: std::array::from_fn(line),
            x,
            y,
        })
    }

    /// The vertices that the first halving adds, in the order of
    /// [`group`](super::subdivision_cache::group), px.
    pub(super) fn halves(&self) -> [[f32; 2]; 5] {
        // Down first and then across: five vertices share three lines.
        let [above, middle, below] = [0, 2, 4].map(|quarter| self.line(quarter));
        [
            self.at(2, &above),
            self.at(0, &middle),
            self.at(2, &middle),
            self.at(4, &middle),
            self.at(2, &below),
        ]
    }

    /// The vertices that the second halving adds, in the same order.
    pub(super) fn quarters(&self) -> [[f32; 2]; 16] {
        let lines: [_; 5] = std::array::from_fn(|quarter| self.line(quarter));
        let mut added = super::subdivision_cache::group(2)
            .map(|(a, b)| self.at(a as usize, &lines[b as usize]));
        std::array::from_fn(|_| added.next().expect("sixteen"))
    }

    /// The nodes of all columns at a quarter of the cell's height.
    fn line(&self, quarter: usize) -> [[f32; 2]; QUINTIC_NODES] {
        let AxisStencil {
            nodes, position, ..
        } = self.y;
        let columns = |line: &'a [[f32; 2]; STENCIL_VERTICES]| -> &'a [[f32; 2]; QUINTIC_NODES] {
            line[self.x.nodes..].first_chunk().expect("the nodes")
        };
        match quarter {
            // On a line of the grid the vertices themselves are taken, not weights of 0 and 1:
            // shared edges must be equal to the last bit.
            0 => *columns(self.lines[nodes + position]),
            4 => *columns(self.lines[nodes + position + 1]),
            _ => {
                let mut sum = [[0.0; 2]; QUINTIC_NODES];
                for (weight, line) in NODE_WEIGHTS[position][quarter - 1]
                    .iter()
                    .zip(&self.lines[nodes..])
                {
                    for (sum, d) in sum
                        .as_flattened_mut()
                        .iter_mut()
                        .zip(columns(line).as_flattened())
                    {
                        *sum += weight * d;
                    }
                }
                sum
            }
        }
    }

    /// The displacement at a quarter of the cell's width.
    fn at(&self, quarter: usize, line: &[[f32; 2]; QUINTIC_NODES]) -> [f32; 2] {
        let AxisStencil { position, .. } = self.x;
        match quarter {
            0 => line[position],
            4 => line[position + 1],
            _ => {
                let weights = &NODE_WEIGHTS[position][quarter - 1];
                weights
                    .iter()
                    .zip(line)
                    .fold([0.0; 2], |[x, y], (weight, d)| {
                        [x + weight * d[0], y + weight * d[1]]
                    })
            }
        }
    }

    /// How far interpolated vertices may be from f, px; infinite where the grid does not resolve
    /// it.
    pub(super) fn off(&self) -> f32 {
        let (left, top) = (self.x.cell(), self.y.cell());
        let rows = [top, top + 1].map(|b| differences::<2, 16>(self.lines[b].as_flattened()));
        let (fourth_x, sixth_x) = (
            largest(rows.iter().flat_map(|row| &row.0[2..6])),
            largest(rows.iter().flat_map(|row| &row.1[..4])),
        );
        // The columns at both sides of the cell, two numbers of each in turn, so that one pass
        // takes the differences of both.
        let mut columns = [0.0; 32];
        for (column, line) in columns.chunks_exact_mut(4).zip(self.lines) {
            column.copy_from_slice(line[left..left + 2].as_flattened());
        }
        let columns = differences::<4, 32>(&columns);
        let (fourth_y, sixth_y) = (largest(&columns.0[4..12]), largest(&columns.1[..8]));
        interpolation_error(
            [fourth_x, fourth_y],
            [sixth_x, sixth_y],
            [self.x.position, self.y.position],
        )
    }

    /// The largest distance between vertices of the first halving and the patch of the cell, px.
    pub(super) fn error(corners: [[f32; 2]; 4], halves: &[[f32; 2]; 5]) -> f32 {
        let [a, b, c, d] = corners;
        let mean = |a: [f32; 2], b: [f32; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let (above, below) = (mean(a, b), mean(c, d));
        let patch = [above, mean(a, c), mean(above, below), mean(b, d), below];
        let off = |(a, b): (&[f32; 2], [f32; 2])| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
        halves
            .iter()
            .zip(patch)
            .map(off)
            .fold(0.0_f32, f32::max)
            .sqrt()
    }
}

/// The fourth and sixth differences of eight values of `COMPONENTS` numbers each; what lies beyond
/// them is meaningless.
fn differences<const COMPONENTS: usize, const N: usize>(values: &[f32]) -> ([f32; N], [f32; N]) {
    let second = |of: &[f32; N], len: usize| {
        let mut out = [0.0; N];
        for k in 0..len * COMPONENTS {
            out[k] = of[k] - 2.0 * of[k + COMPONENTS] + of[k + 2 * COMPONENTS];
        }
        out
    };
    let fourth = second(
        &second(
            values.try_into().expect("eight values"),
            STENCIL_VERTICES - 2,
        ),
        STENCIL_VERTICES - 4,
    );
    let sixth = second(&fourth, STENCIL_VERTICES - 6);
    (fourth, sixth)
}

/// The length of the longest vector; `numbers` are x and y in turn.
fn largest<'a>(numbers: impl IntoIterator<Item = &'a f32>) -> f32 {
    let (mut numbers, mut largest) = (numbers.into_iter(), 0.0_f32);
    while let (Some(x), Some(y)) = (numbers.next(), numbers.next()) {
        largest = largest.max(x * x + y * y);
    }
    largest.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::subdivision_cache::group;

    fn mesh(f: impl Fn(f32, f32) -> [f32; 2]) -> (Mesh, EvenLines) {
        let grid = Grid::with_counts(120.0, 100.0, 13, 11);
        let vertices = (0..11_u8).flat_map(|j| (0..13_u8).map(move |i| (i, j)));
        let mesh = Mesh::new(
            grid,
            vertices
                .map(|(i, j)| f(f32::from(i), f32::from(j)))
                .collect(),
        );
        let even = EvenLines::of(mesh.grid());
        (mesh, even)
    }

    /// The largest distance between the vertices of a cell and a function of its lines.
    fn worst(cell: &Interpolated<'_>, (i, j): (u32, u32), f: impl Fn(f32, f32) -> [f32; 2]) -> f32 {
        let vertices = [cell.halves().to_vec(), cell.quarters().to_vec()];
        let levels = (1..=2)
            .zip(&vertices)
            .flat_map(|(level, vertices)| group(level).map(move |at| (level, at)).zip(vertices));
        levels.fold(0.0, |worst, ((level, (a, b)), vertex)| {
            let share = |k: u32| k as f32 / f32::from(1_u8 << level);
            let want = f(i as f32 + share(a), j as f32 + share(b));
            worst.max((vertex[0] - want[0]).hypot(vertex[1] - want[1]))
        })
    }

    #[test]
    fn quintics_are_interpolated_exactly() {
        let quintic = |x: f32, y: f32| {
            let (x, y) = (x / 6.0, y / 6.0);
            [x.powi(5) - y * y + x * y, 2.0 * y.powi(5) - x.powi(3) * y]
        };
        let (mesh, even) = mesh(quintic);
        for (i, j) in (0..10).flat_map(|j| (0..12).map(move |i| (i, j))) {
            let cell = Interpolated::new(&mesh, even, i, j).unwrap();
            assert!(
                worst(&cell, (i, j), quintic) < 2e-4,
                "{i} {j}: {}",
                worst(&cell, (i, j), quintic)
            );
            assert!(cell.off() < 2e-4, "{i} {j}: {}", cell.off());
        }
    }

    #[test]
    fn what_else_is_off_is_bounded_and_what_is_not_resolved_is_infinite() {
        let wave = |x: f32, y: f32| [(0.7 * x + 0.2 * y).sin(), (0.3 * x - 0.9 * y).cos()];
        let (smooth, even) = mesh(wave);
        for (i, j) in (0..10).flat_map(|j| (0..12).map(move |i| (i, j))) {
            let cell = Interpolated::new(&smooth, even, i, j).unwrap();
            let worst = worst(&cell, (i, j), wave);
            assert!(
                worst <= cell.off() && cell.off() < 20.0 * worst,
                "{i} {j}: {worst} {}",
                cell.off()
            );
        }
        let steep = mesh(|x, y| [(2.5 * x).sin(), (2.9 * y).cos()]).0;
        assert!(
            Interpolated::new(&steep, even, 5, 4)
                .unwrap()
                .off()
                .is_infinite()
        );
    }

    #[test]
    fn the_last_line_is_left_out_if_it_is_nearer() {
        for (width, columns) in [(120.0, 25), (118.0, 24)] {
            let grid = Grid::with_cell(width, 60.0, 5.0);
            let even = EvenLines::of(&grid);
            assert_eq!((even.columns, even.rows), (columns, 13));
            let mesh = Mesh::new(grid, vec![[1.0, 2.0]; grid.len()]);
            let cell = |i: u32| Interpolated::new(&mesh, even, i, 3);
            assert!(cell(22).is_some());
            assert_eq!(cell(23).is_some(), columns == 25);
            assert_eq!(cell(22).unwrap().halves(), [[1.0, 2.0]; 5]);
        }
        let few = Grid::with_counts(50.0, 50.0, 7, 30);
        let mesh = Mesh::new(few, vec![[0.0; 2]; few.len()]);
        assert!(Interpolated::new(&mesh, EvenLines::of(&few), 3, 3).is_none());
    }

    #[test]
    fn the_error_of_a_patch_is_that_of_its_worst_vertex() {
        let corners = [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [4.0, 4.0]];
        let flat = [[2.0, 0.0], [0.0, 2.0], [2.0, 2.0], [4.0, 2.0], [2.0, 4.0]];
        assert_eq!(Interpolated::error(corners, &flat), 0.0);
        let mut bent = flat;
        bent[3] = [7.0, 6.0];
        assert_eq!(Interpolated::error(corners, &bent), 5.0);
    }
}
