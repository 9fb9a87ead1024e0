//! Chooses the cells of a posed grid that must be drawn as smaller ones, so that the drawn map
//! differs from f by at most a tolerance (mathematics section 12). A cell that may be bent is
//! measured against exact rows where halving it would add vertices, and at the handles in it, where
//! f is known. Cells over the tolerance are halved and measured again. Measurements and rejected
//! variants: `warp/notes.md`.
//!
//! The choice depends on grid, handles and pose alone: neither threads nor the rows that are kept
//! change it.

mod interpolate;

use std::borrow::Cow;
use std::cmp::Ordering;

use super::coefficient_table::{CoefficientTable, IsCancelled, to_f32};
use super::curvature::bent_cells;
use super::interpolated::EvenLines;
use super::measured::{Measured, MeasuredCells, edge_level, split_error};
use super::posed_cells::PosedCells;
use super::posed_map::PosedMap;
use super::samples::{CellSamples, sample_error};
use super::subdivision_cache::{MAX_SUBDIVISION_DEPTH, Posing, SubdivisionCache, group_len};
use super::{Pose, RestDeformation};
use crate::geometry::{Grid, Mesh, Orientation, Point, SubdividedCell, Subdivision};

/// Cells are measured if their second differences predict more than this share of the tolerance;
/// they bound the error of resolved cells.
const SUSPECT_TOLERANCE_SHARE: f64 = 0.6;
/// With a larger tolerance, px, cells are measured as with this one: second differences tell little
/// of what the grid does not resolve.
const SUSPECT_TOLERANCE: f64 = 0.2;
/// Halving a smooth cell divides its error by four; a part of that is relied on without measuring
/// again, unless f has a cusp at its handles or a crease along them (mathematics sections 2.4,
/// 3.4).
const HALVED_ERROR_SHARE: f32 = 0.5;
/// The largest error of a cell in which f is resolved, as a share of its size.
const RESOLVED_CELL_SHARE: f32 = 0.1;
/// The largest difference of two targets at one position that counts as one, as a share of the
/// tolerance.
const TORN_TOLERANCE_SHARE: f64 = 0.5;
/// Cells of at most this size, px, are not halved.
const SMALLEST_CELL: f64 = 0.5;
/// A handle this near to the side of a cell, as a share of the cell, is one of the cell beyond as
/// well. With a half, each handle is near one of two opposite sides.
const NEIGHBOUR_HANDLE_CELLS: f64 = 0.5;
/// An error between the vertices where it is measured is at most this much larger: where the grid
/// resolves f, and elsewhere.
const BETWEEN_SMOOTH: f32 = 1.1;
const BETWEEN_VERTICES_FACTOR: f32 = 1.5;

/// At least one suspect cell in this many is halved; room is made for them at once.
const EXPECTED_PENDING: usize = 3;

/// The tolerance of a posed grid, and what may be spent on it.
#[derive(Clone, Copy, Debug)]
pub struct Subdivider<'a> {
    /// The handles.
    pub field: &'a RestDeformation,
    /// The rows that are kept.
    pub rows: &'a SubdivisionCache,
    /// f of the pose, if the grid was posed by it because a table is not worth its time.
    pub f: Option<&'a PosedMap<'a>>,
    /// Largest distance between the drawn map and f, px.
    pub tolerance: f64,
    /// The largest distance between what is drawn and a cell, px of the source, which the tolerance
    /// leaves room for.
    pub drawn_within: f32,
    /// The orientation of the mesh, if some cell of it is folded.
    pub folded: Option<Orientation>,
    /// Most vertices inside cells; cells that would need more remain over the tolerance.
    pub vertices: usize,
}

/// The result of [`Subdivider::subdivide`].
#[derive(Clone, Debug)]
pub struct SubdividedMesh {
    /// The subdivided cells.
    pub subdivision: Subdivision,
    /// Column and row of the cells that remain over the tolerance.
    pub exceeded: Vec<(u32, u32)>,
}

