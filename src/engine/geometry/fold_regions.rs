//! The folded cells of a posed grid, as regions of cells that share an edge or a corner: connected
//! components, found row by row with a union-find structure. O(cells).

use std::ops::Range;

use super::{Mesh, Orientation};

/// Where a posed grid folds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoldRegions {
    /// Folded cells.
    pub cells: u64,
    /// Their share of the area of the grid at rest, 0 to 1.
    pub share: f64,
    /// The number of regions.
    pub regions: u64,
    /// Left, top, right and bottom edges of the largest regions by their number of cells, px of the
    /// posed plane; equal ones in row order.
    pub boxes: Vec<[f64; 4]>,
}

/// Cells that are known to be connected.
#[derive(Clone, Debug)]
struct Component {
    /// The component that it was united with; itself if it is a root.
    parent: usize,
    cells: u64,
    bounds: [f64; 4],
}

/// Adjacent folded cells of a row, and their component.
type FoldedRun = (Range<u32>, usize);

#[derive(Default)]
struct UnionFind(Vec<Component>);

impl UnionFind {
    fn find(&mut self, mut component: usize) -> usize {
        while self.0[component].parent != component {
            self.0[component].parent = self.0[self.0[component].parent].parent;
            component = self.0[component].parent;
        }
        component
    }

    /// Unites two components under the root that was found first.
    fn union(&mut self, a: usize, b: usize) {
        let (a, b) = (self.find(a), self.find(b));
        let (first, last) = (a.min(b), a.max(b));
        if first != last {
            let Component { cells, bounds, .. } = self.0[last].clone();
            self.0[last].parent = first;
            self.0[first].cells += cells;
            include(&mut self.0[first].bounds, bounds);
        }
    }
}

fn include(bounds: &mut [f64; 4], other: [f64; 4]) {
    *bounds = [
        bounds[0].min(other[0]),
        bounds[1].min(other[1]),
        bounds[2].max(other[2]),
        bounds[3].max(other[3]),
    ];
}

