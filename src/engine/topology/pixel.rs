//! Positions and pixels.

use crate::geometry::Point;

/// Positions are moved this far from the border of their pixel before a line of sight is drawn, px.
pub(super) const INTO_PIXEL: f64 = 1e-6;

/// The position of a pixel that is nearest to `v`, `margin` from its border.
pub(super) fn nearest_of_pixel((x, y): (usize, usize), v: Point, margin: f64) -> Point {
    let (x, y) = (x as f64, y as f64);
    Point::new(
        v.x.clamp(x + margin, x + 1.0 - margin),
        v.y.clamp(y + margin, y + 1.0 - margin),
    )
}

/// The largest whole number that is not greater; saturates.
pub(super) fn floor(v: f64) -> i64 {
    // Without a call of the mathematical library, which is most of the time of a line of sight.
    #[expect(clippy::cast_possible_truncation, reason = "saturates")]
    let toward_zero = v as i64;
    toward_zero.saturating_sub(i64::from(toward_zero as f64 > v))
}
