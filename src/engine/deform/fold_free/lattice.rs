//! The lattice on which a factor is examined: larger than the image, so that what lies outside
//! stays open too, in cells that are twice as wide there.

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
/// The side of a cell outside of the image, in those within it.
const OUTSIDE: usize = 4;
/// Cells whose corners are looked at together.
const CELL_LANES: usize = 8;

pub(super) struct ControlLattice {
    places: Vec<Point>,
    rows: Vec<CellRow>,
}

/// A row of cells: its vertices above and below, and the side of a cell, px.
struct CellRow {
    lines: [Range<usize>; 2],
    side: f64,
}

/// The lattice along an axis, in cells of those within the image.
struct Axis {
    first: f64,
    cells: usize,
    /// What the image covers, up to whole cells of those outside.
    image: Range<usize>,
}

impl Axis {
    fn new(length: f64, side: f64) -> Self {
        let first = -BORDER_SHARE * length;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most some hundreds"
        )]
        let count = |length: f64| (length / side / OUTSIDE as f64).max(0.0) as usize * OUTSIDE;
        let up_to = |length: f64| count(length - 0.5 * side) + OUTSIDE;
        Self {
            first,
            cells: up_to(length * (1.0 + 2.0 * BORDER_SHARE)),
            image: count(-first)..up_to(length - first),
        }
    }
}

/// The parts of a lattice: above and below the image, left and right of it, and its own: cells
/// across and down, and how many cells of the image one is wide.
fn parts(across: &Axis, down: &Axis) -> impl Iterator<Item = ([Range<usize>; 2], usize)> {
    let [x, y] = [&across.image, &down.image];
    let parts = [
        ([0..across.cells, 0..y.start], OUTSIDE),
        ([0..across.cells, y.end..down.cells], OUTSIDE),
        ([0..x.start, y.clone()], OUTSIDE),
        ([x.end..across.cells, y.clone()], OUTSIDE),
        ([x.clone(), y.clone()], 1),
    ];
    let has_cells =
        |part: &([Range<usize>; 2], usize)| part.0.iter().all(|cells| !cells.is_empty());
    parts.into_iter().filter(has_cells)
}

impl ControlLattice {
    /// For an image of this size, px.
    pub(super) fn new(width: f64, height: f64) -> Self {
        let side = side_of(width, height);
        let (across, down) = (Axis::new(width, side), Axis::new(height, side));
        let (mut places, mut rows) = (Vec::new(), Vec::new());
        let at = |axis: &Axis, k: usize| axis.first + k as f64 * side;
        for ([x, y], wide) in parts(&across, &down) {
            let mut above: Option<Range<usize>> = None;
            for j in (y.start..=y.end).step_by(wide) {
                let first = places.len();
                let columns = (x.start..=x.end).step_by(wide);
                places.extend(columns.map(|i| Point::new(at(&across, i), at(&down, j))));
                let below = first..places.len();
                if let Some(above) = above {
                    rows.push(CellRow {
                        lines: [above, below.clone()],
                        side: side * wide as f64,
                    });
                }
                above = Some(below);
            }
        }
        Self { places, rows }
    }

    /// The number of vertices of one of this size.
    pub(super) fn count(width: f64, height: f64) -> u64 {
        let side = side_of(width, height);
        let (across, down) = (Axis::new(width, side), Axis::new(height, side));
        let vertices = |cells: &Range<usize>, wide: usize| (cells.len() / wide + 1) as u64;
        parts(&across, &down)
            .map(|([x, y], wide)| vertices(&x, wide) * vertices(&y, wide))
            .sum()
    }

    pub(super) const fn len(&self) -> u64 {
        self.places.len() as u64
    }

    pub(super) fn places(&self) -> &[Point] {
        &self.places
    }

    /// Rows of cells.
    pub(super) const fn rows(&self) -> usize {
        self.rows.len()
    }

    /// The vertices above and below the cells of a row.
    pub(super) fn lines(&self, row: usize) -> [Range<usize>; 2] {
        self.rows[row].lines.clone()
    }

    /// Whether every corner keeps its share.
    pub(super) fn is_open(&self, mapped: &[Point]) -> bool {
        let is_closed = |row| {
            let [above, below] = self.lines(row);
            self.is_closed(row, &mapped[above], &mapped[below])
        };
        !(0..self.rows()).any(is_closed)
    }

