//! A tree of boxes over the posed cells of a mesh: finds the cells that may contain a posed
//! position. Each level has a box for every two by two of the level below. Memory: 22 bytes per
//! cell, 6 more with an order of drawing. Cost: O(cells) to build, O(boxes that contain the
//! position) to ask.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
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

/// Subdivided cells between two questions whether the tree is still wanted.
const SUBDIVIDED_CELLS_PER_LOOK: usize = 64;

/// The tree of one mesh.
#[derive(Debug)]
pub struct CellTree {
    /// The cells first, one box last.
    levels: Vec<TreeLevel>,
}

#[derive(Debug)]
struct TreeLevel {
    columns: usize,
    boxes: Vec<Bounds>,
    /// The last place in the order of drawing of the cells of each box, if that is not row by row.
    ranks: Vec<u32>,
}

/// The place of a cell in the order of drawing, 0 if that is row by row, and its index.
pub type CellKey = (u32, usize);

impl TreeLevel {
    /// Columns and rows.
    fn size(&self) -> (usize, usize) {
        (self.columns, self.boxes.len() / self.columns)
    }

    /// A box for every two by two; `None` when cancelled.
    fn above(&self, cancelled: &dyn Fn() -> bool) -> Option<Self> {
        let (columns, rows) = self.size();
        let mut above = Self {
            columns: columns.div_ceil(2),
            boxes: vec![EMPTY_BOX; columns.div_ceil(2) * rows.div_ceil(2)],
            ranks: vec![0; self.ranks.len().min(columns.div_ceil(2) * rows.div_ceil(2))],
        };
        for (k, child) in self.boxes.iter().enumerate() {
            if k % columns == 0 && cancelled() {
                return None;
            }
            let index = k / columns / 2 * above.columns + k % columns / 2;
            let parent = &mut above.boxes[index];
            *parent = [
                parent[0].min(child[0]),
                parent[1].min(child[1]),
                parent[2].max(child[2]),
                parent[3].max(child[3]),
            ];
            if let Some(rank) = above.ranks.get_mut(index) {
                *rank = self.ranks[k].max(*rank);
            }
        }
        Some(above)
    }
}

