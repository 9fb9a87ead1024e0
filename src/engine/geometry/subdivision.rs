//! The cells of a posed grid that are drawn as smaller cells, because their bilinear patch would be
//! too far from the map.

use super::{Grid, Point, Vec2};

/// A cell of the grid that is drawn as `2^level x 2^level` cells of equal size at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SubdividedCell {
    /// Column of the cell.
    pub column: u32,
    /// Row of the cell.
    pub row: u32,
    /// The cell is halved this many times, at least once.
    pub level: u8,
    /// The same for its edges, top, right, bottom, left: the least of both cells at an edge.
    /// Vertices on an edge that is halved fewer times than the cell lie on the straight lines
    /// between those of the edge, so neighbours agree on all of it.
    pub edges: [u8; 4],
    /// Index of the first of its displacements.
    start: usize,
}

impl SubdividedCell {
    /// Vertices along a side.
    #[must_use]
    pub const fn side(&self) -> usize {
        (1 << self.level) + 1
    }
}

/// The subdivided cells of a mesh, row by row, and the displacements of their vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct Subdivision {
    cells: Vec<SubdividedCell>,
    displacement: Vec<[f32; 2]>,
    drawn_within: f32,
}

impl Default for Subdivision {
    fn default() -> Self {
        Self::NONE
    }
}

impl Subdivision {
    /// No cell is subdivided.
    pub const NONE: Self = Self::new(1.0 / 16.0);

    /// No cell yet, and the largest distance between what is drawn and the patch of a cell of any
    /// size, px of the source.
    #[must_use]
    pub const fn new(drawn_within: f32) -> Self {
        Self {
            cells: Vec::new(),
            displacement: Vec::new(),
            drawn_within,
        }
    }

    /// Makes room for cells and their vertices.
    pub fn reserve(&mut self, cells: usize, vertices: usize) {
        self.cells.reserve_exact(cells);
        self.displacement.reserve_exact(vertices);
    }