    /// Whether a corner of a row of cells does not keep its share.
    pub(super) fn is_closed(&self, row: usize, above: &[Point], below: &[Point]) -> bool {
        let side = self.rows[row].side;
        let least = LEAST_CORNER * (side * side);
        let work = ClosedRow {
            above,
            below,
            least,
        };
        run_at(SimdLevel::detect(), work)
    }

    /// The largest share of the way to these positions, up to 1, with which every corner keeps its
    /// share, if displacements are proportional to it.
    pub(super) fn longest(&self, mapped: &[Point]) -> f64 {
        let mut longest = 1.0;
        let (mut above, mut below) = (Vec::new(), Vec::new());
        for row in &self.rows {
            for (line, displaced) in row.lines.iter().zip([&mut above, &mut below]) {
                displaced.clear();
                let pairs = mapped[line.clone()].iter().zip(&self.places[line.clone()]);
                displaced.extend(pairs.map(|(mapped, v)| *mapped - *v));
            }
            let work = FirstRoots {
                above: &above,
                below: &below,
                side: row.side,
                longest,
            };
            longest = run_at(SimdLevel::detect(), work);
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

/// The largest share of these displacements, up to `longest`, with which every corner of a row of
/// cells keeps its share.
struct FirstRoots<'a> {
    above: &'a [Vec2],
    below: &'a [Vec2],
    side: f64,
    longest: f64,
}

impl LaneWork for FirstRoots<'_> {
    type Output = f64;

    #[expect(
        clippy::needless_range_loop,
        reason = "loops over lanes are written alike, whatever they index"
    )]
    #[inline(always)]
    fn run(self) -> f64 {
        let (above, below) = (self.above, self.below);
        let cells = above.len().min(below.len()) - 1;
        let (above, below) = (&above[..=cells], &below[..=cells]);
        let spare = self.side * self.side * (1.0 - LEAST_CORNER);
        let least = -spare / self.longest;
        let negative = |value: f64| if value < 0.0 { value } else { 0.0 };
        let mut first = [self.longest; CELL_LANES];
        for start in (0..cells).step_by(CELL_LANES) {
            // The last cells are looked at with some of those before.
            let start = start.min(cells.saturating_sub(CELL_LANES));
            let mut each = [[[0.0; 2]; 4]; CELL_LANES];
            let mut is_losing = false;
            for k in 0..CELL_LANES {
                let cell = (start + k).min(cells - 1);
                let corners = [above[cell], above[cell + 1], below[cell + 1], below[cell]];
                each[k] = losses(corners, self.side);
                for [linear, square] in each[k] {
                    let lost = negative(linear) + negative(square) * self.longest;
                    is_losing |= lost <= least;
                }
            }
            // Most lose less than they have to spare, which needs no root.
            if is_losing {
                for k in 0..CELL_LANES {
                    for [linear, square] in each[k] {
                        let root = first_root([spare, linear, square]);
                        first[k] = if root < first[k] { root } else { first[k] };
                    }
                }
            }
        }
        first.into_iter().fold(self.longest, f64::min)
    }
}

fn side_of(width: f64, height: f64) -> f64 {
    let longest = width.max(height);
    let usual = (longest / CELLS).clamp(CELL_SIDES[0], CELL_SIDES[1]);
    usual.max(longest * (1.0 + 2.0 * BORDER_SHARE) / MOST_CELLS)
}

/// The smallest positive root of `c0 + c1 s + c2 s^2`, with `c0 > 0`; infinite without one.
#[inline(always)]
fn first_root([c0, c1, c2]: [f64; 3]) -> f64 {
    let under = c1 * c1 - 4.0 * c2 * c0;
    // The sum of terms of one sign loses nothing; its product with the other root is c0 / c2.
    let sum = -0.5 * (c1 + under.sqrt().copysign(c1));
    let (falls, bends) = (c1 < 0.0, c2 < 0.0);
    let root = if falls { c0 } else { sum } / if falls { sum } else { c2 };
    if under >= 0.0 && (falls || bends) {
        root
    } else {
        f64::INFINITY
    }
}
