//! Crossings of an edge between two lattice vertices with rows of pixel centres. By the top-left
//! rule a polygon owns the pixels whose centre is not left of its left edge and left of its right
//! edge, and the rows from the upper end of an edge to just before its lower end. The rule is
//! applied exactly, so polygons that share an edge neither share pixels nor leave gaps. Cost: O(1)
//! per crossing.

#![expect(
    clippy::cast_possible_truncation,
    reason = "lattice places have 30 bits, and all products fit 62"
)]

use std::ops::Range;

use super::snapped_grid::{Corner, HALF_PX, STEPS_PER_PX, first_row, row_centre};

/// Crossings closer than this to a pixel's centre, px, are decided in integers. The f64 result is
/// off by at most 2^-28 px.
const CLOSE_CALL: f64 = 1e-6;

/// An edge that is not horizontal, from top to bottom.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    top: Corner,
    bottom: Corner,
    /// Change of x per lattice step downwards.
    slope: f64,
    slope_u: f64,
    slope_v: f64,
}

/// Crossing of an edge with a row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// The first pixel whose centre is not left of the crossing; may be off the target.
    pub(super) pixel: i64,
    /// The crossing, lattice steps.
    pub(super) x: f64,
    pub(super) u: f64,
    pub(super) v: f64,
}

impl Edge {
    /// `None` for a horizontal edge, which no row of centres crosses.
    pub(super) fn new(a: Corner, b: Corner) -> Option<Self> {
        let (top, bottom) = match a.y.cmp(&b.y) {
            std::cmp::Ordering::Less => (a, b),
            std::cmp::Ordering::Greater => (b, a),
            std::cmp::Ordering::Equal => return None,
        };
        let per_step = 1.0 / f64::from(bottom.y - top.y);
        Some(Self {
            top,
            bottom,
            slope: f64::from(bottom.x - top.x) * per_step,
            slope_u: (f64::from(bottom.u) - f64::from(top.u)) * per_step,
            slope_v: (f64::from(bottom.v) - f64::from(top.v)) * per_step,
        })
    }

    /// The crossing with the row of centres at lattice y.
    pub(super) fn crossing(&self, y: i64) -> Option<Crossing> {
        if y < i64::from(self.top.y) || y >= i64::from(self.bottom.y) {
            return None;
        }
        Some(self.at(y))
    }

    /// The crossing with the row of centres at lattice y, which lies between the ends.
    #[inline]
    pub(super) fn at(&self, y: i64) -> Crossing {
        let t = (y - i64::from(self.top.y)) as f64;
        let x = f64::from(self.top.x) + t * self.slope;
        let pixel = (x - f64::from(HALF_PX)) / f64::from(STEPS_PER_PX);
        let nearest = (pixel + 0.5 + f64::from(1 << 24)) as i64 - (1 << 24);
        let pixel = if (pixel - nearest as f64).abs() > CLOSE_CALL {
            nearest + i64::from(pixel > nearest as f64)
        } else {
            self.pixel_exactly(y)
        };
        Crossing {
            pixel,
            x,
            u: f64::from(self.top.u) + t * self.slope_u,
            v: f64::from(self.top.v) + t * self.slope_v,
        }
    }

    /// The first pixel whose centre is not left of the crossing, in integers.
    pub(super) fn pixel_exactly(&self, y: i64) -> i64 {
        let (ax, ay) = (i64::from(self.top.x), i64::from(self.top.y));
        let (dx, dy) = (i64::from(self.bottom.x) - ax, i64::from(self.bottom.y) - ay);
        // x = ax + (y - ay) dx / dy, and pixel = ceil((x - HALF) / ONE).
        let numerator = (ax - i64::from(HALF_PX)) * dy + (y - ay) * dx;
        let denominator = i64::from(STEPS_PER_PX) * dy;
        -(-numerator).div_euclid(denominator)
    }
}

