//! Numbers in messages.

use std::fmt;

/// A number with all its digits, and an exponent if it is very large or very small: `1e300` has 300
/// digits otherwise.
///
/// ```
/// use mlswarp::geometry::DisplayNumber;
/// assert_eq!(DisplayNumber(0.25).to_string(), "0.25");
/// assert_eq!(DisplayNumber(1e300).to_string(), "1e300");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct DisplayNumber(pub f64);

impl fmt::Display for DisplayNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(number) = self;
        if *number == 0.0 || !number.is_finite() || (1e-5..1e7).contains(&number.abs()) {
            write!(f, "{number}")
        } else {
            write!(f, "{number:e}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_exact_and_short() {
        for (number, text) in [
            (0.0, "0"),
            (0.499_999, "0.499999"),
            (-1_000_000.5, "-1000000.5"),
            (1e7, "1e7"),
            (-1.25e300, "-1.25e300"),
            (1e-5, "0.00001"),
            (3e-320, "3e-320"),
            (f64::INFINITY, "inf"),
            (f64::NAN, "NaN"),
        ] {
            assert_eq!(DisplayNumber(number).to_string(), text);
        }
    }
}
