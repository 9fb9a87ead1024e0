//! The lattice on which a factor is examined: larger than the image, so that what lies outside
//! stays open too.

use std::ops::Range;

use crate::deform::kernel::{LaneWork, run_at};
use crate::geometry::{Orientation, Point, Vec2};
use crate::level::SimdLevel;

/// The least share of its area at rest that a corner keeps in one factor. Not 0, so that a drag is
/// continuous: just beyond it, the second factor is nearly the identity.
const LEAST_CORNER: f64 = 0.3;
/// How far the lattice reaches beyond the image on every side, as a share of it.
const BORDER_SHARE: f64 = 0.5;
/// Cells along the longer side of the image, and the sides of cells, px.
const CELLS: f64 = 50.0;
const CELL_SIDES: [f64; 2] = [4.0, 10.0];
/// Cells along a side at most: those of an image of 16,384 px are larger.
const MOST_CELLS: f64 = 400.0;

pub(super) struct ControlLattice {
    columns: usize,
    places: Vec<Point>,
    /// Of a cell, px^2.
    area: f64,
}

impl ControlLattice {
    /// For an image of this size, px.
    pub(super) fn new(width: f64, height: f64) -> Self {
        let side = side_of(width, height);
        let lines = |length: f64| {
            let cells = cells_along(length, side);
            let positions = (0..=u32::MAX)
                .map(f64::from)
                .take_while(move |k| *k <= cells);
            positions.map(move |k| k * side - BORDER_SHARE * length)
        };
        let columns = lines(width).count();
        let row = |y: f64| lines(width).map(move |x| Point::new(x, y));
        Self {
            columns,
            places: lines(height).flat_map(row).collect(),
            area: side * side,
        }
    }

    /// The number of vertices of one of this size.
    pub(super) fn count(width: f64, height: f64) -> u64 {
        let side = side_of(width, height);
        let lines = |length: f64| {
            (0..=u64::MAX).take_while(move |k| *k as f64 <= cells_along(length, side))
        };
        (lines(width).count() * lines(height).count()) as u64
    }

    pub(super) const fn len(&self) -> u64 {
        self.places.len() as u64
    }

    pub(super) fn places(&self) -> &[Point] {
        &self.places
    }

    /// Rows of cells.
    pub(super) fn rows(&self) -> usize {
        self.places.len() / self.columns - 1
    }

    /// The vertices of a line above or below cells.
    pub(super) const fn line(&self, line: usize) -> Range<usize> {
        line * self.columns..(line + 1) * self.columns
    }

    /// Whether every corner keeps its share.
    pub(super) fn is_open(&self, mapped: &[Point]) -> bool {
        let is_closed = |row| self.is_closed(&mapped[self.line(row)], &mapped[self.line(row + 1)]);
        !(0..self.rows()).any(is_closed)
    }

    /// Whether a corner of the row of cells between two lines does not keep its share.
    pub(super) fn is_closed(&self, above: &[Point], below: &[Point]) -> bool {
        let least = LEAST_CORNER * self.area;
        let work = ClosedRow {
            above,
            below,
            least,
        };
        run_at(SimdLevel::detect(), work)
    }

    /// The largest share of these displacements, up to 1, with which every corner keeps its share.
    pub(super) fn longest(&self, displacements: &[Vec2]) -> f64 {
        let spare = self.area * (1.0 - LEAST_CORNER);
        let side = self.area.sqrt();
        let mut longest = 1.0_f64;
        for row in 0..self.rows() {
            let (above, below) = (
                &displacements[self.line(row)],
                &displacements[self.line(row + 1)],
            );
            let losing = LosingRow {
                above,
                below,
                side,
                least: -spare / longest,
                longest,
            };
            if !run_at(SimdLevel::detect(), losing) {
                continue;
            }
            for (above, below) in above.windows(2).zip(below.windows(2)) {
                for [linear, square] in losses([above[0], above[1], below[1], below[0]], side) {
                    // The first share at which the corner has no more to spare.
                    let first = first_root([spare, linear, square]);
                    longest = longest.min(first);
                }
            }
        }
        longest
    }
}

/// What a share s of these displacements of the corners of a cell, clockwise from the upper left
/// one, adds to the cross product of each: `linear s + square s^2`.
#[inline(always)]
fn losses([a, b, c, d]: [Vec2; 4], side: f64) -> [[f64; 2]; 4] {
    let [top, right, bottom, left] = [b - a, c - b, c - d, d - a];
    [
        [side * (top.x + left.y), top.cross(left)],
        [side * (top.x + right.y), top.cross(right)],
        [side * (bottom.x + right.y), bottom.cross(right)],
        [side * (bottom.x + left.y), bottom.cross(left)],
    ]
}

/// Whether a corner of a row of cells keeps less than `least` of its area, px^2.
struct ClosedRow<'a> {
    above: &'a [Point],
    below: &'a [Point],
    least: f64,
}

impl LaneWork for ClosedRow<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let (above, below, least) = (self.above, self.below, self.least);
        let cells = above.len().min(below.len()) - 1;
        let (above, below) = (&above[..=cells], &below[..=cells]);
        let mut is_open = true;
        for k in 0..cells {
            let [a, b, c, d] = [above[k], above[k + 1], below[k + 1], below[k]];
            // Without a branch, so that cells fill vectors; what is no number is closed too.
            for turn in Orientation::turns([b - a, c - b, c - d, d - a]) {
                is_open &= turn >= least;
            }
        }
        !is_open
    }
}

/// Whether a corner of a row of cells may lose all that it has to spare within the share `longest`
/// of these displacements: most lose less, which needs no root.
struct LosingRow<'a> {
    above: &'a [Vec2],
    below: &'a [Vec2],
    side: f64,
    least: f64,
    longest: f64,
}

impl LaneWork for LosingRow<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let (above, below) = (self.above, self.below);
        let cells = above.len().min(below.len()) - 1;
        let (above, below) = (&above[..=cells], &below[..=cells]);
        let negative = |value: f64| if value < 0.0 { value } else { 0.0 };
        let mut is_losing = false;
        for k in 0..cells {
            let corners = [above[k], above[k + 1], below[k + 1], below[k]];
            for [linear, square] in losses(corners, self.side) {
                let lost = negative(linear) + negative(square) * self.longest;
                is_losing |= lost <= self.least;
            }
        }
        is_losing
    }
}

fn side_of(width: f64, height: f64) -> f64 {
    let longest = width.max(height);
    let usual = (longest / CELLS).clamp(CELL_SIDES[0], CELL_SIDES[1]);
    usual.max(longest * (1.0 + 2.0 * BORDER_SHARE) / MOST_CELLS)
}

fn cells_along(length: f64, side: f64) -> f64 {
    (length * (1.0 + 2.0 * BORDER_SHARE) / side).ceil()
}

/// The smallest positive root of `c0 + c1 s + c2 s^2`, with `c0 > 0`; infinite without one.
fn first_root([c0, c1, c2]: [f64; 3]) -> f64 {
    let under = c1 * c1 - 4.0 * c2 * c0;
    if under < 0.0 || (c1 >= 0.0 && c2 >= 0.0) {
        return f64::INFINITY;
    }
    // The sum of terms of one sign loses nothing; its product with the other root is c0 / c2.
    let sum = -0.5 * (c1 + under.sqrt().copysign(c1));
    let roots = [sum / c2, c0 / sum].into_iter();
    roots.filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min)
}
