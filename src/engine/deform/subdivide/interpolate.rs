//! Cells whose vertices are interpolated from the grid instead of computed, where that suffices.

use super::{Decision, HALVED_ERROR_SHARE, PoseMeasurement};
use crate::deform::interpolated::Interpolated;
use crate::deform::interpolated_block::InterpolatedBlock;
use crate::deform::measured::{Measured, is_convex, on_edge};

/// Vertices may be interpolated if they are off by at most this share of the tolerance.
const INTERPOLATED_TOLERANCE_SHARE: f32 = 0.35;
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

impl PoseMeasurement<'_> {
    /// Whether interpolated vertices suffice for a cell: it needs not be halved, or no more than
    /// twice. If not, its vertices will be exact.
    pub(super) fn interpolate(&mut self, cell: u32) -> bool {
        let corners = self.posed.corners(cell);
        if let Some(known) = self.cells.get_mut(cell) {
            // Measured once by exact vertices: interpolation has failed here before.
            if known.is_exact {
                return false;
            }
            // Interpolated before, and now a neighbour or a handle wants more: the cell begins
            // again with exact vertices, because two kinds in one cell would leave a step between
            // them.
            if known.depth > 0 {
                *known = Measured {
                    least: known.least,
                    ..Measured::new(corners)
                };
                known.is_exact = true;
                return false;
            }
        }
        let (tolerance, size) = (self.tolerance(), self.posed.size(cell));
        // A handle or a fold in the cell is what a polynomial through the neighbours cannot see.
        let is_open =
            self.is_smooth && self.samples.of(cell).is_empty() && is_convex(&corners, size);
        let halved = if is_open { self.halved(cell) } else { None };
        if let Some(halved) =
            halved.filter(|halved| halved.off <= INTERPOLATED_TOLERANCE_SHARE * tolerance)
        {
            let HalvedCell { off, error, .. } = halved;
            // It needs no halving: neither its own error nor what the interpolation may be off
            // exceeds the tolerance. Nothing is kept of it.
            if self.cells.get(&cell).is_none() && self.between(cell, error + off) <= tolerance {
                return true;
            }
            if self.halve_by(cell, &halved, corners) {
                return true;
            }
            let quarters = self.interpolated(cell).map(|halved| halved.quarters());
            if quarters.is_some_and(|quarters| self.deepen_by(cell, &quarters, off)) {
                return true;
            }
        }
        let known = self.cells.get_or_insert(cell, corners);
        *known = Measured {
            least: known.least,
            is_exact: true,
            ..Measured::new(corners)
        };
        false
    }

    fn interpolated(&self, cell: u32) -> Option<Interpolated<'_>> {
        let columns = self.mesh.grid().columns() - 1;
        Interpolated::new(self.mesh, self.even, cell % columns, cell / columns)
    }

    /// Interpolates the first halving of a cell, in a block where there is one.
    fn halved(&mut self, cell: u32) -> Option<HalvedCell> {
        let place = |block: &Option<InterpolatedBlock>| block.as_ref()?.place(cell);
        if place(&self.block).is_none() {
            let columns = self.mesh.grid().columns() - 1;
            let (i, j) = (cell % columns, cell / columns);
            let block = InterpolatedBlock::new(self.mesh, self.even, i, j);
            self.block = block.or(self.block.take());
        }
        if let Some((place, block)) = place(&self.block).zip(self.block.as_ref()) {
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

    /// Halves a cell once by interpolated vertices. Whether they suffice.
    fn halve_by(&mut self, cell: u32, halved: &HalvedCell, corners: [[f32; 2]; 4]) -> bool {
        let known = self.cells.get_or_insert(cell, corners);
        if self.deepest == 0 || halved.halves.len() > self.left {
            return false;
        }
        *known = Measured {
            least: known.least,
            ..Measured::halved(corners, halved.halves, halved.error)
        };
        self.suffices(cell, halved.off)
    }

    /// Adds interpolated vertices of one halving more to a cell; `off`: how far they may be from f.
    /// Whether they suffice.
    fn deepen_by(&mut self, cell: u32, vertices: &[[f32; 2]], off: f32) -> bool {
        let (corners, size) = (self.posed.corners(cell), self.posed.size(cell));
        let known = self.cells.get_or_insert(cell, corners);
        if known.depth >= self.deepest || vertices.len() > self.left {
            return false;
        }
        known.deepen(vertices, size);
        self.suffices(cell, off)
    }

    /// Whether the interpolated vertices of a cell, which may be `off` by that much, suffice; if
    /// they do, they are paid for.
    fn suffices(&mut self, cell: u32, off: f32) -> bool {
        let known = self.cells.get_mut(cell).expect("is there");
        // `decide` relies on a part of this error for the next level; divided by that part, `off`
        // counts there in full.
        known.errors[usize::from(known.depth) - 1] += off / HALVED_ERROR_SHARE;
        let known = self.cells.get(&cell).expect("is there");
        let suffices = matches!(self.decide(cell, known), Decision::Draw(_));
        if suffices {
            self.left -= known.vertices.len() - CORNERS;
        }
        suffices
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
