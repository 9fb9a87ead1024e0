//! Moments of a segment relative to N vertices, about the position nearest to v: by quadrature
//! (section 3 of the paper for any alpha), and by a robust closed form for alpha = 2 that replaces
//! the paper's appendix B. Units: lengths along the segment in lengths of the segment; weights
//! relative to `(r2min)^-alpha`.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over lanes are written alike, whatever they index"
)]

use super::falloff::{Falloff, Power};
use super::incomplete_beta::{IncompleteBeta, RelativeSegments};
use super::quadrature::Sight;
use crate::deform::columns::RestSegment;
use crate::deform::lanes::Vertices;
use crate::geometry::lane_math::angle;

/// The closed form of alpha 2 replaces the nodes for a segment farther away than this share of its
/// length: nearer, at a distance r, its second moment cancels by (L/r)^2.
const CLOSED_FROM: f64 = 1e-3;
/// The closed form of other alphas replaces the nodes for a segment nearer than this number of its
/// lengths: farther away, its second moment cancels by (r/L)^3.
const CLOSED_TO: f64 = 32.0;

/// The position of a segment relative to N vertices.
#[derive(Clone, Copy, Debug)]
pub(in crate::deform) struct View<const N: usize> {
    /// Distance of v's foot on the line from the nearest position of the segment, lengths: 0 beside
    /// it, positive before a, negative beyond b.
    beyond: [f64; N],
    /// Shares of the ends a and b at the nearest position, `1 - t` and `t`: also its distances from
    /// b and a.
    pub(in crate::deform) share_a: [f64; N],
    pub(in crate::deform) share_b: [f64; N],
    /// Signed distance of v from the line, px, positive to the left of `tau` in y-up terms.
    off: [f64; N],
    /// Squared distance of v from the segment, px^2.
    pub(in crate::deform) r2: [f64; N],
}

/// `sum w y^m` over the positions of a segment, y from the position nearest to v towards b,
/// lengths. Sums of terms of one sign, or about the position of the largest weight: nothing cancels
/// however near v is.
#[derive(Clone, Copy, Debug)]
pub(in crate::deform) struct Moments<const N: usize>(pub(in crate::deform) [[f64; N]; 3]);

impl<const N: usize> View<N> {
    pub(in crate::deform) const ZERO: Self = Self {
        beyond: [0.0; N],
        share_a: [0.0; N],
        share_b: [0.0; N],
        off: [0.0; N],
        r2: [0.0; N],
    };

    #[inline(always)]
    pub(in crate::deform) fn new(s: &RestSegment, v: &Vertices<N>) -> Self {
        let mut view = Self::ZERO;
        let per_length = 1.0 / s.length;
        for k in 0..N {
            let (ax, ay) = (v.x[k] - s.a.x, v.y[k] - s.a.y);
            let (bx, by) = (v.x[k] - s.b.x, v.y[k] - s.b.y);
            // Where the ends are from v's foot on the line, in lengths. Each is computed from its
            // own end, so that next to one end nothing is the difference of two lengths of a
            // segment (mathematics 3.3).
            let (u1, u2) = (
                -(ax * s.tau.x + ay * s.tau.y) * per_length,
                -(bx * s.tau.x + by * s.tau.y) * per_length,
            );
            let (a2, b2) = (ax * ax + ay * ay, bx * bx + by * by);
            // The nearer end gives the offset with the smaller rounding error.
            let (nx, ny) = if a2 <= b2 { (ax, ay) } else { (bx, by) };
            let off = s.tau.x * ny - s.tau.y * nx;
            // Before a, beyond b, or beside the segment: choices of values instead of branches, so
            // that the lanes stay together. The extension is no case of its own.
            let (before, after) = (u1 >= 0.0, u2 <= 0.0);
            view.beyond[k] = if before {
                u1
            } else if after {
                u2
            } else {
                0.0
            };
            view.share_a[k] = if before {
                1.0
            } else if after {
                0.0
            } else {
                u2
            };
            view.share_b[k] = if before {
                0.0
            } else if after {
                1.0
            } else {
                -u1
            };
            view.off[k] = off;
            // Beside the segment the distance is that from the line: on the line it is exactly 0,
            // which a sum of squares from an end would not give.
            view.r2[k] = if before {
                a2
            } else if after {
                b2
            } else {
                off * off
            };
        }
        view
    }

