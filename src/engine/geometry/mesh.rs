//! The posed grid: the result of the mathematics and the input of the renderer.

use std::sync::Arc;

use super::{CutMesh, DrawingOrder, Grid, Point, Subdivision, Vec2};

/// A grid and the displacement of each of its vertices. Every cell is drawn as its bilinear patch,
/// or as those of the smaller cells of its [`Subdivision`].
///
/// Displacements are f32: a displacement is small relative to a position, so the posed position
/// `rest + displacement`, added in f64, keeps its precision on images of any size (absolute f32
/// positions would be off by 8e-3 px at 1e5 px).
#[derive(Clone, Debug)]
pub struct Mesh {
    grid: Grid,
    displacement: Vec<[f32; 2]>,
    subdivision: Subdivision,
    cut: Option<CutMesh>,
    order: Option<Arc<DrawingOrder>>,
}

impl Mesh {
    /// Shapes: `displacement: [rows][columns]`, row-major, px.
    ///
    /// # Panics
    /// If `displacement` does not hold one entry per vertex.
    ///
    /// ```
    /// use mlswarp::geometry::{Grid, Mesh, Point};
    /// let grid = Grid::with_counts(100.0, 50.0, 3, 2);
    /// let mesh = Mesh::new(grid, vec![[10.0, 0.0]; 6]);
    /// assert_eq!(mesh.map(Point::new(25.0, 25.0)), Some(Point::new(35.0, 25.0)));
    /// ```
    #[must_use]
    pub fn new(grid: Grid, displacement: Vec<[f32; 2]>) -> Self {
        assert_eq!(
            displacement.len(),
            grid.len(),
            "one displacement per vertex"
        );
        Self {
            grid,
            displacement,
            subdivision: Subdivision::NONE,
            cut: None,
            order: None,
        }
    }

    /// The mesh that leaves every vertex at rest.
    #[must_use]
    pub fn identity(grid: Grid) -> Self {
        Self::new(grid, vec![[0.0; 2]; grid.len()])
    }

    /// The same mesh, whose cells are drawn in another order than row by row, if there is one: one
    /// of all cells of the grid, or of all quads of a cut grid.
    #[must_use]
    pub fn in_order(self, order: Option<Arc<DrawingOrder>>) -> Self {
        Self { order, ..self }
    }

    /// The order in which the cells are drawn, if it is not row by row.
    #[must_use]
    pub const fn order(&self) -> Option<&Arc<DrawingOrder>> {
        self.order.as_ref()
    }

    /// The place of what is drawn of a cell in the order of drawing, of a cut grid that of one of
    /// its quads; 0 if cells are drawn row by row.
    #[must_use]
    pub fn rank(&self, column: u32, row: u32, quad: usize) -> u32 {
        let cell = || row as usize * (self.grid.columns() as usize - 1) + column as usize;
        let index = |cut: &CutMesh| cut.cells().first_of_cell(column, row) + quad;
        self.order.as_ref().map_or(0, |order| {
            order.rank(self.cut.as_ref().map_or_else(cell, index))
        })
    }

    /// The same mesh, with some of its cells drawn as smaller ones.
    #[must_use]
    pub fn subdivided(self, subdivision: Subdivision) -> Self {
        Self {
            subdivision,
            ..self
        }
    }

    /// The mesh of a cut grid: its quads alone are drawn. A vertex of the grid has the displacement
    /// of the last quad there, and none where there is no quad.
    #[must_use]
    pub fn cut(cut: CutMesh) -> Self {
        let grid = *cut.cells().grid();
        let mut displacement = vec![[0.0; 2]; grid.len()];
        for cell in cut.cells().cells() {
            let [i, j] = cell.cell.map(|line| line as usize);
            let at = j * grid.columns() as usize + i;
            let below = at + grid.columns() as usize;
            for (at, vertex) in [at, at + 1, below + 1, below]
                .into_iter()
                .zip(cell.vertices)
            {
                displacement[at] = cut.displacement()[vertex as usize];
            }
        }
        Self {
            cut: Some(cut),
            ..Self::new(grid, displacement)
        }
    }

    /// The quads that are drawn instead of the cells of the grid, if it is cut.
    #[must_use]
    pub const fn cut_mesh(&self) -> Option<&CutMesh> {
        self.cut.as_ref()
    }

