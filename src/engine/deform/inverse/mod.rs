//! The inverse of f, px to px: the rest position that is drawn at a posed one. The posed mesh finds
//! the cells that may be drawn there, the last one first, and a start in each. From there f itself
//! is solved, for [`LANES`] positions at once, by Broyden's method, which needs one f per step: its
//! matrix begins as the inverse Jacobian of the cell. Where that fails, beside cusps and folds,
//! Newton's method with differences of f and shorter steps takes over. Cost: about five f per
//! position.

mod patch;
#[cfg(test)]
mod tests;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use self::patch::in_patch;
use super::lanes::LANES;
use super::posed_map::PosedMap;
use super::workspace::Workspace;
use super::{IsCancelled, Pose, RestDeformation};
use crate::geometry::{CellKey, CellTree, Mesh, Point, Vec2};

/// The largest distance of f from the position that was asked for, px.
const SOLVED_DISTANCE_PX: f64 = 1e-7;
/// The steps of Broyden's method and of Newton's.
const MAX_STEPS: usize = 12;
const NEWTON_STEPS: usize = 30;
/// The distance of Newton's differences, px, and the most halvings of a step.
const DIFFERENCE_PX: f64 = 1e-4;
const MAX_HALVINGS: usize = 10;
/// A solution lies at most this far outside the cell from which it was sought, and a step is at
/// most this long, in cells.
const MAX_OUTSIDE_CELLS: f64 = 1.0;
const LONGEST_STEP: f64 = 4.0;
/// The mesh is not f: cells this near to a position are tried, px.
const CELL_MARGIN_PX: f64 = 1.0;
/// Cells that are tried for a position: more overlap only where nothing can be seen.
const MOST_CELLS: usize = 32;
/// Those of a cut grid have a few pixels.
const MOST_SMALL_CELLS: usize = 128;
/// Boxes of the tree that a search for one position looks at between two questions whether it is
/// still wanted. All positions of a block may have nearly as many before the first f asks.
const BOXES_PER_LOOK: u64 = 1 << 12;
/// Boxes that a search for one position looks at without being counted: they are part of what f
/// there costs.
const FREE_BOXES: u64 = 512;
/// Rounding errors of the boxes of cells, px.
const PATCH_MARGIN_PX: f64 = 1e-3;
/// Rounding errors at the border of the picture, px.
const BORDER_ERROR_PX: f64 = 1e-6;

/// The inverse of one pose.
#[derive(Debug)]
pub struct Inverse<'a> {
    /// None where the patches of the mesh are the map itself.
    f: Option<PosedMap<'a>>,
    mesh: &'a Mesh,
    /// Made for the first positions, as that can be cancelled.
    tree: Mutex<Option<Arc<CellTree>>>,
    most_cells: usize,
    steps: AtomicU64,
    boxes: AtomicU64,
}

/// What a thread that searches needs.
struct InverseSearch<'a> {
    tree: Arc<CellTree>,
    workspace: Workspace<LANES>,
    cancelled: IsCancelled<'a>,
}

/// Where the solution of one position is sought.
#[derive(Clone, Copy, Debug)]
struct Start {
    cell: usize,
    /// Which quad of the cell, in a cut grid.
    quad: usize,
    /// The position lies in the patch of the cell.
    is_inside: bool,
    x: Point,
    inverse: Matrix,
}

/// A matrix of two rows.
#[derive(Clone, Copy, Debug)]
struct Matrix([Vec2; 2]);

impl Matrix {
    const IDENTITY: Self = Self([Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0)]);

    /// The inverse of the matrix with these columns; `None` if the matrix is singular.
    fn inverse_of(a: Vec2, b: Vec2) -> Option<Self> {
        let determinant = a.cross(b);
        let inverse = Self([
            Vec2::new(b.y, -b.x) * (1.0 / determinant),
            Vec2::new(-a.y, a.x) * (1.0 / determinant),
        ]);
        inverse
            .0
            .iter()
            .all(|row| row.x.is_finite() && row.y.is_finite())
            .then_some(inverse)
    }

    fn times(&self, v: Vec2) -> Vec2 {
        Vec2::new(self.0[0].dot(v), self.0[1].dot(v))
    }

    /// Broyden's update of an inverse: from now on it takes the change of f to the step.
    fn learn(&mut self, step: Vec2, change: Vec2) {
        let Self([a, b]) = *self;
        let (off, across) = (
            step - self.times(change),
            Vec2::new(step.x * a.x + step.y * b.x, step.x * a.y + step.y * b.y),
        );
        let per = 1.0 / across.dot(change);
        if per.is_finite() {
            *self = Self([a + across * (off.x * per), b + across * (off.y * per)]);
        }
    }
}

