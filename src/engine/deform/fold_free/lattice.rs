//! The lattice on which a factor is examined: larger than the image, so that what lies outside
//! stays open too.

use crate::geometry::{Point, Vec2};

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

    /// Calls `look` with a corner and the ends of its edges, whose cross product at rest is the
    /// area of a cell, until it returns false; whether it never did.
    fn all_corners(&self, mut look: impl FnMut(usize, usize, usize) -> bool) -> bool {
        let rows = self.places.len() / self.columns;
        let mut cells = (0..rows - 1).flat_map(|j| (0..self.columns - 1).map(move |i| (i, j)));
        cells.all(|(i, j)| {
            let a = j * self.columns + i;
            let [b, c, d] = [a + 1, a + self.columns + 1, a + self.columns];
            look(a, b, d) && look(b, c, a) && look(c, d, b) && look(d, a, c)
        })
    }

    /// Whether every corner keeps its share.
    pub(super) fn is_open(&self, mapped: &[Point]) -> bool {
        let least = LEAST_CORNER * self.area;
        self.all_corners(|a, b, c| (mapped[b] - mapped[a]).cross(mapped[c] - mapped[a]) >= least)
    }

    /// The largest share of these displacements, up to 1, with which every corner keeps its share.
    pub(super) fn longest(&self, displacements: &[Vec2]) -> f64 {
        let (d, v) = (displacements, &self.places);
        let mut longest = 1.0_f64;
        self.all_corners(|a, b, c| {
            let (edges, moved) = ([v[b] - v[a], v[c] - v[a]], [d[b] - d[a], d[c] - d[a]]);
            let linear = edges[0].cross(moved[1]) + moved[0].cross(edges[1]);
            let square = moved[0].cross(moved[1]);
            let spare = self.area * (1.0 - LEAST_CORNER);
            // Most corners lose less than they have to spare, which needs no root.
            let lost = linear.min(0.0) + square.min(0.0) * longest;
            if spare + lost * longest <= 0.0 {
                longest = longest.min(first_root([spare, linear, square]));
            }
            true
        });
        longest
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
