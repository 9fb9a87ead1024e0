//! From the sums over all points at a few vertices to the displacements there: equations (5) to (8)
//! of means and second moments.

use crate::deform::form::{CoefficientForm, UNDEFINED_ROTATION};
use crate::deform::tiles::TILE_LANES;
use crate::geometry::Vec2;

/// Sums over the points: of w, w p, w d, and the second moments that similarities and affine maps
/// need.
pub(super) const SIMILARITY_SUMS: usize = 8;
pub(super) const AFFINE_SUMS: usize = 12;
/// The largest ratio of the moment about the origin to that about p*, and the largest product of it
/// and |v - p*|, px, at which the sums about the origin are used: they are precise to about 1e-15.
const MOST_CANCELLED: f64 = 1e12;
const MOST_CANCELLED_PX: f64 = 3e7;

/// The displacements of some vertices beyond the common one, |m| (rigid) or 1, and whether the sums
/// were precise.
pub(super) struct FittedLanes {
    pub(super) x: [f64; TILE_LANES],
    pub(super) y: [f64; TILE_LANES],
    pub(super) m: [f64; TILE_LANES],
    pub(super) is_precise: [bool; TILE_LANES],
}

/// Sums from which vertices at some positions, from the origin, are displaced.
pub(super) trait FittedSums {
    fn fitted(
        &self,
        form: CoefficientForm,
        x: &[f64; TILE_LANES],
        y: &[f64; TILE_LANES],
    ) -> FittedLanes;
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

    pub(super) fn determinant(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// The affine map at e, beyond e.
    pub(super) fn affine(&self, e: Vec2) -> Vec2 {
        let determinant = self.determinant();
        let (across, down) = (
            (e.x * self.yy - e.y * self.xy) / determinant,
            (e.y * self.xx - e.x * self.xy) / determinant,
        );
        self.d + self.x_d * across + self.y_d * down
    }
}

impl FittedSums for [[f64; TILE_LANES]; SIMILARITY_SUMS] {
    #[inline(always)]
    fn fitted(
        &self,
        form: CoefficientForm,
        x: &[f64; TILE_LANES],
        y: &[f64; TILE_LANES],
    ) -> FittedLanes {
        let mut fitted = FittedLanes {
            x: [0.0; TILE_LANES],
            y: [0.0; TILE_LANES],
            m: [1.0; TILE_LANES],
            is_precise: [false; TILE_LANES],
        };
        for k in 0..TILE_LANES {
            let per_weight = 1.0 / self[0][k];
            let (px, py) = (self[1][k] * per_weight, self[2][k] * per_weight);
            let (dx, dy) = (self[3][k] * per_weight, self[4][k] * per_weight);
            let (ex, ey) = (x[k] - px, y[k] - py);
            let about_origin = self[5][k] * per_weight;
            let spread = about_origin - (px * px + py * py);
            let per_spread = 1.0 / spread;
            let (ux, uy) = (
                (self[6][k] * per_weight - (px * dx + py * dy)) * per_spread,
                (self[7][k] * per_weight - (px * dy - py * dx)) * per_spread,
            );
            fitted.is_precise[k] = is_precise((ex * ex + ey * ey).sqrt(), about_origin, spread);
            // rho(u) of mathematics 2.3 without a branch, as in `kernel/scalar.rs`.
            let mx = 1.0 + ux;
            let n = (mx * mx + uy * uy).sqrt();
            let is_ahead = mx > 0.0;
            let more = if is_ahead { n + mx } else { 1.0 };
            let over = if is_ahead { -(uy * uy) } else { mx - n };
            let is_defined = n >= UNDEFINED_ROTATION;
            let (re, im) = (
                if is_defined { over / (more * n) } else { 0.0 },
                if is_defined { uy / n } else { 0.0 },
            );
            let is_rigid = matches!(form, CoefficientForm::Rigid);
            let (re, im) = if is_rigid { (re, im) } else { (ux, uy) };
            fitted.m[k] = if is_rigid { n } else { 1.0 };
            fitted.x[k] = dx + (ex * re - ey * im);
            fitted.y[k] = dy + (ex * im + ey * re);
        }
        fitted
    }
}

impl FittedSums for [[f64; TILE_LANES]; AFFINE_SUMS] {
    #[inline(always)]
    fn fitted(
        &self,
        _: CoefficientForm,
        x: &[f64; TILE_LANES],
        y: &[f64; TILE_LANES],
    ) -> FittedLanes {
        let mut fitted = FittedLanes {
            x: [0.0; TILE_LANES],
            y: [0.0; TILE_LANES],
            m: [1.0; TILE_LANES],
            is_precise: [false; TILE_LANES],
        };
        for k in 0..TILE_LANES {
            let means = Means::of(self, k);
            let e = Vec2::new(x[k], y[k]) - means.p;
            let about_origin = (self[5][k] + self[7][k]) / self[0][k];
            let least = means.determinant() / (means.xx + means.yy);
            fitted.is_precise[k] = is_precise(e.norm2().sqrt(), about_origin, least);
            let d = means.affine(e);
            (fitted.x[k], fitted.y[k]) = (d.x, d.y);
        }
        fitted
    }
}

/// Whether a second moment about p* is the precise difference of one about the origin; false for
/// NaN. `reach`: |v - p*|, px.
#[inline(always)]
fn is_precise(reach: f64, about_origin: f64, spread: f64) -> bool {
    spread * MOST_CANCELLED > about_origin && spread * MOST_CANCELLED_PX > about_origin * reach
}