impl Subdivider<'_> {
    /// Measures and halves cells of a posed mesh. `None` when cancelled.
    #[must_use]
    pub fn subdivide(
        &self,
        mesh: &Mesh,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<SubdividedMesh> {
        let none = SubdividedMesh {
            subdivision: Subdivision::new(self.drawn_within),
            exceeded: Vec::new(),
        };
        if pose.is_identity() || self.field.handles().columns() == 0 {
            // f is then bilinear in every cell, exactly; and the picture has to stay as it is to
            // the last bit.
            return Some(none);
        }
        let grid = mesh.grid();
        let terms = self.field.terms_of(pose.displacements());
        let d: Vec<[f32; 2]> = terms.iter().map(|d| to_f32(*d)).collect();
        let bytes = CoefficientTable::bytes_for(self.field, grid.len());
        // Coefficients inside cells are kept for the next poses of a drag. For large sets they
        // would take more memory and time than f itself, which is then computed at each vertex.
        let of_pose = (self.f.is_none() && !CoefficientTable::rows_inside_cells_pay(self.field))
            .then(|| self.field.deformation(pose));
        let posing = Posing {
            field: self.field,
            f: self.f.or(of_pose.as_ref()),
            grid,
            d: &d,
            serial: CoefficientTable::is_posed_on_one_thread(bytes),
        };
        let samples = CellSamples::of_handles(self.field, grid, pose, cancelled)?;
        let mut work = PoseMeasurement {
            subdivider: self,
            mesh,
            even: EvenLines::of(grid),
            samples,
            posed: PosedCells::of(mesh),
            cells: MeasuredCells::new(grid.len()),
            levels: Vec::new(),
            left: self.vertices,
            exceeded: Vec::new(),
            deepest: deepest(grid),
            is_smooth: self.field.map.is_smooth(&self.field.set),
        };
        work.run(&posing, cancelled)?;
        // Two targets at one position: no subdivision helps, and the report says where.
        work.exceed_torn(pose);
        Some(work.finish())
    }
}

/// The times that a cell of a grid may be halved.
fn deepest(grid: &Grid) -> u8 {
    let mut cell = grid.cell().0.max(grid.cell().1);
    let mut level = 0;
    // Smaller cells than pixels show nothing; what then exceeds the tolerance is counted.
    while cell > SMALLEST_CELL && usize::from(level) < MAX_SUBDIVISION_DEPTH {
        cell /= 2.0;
        level += 1;
    }
    level
}

/// The measurement of one pose.
struct PoseMeasurement<'a> {
    subdivider: &'a Subdivider<'a>,
    mesh: &'a Mesh,
    even: EvenLines,
    samples: CellSamples,
    posed: PosedCells<'a>,
    cells: MeasuredCells,
    /// How often each known cell will be halved, since [`Self::judge_edges`].
    levels: Vec<u8>,
    /// Vertices that may still be computed.
    left: usize,
    exceeded: Vec<u32>,
    /// The times that a cell may be halved.
    deepest: u8,
    is_smooth: bool,
}

/// What to do with a cell.
enum Decision {
    /// Draw it halved this many times.
    Draw(u8),
    /// Measure one level more.
    Measure,
}

