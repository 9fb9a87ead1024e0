//! Moves vertices of a posed mesh until no cell is folded (mathematics 9.3): the distortion of the
//! cells around the folds is minimised, with a barrier that is lowered step by step. Regularised
//! after Garanzha et al., "Foldover-free maps in 50 lines of code" (2021).

mod minimise;

use self::minimise::minimise;
use super::{Grid, Mesh, Orientation, Point, Vec2};

/// A corner below this share of its area at rest is mended.
const LEAST_CORNER: f64 = 1e-3;
/// Rounds, and by how many cells the patches of each grow.
const ROUNDS: u32 = 3;
const CELLS_A_ROUND: u32 = 6;
/// The weight of areas beside that of lengths.
const AREA_WEIGHT: f64 = 0.1;
/// The weight of a target, and its growth while it is missed by more than this, px.
const TARGET_WEIGHT: f64 = 1e3;
const WEIGHT_GROWTH: f64 = 4.0;
const MOST_OFF: f64 = 0.05;
/// Passes of one round; in the first ones, the barrier is halved at least.
const PASSES: u32 = 20;
const HALVING_PASSES: u32 = 10;
/// A patch is mended when its least determinant is above this.
const MENDED_DETERMINANT: f64 = 1e-4;
/// Evaluations of the energy in all rounds together. Ordinary folds need 60 to 270.
const MOST_EVALUATIONS: u32 = 4000;
/// Times that all targets are met in turn before anything is mended, and how far off they may be
/// then, px.
const MEETINGS: u32 = 50;
const MET: f64 = 1e-3;
/// Cells or targets between two checks of cancellation: less than a millisecond.
const BETWEEN_CHECKS: usize = 4096;

/// A mended mesh.
#[derive(Clone, Debug)]
pub struct Untangled {
    /// The mesh.
    pub mesh: Mesh,
    /// Cells that were folded, or nearly.
    pub mended: u64,
    /// Evaluations of the distortion.
    pub evaluations: u32,
}

/// Moves vertices of a mesh without subdivided or cut cells: those of cells with targets until
/// these are met, and those near folded cells until none is folded or too much work is done; the
/// others stay, as does the border, so that it does not come to cross itself. `targets`: positions
/// at rest, and where the mesh shall take them, px.
/// `most_evaluations`: of the energy, in all rounds together. `None` when cancelled.
#[must_use]
pub fn untangle(
    mesh: &Mesh,
    targets: &[(Point, Point)],
    most_evaluations: u32,
    cancelled: &dyn Fn() -> bool,
) -> Option<Untangled> {
    let grid = *mesh.grid();
    let most_evaluations = most_evaluations.min(MOST_EVALUATIONS);
    let vertices = (0..grid.rows()).flat_map(|j| (0..grid.columns()).map(move |i| (i, j)));
    let mut places: Vec<Point> = vertices.map(|(i, j)| mesh.posed(i, j)).collect();
    let targets = targets
        .iter()
        .filter_map(|(rest, place)| Aim::new(&grid, *rest, *place));
    let targets: Vec<Aim> = targets.collect();
    let has_moved = meet(&mut places, &targets, cancelled)?;
    let (mut mended, mut evaluations) = (0, 0);
    for round in 1..=ROUNDS {
        let bad = folded(&grid, &places);
        if round == 1 {
            mended = bad.len() as u64;
        }
        if bad.is_empty() {
            break;
        }
        let patch = FreePatch::around(&grid, &bad, CELLS_A_ROUND * round, &targets, cancelled)?;
        evaluations = patch.mend(&mut places, (evaluations, most_evaluations), cancelled)?;
    }
    if mended == 0 && !has_moved {
        return Some(Untangled {
            mesh: mesh.clone(),
            mended,
            evaluations,
        });
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "displacements are in single precision"
    )]
    let displacement = |(index, place): (usize, &Point)| {
        let d = *place - at_rest(&grid, index);
        [d.x as f32, d.y as f32]
    };
    let displacements = places.iter().enumerate().map(displacement).collect();
    let mesh = Mesh::new(grid, displacements);
    Some(Untangled {
        mesh,
        mended,
        evaluations,
    })
}

/// Moves the corners of cells with targets as little as it takes to meet these; more than once,
/// because targets share corners. Whether any was moved; `None` when cancelled.
fn meet(places: &mut [Point], targets: &[Aim], cancelled: &dyn Fn() -> bool) -> Option<bool> {
    let mut has_moved = false;
    for _ in 0..MEETINGS {
        let mut farthest = 0.0_f64;
        for (index, target) in targets.iter().enumerate() {
            if index % BETWEEN_CHECKS == 0 && cancelled() {
                return None;
            }
            let off = target.off(places);
            farthest = farthest.max(off.norm());
            for (vertex, pull) in target.corners.iter().zip(target.pulls) {
                places[*vertex] = places[*vertex] + off * pull;
            }
        }
        if farthest <= MET {
            break;
        }
        has_moved = true;
    }
    Some(has_moved)
}

