//! A segment seen from a vertex: the integrals of section 3 of the paper as graded Gauss-Legendre nodes (any alpha; no cancellation, no
//! special cases), and the robust closed form for alpha = 2 that replaces the paper's appendix B.
//! Units: u, h in lengths of the segment; weights relative to `(r2min)^-alpha`.

use super::columns::Segment;
use super::falloff::Falloff;
use crate::geometry::Point;

/// Positive nodes and weights on [-1, 1]. A panel is no longer than its distance from v, so n nodes leave about 4.6^(-2n): 8 are enough for a
/// plan, whose coefficients are f32, at alpha up to 2.
const GAUSS_8: [(f64, f64); 4] = [
    (0.1834346424956498, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.31370664587788729),
    (0.796_666_477_413_626_7, 0.22238103445337447),
    (0.960_289_856_497_536_2, 0.10122853629037626),
];

/// The same with 16 nodes, for exact evaluation and for plans at higher alpha.
const GAUSS_16: [(f64, f64); 8] = [
    (0.095_012_509_837_637_44, 0.189_450_610_455_068_5),
    (0.281_603_550_779_258_9, 0.182_603_415_044_923_6),
    (0.458_016_777_657_227_4, 0.169_156_519_395_002_54),
    (0.617_876_244_402_643_7, 0.149_595_988_816_576_73),
    (0.755_404_408_355_003, 0.124_628_971_255_533_87),
    (0.865_631_202_387_831_7, 0.095_158_511_682_492_78),
    (0.944_575_023_073_232_6, 0.062_253_523_938_647_89),
    (0.989_400_934_991_649_9, 0.027_152_459_411_754_095),
];

/// A segment in foot coordinates of a vertex v: u is the arc length from v's foot, h the distance from the line, in segment lengths.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    /// u of the ends; `u2 - u1 = 1`.
    pub(super) u1: f64,
    pub(super) u2: f64,
    /// Signed distance of v from the line, px, positive to the left of `tau` (y-up words).
    pub(super) off: f64,
    /// |off| in segment lengths.
    h: f64,
    /// Squared distance of v from the segment, px^2.
    pub(super) r2: f64,
}

/// A quadrature node: an ordinary weighted point of the segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Shares of the ends a and b: `1 - t`, `t`.
    pub(super) share_a: f64,
    pub(super) share_b: f64,
    /// Arc length from the foot, segment lengths.
    pub(super) u: f64,
    pub(super) weight: f64,
}

impl View {
    #[inline]
    pub(super) fn new(s: &Segment, v: Point) -> Self {
        let (from_a, from_b) = (v - s.a, v - s.b);
        let (u1, u2) = (-from_a.dot(s.tau) / s.length, -from_b.dot(s.tau) / s.length);
        // The nearer end gives the offset with the smaller rounding.
        let off = s.tau.cross(if from_a.norm2() <= from_b.norm2() { from_a } else { from_b });
        let r2 = if u1 >= 0.0 {
            from_a.norm2()
        } else if u2 <= 0.0 {
            from_b.norm2()
        } else {
            off * off
        };
        Self { u1, u2, off, h: off.abs() / s.length, r2 }
    }

    /// Parameter of the nearest point of the segment, in [0, 1].
    pub(super) fn nearest(&self) -> f64 {
        (-self.u1).clamp(0.0, 1.0)
    }

    /// Graded Gauss-Legendre: panels are halved until each is no longer than its distance from v.
    #[inline]
    pub(super) fn nodes(&self, s: &Segment, falloff: Falloff, r2min: f64, exact: bool, mut node: impl FnMut(Node)) {
        let rule: &[(f64, f64)] = if exact || falloff.alpha() > 2.0 { &GAUSS_16 } else { &GAUSS_8 };
        let ratio = r2min / (s.length * s.length);
        let h2 = self.h * self.h;
        let scale = s.weight * s.length;
        let mut panel = |p: f64, q: f64| {
            let half = 0.5 * (q - p);
            let mid = 0.5 * (p + q);
            let (to_p, to_q) = (p - self.u1, self.u2 - q);
            for &(x, omega) in rule {
                for x in [-x, x] {
                    let u = mid + half * x;
                    let weight = scale * half * omega * falloff.of(ratio / (u * u + h2));
                    node(Node { share_a: to_q + half * (1.0 - x), share_b: to_p + half * (1.0 + x), u, weight });
                }
            }
        };
        if self.u1 < 0.0 && self.u2 > 0.0 {
            self.graded(self.u1, 0.0, &mut panel);
            self.graded(0.0, self.u2, &mut panel);
        } else {
            self.graded(self.u1, self.u2, &mut panel);
        }
    }

    /// Halves `[p, q]` (0 not inside) towards the foot. The far half is never longer than its distance, so only the near one goes on.
    #[inline]
    fn graded(&self, p: f64, q: f64, panel: &mut impl FnMut(f64, f64)) {
        let (mut p, mut q) = (p, q);
        // The length halves with each step and the distance is bounded below by the snap: 64 steps are never reached.
        for _ in 0..64 {
            if p.max(0.0).max(-q).hypot(self.h) >= q - p {
                break;
            }
            let mid = 0.5 * (p + q);
            if q <= 0.0 {
                panel(p, mid);
                p = mid;
            } else {
                panel(mid, q);
                q = mid;
            }
        }
        panel(p, q);
    }

