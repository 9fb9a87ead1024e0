//! Moments of a segment in closed form for a general alpha. With u along the line from the foot of
//! v and D = u^2 + h^2, the integral of D^-alpha is an incomplete beta function, from the foot (|u|
//! < h) or from infinity (|u| >= h):
//!
//! - `h^(1 - 2 alpha) u / sqrt(D) F(1/2, 3/2 - alpha; 3/2; u^2 / D)`
//! - `u D^-alpha F(1, alpha; alpha + 1/2; h^2 / D) / (2 alpha - 1)`
//!
//! Both arguments are at most 1/2, where the hypergeometric functions F are polynomials to 1e-14,
//! fitted once per alpha. The first and the second moment follow from powers at the ends. Lengths
//! are those of the segment.

use super::falloff::Falloff;
use crate::geometry::lane_math::pow;

/// Coefficients of a polynomial: the functions are singular at 1, so those of Chebyshev polynomials
/// on [0, 1/2] fall by 5.8 each.
const CHEBYSHEV_TERMS: usize = 18;
/// The positive Chebyshev nodes, `cos((2 k + 1) pi / 36)`.
const CHEBYSHEV_NODES: [f64; CHEBYSHEV_TERMS / 2] = [
    0.996_194_698_091_745_5,
    0.965_925_826_289_068_3,
    0.906_307_787_036_649_9,
    0.819_152_044_288_991_8,
    std::f64::consts::FRAC_1_SQRT_2,
    0.573_576_436_351_046,
    0.422_618_261_740_699_44,
    0.258_819_045_102_520_74,
    0.087_155_742_747_658_17,
];
/// The least distance of 2 alpha from 1, 2 and 3, where a moment becomes a logarithm: at it, three
/// of 16 digits cancel.
const FROM_LOGARITHM: f64 = 1e-3;

/// The functions of one alpha.
#[derive(Clone, Debug)]
pub(in crate::deform) struct IncompleteBeta {
    alpha: f64,
    /// Polynomials in `4 y - 1`.
    from_foot: [f64; CHEBYSHEV_TERMS],
    from_infinity: [f64; CHEBYSHEV_TERMS],
    /// The integral from the foot to infinity, for h = 1.
    total: f64,
}

/// Segments relative to N vertices.
pub(in crate::deform) struct RelativeSegments<'a, const N: usize> {
    /// The foot coordinates of the ends and of the position nearest to v, lengths.
    pub(in crate::deform) ends: [[f64; N]; 2],
    pub(in crate::deform) nearest: &'a [f64; N],
    /// Distance from the line, lengths.
    pub(in crate::deform) h: [f64; N],
    /// r2min in squared lengths.
    pub(in crate::deform) ratio: [f64; N],
}

impl IncompleteBeta {
    /// `None` if the moments need a logarithm.
    pub(in crate::deform) fn new(alpha: f64) -> Option<Self> {
        if [1.0, 2.0, 3.0]
            .iter()
            .any(|pole| (2.0 * alpha - pole).abs() < FROM_LOGARITHM)
            || alpha < 0.5
        {
            return None;
        }
        let from_foot = fitted(|y| hypergeometric(0.5, 1.5 - alpha, 1.5, y));
        let from_infinity =
            fitted(|y| hypergeometric(1.0, alpha, alpha + 0.5, y) / (2.0 * alpha - 1.0));
        // Both parts at u = h = 1.
        let total = 0.5_f64.sqrt() * polynomial(&from_foot, 1.0)
            + pow(0.5, alpha) * polynomial(&from_infinity, 1.0);
        Some(Self {
            alpha,
            from_foot,
            from_infinity,
            total,
        })
    }

    /// `sum w y^m`, m = 0, 1, 2, with density 1, y from the nearest position; weights relative to
    /// r2min's.
    #[inline(always)]
    pub(in crate::deform) fn moments<const N: usize>(
        &self,
        along: &RelativeSegments<'_, N>,
        falloff: Falloff,
    ) -> [[f64; N]; 3] {
        let RelativeSegments {
            ends: [a, b],
            nearest,
            h,
            ratio,
        } = along;
        // The integral to an end at `|u| >= h` contains the one from the foot to infinity. Where v
        // is beyond an end, at `|nearest| >= h`, both integrals do, and both leave it out: near the
        // extension it exceeds their difference by so much that nothing would be left.
        let mut common = [0.0; N];
        for k in 0..N {
            common[k] = ratio[k] / (h[k] * h[k]);
            common[k] = if nearest[k].abs() < h[k] {
                common[k]
            } else {
                0.0
            };
        }
        falloff.of_lanes(&mut common);
        for k in 0..N {
            common[k] *= h[k];
        }
        let ([a0, a1, a2], [b0, b1, b2]) = (
            self.up_to(a, &common, along, falloff),
            self.up_to(b, &common, along, falloff),
        );
        let (per_first, per_second) = (
            1.0 / (2.0 - 2.0 * self.alpha),
            1.0 / (3.0 - 2.0 * self.alpha),
        );
        let mut m = [[0.0; N]; 3];
        for k in 0..N {
            let i0 = b0[k] - a0[k];
            let i1 = (b1[k] - a1[k]) * per_first;
            let i2 = ((b2[k] - a2[k]) - h[k] * h[k] * i0) * per_second;
            m[0][k] = i0;
            m[1][k] = i1 - nearest[k] * i0;
            m[2][k] = i2 - nearest[k] * (2.0 * i1 - nearest[k] * i0);
        }
        m
    }

