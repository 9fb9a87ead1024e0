//! Exact rows inside the cells of a grid: the coefficients of the vertices that halving a cell
//! adds. Computed when a pose first needs them, and kept while they fit; those that do not fit are
//! computed again for each pose, to the same bits, because each vertex has its own lane.
//!
//! Shapes: a group holds the vertices that one halving adds to one cell, those of
//! `[2^level + 1][2^level + 1]` with an odd index, row by row. Small groups share a block of
//! [`LANES`] vertices.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use crate::parallel::prelude::*;

use super::coefficient_table::{IsCancelled, store};
use super::kernel::{self, BlockDisplacements, CoefficientLanes, lanes_per_block};
use super::lanes::{LANES, gather};
use super::posed_map::PosedMap;
use super::rest_deformation::RestDeformation;
use super::workspace::Workspace;
use crate::geometry::{Grid, Point};

/// Most times that a cell is halved, which is enough for the cells of `grid: auto`.
pub(super) const MAX_SUBDIVISION_DEPTH: usize = 4;
/// Memory to find a group, bytes: its entry in a hash map that is half full, and a share of the
/// counters of its unit.
const ENTRY_BYTES: usize = 96;

/// Blocks of one or more groups, as the table of a plan, and what they hold.
type CachedBlocks = Arc<[CoefficientLanes]>;

/// The rows of some groups of a grid's cells.
#[derive(Debug)]
pub struct SubdivisionCache {
    kept: RwLock<HashMap<(u32, u8), (CachedBlocks, usize)>>,
    /// Memory that may still be taken, bytes.
    left: AtomicU64,
}

/// A set of handles, its grid, and a pose in the precision of the rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Posing<'a> {
    pub(super) field: &'a RestDeformation,
    /// Gives displacements without rows, where rows take longer than they save.
    pub(super) f: Option<&'a PosedMap<'a>>,
    pub(super) grid: &'a Grid,
    /// What coefficients multiply, px.
    pub(super) d: &'a [[f32; 2]],
    /// Whether rows are computed on this thread alone.
    pub(super) serial: bool,
}

/// The vertices of a group, `(a, b)` of the cell's lattice.
pub(super) fn group(level: u8) -> impl Iterator<Item = (u32, u32)> + Clone {
    let last = 1_u32 << level;
    (0..=last)
        .flat_map(move |b| (0..=last).map(move |a| (a, b)))
        .filter(|(a, b)| (a | b) & 1 == 1)
}

/// The number of vertices in a group.
pub(super) const fn group_len(level: u8) -> usize {
    let (fine, coarse) = ((1 << level) + 1, (1 << (level - 1)) + 1);
    fine * fine - coarse * coarse
}

/// Groups in a unit.
const fn groups_per_unit(level: u8) -> usize {
    let fit = LANES / group_len(level);
    if fit == 0 { 1 } else { fit }
}

/// The groups of some cells at rest. Cells that share a vertex compute the same bits.
fn vertices(grid: &Grid, cells: &[u32], level: u8) -> Vec<Point> {
    let (group, last) = (group(level).collect::<Vec<_>>(), 1_u32 << level);
    let mut vertices = Vec::with_capacity(cells.len() * group.len());
    let lines = |from: f64, to: f64| {
        let mut lines = [from; (1 << MAX_SUBDIVISION_DEPTH) + 1];
        for (k, line) in (1..last).zip(&mut lines[1..]) {
            *line = from + (to - from) * (f64::from(k) / f64::from(last));
        }
        lines[last as usize] = to;
        lines
    };
    for cell in cells {
        let (i, j) = (cell % (grid.columns() - 1), cell / (grid.columns() - 1));
        let (x, y) = (
            lines(grid.x(i), grid.x(i + 1)),
            lines(grid.y(j), grid.y(j + 1)),
        );
        let at = |(a, b): &(u32, u32)| Point::new(x[*a as usize], y[*b as usize]);
        vertices.extend(group.iter().map(at));
    }
    vertices
}

impl SubdivisionCache {
    /// Keeps rows of up to `bytes`.
    #[must_use]
    pub fn new(bytes: u64) -> Self {
        Self {
            kept: RwLock::default(),
            left: AtomicU64::new(bytes),
        }
    }