    /// The cells that are drawn as smaller ones.
    #[must_use]
    pub const fn subdivision(&self) -> &Subdivision {
        &self.subdivision
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

    /// Whether every vertex is exactly at rest.
    ///
    /// ```
    /// use mlswarp::geometry::{Grid, Mesh};
    /// assert!(Mesh::identity(Grid::with_cell(64.0, 64.0, 8.0)).is_identity());
    /// ```
    #[must_use]
    pub fn is_identity(&self) -> bool {
        let moved = self
            .cut
            .as_ref()
            .map_or(&*self.displacement, CutMesh::displacement);
        moved.iter().all(|d| *d == [0.0; 2]) && self.subdivision.is_empty()
    }

    /// Displacement of a vertex.
    #[must_use]
    pub fn displaced(&self, column: u32, row: u32) -> Vec2 {
        let [x, y] =
            self.displacement[row as usize * self.grid.columns() as usize + column as usize];
        Vec2::new(f64::from(x), f64::from(y))
    }

    /// A vertex posed.
    #[must_use]
    pub fn posed(&self, column: u32, row: u32) -> Point {
        self.grid.vertex(column, row) + self.displaced(column, row)
    }

    /// The drawn position of the rest position `p`: the bilinear patch of its cell, or of the
    /// smaller one. `None` outside the image, and where a cut grid draws nothing.
    #[must_use]
    pub fn map(&self, p: Point) -> Option<Point> {
        if let Some(cut) = &self.cut {
            return cut.map(p);
        }
        let (i, j, s, t) = self.grid.locate(p)?;
        if let Some(cell) = self.subdivision.find(i, j) {
            return Some(p + self.subdivision.displaced(cell, s, t));
        }
        let top = self.displaced(i, j) * (1.0 - s) + self.displaced(i + 1, j) * s;
        let bottom = self.displaced(i, j + 1) * (1.0 - s) + self.displaced(i + 1, j + 1) * s;
        Some(p + top * (1.0 - t) + bottom * t)
    }

    /// Left, top, right and bottom edge of the smallest box that contains all posed cells, px.
    /// `None` when cancelled, which is checked for each row.
    #[must_use]
    pub fn bounds(&self, cancelled: &dyn Fn() -> bool) -> Option<[f64; 4]> {
        if let Some(cut) = &self.cut {
            let cells = cut.cells().cells().iter();
            return (!cancelled()).then(|| bounds(cells.flat_map(|cell| cut.posed(cell))));
        }
        let mut all = bounds(
            self.subdivision
                .cells()
                .iter()
                .flat_map(|cell| self.subdivision.posed(&self.grid, cell)),
        );
        for row in 0..self.grid.rows() {
            if cancelled() {
                return None;
            }
            let of_row = bounds((0..self.grid.columns()).map(|column| self.posed(column, row)));
            all = [
                all[0].min(of_row[0]),
                all[1].min(of_row[1]),
                all[2].max(of_row[2]),
                all[3].max(of_row[3]),
            ];
        }
        Some(all)
    }

    /// The posed corners of what is drawn of a cell: its own, top left, top right, bottom right and
    /// bottom left; in a cut grid those of each of its quads.
    pub fn corners(&self, column: u32, row: u32) -> impl Iterator<Item = [Point; 4]> + '_ {
        let (i, j) = (column, row);
        let quads = self.cut.as_ref().map(|cut| {
            let quads = cut.cells().of_cell(i, j).iter();
            quads.map(move |quad| cut.posed(quad))
        });
        let own = self.cut.is_none().then(|| {
            [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| self.posed(i, j))
        });
        own.into_iter().chain(quads.into_iter().flatten())
    }

    /// Left, top, right and bottom edge of the smallest box that contains what is drawn of a posed
    /// cell, px.
    #[must_use]
    pub fn cell_bounds(&self, column: u32, row: u32) -> [f64; 4] {
        let (i, j) = (column, row);
        let corners = self.corners(i, j).flatten();
        let subdivided = self
            .subdivision
            .find(i, j)
            .into_iter()
            .flat_map(|cell| self.subdivision.posed(&self.grid, cell));
        bounds(corners.chain(subdivided))
    }

    /// The number of vertices, those of subdivided cells included.
    #[must_use]
    pub fn vertices(&self) -> u64 {
        let subdivided: usize = self
            .subdivision
            .cells()
            .iter()
            .map(|cell| cell.side() * cell.side())
            .sum();
        (self.grid.len() + subdivided) as u64
    }