    /// The integral of w from the foot to u, without the one from the foot to infinity where
    /// `common` is 0; `D w` and `u D w`.
    #[inline(always)]
    fn up_to<const N: usize>(
        &self,
        u: &[f64; N],
        common: &[f64; N],
        along: &RelativeSegments<'_, N>,
        falloff: Falloff,
    ) -> [[f64; N]; 3] {
        let RelativeSegments { h, ratio, .. } = along;
        let (mut d, mut w, mut integral) = ([0.0; N], [0.0; N], [0.0; N]);
        for k in 0..N {
            d[k] = u[k] * u[k] + h[k] * h[k];
            w[k] = ratio[k] / d[k];
        }
        falloff.of_lanes(&mut w);
        for k in 0..N {
            let is_near = u[k].abs() < h[k];
            let y = (if is_near { u[k] * u[k] } else { h[k] * h[k] }) / d[k];
            let s = 4.0 * y - 1.0;
            let (near, far) = (
                polynomial(&self.from_foot, s),
                polynomial(&self.from_infinity, s),
            );
            let near = common[k] * (u[k].abs() / d[k].sqrt()) * near;
            let far = common[k] * self.total - u[k].abs() * w[k] * far;
            let size = if is_near { near } else { far };
            integral[k] = if u[k] < 0.0 { -size } else { size };
        }
        for k in 0..N {
            d[k] *= w[k];
            w[k] = u[k] * d[k];
        }
        [integral, d, w]
    }
}

#[inline(always)]
fn polynomial(coefficients: &[f64; CHEBYSHEV_TERMS], x: f64) -> f64 {
    let mut sum = coefficients[CHEBYSHEV_TERMS - 1];
    for k in (0..CHEBYSHEV_TERMS - 1).rev() {
        sum = sum * x + coefficients[k];
    }
    sum
}

/// F(a, b; c; y) for 0 <= y <= 1/2 by its series.
fn hypergeometric(a: f64, b: f64, c: f64, y: f64) -> f64 {
    let (mut sum, mut term) = (1.0, 1.0);
    for k in 0..64 {
        let k = f64::from(k);
        term *= (a + k) * (b + k) / ((c + k) * (1.0 + k)) * y;
        sum += term;
    }
    sum
}

/// The polynomial in `x = 4 y - 1` that equals a function of y at the Chebyshev nodes of [0, 1/2].
fn fitted(function: impl Fn(f64) -> f64) -> [f64; CHEBYSHEV_TERMS] {
    let nodes: [f64; CHEBYSHEV_TERMS] = std::array::from_fn(|k| {
        if k < CHEBYSHEV_TERMS / 2 {
            CHEBYSHEV_NODES[k]
        } else {
            -CHEBYSHEV_NODES[CHEBYSHEV_TERMS - 1 - k]
        }
    });
    let values = nodes.map(|x| function(0.25 * (1.0 + x)));
    let mut sum = [0.0; CHEBYSHEV_TERMS];
    // T_n at the nodes, and its coefficients; T_(-1) is T_1.
    let mut unit = [0.0; CHEBYSHEV_TERMS];
    unit[0] = 1.0;
    let (mut at, mut before) = ([1.0; CHEBYSHEV_TERMS], nodes);
    let (mut t, mut t_before) = (unit, [0.0; CHEBYSHEV_TERMS]);
    t_before[1] = 1.0;
    for n in 0..CHEBYSHEV_TERMS {
        let product: f64 = values.iter().zip(&at).map(|(value, t)| value * t).sum();
        let share = product / CHEBYSHEV_TERMS as f64 * if n == 0 { 1.0 } else { 2.0 };
        for (sum, t) in sum.iter_mut().zip(&t) {
            *sum += share * t;
        }
        let next = std::array::from_fn(|k| 2.0 * nodes[k] * at[k] - before[k]);
        let t_next =
            std::array::from_fn(|k| if k == 0 { 0.0 } else { 2.0 * t[k - 1] } - t_before[k]);
        (before, at, t_before, t) = (at, next, t, t_next);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_hypergeometric_functions() {
        for alpha in [0.51, 0.6, 0.75, 1.01, 1.3, 1.4, 1.6, 2.0, 2.7, 4.0, 8.0] {
            let beta = IncompleteBeta::new(alpha).unwrap();
            for k in 0..=100 {
                let y = f64::from(k) / 200.0;
                let near = (
                    polynomial(&beta.from_foot, 4.0 * y - 1.0),
                    hypergeometric(0.5, 1.5 - alpha, 1.5, y),
                );
                let far = (
                    polynomial(&beta.from_infinity, 4.0 * y - 1.0),
                    hypergeometric(1.0, alpha, alpha + 0.5, y) / (2.0 * alpha - 1.0),
                );
                for (got, want) in [near, far] {
                    assert!(
                        (got - want).abs() <= 3e-14 * want.abs(),
                        "alpha {alpha}, y {y}: {got} against {want}"
                    );
                }
            }
        }
    }

    #[test]
    fn alphas_of_logarithms_have_none() {
        assert!(
            [0.5, 1.0, 1.5, 1.0001]
                .iter()
                .all(|alpha| IncompleteBeta::new(*alpha).is_none())
        );
        assert!(
            [0.51, 2.0, 2.5, 8.0]
                .iter()
                .all(|alpha| IncompleteBeta::new(*alpha).is_some())
        );
    }

    /// Alpha 2: the integral from the foot to infinity is pi/4, and 2/3 for alpha 5/2.
    #[test]
    fn totals_are_known() {
        assert!(
            (IncompleteBeta::new(2.0).unwrap().total - std::f64::consts::FRAC_PI_4).abs() < 1e-14
        );
        assert!((IncompleteBeta::new(2.5).unwrap().total - 2.0 / 3.0).abs() < 1e-14);
    }
}