    /// Displacements of the groups of cells, which must be sorted, `[cells][group]`; `None` when
    /// cancelled, which is checked for each unit.
    pub(super) fn displace(
        &self,
        posing: &Posing<'_>,
        level: u8,
        cells: &[u32],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<[f32; 2]>> {
        // Where rows take longer than they save, f itself is evaluated, and nothing is kept.
        if let Some(f) = posing.f {
            let places = vertices(posing.grid, cells, level);
            return Some(f.displaced(&places, cancelled)?.0);
        }
        let len = group_len(level);
        let mut out = vec![[0.0; 2]; cells.len() * len];
        // Only references are taken under the lock; other poses of the same handles wait for no
        // arithmetic of this one.
        let found: Vec<Option<(CachedBlocks, usize)>> = {
            let kept = self.kept.read().unwrap_or_else(PoisonError::into_inner);
            cells
                .iter()
                .map(|&cell| kept.get(&(cell, level)).cloned())
                .collect()
        };
        // Unit by unit, because the groups of one need not follow each other.
        let mut known: Vec<(&CachedBlocks, usize, usize)> = (found.iter().enumerate())
            .filter_map(|(k, found)| found.as_ref().map(|(unit, group)| (unit, *group, k)))
            .collect();
        known.sort_unstable_by_key(|(unit, ..)| unit.as_ptr());
        let mut posed: Vec<BlockDisplacements> = Vec::new();
        for groups in known.chunk_by(|(a, ..), (b, ..)| Arc::ptr_eq(a, b)) {
            if cancelled() {
                return None;
            }
            posed.clear();
            kernel::displace(posing.field.form(), groups[0].0, posing.d, &mut posed);
            for (_, group, k) in groups {
                out[k * len..][..len].copy_from_slice(&posed.as_flattened()[group * len..][..len]);
            }
        }
        let missing: Vec<usize> = (0..cells.len()).filter(|&k| found[k].is_none()).collect();
        if missing.is_empty() {
            return Some(out);
        }
        let per_unit = groups_per_unit(level);
        let compute = |workspace: &mut Workspace<LANES>, indices: &[usize]| {
            if cancelled() {
                return None;
            }
            let unit_cells: Vec<u32> = indices.iter().map(|&k| cells[k]).collect();
            Some(self.unit(posing, level, &unit_cells, workspace))
        };
        let terms = posing.field.terms();
        let units: Option<Vec<(Vec<BlockDisplacements>, Option<CachedBlocks>)>> = if posing.serial {
            let mut workspace = Workspace::new(terms);
            missing
                .chunks(per_unit)
                .map(|indices| compute(&mut workspace, indices))
                .collect()
        } else {
            missing
                .par_chunks(per_unit)
                .map_init(|| Workspace::new(terms), compute)
                .collect()
        };
        // Units are put together in the order of the cells, whichever thread has computed them.
        let mut fresh = Vec::new();
        for (indices, (pairs, unit)) in missing.chunks(per_unit).zip(units?) {
            for (group, &k) in indices.iter().enumerate() {
                out[k * len..][..len].copy_from_slice(&pairs.as_flattened()[group * len..][..len]);
            }
            fresh.extend(unit.map(|unit| (indices, unit)));
        }
        self.keep(level, cells, fresh);
        Some(out)
    }

    /// Computes the rows of a unit; returns its displacements, and the rows if they may be kept.
    fn unit(
        &self,
        posing: &Posing<'_>,
        level: u8,
        cells: &[u32],
        workspace: &mut Workspace<LANES>,
    ) -> (Vec<BlockDisplacements>, Option<CachedBlocks>) {
        let Posing { field, grid, d, .. } = *posing;
        let places = vertices(grid, cells, level);
        let block_at = |places: &[Point]| gather(|lane| places[lane.min(places.len() - 1)]);
        let per_block = lanes_per_block(field.form(), field.terms());
        let blocks = places.len().div_ceil(LANES);
        let bytes =
            (blocks * per_block * size_of::<CoefficientLanes>() + cells.len() * ENTRY_BYTES) as u64;
        // The memory is taken before the rows are computed. Two poses that race for the last of it
        // cannot both keep theirs; the loser computes the same bits and drops them.
        let is_kept = self
            .left
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| {
                left.checked_sub(bytes)
            })
            .is_ok();
        let mut table = vec![
            CoefficientLanes::default();
            if is_kept {
                blocks * per_block
            } else {
                per_block
            }
        ];
        let mut pairs = Vec::with_capacity(blocks);
        for (k, places) in places.chunks(LANES).enumerate() {
            field.rows(&block_at(places), false, workspace);
            let block = if is_kept {
                &mut table[k * per_block..][..per_block]
            } else {
                &mut table[..]
            };
            store(field.form(), &workspace.rows, block);
            kernel::displace(field.form(), block, d, &mut pairs);
        }
        (pairs, is_kept.then(|| table.into()))
    }

