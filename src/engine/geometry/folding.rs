//! Folds: a fold is a change of orientation against that of the whole. Most of the area keeps one
//! orientation, as at rest or mirrored; a cell with another one, or with none because its corners
//! turn both ways, is folded. So an exact mirror image has no folds.

use super::{CutMesh, Mesh, Point, Vec2};

/// Which way round a posed cell is, or most of a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Orientation {
    /// As at rest.
    #[default]
    Upright,
    /// Turned over, as in a mirror.
    Mirrored,
}

impl Orientation {
    /// Whether all corners of a cell turn this way. Its bilinear patch is then one-to-one: the
    /// Jacobian is affine in the parameters, so the extremes are at corners (mathematics section
    /// 9.1).
    #[must_use]
    pub fn is_kept(self, turns: [f64; 4]) -> bool {
        match self {
            Self::Upright => {
                (turns[0] > 0.0) & (turns[1] > 0.0) & (turns[2] > 0.0) & (turns[3] > 0.0)
            }
            Self::Mirrored => {
                (turns[0] < 0.0) & (turns[1] < 0.0) & (turns[2] < 0.0) & (turns[3] < 0.0)
            }
        }
    }

    /// The cross products at the corners of a cell with these edges: top, right, bottom, left.
    #[must_use]
    pub fn turns([top, right, bottom, left]: [Vec2; 4]) -> [f64; 4] {
        [
            top.cross(left),
            top.cross(right),
            bottom.cross(right),
            bottom.cross(left),
        ]
    }
}

/// The orientation of a mesh, and the number of cells that have another one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Folding {
    /// That of most of the area at rest.
    pub orientation: Orientation,
    /// Folded cells.
    pub cells: u64,
}

impl Mesh {
    /// The orientation of most of the area at rest, and the number of folded cells, equal to
    /// `folded_cells().count()`. `None` when cancelled, which is checked for each row.
    ///
    /// ```
    /// use mlswarp::geometry::{Grid, Mesh};
    /// // The middle column passes beyond the right one.
    /// let grid = Grid::with_counts(20.0, 10.0, 3, 2);
    /// let row = [[0.0; 2], [15.0, 0.0], [0.0; 2]];
    /// let mesh = Mesh::new(grid, [row, row].concat());
    /// assert_eq!(mesh.folding(&|| false).map(|folding| folding.cells), Some(1));
    /// ```
    #[must_use]
    pub fn folding(&self, cancelled: &dyn Fn() -> bool) -> Option<Folding> {
        let cells = u64::from(self.grid().columns() - 1) * u64::from(self.grid().rows() - 1);
        let of_subject = |cut: &CutMesh| cut.of_subject().count() as u64;
        let (mut upright, all) = (0, self.cut_mesh().map_or(cells, of_subject));
        self.each_cell(cancelled, |_, _, turns| {
            upright += u64::from(Orientation::Upright.is_kept(turns))
        })?;
        if upright == all {
            return Some(Folding::default());
        }
        let (mut mirrored, mut upright_area, mut mirrored_area) = (0, 0.0, 0.0);
        let grid = *self.grid();
        self.each_cell(cancelled, |i, j, turns| {
            let area = (grid.x(i + 1) - grid.x(i)) * (grid.y(j + 1) - grid.y(j));
            if Orientation::Upright.is_kept(turns) {
                upright_area += area;
            } else if Orientation::Mirrored.is_kept(turns) {
                (mirrored, mirrored_area) = (mirrored + 1, mirrored_area + area);
            }
        })?;
        let is_mirrored = mirrored_area > upright_area;
        let (orientation, kept) = if is_mirrored {
            (Orientation::Mirrored, mirrored)
        } else {
            (Orientation::Upright, upright)
        };
        Some(Folding {
            orientation,
            cells: all - kept,
        })
    }

    /// Column and row of each folded cell, row by row.
    pub fn folded_cells(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let orientation = self.folding(&|| false).unwrap_or_default().orientation;
        self.folded_against(orientation).into_iter()
    }

