//! The forms of coefficients: maps in displacement form (mathematics 2.3),
//! `f(v) = v + sum C_j d_j`, and for rigid `v + e rho(u) + sum wn_j d_j` with `u = sum H_j d_j`.
//! Identity is exact: d = 0 gives f = v bit for bit.

use super::lanes::Coefficients;
use crate::geometry::Vec2;
use crate::geometry::lane_math::hypot;

/// What the coefficients of a position are, and how they make f of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CoefficientForm {
    /// A real number for each vector: `sum C_j d_j`.
    Real,
    /// A complex number for each vector: `sum C_j d_j`.
    Complex,
    /// Complex and real ones, and a vector: `e rho(sum H_j d_j) + sum wn_j d_j`.
    Rigid,
}

/// Below this |m| the rotation is undefined (f64).
pub(super) const UNDEFINED_ROTATION: f64 = 1e-9;

/// `f(v) - v` of vertex `k` of the rows, px.
pub(super) fn displacement<const N: usize>(
    form: CoefficientForm,
    rows: &Coefficients<N>,
    k: usize,
    d: &[Vec2],
) -> Vec2 {
    match form {
        CoefficientForm::Real => rows
            .h
            .iter()
            .zip(d)
            .fold(Vec2::ZERO, |sum, (c, d)| sum + *d * c[0][k]),
        CoefficientForm::Complex => pull(rows, k, d),
        CoefficientForm::Rigid => {
            let [shift, e, u] = rigid_motion(rows, k, d);
            e.complex_mul(rho(u)) + shift
        }
    }
}

/// d, e and u of [`MotionLanes`], of vertex `k` of the rows of a rigid map.
pub(super) fn rigid_motion<const N: usize>(
    rows: &Coefficients<N>,
    k: usize,
    d: &[Vec2],
) -> [Vec2; 3] {
    let shares = rows.wn.iter().zip(d);
    let shift = shares.fold(Vec2::ZERO, |sum, (wn, d)| sum + *d * wn[k]);
    let e = Vec2::new(rows.e[0][k], rows.e[1][k]);
    [shift, e, pull(rows, k, d)]
}

/// `sum H_j d_j` (rigid: u) or `sum C_j d_j` (similarity).
fn pull<const N: usize>(rows: &Coefficients<N>, k: usize, d: &[Vec2]) -> Vec2 {
    rows.h.iter().zip(d).fold(Vec2::ZERO, |sum, (h, d)| {
        sum + Vec2::new(h[0][k], h[1][k]).complex_mul(*d)
    })
}

/// f of N vertices as a function of the share s that the handles have gone of their ways:
/// `f(v) = v + s d + e rho(s u)`; of similarities `v + s d + s e u`.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionLanes<const N: usize> {
    pub(super) d: [[f64; N]; 2],
    pub(super) e: [[f64; N]; 2],
    pub(super) u: [[f64; N]; 2],
}

impl<const N: usize> MotionLanes<N> {
    pub(super) const ZERO: Self = Self {
        d: [[0.0; N]; 2],
        e: [[0.0; N]; 2],
        u: [[0.0; N]; 2],
    };

    /// Replaces a lane by d, e and u.
    pub(super) fn put(&mut self, lane: usize, [d, e, u]: [Vec2; 3]) {
        for (lanes, v) in [(&mut self.d, d), (&mut self.e, e), (&mut self.u, u)] {
            (lanes[0][lane], lanes[1][lane]) = (v.x, v.y);
        }
    }

    /// `f(v) - v`, px, and |m| (rigid), else 1.
    #[inline(always)]
    pub(super) fn at(&self, form: CoefficientForm, share: f64) -> ([[f64; N]; 2], [f64; N]) {
        let (mut x, mut y, mut m) = ([0.0; N], [0.0; N], [1.0; N]);
        let is_rigid = form == CoefficientForm::Rigid;
        for k in 0..N {
            let (ux, uy) = (share * self.u[0][k], share * self.u[1][k]);
            let (ex, ey) = (self.e[0][k], self.e[1][k]);
            if !is_rigid {
                x[k] = share * self.d[0][k] + (ex * ux - ey * uy);
                y[k] = share * self.d[1][k] + (ex * uy + ey * ux);
                continue;
            }
            // rho(u) without a branch, as in `kernel/scalar.rs`.
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
            m[k] = n;
            x[k] = share * self.d[0][k] + (ex * re - ey * im);
            y[k] = share * self.d[1][k] + (ex * im + ey * re);
        }
        ([x, y], m)
    }
}

/// The length |m| of the fitted rotation for rigid, 1 for the other families; near 0 all
/// rotations fit equally.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a quality number, compared with 0.1"
)]
pub(super) fn rotation<const N: usize>(
    form: CoefficientForm,
    rows: &Coefficients<N>,
    k: usize,
    d: &[Vec2],
) -> f32 {
    match form {
        CoefficientForm::Real | CoefficientForm::Complex => 1.0,
        CoefficientForm::Rigid => {
            let u = pull(rows, k, d);
            hypot(1.0 + u.x, u.y) as f32
        }
    }
}

/// `(1 + u)/|1 + u| - 1`, exact at 0 and without cancellation for small u; 0 where `1 + u` vanishes
/// and all rotations fit equally.
pub(super) fn rho(u: Vec2) -> Vec2 {
    let n = hypot(1.0 + u.x, u.y);
    if n < UNDEFINED_ROTATION {
        return Vec2::ZERO;
    }
    let re = if 1.0 + u.x > 0.0 {
        -u.y * (u.y / (1.0 + u.x + n))
    } else {
        1.0 + u.x - n
    };
    Vec2::new(re / n, u.y / n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rho_turns_by_the_angle_of_one_plus_u_at_every_size() {
        assert_eq!(rho(Vec2::ZERO), Vec2::ZERO);
        assert_eq!(rho(Vec2::new(-1.0, 0.0)), Vec2::ZERO);
        for exponent in -300..=300 {
            let size = 10f64.powi(exponent);
            for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.3), (0.7, -0.7)] {
                let u = Vec2::new(x * size, y * size);
                let r = rho(u);
                assert!(r.x.is_finite() && r.y.is_finite());
                let turned = Vec2::new(1.0 + r.x, r.y);
                assert!(
                    (turned.norm() - 1.0).abs() < 1e-12,
                    "|1 + rho({u:?})| = {}",
                    turned.norm()
                );
                let sine =
                    Vec2::new(1.0 + u.x, u.y).cross(turned) / Vec2::new(1.0 + u.x, u.y).norm();
                assert!(sine.abs() < 1e-12);
            }
        }
    }
}
