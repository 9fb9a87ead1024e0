//! The handles in the cells of a grid: positions at which f is known, and how far a cell is from it
//! there.

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
pub(super) struct CellSamples {
    /// One more than the position of each cell in `by_cell`, or 0.
    index: Vec<u32>,
    by_cell: Vec<(u32, Vec<CellSample>)>,
}

impl CellSamples {
    /// The handles inside the grid.
    pub(super) fn of_handles(
        field: &RestDeformation,
        grid: &Grid,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let mut samples = Self {
            index: vec![0; grid.len()],
            by_cell: Vec::new(),
        };
        field.for_each_constraint(pose, cancelled, |p, displacement| {
            if let Some((i, j, s, t)) = grid.locate(p) {
                samples.push(
                    j * (grid.columns() - 1) + i,
                    CellSample { s, t, displacement },
                );
            }
        })?;
        Some(samples)
    }

    fn push(&mut self, cell: u32, sample: CellSample) {
        let index = &mut self.index[cell as usize];
        if *index == 0 {
            self.by_cell.push((cell, Vec::new()));
            *index = u32::try_from(self.by_cell.len()).expect("fewer than the grid has");
        }
        self.by_cell[*index as usize - 1].1.push(sample);
    }

    /// Those of a cell.
    pub(super) fn of(&self, cell: u32) -> &[CellSample] {
        (self.index[cell as usize] as usize)
            .checked_sub(1)
            .map_or(&[], |at| &self.by_cell[at].1)
    }

    /// The cells that have some.
    pub(super) fn by_cell(&self) -> impl Iterator<Item = (u32, &[CellSample])> {
        self.by_cell
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