    /// Column and row of each folded cell of a mesh of this orientation, row by row.
    #[must_use]
    pub fn folded_against(&self, orientation: Orientation) -> Vec<(u32, u32)> {
        let mut folded = Vec::new();
        let all = self.each_cell(&|| false, |i, j, turns| {
            if !orientation.is_kept(turns) {
                folded.push((i, j));
            }
        });
        all.expect("nothing cancels it");
        // A cell that is cut has several quads.
        folded.dedup();
        folded
    }

    /// Whether a cell, or a quad of a cut one, is folded in a mesh of this orientation.
    #[must_use]
    pub fn is_folded(&self, i: u32, j: u32, orientation: Orientation) -> bool {
        let is_folded = |[a, b, c, d]: [Point; 4]| {
            !orientation.is_kept(Orientation::turns([b - a, c - b, c - d, d - a]))
        };
        let Some(cut) = self.cut_mesh() else {
            return self.corners(i, j).any(is_folded);
        };
        let mut of_subject = cut.cells().of_cell(i, j).iter();
        of_subject.any(|quad| !quad.is_loose && is_folded(cut.posed(quad)))
    }

    /// Calls `cell` with column, row and corner cross products of every cell; computes a row of
    /// edges at a time, because each edge belongs to two cells. `None` when cancelled.
    fn each_cell(
        &self,
        cancelled: &dyn Fn() -> bool,
        mut cell: impl FnMut(u32, u32, [f64; 4]),
    ) -> Option<()> {
        if let Some(cut) = self.cut_mesh() {
            for quad in cut.of_subject() {
                let [a, b, c, d] = cut.posed(quad);
                cell(
                    quad.cell[0],
                    quad.cell[1],
                    Orientation::turns([b - a, c - b, c - d, d - a]),
                );
            }
            return Some(());
        }
        let (grid, columns) = (self.grid(), self.grid().columns() as usize);
        let rest: Vec<f64> = (0..grid.columns()).map(|i| grid.x(i)).collect();
        let line = |j: u32, posed: &mut Vec<Point>, along: &mut Vec<Vec2>| {
            let (y, row) = (
                grid.y(j),
                &self.displacement()[j as usize * columns..][..columns],
            );
            posed.clear();
            posed.extend(
                rest.iter()
                    .zip(row)
                    .map(|(&x, d)| Point::new(x, y) + Vec2::new(f64::from(d[0]), f64::from(d[1]))),
            );
            along.clear();
            along.extend(posed.windows(2).map(|ab| ab[1] - ab[0]));
        };
        let (mut above, mut top, mut below, mut bottom, mut across) =
            (vec![], vec![], vec![], vec![], vec![]);
        line(0, &mut above, &mut top);
        for j in 1..grid.rows() {
            if cancelled() {
                return None;
            }
            line(j, &mut below, &mut bottom);
            across.clear();
            across.extend(above.iter().zip(&below).map(|(a, d)| *d - *a));
            for ((i, (top, bottom)), sides) in
                (0..).zip(top.iter().zip(&bottom)).zip(across.windows(2))
            {
                cell(
                    i,
                    j - 1,
                    Orientation::turns([*top, sides[1], *bottom, sides[0]]),
                );
            }
            std::mem::swap(&mut above, &mut below);
            std::mem::swap(&mut top, &mut bottom);
        }
        Some(())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::geometry::Grid;

    fn random(seed: u32) -> impl FnMut() -> f32 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f32::from((state >> 16) as u16) / 32_768.0 - 1.0
        }
    }

    /// A grid of 100 x 80 px whose vertices are moved at random.
    pub(in crate::geometry) fn shaken(columns: u32, rows: u32, reach: f32) -> Mesh {
        let (grid, mut random) = (Grid::with_counts(100.0, 80.0, columns, rows), random(7));
        let displacement = (0..grid.len()).map(|_| [random() * reach, random() * reach]);
        Mesh::new(grid, displacement.collect())
    }

    /// The same posed mesh in a mirror along the y axis.
    fn mirror(mesh: &Mesh) -> Mesh {
        let grid = *mesh.grid();
        let vertices = (0..grid.rows()).flat_map(|j| (0..grid.columns()).map(move |i| (i, j)));
        #[expect(clippy::cast_possible_truncation, reason = "small numbers")]
        let mirrored = vertices.map(|(i, j)| {
            let (posed, rest) = (mesh.posed(i, j), grid.vertex(i, j));
            [
                (grid.width() - posed.x - rest.x) as f32,
                (posed.y - rest.y) as f32,
            ]
        });
        Mesh::new(grid, mirrored.collect())
    }

    #[test]
    fn folded_cells_are_counted_as_they_are_listed() {
        for (columns, rows, reach) in [
            (2, 2, 30.0),
            (3, 5, 4.0),
            (40, 30, 0.5),
            (40, 30, 3.0),
            (17, 23, 1e30),
            (9, 9, 0.0),
        ] {
            let mut mesh = shaken(columns, rows, reach);
            let count = |mesh: &Mesh| mesh.folding(&|| false).unwrap().cells;
            // Each cell by itself: the count and the list share the pass over rows.
            let one_by_one = |mesh: &Mesh| {
                let orientation = mesh.folding(&|| false).unwrap().orientation;
                let cells = (0..rows - 1).flat_map(|j| (0..columns - 1).map(move |i| (i, j)));
                let folded = cells.filter(|&(i, j)| mesh.is_folded(i, j, orientation));
                folded.collect::<Vec<_>>()
            };
            assert!(
                mesh.folded_cells().eq(one_by_one(&mesh))
                    && count(&mesh) == one_by_one(&mesh).len() as u64,
                "{columns} x {rows}, {reach}"
            );
            // NaN folds what it touches.
            let mut displacement = mesh.displacement().to_vec();
            displacement[0][1] = f32::NAN;
            mesh = Mesh::new(*mesh.grid(), displacement);
            assert!(mesh.folded_cells().eq(one_by_one(&mesh)));
            assert_eq!(count(&mesh), one_by_one(&mesh).len() as u64);
            assert!(
                mesh.is_folded(0, 0, Orientation::Upright)
                    && mesh.is_folded(0, 0, Orientation::Mirrored)
            );
            assert_eq!(mesh.folding(&|| true), None);
        }
    }

    #[test]
    fn a_mesh_in_a_mirror_folds_in_the_same_cells() {
        for (reach, folds) in [(0.0, false), (0.5, false), (1.5, true), (2.2, true)] {
            let mesh = shaken(40, 30, reach);
            let (own, mirrored) = (
                mesh.folding(&|| false).unwrap(),
                mirror(&mesh).folding(&|| false).unwrap(),
            );
            assert_eq!(own.cells > 0, folds, "{reach}");
            assert_eq!(
                (own.orientation, mirrored.orientation),
                (Orientation::Upright, Orientation::Mirrored)
            );
            assert_eq!(own.cells, mirrored.cells, "{reach}");
            assert!(mesh.folded_cells().eq(mirror(&mesh).folded_cells()));
        }
    }

    #[test]
    fn the_orientation_is_that_of_most_of_the_area_at_rest() {
        // The columns of cells from `first` on are turned over; the last one is narrow.
        let turned = |first: f64| {
            let grid = Grid::with_cell(91.0, 40.0, 10.0);
            let vertices =
                (0..grid.rows()).flat_map(|j| (0..grid.columns()).map(move |i| grid.vertex(i, j)));
            #[expect(clippy::cast_possible_truncation, reason = "small numbers")]
            let displacement = vertices.map(|p| [(-2.0 * (p.x - first).max(0.0)) as f32, 0.0]);
            Mesh::new(grid, displacement.collect())
                .folding(&|| false)
                .unwrap()
        };
        assert_eq!(
            turned(90.0),
            Folding {
                orientation: Orientation::Upright,
                cells: 4
            }
        );
        assert_eq!(
            turned(50.0),
            Folding {
                orientation: Orientation::Upright,
                cells: 20
            }
        );
        assert_eq!(
            turned(40.0),
            Folding {
                orientation: Orientation::Mirrored,
                cells: 16
            }
        );
        assert_eq!(
            turned(0.0),
            Folding {
                orientation: Orientation::Mirrored,
                cells: 0
            }
        );
        // Nothing has an orientation.
        let flat = Mesh::new(
            Grid::with_counts(10.0, 10.0, 2, 2),
            vec![[0.0; 2], [-10.0, 0.0], [0.0; 2], [-10.0, 0.0]],
        );
        assert_eq!(
            flat.folding(&|| false),
            Some(Folding {
                orientation: Orientation::Upright,
                cells: 1
            })
        );
    }
}