    /// The vertices of all cells.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.displacement.len()
    }

    /// The largest distance between what is drawn and the patch of a cell, px of the source.
    #[must_use]
    pub const fn drawn_within(&self) -> f32 {
        self.drawn_within
    }

    /// Appends a cell, which must come after all others. Shapes:
    /// `vertices: [2^level + 1][2^level + 1]`. The edges are as fine as the cell until
    /// [`Subdivision::join`]. Returns the cell's copy of its vertices.
    ///
    /// # Panics
    /// If `vertices` does not have the size of its shape.
    pub fn push(
        &mut self,
        column: u32,
        row: u32,
        level: u8,
        vertices: &[[f32; 2]],
    ) -> &mut [[f32; 2]] {
        let cell = SubdividedCell {
            column,
            row,
            level,
            edges: [level; 4],
            start: self.displacement.len(),
        };
        assert_eq!(
            vertices.len(),
            cell.side() * cell.side(),
            "one displacement per vertex"
        );
        self.cells.push(cell);
        self.displacement.extend_from_slice(vertices);
        &mut self.displacement[cell.start..]
    }

    /// Makes neighbours agree on their common edges: each edge gets the lesser level of both cells.
    /// `outer(cell, edge)` is the level of an edge on the border of the grid, at most the cell's.
    pub fn join(&mut self, grid: &Grid, outer: impl Fn(&SubdividedCell, usize) -> u8) {
        let (last_column, last_row) = (grid.columns() - 2, grid.rows() - 2);
        let at = |i: u32, j: u32| j as usize * (last_column as usize + 1) + i as usize;
        let mut levels = vec![0; at(0, last_row + 1)];
        for cell in &self.cells {
            levels[at(cell.column, cell.row)] = cell.level;
        }
        for index in 0..self.cells.len() {
            let cell = self.cells[index];
            let beyond = [
                cell.row == 0,
                cell.column == last_column,
                cell.row == last_row,
                cell.column == 0,
            ];
            let (i, j) = (cell.column, cell.row);
            let beside = |edge: usize| {
                levels[match edge {
                    0 => at(i, j - 1),
                    1 => at(i + 1, j),
                    2 => at(i, j + 1),
                    _ => at(i - 1, j),
                }]
            };
            let edges = std::array::from_fn(|edge| {
                if beyond[edge] {
                    outer(&cell, edge)
                } else {
                    beside(edge)
                }
                .min(cell.level)
            });
            self.cells[index].edges = edges;
        }
        for cell in &self.cells {
            let side = cell.side();
            let vertices = &mut self.displacement[cell.start..][..side * side];
            for (edge, &level) in cell
                .edges
                .iter()
                .enumerate()
                .filter(|(_, level)| **level < cell.level)
            {
                // Index of the k-th vertex of an edge.
                let at = |k: usize| match edge {
                    0 => k,
                    1 => k * side + side - 1,
                    2 => (side - 1) * side + k,
                    _ => k * side,
                };
                let step = 1 << (cell.level - level);
                for first in (0..side - 1).step_by(step) {
                    let (from, to) = (vertices[at(first)], vertices[at(first + step)]);
                    for k in 1..step {
                        #[expect(clippy::cast_precision_loss, reason = "at most 2^level")]
                        let share = k as f32 / step as f32;
                        vertices[at(first + k)] =
                            [0, 1].map(|c| from[c] + (to[c] - from[c]) * share);
                    }
                }
            }
        }
    }

    /// Whether no cell is subdivided.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The subdivided cells, row by row.
    #[must_use]
    pub fn cells(&self) -> &[SubdividedCell] {
        &self.cells
    }

    /// Displacements of the vertices of a cell, `[2^level + 1][2^level + 1]`, px.
    #[must_use]
    pub fn displacement(&self, cell: &SubdividedCell) -> &[[f32; 2]] {
        &self.displacement[cell.start..][..cell.side() * cell.side()]
    }

    /// The posed vertices of a cell, `[2^level + 1][2^level + 1]`.
    pub fn posed<'a>(
        &'a self,
        grid: &'a Grid,
        cell: &SubdividedCell,
    ) -> impl Iterator<Item = Point> + 'a {
        let (from, to) = (
            grid.vertex(cell.column, cell.row),
            grid.vertex(cell.column + 1, cell.row + 1),
        );
        let side = cell.side();
        #[expect(clippy::cast_precision_loss, reason = "a few vertices")]
        let share = move |k: usize| k as f64 / (side - 1) as f64;
        self.displacement(cell)
            .iter()
            .enumerate()
            .map(move |(k, d)| {
                let (s, t) = (share(k % side), share(k / side));
                let rest = Point::new(from.x + (to.x - from.x) * s, from.y + (to.y - from.y) * t);
                rest + Vec2::new(f64::from(d[0]), f64::from(d[1]))
            })
    }

    /// The subdivided cell at a column and row.
    #[must_use]
    pub fn find(&self, column: u32, row: u32) -> Option<&SubdividedCell> {
        self.cells
            .binary_search_by_key(&(row, column), |cell| (cell.row, cell.column))
            .ok()
            .map(|index| &self.cells[index])
    }

    /// The displacement at `(s, t)` of a subdivided cell, each in [0, 1].
    #[must_use]
    pub fn displaced(&self, cell: &SubdividedCell, s: f64, t: f64) -> Vec2 {
        Self::displaced_in(self.displacement(cell), cell.side(), s, t)
    }

    /// The displacement at `(s, t)` of a lattice of `side x side` vertices at equal distances, by
    /// the bilinear patch of its cell there.
    #[must_use]
    pub fn displaced_in(vertices: &[[f32; 2]], side: usize, s: f64, t: f64) -> Vec2 {
        #[expect(clippy::cast_precision_loss, reason = "a few vertices")]
        let cells = (side - 1) as f64;
        let along = |share: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "float to integer saturates"
            )]
            let k = ((share * cells) as usize).min(side - 2);
            #[expect(clippy::cast_precision_loss, reason = "a few vertices")]
            (k, share * cells - k as f64)
        };
        let ((i, s), (j, t)) = (along(s), along(t));
        let at = |i: usize, j: usize| {
            let [x, y] = vertices[j * side + i];
            Vec2::new(f64::from(x), f64::from(y))
        };
        let top = at(i, j) * (1.0 - s) + at(i + 1, j) * s;
        let bottom = at(i, j + 1) * (1.0 - s) + at(i + 1, j + 1) * s;
        top * (1.0 - t) + bottom * t
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_agree_on_their_edge() {
        let grid = Grid::with_counts(40.0, 20.0, 5, 3);
        let mut subdivision = Subdivision::default();
        let wave = |x: f32, y: f32| [(x * 0.3 + y).sin(), (x - 0.2 * y).cos()];
        for (column, row, level) in [(0_u8, 0_u8, 1_u8), (1, 0, 3), (2, 1, 2)] {
            let parts = 1_u8 << level;
            let at = |k: u8, first: u8| 10.0 * (f32::from(first) + f32::from(k) / f32::from(parts));
            let vertices: Vec<_> = (0..=parts)
                .flat_map(|b| (0..=parts).map(move |a| wave(at(a, column), at(b, row))))
                .collect();
            subdivision.push(column.into(), row.into(), level, &vertices);
        }
        subdivision.join(&grid, |cell, _| cell.level);
        let cells = subdivision.cells();
        assert_eq!(
            cells.iter().map(|cell| cell.edges).collect::<Vec<_>>(),
            [[1, 1, 0, 1], [3, 0, 0, 1], [0, 0, 2, 0]]
        );
        for k in 0..=100 {
            let t = f64::from(k) / 100.0;
            let (left, right) = (
                subdivision.displaced(&cells[0], 1.0, t),
                subdivision.displaced(&cells[1], 0.0, t),
            );
            assert!((left - right).norm() < 1e-6, "{left:?} {right:?}");
        }
        // An edge beside a cell that is not subdivided is straight.
        let (a, b) = (
            subdivision.displaced(&cells[2], 0.0, 0.0),
            subdivision.displaced(&cells[2], 1.0, 0.0),
        );
        assert!(
            (subdivision.displaced(&cells[2], 0.25, 0.0) - (a * 0.75 + b * 0.25)).norm() < 1e-6
        );
        assert_eq!(subdivision.find(1, 0), Some(&cells[1]));
        assert_eq!(subdivision.find(3, 0), None);
    }
}