impl CellTree {
    /// Builds the tree; the vertices of subdivided cells count as well.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        Self::unless(mesh, &|| false).expect("nobody cancels")
    }

    /// The same; `None` when cancelled, which is asked for each row.
    #[must_use]
    pub fn unless(mesh: &Mesh, cancelled: &dyn Fn() -> bool) -> Option<Self> {
        let grid = mesh.grid();
        let (columns, rows) = (grid.columns() as usize - 1, grid.rows() as usize - 1);
        let mut boxes = vec![EMPTY_BOX; columns * rows];
        let mut ranks = vec![0; mesh.order().map_or(0, |_| boxes.len())];
        for (j, row) in (0..).zip(boxes.chunks_exact_mut(columns)) {
            if cancelled() {
                return None;
            }
            for (i, cell) in (0..).zip(row) {
                let mut quads = 0;
                for corners in mesh.corners(i, j) {
                    corners.into_iter().for_each(|corner| include(cell, corner));
                    quads += 1;
                }
                if let Some(rank) = ranks.get_mut(j as usize * columns + i as usize) {
                    let of_quads = (0..quads).map(|quad| mesh.rank(i, j, quad));
                    *rank = of_quads.max().unwrap_or_default();
                }
            }
        }
        for (index, cell) in mesh.subdivision().cells().iter().enumerate() {
            if index % SUBDIVIDED_CELLS_PER_LOOK == 0 && cancelled() {
                return None;
            }
            let bounds = &mut boxes[cell.row as usize * columns + cell.column as usize];
            mesh.subdivision()
                .posed(grid, cell)
                .for_each(|p| include(bounds, p));
        }
        let cells = TreeLevel {
            columns,
            boxes,
            ranks,
        };
        let mut levels = vec![cells];
        while let Some(below) = levels.last().filter(|level| level.boxes.len() > 1) {
            levels.push(below.above(cancelled)?);
        }
        Some(Self { levels })
    }

    /// Upper bound of the memory of a tree, bytes.
    #[must_use]
    pub fn bytes_for(mesh: &Mesh) -> u64 {
        let per_box = size_of::<Bounds>() + mesh.order().map_or(0, |_| size_of::<u32>());
        let (mut columns, mut rows) = (mesh.grid().columns() - 1, mesh.grid().rows() - 1);
        let mut boxes = 1;
        while columns > 1 || rows > 1 {
            boxes += u64::from(columns) * u64::from(rows);
            (columns, rows) = (columns.div_ceil(2), rows.div_ceil(2));
        }
        boxes * per_box as u64
    }

    /// Indices of the cells, row by row, whose boxes contain a position or are at most `margin` px
    /// from it along each axis; the last cell first, as it is drawn over the others, and no more
    /// than `most`. `look` is called for each box that is looked at, and ends the search by
    /// `Break`.
    ///
    /// Boxes whose cells are all drawn before the `most` that were found are left out: where many
    /// cells lie on each other, which a pose with coincident handles does to all, the search costs
    /// a few boxes for each of the `most`, not all cells.
    pub fn find(
        &self,
        p: Point,
        margin: f64,
        most: usize,
        look: &mut impl FnMut() -> ControlFlow<()>,
    ) -> ControlFlow<(), Vec<usize>> {
        let mut found: BinaryHeap<Reverse<CellKey>> = BinaryHeap::new();
        self.visit_last(p, margin, look, &mut |key| {
            found.push(Reverse(key));
            if found.len() > most {
                found.pop();
            }
            let is_full = found.len() == most;
            let first = found.peek().filter(|_| is_full);
            first.map_or(CellKey::default(), |Reverse(key)| *key)
        })?;
        let last_first = found.into_sorted_vec().into_iter();
        ControlFlow::Continue(last_first.map(|Reverse((_, cell))| cell).collect())
    }

    /// Passes the cells of [`CellTree::find`], later ones mostly first. `cell` says from which one
    /// on others are still of interest.
    pub fn visit_last(
        &self,
        p: Point,
        margin: f64,
        look: &mut impl FnMut() -> ControlFlow<()>,
        cell: &mut impl FnMut(CellKey) -> CellKey,
    ) -> ControlFlow<()> {
        let edges = [p.x - margin, p.y - margin, p.x + margin, p.y + margin];
        let (top, mut from) = ([self.levels.len() - 1, 0, 0], CellKey::default());
        self.descend_last(top, edges, &mut from, look, cell)
    }

    fn descend_last(
        &self,
        [level, i, j]: [usize; 3],
        edges: [f64; 4],
        from: &mut CellKey,
        look: &mut impl FnMut() -> ControlFlow<()>,
        cell: &mut impl FnMut(CellKey) -> CellKey,
    ) -> ControlFlow<()> {
        let last = self.last(level, i, j);
        if last < *from {
            return ControlFlow::Continue(());
        }
        look()?;
        let TreeLevel { columns, boxes, .. } = &self.levels[level];
        if !meet(&boxes[j * columns + i], edges) {
            return ControlFlow::Continue(());
        }
        let Some(below) = level.checked_sub(1) else {
            *from = cell(last);
            return ControlFlow::Continue(());
        };
        let (columns, rows) = self.levels[below].size();
        let mut children = [(1, 1), (0, 1), (1, 0), (0, 0)].map(|(right, down)| {
            let (i, j) = (2 * i + right, 2 * j + down);
            (i < columns && j < rows).then(|| (self.last(below, i, j), i, j))
        });
        children.sort_unstable_by_key(|child| Reverse(*child));
        for (_, i, j) in children.into_iter().flatten() {
            self.descend_last([below, i, j], edges, from, look, cell)?;
        }
        ControlFlow::Continue(())
    }

    /// No cell of a box is drawn after this one, which is itself for a cell.
    fn last(&self, level: usize, i: usize, j: usize) -> CellKey {
        let (columns, rows) = self.levels[0].size();
        let end = |place: usize, count: usize| ((place + 1) << level).min(count) - 1;
        let own = &self.levels[level];
        let rank = own.ranks.get(j * own.columns + i).copied();
        (
            rank.unwrap_or_default(),
            end(j, rows) * columns + end(i, columns),
        )
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
        let TreeLevel { columns, boxes, .. } = &self.levels[level];
        let index = j * columns + i;
        if !meet(&boxes[index], edges) {
            return ControlFlow::Continue(());
        }
        let Some(below) = level.checked_sub(1) else {
            return cell(index);
        };
        let (columns, rows) = self.levels[below].size();
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

fn meet(bounds: &Bounds, edges: [f64; 4]) -> bool {
    let [left, top, right, bottom] = bounds.map(f64::from);
    !(edges[2] < left || edges[0] > right || edges[3] < top || edges[1] > bottom)
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
    use std::sync::Arc;

    use super::*;
    use crate::geometry::{DrawingOrder, Grid};

    #[test]
    fn cells_are_those_of_a_search_of_all() {
        let mut state = 7_u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f32::from((state >> 16) as u16) / 32_768.0 - 1.0
        };
        for (columns, rows, reach, is_ordered) in [
            (2, 2, 3.0, false),
            (2, 9, 3.0, true),
            (17, 5, 20.0, false),
            (40, 33, 1.0, false),
            (33, 32, 200.0, false),
            (17, 6, 20.0, true),
            (33, 32, 200.0, true),
        ] {
            let grid = Grid::with_counts(100.0, 80.0, columns, rows);
            let depth: Vec<f32> = (0..grid.len()).map(|_| noise()).collect();
            let order = DrawingOrder::of_grid(&grid, &depth, &|| false).flatten();
            let order = order.filter(|_| is_ordered);
            let displacement = (0..grid.len()).map(|_| [reach * noise(), reach * noise()]);
            let mesh = Mesh::new(grid, displacement.collect()).in_order(order.map(Arc::new));
            let tree = CellTree::new(&mesh);
            for _ in 0..200 {
                let p = Point::new(
                    50.0 + 90.0 * f64::from(noise()),
                    40.0 + 80.0 * f64::from(noise()),
                );
                for margin in [0.0, 1.0] {
                    let find = |most| {
                        let found = tree.find(p, margin, most, &mut || ControlFlow::Continue(()));
                        found.continue_value().unwrap()
                    };
                    let found = find(usize::MAX);
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
                    want.sort_by_key(|cell| {
                        let [i, j] = [cell % (columns as usize - 1), cell / (columns as usize - 1)]
                            .map(|line| u32::try_from(line).unwrap());
                        Reverse((mesh.rank(i, j, 0), *cell))
                    });
                    assert_eq!(found, want, "{columns} x {rows}, {reach}: {p:?}");
                    for most in [1, 3, 32] {
                        let first = &want[..most.min(want.len())];
                        assert_eq!(find(most), first, "{columns} x {rows}, {reach}: {p:?}");
                    }
                }
            }
        }
    }
    /// A pose with coincident handles puts all cells on one position.
    #[test]
    fn a_search_among_cells_that_coincide_looks_at_few_boxes() {
        let grid = Grid::with_counts(1000.0, 1000.0, 257, 301);
        let to_one = |k: usize| {
            let [i, j] = [k % 257, k / 257].map(|line| u32::try_from(line).unwrap());
            let vertex = grid.vertex(i, j);
            #[expect(clippy::cast_possible_truncation, reason = "to a pixel's thousandth")]
            [(5.0 - vertex.x) as f32, (5.0 - vertex.y) as f32]
        };
        let mesh = Mesh::new(grid, (0..grid.len()).map(to_one).collect());
        let tree = CellTree::new(&mesh);
        let mut boxes = 0;
        let mut look = || {
            boxes += 1;
            ControlFlow::Continue(())
        };
        let found = tree.find(Point::new(5.0, 5.0), 1.0, 32, &mut look);
        let cells = 256 * 300;
        let want: Vec<usize> = (cells - 32..cells).rev().collect();
        assert_eq!(found.continue_value().unwrap(), want);
        assert!(boxes < 400, "{boxes} of {cells}");
    }

    #[test]
    fn the_memory_of_a_tree_is_known_before() {
        for (columns, rows) in [(2, 2), (2, 9), (17, 5), (40, 33)] {
            let grid = Grid::with_counts(100.0, 80.0, columns, rows);
            let depth = [1.0, 3.0, 2.0].into_iter().cycle().take(grid.len());
            let depth: Vec<f32> = depth.collect();
            let order = DrawingOrder::of_grid(&grid, &depth, &|| false).flatten();
            let mesh = Mesh::new(grid, vec![[0.0; 2]; grid.len()]);
            for mesh in [mesh.clone(), mesh.in_order(order.map(Arc::new))] {
                let of_level = |level: &TreeLevel| {
                    size_of_val(&level.boxes[..]) + size_of_val(&level.ranks[..])
                };
                let bytes: usize = CellTree::new(&mesh).levels.iter().map(of_level).sum();
                assert_eq!(
                    CellTree::bytes_for(&mesh),
                    bytes as u64,
                    "{columns} x {rows}"
                );
            }
        }
    }

    #[test]
    fn a_tree_that_nobody_wants_is_not_built() {
        let grid = Grid::with_counts(100.0, 80.0, 40, 30);
        let mesh = Mesh::new(grid, vec![[0.0; 2]; grid.len()]);
        let looks = std::cell::Cell::new(0_u32);
        let all = CellTree::unless(&mesh, &|| {
            looks.set(looks.get() + 1);
            false
        });
        assert!(all.is_some() && looks.get() > 29, "{looks:?}");
        for most in 0..looks.get() {
            let left = std::cell::Cell::new(most);
            let cancelled = || left.replace(left.get().saturating_sub(1)) == 0;
            assert!(CellTree::unless(&mesh, &cancelled).is_none(), "{most}");
        }
    }
}