impl Mesh {
    /// The regions of the cells that fold in a mesh of this orientation, of which at most `most`
    /// have boxes. Memory: at most 32 bytes per cell. `None` when cancelled, which is checked for
    /// each row.
    #[must_use]
    pub fn fold_regions(
        &self,
        orientation: Orientation,
        most: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<FoldRegions> {
        let grid = self.grid();
        let mut components = UnionFind::default();
        let (mut above, mut runs): (Vec<FoldedRun>, Vec<FoldedRun>) = (Vec::new(), Vec::new());
        let (mut cells, mut area) = (0, 0.0);
        for j in 0..grid.rows() - 1 {
            if cancelled() {
                return None;
            }
            runs.clear();
            let mut before = 0;
            for i in (0..grid.columns() - 1).filter(|&i| self.is_folded(i, j, orientation)) {
                cells += 1;
                let size = grid.vertex(i + 1, j + 1) - grid.vertex(i, j);
                area += size.x * size.y;
                let bounds = self.cell_bounds(i, j);
                match runs.last_mut() {
                    Some((run, component)) if run.end == i => {
                        run.end = i + 1;
                        let root = components.find(*component);
                        components.0[root].cells += 1;
                        include(&mut components.0[root].bounds, bounds);
                    }
                    _ => {
                        let parent = components.0.len();
                        components.0.push(Component {
                            parent,
                            cells: 1,
                            bounds,
                        });
                        runs.push((i..i + 1, parent));
                    }
                }
                // Cells of the row above that share an edge or a corner.
                while above.get(before).is_some_and(|(run, _)| run.end < i) {
                    before += 1;
                }
                let (_, own) = *runs.last().expect("has this cell");
                for (_, component) in above[before..]
                    .iter()
                    .take_while(|(run, _)| run.start <= i + 1)
                {
                    components.union(own, *component);
                }
            }
            std::mem::swap(&mut above, &mut runs);
        }
        let roots = components
            .0
            .iter()
            .enumerate()
            .filter(|(k, component)| component.parent == *k);
        let mut roots: Vec<&Component> = roots.map(|(_, root)| root).collect();
        let regions = roots.len() as u64;
        // Stable: equal regions stay in the order of their first cells.
        roots.sort_by_key(|root| std::cmp::Reverse(root.cells));
        let boxes = roots
            .into_iter()
            .take(most)
            .map(|root| root.bounds)
            .collect();
        Some(FoldRegions {
            cells,
            share: area / (grid.width() * grid.height()),
            regions,
            boxes,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    /// Moves the middle vertex of a block of two by two cells far past its neighbours: these four
    /// cells fold.
    fn folded(vertices: &[(usize, usize)]) -> Mesh {
        let grid = Grid::with_counts(200.0, 100.0, 21, 11);
        let mut displacement = vec![[0.0; 2]; grid.len()];
        for (column, row) in vertices {
            displacement[row * 21 + column] = [14.0, 0.0];
        }
        Mesh::new(grid, displacement)
    }

    fn regions_of(mesh: &Mesh, most: usize) -> FoldRegions {
        mesh.fold_regions(mesh.folding(&|| false).unwrap().orientation, most, &|| {
            false
        })
        .unwrap()
    }

    #[test]
    fn cells_that_touch_are_one_region() {
        let regions = |vertices: &[(usize, usize)], most| regions_of(&folded(vertices), most);
        assert_eq!(regions(&[], 9), FoldRegions::default());
        let one = regions(&[(3, 4)], 9);
        assert_eq!(
            (one.cells, one.regions, one.boxes.as_slice()),
            (2, 1, &[[30.0, 30.0, 44.0, 50.0]][..])
        );
        assert!((one.share - 200.0 / 20_000.0).abs() < 1e-12);
        // Cells of both meet at a corner.
        let joined = regions(&[(3, 4), (4, 6)], 9);
        assert_eq!(
            (joined.cells, joined.regions, joined.boxes.as_slice()),
            (4, 1, &[[30.0, 30.0, 54.0, 70.0]][..])
        );
    }

    #[test]
    fn regions_are_those_of_a_flood() {
        let mut state = 7_u32;
        for (columns, rows, reach) in [
            (2, 2, 30.0),
            (3, 9, 9.0),
            (40, 30, 1.2),
            (40, 30, 1.6),
            (17, 23, 3.0),
        ] {
            let grid = Grid::with_counts(100.0, 80.0, columns, rows);
            let displacement = (0..grid.len()).map(|_| {
                [(); 2].map(|()| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (f32::from((state >> 16) as u16) / 32_768.0 - 1.0) * reach
                })
            });
            let mesh = Mesh::new(grid, displacement.collect());
            let mut left: Vec<(u32, u32)> = mesh.folded_cells().collect();
            let (cells, mut sizes) = (left.len() as u64, Vec::new());
            while let Some(first) = left.pop() {
                let (mut open, mut size) = (vec![first], 0);
                while let Some((i, j)) = open.pop() {
                    size += 1;
                    let (near, far) = left
                        .into_iter()
                        .partition(|(a, b)| a.abs_diff(i) <= 1 && b.abs_diff(j) <= 1);
                    left = far;
                    open.extend::<Vec<_>>(near);
                }
                sizes.push(size);
            }
            let found = regions_of(&mesh, usize::MAX);
            assert_eq!(
                (found.cells, found.regions, found.boxes.len()),
                (cells, sizes.len() as u64, sizes.len()),
                "{columns} x {rows}"
            );
            assert_eq!(
                regions_of(&mesh, 1).boxes[..],
                found.boxes[..found.boxes.len().min(1)]
            );
        }
    }

    #[test]
    fn the_largest_regions_have_boxes() {
        let three = regions_of(&folded(&[(3, 2), (14, 2), (14, 3), (3, 8)]), 2);
        assert_eq!((three.regions, three.boxes.len()), (3, 2));
        assert!(
            three.boxes[0][0] >= 140.0 && three.boxes[1][1] < 30.0,
            "{three:?}"
        );
        assert_eq!(
            folded(&[]).fold_regions(Orientation::Upright, 2, &|| true),
            None
        );
    }
}
