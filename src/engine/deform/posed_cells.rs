//! The cells of a posed grid, numbered row by row: their sizes, corners and neighbours.

use crate::geometry::Mesh;

/// The cells of one mesh.
#[derive(Clone, Copy, Debug)]
pub(super) struct PosedCells<'a> {
    mesh: &'a Mesh,
    columns: u32,
    rows: u32,
}

impl<'a> PosedCells<'a> {
    pub(super) const fn of(mesh: &'a Mesh) -> Self {
        Self {
            mesh,
            columns: mesh.grid().columns() - 1,
            rows: mesh.grid().rows() - 1,
        }
    }

    /// Width and height of a cell at rest.
    #[expect(clippy::cast_possible_truncation, reason = "errors are f32")]
    pub(super) fn size(&self, cell: u32) -> [f32; 2] {
        let grid = self.mesh.grid();
        let (i, j) = (cell % self.columns, cell / self.columns);
        [
            (grid.x(i + 1) - grid.x(i)) as f32,
            (grid.y(j + 1) - grid.y(j)) as f32,
        ]
    }

    /// The displacements of the corners of a cell.
    pub(super) fn corners(&self, cell: u32) -> [[f32; 2]; 4] {
        let (across, columns) = (self.columns as usize, self.columns as usize + 1);
        let at = cell as usize / across * columns + cell as usize % across;
        let d = self.mesh.displacement();
        [d[at], d[at + 1], d[at + columns], d[at + columns + 1]]
    }

    /// The cells at the edges of a cell: top, right, bottom, left.
    pub(super) fn beside(&self, cell: u32) -> [Option<u32>; 4] {
        let (i, j) = (cell % self.columns, cell / self.columns);
        [
            (j > 0).then(|| cell - self.columns),
            (i + 1 < self.columns).then(|| cell + 1),
            (j + 1 < self.rows).then(|| cell + self.columns),
            (i > 0).then(|| cell - 1),
        ]
    }

    /// The neighbours of a cell in the chosen directions.
    pub(super) fn around<F: Fn(i32, i32) -> bool>(
        &self,
        cell: u32,
        is_chosen: F,
    ) -> impl Iterator<Item = u32> + use<F> {
        let (columns, rows) = (self.columns, self.rows);
        let (i, j) = (cell % columns, cell / columns);
        let directions = (-1..=1).flat_map(|dj| (-1..=1).map(move |di| (di, dj)));
        directions
            .filter(move |&(di, dj)| (di, dj) != (0, 0) && is_chosen(di, dj))
            .filter_map(move |(di, dj)| {
                Some((i.checked_add_signed(di)?, j.checked_add_signed(dj)?))
            })
            .filter(move |&(i, j)| i < columns && j < rows)
            .map(move |(i, j)| j * columns + i)
    }
}
