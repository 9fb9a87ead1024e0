//! Cells whose vertices are interpolated from the grid instead of computed, where that suffices.

use super::{Decision, HALVED_ERROR_SHARE, PoseMeasurement};
use crate::deform::interpolated::Interpolated;
use crate::deform::interpolated_block::InterpolatedBlock;
use crate::deform::measured::{Measured, is_convex, on_edge};

/// Vertices may be interpolated if they are off by at most this share of the tolerance.
const INTERPOLATED_TOLERANCE_SHARE: f32 = 0.35;
/// The most times that a cell is halved by interpolated vertices.
const MOST_INTERPOLATED: u8 = 2;
/// Vertices of a cell that is not halved.
const CORNERS: usize = 4;

/// The vertices that the first halving adds to a cell, interpolated.
struct HalvedCell {
    /// How far they may be from f, px.
    off: f32,
    /// The largest distance between them and the patch of the cell, px.
    error: f32,
    halves: [[f32; 2]; 5],
}

/// What interpolation gives for a cell.
enum InterpolationOutcome {
    /// It needs no halving: nothing is kept of it.
    Flat,
    /// It needs no more than two halvings, and interpolated vertices suffice for them.
    Halved(Measured),
    /// Its vertices must be exact.
    Fails,
}

impl PoseMeasurement<'_> {
    /// Whether interpolated vertices suffice for a cell: it needs not be halved, or no more than
    /// twice. If not, its vertices will be exact. `block`: the cells that were interpolated last.
    pub(super) fn interpolate(&mut self, cell: u32, block: &mut Option<InterpolatedBlock>) -> bool {
        let outcome = self.interpolation(cell, block);
        if let InterpolationOutcome::Flat = outcome {
            return true;
        }
        let corners = self.posed.corners(cell);
        let known = self.cells.get_or_insert(cell, corners);
        if let InterpolationOutcome::Halved(halved) = outcome {
            // All of its vertices are paid for, or none.
            if let Some(left) = self.left.checked_sub(halved.vertices.len() - CORNERS) {
                (self.left, *known) = (left, halved);
                return true;
            }
        }
        // A cell that was interpolated, of which a neighbour or a handle now wants more, begins
        // again: two kinds of vertices in one cell would leave a step between them.
        if !known.is_exact {
            *known = Measured {
                least: known.least,
                is_exact: true,
                ..Measured::new(corners)
            };
        }
        false
    }

    /// What interpolation gives for a cell.
    fn interpolation(
        &self,
        cell: u32,
        block: &mut Option<InterpolatedBlock>,
    ) -> InterpolationOutcome {
        let known = self.cells.get(&cell);
        if known.is_some_and(|known| known.is_exact || known.depth > 0) {
            // Its vertices are exact already, or it was interpolated and now needs more.
            return InterpolationOutcome::Fails;
        }
        let (corners, size) = (self.posed.corners(cell), self.posed.size(cell));
        let tolerance = self.tolerance();
        // A handle or a fold in the cell is what a polynomial through the neighbours cannot see.
        let is_open =
            self.is_smooth && self.samples.of(cell).is_empty() && is_convex(&corners, size);
        let halved = if is_open {
            self.halved(cell, block)
        } else {
            None
        };
        let Some(HalvedCell { off, error, halves }) =
            halved.filter(|halved| halved.off <= INTERPOLATED_TOLERANCE_SHARE * tolerance)
        else {
            return InterpolationOutcome::Fails;
        };
        // Neither its own error nor what the interpolation may be off exceeds the tolerance.
        if known.is_none() && self.between(cell, error + off) <= tolerance {
            return InterpolationOutcome::Flat;
        }
        let mut halved = Measured {
            least: known.map_or(0, |known| known.least),
            ..Measured::halved(corners, halves, error)
        };
        for depth in 1..=self.deepest.min(MOST_INTERPOLATED) {
            if depth > 1 {
                let Some(interpolated) = self.interpolated(cell) else {
                    break;
                };
                halved.deepen(&interpolated.quarters(), size);
            }
            if self.suffices(cell, &mut halved, off) {
                return InterpolationOutcome::Halved(halved);
            }
        }
        InterpolationOutcome::Fails
    }

    fn interpolated(&self, cell: u32) -> Option<Interpolated<'_>> {
        let columns = self.mesh.grid().columns() - 1;
        Interpolated::new(self.mesh, self.even, cell % columns, cell / columns)
    }

    /// Interpolates the first halving of a cell, in a block where there is one.
    fn halved(&self, cell: u32, block: &mut Option<InterpolatedBlock>) -> Option<HalvedCell> {
        let place = |block: &Option<InterpolatedBlock>| block.as_ref()?.place(cell);
        if place(block).is_none() {
            let columns = self.mesh.grid().columns() - 1;
            let (i, j) = (cell % columns, cell / columns);
            let fresh = InterpolatedBlock::new(self.mesh, self.even, i, j);
            *block = fresh.or(block.take());
        }
        if let Some((place, block)) = place(block).zip(block.as_ref()) {
            return Some(HalvedCell {
                off: block.off(place),
                error: block.error(place),
                halves: block.halves(place),
            });
        }
        // At the end of a row.
        let (one, corners) = (self.interpolated(cell)?, self.posed.corners(cell));
        let halves = one.halves();
        Some(HalvedCell {
            off: one.off(),
            error: Interpolated::error(corners, &halves),
            halves,
        })
    }

    /// Whether the interpolated vertices of a cell, which may be `off` by that much, suffice. Its
    /// last error then includes `off`.
    fn suffices(&self, cell: u32, halved: &mut Measured, off: f32) -> bool {
        // `decide` relies on a part of this error for the next level; divided by that part, `off`
        // counts there in full.
        halved.errors[usize::from(halved.depth) - 1] += off / HALVED_ERROR_SHARE;
        matches!(self.decide(cell, halved), Decision::Draw(_))
    }

    /// Gives a cell that is halved by interpolation the vertices of its edges that neighbours
    /// compute exactly.
    pub(super) fn take_exact_edges(&self, cell: u32, level: u8, vertices: &mut [[f32; 2]]) {
        for (edge, other) in self.posed.beside(cell).into_iter().enumerate() {
            let Some(known) = other
                .and_then(|other| self.cells.get(&other))
                .filter(|known| known.is_exact && known.depth > 0)
            else {
                continue;
            };
            let (common, depth) = (level.min(known.depth), known.depth);
            for k in 1..1 << common {
                let (ours, theirs) = (k << (level - common), k << (depth - common));
                vertices[on_edge(ours, (1 << level) + 1, edge)] =
                    known.vertices[on_edge(theirs, (1 << depth) + 1, (edge + 2) % 4)];
            }
        }
    }
}