    /// Keeps fresh rows, unless another thread was faster.
    fn keep(&self, level: u8, cells: &[u32], fresh: Vec<(&[usize], CachedBlocks)>) {
        if fresh.is_empty() {
            return;
        }
        let mut kept = self.kept.write().unwrap_or_else(PoisonError::into_inner);
        for (indices, unit) in fresh {
            for (group, &k) in indices.iter().enumerate() {
                kept.entry((cells[k], level))
                    .or_insert_with(|| (Arc::clone(&unit), group));
            }
            if Arc::strong_count(&unit) == 1 {
                self.left.fetch_add(
                    (size_of_val(&*unit) + indices.len() * ENTRY_BYTES) as u64,
                    Ordering::Relaxed,
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::deform::coefficient_table::to_f32;
    use crate::deform::{CoefficientTable, Falloff, Handle, Handles, Method, Pose};
    use crate::geometry::Vec2;

    /// Bytes of the units that are kept, each once, and of their entries.
    fn kept_bytes(rows: &SubdivisionCache) -> u64 {
        let kept = rows.kept.read().unwrap();
        let units: HashSet<_> = kept
            .values()
            .map(|(unit, _)| (unit.as_ptr(), size_of_val(&**unit)))
            .collect();
        units.iter().map(|(_, bytes)| *bytes as u64).sum::<u64>()
            + (kept.len() * ENTRY_BYTES) as u64
    }

    fn set() -> (RestDeformation, Pose, Grid) {
        let place =
            |k: u32| Point::new(f64::from(k % 5) * 31.0 + 3.3, f64::from(k / 5) * 17.0 + 5.1);
        let rest = Handles::new((0..20).map(|k| Handle::Point(place(k))).collect(), None).unwrap();
        let field =
            RestDeformation::new(rest, Method::Rigid, Falloff::new(1.3, false).unwrap(), 1.0)
                .unwrap();
        let moved = |k: u32| Handle::Point(place(k) + Vec2::new(3.0, f64::from(k % 3)));
        let pose = field.pose(&(0..20).map(moved).collect::<Vec<_>>()).unwrap();
        (field, pose, Grid::with_counts(160.0, 100.0, 33, 21))
    }

    #[test]
    fn kept_rows_stay_within_their_bytes_and_the_others_are_computed_again_to_the_same_bits() {
        let (field, pose, grid) = set();
        let d: Vec<[f32; 2]> = pose.displacements().iter().map(|d| to_f32(*d)).collect();
        let cells: Vec<u32> = (0..32 * 20).collect();
        let displaced = |rows: &SubdivisionCache, level: u8, serial: bool| {
            let posing = Posing {
                field: &field,
                f: None,
                grid: &grid,
                d: &d,
                serial,
            };
            cells
                .chunks(100)
                .flat_map(|cells| rows.displace(&posing, level, cells, &|| false).unwrap())
                .collect::<Vec<_>>()
        };
        let all = SubdivisionCache::new(u64::MAX);
        let want: Vec<_> = (1..=4).map(|level| displaced(&all, level, true)).collect();
        let (needed, table) = (
            kept_bytes(&all),
            CoefficientTable::bytes_for(&field, grid.len()),
        );
        assert!(needed > 100 * table, "{needed} {table}");
        for limit in [0, 1, table, needed / 3, needed - 1, needed] {
            let rows = SubdivisionCache::new(limit);
            for serial in [true, false, true] {
                for (level, want) in (1..=4).zip(&want) {
                    assert_eq!(
                        &displaced(&rows, level, serial),
                        want,
                        "{limit} bytes, level {level}"
                    );
                }
                let kept = kept_bytes(&rows);
                assert_eq!(
                    kept + rows.left.load(Ordering::Relaxed),
                    limit,
                    "what is kept is counted"
                );
            }
            assert_eq!(
                rows.kept.read().unwrap().len() == 4 * cells.len(),
                limit == needed,
                "{limit} of {needed} bytes"
            );
        }
    }

    #[test]
    fn nothing_is_kept_of_what_needs_no_rows() {
        let (field, pose, grid) = set();
        let f = field.deformation(&pose);
        let d: Vec<[f32; 2]> = pose.displacements().iter().map(|d| to_f32(*d)).collect();
        let cells: Vec<u32> = (0..32 * 20).collect();
        let rows = SubdivisionCache::new(u64::MAX);
        let posing = |f| Posing {
            field: &field,
            f,
            grid: &grid,
            d: &d,
            serial: true,
        };
        let direct = rows
            .displace(&posing(Some(&f)), 2, &cells, &|| false)
            .unwrap();
        assert_eq!(kept_bytes(&rows), 0);
        let by_rows = rows.displace(&posing(None), 2, &cells, &|| false).unwrap();
        for (a, b) in direct.iter().zip(by_rows) {
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-3, "{a:?} {b:?}");
        }
    }
}
