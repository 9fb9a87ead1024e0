//! A grid of which only some cells are drawn, and some several times: one quad for each piece of
//! the subject in a cell. Quads that do not belong together share no vertex.

use std::sync::Arc;

use super::{Grid, Point, Vec2};

/// A quad: a cell of the grid with four vertices of its own or shared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CutCell {
    /// Column and row of the cell.
    pub cell: [u32; 2],
    /// Its vertices: top left, top right, bottom right, bottom left.
    pub vertices: [u32; 4],
    /// Which set of texels it draws; `None`: all of its cell.
    pub texels: Option<u32>,
    /// Whether it is dust beside the subject: it is drawn before all others, so that it never
    /// covers what is moved onto it, and it counts as no fold.
    pub is_loose: bool,
}

/// The quads of a cut grid at rest, in the order in which they are drawn.
#[derive(Debug)]
pub struct CutCells {
    grid: Grid,
    /// Pixels along a side of a cell.
    side: u32,
    cells: Vec<CutCell>,
    /// The first quad of each cell of the grid, row by row, and the number of all.
    first: Vec<u32>,
    /// Column and row of the grid's vertex at which each vertex rests.
    vertices: Vec<[u32; 2]>,
    /// Sets of texels of a cell, one bit each, row by row.
    texels: Vec<u64>,
}

impl CutCells {
    /// Shapes: `cells` ordered by row and column; their vertices are indices of `vertices`, which
    /// are vertices of `grid`. Its cells have `side` pixels a side, the last ones fewer; `texels`
    /// has `(side * side).div_ceil(64)` words for each set.
    ///
    /// # Panics
    /// If an index is out of range.
    #[must_use]
    pub fn new(
        grid: Grid,
        side: u32,
        cells: Vec<CutCell>,
        vertices: Vec<[u32; 2]>,
        texels: Vec<u64>,
    ) -> Self {
        let (columns, rows) = (grid.columns() as usize - 1, grid.rows() as usize - 1);
        let mut first = vec![0_u32; columns * rows + 1];
        for cell in &cells {
            let at = cell.cell[1] as usize * columns + cell.cell[0] as usize;
            first[at + 1] += 1;
            assert!(
                cell.vertices
                    .iter()
                    .all(|vertex| (*vertex as usize) < vertices.len()),
                "vertices are those of the grid"
            );
        }
        for at in 1..first.len() {
            first[at] += first[at - 1];
        }
        Self {
            grid,
            side,
            cells,
            first,
            vertices,
            texels,
        }
    }

    /// The grid at rest.
    #[must_use]
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The quads, in the order in which they are drawn.
    #[must_use]
    pub fn cells(&self) -> &[CutCell] {
        &self.cells
    }

    /// Pixels along a side of a cell.
    #[must_use]
    pub const fn side(&self) -> u32 {
        self.side
    }

    /// Number of vertices.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Whether there is nothing to draw.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }

    /// A vertex at rest.
    #[must_use]
    pub fn vertex(&self, vertex: u32) -> Point {
        let [column, row] = self.vertices[vertex as usize];
        self.grid.vertex(column, row)
    }

    /// Whether a quad draws a texel of its cell, counted from the cell's first one.
    #[must_use]
    pub fn draws(&self, cell: &CutCell, x: u32, y: u32) -> bool {
        let words = (self.side as usize * self.side as usize).div_ceil(64);
        cell.texels.is_none_or(|set| {
            let bit = (y * self.side + x) as usize;
            self.texels[set as usize * words + bit / 64] >> (bit % 64) & 1 != 0
        })
    }

    /// The quads of a cell of the grid.
    #[must_use]
    pub fn of_cell(&self, column: u32, row: u32) -> &[CutCell] {
        let at = row as usize * (self.grid.columns() as usize - 1) + column as usize;
        &self.cells[self.first[at] as usize..self.first[at + 1] as usize]
    }

    /// The number of the first quad of a cell of the grid.
    pub(super) fn first_of_cell(&self, column: u32, row: u32) -> usize {
        let at = row as usize * (self.grid.columns() as usize - 1) + column as usize;
        self.first[at] as usize
    }

    /// The quad that draws a position at rest, and the position in it, each share in [0, 1].
    #[must_use]
    pub fn locate(&self, p: Point) -> Option<(&CutCell, f64, f64)> {
        let (i, j, s, t) = self.grid.locate(p)?;
        let (x, y) = (self.texel(p.x, i), self.texel(p.y, j));
        let quad = self
            .of_cell(i, j)
            .iter()
            .rev()
            .find(|cell| self.draws(cell, x, y))?;
        Some((quad, s, t))
    }

    /// Whether a position at rest is drawn by a quad, or by one that shares a vertex with it.
    #[must_use]
    pub fn is_beside(&self, quad: &CutCell, p: Point) -> bool {
        self.locate(p).is_some_and(|(other, ..)| {
            let mut vertices = other.vertices.iter();
            vertices.any(|vertex| quad.vertices.contains(vertex))
        })
    }

    /// The pixel of a cell that has a position, along one axis.
    fn texel(&self, position: f64, cell: u32) -> u32 {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "float to integer saturates"
        )]
        let pixel = position as u32;
        pixel.saturating_sub(cell * self.side).min(self.side - 1)
    }

    /// Memory, bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.cells)
            + size_of_val(&*self.first)
            + size_of_val(&*self.vertices)
            + size_of_val(&*self.texels)) as u64
    }
}

/// The quads of a mesh and the displacements of their vertices.
#[derive(Clone, Debug)]
pub struct CutMesh {
    cells: Arc<CutCells>,
    displacement: Vec<[f32; 2]>,
}

impl CutMesh {
    /// # Panics
    /// If `displacement` does not hold one entry per vertex.
    #[must_use]
    pub fn new(cells: Arc<CutCells>, displacement: Vec<[f32; 2]>) -> Self {
        assert_eq!(
            displacement.len(),
            cells.len(),
            "one displacement per vertex"
        );
        Self {
            cells,
            displacement,
        }
    }

    /// The quads at rest.
    #[must_use]
    pub const fn cells(&self) -> &Arc<CutCells> {
        &self.cells
    }

    /// Displacements of the vertices, px.
    #[must_use]
    pub fn displacement(&self) -> &[[f32; 2]] {
        &self.displacement
    }

    /// The quads of the subject, without dust.
    pub(super) fn of_subject(&self) -> impl Iterator<Item = &CutCell> {
        self.cells.cells.iter().filter(|quad| !quad.is_loose)
    }

    pub(super) fn displaced(&self, vertex: u32) -> Vec2 {
        let [x, y] = self.displacement[vertex as usize];
        Vec2::new(f64::from(x), f64::from(y))
    }

    /// The posed vertices of a quad.
    #[must_use]
    pub fn posed(&self, cell: &CutCell) -> [Point; 4] {
        // `map` of arrays is a call for each element here.
        let at = |vertex| self.cells.vertex(vertex) + self.displaced(vertex);
        let [a, b, c, d] = cell.vertices;
        [at(a), at(b), at(c), at(d)]
    }

    /// The drawn position of a position at rest; `None` where nothing is drawn.
    #[must_use]
    pub fn map(&self, p: Point) -> Option<Point> {
        let (cell, s, t) = self.cells.locate(p)?;
        let [a, b, c, d] = cell.vertices.map(|vertex| self.displaced(vertex));
        let (top, bottom) = (a * (1.0 - s) + b * s, d * (1.0 - s) + c * s);
        Some(p + top * (1.0 - t) + bottom * t)
    }
}
