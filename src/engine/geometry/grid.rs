//! The grid at rest: cells over the image rectangle `[0, W] x [0, H]`, lines at 0, c, 2c, ... and
//! the last exactly at W (H).

use super::Point;

/// A lattice of vertices over `[0, width] x [0, height]`, px. Vertices are numbered row by row,
/// `index = row * columns + column`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    width: f64,
    height: f64,
    cell_width: f64,
    cell_height: f64,
    columns: u32,
    rows: u32,
}

/// A line 0, cell, 2 cell, ... closer than this share of a cell to the far edge becomes the far
/// edge: the rounding of its f32 displacements alone would fold a thinner last cell.
const LAST_CELL_AT_LEAST: f64 = 1e-3;

impl Grid {
    /// Cells of `cell` px; the last column and row may be narrower. `width`, `height`, `cell` are
    /// positive and finite.
    ///
    /// ```
    /// use mlswarp::geometry::Grid;
    /// let grid = Grid::with_cell(100.0, 50.0, 20.0);
    /// // Vertices: one more than cells. The last row of cells has 10 px.
    /// assert_eq!((grid.columns(), grid.rows()), (6, 4));
    /// ```
    #[must_use]
    pub fn with_cell(width: f64, height: f64, cell: f64) -> Self {
        Self {
            width,
            height,
            cell_width: cell,
            cell_height: cell,
            columns: 1 + Self::cells_along(width, cell),
            rows: 1 + Self::cells_along(height, cell),
        }
    }

    /// `columns x rows` vertices at equal distances, both at least 2.
    #[must_use]
    pub fn with_counts(width: f64, height: f64, columns: u32, rows: u32) -> Self {
        let (columns, rows) = (columns.max(2), rows.max(2));
        Self {
            width,
            height,
            cell_width: width / f64::from(columns - 1),
            cell_height: height / f64::from(rows - 1),
            columns,
            rows,
        }
    }

    /// Every n-th line, and the last one, along both axes; `step` is at least 1.
    #[must_use]
    pub fn thinned(&self, step: usize) -> Self {
        let step = u32::try_from(step).unwrap_or(u32::MAX);
        let lines = |lines: u32| 1 + (lines - 1).div_ceil(step);
        let cell = |cell: f64| cell * f64::from(step);
        let (columns, rows) = (lines(self.columns), lines(self.rows));
        Self {
            cell_width: cell(self.cell_width),
            cell_height: cell(self.cell_height),
            columns,
            rows,
            ..*self
        }
    }

    /// Number of cells of `cell` px that cover `length` px; saturates, so that callers can compare
    /// it with a limit.
    #[must_use]
    pub fn cells_along(length: f64, cell: f64) -> u32 {
        let cells = (length / cell - LAST_CELL_AT_LEAST).ceil().max(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "float to integer saturates, and cells >= 1"
        )]
        let cells = cells as u32;
        cells.min(u32::MAX - 1)
    }

    /// Width of the rectangle, px.
    #[must_use]
    pub const fn width(&self) -> f64 {
        self.width
    }

    /// Height of the rectangle, px.
    #[must_use]
    pub const fn height(&self) -> f64 {
        self.height
    }

    /// Distance of neighbouring columns and rows, px (the last ones may be nearer).
    #[must_use]
    pub const fn cell(&self) -> (f64, f64) {
        (self.cell_width, self.cell_height)
    }

    /// Vertices in a row.
    #[must_use]
    pub const fn columns(&self) -> u32 {
        self.columns
    }

    /// Vertices in a column.
    #[must_use]
    pub const fn rows(&self) -> u32 {
        self.rows
    }

    /// Number of vertices.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.columns as usize * self.rows as usize
    }

    /// Always false: a grid has at least four vertices.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// x of a column, px.
    #[must_use]
    pub fn x(&self, column: u32) -> f64 {
        if column + 1 == self.columns {
            self.width
        } else {
            f64::from(column) * self.cell_width
        }
    }

    /// y of a row, px.
    #[must_use]
    pub fn y(&self, row: u32) -> f64 {
        if row + 1 == self.rows {
            self.height
        } else {
            f64::from(row) * self.cell_height
        }
    }

    /// A vertex at rest.
    #[must_use]
    pub fn vertex(&self, column: u32, row: u32) -> Point {
        Point::new(self.x(column), self.y(row))
    }

    /// The cell (its column and row) that contains `p`, and the position in it:
    /// `(column, row, s, t)` with s, t in [0, 1]; `None` outside the rectangle.
    ///
    /// ```
    /// use mlswarp::geometry::{Grid, Point};
    /// let grid = Grid::with_cell(100.0, 50.0, 20.0);
    /// assert_eq!(grid.locate(Point::new(25.0, 10.0)), Some((1, 0, 0.25, 0.5)));
    /// assert_eq!(grid.locate(Point::new(101.0, 10.0)), None);
    /// ```
    #[must_use]
    pub fn locate(&self, p: Point) -> Option<(u32, u32, f64, f64)> {
        if !(0.0..=self.width).contains(&p.x) || !(0.0..=self.height).contains(&p.y) {
            return None;
        }
        let (i, s) = locate_along(p.x, self.cell_width, self.columns, |k| self.x(k));
        let (j, t) = locate_along(p.y, self.cell_height, self.rows, |k| self.y(k));
        Some((i, j, s, t))
    }
}

fn locate_along(x: f64, cell: f64, lines: u32, line: impl Fn(u32) -> f64) -> (u32, f64) {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to integer saturates"
    )]
    let k = ((x / cell) as u32).min(lines - 2);
    let (a, b) = (line(k), line(k + 1));
    (k, ((x - a) / (b - a)).clamp(0.0, 1.0))
}
