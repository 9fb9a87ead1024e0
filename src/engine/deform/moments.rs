//! f at N vertices from the moments of the weights, without a row of coefficients: for poses of many points whose rows are used once.
//! Points of equal weight only. Equations (1) to (8), anchored at the nearest point: its position and displacement are the origin of all
//! others, so next to it every sum consists of relatively exact terms (mathematics 7.1). About thirty operations per vertex and point, no
//! memory.

use super::Method;
use super::columns::PointSource;
use super::falloff::Falloff;
use super::family::rho;
use super::lanes::Vertices;
use crate::geometry::{Point, Vec2};

/// Vertices whose sums fit into registers.
const LANES: usize = 8;
/// Sums over the points.
const SUMS: usize = 12;
/// Affine: the least determinant of the second moments, as a share of the product of both.
const SINGULAR: f64 = 1e-14;
/// Squared distances are at least this, px^2: the nearest point at no distance has the ratio 1 and not 0/0.
const TINY: f64 = f64::MIN_POSITIVE;

/// The input that does not depend on the vertices.
#[derive(Clone, Copy, Debug)]
pub(super) struct MomentInputs<'a> {
    pub(super) points: &'a [PointSource],
    /// Displacements of the points, px.
    pub(super) d: &'a [Vec2],
    pub(super) falloff: Falloff,
    pub(super) method: Method,
}

/// What the nearest point of each vertex is the origin of.
struct Nearest {
    r2: [f64; LANES],
    x: [f64; LANES],
    y: [f64; LANES],
    dx: [f64; LANES],
    dy: [f64; LANES],
}

impl MomentInputs<'_> {
    /// `f(v) - v`, px, and |m| (rigid), else 1. The body of every instruction set's function in `kernel`.
    #[inline(always)]
    pub(super) fn displacements<const N: usize>(&self, v: &Vertices<N>) -> ([[f64; N]; 2], [f64; N]) {
        let (mut moved, mut rotation) = ([[0.0; N]; 2], [1.0; N]);
        for first in (0..N).step_by(LANES) {
            let at = |of: &[f64; N]| std::array::from_fn(|k| of[(first + k).min(N - 1)]);
            let (x, y): ([f64; LANES], [f64; LANES]) = (at(&v.x), at(&v.y));
            let nearest = self.nearest(&x, &y);
            let sums = self.sums(&x, &y, &nearest);
            for k in 0..LANES.min(N - first) {
                let (d, m) = self.fitted(Vec2::new(x[k] - nearest.x[k], y[k] - nearest.y[k]), &sums, k);
                (moved[0][first + k], moved[1][first + k]) = (nearest.dx[k] + d.x, nearest.dy[k] + d.y);
                rotation[first + k] = m;
            }
        }
        (moved, rotation)
    }

    #[inline(always)]
    fn nearest(&self, x: &[f64; LANES], y: &[f64; LANES]) -> Nearest {
        let (mut least, mut index) = ([f64::INFINITY; LANES], [0; LANES]);
        for (PointSource { p, .. }, n) in self.points.iter().zip(0_u64..) {
            let r2 = squared_distances(*p, x, y);
            for k in 0..LANES {
                index[k] = if r2[k] < least[k] { n } else { index[k] };
                least[k] = if r2[k] < least[k] { r2[k] } else { least[k] };
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "an index of the points")]
        let (p, d) = (index.map(|n| self.points[n as usize].p), index.map(|n| self.d[n as usize]));
        Nearest { r2: least, x: p.map(|p| p.x), y: p.map(|p| p.y), dx: d.map(|d| d.x), dy: d.map(|d| d.y) }
    }

    /// The sums of w, w x, w y, w d, w x x, w x y, w y y, w x d, w y d; the nearest point is the origin of positions and displacements.
    #[inline(always)]
    fn sums(&self, x: &[f64; LANES], y: &[f64; LANES], nearest: &Nearest) -> [[f64; LANES]; SUMS] {
        let mut sums = [[0.0; LANES]; SUMS];
        for (PointSource { p, .. }, d) in self.points.iter().zip(self.d) {
            let r2 = squared_distances(*p, x, y);
            let mut w = [0.0; LANES];
            for k in 0..LANES {
                // The nearest point itself has the weight 1, also at no distance.
                w[k] = nearest.r2[k].max(TINY) / r2[k].max(TINY);
            }
            self.falloff.of_lanes(&mut w);
            for k in 0..LANES {
                let (px, py, dx, dy) = (p.x - nearest.x[k], p.y - nearest.y[k], d.x - nearest.dx[k], d.y - nearest.dy[k]);
                let (wx, wy) = (w[k] * px, w[k] * py);
                sums[0][k] += w[k];
                sums[1][k] += wx;
                sums[2][k] += wy;
                sums[3][k] += w[k] * dx;
                sums[4][k] += w[k] * dy;
                sums[5][k] += wx * px;
                sums[6][k] += wx * py;
                sums[7][k] += wy * py;
                sums[8][k] += wx * dx;
                sums[9][k] += wx * dy;
                sums[10][k] += wy * dx;
                sums[11][k] += wy * dy;
            }
        }
        sums
    }

    /// The displacement of vertex k beyond that of its nearest point, from which it lies at `v`; and |m|.
    #[inline(always)]
    fn fitted(&self, v: Vec2, sums: &[[f64; LANES]; SUMS], k: usize) -> (Vec2, f64) {
        let per_weight = 1.0 / sums[0][k];
        let mean = |n: usize| sums[n][k] * per_weight;
        let (p, d) = (Vec2::new(mean(1), mean(2)), Vec2::new(mean(3), mean(4)));
        let e = v - p;
        let (xx, xy, yy) = (mean(5) - p.x * p.x, mean(6) - p.x * p.y, mean(7) - p.y * p.y);
        let (x_d, y_d) = (Vec2::new(mean(8), mean(9)) - d * p.x, Vec2::new(mean(10), mean(11)) - d * p.y);
        if self.method == Method::Affine {
            let determinant = xx * yy - xy * xy;
            if determinant <= SINGULAR * xx * yy {
                return (d, 1.0);
            }
            let (across, down) = ((e.x * yy - e.y * xy) / determinant, (e.y * xx - e.x * xy) / determinant);
            return (d + x_d * across + y_d * down, 1.0);
        }
        let spread = xx + yy;
        if spread <= 0.0 {
            // Only the nearest point has a weight that a number can hold.
            return (d, 1.0);
        }
        let u = Vec2::new(x_d.x + y_d.y, x_d.y - y_d.x) * (1.0 / spread);
        match self.method {
            Method::Rigid => (d + e.complex_mul(rho(u)), (1.0 + u.x).hypot(u.y)),
            Method::Affine | Method::Similarity => (d + e.complex_mul(u), 1.0),
        }
    }
}