impl<'a> Inverse<'a> {
    /// `mesh`: of the same pose; of cells that overlap, the one that it draws last counts. They
    /// have 4 to 8 px: positions are not found where larger ones differ from f by more than
    /// `CELL_MARGIN_PX`, or where more than `MOST_CELLS` smaller ones overlap.
    #[must_use]
    pub fn new(field: &'a RestDeformation, pose: &'a Pose, mesh: &'a Mesh) -> Self {
        Self {
            f: Some(field.deformation(pose)),
            ..Self::of_mesh(mesh)
        }
    }

    /// The inverse of a map that is what a mesh draws.
    #[must_use]
    pub fn of_mesh(mesh: &'a Mesh) -> Self {
        Self {
            f: None,
            mesh,
            tree: Mutex::new(None),
            most_cells: if mesh.cut_mesh().is_some() {
                MOST_SMALL_CELLS
            } else {
                MOST_CELLS
            },
            steps: AtomicU64::new(0),
            boxes: AtomicU64::new(0),
        }
    }

    /// The same inverse, which seeks in a tree of its mesh that is there already.
    #[must_use]
    pub fn seeking_in(self, tree: Option<Arc<CellTree>>) -> Self {
        Self {
            tree: Mutex::new(tree),
            ..self
        }
    }

    /// The rest positions of posed ones, px, to 1e-7 px of f; `None` where nothing of the picture
    /// is posed. If several rest positions have the same posed one, that of the cell that is drawn.
    /// `None` for all when cancelled, which is checked for each step of a search and for each
    /// `BOXES_PER_LOOK` boxes of the tree: one position may have many.
    #[must_use]
    pub fn map(&self, posed: &[Point], cancelled: IsCancelled<'_>) -> Option<Vec<Option<Point>>> {
        let mut search = InverseSearch {
            tree: self.tree(cancelled)?,
            workspace: Workspace::new(self.f.as_ref().map_or(0, PosedMap::terms)),
            cancelled,
        };
        let mut found = Vec::with_capacity(posed.len());
        for posed in posed.chunks(LANES) {
            found.extend(self.block(posed, &mut search)?);
        }
        Some(found)
    }