impl PoseMeasurement<'_> {
    #[expect(clippy::cast_possible_truncation, reason = "errors are f32")]
    fn tolerance(&self) -> f32 {
        self.subdivider.tolerance as f32
    }

    /// The largest error of a cell between the vertices where this one was measured.
    fn between(&self, cell: u32, error: f32) -> f32 {
        let [width, height] = self.posed.size(cell);
        error
            // Where f is resolved, its largest error lies next to where it was measured; elsewhere
            // it may peak between the vertices (mathematics section 12, step 3).
            * if self.is_smooth && error <= RESOLVED_CELL_SHARE * width.max(height) {
                BETWEEN_SMOOTH
            } else {
                BETWEEN_VERTICES_FACTOR
            }
    }

    fn run(&mut self, posing: &Posing<'_>, cancelled: IsCancelled<'_>) -> Option<()> {
        // Step 1 of mathematics section 12. Three kinds of cells are suspect: bent ones by their
        // second differences, those with a handle that is off, and folded ones.
        let mut pending = bent_cells(
            self.mesh,
            SUSPECT_TOLERANCE_SHARE * self.subdivider.tolerance.min(SUSPECT_TOLERANCE),
        );
        for (cell, samples) in self.samples.by_cell() {
            // At a handle f is known without computing it. Half of the tolerance, because what is
            // found at one position is not the largest error of the cell.
            if sample_error(samples, &self.posed.corners(cell), 0) > self.tolerance() * 0.5 {
                pending.push(cell);
            }
        }
        if let Some(orientation) = self.subdivider.folded {
            let columns = self.mesh.grid().columns() - 1;
            // What the second differences of a cell that is not bent leave room for.
            #[expect(clippy::cast_possible_truncation, reason = "errors are f32")]
            let split = ((1.0 - SUSPECT_TOLERANCE_SHARE) * self.subdivider.tolerance) as f32;
            let folded = self.mesh.folded_against(orientation);
            let folded = folded.into_iter().map(|(i, j)| j * columns + i);
            // A folded cell is drawn as two triangles, not as its patch: their difference is a
            // quarter of the twist, and second differences do not show it.
            pending.extend(folded.filter(|&cell| {
                split_error(&self.posed.corners(cell), 2, self.posed.size(cell)) > split
            }));
        }
        self.cells.known.reserve(pending.len() / EXPECTED_PENDING);
        while !pending.is_empty() {
            // In the order of the grid, so that the result does not depend on which neighbour asked
            // first. A stable sort is faster here: most of them are in this order already.
            pending.sort();
            pending.dedup();
            // Cells come row by row.
            let mut block = None;
            pending.retain(|&cell| !self.interpolate(cell, &mut block));
            // Cells of one depth are computed together, as one block of vertices: that is what the
            // kernels are fast at.
            let mut by_depth = vec![Vec::new(); self.deepest.into()];
            for &cell in &pending {
                by_depth[usize::from(self.cells.get(&cell).map_or(0, |known| known.depth))]
                    .push(cell);
            }
            for (depth, cells) in (0..).zip(&by_depth) {
                self.measure(posing, depth, cells, cancelled)?;
            }
            let mut next = Vec::new();
            for &cell in &pending {
                self.judge(cell, &mut next);
            }
            // Edges come last: which cell is the coarser one is known only when no cell needs
            // measuring for its own sake. They may begin new rounds.
            if next.is_empty() {
                self.judge_edges(&mut next);
            }
            pending = next;
        }
        Some(())
    }

    /// Adds the vertices of one halving more to cells of a depth, and measures the errors there.
    fn measure(
        &mut self,
        posing: &Posing<'_>,
        depth: u8,
        cells: &[u32],
        cancelled: IsCancelled<'_>,
    ) -> Option<()> {
        let len = group_len(depth + 1);
        // The budget is spent in the order of the grid. What does not fit stays at its depth, and
        // `judge` reports it as exceeded.
        let cells = &cells[..cells.len().min(self.left / len)];
        self.left -= cells.len() * len;
        let fresh = self
            .subdivider
            .rows
            .displace(posing, depth + 1, cells, cancelled)?;
        for (&cell, fresh) in cells.iter().zip(fresh.chunks_exact(len)) {
            let (corners, size) = (self.posed.corners(cell), self.posed.size(cell));
            self.cells.get_or_insert(cell, corners).deepen(fresh, size);
        }
        Some(())
    }

    /// Decides on a cell that was measured; what must be measured next goes to `next`.
    fn judge(&mut self, cell: u32, next: &mut Vec<u32>) {
        let Some(known) = self.cells.get(&cell).filter(|known| known.depth > 0) else {
            // No vertices were left for it.
            self.exceeded.push(cell);
            return;
        };
        match self.decide(cell, known) {
            Decision::Measure if known.depth < self.deepest => {
                // Without vertices left the next measurement changes nothing.
                if self.left < group_len(known.depth + 1) {
                    self.exceeded.push(cell);
                } else {
                    next.push(cell);
                }
            }
            Decision::Measure => self.exceeded.push(cell),
            Decision::Draw(_) => {}
        }
        let (depth, samples) = (known.depth, self.samples.of(cell));
        // The grid may not resolve f there.
        if depth == 1 && self.between(cell, known.errors[0]) > self.tolerance() {
            next.extend(
                // A bend that passes between the vertices of the neighbours looks flat there
                // (mathematics section 12, step 5). One ring is enough: each cell that exceeds asks
                // its own neighbours.
                self.posed
                    .around(cell, |_, _| true)
                    .filter(|other| self.cells.get(other).is_none()),
            );
        }
        // Both cells at a side must be halved for the handles beside it.
        if !samples.is_empty()
            && sample_error(samples, &known.vertices, depth - 1) > self.tolerance()
        {
            let beside = |di: i32, dj: i32| {
                // A handle near a side bends the cell beyond as well. Halving one side alone would
                // leave the handle at the edge of a coarse cell.
                let near = |x: f64, side: i32| {
                    side == 0 || (if side < 0 { x } else { 1.0 - x }) < NEIGHBOUR_HANDLE_CELLS
                };
                samples
                    .iter()
                    .any(|sample| near(sample.s, di) && near(sample.t, dj))
            };
            let others: Vec<u32> = self.posed.around(cell, beside).collect();
            for other in others {
                let corners = self.posed.corners(other);
                let other_known = self.cells.get_or_insert(other, corners);
                other_known.least = other_known.least.max(depth);
                if other_known.depth < depth {
                    next.push(other);
                }
            }
        }
    }

    /// Cells whose neighbours know that a common edge must be halved more often; those that must be
    /// measured for it go to `next`.
    fn judge_edges(&mut self, next: &mut Vec<u32>) {
        let mut wanted = Vec::new();
        // All levels before any is changed, so that the order of the cells does not matter.
        let levels: Vec<u8> = self
            .cells
            .known
            .iter()
            .map(|(cell, known)| self.level(*cell, known))
            .collect();
        for ((cell, known), &level) in self.cells.known.iter().zip(&levels) {
            if level == 0 {
                continue;
            }
            let mut vertices = Cow::Borrowed(&[][..]);
            for (edge, other) in self.posed.beside(*cell).into_iter().enumerate() {
                let Some(other) = other else { continue };
                let other_level = self.cells.position(other).map_or(0, |at| levels[at]);
                if other_level >= level {
                    continue;
                }
                if vertices.is_empty() {
                    vertices = known.at_level(level);
                }
                // The edge is drawn with the vertices of the coarser cell (`Subdivision::join`).
                // Where those of the finer one lie on its straight lines, within the tolerance,
                // nothing is to be done.
                let least = edge_level(&vertices, (1 << level) + 1, edge, self.tolerance());
                if least > other_level {
                    wanted.push((other, least));
                }
            }
        }
        self.levels = levels;
        for (cell, least) in wanted {
            let corners = self.posed.corners(cell);
            let known = self.cells.get_or_insert(cell, corners);
            if known.least < least {
                known.least = least;
                if known.depth < least {
                    // Measured, and judged with all others again.
                    next.push(cell);
                } else {
                    let at = self.cells.position(cell).expect("is there");
                    self.levels[at] = self.level(cell, &self.cells.known[at].1);
                }
            }
        }
    }

    /// No cell resolves a position at which f is torn.
    fn exceed_torn(&mut self, pose: &Pose) {
        let grid = self.mesh.grid();
        let beside = |x: f64, y: f64| {
            grid.locate(Point::new(
                x.clamp(0.0, grid.width()),
                y.clamp(0.0, grid.height()),
            ))
        };
        for p in pose
            .conflicts()
            .torn(TORN_TOLERANCE_SHARE * self.subdivider.tolerance)
        {
            if grid.locate(p).is_none() {
                continue;
            }
            // The four cells that meet near the position: it may lie on an edge or on a vertex.
            let around = [-1.0, 1.0].map(|x| {
                [-1.0, 1.0].map(|y| beside(p.x + x * SMALLEST_CELL, p.y + y * SMALLEST_CELL))
            });
            let cells = around
                .into_iter()
                .flatten()
                .flatten()
                .map(|(i, j, ..)| j * (grid.columns() - 1) + i);
            self.exceeded.extend(cells);
        }
    }

    /// The halvings of a cell as it will be drawn.
    fn level(&self, cell: u32, known: &Measured) -> u8 {
        match self.decide(cell, known) {
            Decision::Draw(level) => level,
            Decision::Measure => known.depth,
        }
    }

    /// The fewest halvings with which a cell meets the tolerance, as far as it was measured.
    fn decide(&self, cell: u32, known: &Measured) -> Decision {
        let samples = self.samples.of(cell);
        let size = self.posed.size(cell);
        let is_resolved = |level: u8| {
            let size = size[0].max(size[1]) / f32::from(1_u8 << (level - 1));
            known.errors[usize::from(level) - 1] <= RESOLVED_CELL_SHARE * size
        };
        for level in known.least..=known.depth {
            let error = match level.cmp(&known.depth) {
                // Measured at the vertices of the next halving.
                Ordering::Less => self.between(cell, known.errors[usize::from(level)]),
                // Predicted from the last measurement where f is smooth: in resolved cells, and in
                // the smallest ones, which are not measured again.
                _ if level > 0
                    && self.is_smooth
                    && (level == self.deepest || is_resolved(level)) =>
                {
                    known.errors[usize::from(level) - 1] * HALVED_ERROR_SHARE
                }
                // Without smoothness a halving may not help, so the last error counts in full.
                _ if level > 0 && level == self.deepest => known.errors[usize::from(level) - 1],
                _ => f32::INFINITY,
            };
            if error <= self.tolerance()
                && sample_error(samples, &known.vertices, level) <= self.tolerance()
            {
                return Decision::Draw(level);
            }
        }
        Decision::Measure
    }

    fn finish(mut self) -> SubdividedMesh {
        let grid = self.mesh.grid();
        let mut subdivision = Subdivision::new(self.subdivider.drawn_within);
        let drawn = self.levels.iter().filter(|level| **level > 0);
        let vertices = |level: &u8| ((1_usize << level) + 1).pow(2);
        subdivision.reserve(drawn.clone().count(), drawn.map(vertices).sum());
        for at in self.cells.in_order() {
            let (cell, known) = &self.cells.known[at];
            let (cell, level) = (*cell, self.levels[at]);
            if level > 0 {
                let (i, j) = (cell % (grid.columns() - 1), cell / (grid.columns() - 1));
                let vertices = subdivision.push(i, j, level, &known.at_level(level));
                if !known.is_exact {
                    self.take_exact_edges(cell, level, vertices);
                }
            }
        }
        let outer = |cell: &SubdividedCell, edge: usize| {
            let index = cell.row * (grid.columns() - 1) + cell.column;
            if !self.samples.of(index).is_empty() {
                return cell.level;
            }
            let vertices = self
                .cells
                .get(&index)
                .map_or(Cow::Borrowed(&[][..]), |known| known.at_level(cell.level));
            edge_level(&vertices, cell.side(), edge, self.tolerance())
        };
        // Neighbours decide with the levels of the first pass.
        subdivision.join(grid, outer);
        self.exceeded.sort_unstable();
        self.exceeded.dedup();
        let exceeded = self
            .exceeded
            .iter()
            .map(|cell| (cell % (grid.columns() - 1), cell / (grid.columns() - 1)))
            .collect();
        SubdividedMesh {
            subdivision,
            exceeded,
        }
    }
}
