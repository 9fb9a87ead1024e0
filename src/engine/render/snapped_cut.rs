//! The quads of a cut grid as the rasteriser uses them. Cost: O(vertices + quads).

use std::sync::Arc;

use super::fixed_point::{Corner, YRange, first_row};
use crate::geometry::{CutCell, CutCells};

/// The quads of a cut mesh, in the order in which they are drawn.
#[derive(Debug)]
pub(super) struct SnappedCut {
    pub(super) rest: Arc<CutCells>,
    pub(super) quads: Vec<SnappedQuad>,
}

/// A posed quad.
#[derive(Clone, Copy, Debug)]
pub(super) struct SnappedQuad {
    pub(super) corners: [Corner; 4],
    pub(super) y: YRange,
    pub(super) cell: CutCell,
    /// Pixels of its cell per unit of the sampler's coordinates.
    pub(super) per_unit: [f32; 2],
}

impl SnappedCut {
    /// Whether a quad draws the texel at sampler coordinates.
    pub(super) fn draws(&self, quad: &SnappedQuad, u: f32, v: f32) -> bool {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "float to integer saturates"
        )]
        let pixel = |along: f32, per_unit: f32| (along * per_unit) as u32;
        let last = self.rest.side() - 1;
        let x = pixel(u - quad.corners[0].u, quad.per_unit[0]).min(last);
        let y = pixel(v - quad.corners[0].v, quad.per_unit[1]).min(last);
        self.rest.draws(&quad.cell, x, y)
    }
}

impl SnappedQuad {
    /// Whether some texels of its cell are not drawn.
    pub(super) const fn is_partial(&self) -> bool {
        self.cell.texels.is_some()
    }

    /// Whether it may touch target rows.
    pub(super) fn meets(&self, rows: &std::ops::Range<u32>) -> bool {
        self.y.meets(rows)
    }

    /// The rows and pixels of a strip that it may touch.
    pub(super) fn pixels(
        &self,
        first: u32,
        rows: usize,
        width: usize,
    ) -> [std::ops::Range<usize>; 2] {
        let clip = |at: i64, end: usize| usize::try_from(at.max(0)).unwrap_or(0).min(end);
        let row = |y: i32| clip(first_row(y) - i64::from(first), rows);
        let x = self.corners.map(|corner| corner.x);
        let (left, right) = (
            x.iter().min().copied().unwrap_or(0),
            x.iter().max().copied().unwrap_or(0),
        );
        // Rows and columns of pixels have the same rule.
        [
            row(self.y.top)..row(self.y.bottom),
            clip(first_row(left), width)..clip(first_row(right), width),
        ]
    }
}