    /// The number of times that f has been computed for a block of positions.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps.load(Ordering::Relaxed)
    }

    /// The boxes of the tree that have been looked at beyond `FREE_BOXES` for each position. Their
    /// number has no bound below that of all cells: boxes may contain a position that none of their
    /// cells contains, and the patches of all cells may be beside a position in all their boxes.
    /// So a limit of the work counts them, as it counts [`Inverse::steps`]; a limit for each
    /// position instead would lose positions that are found.
    #[must_use]
    pub fn boxes(&self) -> u64 {
        self.boxes.load(Ordering::Relaxed)
    }

    /// The tree; `None` when cancelled.
    fn tree(&self, cancelled: IsCancelled<'_>) -> Option<Arc<CellTree>> {
        let mut tree = self.tree.lock().unwrap_or_else(PoisonError::into_inner);
        if tree.is_none() {
            *tree = Some(Arc::new(CellTree::unless(self.mesh, cancelled)?));
        }
        tree.clone()
    }

    /// Calls a search in the tree with what it calls for each box; `None` when cancelled.
    fn counting<T>(
        &self,
        cancelled: IsCancelled<'_>,
        search: impl FnOnce(&mut dyn FnMut() -> ControlFlow<()>) -> ControlFlow<(), T>,
    ) -> Option<T> {
        let mut boxes = 0;
        let found = search(&mut || {
            boxes += 1;
            if boxes % BOXES_PER_LOOK == 0 && cancelled() {
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(())
        });
        let counted = boxes.saturating_sub(FREE_BOXES);
        self.boxes.fetch_add(counted, Ordering::Relaxed);
        found.continue_value()
    }

    /// f at up to [`LANES`] positions; `None` when cancelled.
    fn f(&self, x: &[Point], search: &mut InverseSearch<'_>) -> Option<Vec<Point>> {
        self.steps.fetch_add(1, Ordering::Relaxed);
        let f = self.f.as_ref().filter(|_| !(search.cancelled)())?;
        Some(f.map_block(x, &mut search.workspace))
    }

    /// The positions in the patches of the cells that are drawn last, where those are the map;
    /// `None` when cancelled.
    fn in_patches(
        &self,
        posed: &[Point],
        search: &InverseSearch<'_>,
    ) -> Option<Vec<Option<Point>>> {
        let find = |y: &Point| {
            let mut drawn: Option<(CellKey, Point)> = None;
            let mut try_cell = |(_, cell): CellKey| {
                let [i, j] = self.column_and_row(cell);
                let at = self.mesh.corners(i, j).next();
                if let Some([s, t]) = at.and_then(|corners| in_patch(corners, *y)) {
                    let from = self.mesh.grid().vertex(i, j);
                    let to = self.mesh.grid().vertex(i + 1, j + 1);
                    let at = |a: f64, b: f64, share: f64| a + (b - a) * share;
                    let place = Point::new(at(from.x, to.x, s), at(from.y, to.y, t));
                    let key = (self.mesh.rank(i, j, 0), cell);
                    if drawn.is_none_or(|(last, _)| key > last) {
                        drawn = Some((key, place));
                    }
                }
                drawn.map_or(CellKey::default(), |(last, _)| last)
            };
            self.counting(search.cancelled, |mut look| {
                let tree = &search.tree;
                tree.visit_last(*y, PATCH_MARGIN_PX, &mut look, &mut try_cell)
            })?;
            Some(drawn.map(|(_, place)| place))
        };
        posed.iter().map(find).collect()
    }

    fn block(&self, posed: &[Point], search: &mut InverseSearch<'_>) -> Option<Vec<Option<Point>>> {
        if self.f.is_none() {
            return (!(search.cancelled)())
                .then(|| self.in_patches(posed, search))
                .flatten();
        }
        let starts: Option<Vec<Vec<Start>>> = posed
            .iter()
            .map(|y| {
                let cells = self.counting(search.cancelled, |mut look| {
                    let (tree, most) = (&search.tree, self.most_cells);
                    tree.find(*y, CELL_MARGIN_PX, most, &mut look)
                })?;
                let mut starts: Vec<Start> = cells
                    .iter()
                    .flat_map(|cell| self.starts(*cell, *y))
                    .collect();
                // The others only if no cell contains the position.
                starts.sort_by_key(|start| {
                    let [i, j] = self.column_and_row(start.cell);
                    let rank = self.mesh.rank(i, j, start.quad);
                    (!start.is_inside, std::cmp::Reverse(rank))
                });
                Some(starts)
            })
            .collect();
        let starts = starts?;
        let mut found = vec![None; posed.len()];
        for attempt in 0.. {
            let at = |k: usize| starts[k].get(attempt).filter(|_| found[k].is_none());
            let now: Vec<(usize, Start)> = (0..posed.len())
                .filter_map(|k| Some((k, *at(k)?)))
                .collect();
            if now.is_empty() {
                break;
            }
            for ((k, start), mut x) in now.iter().zip(self.solve(posed, &now, search)?) {
                if x.is_none() && start.is_inside {
                    x = self.newton(posed[*k], start, search)?;
                }
                found[*k] = x.and_then(|x| self.within(x, start));
            }
        }
        Some(found)
    }

    /// The starts in what is drawn of a cell, the last quad first.
    fn starts(&self, cell: usize, y: Point) -> Vec<Start> {
        let [column, row] = self.column_and_row(cell);
        let drawn: Vec<_> = self.mesh.corners(column, row).collect();
        let of_quad = |(quad, corners)| self.start((cell, quad), corners, y);
        drawn.into_iter().enumerate().rev().map(of_quad).collect()
    }

    fn column_and_row(&self, cell: usize) -> [u32; 2] {
        let columns = self.mesh.grid().columns() as usize - 1;
        #[expect(clippy::cast_possible_truncation, reason = "columns and rows are u32")]
        [(cell % columns) as u32, (cell / columns) as u32]
    }

    /// The position in the patch of a cell, or beside it.
    fn start(&self, (cell, quad): (usize, usize), [a, b, d, c]: [Point; 4], y: Point) -> Start {
        let grid = self.mesh.grid();
        let [i, j] = self.column_and_row(cell);
        let (e, f, twist) = (b - a, c - a, (d - b) - (c - a));
        let (mut s, mut t, mut inverse) = (0.5, 0.5, None);
        for _ in 0..8 {
            let off = y - (a + e * s + f * t + twist * (s * t));
            inverse = Matrix::inverse_of(e + twist * t, f + twist * s);
            let Some(step) = inverse.map(|inverse| inverse.times(off)) else {
                break;
            };
            (s, t) = ((s + step.x).clamp(-1.0, 2.0), (t + step.y).clamp(-1.0, 2.0));
            if step.norm() < 1e-9 {
                break;
            }
        }
        let (from, to) = (grid.vertex(i, j), grid.vertex(i + 1, j + 1));
        let size = to - from;
        let at_rest = |Matrix([s, t])| Matrix([s * size.x, t * size.y]);
        let inside = -1e-6..=1.0 + 1e-6;
        Start {
            cell,
            quad,
            is_inside: inverse.is_some() && inside.contains(&s) && inside.contains(&t),
            x: Point::new(from.x + s * size.x, from.y + t * size.y),
            inverse: inverse.map_or(Matrix::IDENTITY, at_rest),
        }
    }

    /// Broyden's method from a start of each position; `None` for all when cancelled.
    fn solve(
        &self,
        posed: &[Point],
        starts: &[(usize, Start)],
        search: &mut InverseSearch<'_>,
    ) -> Option<Vec<Option<Point>>> {
        let (width, height) = self.mesh.grid().cell();
        let longest = LONGEST_STEP * width.max(height);
        let mut x: Vec<Point> = starts.iter().map(|(_, start)| start.x).collect();
        let mut inverses: Vec<Matrix> = starts.iter().map(|(_, start)| start.inverse).collect();
        let off = |x: &[Point], search: &mut InverseSearch<'_>| -> Option<Vec<Vec2>> {
            let f = self.f(x, search)?;
            Some(
                starts
                    .iter()
                    .zip(f)
                    .map(|((k, _), f)| posed[*k] - f)
                    .collect(),
            )
        };
        let mut offs = off(&x, search)?;
        for _ in 0..MAX_STEPS {
            if offs.iter().all(|off| off.norm() <= SOLVED_DISTANCE_PX) {
                break;
            }
            let mut steps = vec![Vec2::ZERO; x.len()];
            for (k, step) in steps.iter_mut().enumerate() {
                if offs[k].norm() > SOLVED_DISTANCE_PX {
                    let whole = inverses[k].times(offs[k]);
                    let length = whole.norm();
                    *step = if length > longest {
                        whole * (longest / length)
                    } else {
                        whole
                    };
                    x[k] = x[k] + *step;
                }
            }
            let next = off(&x, search)?;
            for (k, step) in steps.into_iter().enumerate() {
                if step != Vec2::ZERO {
                    inverses[k].learn(step, offs[k] - next[k]);
                }
            }
            offs = next;
        }
        // One more step costs nothing.
        let last = x.into_iter().zip(inverses).zip(offs);
        Some(
            last.map(|((x, inverse), off)| {
                (off.norm() <= SOLVED_DISTANCE_PX).then(|| x + inverse.times(off))
            })
            .collect(),
        )
    }

    /// Newton's method with shorter steps where whole ones lead away. The outer `None`: cancelled.
    fn newton(
        &self,
        y: Point,
        start: &Start,
        search: &mut InverseSearch<'_>,
    ) -> Option<Option<Point>> {
        let mut x = start.x;
        for _ in 0..NEWTON_STEPS {
            let (across, down) = (Vec2::new(DIFFERENCE_PX, 0.0), Vec2::new(0.0, DIFFERENCE_PX));
            let around = [x, x + across, x - across, x + down, x - down];
            let [f, right, left, below, above] =
                <[Point; 5]>::try_from(self.f(&around, search)?).expect("five");
            let off = y - f;
            if off.norm() <= SOLVED_DISTANCE_PX {
                return Some(Some(x));
            }
            // Central differences have an error of second order.
            let per = 0.5 / DIFFERENCE_PX;
            let Some(inverse) = Matrix::inverse_of((right - left) * per, (below - above) * per)
            else {
                return Some(None);
            };
            let step = inverse.times(off);
            // Positions are computed together, so all lengths cost little more than one. The
            // longest that comes nearer is taken.
            let shorter: Vec<Point> = (0..MAX_HALVINGS)
                .map(|k| x + step * 0.5_f64.powi(i32::try_from(k).expect("a few")))
                .collect();
            let tried = self.f(&shorter, search)?;
            let nearest = shorter
                .into_iter()
                .zip(tried)
                .find(|(_, f)| (y - *f).norm() < off.norm());
            let Some((nearer, _)) = nearest else {
                return Some(None);
            };
            x = nearer;
        }
        Some(None)
    }

    /// A solution, if it lies in the picture and in the cell or beside it; in a cut grid, where the
    /// quad or one beside it draws.
    fn within(&self, x: Point, start: &Start) -> Option<Point> {
        let grid = self.mesh.grid();
        let inside = |value: f64, side: f64| {
            (-BORDER_ERROR_PX..=side + BORDER_ERROR_PX)
                .contains(&value)
                .then_some(value.clamp(0.0, side))
        };
        let x = Point::new(inside(x.x, grid.width())?, inside(x.y, grid.height())?);
        let (width, height) = grid.cell();
        let [i, j] = self.column_and_row(start.cell);
        let beside = |value: f64, first: u32, side: f64| {
            (-MAX_OUTSIDE_CELLS..=1.0 + MAX_OUTSIDE_CELLS)
                .contains(&((value - f64::from(first) * side) / side))
        };
        let is_drawn = self.mesh.cut_mesh().is_none_or(|cut| {
            let quad = cut.cells().of_cell(i, j)[start.quad];
            cut.cells().is_beside(&quad, x)
        });
        (is_drawn && beside(x.x, i, width) && beside(x.y, j, height)).then_some(x)
    }
}
