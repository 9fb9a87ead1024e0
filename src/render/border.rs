//! The border of the posed picture: the closed polygon of the grid's outer vertices. Decides without drawing whether the target is covered,
//! and finds the border's place nearest to a pixel for `Outside::Edge`, by a binary tree of boxes over consecutive segments (the polygon is local
//! enough that no other order is needed). Lattice steps in, sampler coordinates out. Built in O(border), a query visits O(log border) boxes as a rule.

use super::lattice::{Corner, HALF, Lattice, ONE};
use crate::geometry::Point;
use crate::pixmap::Extent;

/// Segments in a leaf of the tree.
const LEAF: usize = 4;

/// The border polygon, and its tree of boxes.
#[derive(Debug)]
pub(super) struct Border {
    /// Closed: the last vertex is the first.
    vertices: Vec<Corner>,
    /// Boxes of a complete binary tree, the root first, the children of k at 2k + 1 and 2k + 2; empty until [`Border::index`].
    boxes: Vec<[f64; 4]>,
}

impl Border {
    /// Clockwise (y down) at rest: top row, right column, bottom row, left column.
    pub(super) fn new(lattice: &Lattice) -> Self {
        let (right, bottom) = (lattice.columns - 1, lattice.rows - 1);
        let top_row = (0..right).map(|i| (i, 0));
        let right_column = (0..bottom).map(|j| (right, j));
        let bottom_row = (1..=right).rev().map(|i| (i, bottom));
        let left_column = (0..=bottom).rev().map(|j| (0, j));
        let vertices = top_row.chain(right_column).chain(bottom_row).chain(left_column).map(|(i, j)| lattice.corner(i, j)).collect();
        Self { vertices, boxes: Vec::new() }
    }

    fn segments(&self) -> impl Iterator<Item = (Corner, Corner)> + '_ {
        self.vertices.windows(2).map(|pair| (pair[0], pair[1]))
    }

    /// Whether every pixel centre of the target is certainly inside: no segment meets the rectangle of the centres, and the polygon winds around it.
    /// Then the map of the picture has one degree on the whole rectangle, which is not zero, so that no centre is left out.
    pub(super) fn surrounds(&self, target: Extent) -> bool {
        let far = |pixels: u32| i64::from(pixels) * i64::from(ONE) - i64::from(HALF);
        let near = i64::from(HALF);
        let (right, bottom) = (far(target.width()), far(target.height()));
        let mut winding = 0;
        for (a, b) in self.segments() {
            if meets(a, b, near, right, bottom) {
                return false;
            }
            // Rays from the first centre to the right.
            let crosses = |low: Corner, high: Corner| i64::from(low.y) <= near && i64::from(high.y) > near;
            let side = || {
                let (dx, dy) = (i128::from(b.x) - i128::from(a.x), i128::from(b.y) - i128::from(a.y));
                dx * (i128::from(near) - i128::from(a.y)) - dy * (i128::from(near) - i128::from(a.x))
            };
            if crosses(a, b) && side() > 0 {
                winding += 1;
            } else if crosses(b, a) && side() < 0 {
                winding -= 1;
            }
        }
        winding != 0
    }

    /// Builds the tree that [`Border::nearest`] walks.
    pub(super) fn index(&mut self) {
        let leaves = (self.vertices.len() - 1).div_ceil(LEAF).next_power_of_two();
        let mut boxes = vec![[f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY]; 2 * leaves - 1];
        for (leaf, cell) in boxes[leaves - 1..].iter_mut().enumerate() {
            for vertex in self.vertices.iter().skip(leaf * LEAF).take(LEAF + 1) {
                let (x, y) = (f64::from(vertex.x), f64::from(vertex.y));
                *cell = [cell[0].min(x), cell[1].min(y), cell[2].max(x), cell[3].max(y)];
            }
        }
        for k in (0..leaves - 1).rev() {
            let (a, b) = (boxes[2 * k + 1], boxes[2 * k + 2]);
            boxes[k] = [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])];
        }
        self.boxes = boxes;
    }

    /// The sampler's coordinates of the border's place that is nearest to `place`; among equals the one found first, which depends on `place` alone.
    pub(super) fn nearest(&self, place: Point) -> (f32, f32) {
        let leaves = self.boxes.len().div_ceil(2);
        let mut best = (f64::INFINITY, (self.vertices[0].u, self.vertices[0].v));
        // Depth first, the nearer child first: two entries a level at most.
        let mut pending = [(0_usize, 0.0_f64); 2 * usize::BITS as usize];
        let mut depth = usize::from(!self.boxes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (node, distance) = pending[depth];
            if distance >= best.0 {
                continue;
            }
            if node + 1 >= leaves {
                let first = (node + 1 - leaves) * LEAF;
                for pair in self.vertices[first.min(self.vertices.len())..].windows(2).take(LEAF) {
                    let (distance, coordinates) = nearest_on(pair[0], pair[1], place);
                    if distance < best.0 {
                        best = (distance, coordinates);
                    }
                }
                continue;
            }
            let mut children = [2 * node + 1, 2 * node + 2].map(|child| (child, box_distance(&self.boxes[child], place)));
            if children[0].1 <= children[1].1 {
                children.swap(0, 1);
            }
            pending[depth..depth + 2].copy_from_slice(&children);
            depth += 2;
        }
        best.1
    }
}

