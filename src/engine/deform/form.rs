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
            let shift = rows
                .wn
                .iter()
                .zip(d)
                .fold(Vec2::ZERO, |sum, (wn, d)| sum + *d * wn[k]);
            Vec2::new(rows.e[0][k], rows.e[1][k]).complex_mul(rho(pull(rows, k, d))) + shift
        }
    }
}

/// `sum H_j d_j` (rigid: u) or `sum C_j d_j` (similarity).
fn pull<const N: usize>(rows: &Coefficients<N>, k: usize, d: &[Vec2]) -> Vec2 {
    rows.h.iter().zip(d).fold(Vec2::ZERO, |sum, (h, d)| {
        sum + Vec2::new(h[0][k], h[1][k]).complex_mul(*d)
    })
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
