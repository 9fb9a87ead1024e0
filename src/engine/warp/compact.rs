//! Compact meshes: the posed grid at every n-th of its lines, as 16-bit displacements. The lines
//! depend on the rest handles, the other settings of the warp, the image's size and the tolerance,
//! not on the pose: a client learns them once.

use super::posed_mesh::PosedMesh;
use super::{CompiledRest, ResolvedRest, WarpError};
use crate::deform::{Handle, IsCancelled, Pose};
use crate::geometry::{Grid, Mesh, Point, Vec2};

/// Most vertices: a frame of the drag socket, with its number and the scale, has at most 20,000
/// bytes.
const MOST_VERTICES: usize = 4997;
/// The largest 16-bit displacement.
const LARGEST_DISPLACEMENT: f32 = 32_767.0;
/// How far the handles of a reference pose move along an axis, as a share of the picture's shorter
/// side.
const REFERENCE_MOVE_SHARE: f64 = 0.1;
/// Most reference poses.
const MOST_POSES: usize = 16;
/// Most work of the choice, in products of a vertex with a column or with a candidate; at least two
/// poses.
const MAX_PRODUCTS: usize = 1 << 26;
/// Candidates, about: those of a grid of 100 lines.
const CANDIDATE_COUNT: usize = 12;
/// On a grid of more vertices, the finest lattice is taken, whatever its error.
const COMPARED_VERTICES: usize = 1 << 20;

/// The lattice of compact meshes: every n-th line of the grid along each axis, and the last one.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactLattice {
    grid: Grid,
    step: usize,
    tolerance: f64,
    error: Option<f64>,
}

impl CompactLattice {
    /// The coarsest of some lattices whose meshes are within `tolerance` px of the full ones at the
    /// reference poses; if none is, or the grid has more than 2^20 vertices, the finest with at
    /// most 4,997 vertices. CPU work: poses at most 16 meshes, or two large ones, and compares each
    /// with about a dozen lattices. Stops when `cancelled` returns true.
    ///
    /// In a reference pose one handle is moved along one axis, towards the middle of the picture,
    /// by a tenth of the shorter side. Of more than eight handles (fewer of them on a large grid)
    /// several are moved at once. Handles that coincide are moved together; poses that contradict
    /// each other are left out if the policy is to reject them.
    ///
    /// # Errors
    /// Cancelled.
    pub fn new(
        setup: &ResolvedRest,
        plan: &CompiledRest,
        tolerance: f64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let grid = setup.grid();
        let mut steps = steps(grid);
        let mut errors = vec![0.0_f64; steps.len()];
        let (mut is_measured, has_handles) =
            (false, !setup.field().client_handles().handles().is_empty());
        for pose in reference_poses(setup) {
            let (mesh, _) = setup.mesh(plan, None, &pose, cancelled)?;
            let mut k = 0;
            while k < steps.len() {
                let (_, displacement) = Quantized::new(&mesh, steps[k]).displacement();
                errors[k] = errors[k].max(distance(&mesh, steps[k], &displacement, cancelled)?);
                if k > 0 && errors[k] > tolerance {
                    steps.truncate(k);
                }
                k += 1;
            }
            is_measured = true;
        }
        if has_handles && !is_measured {
            return Ok(Self {
                grid: *grid,
                step: steps[0],
                tolerance,
                error: None,
            });
        }
        let coarsest = steps.len() - 1;
        Ok(Self {
            grid: *grid,
            step: steps[coarsest],
            tolerance,
            error: Some(errors[coarsest]),
        })
    }

    /// The lines at rest.
    #[must_use]
    pub fn grid(&self) -> Grid {
        self.grid.thinned(self.step)
    }

    /// The tolerance that the lattice was chosen for, px.
    #[must_use]
    pub const fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// The largest distance between the compact and the full mesh at the reference poses, px;
    /// `None` if all of them are conflicting.
    #[must_use]
    pub const fn error(&self) -> Option<f64> {
        self.error
    }

    /// The mesh of a pose, and its largest distance from the full one, px. The file, little-endian:
    /// the scale (f32, px), then x and y of the displacement of each vertex, row by row, as i16 in
    /// units of the scale. The scale is the largest displacement / 32,767.
    ///
    /// # Errors
    /// Cancelled.
    pub fn to_le_bytes(
        &self,
        posed: &PosedMesh,
        cancelled: IsCancelled<'_>,
    ) -> Result<(Vec<u8>, f64), WarpError> {
        let quantized = Quantized::new(posed.mesh(), self.step);
        let (units, displacement) = quantized.displacement();
        let error = distance(posed.mesh(), self.step, &displacement, cancelled)?;
        let mut out = Vec::with_capacity(4 + 4 * units.len());
        out.extend(quantized.scale.to_le_bytes());
        out.extend(units.into_iter().flatten().flat_map(i16::to_le_bytes));
        Ok((out, error))
    }
}

/// Steps between lines, ascending: those of lattices that have few enough vertices. With the
/// largest the lattice is a single cell.
fn steps(grid: &Grid) -> Vec<usize> {
    let cells = grid.columns().max(grid.rows()) as usize - 1;
    let first = (1..cells)
        .find(|&step| grid.thinned(step).len() <= MOST_VERTICES)
        .unwrap_or(cells);
    let more = if grid.len() > COMPARED_VERTICES {
        first
    } else {
        cells
    };
    std::iter::successors(Some(first), |&step| {
        (step < more).then(|| (step * 3 / 2).max(step + 1).min(cells))
    })
    .collect()
}

