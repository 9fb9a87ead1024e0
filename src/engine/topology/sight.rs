//! Lines of sight inside a mask, decided on its pixels (mathematics 11.2).

use super::Mask;
use super::pixel::floor;
use crate::geometry::Point;

/// A crossing this near to the corner of a pixel passes through the corner, px.
const ON_CORNER: f64 = 1e-9;

impl Mask {
    /// Whether the segment between two positions inside stays inside: it crosses no pixel that is
    /// not, and passes the corner of two such pixels only beside a third one. O(1) far from the
    /// border of the mask, at most O(length).
    #[must_use]
    pub fn sees(&self, a: Point, b: Point) -> bool {
        let (width, height) = self.size();
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let steep = dy.abs() > dx.abs();
        // Along the axis in which the segment is longer, from left to right: columns of pixels in
        // which it touches two at most.
        let turn = |v: Point| if steep { (v.y, v.x) } else { (v.x, v.y) };
        let (mut from, mut to) = (turn(a), turn(b));
        if from.0 > to.0 {
            std::mem::swap(&mut from, &mut to);
        }
        let length = to.0 - from.0;
        let slope = if length > 0.0 {
            (to.1 - from.1) / length
        } else {
            0.0
        };
        let at = |u: f64| from.1 + slope * (u - from.0);
        let clearance = |u: i64, v: i64| {
            let (x, y) = if steep { (v, u) } else { (u, v) };
            match (usize::try_from(x), usize::try_from(y)) {
                (Ok(x), Ok(y)) if x < width && y < height => self.clearance(x, y),
                _ => 0,
            }
        };
        let (mut u, last) = (floor(from.0), floor(to.0));
        let mut row = floor(from.1);
        loop {
            let here = clearance(u, row);
            if here == 0 {
                return false;
            }
            if here > 2 {
                // Everything within `here - 1` pixels is inside, and the segment rises by one pixel
                // a column at most.
                let skipped = i64::try_from(here - 1).unwrap_or(1);
                if u + skipped > last {
                    return true;
                }
                u += skipped;
                row = floor(at(u as f64));
                continue;
            }
            let end = if u == last { to.1 } else { at((u + 1) as f64) };
            let corner = end.round();
            let through_corner = u < last && (end - corner).abs() < ON_CORNER;
            let (side, next) = if through_corner {
                // Rising segments leave the column below the corner, falling ones above it.
                #[expect(clippy::cast_possible_truncation, reason = "positions of an image")]
                let corner = corner as i64;
                if slope > 0.0 {
                    (corner - 1, corner)
                } else {
                    (corner, corner - i64::from(slope < 0.0))
                }
            } else {
                (floor(end), floor(end))
            };
            if side != row && clearance(u, side) == 0 {
                return false;
            }
            if u == last {
                return true;
            }
            if next != side && clearance(u, next) == 0 && clearance(u + 1, side) == 0 {
                return false;
            }
            (u, row) = (u + 1, next);
        }
    }
}
