//! Which parts of a row are drawn by column crossings and which cell by cell. Between two neighbouring columns lies a strip of cells; in a row of
//! pixels a strip is *good* when both columns cross the row and no cell that is not sound touches it there, *bare* when the row passes above or
//! below it, else *mixed*. Mixed strips are drawn cell by cell in painter's order. Good ones may be drawn beside them without any
//! order, because those that a mixed one might overlap are drawn cell by cell too, and a row whose good strips are not in order is as a whole.
//! Per strip of target rows: O(cells touched + rows columns).

use std::ops::Range;

use super::lattice::{Lattice, ONE, Reach, row_centre};

/// What a strip of cells is in a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Kind {
    /// Drawn from its two columns.
    #[default]
    Good,
    /// Drawn cell by cell.
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
    /// Of the columns' cells that touch the rows, px.
    reach: Vec<(f32, f32)>,
    /// Some cell of the strip may have to be drawn.
    some: Vec<bool>,
    /// The farthest right that mixed strips left of a strip reach, px.
    pushed: Vec<f32>,
}

impl Kinds {
    /// Begins with a few target rows: marks what is not sound, and notes how far every strip reaches.
    pub(super) fn begin(&mut self, lattice: &Lattice, sound: &[bool], rows: &Range<u32>) {
        let cells = lattice.columns - 1;
        (self.first, self.cells) = (rows.start, cells);
        self.kinds.clear();
        self.kinds.resize(rows.len() * cells, Kind::Good);
        self.reach.clear();
        self.reach.resize(cells, (f32::INFINITY, f32::NEG_INFINITY));
        self.some.clear();
        self.some.resize(cells, false);
        for (i, j) in lattice.cells_touching(rows.clone()) {
            let (left, right) = lattice.cell_across(i, j);
            let reach = &mut self.reach[i];
            *reach = (reach.0.min(left), reach.1.max(right));
            if !sound[j * cells + i] {
                for row in lattice.cell_reach(i, j).rows(rows) {
                    self.kinds[(row - rows.start) as usize * cells + i] = Kind::Mixed;
                }
            }
        }
    }

    /// Decides about a row, from where its columns cross; good strips as ranges.
    pub(super) fn decide(&mut self, lattice: &Lattice, row: u32, x: &[f32], good: &mut Vec<Range<usize>>) {
        let cells = self.cells;
        let kinds = &mut self.kinds[(row - self.first) as usize * cells..][..cells];
        let (top, bottom) = (&lattice.y[..=cells], &lattice.y[(lattice.rows - 1) * lattice.pitch..][..=cells]);
        let y = i32::try_from(row_centre(row)).unwrap_or(i32::MAX);
        let (mut end, mut pushed, mut ordered) = (f32::NEG_INFINITY, f32::NEG_INFINITY, true);
        self.pushed.clear();
        for (i, kind) in kinds.iter_mut().enumerate() {
            if *kind == Kind::Good {
                let (above, below) = ((top[i] > y, top[i + 1] > y), (bottom[i] <= y, bottom[i + 1] <= y));
                *kind = match (above, below) {
                    ((false, false), (false, false)) => Kind::Good,
                    ((true, true), _) | (_, (true, true)) => Kind::Bare,
                    _ => Kind::Mixed,
                };
            }
            self.pushed.push(pushed);
            match *kind {
                Kind::Good => {
                    ordered &= x[i] >= end && x[i + 1] >= x[i];
                    end = x[i + 1];
                }
                Kind::Mixed => pushed = pushed.max(self.reach[i].1),
                Kind::Yielding | Kind::Bare => {}
            }
        }
        good.clear();
        let mut pushed = f32::INFINITY;
        for (i, kind) in kinds.iter_mut().enumerate().rev() {
            match *kind {
                Kind::Good if ordered && self.pushed[i] <= x[i] && pushed >= x[i + 1] => match good.last_mut() {
                    Some(run) if run.start == i + 1 => run.start = i,
                    _ => good.push(i..i + 1),
                },
                Kind::Good => *kind = Kind::Yielding,
                Kind::Mixed => pushed = pushed.min(self.reach[i].0),
                Kind::Yielding | Kind::Bare => {}
            }
            self.some[i] |= matches!(*kind, Kind::Mixed | Kind::Yielding);
        }
        good.reverse();
    }

    /// Whether the cells of a strip are drawn in some row.
    pub(super) fn some(&self, column: usize) -> bool {
        self.some[column]
    }

    /// Whether the cells of a strip are drawn in a row.
    pub(super) fn drawn(&self, row: u32, column: usize) -> bool {
        matches!(self.kinds[(row - self.first) as usize * self.cells + column], Kind::Mixed | Kind::Yielding)
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
