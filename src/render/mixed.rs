//! Which parts of a row are drawn by column crossings and which cell by cell. Between two neighbouring columns lies a strip of cells; in a row of
//! pixels a strip is *good* when both columns cross the row and only sound cells touch it there, *bent* when they are upright but not all near enough
//! to linear, *bare* when the row passes above or below it, else *mixed*. All but good ones are drawn cell by cell in painter's order. Good ones may
//! be drawn beside them without any order: upright strips are ordered like their columns, good ones that a mixed one might overlap are drawn cell
//! by cell too, and a row whose upright strips are not in order is as a whole. Per strip of target rows: O(cells touched + rows columns).

use std::ops::Range;

use super::kernel::{SOUND, UPRIGHT};
use super::lattice::{Lattice, ONE, Reach, row_centre};

/// What a strip of cells is in a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// Drawn from its two columns.
    #[default]
    Good,
    /// Drawn cell by cell, between its two columns.
    Bent,
    /// Drawn cell by cell, and may be anywhere.
    Mixed,
    /// A good one, drawn cell by cell because a mixed one may overlap it.
    Yielding,
    /// Nothing is there.
    Bare,
}

/// The kinds in a few target rows.
#[derive(Debug, Default)]
pub(super) struct Kinds {
    first: u32,
    cells: usize,
    /// `[rows][cells]`.
    kinds: Vec<Kind>,
    /// Of the strips' cells that touch the rows, px; empty unless there may be mixed strips.
    reach: Vec<(f32, f32)>,
    /// Some cell of the strip may have to be drawn.
    some: Vec<bool>,
    /// The farthest right that mixed strips left of a strip reach, px.
    pushed: Vec<f32>,
}

impl Kinds {
    /// Begins with a few target rows, of which all cross every column or not: marks what is not sound, and notes how far every strip reaches.
    pub(super) fn begin(&mut self, lattice: &Lattice, soundness: &[u8], rows: &Range<u32>, all_cross: bool) {
        let cells = lattice.columns - 1;
        (self.first, self.cells) = (rows.start, cells);
        self.kinds.clear();
        self.kinds.resize(rows.len() * cells, Kind::Good);
        self.reach.clear();
        self.some.clear();
        self.some.resize(cells, false);
        let (mut wild, mut unmixed) = (!all_cross, self.kinds.len());
        for (j, soundness) in soundness.chunks_exact(cells).enumerate().filter(|(j, _)| lattice.row_reach[*j].meets(rows)) {
            if unmixed == 0 {
                break;
            }
            if soundness.iter().fold(true, |all, &s| all & (s == SOUND)) {
                continue;
            }
            for (i, &soundness) in soundness.iter().enumerate().filter(|(_, s)| **s != SOUND) {
                let kind = if soundness == UPRIGHT { Kind::Bent } else { Kind::Mixed };
                for row in lattice.cell_reach(i, j).rows(rows) {
                    let marked = &mut self.kinds[(row - rows.start) as usize * cells + i];
                    unmixed -= usize::from(kind == Kind::Mixed && *marked != Kind::Mixed);
                    *marked = kind.max(*marked);
                    self.some[i] = true;
                    wild |= kind == Kind::Mixed;
                }
            }
        }
        if wild {
            self.reach.resize(cells, (f32::INFINITY, f32::NEG_INFINITY));
            for (i, j) in lattice.cells_touching(rows.clone()) {
                let (left, right) = lattice.cell_across(i, j);
                let reach = &mut self.reach[i];
                *reach = (reach.0.min(left), reach.1.max(right));
            }
        }
    }

    /// Decides about a row, from where its columns cross; good strips as ranges.
    pub(super) fn decide(&mut self, lattice: &Lattice, row: u32, x: &[f32], good: &mut Vec<Range<usize>>) {
        good.clear();
        let kinds = &mut self.kinds[(row - self.first) as usize * self.cells..][..self.cells];
        // Without reaches every column crosses, and all cells are upright: there is nothing to yield to.
        if !self.reach.is_empty() {
            trim(lattice, row, kinds);
            if kinds.contains(&Kind::Mixed) {
                yield_to_mixed(x, &self.reach, &mut self.pushed, kinds);
            }
            for (some, kind) in self.some.iter_mut().zip(kinds.iter()) {
                *some |= is_drawn(*kind);
            }
        }
        let mut at = 0;
        while let Some(start) = kinds[at..].iter().position(|&kind| kind == Kind::Good).map(|k| at + k) {
            at = kinds[start..].iter().position(|&kind| kind != Kind::Good).map_or(kinds.len(), |k| start + k);
            good.push(start..at);
        }
    }

