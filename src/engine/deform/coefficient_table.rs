//! The plan: the coefficients A_j of every vertex of a grid, computed once in f64 and stored as
//! f32, so that each later q costs two to six multiplications per vertex and handle.
//!
//! Shapes: blocks of [`LANES`] vertices; per block and term one [`CoefficientLanes`] (real), two
//! (complex: re, im of C) or three (rigid: re, im of H, wn), and two more per block for rigid (e).
//! A term is a column, unless the method says otherwise. A block is read from front to back.

use std::sync::Arc;

use crate::parallel::prelude::*;

use super::Pose;
use super::form::CoefficientForm;
use super::kernel::{self, CoefficientLanes, lanes_per_block};
use super::lanes::{Coefficients, LANES, Vertices, gather};
use super::point_map::PointMap;
use super::rest_deformation::RestDeformation;
use super::workspace::Workspace;
use crate::geometry::{Grid, Mesh, Point, Vec2};

/// Blocks that one task computes: about a hundred rows, which makes the cost of a task negligible.
const BLOCKS_PER_TASK: usize = 8;
/// Tables up to this size are posed on one thread, bytes: reading 1 MiB takes less time than waking
/// a second thread.
const SERIAL_BYTES: u64 = 2 << 20;
/// Tables are filled and posed in pieces of this size, bytes, which take a few milliseconds;
/// cancellation is checked between them.
const PIECE_BYTES: usize = 16 << 20;

/// Returns true when the result is no longer needed; called by any thread.
pub type IsCancelled<'a> = &'a (dyn Fn() -> bool + Sync);

/// The A_j table of a set of vertices.
#[derive(Debug)]
pub struct CoefficientTable {
    map: Arc<dyn PointMap>,
    form: CoefficientForm,
    columns: usize,
    /// Vectors that the coefficients of a vertex multiply.
    terms: usize,
    vertices: usize,
    table: Vec<CoefficientLanes>,
}

/// Quality of a pose, measured while it is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseQuality {
    /// Least |m| over the vertices for rigid (1 for other forms): near 0 the rotation is undefined.
    pub least_rotation: f32,
}

impl CoefficientTable {
    /// Memory that the table of `vertices` vertices takes, bytes; known before anything is
    /// allocated.
    #[must_use]
    pub fn bytes_for(field: &RestDeformation, vertices: usize) -> u64 {
        let lanes = lanes_per_block(field.form(), field.terms()) as u64;
        vertices.div_ceil(LANES) as u64 * lanes * size_of::<CoefficientLanes>() as u64
    }

    /// Whether a table is worth its time and its memory for posing: what it saves of each pose may
    /// be less than what reading it takes.
    #[must_use]
    pub fn is_worthwhile(field: &RestDeformation) -> bool {
        field.map.has_table(&field.set)
    }

