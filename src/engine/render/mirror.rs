//! The source position that an uncovered pixel shows with `Outside::Reflect`. The pixel lies at
//! some distance from the nearest position of the posed border; the source position lies as far
//! outside the source, beyond the same position of its border and at a right angle to it, and is
//! mirrored back into the source as often as necessary (`fedcba|abcdef`). Distances are measured as
//! in the cells along the border: the posed length of their inner edges is their height at rest. At
//! a corner of the image, the distances beyond its two sides are those along the normals of these
//! sides. The result is continuous across the border and along it.

use super::snapped_grid::{Corner, SnappedGrid};
use crate::geometry::{Point, Vec2};

/// The sides of the image, clockwise from the top: the axis that leads outwards, and its sign.
const OUTWARD_AXES: [(usize, f64); 4] = [(1, -1.0), (0, 1.0), (1, 1.0), (0, -1.0)];

/// A segment of the border.
#[derive(Clone, Copy, Debug)]
pub(super) struct BorderSegment {
    /// The side of the image, clockwise from the top.
    pub(super) side: usize,
    /// The sampler's coordinate per lattice step outwards, at both ends.
    pub(super) depth: [f64; 2],
}

/// What is necessary to mirror beyond the border.
#[derive(Debug)]
pub(super) struct Mirror {
    segments: Vec<BorderSegment>,
    /// The sampler's coordinates of the borders: first and last, across and down.
    ends: [[f64; 2]; 2],
}

impl Mirror {
    /// `counts`: how many segments belong to each outer edge of a cell, clockwise from the top left
    /// corner.
    pub(super) fn new(lattice: &SnappedGrid, counts: &[usize]) -> Self {
        let (right, bottom) = (lattice.columns - 1, lattice.rows - 1);
        // A vertex of the border and the next one inwards.
        let depth = |outer: (usize, usize), inner: (usize, usize)| {
            let (a, b) = (
                lattice.corner(outer.0, outer.1),
                lattice.corner(inner.0, inner.1),
            );
            let height = f64::from((a.u - b.u).abs().max((a.v - b.v).abs()));
            height / (place(b) - place(a)).norm().max(1.0)
        };
        let top = (0..right).map(|i| (0, [i, i + 1].map(|i| depth((i, 0), (i, 1)))));
        let east = (0..bottom).map(|j| (1, [j, j + 1].map(|j| depth((right, j), (right - 1, j)))));
        let low = (0..right)
            .rev()
            .map(|i| (2, [i + 1, i].map(|i| depth((i, bottom), (i, bottom - 1)))));
        let west = (0..bottom)
            .rev()
            .map(|j| (3, [j + 1, j].map(|j| depth((0, j), (1, j)))));
        let mut segments = Vec::new();
        for ((side, [from, to]), &count) in top.chain(east).chain(low).chain(west).zip(counts) {
            let at = |k: usize| from + (to - from) * (k as f64 / count as f64);
            segments.extend((0..count).map(|k| BorderSegment {
                side,
                depth: [at(k), at(k + 1)],
            }));
        }
        let ends = |line: &[f32], last: usize| [f64::from(line[0]), f64::from(line[last])];
        Self {
            segments,
            ends: [ends(&lattice.u, right), ends(&lattice.v, bottom)],
        }
    }

    /// The sampler's coordinates for `place`, whose nearest border position lies on the segment
    /// `index`. `vertices` are closed.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "sampler coordinates are f32"
    )]
    pub(super) fn at(&self, vertices: &[Corner], index: usize, pixel: Point) -> (f32, f32) {
        let (a, b) = (vertices[index], vertices[index + 1]);
        let (along, reach) = (place(b) - place(a), pixel - place(a));
        let length2 = along.norm2();
        let t = if length2 > 0.0 {
            (reach.dot(along) / length2).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let reach = reach - along * t;
        let distance = reach.norm();
        let segment = self.segments[index];
        let mut outwards = [[0.0; 2]; 2];
        let depth = segment.depth[0] + t * (segment.depth[1] - segment.depth[0]);
        let count = self.segments.len();
        let other = if t <= 0.0 {
            (index + count - 1) % count
        } else {
            (index + 1) % count
        };
        if (t > 0.0 && t < 1.0) || self.segments[other].side == segment.side {
            outwards[0] = beyond(segment.side, distance * depth);
        } else {
            let next = self.segments[other];
            let next_along = place(vertices[other + 1]) - place(vertices[other]);
            let shares = shares(reach, normal(along), normal(next_along), distance);
            outwards = [
                beyond(segment.side, shares[0] * depth),
                beyond(next.side, shares[1] * next.depth[usize::from(t <= 0.0)]),
            ];
        }
        let at = |from: f32, to: f32, axis: usize| {
            let border = f64::from(from) + t * (f64::from(to) - f64::from(from));
            folded(
                border + outwards[0][axis] + outwards[1][axis],
                self.ends[axis],
            ) as f32
        };
        (at(a.u, b.u, 0), at(a.v, b.v, 1))
    }
}

fn place(corner: Corner) -> Point {
    Point::new(f64::from(corner.x), f64::from(corner.y))
}

fn beyond(side: usize, distance: f64) -> [f64; 2] {
    let (axis, sign) = OUTWARD_AXES[side];
    let mut vector = [0.0; 2];
    vector[axis] = sign * distance;
    vector
}

fn normal(along: Vec2) -> Vec2 {
    let length = along.norm();
    if length > 0.0 {
        Vec2::new(along.y / length, -along.x / length)
    } else {
        Vec2::new(0.0, 0.0)
    }
}

/// The distances along two normals that add up to `reach`; neither exceeds its length.
fn shares(reach: Vec2, one: Vec2, other: Vec2, distance: f64) -> [f64; 2] {
    let cross = one.cross(other);
    if cross.abs() < 1e-9 {
        return [distance, 0.0];
    }
    [reach.cross(other) / cross, one.cross(reach) / cross].map(|share| share.abs().min(distance))
}

/// A coordinate mirrored between two ends as often as necessary.
fn folded(at: f64, [first, last]: [f64; 2]) -> f64 {
    let length = last - first;
    let along = (at - first).rem_euclid(2.0 * length);
    first + along.min(2.0 * length - along)
}

/// The pixel of a row or column of `side` pixels that is shown at `at`, mirrored.
pub(super) fn mirrored(at: i64, side: i64) -> i64 {
    let along = at.rem_euclid(2 * side);
    along.min(2 * side - 1 - along)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_mirrored_with_the_edge_repeated() {
        let shown: String = (-13..14)
            .map(|at| char::from(b'a' + u8::try_from(mirrored(at, 6)).unwrap()))
            .collect();
        assert_eq!(shown, "aabcdeffedcbaabcdeffedcbaab");
        assert!((-5..5).all(|at| mirrored(at, 1) == 0));
        for at in [-13.75_f64, -6.5, -0.25, 0.0, 2.5, 6.0, 6.25, 12.5] {
            #[expect(clippy::cast_possible_truncation, reason = "a few pixels")]
            let pixel = mirrored(at.floor() as i64, 6);
            assert!(
                (folded(at, [0.0, 6.0]) - (pixel as f64 + 0.5)).abs() <= 0.5,
                "{at}"
            );
        }
    }
}