    /// `d00, d01, d11` of section 3.1 for alpha = 2, times `r2min^2`: exact everywhere, no branch on the extension (mathematics 3.2).
    #[inline]
    pub(super) fn masses_alpha_two(&self, s: &Segment, v: Point, r2min: f64) -> [f64; 3] {
        let (a, b) = (s.a - v, s.b - v);
        let (r1, r2) = (a.norm2().sqrt(), b.norm2().sqrt());
        let (cross, dot) = (self.off.abs() * s.length, a.dot(b));
        let phi = cross.atan2(dot);
        let (g1, g2) = if phi < 0.3 { g_series(phi * phi) } else { g_closed(phi, cross / (r1 * r2), dot / (r1 * r2)) };
        let half = 0.5 * s.weight * s.length;
        let (q1, q2, q12) = (r2min / (r1 * r1), r2min / (r2 * r2), r2min / (r1 * r2));
        [half * g1 * q1 * q12, half * g2 * q12 * q12, half * g1 * q2 * q12]
    }
}

#[inline]
fn g_closed(phi: f64, sin: f64, cos: f64) -> (f64, f64) {
    let s2 = sin * sin;
    ((phi / sin - cos) / s2, (1.0 - phi * cos / sin) / s2)
}

/// Series in `x = phi^2` (appendix of the mathematics); 12 terms reach 1e-15 at phi = 0.3.
#[inline]
fn g_series(x: f64) -> (f64, f64) {
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
    let horner = |c: &[f64; 12]| c.iter().rev().fold(0.0, |sum, &k| sum * x + k);
    (horner(&G1), horner(&G2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;

    fn segment(a: Point, b: Point) -> Segment {
        let length = a.distance(b);
        Segment { a, b, length, tau: (b - a) * (1.0 / length), weight: 1.0, column: 0 }
    }

    fn by_quadrature(s: &Segment, v: Point, alpha: f64, r2min: f64) -> [f64; 3] {
        let mut d = [0.0; 3];
        View::new(s, v).nodes(s, Falloff::new(alpha, true).unwrap(), r2min, true, |n| {
            d[0] += n.weight * n.share_a * n.share_a;
            d[1] += n.weight * n.share_a * n.share_b;
            d[2] += n.weight * n.share_b * n.share_b;
        });
        d
    }

    /// Vertices beside the foot, beyond the ends, on the extension and far away, at distances 1e-3 .. 1e5 px.
    fn views(s: &Segment) -> Vec<Point> {
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
        for s in [segment(Point::new(40.0, 200.0), Point::new(300.0, 210.0)), segment(Point::new(7.0, 3.0), Point::new(7.5, -2.0))] {
            for v in views(&s) {
                let view = View::new(&s, v);
                let closed = view.masses_alpha_two(&s, v, view.r2);
                let nodes = by_quadrature(&s, v, 2.0, view.r2);
                for (c, n) in closed.iter().zip(nodes) {
                    assert!((c - n).abs() <= 1e-9 * n.abs(), "v = {v:?}: closed {closed:?}, quadrature {nodes:?}");
                }
            }
        }
    }

    /// The fewer nodes of a plan, beside the exact rule: far below what f32 keeps (6e-8).
    #[test]
    fn plan_nodes_integrate_to_single_precision() {
        let s = segment(Point::new(40.0, 200.0), Point::new(300.0, 210.0));
        for alpha in [0.5, 1.0, 1.3, 2.0, 3.0, 5.5, 8.0] {
            for v in views(&s) {
                let view = View::new(&s, v);
                let mass = |exact| {
                    let mut mass = [0.0; 2];
                    view.nodes(&s, Falloff::new(alpha, true).unwrap(), view.r2, exact, |n| {
                        mass[0] += n.weight * n.share_a;
                        mass[1] += n.weight * n.share_b;
                    });
                    mass
                };
                for (few, many) in mass(false).into_iter().zip(mass(true)) {
                    assert!((few - many).abs() <= 2e-8 * many, "alpha {alpha}, v = {v:?}: {few} against {many}");
                }
            }
        }
    }

    #[test]
    fn nodes_integrate_length_and_shares() {
        let s = segment(Point::new(0.0, 0.0), Point::new(30.0, 40.0));
        for v in views(&s) {
            let mut shares: f64 = 0.0;
            let mut count = 0;
            View::new(&s, v).nodes(&s, Falloff::new(0.5, true).unwrap(), 1.0, true, |n| {
                shares = shares.max((n.share_a + n.share_b - 1.0).abs());
                assert!(n.share_a >= -1e-12 && n.share_b >= -1e-12 && n.weight > 0.0 && n.weight.is_finite());
                count += 1;
            });
            assert!(count <= 1200);
            assert!(shares < 1e-10, "v = {v:?}: shares are off by {shares}");
        }
    }

    #[test]
    fn quadrature_of_alpha_one_and_half_equals_its_integrals() {
        // I0, I1, I2 of the mathematics' table at alpha 1, foot inside and h <= L, where that table is exact.
        let s = segment(Point::new(10.0, 20.0), Point::new(110.0, 20.0));
        for off in [1e-3, 0.5, 20.0, 99.0] {
            let v = Point::new(47.0, 20.0 + off);
            let (u1, u2, length) = (-37.0, 63.0, 100.0);
            let (d1, d2) = (u1 * u1 + off * off, u2 * u2 + off * off);
            let phi = (off * length).atan2(u1 * u2 + off * off);
            let (i0, i1, i2) = (phi / off, 0.5 * f64::ln(d2 / d1), length - off * phi);
            let expected = [
                (u2 * u2 * i0 - 2.0 * u2 * i1 + i2) / (length * length),
                (-u1 * u2 * i0 + (u1 + u2) * i1 - i2) / (length * length),
                (u1 * u1 * i0 - 2.0 * u1 * i1 + i2) / (length * length),
            ];
            let got = by_quadrature(&s, v, 1.0, 1.0);
            for (g, e) in got.iter().zip(expected) {
                assert!((g - e).abs() <= 1e-9 * e.abs(), "h = {off}: {got:?} against {expected:?}");
            }
        }
    }
}