    /// Whether a posed cell overlaps the rectangle with these edges (left, top, right, bottom);
    /// touching its border is not enough. A cell counts as the convex hull of its corners, which is
    /// exact for convex cells. Usually examines one vertex, at most every cell; `None` when
    /// cancelled, which is checked for each row.
    #[must_use]
    pub fn intersects(&self, rectangle: [f64; 4], cancelled: &dyn Fn() -> bool) -> Option<bool> {
        if let Some(cut) = &self.cut {
            let mut cells = cut.cells().cells().iter();
            return Some(cells.any(|cell| overlaps(cut.posed(cell), rectangle)));
        }
        let (columns, rows) = (self.grid.columns(), self.grid.rows());
        let [left, top, right, bottom] = rectangle;
        let middle = self.posed(columns / 2, rows / 2);
        if middle.x > left && middle.x < right && middle.y > top && middle.y < bottom {
            return Some(true);
        }
        let corners = |i, j| {
            [
                self.posed(i, j),
                self.posed(i + 1, j),
                self.posed(i, j + 1),
                self.posed(i + 1, j + 1),
            ]
        };
        for j in 0..rows - 1 {
            if cancelled() {
                return None;
            }
            if (0..columns - 1).any(|i| overlaps(corners(i, j), rectangle)) {
                return Some(true);
            }
        }
        Some(false)
    }
}

fn bounds(points: impl Iterator<Item = Point>) -> [f64; 4] {
    points.fold(
        [
            f64::INFINITY,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NEG_INFINITY,
        ],
        |[l, t, r, b], p| [l.min(p.x), t.min(p.y), r.max(p.x), b.max(p.y)],
    )
}

/// Whether the convex hull of four points and the rectangle with these edges (left, top, right,
/// bottom) share more than a border: no line along an edge of either separates them.
fn overlaps(corners: [Point; 4], [left, top, right, bottom]: [f64; 4]) -> bool {
    let range = |values: [f64; 4]| {
        values
            .into_iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (a.min(v), b.max(v))
            })
    };
    let apart = |(a, b): (f64, f64), (c, d): (f64, f64)| b <= c || d <= a;
    if apart(range(corners.map(|p| p.x)), (left, right))
        || apart(range(corners.map(|p| p.y)), (top, bottom))
    {
        return false;
    }
    let rectangle =
        [(left, top), (right, top), (left, bottom), (right, bottom)].map(|(x, y)| Point::new(x, y));
    // The edges of the hull are among the lines through two corners.
    let lines = (0..4).flat_map(|i| (0..i).map(move |k| (corners[i], corners[k])));
    let separates = |(a, b): (Point, Point)| {
        let across = |p: Point| (b - a).cross(p - a);
        a != b && apart(range(corners.map(across)), range(rectangle.map(across)))
    };
    !lines.into_iter().any(separates)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_intersects_the_picture_by_more_than_a_border() {
        let moved = |columns, rows, map: &dyn Fn(Point) -> Point| {
            let grid = Grid::with_counts(100.0, 80.0, columns, rows);
            let vertices = (0..rows).flat_map(|j| (0..columns).map(move |i| grid.vertex(i, j)));
            #[expect(clippy::cast_possible_truncation, reason = "small numbers")]
            let displacement = vertices
                .map(|p| map(p) - p)
                .map(|d| [d.x as f32, d.y as f32])
                .collect();
            let picture = [0.0, 0.0, grid.width(), grid.height()];
            Mesh::new(grid, displacement)
                .intersects(picture, &|| false)
                .unwrap()
        };
        for (columns, rows) in [(2, 2), (5, 4), (40, 30)] {
            let moved = |map: &dyn Fn(Point) -> Point| moved(columns, rows, map);
            let shifted = |x: f64, y: f64| moved(&|p| p + Vec2::new(x, y));
            for (x, y, meets) in [
                (0.0, 0.0, true),
                (99.0, 79.0, true),
                (-99.0, 0.0, true),
                (100.0, 0.0, false),
                (-100.0, 0.0, false),
                (0.0, 80.0, false),
                (0.0, -80.0, false),
                (1e6, -1e6, false),
            ] {
                assert_eq!(shifted(x, y), meets, "{columns} x {rows} by {x}, {y}");
            }
            // The image lies within a single cell, with no vertex in it.
            assert!(moved(&|p| Point::new(
                (p.x - 51.0) * 1e4,
                (p.y - 41.0) * 1e4
            )));
            // Turned by 45 degrees beside a corner: its box overlaps the image's, and it does
            // not.
            let turned = |far: f64| {
                moved(&|p| Point::new(far + (p.x - p.y) * 0.7, far + (p.x + p.y) * 0.7 - 63.0))
            };
            assert!(turned(90.0));
            let beside =
                |p: Point| Point::new(-40.0 + (p.x - p.y) * 0.5, -75.0 + (p.x + p.y) * 0.5);
            assert!(!moved(&beside), "{columns} x {rows}");
        }
    }
}
