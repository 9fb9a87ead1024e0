//! Numbers: text to f64 (correctly rounded) and to whole numbers.

use std::ops::RangeInclusive;

use mlswarp::geometry::DisplayNumber;

use super::json::{Kind, Node};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};

/// 2^53: above it an f64 does not name one whole number.
const MAX_WHOLE: f64 = 9_007_199_254_740_992.0;

/// A finite number. `expected` describes it in problems.
pub(crate) fn number(node: &Node<'_, '_>, expected: &str) -> Result<f64, Problem> {
    if node.kind() != Kind::Number {
        return Err(node.wrong_kind(expected));
    }
    let value: f64 = node.text.parse().map_err(|_| {
        node.problem(
            Code::BadValue,
            format!("not a number: {}", quote(node.text)),
        )
    })?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(node.problem(
            Code::NotFinite,
            format!(
                "the number exceeds the range of a 64-bit float: {}",
                quote(node.text)
            ),
        ))
    }
}

/// A number above zero.
pub(crate) fn positive(node: &Node<'_, '_>, expected: &str) -> Result<f64, Problem> {
    let value = number(node, expected)?;
    if value > 0.0 {
        Ok(value)
    } else {
        Err(node
            .unexpected(expected, DisplayNumber(value))
            .actual(value))
    }
}

/// A number in a range.
pub(crate) fn number_in(
    node: &Node<'_, '_>,
    range: RangeInclusive<f64>,
    expected: &str,
) -> Result<f64, Problem> {
    let value = number(node, expected)?;
    if range.contains(&value) {
        Ok(value)
    } else {
        Err(node
            .unexpected(expected, DisplayNumber(value))
            .actual(value))
    }
}

/// A whole number, at least 0; `8.0` and `1e3` are whole numbers.
pub(crate) fn whole(node: &Node<'_, '_>, expected: &str) -> Result<u64, Problem> {
    if let Ok(value) = node.text.parse::<u64>() {
        return Ok(value);
    }
    let value = number(node, expected)?;
    if (0.0..=MAX_WHOLE).contains(&value) && value.fract() == 0.0 {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a whole number of 0..=2^53"
        )]
        let value = value as u64;
        Ok(value)
    } else {
        Err(node.unexpected(expected, quote(node.text)).actual(value))
    }
}

/// A whole number of `-most..=most`.
pub(crate) fn integer(node: &Node<'_, '_>, most: i32, expected: &str) -> Result<i32, Problem> {
    let value = number(node, expected)?;
    if value.fract() != 0.0 {
        return Err(node.unexpected(expected, quote(node.text)).actual(value));
    }
    if value.abs() > f64::from(most) {
        return Err(node
            .unexpected(
                &format!("{expected} between -{most} and {most}"),
                DisplayNumber(value),
            )
            .actual(value));
    }
    #[expect(clippy::cast_possible_truncation, reason = "a whole number in range")]
    let value = value as i32;
    Ok(value)
}

/// A whole number of `min..=u32::MAX`. Whether the service can process so large a value is decided
/// later.
pub(crate) fn count(node: &Node<'_, '_>, min: u32, expected: &str) -> Result<u32, Problem> {
    let value = whole(node, expected)?;
    match u32::try_from(value) {
        Ok(count) if count >= min => Ok(count),
        Ok(count) => Err(node.unexpected(expected, count).actual(count)),
        Err(_) => Err(node
            .unexpected(&format!("{expected}, at most {}", u32::MAX), value)
            .limit("count", u32::MAX, value)),
    }
}
