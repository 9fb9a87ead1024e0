//! The fall-off `w = |p - v|^(-2 alpha)`, always computed as a power of a ratio of squared
//! distances, so that it never overflows.

use crate::deform::DeformError;
use crate::geometry::lane_math::pow;

/// The validated exponent alpha: `0 < alpha <= 8`, and at least 1/2 with lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Falloff {
    alpha: f64,
    power: Power,
}

/// Powers that need only multiplications and roots; all others need a logarithm and an exponential.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::deform) enum Power {
    Half,
    One,
    OneAndHalf,
    Two,
    Three,
    Other,
}

/// Largest exponent.
const MAX_EXPONENT: f64 = 8.0;
/// Powers of smaller squared distances may exceed the numbers, px^2.
const NO_DISTANCE: f64 = 1e-30;
/// Below this exponent a line is not interpolated (mathematics section 3.4).
const LEAST_WITH_LINES: f64 = 0.5;

impl Falloff {
    /// Validates the exponent.
    ///
    /// # Errors
    /// [`DeformError::AlphaOutOfRange`], also for NaN.
    ///
    /// ```
    /// use mlswarp::deform::Falloff;
    /// assert!(Falloff::new(1.5, true).is_ok());
    /// // With lines, a smaller exponent would not interpolate.
    /// assert!(Falloff::new(0.4, true).is_err());
    /// ```
    pub fn new(alpha: f64, lines: bool) -> Result<Self, DeformError> {
        if !(alpha > 0.0 && alpha <= MAX_EXPONENT) || lines && alpha < LEAST_WITH_LINES {
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

    pub(in crate::deform) const fn power(self) -> Power {
        self.power
    }

    /// Replaces every squared distance, px^2, by the weight of a unit mass at it; infinite at no
    /// distance.
    #[cfg_attr(not(optimized_for_size), inline(always))]
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(in crate::deform) fn apply_to_squared(self, squares: &mut [f64]) {
        match self.power {
            Power::Half => {
                for r2 in squares {
                    *r2 = 1.0 / r2.sqrt();
                }
            }
            Power::One => {
                for r2 in squares {
                    *r2 = 1.0 / *r2;
                }
            }
            Power::OneAndHalf => {
                for r2 in squares {
                    *r2 = 1.0 / (*r2 * r2.sqrt());
                }
            }
            Power::Two => {
                for r2 in squares {
                    *r2 = 1.0 / (*r2 * *r2);
                }
            }
            Power::Three => {
                for r2 in squares {
                    *r2 = 1.0 / (*r2 * *r2 * *r2);
                }
            }
            Power::Other => {
                for r2 in squares {
                    let power = pow(1.0 / *r2, self.alpha);
                    *r2 = if *r2 < NO_DISTANCE {
                        f64::INFINITY
                    } else {
                        power
                    };
                }
            }
        }
    }

    /// Replaces every ratio in [0, 1] by `ratio^alpha`.
    #[inline(always)]
    pub(in crate::deform) fn of_lanes<const N: usize>(self, ratios: &mut [f64; N]) {
        // A loop per power: one loop around the match is not vectorised on AVX2.
        match self.power {
            Power::Half => {
                for r in ratios {
                    *r = r.sqrt();
                }
            }
            Power::One => {}
            Power::OneAndHalf => {
                for r in ratios {
                    *r *= r.sqrt();
                }
            }
            Power::Two => {
                for r in ratios {
                    *r *= *r;
                }
            }
            Power::Three => {
                for r in ratios {
                    *r = *r * *r * *r;
                }
            }
            Power::Other => {
                for r in ratios {
                    *r = pow(*r, self.alpha);
                }
            }
        }
    }
}