    /// Whether the cells of a strip are drawn in some row.
    pub(super) fn some(&self, column: usize) -> bool {
        self.some[column]
    }

    /// Whether the cells of a strip are drawn in a row.
    pub(super) fn drawn(&self, row: u32, column: usize) -> bool {
        is_drawn(self.kinds[(row - self.first) as usize * self.cells + column])
    }
}

fn is_drawn(kind: Kind) -> bool {
    matches!(kind, Kind::Bent | Kind::Mixed | Kind::Yielding)
}

/// Finds the strips of a row that it leaves through the upper or the lower border.
fn trim(lattice: &Lattice, row: u32, kinds: &mut [Kind]) {
    let cells = kinds.len();
    let (top, bottom) = (&lattice.y[..=cells], &lattice.y[(lattice.rows - 1) * lattice.pitch..][..=cells]);
    let y = i32::try_from(row_centre(row)).unwrap_or(i32::MAX);
    for ((kind, top), bottom) in kinds.iter_mut().zip(top.windows(2)).zip(bottom.windows(2)).filter(|((kind, _), _)| **kind <= Kind::Bent) {
        let (above, below) = ((top[0] > y, top[1] > y), (bottom[0] <= y, bottom[1] <= y));
        *kind = match (above, below) {
            ((false, false), (false, false)) => *kind,
            ((true, true), _) | (_, (true, true)) => Kind::Bare,
            _ => Kind::Mixed,
        };
    }
}

/// Good strips that a mixed one may overlap, or all of them if they are not in order, give way.
fn yield_to_mixed(x: &[f32], reach: &[(f32, f32)], pushed: &mut Vec<f32>, kinds: &mut [Kind]) {
    let (mut end, mut right, mut ordered) = (f32::NEG_INFINITY, f32::NEG_INFINITY, true);
    pushed.clear();
    for (i, kind) in kinds.iter().enumerate() {
        pushed.push(right);
        match kind {
            Kind::Good | Kind::Bent => {
                ordered &= x[i] >= end && x[i + 1] >= x[i];
                end = x[i + 1];
            }
            Kind::Mixed => right = right.max(reach[i].1),
            Kind::Yielding | Kind::Bare => {}
        }
    }
    let mut left = f32::INFINITY;
    for (i, kind) in kinds.iter_mut().enumerate().rev() {
        match *kind {
            Kind::Good if !ordered || pushed[i] > x[i] || left < x[i + 1] => *kind = Kind::Yielding,
            Kind::Mixed => left = left.min(reach[i].0),
            Kind::Good | Kind::Bent | Kind::Yielding | Kind::Bare => {}
        }
    }
}

impl Lattice {
    /// How far a cell reaches to the left and to the right, px.
    fn cell_across(&self, i: usize, j: usize) -> (f32, f32) {
        let (left, right) = self.cell_bounds(&self.x, i, j);
        #[expect(clippy::cast_precision_loss, reason = "places that are not exact in f32 make a cell unsound, and a pixel is added")]
        let px = |place: i32| place as f32 / ONE as f32;
        (px(left) - 1.0, px(right) + 1.0)
    }

    /// How far a cell reaches up and down.
    pub(super) fn cell_reach(&self, i: usize, j: usize) -> Reach {
        let (top, bottom) = self.cell_bounds(&self.y, i, j);
        Reach { top, bottom }
    }

    fn cell_bounds(&self, places: &[i32], i: usize, j: usize) -> (i32, i32) {
        let above = j * self.pitch + i;
        let below = above + self.pitch;
        let (a, b, c, d) = (places[above], places[above + 1], places[below], places[below + 1]);
        (a.min(b).min(c).min(d), a.max(b).max(c).max(d))
    }
}