/// The cells of which a corner is folded, or nearly.
fn folded(grid: &Grid, places: &[Point]) -> Vec<[u32; 2]> {
    let lines: Vec<&[Point]> = places.chunks_exact(grid.columns() as usize).collect();
    let widths: Vec<f64> = (0..grid.columns() - 1)
        .map(|i| size(grid, [i, 0])[0])
        .collect();
    let mut folded = Vec::new();
    for (j, lines) in (0..).zip(lines.windows(2)) {
        let least = LEAST_CORNER * size(grid, [0, j])[1];
        let sides = lines[0].windows(2).zip(lines[1].windows(2)).zip(&widths);
        folded.extend((0..).zip(sides).filter_map(|(i, ((above, below), width))| {
            let [a, b, c, d] = [above[0], above[1], below[1], below[0]];
            let turns = Orientation::turns([b - a, c - b, c - d, d - a]);
            // All four, without a branch between them.
            let is_folded = turns.map(|turn| turn <= least * width);
            (is_folded[0] | is_folded[1] | is_folded[2] | is_folded[3]).then_some([i, j])
        }));
    }
    folded
}

fn cells(grid: &Grid) -> impl Iterator<Item = [u32; 2]> + use<> {
    let (columns, rows) = (grid.columns() - 1, grid.rows() - 1);
    (0..rows).flat_map(move |j| (0..columns).map(move |i| [i, j]))
}

/// Indices of the corners of a cell, clockwise from the upper left one.
fn corners(grid: &Grid, [i, j]: [u32; 2]) -> [usize; 4] {
    let columns = grid.columns() as usize;
    let first = j as usize * columns + i as usize;
    [first, first + 1, first + columns + 1, first + columns]
}

fn at_rest(grid: &Grid, vertex: usize) -> Point {
    let columns = grid.columns() as usize;
    Point::new(
        grid.x(of_u32(vertex % columns)),
        grid.y(of_u32(vertex / columns)),
    )
}

/// An index of a vertex, of which grids have fewer.
fn of_u32(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}

/// Width and height of a cell at rest.
fn size(grid: &Grid, [i, j]: [u32; 2]) -> [f64; 2] {
    [grid.x(i + 1) - grid.x(i), grid.y(j + 1) - grid.y(j)]
}

/// The three vertices of each corner of a cell, and the lengths of both edges at rest.
fn each_corner(grid: &Grid, cell: [u32; 2]) -> [([usize; 3], [f64; 2]); 4] {
    let ([a, b, c, d], [width, height]) = (corners(grid, cell), size(grid, cell));
    [
        ([a, b, d], [width, height]),
        ([b, c, a], [height, width]),
        ([c, d, b], [width, height]),
        ([d, a, c], [height, width]),
    ]
}

fn least_corner(grid: &Grid, places: &[Point], cell: [u32; 2]) -> f64 {
    let share = |([a, b, c], [u, v]): ([usize; 3], [f64; 2])| {
        (places[b] - places[a]).cross(places[c] - places[a]) / (u * v)
    };
    let shares = each_corner(grid, cell).map(share);
    shares.into_iter().fold(f64::INFINITY, f64::min)
}

/// A position in a cell as shares of its corners, and where it shall be.
#[derive(Clone, Copy)]
struct Aim {
    corners: [usize; 4],
    shares: [f64; 4],
    /// How far corners move to meet it, as shares of how far it is off.
    pulls: [f64; 4],
    place: Point,
}

impl Aim {
    /// `None` outside of the grid.
    fn new(grid: &Grid, rest: Point, place: Point) -> Option<Self> {
        let (width, height) = grid.cell();
        let last = |lines: u32| f64::from(lines - 2);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within the grid"
        )]
        let line = |v: f64, cell: f64, lines: u32| (v / cell).clamp(0.0, last(lines)) as u32;
        let cell = [
            line(rest.x, width, grid.columns()),
            line(rest.y, height, grid.rows()),
        ];
        let own = size(grid, cell);
        let s = (rest.x - grid.x(cell[0])) / own[0];
        let t = (rest.y - grid.y(cell[1])) / own[1];
        let is_inside = [s, t].iter().all(|share| (0.0..=1.0).contains(share));
        let shares = [(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t];
        let sum: f64 = shares.iter().map(|share| share * share).sum();
        is_inside.then(|| Self {
            corners: corners(grid, cell),
            shares,
            pulls: shares.map(|share| -share / sum),
            place,
        })
    }

    /// How far it is off.
    fn off(&self, places: &[Point]) -> Vec2 {
        let origin = self.place;
        let terms = self.corners.iter().zip(self.shares);
        terms.fold(Vec2::ZERO, |sum, (vertex, share)| {
            sum + (places[*vertex] - origin) * share
        })
    }
}