    /// Why there is no table for clients, if it is not worth its time.
    #[must_use]
    pub fn reason_against(field: &RestDeformation) -> Option<&'static str> {
        field.map.without_table()
    }

    /// Whether rows inside cells are worth keeping.
    #[must_use]
    pub fn rows_inside_cells_pay(field: &RestDeformation) -> bool {
        Self::is_worthwhile(field) && field.map.keeps_coefficients(&field.set)
    }

    /// Whether a table of this size is posed on one thread, whatever the current rayon pool.
    #[must_use]
    pub const fn is_posed_on_one_thread(bytes: u64) -> bool {
        bytes <= SERIAL_BYTES
    }

    /// Memory of this table, bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        size_of_val(self.table.as_slice()) as u64
    }

    /// Fills the table for the vertices of a grid, in parallel on the current pool; `None` when
    /// cancelled, which is checked for each block of vertices.
    #[must_use]
    pub fn of_grid(
        field: &RestDeformation,
        grid: &Grid,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let columns = grid.columns() as usize;
        let block = |at: &dyn Fn(usize) -> usize| gather(|lane| vertex(grid, columns, at(lane)));
        Self::fill(field, grid.len(), block, cancelled)
    }

    /// Fills the table for vertices of which each belongs to a pixel, counted row by row: those of
    /// a grid that is cut along a mask. `None` when cancelled.
    #[must_use]
    pub fn of_cut(
        field: &RestDeformation,
        vertices: &[(Point, u32)],
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let block = |at: &dyn Fn(usize) -> usize| {
            let mut block = gather(|lane| vertices[at(lane)].0);
            for (lane, pixel) in block.pixel.iter_mut().enumerate() {
                *pixel = vertices[at(lane)].1;
            }
            block
        };
        Self::fill(field, vertices.len(), block, cancelled)
    }

    /// Fills the table for any vertices, `vertex(0..vertices)`.
    #[must_use]
    pub fn of_vertices(
        field: &RestDeformation,
        vertices: usize,
        vertex: impl Fn(usize) -> Point + Sync,
    ) -> Self {
        let block = |at: &dyn Fn(usize) -> usize| gather(|lane| vertex(at(lane)));
        Self::fill(field, vertices, block, &|| false).expect("nothing gives it up")
    }

    fn fill(
        field: &RestDeformation,
        vertices: usize,
        block_of: impl Fn(&dyn Fn(usize) -> usize) -> Vertices<LANES> + Sync,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let (form, terms) = (field.form(), field.terms());
        let per_block = lanes_per_block(form, terms);
        let blocks = vertices.div_ceil(LANES);
        let mut table = Vec::with_capacity(blocks * per_block);
        let per_piece = blocks_per_piece(per_block);
        for piece in (0..if per_block > 0 { blocks } else { 0 }).step_by(per_piece) {
            // Reserves a piece at a time, because touching the memory of a large table takes tenths
            // of a second.
            let start = table.len();
            table.resize(
                per_block * blocks.min(piece + per_piece),
                CoefficientLanes::default(),
            );
            table[start..]
                .par_chunks_mut(per_block * BLOCKS_PER_TASK)
                .enumerate()
                .try_for_each_init(
                    || Workspace::<LANES>::new(terms),
                    |workspace, (task, blocks)| {
                        for (k, block) in blocks.chunks_exact_mut(per_block).enumerate() {
                            if cancelled() {
                                return None;
                            }
                            let first = (piece + task * BLOCKS_PER_TASK + k) * LANES;
                            // The last block repeats the last vertex.
                            field.rows(
                                &block_of(&|lane| (first + lane).min(vertices - 1)),
                                false,
                                workspace,
                            );
                            store(form, &workspace.rows, block);
                        }
                        Some(())
                    },
                )?;
        }
        Some(Self {
            map: Arc::clone(&field.map),
            form,
            columns: field.handles().columns(),
            terms,
            vertices,
            table,
        })
    }

    /// The displacement of every vertex, px; `None` when cancelled. O(vertices x columns), one pass
    /// over the table.
    #[must_use]
    pub fn displace(
        &self,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<(Vec<[f32; 2]>, PoseQuality)> {
        assert_eq!(
            pose.displacements().len(),
            self.columns,
            "the pose belongs to the plan's handles"
        );
        let mut quality = PoseQuality {
            least_rotation: 1.0,
        };
        if pose.is_identity() || self.columns == 0 {
            return Some((vec![[0.0; 2]; self.vertices], quality));
        }
        let terms = self.map.terms_of(pose.displacements());
        let terms = terms.as_deref().unwrap_or(pose.displacements());
        let d: Vec<[f32; 2]> = terms.iter().map(|d| to_f32(*d)).collect();
        let per_block = lanes_per_block(self.form, self.terms);
        let blocks = self.vertices.div_ceil(LANES);
        let mut out = Vec::with_capacity(blocks);
        let threads = crate::parallel::current_num_threads();
        let piece = blocks_per_piece(per_block) * per_block;
        if threads == 1 || Self::is_posed_on_one_thread(self.bytes()) {
            for table in self.table.chunks(piece) {
                if cancelled() {
                    return None;
                }
                quality.least_rotation = quality
                    .least_rotation
                    .min(kernel::displace(self.form, table, &d, &mut out));
            }
        } else {
            let parts: Option<Vec<_>> = self
                .table
                .par_chunks((blocks.div_ceil(4 * threads) * per_block).min(piece))
                .map(|table| {
                    let mut out = Vec::new();
                    (!cancelled()).then(|| (kernel::displace(self.form, table, &d, &mut out), out))
                })
                .collect();
            for (least, part) in parts? {
                quality.least_rotation = quality.least_rotation.min(least);
                out.extend(part);
            }
        }
        // The last block repeats its last vertex.
        let mut out = out.into_flattened();
        out.truncate(self.vertices);
        Some((out, quality))
    }

    /// Numbers per vertex in [`CoefficientTable::planes`].
    #[must_use]
    pub fn planes_for(field: &RestDeformation) -> usize {
        field.terms() * lanes_per_block(field.form(), 1).min(3)
    }

    /// The coefficients for clients that pose by themselves, plane by plane: each plane has one
    /// number per vertex. A term, which is a column unless the method says otherwise, has one plane
    /// (real: C), two (complex: re and im of C) or three (rigid: re and im of `B = e H`, and wn).
    /// With the position of each column at rest (P) and posed (Q), `p* = sum wn P`, `q* = sum wn Q`
    /// and `e = v - p*`, rigid is `q* + |e| F / |F|` for `F = e + sum B (Q - P)`.
    pub fn planes(&self) -> impl Iterator<Item = impl Iterator<Item = f32> + '_> + '_ {
        let per_block = lanes_per_block(self.form, self.terms);
        let per_term = lanes_per_block(self.form, 1).min(3);
        (0..self.terms * per_term).map(move |plane| {
            let blocks = self.table.chunks_exact(per_block);
            blocks
                .flat_map(move |block| self.plane_of_block(block, plane).0)
                .take(self.vertices)
        })
    }

    fn plane_of_block(&self, block: &[CoefficientLanes], plane: usize) -> CoefficientLanes {
        let (CoefficientForm::Rigid, [.., ex, ey]) = (self.form, block) else {
            return block[plane];
        };
        let first = plane - plane % 3;
        let product = |lane: usize| {
            let ([re, im], [ex, ey]) = (
                [block[first].0[lane], block[first + 1].0[lane]],
                [ex.0[lane], ey.0[lane]],
            );
            if plane == first {
                ex * re - ey * im
            } else {
                ex * im + ey * re
            }
        };
        if plane - first == 2 {
            block[plane]
        } else {
            CoefficientLanes(std::array::from_fn(product))
        }
    }

    /// Number of vertices.
    pub(super) const fn len(&self) -> usize {
        self.vertices
    }

    /// The blocks of a table whose coefficients have the weights of the columns, the third of each;
    /// `None` if they do not.
    pub(super) fn weights(&self) -> Option<impl Iterator<Item = &[CoefficientLanes]>> {
        let per_block = lanes_per_block(self.form, self.terms);
        (self.form == CoefficientForm::Rigid && per_block > 0)
            .then(|| self.table.chunks_exact(per_block))
    }

    /// The posed mesh of the grid that the plan was made for; `None` when cancelled.
    #[must_use]
    pub fn pose(
        &self,
        grid: &Grid,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<(Mesh, PoseQuality)> {
        let (displacement, quality) = self.displace(pose, cancelled)?;
        Some((Mesh::new(*grid, displacement), quality))
    }
}

/// Blocks per piece of a table.
fn blocks_per_piece(per_block: usize) -> usize {
    (PIECE_BYTES / size_of::<CoefficientLanes>() / per_block.max(1)).max(BLOCKS_PER_TASK)
}

pub(super) fn vertex(grid: &Grid, columns: usize, k: usize) -> Point {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "k < columns * rows, both u32"
    )]
    grid.vertex((k % columns) as u32, (k / columns) as u32)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "f32 is the precision of the table"
)]
pub(super) fn to_f32(d: Vec2) -> [f32; 2] {
    [d.x as f32, d.y as f32]
}