/// Squared distance to a box; infinite for an empty one.
fn box_distance(&[left, top, right, bottom]: &[f64; 4], place: Point) -> f64 {
    let dx = (left - place.x).max(place.x - right).max(0.0);
    let dy = (top - place.y).max(place.y - bottom).max(0.0);
    dx * dx + dy * dy
}

/// Squared distance to a segment, and the coordinates of the place nearest.
#[expect(clippy::cast_possible_truncation, reason = "sampler coordinates are f32")]
fn nearest_on(a: Corner, b: Corner, place: Point) -> (f64, (f32, f32)) {
    let (from, to) = (Point::new(f64::from(a.x), f64::from(a.y)), Point::new(f64::from(b.x), f64::from(b.y)));
    let (along, reach) = (to - from, place - from);
    let length2 = along.norm2();
    let t = if length2 > 0.0 { (reach.dot(along) / length2).clamp(0.0, 1.0) } else { 0.0 };
    let distance2 = (reach - along * t).norm2();
    let blend = |a: f32, b: f32| (f64::from(a) + t * f64::from(b - a)) as f32;
    (distance2, (blend(a.u, b.u), blend(a.v, b.v)))
}

/// Whether a segment meets the closed rectangle `[near, right] x [near, bottom]`.
fn meets(a: Corner, b: Corner, near: i64, right: i64, bottom: i64) -> bool {
    let apart = |a: i32, b: i32, far: i64| i64::from(a.max(b)) < near || i64::from(a.min(b)) > far;
    if apart(a.x, b.x, right) || apart(a.y, b.y, bottom) {
        return false;
    }
    // The boxes overlap: they are apart only if the rectangle lies on one side of the line.
    let (dx, dy) = (i128::from(b.x) - i128::from(a.x), i128::from(b.y) - i128::from(a.y));
    let side = |x: i64, y: i64| (dx * (i128::from(y) - i128::from(a.y)) - dy * (i128::from(x) - i128::from(a.x))).signum();
    let sides = [side(near, near), side(right, near), side(right, bottom), side(near, bottom)];
    !(sides == [1; 4] || sides == [-1; 4])
}

#[cfg(test)]
#[expect(clippy::cast_possible_truncation, reason = "small numbers of the tests themselves")]
mod tests {
    use super::*;

    fn polygon(vertices: &[(i32, i32)]) -> Border {
        let closed = vertices.iter().chain(vertices.first());
        let vertices = closed.map(|&(x, y)| Corner { x: x * ONE, y: y * ONE, u: x as f32, v: y as f32 }).collect();
        Border { vertices, boxes: Vec::new() }
    }

    fn extent(width: u32, height: u32) -> Extent {
        Extent::new(width, height).unwrap()
    }

    #[test]
    fn border_surrounds_what_it_winds_around() {
        let rectangle = polygon(&[(0, 0), (10, 0), (10, 8), (0, 8)]);
        assert!(rectangle.surrounds(extent(10, 8)));
        assert!(!rectangle.surrounds(extent(11, 8)));
        assert!(!rectangle.surrounds(extent(10, 9)));
        assert!(polygon(&[(0, 0), (0, 8), (10, 8), (10, 0)]).surrounds(extent(10, 8)), "flipped");
        assert!(!polygon(&[(20, 0), (30, 0), (30, 8), (20, 8)]).surrounds(extent(10, 8)), "beside");
        assert!(!polygon(&[(-9, -9), (40, -9), (40, -8), (-8, -8), (-8, 40), (-9, 40)]).surrounds(extent(10, 8)), "around a corner only");
        assert!(polygon(&[(-30, 4), (5, -30), (40, 4), (5, 40)]).surrounds(extent(10, 8)), "a slanted one");
    }

    #[test]
    fn nearest_agrees_with_a_search_of_all() {
        let spiral: Vec<_> =
            (0..200_i32).map(|k| ((f64::from(k) * 0.7).sin() * f64::from(k), (f64::from(k) * 0.7).cos() * f64::from(k))).collect();
        let mut border = polygon(&spiral.iter().map(|&(x, y)| (x.round() as i32, y.round() as i32)).collect::<Vec<_>>());
        border.index();
        for k in 0..500 {
            let place = Point::new(f64::from((k * 7919) % 90_000) - 45_000.5, f64::from((k * 104_729) % 90_000) - 45_000.25);
            let (u, v) = border.nearest(place);
            let found = Point::new(f64::from(u) * f64::from(ONE), f64::from(v) * f64::from(ONE)).distance(place);
            let least = border.segments().map(|(a, b)| nearest_on(a, b, place).0).fold(f64::INFINITY, f64::min).sqrt();
            assert!((found - least).abs() < 1e-2, "{found} {least}");
        }
    }

    #[test]
    fn nearest_of_one_point_is_that_point() {
        let mut border = polygon(&[(3, 4); 1000]);
        border.index();
        assert_eq!(border.nearest(Point::new(1e9, -1e9)), (3.0, 4.0));
    }
}
