//! The inverse of one bilinear patch.

use super::BORDER_ERROR_PX;
use crate::geometry::Point;

/// Rounding errors at the border of a patch, as a share of its side.
const PATCH_ERROR: f64 = 1e-9;

/// Where a position lies in a patch, as shares of its sides: a root of a quadratic.
pub(super) fn in_patch([a, b, d, c]: [Point; 4], y: Point) -> Option<[f64; 2]> {
    let (h, e, f, twist) = (y - a, b - a, c - a, (d - b) - (c - a));
    let [c0, c1, c2] = [h.cross(e), h.cross(twist) - f.cross(e), -f.cross(twist)];
    // The sum of terms of one sign loses nothing.
    let sum = -0.5 * (c1 + (c1 * c1 - 4.0 * c2 * c0).max(0.0).sqrt().copysign(c1));
    let shares = [c0 / sum, sum / c2].map(|t| {
        let across = e + twist * t;
        [(h - f * t).dot(across) / across.norm2(), t]
    });
    let beyond = |[s, t]: &[f64; 2]| (s - 0.5).abs().max((t - 0.5).abs()) - 0.5;
    // Beside a patch the quadratic may have no root.
    let off = |[s, t]: &[f64; 2]| (h - e * *s - f * *t - twist * (s * t)).norm();
    let is_inside = |at: &[f64; 2]| beyond(at) <= PATCH_ERROR && off(at) <= BORDER_ERROR_PX;
    let inside = shares.into_iter().filter(is_inside);
    let nearest = inside.min_by(|one, other| beyond(one).total_cmp(&beyond(other)))?;
    Some(nearest.map(|share| share.clamp(0.0, 1.0)))
}