/// The vertices that may move, and all cells that have one of them.
struct FreePatch<'a> {
    grid: &'a Grid,
    /// Among the vertices that may move, the number of each.
    free: Vec<Option<usize>>,
    vertices: Vec<usize>,
    cells: Vec<PatchCell>,
    targets: Vec<Aim>,
}

/// A vertex that does not move.
const STAYS: u32 = u32::MAX;

/// A cell with a vertex that may move.
struct PatchCell {
    cell: [u32; 2],
    corners: [u32; 4],
    /// The numbers of its corners among the vertices that may move, or [`STAYS`].
    numbers: [u32; 4],
    /// One by its width and by its height.
    inverse: [f64; 2],
}

impl<'a> FreePatch<'a> {
    /// `rings`: how many cells from folded ones vertices may move. `None` when cancelled.
    fn around(
        grid: &'a Grid,
        bad: &[[u32; 2]],
        rings: u32,
        targets: &[Aim],
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let mut free = vec![None; grid.len()];
        for [i, j] in bad {
            if cancelled() {
                return None;
            }
            // The lines between the first and the last one.
            let lines = |line: u32, all: u32| {
                line.saturating_sub(rings).max(1)..(line + 2 + rings).min(all - 1)
            };
            for y in lines(*j, grid.rows()) {
                for x in lines(*i, grid.columns()) {
                    free[y as usize * grid.columns() as usize + x as usize] = Some(0);
                }
            }
        }
        let mut vertices = Vec::new();
        for (vertex, number) in free.iter_mut().enumerate() {
            if let Some(number) = number {
                *number = vertices.len();
                vertices.push(vertex);
            }
        }
        let touches = |corners: &[usize; 4]| corners.iter().any(|vertex| free[*vertex].is_some());
        let cells = cells(grid).filter_map(|cell| {
            let corners = corners(grid, cell);
            touches(&corners).then(|| PatchCell {
                cell,
                corners: corners.map(of_u32),
                numbers: corners.map(|vertex| free[vertex].map_or(STAYS, of_u32)),
                inverse: size(grid, cell).map(|side| 1.0 / side),
            })
        });
        let targets = targets.iter().copied();
        Some(Self {
            cells: cells.collect(),
            targets: targets.filter(|target| touches(&target.corners)).collect(),
            grid,
            free,
            vertices,
        })
    }

    /// Moves the vertices; returns the evaluations so far. `None` when cancelled.
    fn mend(
        &self,
        places: &mut [Point],
        (mut evaluations, most): (u32, u32),
        cancelled: &dyn Fn() -> bool,
    ) -> Option<u32> {
        let mut weight = TARGET_WEIGHT;
        let mut least = self.least(places);
        let floor = |least: f64, floor: f64| (floor + 0.04 * least.min(0.0).powi(2)).sqrt();
        let (mut barrier, mut before) = (floor(least, 1e-6).max(1e-3), f64::INFINITY);
        for pass in 0..PASSES {
            let mut x: Vec<Vec2> = self.positions(places);
            let mut energy = |x: &[Vec2], slope: &mut [Vec2]| {
                self.put(x, places);
                self.energy(places, (barrier, weight), slope, cancelled)
            };
            let spare = most.saturating_sub(evaluations);
            let (after, spent) = minimise(&mut energy, &mut x, spare, cancelled)?;
            // What was stopped has no energy.
            if cancelled() {
                return None;
            }
            evaluations += spent;
            self.put(&x, places);
            least = self.least(places);
            let off = self.targets.iter().map(|target| target.off(places).norm());
            let is_off = off.fold(0.0, f64::max) > MOST_OFF;
            if (least > MENDED_DETERMINANT && !is_off) || evaluations >= most {
                break;
            }
            if is_off {
                weight *= WEIGHT_GROWTH;
            }
            barrier = if pass < HALVING_PASSES {
                (barrier / 2.0).min(floor(least, 1e-12))
            } else {
                let gained = (1.0 - after / before).max(0.1);
                let goal = (1.0 - if gained.is_finite() { gained } else { 0.1 })
                    * softened(least, barrier)[0];
                if least < goal {
                    2.0 * (goal * (goal - least)).sqrt()
                } else {
                    1e-9
                }
            };
            before = after;
        }
        Some(evaluations)
    }

    fn positions(&self, places: &[Point]) -> Vec<Vec2> {
        let of = |vertex: &usize| places[*vertex] - Point::default();
        self.vertices.iter().map(of).collect()
    }