    /// v from the position nearest to it, px, in the frame of `tau`.
    #[inline(always)]
    pub(in crate::deform) fn off_nearest(&self, s: &RestSegment) -> [[f64; N]; 2] {
        let mut along = self.beyond;
        for u in &mut along {
            *u *= -s.length;
        }
        [along, self.off]
    }

    /// The moments, with weights relative to `r2min`. `exact`: by the nodes, at their full number.
    #[inline(always)]
    pub(in crate::deform) fn moments(
        &self,
        s: &RestSegment,
        v: &Vertices<N>,
        (falloff, beta): (Falloff, Option<&IncompleteBeta>),
        r2min: &[f64; N],
        exact: bool,
    ) -> Moments<N> {
        let square = |lengths: f64| (lengths * s.length) * (lengths * s.length);
        // Three ways, each where it is accurate (mathematics 3.2): a closed form between `near` and
        // `far`, and the nodes elsewhere. Without a closed form everything is nearer than `near`.
        let (mut m, near, far) = match beta {
            _ if exact => (Moments([[0.0; N]; 3]), f64::INFINITY, 0.0),
            _ if falloff.power() == Power::Two => (
                self.moments_alpha_two(s, v, r2min),
                square(CLOSED_FROM),
                f64::INFINITY,
            ),
            Some(beta) => (
                self.moments_by_beta(s, falloff, beta, r2min),
                0.0,
                square(CLOSED_TO),
            ),
            None => (Moments([[0.0; N]; 3]), f64::INFINITY, 0.0),
        };
        for k in 0..N {
            // Lane by lane, because few vertices are so near or so far. Exact rows and large alphas
            // take sixteen nodes, the others eight: what is stored in f32 needs no more.
            if self.r2[k] <= near || self.r2[k] > far {
                let [m0, m1, m2] =
                    self.by_nodes(k, s, falloff, r2min[k], exact || falloff.alpha() > 2.0);
                (m.0[0][k], m.0[1][k], m.0[2][k]) = (m0, m1, m2);
            }
        }
        m
    }

    #[inline(always)]
    fn moments_by_beta(
        &self,
        s: &RestSegment,
        falloff: Falloff,
        beta: &IncompleteBeta,
        r2min: &[f64; N],
    ) -> Moments<N> {
        let (mut a, mut b, mut h, mut ratio) = ([0.0; N], [0.0; N], [0.0; N], [0.0; N]);
        for k in 0..N {
            // From the foot of v: the closed form integrates along the line, on which the foot is
            // the origin.
            a[k] = self.beyond[k] - self.share_b[k];
            b[k] = self.beyond[k] + self.share_a[k];
            h[k] = self.off[k].abs() / s.length;
            ratio[k] = r2min[k] / (s.length * s.length);
        }
        let mut m = beta.moments(
            &RelativeSegments {
                ends: [a, b],
                nearest: &self.beyond,
                h,
                ratio,
            },
            falloff,
        );
        for m in m.as_flattened_mut() {
            // The integral was in lengths of the segment.
            *m *= s.weight * s.length;
        }
        Moments(m)
    }

    #[inline(always)]
    fn by_nodes(
        &self,
        k: usize,
        s: &RestSegment,
        falloff: Falloff,
        r2min: f64,
        many: bool,
    ) -> [f64; 3] {
        // The two sides of the nearest position are integrated apart, away from it: panels grow
        // with the distance, so that no panel is longer than its distance from v. The side towards
        // a is as long as the share of b at the nearest position, and the other way round.
        let h = self.off[k] / s.length;
        let sight = Sight {
            beyond: self.beyond[k].abs(),
            h2: h * h,
            ratio: r2min / (s.length * s.length),
            falloff,
            many,
        };
        let (a, b) = (sight.side(self.share_b[k]), sight.side(self.share_a[k]));
        let scale = s.weight * s.length;
        [
            scale * (a[0] + b[0]),
            // The first moments point to opposite sides. This is the one difference; both parts are
            // sums of positive terms, so its error is small beside m0 and m2, which weigh it.
            scale * (b[1] - a[1]),
            scale * (a[2] + b[2]),
        ]
    }