#[inline(always)]
fn squared_distances(p: Point, x: &[f64; LANES], y: &[f64; LANES]) -> [f64; LANES] {
    let mut r2 = [0.0; LANES];
    for k in 0..LANES {
        let (to_x, to_y) = (p.x - x[k], p.y - y[k]);
        r2[k] = to_x * to_x + to_y * to_y;
    }
    r2
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::kernel::moments_at;
    use super::super::{Field, Handle, Handles, Pose};
    use super::*;
    use crate::level::Level;

    const METHODS: [Method; 3] = [Method::Affine, Method::Similarity, Method::Rigid];

    fn set(method: Method, alpha: f64, count: u32, seed: u32) -> (Field, Pose) {
        let noise = |k: u32, n: u32| f64::from((k * 4 + n + 977 * seed).wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 24);
        let place = |k: u32| Point::new((500.0 * noise(k, 0)).round(), 400.0 * noise(k, 1));
        let moved = |k: u32| Handle::Point(place(k) + Vec2::new(30.0 * noise(k, 2), 30.0 * noise(k, 3)));
        let rest = Handles::new((0..count).map(|k| Handle::Point(place(k))).collect(), None).unwrap();
        let field = Field::new(rest, method, Falloff::new(alpha, false).unwrap(), 1.0).unwrap();
        let pose = field.pose(&(0..count).map(moved).collect::<Vec<_>>()).unwrap();
        (field, pose)
    }

    fn by_moments(field: &Field, pose: &Pose, places: &[Point; 16], level: Level) -> ([[f64; 16]; 2], [f64; 16]) {
        let mut v = Vertices::all(places[0]);
        for (k, place) in places.iter().enumerate() {
            (v.x[k], v.y[k]) = (place.x, place.y);
        }
        moments_at(level, &field.moments(pose).unwrap(), &v)
    }

    proptest! {
        /// Anywhere, also a hair beside points and far away.
        #[test]
        fn moments_give_what_rows_give(
            method in prop::sample::select(&METHODS[..]),
            alpha in prop::sample::select(&[0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5][..]),
            (count, seed) in (3..40_u32, 0..1000_u32),
            angle in 0.0..std::f64::consts::TAU,
            (x, y) in (-200.0..700.0_f64, -200.0..600.0_f64),
        ) {
            let alpha = if method == Method::Affine { f64::min(alpha, 2.0) } else { alpha };
            let (field, pose) = set(method, alpha, count, seed);
            let Handle::Point(p) = field.handles().handles()[0] else { unreachable!() };
            let near = |r: f64| p + Vec2::new(angle.cos(), angle.sin()) * r;
            let mut places = [Point::new(x, y); 16];
            for (place, exponent) in places[..12].iter_mut().zip(-9..) {
                *place = near(10f64.powi(exponent));
            }
            (places[12], places[13]) = (p, Point::new(x.round(), y));
            for level in Level::available() {
                let ([dx, dy], _) = by_moments(&field, &pose, &places, *level);
                for (k, place) in places.iter().enumerate() {
                    let want = field.map(&pose, *place) - *place;
                    // Far away, affine maps extrapolate.
                    let allowed = 1e-7 * (1.0 + want.norm());
                    let off = (Vec2::new(dx[k], dy[k]) - want).norm();
                    prop_assert!(off <= allowed, "{place:?}: {off} px of {want:?}");
                }
            }
        }
    }

    #[test]
    fn every_level_gives_the_same_bits_and_points_are_met_exactly() {
        for (method, alpha) in METHODS.into_iter().flat_map(|method| [0.5, 1.0, 1.3, 2.0, 8.0].map(|alpha| (method, alpha))) {
            let alpha = if method == Method::Affine { f64::min(alpha, 2.0) } else { alpha };
            let (field, pose) = set(method, alpha, 30, 5);
            let places: [Point; 16] = std::array::from_fn(|k| field.handles().handles()[k].places()[0]);
            let reference = by_moments(&field, &pose, &places, Level::Scalar);
            for (k, d) in pose.displacements()[..16].iter().enumerate() {
                assert_eq!((reference.0[0][k], reference.0[1][k]), (d.x, d.y), "{method:?} {alpha}");
            }
            let beside = places.map(|p| p + Vec2::new(3.1, -0.7));
            let reference = by_moments(&field, &pose, &beside, Level::Scalar);
            for level in Level::available() {
                assert_eq!(by_moments(&field, &pose, &beside, *level), reference, "{level:?} {method:?} {alpha}");
            }
        }
    }
}