    fn put(&self, x: &[Vec2], places: &mut [Point]) {
        for (vertex, x) in self.vertices.iter().zip(x) {
            places[*vertex] = Point::default() + *x;
        }
    }

    fn least(&self, places: &[Point]) -> f64 {
        let cells = self.cells.iter();
        let least = cells.map(|of| least_corner(self.grid, places, of.cell));
        least.fold(f64::INFINITY, f64::min)
    }

    /// The distortion of all cells and the distances from targets, and its slope by each vertex;
    /// infinite when cancelled.
    fn energy(
        &self,
        places: &[Point],
        (barrier, weight): (f64, f64),
        slope: &mut [Vec2],
        cancelled: &dyn Fn() -> bool,
    ) -> f64 {
        slope.fill(Vec2::ZERO);
        let mut sum = 0.0;
        for (index, cell) in self.cells.iter().enumerate() {
            if index % BETWEEN_CHECKS == BETWEEN_CHECKS - 1 && cancelled() {
                return f64::INFINITY;
            }
            let of = |number: u32| slope.get(number as usize).copied().unwrap_or_default();
            let mut slopes = cell.numbers.map(of);
            sum = cell.add_distortion(places, barrier, sum, &mut slopes);
            for (number, of_corner) in cell.numbers.iter().zip(slopes) {
                if let Some(slope) = slope.get_mut(*number as usize) {
                    *slope = of_corner;
                }
            }
        }
        for target in &self.targets {
            let off = target.off(places);
            sum += 0.5 * weight * off.norm2();
            for (vertex, share) in target.corners.iter().zip(target.shares) {
                if let Some(number) = self.free[*vertex] {
                    slope[number] += off * (weight * share);
                }
            }
        }
        sum
    }
}

/// A determinant without its sign: near itself where it is positive, small and positive where it is
/// not; and its slope.
fn softened(det: f64, barrier: f64) -> [f64; 2] {
    let root = (barrier * barrier + det * det).sqrt();
    // Both without a branch, so that four corners fill vectors.
    let [above, below] = [0.5 * (det + root), 0.5 * barrier * barrier / (root - det)];
    let soft = if det > 0.0 { above } else { below };
    [soft, soft / root]
}

impl PatchCell {
    /// Adds the distortion of its corners to a sum, and its slopes to those of its corners.
    fn add_distortion(
        &self,
        places: &[Point],
        barrier: f64,
        mut sum: f64,
        slopes: &mut [Vec2; 4],
    ) -> f64 {
        let at = self.corners.map(|vertex| places[vertex as usize]);
        let scale = |k: usize| self.inverse[k % 2];
        // The edges of each corner, in units of those at rest.
        let u: [Vec2; 4] = std::array::from_fn(|k| (at[(k + 1) % 4] - at[k]) * scale(k));
        let v: [Vec2; 4] = std::array::from_fn(|k| (at[(k + 3) % 4] - at[k]) * scale(k + 1));
        let edges = [
            u.map(|u| u.x),
            u.map(|u| u.y),
            v.map(|v| v.x),
            v.map(|v| v.y),
        ];
        let (energy, [ux, uy, vx, vy]) = distortions(edges, barrier);
        for k in 0..4 {
            let du = Vec2::new(ux[k], uy[k]) * scale(k);
            let dv = Vec2::new(vx[k], vy[k]) * scale(k + 1);
            sum += energy[k];
            slopes[(k + 1) % 4] += du;
            slopes[(k + 3) % 4] += dv;
            slopes[k] += -(du + dv);
        }
        sum
    }
}

/// Numbers of four corners, side by side, so that they fill vectors.
type OfCorners = [f64; 4];

/// The distortion of corners with the edges `[ux, uy, vx, vy]`, in units of those at rest, and its
/// slopes.
fn distortions([ux, uy, vx, vy]: [OfCorners; 4], barrier: f64) -> (OfCorners, [OfCorners; 4]) {
    let (mut energies, mut slopes) = (OfCorners::default(), [OfCorners::default(); 4]);
    for k in 0..4 {
        let (u, v) = (Vec2::new(ux[k], uy[k]), Vec2::new(vx[k], vy[k]));
        let det = u.cross(v);
        let [soft, slope] = softened(det, barrier);
        let size = 0.5 * (u.norm2() + v.norm2()) + 0.5 * AREA_WEIGHT * (det * det + 1.0);
        let energy = size / soft;
        let by_det = AREA_WEIGHT * det / soft - energy * slope / soft;
        let du = u * (1.0 / soft) + Vec2::new(v.y, -v.x) * by_det;
        let dv = v * (1.0 / soft) + Vec2::new(-u.y, u.x) * by_det;
        energies[k] = energy;
        [slopes[0][k], slopes[1][k], slopes[2][k], slopes[3][k]] = [du.x, du.y, dv.x, dv.y];
    }
    (energies, slopes)
}