    /// From `d00, d01, d11` of section 3.1 for alpha = 2, times `r2min^2`: exact everywhere, no
    /// branch on the extension (mathematics 3.2).
    #[inline(always)]
    fn moments_alpha_two(&self, s: &RestSegment, v: &Vertices<N>, r2min: &[f64; N]) -> Moments<N> {
        // The formulas of mathematics 3.2 for d00, d01 and d11, from the angle phi under which v
        // sees the segment.
        let half = 0.5 * s.weight * s.length;
        let mut m = Moments([[0.0; N]; 3]);
        for k in 0..N {
            let (ax, ay) = (s.a.x - v.x[k], s.a.y - v.y[k]);
            let (bx, by) = (s.b.x - v.x[k], s.b.y - v.y[k]);
            let (a2, b2) = (ax * ax + ay * ay, bx * bx + by * by);
            let per_ab = 1.0 / (a2 * b2).sqrt();
            let (cross, dot) = (self.off[k].abs() * s.length, ax * bx + ay * by);
            // The cross product is |off| L: `off` was computed at the nearer end, so phi keeps its
            // digits next to the line and on the extension, where it is 0.
            let phi = angle(cross, dot);
            let (near, far) = (
                g_series(phi * phi),
                g_closed(phi, cross * per_ab, dot * per_ab),
            );
            // Both are computed and one is chosen: the closed form is 0/0 at phi = 0, and the
            // series ends too early for large angles.
            let (g1, g2) = if phi < 0.3 { near } else { far };
            // Ratios of squared distances, each at most 1: the products of R1 and R2 in the
            // formulas would overflow far away and vanish next to an end.
            let q12 = r2min[k] * per_ab;
            let (q1, q2) = (r2min[k] / a2, r2min[k] / b2);
            let (d00, d01, d11) = (
                half * g1 * q1 * q12,
                half * g2 * q12 * q12,
                half * g1 * q2 * q12,
            );
            // From the shares of the two ends to moments about the nearest position, where b is the
            // distance from a. What is used later cancels nowhere there.
            let (of_a, of_b) = (d00 + d01, d01 + d11);
            let b = self.share_b[k];
            m.0[0][k] = of_a + of_b;
            m.0[1][k] = of_b * (1.0 - b) - of_a * b;
            m.0[2][k] = d11 * ((1.0 - b) * (1.0 - b)) - 2.0 * d01 * (b * (1.0 - b)) + d00 * (b * b);
        }
        m
    }
}

#[inline(always)]
fn g_closed(phi: f64, sin: f64, cos: f64) -> (f64, f64) {
    // phi / sin is near 1 and cos as well: for small angles the digits cancel, and at 0 nothing is
    // left. `g_series` takes over.
    let s2 = sin * sin;
    ((phi / sin - cos) / s2, (1.0 - phi * cos / sin) / s2)
}

/// Series in `x = phi^2` (appendix of the mathematics); 12 terms reach 1e-15 at phi = 0.3.
#[inline(always)]
fn g_series(x: f64) -> (f64, f64) {
    let (mut g1, mut g2) = (G1[11], G2[11]);
    for k in (0..11).rev() {
        (g1, g2) = (g1 * x + G1[k], g2 * x + G2[k]);
    }
    (g1, g2)
}

const G1: [f64; 12] = [
    0.666_666_666_666_666_6,
    0.2,
    0.040_476_190_476_190_48,
    0.006_904_761_904_761_905,
    0.001_065_115_440_115_440_1,
    0.000_153_448_954_044_192_13,
    2.103_185_064_494_588_3e-5,
    2.775_288_059_193_287_7e-6,
    3.554_743_897_991_485_7e-7,
    4.445_508_838_349_299_4e-8,
    5.451_608_923_746_391e-9,
    6.577_162_419_890_202e-10,
];
const G2: [f64; 12] = [
    0.333_333_333_333_333_3,
    0.133_333_333_333_333_33,
    0.031_746_031_746_031_744,
    0.005_925_925_925_925_926,
    0.000_962_000_962_000_962,
    0.000_142_850_682_533_222_2,
    1.995_261_254_520_514e-5,
    2.665_753_054_797_561_7e-6,
    3.443_700_517_071_775_7e-7,
    4.332_978_728_872_515e-8,
    5.337_585_930_369_606e-9,
    6.461_631_082_271_668e-10,
];

