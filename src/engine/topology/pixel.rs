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
    #[expect(clippy::cast_possible_truncation, reason = "saturates")]
    let floor = v.floor() as i64;
    floor
}
