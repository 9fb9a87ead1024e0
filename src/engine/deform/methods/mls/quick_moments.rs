//! `sum w t^m` of segments at alpha 2, t from a in lengths of the segment: about 1e-13 of the
//! largest of them, for sums that cancel beside the segment in any case. An eighth of the time of
//! [`View::moments`](super::segments::View). In two steps, each for several segments: in one, so
//! many operations would wait for each other that a processor has no room for those of a second
//! segment.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over lanes are written alike, whatever they index"
)]

use crate::deform::columns::RestSegment;
use crate::geometry::lane_math::{Arc, arc_remainder};

/// The least cross product that is divided by, px^2.
const LEAST_CROSS: f64 = 1e-100;

/// A segment as N vertices see it (mathematics 7.3).
#[derive(Clone, Copy)]
pub(super) struct SeenSegment<const N: usize> {
    /// `|A|^2`, `|B|^2` and `A . B`, px^2, and the last by both others, 1/px^2.
    a2: [f64; N],
    b2: [f64; N],
    dot: [f64; N],
    per_dot: [f64; N],
    /// The angle is `base + atan(q)`.
    base: [f64; N],
    q: [f64; N],
    /// One by the dot product where base is 0, elsewhere by the cross product, 1/px^2.
    per: [f64; N],
}

/// What the moments are multiplied by.
pub(super) fn factor(s: &RestSegment) -> f64 {
    0.5 * s.weight * s.length
}

impl<const N: usize> SeenSegment<N> {
    pub(super) const ZERO: Self = Self {
        a2: [0.0; N],
        b2: [0.0; N],
        dot: [0.0; N],
        per_dot: [0.0; N],
        base: [0.0; N],
        q: [0.0; N],
        per: [0.0; N],
    };

    /// The first step.
    #[inline(always)]
    pub(super) fn see(&mut self, s: &RestSegment, x: &[f64; N], y: &[f64; N]) {
        for k in 0..N {
            let (ax, ay) = (s.a.x - x[k], s.a.y - y[k]);
            let (bx, by) = (s.b.x - x[k], s.b.y - y[k]);
            let (a2, b2) = (ax * ax + ay * ay, bx * bx + by * by);
            let (cross, dot) = ((ax * by - ay * bx).abs(), ax * bx + ay * by);
            // On the line beyond an end, where it is divided by as well.
            let cross = if cross > LEAST_CROSS {
                cross
            } else {
                LEAST_CROSS
            };
            // One division for all three.
            let (square, arc) = (a2 * b2, Arc::new(cross, dot));
            let product = square * cross;
            let per_all = 1.0 / (product * arc.under);
            let (per_under, per_product) = (per_all * product, per_all * arc.under);
            let (base, sign) = arc.base();
            (self.a2[k], self.b2[k], self.dot[k]) = (a2, b2, dot);
            self.per_dot[k] = dot * (per_product * cross);
            (self.base[k], self.q[k]) = (base, sign * arc.over * per_under);
            let per_cross = per_product * square;
            self.per[k] = if base > 0.0 { per_cross } else { per_under };
        }
    }

    /// The second one.
    #[inline(always)]
    pub(super) fn put(&self, moments: &mut [[f64; N]; 3]) {
        for k in 0..N {
            let (q, base, per) = (self.q[k], self.base[k], self.per[k]);
            let z = q * q;
            let remainder = arc_remainder(z);
            let phi = base + (q - q * (z * remainder));
            // Below pi/8 the differences for larger angles are those of the remainder, without
            // what cancels.
            let is_wide = base > 0.0;
            let over = (if is_wide { phi } else { remainder }) * per;
            let off = over - self.per_dot[k];
            let of_both = if is_wide {
                1.0 - over * self.dot[k]
            } else {
                remainder
            };
            let per2 = per * per;
            let (of_ends, d01) = ((if is_wide { off } else { -off }) * per2, of_both * per2);
            let (d00, d11) = (of_ends * self.b2[k], of_ends * self.a2[k]);
            let of_b = d01 + d11;
            (moments[0][k], moments[1][k], moments[2][k]) = (d00 + d01 + of_b, of_b, d11);
        }
    }
}