#[cfg(test)]
mod tests {
    use super::super::quick_moments::{SeenSegment, factor};
    use super::*;
    use crate::geometry::{Point, Vec2};

    fn segment(a: Point, b: Point) -> RestSegment {
        let length = a.distance(b);
        RestSegment {
            a,
            b,
            length,
            tau: (b - a) * (1.0 / length),
            weight: 1.0,
            column: 0,
        }
    }

    /// Moments about the nearest place, and r2min = the segment's own.
    fn moments(s: &RestSegment, v: Point, alpha: f64, exact: bool) -> (View<1>, [f64; 3]) {
        let v = Vertices::all(v);
        let view = View::new(s, &v);
        let (falloff, beta) = (
            Falloff::new(alpha, true).unwrap(),
            IncompleteBeta::new(alpha),
        );
        let Moments([[m0], [m1], [m2]]) =
            view.moments(s, &v, (falloff, beta.as_ref()), &view.r2, exact);
        (view, [m0, m1, m2])
    }

    /// `d00, d01, d11` of the mathematics: the moments seen from the ends.
    fn shares(s: &RestSegment, v: Point, alpha: f64, exact: bool) -> [f64; 3] {
        let (view, [m0, m1, m2]) = moments(s, v, alpha, exact);
        let (a, b) = (view.share_a[0], view.share_b[0]);
        [
            a * a * m0 - 2.0 * a * m1 + m2,
            a * b * m0 + (a - b) * m1 - m2,
            b * b * m0 + 2.0 * b * m1 + m2,
        ]
    }

    /// Vertices beside the foot, beyond the ends, on the extension and far away, at distances 1e-3
    /// .. 1e5 px.
    fn views(s: &RestSegment) -> Vec<Point> {
        let normal = Vec2::new(-s.tau.y, s.tau.x);
        let mut all = Vec::new();
        for off in [-1e5, -700.0, -3.0, -1e-3, 0.0, 1e-3, 0.1, 10.0, 200.0, 1e4] {
            for along in [-5e4, -300.0, -1.0, -1e-3, 0.2, 0.5, 0.999, 1.001, 1.5, 40.0] {
                if off == 0.0 && (0.0..=1.0).contains(&along) {
                    continue;
                }
                all.push(s.a + s.tau * (along * s.length) + normal * off);
            }
        }
        all
    }

    #[test]
    fn closed_form_of_alpha_two_equals_quadrature() {
        for s in [
            segment(Point::new(40.0, 200.0), Point::new(300.0, 210.0)),
            segment(Point::new(7.0, 3.0), Point::new(7.5, -2.0)),
        ] {
            for v in views(&s) {
                let (_, closed) = moments(&s, v, 2.0, false);
                let (_, nodes) = moments(&s, v, 2.0, true);
                let sizes = [nodes[0], (nodes[0] * nodes[2]).sqrt(), nodes[2]];
                for ((c, n), size) in closed.iter().zip(nodes).zip(sizes) {
                    assert!(
                        (c - n).abs() <= 1e-9 * size,
                        "v = {v:?}: closed {closed:?}, quadrature {nodes:?}"
                    );
                }
            }
        }
    }

    /// From an end, to the digits that are left of the sums of a pose.
    #[test]
    fn quick_moments_equal_quadrature() {
        for s in [
            segment(Point::new(40.0, 200.0), Point::new(300.0, 210.0)),
            segment(Point::new(7.0, 3.0), Point::new(7.5, -2.0)),
        ] {
            let turned = |angle: f64| {
                let distance = 0.5 * s.length / (0.5 * angle).tan();
                s.a.lerp(s.b, 0.5) + Vec2::new(-s.tau.y, s.tau.x) * distance
            };
            let turned = (1..630).map(|k| turned(0.005 * f64::from(k)));
            for v in views(&s).into_iter().chain(turned) {
                let (view, [m0, m1, m2]) = moments(&s, v, 2.0, true);
                let (b, scale) = (view.share_b[0], view.r2[0] * view.r2[0]);
                let nodes = [m0, m1 + b * m0, m2 + b * (2.0 * m1 + b * m0)];
                let (mut seen, mut quick) = (SeenSegment::<1>::ZERO, [[0.0]; 3]);
                seen.see(&s, &[v.x], &[v.y]);
                seen.put(&mut quick);
                let quick = quick.map(|[m]| m * factor(&s) * scale);
                for (m, (quick, nodes)) in quick.iter().zip(nodes).enumerate() {
                    // Beside the line and far away, positions have fewer digits themselves.
                    let off = (quick - nodes).abs() / nodes;
                    assert!(off <= 1e-9, "{m} at {v:?}: {quick:e}, {nodes:e}: {off:e}");
                }
            }
        }
    }

