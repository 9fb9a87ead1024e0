//! Pulling a path tight: the corners around which the shortest path within a triangle bends
//! (mathematics 11.2).

use super::Nodes;
use super::sight::Sights;
use crate::geometry::Point;

/// How often a path may be divided at a corner.
const MOST_BENDS: u32 = 6;
/// Positions this near to the edge of a triangle count as inside, px.
const ON_EDGE: f64 = 1e-5;
/// Where rows have at most this many corners on average, all are looked at, without a search for the
/// first of each.
const FEW_CORNERS: usize = 8;
/// A corner bends a path if it is at least this far from the straight line, px.
const OFF_LINE: f64 = 1e-9;

impl Nodes {
    /// The corners of the tight path from `from` to `to`, which it does not see, inside the
    /// triangle with the vertex `apex`, in their order. False if it finds no such path.
    pub(super) fn pull_tight(
        &self,
        [from, apex, to]: [Point; 3],
        sights: &mut Sights,
        corners: &mut Vec<u32>,
    ) -> bool {
        corners.clear();
        self.bend([from, apex, to], MOST_BENDS, sights, corners)
    }

    fn bend(
        &self,
        [from, apex, to]: [Point; 3],
        depth: u32,
        sights: &mut Sights,
        corners: &mut Vec<u32>,
    ) -> bool {
        let Some(depth) = depth.checked_sub(1) else {
            return false;
        };
        let Some(corner) = self.farthest_corner([from, apex, to]) else {
            return false;
        };
        let at = self.position(corner);
        let sees = sights.sees(self.mask(), from, at);
        if !sees && !self.bend([from, apex, at], depth, sights, corners) {
            return false;
        }
        corners.push(corner);
        sights.sees(self.mask(), at, to) || self.bend([at, apex, to], depth, sights, corners)
    }

    /// The corner inside a triangle that is farthest from the line from its first vertex to its
    /// last; the first of equals.
    fn farthest_corner(&self, vertices: [Point; 3]) -> Option<u32> {
        let [from, apex, to] = vertices;
        let line = to - from;
        let height = line.cross(apex - from);
        let side = height.signum();
        let least = OFF_LINE * line.norm();
        if height.abs() <= least {
            return None;
        }
        let (mut best, mut farthest) = (None, least);
        // Most corners are beside the strip of the triangle, which costs less to see than whether
        // one is inside.
        let most = height.abs() + 4.0 * ON_EDGE * line.norm();
        let low = from.y.min(apex.y).min(to.y) - ON_EDGE;
        let high = from.y.max(apex.y).max(to.y) + ON_EDGE;
        let leftmost = from.x.min(apex.x).min(to.x) - ON_EDGE;
        let rightmost = from.x.max(apex.x).max(to.x) + ON_EDGE;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positions of an image"
        )]
        let lines = low.ceil().max(0.0) as usize..=high.floor().max(0.0) as usize;
        let mut consider = |corner: u32| {
            let at = self.position(corner);
            let distance = side * line.cross(at - from);
            if distance > farthest
                && distance <= most
                && across(vertices, at.y.round())
                    .is_some_and(|[left, right]| (left..=right).contains(&at.x))
            {
                (best, farthest) = (Some(corner), distance);
            }
        };
        let all = self.corners_on(*lines.start()).start..self.corners_on(*lines.end()).end;
        if all.len() <= FEW_CORNERS * lines.clone().count() {
            for corner in all {
                consider(corner);
            }
            return best;
        }
        for y in lines {
            let on_line = self.corners_on(y);
            let first = lower_bound(on_line.clone(), |corner| self.position(corner).x < leftmost);
            for corner in first..on_line.end {
                if self.position(corner).x > rightmost {
                    break;
                }
                consider(corner);
            }
        }
        best
    }
}

/// Where a horizontal line crosses a triangle, with its margin.
fn across(vertices: [Point; 3], y: f64) -> Option<[f64; 2]> {
    let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
    for k in 0..3 {
        let (a, b) = (vertices[k], vertices[(k + 1) % 3]);
        if (a.y - y).abs() <= ON_EDGE {
            (left, right) = (left.min(a.x), right.max(a.x));
        }
        if (a.y < y) != (b.y < y) {
            let x = a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y));
            (left, right) = (left.min(x), right.max(x));
        }
    }
    (left <= right).then_some([left - ON_EDGE, right + ON_EDGE])
}

/// The first number of a range for which `before` is false; `before` holds for none after that.
fn lower_bound(range: std::ops::Range<u32>, before: impl Fn(u32) -> bool) -> u32 {
    let (mut low, mut high) = (range.start, range.end);
    while low < high {
        let middle = low + (high - low) / 2;
        if before(middle) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    low
}
