//! The fall-off `w = |p - v|^(-2 alpha)`, always computed as a power of a ratio of squared distances, so that it never overflows.

use super::DeformError;
use super::lane_math::pow;

/// The validated exponent alpha: `0 < alpha <= 8`, and at least 1/2 with lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Falloff {
    alpha: f64,
    power: Power,
}

/// Powers that need only multiplications and roots; all others need a logarithm and an exponential.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Power {
    Half,
    One,
    OneAndHalf,
    Two,
    Three,
    Other,
}

/// Largest exponent.
const MOST: f64 = 8.0;
/// Below this exponent a line is not interpolated (mathematics section 3.4).
const LEAST_WITH_LINES: f64 = 0.5;

impl Falloff {
    /// Validates the exponent.
    ///
    /// # Errors
    /// [`DeformError::AlphaOutOfRange`], also for NaN.
    pub fn new(alpha: f64, lines: bool) -> Result<Self, DeformError> {
        if !(alpha > 0.0 && alpha <= MOST) || lines && alpha < LEAST_WITH_LINES {
            return Err(DeformError::AlphaOutOfRange { alpha, lines });
        }
        let power = match alpha {
            0.5 => Power::Half,
            1.0 => Power::One,
            1.5 => Power::OneAndHalf,
            2.0 => Power::Two,
            3.0 => Power::Three,
            _ => Power::Other,
        };
        Ok(Self { alpha, power })
    }

    /// The default: 1 for points alone, 2 with any line (a line's crease at alpha 1 is visible).
    #[must_use]
    pub fn default_alpha(lines: bool) -> f64 {
        if lines { 2.0 } else { 1.0 }
    }

    /// The exponent.
    #[must_use]
    pub const fn alpha(self) -> f64 {
        self.alpha
    }

    pub(super) const fn power(self) -> Power {
        self.power
    }

    /// Replaces every ratio in [0, 1] by `ratio^alpha`.
    #[inline(always)]
    pub(super) fn of_lanes<const N: usize>(self, ratios: &mut [f64; N]) {
        match self.power {
            Power::Half => each(ratios, f64::sqrt),
            Power::One => {}
            Power::OneAndHalf => each(ratios, |r| r * r.sqrt()),
            Power::Two => each(ratios, |r| r * r),
            Power::Three => each(ratios, |r| r * r * r),
            Power::Other => each(ratios, |r| pow(r, self.alpha)),
        }
    }
}

#[inline(always)]
fn each<const N: usize>(ratios: &mut [f64; N], power: impl Fn(f64) -> f64) {
    for r in ratios {
        *r = power(*r);
    }
}
