//! The handles in the cells of a grid: positions at which f is known, and how far a cell is from it
//! there.

use std::collections::BTreeMap;

use super::measured::at_level;
use super::{IsCancelled, Pose, RestDeformation};
use crate::geometry::{Grid, Subdivision, Vec2};

/// A position in a cell, in shares of its sides, at which f is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellSample {
    pub(super) s: f64,
    pub(super) t: f64,
    displacement: Vec2,
}

/// The samples of each cell.
#[derive(Debug)]
pub(super) struct CellSamples(BTreeMap<u32, Vec<CellSample>>);

impl CellSamples {
    /// The handles inside the grid.
    pub(super) fn of_handles(
        field: &RestDeformation,
        grid: &Grid,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let mut samples: BTreeMap<u32, Vec<CellSample>> = BTreeMap::new();
        field.for_each_constraint(pose, cancelled, |p, displacement| {
            if let Some((i, j, s, t)) = grid.locate(p) {
                samples
                    .entry(j * (grid.columns() - 1) + i)
                    .or_default()
                    .push(CellSample { s, t, displacement });
            }
        })?;
        Some(Self(samples))
    }

    /// Those of a cell.
    pub(super) fn of(&self, cell: u32) -> &[CellSample] {
        self.0.get(&cell).map_or(&[], Vec::as_slice)
    }

    /// The cells that have some.
    pub(super) fn by_cell(&self) -> impl Iterator<Item = (u32, &[CellSample])> {
        self.0
            .iter()
            .map(|(cell, samples)| (*cell, samples.as_slice()))
    }
}

/// The largest distance at samples between f and a cell halved `level` times; its vertices may be
/// finer.
#[expect(clippy::cast_possible_truncation, reason = "errors are f32")]
pub(super) fn sample_error(samples: &[CellSample], vertices: &[[f32; 2]], level: u8) -> f32 {
    if samples.is_empty() {
        return 0.0;
    }
    let side = vertices.len().isqrt();
    let coarse = at_level(vertices, side, level);
    let error = |sample: &CellSample| {
        (Subdivision::displaced_in(&coarse, (1 << level) + 1, sample.s, sample.t)
            - sample.displacement)
            .norm() as f32
    };
    samples.iter().map(error).fold(0.0, f32::max)
}