    /// The fewer nodes of a plan, beside the exact rule: far below what f32 keeps (6e-8).
    #[test]
    fn plans_integrate_to_single_precision() {
        let s = segment(Point::new(40.0, 200.0), Point::new(300.0, 210.0));
        for alpha in [
            0.5, 0.501, 0.6, 0.9, 0.999, 1.0, 1.3, 1.501, 2.0, 3.0, 5.5, 8.0,
        ] {
            for v in views(&s) {
                let few = shares(&s, v, alpha, false);
                let many = shares(&s, v, alpha, true);
                for (few, many) in [
                    (few[0] + few[1], many[0] + many[1]),
                    (few[1] + few[2], many[1] + many[2]),
                ] {
                    assert!(
                        (few - many).abs() <= 2e-8 * many,
                        "alpha {alpha}, v = {v:?}: {few} against {many}"
                    );
                }
            }
        }
    }

    /// Many small midpoints say the same, wherever v is; the second moment keeps its digits next to
    /// the line.
    #[test]
    fn moments_are_those_of_many_points() {
        let s = segment(Point::new(0.0, 0.0), Point::new(30.0, 40.0));
        for alpha in [0.7, 1.5, 3.0] {
            for (along, off) in [
                (0.3, 5.0),
                (-0.2, 3.0),
                (1.4, 0.0),
                (0.5, -80.0),
                (30.0, 7.0),
            ] {
                let v = s.a + s.tau * (along * s.length) + Vec2::new(-s.tau.y, s.tau.x) * off;
                let (view, got) = moments(&s, v, alpha, true);
                let mut expected = [0.0; 3];
                let n = 200_000;
                for i in 0..n {
                    let t = (f64::from(i) + 0.5) / f64::from(n);
                    let y = t - view.share_b[0];
                    let w = s.length / f64::from(n)
                        * (view.r2[0] / (s.a + (s.b - s.a) * t - v).norm2()).powf(alpha);
                    for (e, power) in expected.iter_mut().zip([1.0, y, y * y]) {
                        *e += w * power;
                    }
                }
                for (g, e) in got.iter().zip(expected) {
                    assert!(
                        (g - e).abs() <= 1e-8 * e.abs().max(expected[2]),
                        "{along}, {off}: {got:?} against {expected:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn shares_of_the_nearest_place_add_up() {
        let s = segment(Point::new(0.0, 0.0), Point::new(30.0, 40.0));
        for v in views(&s) {
            let view = View::new(&s, &Vertices::<1>::all(v));
            let (a, b) = (view.share_a[0], view.share_b[0]);
            assert!(
                a >= 0.0 && b >= 0.0 && (a + b - 1.0).abs() < 1e-10,
                "v = {v:?}: {a}, {b}"
            );
        }
    }

    #[test]
    fn quadrature_of_alpha_one_equals_its_integrals() {
        // I0, I1, I2 of the mathematics' table at alpha 1, foot inside and h <= L, where that table
        // is exact.
        let s = segment(Point::new(10.0, 20.0), Point::new(110.0, 20.0));
        for off in [1e-3, 0.5, 20.0, 99.0] {
            let v = Point::new(47.0, 20.0 + off);
            let (u1, u2, length) = (-37.0, 63.0, 100.0);
            let (d1, d2) = (u1 * u1 + off * off, u2 * u2 + off * off);
            let phi = (off * length).atan2(u1 * u2 + off * off);
            let expected = [
                phi / off,
                0.5 * f64::ln(d2 / d1) / length,
                (length - off * phi) / (length * length),
            ]
            .map(|i| i * off * off);
            let (_, got) = moments(&s, v, 1.0, true);
            for (g, e) in got.iter().zip(expected) {
                assert!(
                    (g - e).abs() <= 1e-9 * e.abs(),
                    "h = {off}: {got:?} against {expected:?}"
                );
            }
        }
    }
}