/// Crossings of rows with a convex polygon (a triangle repeats a corner): left and right in any
/// order.
pub(super) fn walk(
    corners: &[Corner; 4],
    rows: Range<u32>,
    mut found: impl FnMut(u32, Crossing, Crossing),
) {
    let from = (0..4).min_by_key(|&k| corners[k].y).unwrap_or(0);
    let (mut one, mut other) = (Chain::new(corners, from, 1), Chain::new(corners, from, 3));
    for row in rows {
        let y = row_centre(row);
        if let (Some(a), Some(b)) = (one.crossing(row, y), other.crossing(row, y)) {
            found(row, a, b);
        }
    }
}

/// One of the two chains of edges from a convex polygon's highest corner to its lowest.
struct Chain<'a> {
    corners: &'a [Corner; 4],
    at: usize,
    step: usize,
    edge: Option<Edge>,
    /// The first row behind the edge.
    end: i64,
}

impl<'a> Chain<'a> {
    fn new(corners: &'a [Corner; 4], at: usize, step: usize) -> Self {
        Self {
            corners,
            at,
            step,
            edge: None,
            end: i64::MIN,
        }
    }

    /// The crossing with a row that the polygon meets. Rows must be requested from top to bottom.
    fn crossing(&mut self, row: u32, y: i64) -> Option<Crossing> {
        if self.end <= i64::from(row) {
            // Ends at the last edge, because rows below the lowest corner are never requested.
            for _ in 0..4 {
                let from = self.corners[self.at];
                self.at = (self.at + self.step) % 4;
                let to = self.corners[self.at];
                self.end = first_row(to.y);
                if self.end > i64::from(row) {
                    self.edge = Edge::new(from, to);
                    break;
                }
            }
        }
        self.edge.as_ref().map(|edge| edge.at(y))
    }
}

#[cfg(test)]
mod tests {
    use super::super::snapped_grid::MAX_STEPS;
    use super::*;
    use proptest::prelude::*;

    fn corner(x: i32, y: i32) -> Corner {
        Corner {
            x,
            y,
            u: x as f32,
            v: y as f32,
        }
    }

    proptest! {
        #[test]
        fn crossing_is_the_exact_one(
            (ax, ay, bx, by) in (-9000..9000_i32, -9000..9000_i32, -9000..9000_i32,
                -9000..9000_i32),
            row in -30..30_i64,
        ) {
            let y = row * i64::from(STEPS_PER_PX) + i64::from(HALF_PX);
            if let Some(edge) = Edge::new(corner(ax, ay), corner(bx, by))
                && let Some(crossing) = edge.crossing(y)
            {
                prop_assert_eq!(crossing.pixel, edge.pixel_exactly(y));
                prop_assert!((crossing.u - crossing.x).abs() < 1e-6);
                prop_assert!((crossing.v - y as f64).abs() < 1e-6);
            }
        }

        #[test]
        fn crossing_through_centres_takes_the_pixel(column in -40..40_i32, slant in -40..40_i32,
            height in 1..40_i32, row in 0..40_i32) {
            // Both ends on pixel centres: whole slopes meet centres exactly.
            let (top, bottom) = (corner(column * STEPS_PER_PX + HALF_PX, HALF_PX),
                corner((column + slant * height) * STEPS_PER_PX + HALF_PX,
                    height * STEPS_PER_PX + HALF_PX));
            let centre = i64::from(row * STEPS_PER_PX + HALF_PX);
            let crossing = Edge::new(bottom, top).unwrap().crossing(centre);
            prop_assert_eq!(crossing.map(|c| c.pixel),
                (row < height).then(|| i64::from(column + slant * row)));
        }

        #[test]
        fn crossing_never_overflows(
            (ax, ay) in (any::<bool>(), any::<bool>()),
            (bx, by) in (-MAX_STEPS..MAX_STEPS, -MAX_STEPS..MAX_STEPS),
            row in 0..100_000_u32,
        ) {
            let far = |negative| if negative { -MAX_STEPS } else { MAX_STEPS };
            if let Some(edge) = Edge::new(corner(far(ax), far(ay)), corner(bx, by))
                && let Some(crossing) = edge.crossing(row_centre(row))
            {
                prop_assert_eq!(crossing.pixel, edge.pixel_exactly(row_centre(row)));
            }
        }
    }
}
