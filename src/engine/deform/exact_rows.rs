//! Exact rows inside the cells of a grid: the coefficients of the vertices that halving a cell adds. Computed when a pose first needs them,
//! and kept while they fit; those that do not fit are computed again for each pose, to the same bits, because each vertex has its own lane.
//!
//! Shapes: a group holds the vertices that one halving adds to one cell, those of `[2^level + 1][2^level + 1]` with an odd index, row by
//! row. Small groups share a block of [`LANES`] vertices.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use rayon::prelude::*;

use super::field::{Deformation, Field, Workspace};
use super::kernel::{self, LANES, Lanes, Pairs, lanes_per_block};
use super::plan::{IsCancelled, gather, store, to_f32};
use crate::geometry::{Grid, Point, Vec2};

/// Memory to find a group, bytes.
const ENTRY: usize = 64;

/// Blocks of one or more groups, as the table of a plan, and what they hold.
type Unit = Arc<[Lanes]>;

/// The rows of some groups of a grid's cells.
#[derive(Debug)]
pub struct ExactRows {
    kept: RwLock<HashMap<(u32, u8), (Unit, usize)>>,
    /// Memory that may still be taken, bytes.
    left: AtomicU64,
}

/// A set of handles, its grid, and a pose in the precision of the rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Posing<'a> {
    pub(super) field: &'a Field,
    /// Gives displacements without rows, where rows take longer than they save.
    pub(super) f: Option<&'a Deformation<'a>>,
    pub(super) grid: &'a Grid,
    pub(super) d: &'a [[f32; 2]],
    /// Whether rows are computed on this thread alone.
    pub(super) serial: bool,
}

/// The vertices of a group, `(a, b)` of the cell's lattice.
pub(super) fn group(level: u8) -> impl Iterator<Item = (u32, u32)> + Clone {
    let last = 1_u32 << level;
    (0..=last).flat_map(move |b| (0..=last).map(move |a| (a, b))).filter(|(a, b)| (a | b) & 1 == 1)
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

/// A vertex of a cell's lattice at rest. Cells that share it compute the same bits.
pub(super) fn vertex(grid: &Grid, cell: u32, level: u8, (a, b): (u32, u32)) -> Point {
    let (i, j) = (cell % (grid.columns() - 1), cell / (grid.columns() - 1));
    let between = |from: f64, to: f64, k: u32| match k {
        0 => from,
        k if k == 1 << level => to,
        k => from + (to - from) * (f64::from(k) / f64::from(1 << level)),
    };
    Point::new(between(grid.x(i), grid.x(i + 1), a), between(grid.y(j), grid.y(j + 1), b))
}

impl ExactRows {
    /// Keeps rows of up to `bytes`.
    #[must_use]
    pub fn new(bytes: u64) -> Self {
        Self { kept: RwLock::default(), left: AtomicU64::new(bytes) }
    }

    /// Displacements of the groups of cells, which must be sorted, `[cells][group]`; `None` when cancelled, which is checked for each unit.
    pub(super) fn displace(&self, posing: &Posing<'_>, level: u8, cells: &[u32], cancelled: IsCancelled<'_>) -> Option<Vec<[f32; 2]>> {
        let len = group_len(level);
        let mut out = vec![[0.0; 2]; cells.len() * len];
        let found: Vec<Option<(Unit, usize)>> = {
            let kept = self.kept.read().unwrap_or_else(PoisonError::into_inner);
            cells.iter().map(|&cell| kept.get(&(cell, level)).cloned()).collect()
        };
        let mut posed: (Option<Unit>, Vec<Pairs>) = (None, Vec::new());
        for (unit, out) in found.iter().zip(out.chunks_exact_mut(len)) {
            let Some((unit, group)) = unit else { continue };
            if posed.0.as_ref().is_none_or(|last| !Arc::ptr_eq(last, unit)) {
                if cancelled() {
                    return None;
                }
                posed.1.clear();
                kernel::displace(posing.field.family(), unit, posing.d, &mut posed.1);
                posed.0 = Some(Arc::clone(unit));
            }
            out.copy_from_slice(&posed.1.as_flattened()[group * len..][..len]);
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
        let columns = posing.field.handles().columns();
        let units: Option<Vec<(Vec<Pairs>, Option<Unit>)>> = if posing.serial {
            let mut workspace = Workspace::new(columns);
            missing.chunks(per_unit).map(|indices| compute(&mut workspace, indices)).collect()
        } else {
            missing.par_chunks(per_unit).map_init(|| Workspace::new(columns), compute).collect()
        };
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
    fn unit(&self, posing: &Posing<'_>, level: u8, cells: &[u32], workspace: &mut Workspace<LANES>) -> (Vec<Pairs>, Option<Unit>) {
        let Posing { field, grid, d, .. } = *posing;
        let places: Vec<Point> = cells.iter().flat_map(|&cell| group(level).map(move |at| vertex(grid, cell, level, at))).collect();
        let block_at = |places: &[Point]| gather(|lane| places[lane.min(places.len() - 1)]);
        if let Some(f) = posing.f {
            let displaced = |places: &[Point]| {
                let ([x, y], _) = f.displacements(&block_at(places), false, workspace);
                std::array::from_fn(|lane| to_f32(Vec2::new(x[lane], y[lane])))
            };
            return (places.chunks(LANES).map(displaced).collect(), None);
        }
        let per_block = lanes_per_block(field.family(), field.handles().columns());
        let blocks = places.len().div_ceil(LANES);
        let bytes = (blocks * per_block * size_of::<Lanes>() + cells.len() * ENTRY) as u64;
        let is_kept = self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes)).is_ok();
        let mut table = vec![Lanes::default(); if is_kept { blocks * per_block } else { per_block }];
        let mut pairs = Vec::with_capacity(blocks);
        for (k, places) in places.chunks(LANES).enumerate() {
            field.rows(&block_at(places), false, workspace);
            let block = if is_kept { &mut table[k * per_block..][..per_block] } else { &mut table[..] };
            store(field.family(), &workspace.rows, block);
            kernel::displace(field.family(), block, d, &mut pairs);
        }
        (pairs, is_kept.then(|| table.into()))
    }

    /// Keeps fresh rows, unless another thread was faster.
    fn keep(&self, level: u8, cells: &[u32], fresh: Vec<(&[usize], Unit)>) {
        if fresh.is_empty() {
            return;
        }
        let mut kept = self.kept.write().unwrap_or_else(PoisonError::into_inner);
        for (indices, unit) in fresh {
            for (group, &k) in indices.iter().enumerate() {
                kept.entry((cells[k], level)).or_insert_with(|| (Arc::clone(&unit), group));
            }
            if Arc::strong_count(&unit) == 1 {
                self.left.fetch_add((size_of_val(&*unit) + indices.len() * ENTRY) as u64, Ordering::Relaxed);
            }
        }
    }
}
