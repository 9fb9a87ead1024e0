//! Lines of sight inside a mask, decided on its pixels (mathematics 11.2).

use super::Mask;
use crate::geometry::Point;

/// A crossing this near to the corner of a pixel passes through the corner, px.
const ON_CORNER: f64 = 1e-9;
/// Lines of sight that are remembered.
const KEPT: usize = 256;

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
        let (sides, steps) = if steep {
            ([height, width], [width, 1])
        } else {
            ([width, height], [1, width])
        };
        let clearance = |u: i64, v: i64| match (usize::try_from(u), usize::try_from(v)) {
            (Ok(u), Ok(v)) if u < sides[0] && v < sides[1] => {
                self.clearance_at(u * steps[0] + v * steps[1])
            }
            _ => 0,
        };
        // Of positions that are not negative; faster than `floor`, on which each step waits.
        #[expect(clippy::cast_possible_truncation, reason = "positions of an image")]
        let pixel = |v: f64| v as i64;
        let (mut u, last) = (pixel(from.0), pixel(to.0));
        let mut row = pixel(from.1);
        loop {
            let here = clearance(u, row);
            if here == 0 {
                return false;
            }
            if here > 1 {
                // Everything within `here - 1` pixels is inside, and the segment rises by one pixel
                // a column at most.
                let skipped = i64::try_from(here - 1).unwrap_or(1);
                if u + skipped > last {
                    return true;
                }
                u += skipped;
                row = pixel(at(u as f64));
                continue;
            }
            let end = if u == last { to.1 } else { at((u + 1) as f64) };
            let below = pixel(end);
            let corner = below + i64::from(end - below as f64 >= 0.5);
            let through_corner = u < last && (end - corner as f64).abs() < ON_CORNER;
            let (side, next) = if through_corner {
                // Rising segments leave the column below the corner, falling ones above it.
                if slope > 0.0 {
                    (corner - 1, corner)
                } else {
                    (corner, corner - i64::from(slope < 0.0))
                }
            } else {
                (below, below)
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

/// Lines of sight that were asked for last: pulling paths tight around a corner asks for the same
/// ones again and again.
#[derive(Debug)]
pub struct Sights {
    known: Box<[(Point, Point, bool)]>,
}

impl Default for Sights {
    fn default() -> Self {
        // No position is equal to this one.
        let none = Point::new(f64::NAN, f64::NAN);
        Self {
            known: [(none, none, false); KEPT].into(),
        }
    }
}

impl Sights {
    pub(super) const BYTES: u64 = 40 * KEPT as u64;

    /// What [`Mask::sees`] says, of one mask.
    pub(super) fn sees(&mut self, mask: &Mask, a: Point, b: Point) -> bool {
        let mixed = [a.x, a.y, b.x, b.y].iter().fold(0_u64, |mixed, v| {
            (mixed.rotate_left(7) ^ v.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        });
        let known = &mut self.known[(mixed >> 40) as usize % KEPT];
        if (known.0, known.1) != (a, b) {
            *known = (a, b, mask.sees(a, b));
        }
        known.2
    }
}