/// See [`CompactLattice::new`].
fn reference_poses(setup: &ResolvedRest) -> impl Iterator<Item = Pose> + '_ {
    let (grid, field) = (setup.grid(), setup.field());
    let handles = field.client_handles().handles();
    let mut leader: Vec<usize> = (0..handles.len()).collect();
    for group in field.groups() {
        for &handle in &group {
            leader[handle] = leader[handle].min(leader[group[0]]);
        }
    }
    let columns: usize = handles.iter().map(|handle| handle.places().len()).sum();
    let sets = (MAX_PRODUCTS / grid.len().saturating_mul(columns + CANDIDATE_COUNT) / 2)
        .clamp(1, MOST_POSES / 2)
        .min(handles.len());
    let middle = Point::new(grid.width() / 2.0, grid.height() / 2.0);
    let far = REFERENCE_MOVE_SHARE * grid.width().min(grid.height());
    let towards = move |from: f64, to: f64| if from > to { -far } else { far };
    (0..2 * sets).filter_map(move |pose| {
        let posed = handles.iter().zip(&leader).map(|(handle, &leader)| {
            let first = handles[leader].places().first().copied().unwrap_or(middle);
            let along = if pose % 2 == 0 {
                Vec2::new(towards(first.x, middle.x), 0.0)
            } else {
                Vec2::new(0.0, towards(first.y, middle.y))
            };
            match handle {
                moved if leader % sets != pose / 2 => moved.clone(),
                Handle::Point(p) => Handle::Point(*p + along),
                Handle::Polyline(places) => {
                    Handle::Polyline(places.iter().map(|p| *p + along).collect())
                }
                Handle::Missing => Handle::Missing,
            }
        });
        field.pose(&posed.collect::<Vec<_>>()).ok()
    })
}

/// Displacements at every n-th line, px, and the scale of their units.
struct Quantized {
    displacement: Vec<[f32; 2]>,
    scale: f32,
}

impl Quantized {
    fn new(mesh: &Mesh, step: usize) -> Self {
        let (columns, rows) = (mesh.grid().columns() as usize, mesh.grid().rows() as usize);
        let row = |j: usize| {
            let row = &mesh.displacement()[j * columns..][..columns];
            lines(columns, step).map(|i| row[i])
        };
        let displacement: Vec<_> = lines(rows, step).flat_map(row).collect();
        let largest = displacement
            .iter()
            .flatten()
            .fold(0.0_f32, |largest, d| largest.max(d.abs()));
        Self {
            displacement,
            scale: largest.min(f32::MAX) / LARGEST_DISPLACEMENT,
        }
    }

    /// In units of the scale, and as they are read again, px.
    fn displacement(&self) -> (Vec<[i16; 2]>, Vec<[f32; 2]>) {
        let Self {
            displacement,
            scale,
        } = self;
        #[expect(clippy::cast_possible_truncation, reason = "clamped; 0 / 0 is 0")]
        let units = displacement
            .iter()
            .map(|d| {
                d.map(|d| {
                    (d / scale)
                        .round()
                        .clamp(-LARGEST_DISPLACEMENT, LARGEST_DISPLACEMENT)
                        as i16
                })
            })
            .collect::<Vec<_>>();
        let read = units
            .iter()
            .map(|units| units.map(|unit| f32::from(unit) * scale))
            .collect();
        (units, read)
    }
}

/// Every n-th of `count` lines, and the last.
fn lines(count: usize, step: usize) -> impl Iterator<Item = usize> {
    (0..=(count - 1).div_ceil(step)).map(move |line| (line * step).min(count - 1))
}

/// Of each line between those of the lattice: the one before in the lattice, and the position
/// between that and the next.
fn between(count: usize, step: usize, at: impl Fn(usize) -> f64) -> Vec<(usize, f32)> {
    let last = (count - 1).div_ceil(step) - 1;
    let place = |line: usize| {
        let before = (line / step).min(last);
        let (a, b) = (at(before * step), at((before * step + step).min(count - 1)));
        #[expect(clippy::cast_possible_truncation, reason = "0 to 1")]
        let share = ((at(line) - a) / (b - a)) as f32;
        (before, share)
    };
    (0..count).map(place).collect()
}

/// The largest distance between a mesh and the one with `displacement` at every n-th line, px.
/// Their difference is bilinear in the cells of the full mesh, so it is largest at a vertex.
fn distance(
    mesh: &Mesh,
    step: usize,
    displacement: &[[f32; 2]],
    cancelled: IsCancelled<'_>,
) -> Result<f64, WarpError> {
    let grid = mesh.grid();
    let (columns, rows) = (grid.columns() as usize, grid.rows() as usize);
    #[expect(clippy::cast_possible_truncation, reason = "lines of a grid are u32")]
    let (across, down) = (
        between(columns, step, |i| grid.x(i as u32)),
        between(rows, step, |j| grid.y(j as u32)),
    );
    let mix = |a: [f32; 2], b: [f32; 2], t: f32| [0, 1].map(|k| a[k] + t * (b[k] - a[k]));
    let coarse = displacement.len() / ((rows - 1).div_ceil(step) + 1);
    let mut line = Vec::with_capacity(coarse);
    let mut worst = 0.0_f32;
    for (full, &(above, t)) in mesh.displacement().chunks_exact(columns).zip(&down) {
        if cancelled() {
            return Err(WarpError::Cancelled);
        }
        let (top, bottom) = (
            &displacement[above * coarse..][..coarse],
            &displacement[(above + 1) * coarse..][..coarse],
        );
        line.clear();
        line.extend(top.iter().zip(bottom).map(|(a, b)| mix(*a, *b, t)));
        for (full, &(left, s)) in full.iter().zip(&across) {
            let drawn = mix(line[left], line[left + 1], s);
            let (x, y) = (drawn[0] - full[0], drawn[1] - full[1]);
            worst = worst.max(x * x + y * y);
        }
    }
    Ok(f64::from(worst).sqrt())
}
