//! From the sums over all points at a few vertices to the displacements there: equations (5) to (8)
//! of means and second moments.

use crate::deform::form::MotionLanes;
use crate::geometry::Vec2;

/// Sums over the points: of w, w p, w d, and the second moments that similarities and affine maps
/// need.
pub(super) const SIMILARITY_SUMS: usize = 8;
pub(super) const AFFINE_SUMS: usize = 12;
/// The largest ratio of the moment about the origin to that about p*, and the largest product of it
/// and |v - p*|, px, at which the sums about the origin are used: they are precise to about 1e-15.
const MOST_CANCELLED: f64 = 1e12;
const MOST_CANCELLED_PX: f64 = 3e7;

/// What the weight of a point at `p` with the displacement `d` is multiplied by: 1, p, d, |p|^2,
/// conj(p) d.
pub(super) fn similarity_factors(p: Vec2, d: Vec2) -> [f64; SIMILARITY_SUMS] {
    [1.0, p.x, p.y, d.x, d.y, p.norm2(), p.dot(d), p.cross(d)]
}

/// 1, p, d, x x, x y, y y, x d, y d.
pub(super) fn affine_factors(p: Vec2, d: Vec2) -> [f64; AFFINE_SUMS] {
    let [px, py] = [d * p.x, d * p.y];
    let [xx, xy, yy] = [p.x * p.x, p.x * p.y, p.y * p.y];
    [1.0, p.x, p.y, d.x, d.y, xx, xy, yy, px.x, px.y, py.x, py.y]
}

/// How some vertices move beyond the common displacement, and whether the sums were precise.
pub(super) struct FittedLanes<const N: usize> {
    pub(super) motion: MotionLanes<N>,
    pub(super) is_precise: [bool; N],
}

/// Sums from which vertices at some positions, from the origin, are displaced.
pub(super) trait FittedSums<const N: usize> {
    fn fitted(&self, x: &[f64; N], y: &[f64; N]) -> FittedLanes<N>;
}

/// The means of one vertex, by weight, from some origin.
pub(super) struct Means {
    pub(super) p: Vec2,
    pub(super) d: Vec2,
    /// Second moments about p: of x x, x y, y y, x d, y d.
    pub(super) xx: f64,
    pub(super) xy: f64,
    pub(super) yy: f64,
    pub(super) x_d: Vec2,
    pub(super) y_d: Vec2,
}

impl Means {
    #[inline(always)]
    pub(super) fn of<const LANES: usize>(sums: &[[f64; LANES]; AFFINE_SUMS], k: usize) -> Self {
        let per_weight = 1.0 / sums[0][k];
        let mean = |n: usize| sums[n][k] * per_weight;
        let (p, d) = (Vec2::new(mean(1), mean(2)), Vec2::new(mean(3), mean(4)));
        let (xx, xy, yy) = (
            mean(5) - p.x * p.x,
            mean(6) - p.x * p.y,
            mean(7) - p.y * p.y,
        );
        Self {
            p,
            d,
            xx,
            xy,
            yy,
            x_d: Vec2::new(mean(8), mean(9)) - d * p.x,
            y_d: Vec2::new(mean(10), mean(11)) - d * p.y,
        }
    }

    #[inline(always)]
    pub(super) fn determinant(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// The affine map at e, beyond e.
    #[inline(always)]
    pub(super) fn affine(&self, e: Vec2) -> Vec2 {
        let determinant = self.determinant();
        let (across, down) = (
            (e.x * self.yy - e.y * self.xy) / determinant,
            (e.y * self.xx - e.x * self.xy) / determinant,
        );
        self.d + self.x_d * across + self.y_d * down
    }
}

impl<const N: usize> FittedSums<N> for [[f64; N]; SIMILARITY_SUMS] {
    #[inline(always)]
    fn fitted(&self, x: &[f64; N], y: &[f64; N]) -> FittedLanes<N> {
        let (mut motion, mut precise) = (MotionLanes::ZERO, [false; N]);
        for k in 0..N {
            let per_weight = 1.0 / self[0][k];
            let (px, py) = (self[1][k] * per_weight, self[2][k] * per_weight);
            let (dx, dy) = (self[3][k] * per_weight, self[4][k] * per_weight);
            let (ex, ey) = (x[k] - px, y[k] - py);
            let about_origin = self[5][k] * per_weight;
            let spread = about_origin - (px * px + py * py);
            let per_spread = 1.0 / spread;
            (motion.d[0][k], motion.d[1][k]) = (dx, dy);
            (motion.e[0][k], motion.e[1][k]) = (ex, ey);
            motion.u[0][k] = (self[6][k] * per_weight - (px * dx + py * dy)) * per_spread;
            motion.u[1][k] = (self[7][k] * per_weight - (px * dy - py * dx)) * per_spread;
            precise[k] = is_precise((ex * ex + ey * ey).sqrt(), about_origin, spread);
        }
        FittedLanes {
            motion,
            is_precise: precise,
        }
    }
}

impl<const N: usize> FittedSums<N> for [[f64; N]; AFFINE_SUMS] {
    #[inline(always)]
    fn fitted(&self, x: &[f64; N], y: &[f64; N]) -> FittedLanes<N> {
        let (mut motion, mut precise) = (MotionLanes::ZERO, [false; N]);
        for k in 0..N {
            let means = Means::of(self, k);
            let e = Vec2::new(x[k], y[k]) - means.p;
            let about_origin = (self[5][k] + self[7][k]) / self[0][k];
            let least = means.determinant() / (means.xx + means.yy);
            precise[k] = is_precise(e.norm2().sqrt(), about_origin, least);
            let d = means.affine(e);
            (motion.d[0][k], motion.d[1][k]) = (d.x, d.y);
        }
        FittedLanes {
            motion,
            is_precise: precise,
        }
    }
}

/// Whether a second moment about p* is the precise difference of one about the origin; false for
/// NaN. `reach`: |v - p*|, px.
#[inline(always)]
fn is_precise(reach: f64, about_origin: f64, spread: f64) -> bool {
    spread * MOST_CANCELLED > about_origin && spread * MOST_CANCELLED_PX > about_origin * reach
}