/// Writes the rows of a block.
pub(super) fn store(
    form: CoefficientForm,
    rows: &Coefficients<LANES>,
    block: &mut [CoefficientLanes],
) {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "f32 is the precision of the table"
    )]
    let put = |lanes: &mut CoefficientLanes, row: &[f64; LANES]| lanes.0 = row.map(|x| x as f32);
    match form {
        CoefficientForm::Real => {
            for (lanes, c) in block.iter_mut().zip(&rows.h) {
                put(lanes, &c[0]);
            }
        }
        CoefficientForm::Complex => {
            for (lanes, c) in block.chunks_exact_mut(2).zip(&rows.h) {
                put(&mut lanes[0], &c[0]);
                put(&mut lanes[1], &c[1]);
            }
        }
        CoefficientForm::Rigid => {
            for ((lanes, h), wn) in block.chunks_exact_mut(3).zip(&rows.h).zip(&rows.wn) {
                put(&mut lanes[0], &h[0]);
                put(&mut lanes[1], &h[1]);
                put(&mut lanes[2], wn);
            }
            if let [.., ex, ey] = block {
                put(ex, &rows.e[0]);
                put(ey, &rows.e[1]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::deform::{Falloff, Handle, Handles, Method, pose_without_table};

    fn field(count: u32) -> (RestDeformation, Pose) {
        let place = |k: u32| {
            Point::new(
                f64::from(k % 10) * 31.0 + 3.3,
                f64::from(k / 10) * 17.0 + 5.1,
            )
        };
        let moved = |k: u32| Handle::Point(place(k) + Vec2::new(3.0, f64::from(k % 3)));
        let rest =
            Handles::new((0..count).map(|k| Handle::Point(place(k))).collect(), None).unwrap();
        let field =
            RestDeformation::new(rest, Method::Rigid, Falloff::new(1.3, false).unwrap(), 1.0)
                .unwrap();
        let pose = field
            .pose(&(0..count).map(moved).collect::<Vec<_>>())
            .unwrap();
        (field, pose)
    }

    #[test]
    fn what_nobody_waits_for_is_given_up_at_the_next_look() {
        let (field, pose) = field(100);
        // Two pieces of a table.
        let grid = Grid::with_counts(300.0, 200.0, 200, 100);
        let plan = CoefficientTable::of_grid(&field, &grid, &|| false).unwrap();
        assert!(plan.bytes() > PIECE_BYTES as u64);
        type GivesUp<'a> = &'a (dyn Fn(IsCancelled<'_>) -> bool + Sync);
        let works: [(&str, usize, GivesUp<'_>); 3] = [
            ("filling", grid.len() / LANES, &|cancelled| {
                CoefficientTable::of_grid(&field, &grid, cancelled).is_none()
            }),
            ("posing", 2, &|cancelled| {
                plan.pose(&grid, &pose, cancelled).is_none()
            }),
            ("without a table", grid.len() / LANES, &|cancelled| {
                pose_without_table(&field, &grid, &pose, cancelled).is_none()
            }),
        ];
        let one = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        for (name, looks, work) in works {
            for after in [0, 1, looks / 2, looks - 1] {
                let asked = AtomicUsize::new(0);
                let gave_up =
                    one.install(|| work(&|| asked.fetch_add(1, Ordering::Relaxed) >= after));
                assert!(gave_up, "{name}, after {after} of {looks}");
                assert_eq!(asked.into_inner(), after + 1, "{name}");
            }
        }
    }

    #[test]
    fn a_table_of_several_pieces_has_no_seam() {
        let (field, pose) = field(100);
        let grid = Grid::with_counts(300.0, 200.0, 200, 100);
        let (displacement, _) = CoefficientTable::of_grid(&field, &grid, &|| false)
            .unwrap()
            .displace(&pose, &|| false)
            .unwrap();
        for (k, d) in displacement.iter().enumerate() {
            let v = vertex(&grid, 200, k);
            let want = to_f32(field.map(&pose, v) - v);
            assert!(
                (d[0] - want[0]).abs() < 1e-3 && (d[1] - want[1]).abs() < 1e-3,
                "vertex {k}: {d:?} {want:?}"
            );
        }
    }
}
