//! The posed grid: the only thing that the mathematics hands to the pixels.

use super::{Grid, Point, Vec2};

/// A grid and the displacement of each of its vertices. What is drawn is the bilinear patch of every cell.
///
/// Displacements are f32: a displacement is small beside a position, so the posed place `rest + displacement`, added in f64, keeps
/// its digits on images of any size (absolute f32 positions would be off by 8e-3 px at 1e5 px).
#[derive(Clone, Debug)]
pub struct Mesh {
    grid: Grid,
    displacement: Vec<[f32; 2]>,
}

impl Mesh {
    /// Shapes: `displacement: [rows][columns]`, row-major, px.
    ///
    /// # Panics
    /// If `displacement` does not hold one entry per vertex.
    #[must_use]
    pub fn new(grid: Grid, displacement: Vec<[f32; 2]>) -> Self {
        assert_eq!(displacement.len(), grid.len(), "one displacement per vertex");
        Self { grid, displacement }
    }

    /// The mesh that leaves every vertex at rest.
    #[must_use]
    pub fn identity(grid: Grid) -> Self {
        Self { grid, displacement: vec![[0.0; 2]; grid.len()] }
    }

    /// The grid at rest.
    #[must_use]
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Displacements, `[rows][columns]`, row-major, px.
    #[must_use]
    pub fn displacement(&self) -> &[[f32; 2]] {
        &self.displacement
    }

    /// Every vertex is exactly at rest.
    #[must_use]
    pub fn is_identity(&self) -> bool {
        self.displacement.iter().all(|d| *d == [0.0; 2])
    }

    /// Displacement of a vertex.
    #[must_use]
    pub fn displaced(&self, column: u32, row: u32) -> Vec2 {
        let [x, y] = self.displacement[row as usize * self.grid.columns() as usize + column as usize];
        Vec2::new(f64::from(x), f64::from(y))
    }

    /// A vertex posed.
    #[must_use]
    pub fn posed(&self, column: u32, row: u32) -> Point {
        self.grid.vertex(column, row) + self.displaced(column, row)
    }

    /// Where the drawn picture puts the rest place `p`: the bilinear patch of its cell. `None` outside the image.
    #[must_use]
    pub fn map(&self, p: Point) -> Option<Point> {
        let (i, j, s, t) = self.grid.locate(p)?;
        let top = self.displaced(i, j) * (1.0 - s) + self.displaced(i + 1, j) * s;
        let bottom = self.displaced(i, j + 1) * (1.0 - s) + self.displaced(i + 1, j + 1) * s;
        Some(p + top * (1.0 - t) + bottom * t)
    }

    /// Cells of which a corner's cross product is not positive: the bilinear patch is not one-to-one there
    /// (its Jacobian is affine in the parameters, so the minimum is at a corner). `(column, row)` of each, row by row.
    pub fn folded_cells(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let (columns, rows) = (self.grid.columns(), self.grid.rows());
        (0..rows - 1).flat_map(move |j| (0..columns - 1).filter(move |&i| self.is_folded(i, j)).map(move |i| (i, j)))
    }

    fn is_folded(&self, i: u32, j: u32) -> bool {
        let (a, b) = (self.posed(i, j), self.posed(i + 1, j));
        let (d, c) = (self.posed(i, j + 1), self.posed(i + 1, j + 1));
        let (top, right, bottom, left) = (b - a, c - b, c - d, d - a);
        !(top.cross(left) > 0.0 && top.cross(right) > 0.0 && bottom.cross(right) > 0.0 && bottom.cross(left) > 0.0)
    }
}
