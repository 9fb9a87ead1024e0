//! A tree of boxes over the posed cells of a mesh: finds the cells that may contain a posed
//! position. Each level has a box for every two by two of the level below. Memory: 22 bytes per
//! cell, 4 more with an order of drawing. Cost: O(cells) to build, O(boxes that contain the
//! position) to ask.

use std::ops::ControlFlow;

use super::{Mesh, Point};

/// Left, top, right, bottom, px; rounded outwards.
type Bounds = [f32; 4];

const EMPTY_BOX: Bounds = [
    f32::INFINITY,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::NEG_INFINITY,
];

/// The tree of one mesh.
#[derive(Debug)]
pub struct CellTree {
    /// The cells first, one box last.
    levels: Vec<TreeLevel>,
    /// The place of each cell in the order of drawing, if that is not row by row.
    ranks: Vec<u32>,
}

#[derive(Debug)]
struct TreeLevel {
    columns: usize,
    boxes: Vec<Bounds>,
}

impl CellTree {
    /// Builds the tree; the vertices of subdivided cells count as well.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let grid = mesh.grid();
        let (columns, rows) = (grid.columns() as usize - 1, grid.rows() as usize - 1);
        let mut boxes = vec![EMPTY_BOX; columns * rows];
        for (j, row) in (0..).zip(boxes.chunks_exact_mut(columns)) {
            for (i, cell) in (0..).zip(row) {
                for corner in mesh.corners(i, j).flatten() {
                    include(cell, corner);
                }
            }
        }
        for cell in mesh.subdivision().cells() {
            let bounds = &mut boxes[cell.row as usize * columns + cell.column as usize];
            mesh.subdivision()
                .posed(grid, cell)
                .for_each(|p| include(bounds, p));
        }
        let mut levels = vec![TreeLevel { columns, boxes }];
        while let Some(below) = levels.last().filter(|level| level.boxes.len() > 1) {
            let columns = below.columns.div_ceil(2);
            let mut boxes =
                vec![EMPTY_BOX; columns * (below.boxes.len() / below.columns).div_ceil(2)];
            for (k, child) in below.boxes.iter().enumerate() {
                let parent = &mut boxes[k / below.columns / 2 * columns + k % below.columns / 2];
                *parent = [
                    parent[0].min(child[0]),
                    parent[1].min(child[1]),
                    parent[2].max(child[2]),
                    parent[3].max(child[3]),
                ];
            }
            levels.push(TreeLevel { columns, boxes });
        }
        let rank = |(i, j)| {
            let quads = mesh.corners(i, j).count();
            (0..quads).map(|quad| mesh.rank(i, j, quad)).max()
        };
        let cells = (0..grid.rows() - 1).flat_map(|j| (0..grid.columns() - 1).map(move |i| (i, j)));
        let ranks = mesh.order().map_or_else(Vec::new, |_| {
            cells.map(|cell| rank(cell).unwrap_or_default()).collect()
        });
        Self { levels, ranks }
    }

    /// Indices of the cells, row by row, whose boxes contain a position or are at most `margin` px
    /// from it along each axis; the last cell first, as it is drawn over the others.
    pub fn find(&self, p: Point, margin: f64, cells: &mut Vec<usize>) {
        cells.clear();
        let _ = self.visit(
            [p.x - margin, p.y - margin, p.x + margin, p.y + margin],
            &mut |cell| {
                cells.push(cell);
                ControlFlow::Continue(())
            },
        );
        let rank = |cell: usize| self.ranks.get(cell).copied().unwrap_or_default();
        cells.sort_unstable_by_key(|cell| std::cmp::Reverse((rank(*cell), *cell)));
    }

    /// Passes the index of every cell whose box meets the box with these edges (left, top, right,
    /// bottom), in any order, until `cell` returns `Break`.
    pub fn visit(
        &self,
        edges: [f64; 4],
        cell: &mut impl FnMut(usize) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        self.descend(self.levels.len() - 1, 0, 0, edges, cell)
    }

    fn descend(
        &self,
        level: usize,
        i: usize,
        j: usize,
        edges: [f64; 4],
        cell: &mut impl FnMut(usize) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let TreeLevel { columns, boxes } = &self.levels[level];
        let index = j * columns + i;
        let [left, top, right, bottom] = boxes[index].map(f64::from);
        if edges[2] < left || edges[0] > right || edges[3] < top || edges[1] > bottom {
            return ControlFlow::Continue(());
        }
        let Some(below) = level.checked_sub(1) else {
            return cell(index);
        };
        let (columns, rows) = (
            self.levels[below].columns,
            self.levels[below].boxes.len() / self.levels[below].columns,
        );
        for (i, j) in [
            (2 * i, 2 * j),
            (2 * i + 1, 2 * j),
            (2 * i, 2 * j + 1),
            (2 * i + 1, 2 * j + 1),
        ] {
            if i < columns && j < rows {
                self.descend(below, i, j, edges, cell)?;
            }
        }
        ControlFlow::Continue(())
    }
}

fn include(bounds: &mut Bounds, p: Point) {
    #[expect(clippy::cast_possible_truncation, reason = "rounded outwards")]
    let (x, y) = (p.x as f32, p.y as f32);
    *bounds = [
        bounds[0].min(x.next_down()),
        bounds[1].min(y.next_down()),
        bounds[2].max(x.next_up()),
        bounds[3].max(y.next_up()),
    ];
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn cells_are_those_of_a_search_of_all() {
        let mut state = 7_u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f32::from((state >> 16) as u16) / 32_768.0 - 1.0
        };
        for (columns, rows, reach) in [
            (2, 2, 3.0),
            (2, 9, 3.0),
            (17, 5, 20.0),
            (40, 33, 1.0),
            (33, 32, 200.0),
        ] {
            let grid = Grid::with_counts(100.0, 80.0, columns, rows);
            let mesh = Mesh::new(
                grid,
                (0..grid.len())
                    .map(|_| [reach * noise(), reach * noise()])
                    .collect(),
            );
            let tree = CellTree::new(&mesh);
            let mut found = Vec::new();
            for _ in 0..200 {
                let p = Point::new(
                    50.0 + 90.0 * f64::from(noise()),
                    40.0 + 80.0 * f64::from(noise()),
                );
                for margin in [0.0, 1.0] {
                    tree.find(p, margin, &mut found);
                    let is_in = |i: u32, j: u32| {
                        let corners = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)]
                            .map(|(i, j)| mesh.posed(i, j));
                        let within = |at: fn(&Point) -> f64, value: f64| {
                            let low = corners.iter().map(at).fold(f64::INFINITY, f64::min);
                            let high = corners.iter().map(at).fold(f64::NEG_INFINITY, f64::max);
                            (low - margin..=high + margin).contains(&value)
                        };
                        within(|p| p.x, p.x) && within(|p| p.y, p.y)
                    };
                    let cells = (0..rows - 1).flat_map(|j| (0..columns - 1).map(move |i| (i, j)));
                    let mut want: Vec<usize> = cells
                        .filter(|&(i, j)| is_in(i, j))
                        .map(|(i, j)| (j * (columns - 1) + i) as usize)
                        .collect();
                    want.reverse();
                    assert_eq!(found, want, "{columns} x {rows}, {reach}: {p:?}");
                }
            }
        }
    }
}
