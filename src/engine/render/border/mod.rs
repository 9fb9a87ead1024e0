//! The border of the posed image: the closed polygon of the grid's outer vertices. Decides
//! without drawing whether the target is covered, and finds the border position nearest to each
//! uncovered pixel for `Outside::Edge`. Lattice steps in, sampler coordinates out.
//!
//! Each square of pixels has a list of candidate segments: those no farther from its centre than
//! the nearest one plus the square's diagonal. The lists of the largest squares come from a binary
//! tree of boxes over consecutive segments; smaller squares filter the list of the square around
//! them. A border that crosses the image back and forth, with boxes that overlap everywhere, is
//! therefore searched once per square and not once per pixel. The work is bounded for every border,
//! because list lengths are ([`SQUARE_SIZES`]).

use std::ops::Range;

use super::kernel::UNCOVERED;
use super::mirror::Mirror;
use super::snapped_grid::{Corner, HALF_PX, STEPS_PER_PX, SnappedGrid, column_centre, row_centre};
use crate::geometry::Point;

/// Segments in a leaf of the tree.
const LEAF_SEGMENTS: usize = 4;
/// Squares of pixels: side, px, and the largest number of candidates of one. If more segments are
/// as near, those nearest to the centre are kept; the result may then be farther away than the
/// nearest position, by at most the square's diagonal. Squares depend on target positions alone, so
/// every division into bands gives the same bytes.
const SQUARE_SIZES: [(usize, usize); 3] = [(32, 8192), (8, 512), (2, 128)];
/// Lists up to this length are searched for each pixel without smaller squares.
const SHORT_LIST: usize = 12;
/// Upper bound of rounding errors in distances, lattice steps.
const ROUNDING_MARGIN_STEPS: f64 = 1.0;

/// The border polygon, and its tree of boxes.
#[derive(Debug)]
pub(super) struct Border {
    /// Closed: the last vertex is the first.
    vertices: Vec<Corner>,
    /// Boxes of a complete binary tree, the root first, the children of k at 2k + 1 and 2k + 2;
    /// empty until [`Border::index`].
    boxes: Vec<[f64; 4]>,
    /// For `Outside::Reflect`.
    mirror: Option<Mirror>,
}

impl Border {
    /// Clockwise (y down) at rest: top row, right column, bottom row, left column.
    pub(super) fn new(lattice: &SnappedGrid) -> Self {
        let vertices = edges(lattice)
            .flat_map(|((i, j), cell, edge)| {
                std::iter::once(lattice.corner(i, j)).chain(lattice.fine.edge(cell.0, cell.1, edge))
            })
            .chain([lattice.corner(0, 0)])
            .collect();
        Self {
            vertices,
            boxes: Vec::new(),
            mirror: None,
        }
    }

    /// Prepares `Outside::Reflect`.
    pub(super) fn mirror(&mut self, lattice: &SnappedGrid) {
        let counts: Vec<_> = edges(lattice)
            .map(|(_, cell, edge)| 1 + lattice.fine.edge(cell.0, cell.1, edge).count())
            .collect();
        self.mirror = Some(Mirror::new(lattice, &counts));
    }

    fn segments(&self) -> impl Iterator<Item = (Corner, Corner)> + '_ {
        self.vertices.windows(2).map(|pair| (pair[0], pair[1]))
    }

    /// Whether every pixel centre of these columns and rows is certainly inside: no segment meets
    /// the rectangle of the centres, and the polygon winds around it. The image's map then has
    /// the same non-zero degree on the whole rectangle, so every centre is covered.
    pub(super) fn surrounds(&self, columns: &Range<usize>, rows: &Range<u32>) -> bool {
        let centre = |pixel: i64| pixel * i64::from(STEPS_PER_PX) + i64::from(HALF_PX);
        #[expect(clippy::cast_possible_wrap, reason = "a window has few columns")]
        let (left, right) = (centre(columns.start as i64), centre(columns.end as i64 - 1));
        let (top, bottom) = (centre(rows.start.into()), centre(i64::from(rows.end) - 1));
        // A polygon that no segment of which meets the rectangle winds around all of it alike, so
        // one position decides.
        let mut winding = 0;
        for (a, b) in self.segments() {
            if meets(a, b, [left, top, right, bottom]) {
                return false;
            }
            // Rays from the first centre to the right.
            let crosses =
                // Half open in y: a vertex on the ray counts for one of its two segments.
                |low: Corner, high: Corner| i64::from(low.y) <= top && i64::from(high.y) > top;
            let side = || {
                let (dx, dy) = (
                    i128::from(b.x) - i128::from(a.x),
                    i128::from(b.y) - i128::from(a.y),
                );
                // In 128 bits: corners reach 2^29 and the rectangle may lie anywhere.
                dx * (i128::from(top) - i128::from(a.y)) - dy * (i128::from(left) - i128::from(a.x))
            };
            if crosses(a, b) && side() > 0 {
                winding += 1;
            } else if crosses(b, a) && side() < 0 {
                winding -= 1;
            }
        }
        winding != 0
    }

    /// Builds the tree for a [`BorderSearch`].
    pub(super) fn index(&mut self) {
        let leaves = (self.vertices.len() - 1)
            .div_ceil(LEAF_SEGMENTS)
            .next_power_of_two();
        // A complete tree in an array needs no pointers; neighbours along the border lie near each
        // other, so boxes of successive segments are small.
        let mut boxes = vec![
            [
                f64::INFINITY,
                f64::INFINITY,
                f64::NEG_INFINITY,
                f64::NEG_INFINITY
            ];
            2 * leaves - 1
        ];
        for (leaf, cell) in boxes[leaves - 1..].iter_mut().enumerate() {
            for vertex in self
                .vertices
                .iter()
                .skip(leaf * LEAF_SEGMENTS)
                .take(LEAF_SEGMENTS + 1)
            {
                let (x, y) = (f64::from(vertex.x), f64::from(vertex.y));
                *cell = [
                    cell[0].min(x),
                    cell[1].min(y),
                    cell[2].max(x),
                    cell[3].max(y),
                ];
            }
        }
        for k in (0..leaves - 1).rev() {
            let (a, b) = (boxes[2 * k + 1], boxes[2 * k + 2]);
            boxes[k] = [
                a[0].min(b[0]),
                a[1].min(b[1]),
                a[2].max(b[2]),
                a[3].max(b[3]),
            ];
        }
        self.boxes = boxes;
    }

    /// Leaves of the tree.
    fn leaves(&self) -> usize {
        self.boxes.len().div_ceil(2)
    }

    /// Whether a search down the tree finds `segment` before `other` at equal distance: nearer
    /// boxes come first, then the left one.
    fn comes_first(&self, segment: usize, other: usize, place: Point) -> bool {
        let node = |segment: usize| segment / LEAF_SEGMENTS + self.leaves() - 1;
        let (mut a, mut b) = (node(segment.min(other)), node(segment.max(other)));
        if a == b {
            return segment < other;
        }
        // Up to the children of the common parent: which of them is searched first decides. Equal
        // distances happen at every convex vertex, and bands must agree on them.
        while (a - 1) / 2 != (b - 1) / 2 {
            (a, b) = ((a - 1) / 2, (b - 1) / 2);
        }
        let left_is_first =
            box_distance(&self.boxes[a], place) <= box_distance(&self.boxes[b], place);
        left_is_first == (segment < other)
    }
}

/// The outer edges of the grid, clockwise (y down) at rest from the top left corner: the first
/// vertex, the cell, and its edge.
fn edges(lattice: &SnappedGrid) -> impl Iterator<Item = ((usize, usize), (usize, usize), usize)> {
    let (right, bottom) = (lattice.columns - 1, lattice.rows - 1);
    let top_row = (0..right).map(|i| ((i, 0), (i, 0), 0));
    let right_column = (0..bottom).map(move |j| ((right, j), (right - 1, j), 1));
    let bottom_row = (0..right)
        .rev()
        .map(move |i| ((i + 1, bottom), (i, bottom - 1), 2));
    let left_column = (0..bottom).rev().map(|j| ((0, j + 1), (0, j), 3));
    top_row
        .chain(right_column)
        .chain(bottom_row)
        .chain(left_column)
}

/// Rows of coordinates with uncovered pixels: `[rows][pitch]`, of which those from `left` to
/// `width` are filled.
#[derive(Debug)]
pub(super) struct UncoveredRows<'a> {
    pub(super) first: u32,
    pub(super) left: usize,
    pub(super) width: usize,
    pub(super) pitch: usize,
    pub(super) u: &'a mut [f32],
    pub(super) v: &'a mut [f32],
}

impl UncoveredRows<'_> {
    fn end(&self) -> usize {
        self.first as usize + self.u.len().div_ceil(self.pitch)
    }

    /// Index of a pixel.
    fn at(&self, x: usize, y: usize) -> usize {
        (y - self.first as usize) * self.pitch + x
    }
}

/// A candidate for the nearest segment, with its distance from the centre of the square.
type NearSegment = (f64, u32);

/// The search for the nearest border positions.
#[derive(Debug)]
pub(super) struct BorderSearch<'a> {
    border: &'a Border,
    lists: [Vec<NearSegment>; SQUARE_SIZES.len()],
    /// Boxes, segments and pixels examined.
    work: u64,
}

impl<'a> BorderSearch<'a> {
    /// Requires an indexed border.
    pub(super) fn new(border: &'a Border) -> Self {
        Self {
            border,
            lists: Default::default(),
            work: 0,
        }
    }

    /// Gives every uncovered pixel the sampler's coordinates of the nearest border position; among
    /// equals, of the first segment.
    pub(super) fn fill(&mut self, rows: &mut UncoveredRows<'_>) {
        let (side, _) = SQUARE_SIZES[0];
        let before = self.work;
        // Squares at multiples of their side, not from the first row: the division into bands must
        // not change which candidates a pixel has.
        for y in (rows.first as usize / side * side..rows.end()).step_by(side) {
            for x in (rows.left / side * side..rows.width).step_by(side) {
                self.square(0, x, y, rows);
            }
        }
        debug_assert!(
            self.work - before <= self.most_work(rows),
            "{} of {}",
            self.work - before,
            self.most_work(rows)
        );
    }

    /// Upper bound of the work for these rows: each square its parent's whole list (first the
    /// tree), each pixel the longest list of the last size.
    fn most_work(&self, rows: &UncoveredRows<'_>) -> u64 {
        let tree = self.border.boxes.len() + self.border.vertices.len();
        let above = [tree, SQUARE_SIZES[0].1, SQUARE_SIZES[1].1];
        let lists = SQUARE_SIZES.iter().zip(above).map(|((side, _), above)| {
            let squares = rows.width.div_ceil(*side)
                * (rows.u.len().div_ceil(rows.pitch).div_ceil(*side) + 1);
            squares * (above + side * side)
        });
        let pixels = rows.u.len() * SQUARE_SIZES[2].1.max(SHORT_LIST);
        (lists.sum::<usize>() + pixels) as u64
    }

    /// Fills the uncovered pixels of a square, as far as it lies in the rows.
    fn square(&mut self, level: usize, x0: usize, y0: usize, rows: &mut UncoveredRows<'_>) {
        let (side, most) = SQUARE_SIZES[level];
        let (xs, ys) = (
            x0..(x0 + side).min(rows.width),
            y0.max(rows.first as usize)..(y0 + side).min(rows.end()),
        );
        self.work += (xs.len() * ys.len()) as u64;
        if !ys
            .clone()
            .any(|y| rows.u[rows.at(xs.start, y)..rows.at(xs.end, y)].contains(&UNCOVERED))
        {
            return;
        }
        let half = |corner: usize| {
            column_centre(corner) + 0.5 * (side as f64 - 1.0) * f64::from(STEPS_PER_PX)
        };
        let centre = Point::new(half(x0), half(y0));
        // A segment that is the nearest of some pixel of the square is at most a diagonal farther
        // from the centre than the nearest one: half for the pixel, half for the segment.
        let diagonal = side as f64 * f64::from(STEPS_PER_PX) * std::f64::consts::SQRT_2
            + ROUNDING_MARGIN_STEPS;
        let (above, below) = self.lists.split_at_mut(level);
        let list = &mut below[0];
        list.clear();
        let nearest = match above.last() {
            None => self.border.gather(centre, diagonal, list, &mut self.work),
            Some(above) => {
                self.work += above.len() as u64;
                list.extend(above.iter().map(|&(_, segment)| {
                    (self.border.distance(segment as usize, centre), segment)
                }));
                list.iter()
                    .fold(f64::INFINITY, |nearest, candidate| nearest.min(candidate.0))
            }
        };
        list.retain(|candidate| candidate.0 <= nearest + diagonal);
        // Around the centre of a circle everything is as near. Without this bound a hostile pose
        // would cost pixels times segments.
        if list.len() > most {
            list.select_nth_unstable_by(most - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            list.truncate(most);
        }
        if level + 1 < SQUARE_SIZES.len() && list.len() > SHORT_LIST {
            let (side, _) = SQUARE_SIZES[level + 1];
            for y in (y0..ys.end).step_by(side).filter(|y| y + side > ys.start) {
                for x in xs.clone().step_by(side) {
                    self.square(level + 1, x, y, rows);
                }
            }
            return;
        }
        for y in ys {
            for x in xs.clone() {
                let at = rows.at(x, y);
                if rows.u[at] == UNCOVERED {
                    let list = &self.lists[level];
                    self.work += list.len() as u64;
                    #[expect(clippy::cast_possible_truncation, reason = "a row of the target")]
                    let place = Point::new(column_centre(x), row_centre(y as u32) as f64);
                    (rows.u[at], rows.v[at]) = self.border.nearest_of(list, place);
                }
            }
        }
    }
}

impl Border {
    fn segment(&self, index: usize) -> (Corner, Corner) {
        (self.vertices[index], self.vertices[index + 1])
    }

    /// Distance of a segment from a position.
    fn distance(&self, index: usize, place: Point) -> f64 {
        let (a, b) = self.segment(index);
        nearest_on(a, b, place).0.sqrt()
    }

    /// Appends all segments no farther from `place` than the nearest one plus `beyond`, and
    /// possibly more; returns the distance of the nearest one.
    fn gather(
        &self,
        place: Point,
        beyond: f64,
        list: &mut Vec<NearSegment>,
        work: &mut u64,
    ) -> f64 {
        let leaves = self.leaves();
        let mut nearest = f64::INFINITY;
        // Depth first, nearer child first: at most two entries per level.
        let mut pending = [(0_usize, 0.0_f64); 2 * usize::BITS as usize];
        let mut depth = usize::from(!self.boxes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (node, distance2) = pending[depth];
            *work += 1;
            // The nearest distance has become smaller since the box was put aside.
            if distance2.sqrt() > nearest + beyond {
                continue;
            }
            if node + 1 >= leaves {
                let first = (node + 1 - leaves) * LEAF_SEGMENTS;
                for index in first..(first + LEAF_SEGMENTS).min(self.vertices.len() - 1) {
                    *work += 1;
                    let distance = self.distance(index, place);
                    nearest = nearest.min(distance);
                    #[expect(
                        clippy::cast_possible_truncation,
                        reason = "a grid has fewer than 2^32 outer vertices"
                    )]
                    list.push((distance, index as u32));
                }
                continue;
            }
            let mut children = [2 * node + 1, 2 * node + 2]
                .map(|child| (child, box_distance(&self.boxes[child], place)));
            if children[0].1 <= children[1].1 {
                children.swap(0, 1);
            }
            pending[depth..depth + 2].copy_from_slice(&children);
            depth += 2;
        }
        nearest
    }

    /// The sampler's coordinates of the position nearest to `place` on the listed segments, or
    /// mirrored beyond it.
    fn nearest_of(&self, list: &[NearSegment], place: Point) -> (f32, f32) {
        let mut best = (
            f64::INFINITY,
            (self.vertices[0].u, self.vertices[0].v),
            usize::MAX,
        );
        for &(_, index) in list {
            let index = index as usize;
            let (a, b) = self.segment(index);
            let (distance, coordinates) = nearest_on(a, b, place);
            if distance < best.0 || (distance == best.0 && self.comes_first(index, best.2, place)) {
                // Among equals the order of the tree, not that of the list: lists of different
                // squares hold different segments.
                best = (distance, coordinates, index);
            }
        }
        match &self.mirror {
            Some(mirror) if best.2 != usize::MAX => mirror.at(&self.vertices, best.2, place),
            _ => best.1,
        }
    }
}

/// Squared distance to a box; infinite for an empty one.
fn box_distance(&[left, top, right, bottom]: &[f64; 4], place: Point) -> f64 {
    let dx = (left - place.x).max(place.x - right).max(0.0);
    let dy = (top - place.y).max(place.y - bottom).max(0.0);
    dx * dx + dy * dy
}

/// Squared distance to a segment, and the coordinates of the nearest position.
#[expect(
    clippy::cast_possible_truncation,
    reason = "sampler coordinates are f32"
)]
fn nearest_on(a: Corner, b: Corner, place: Point) -> (f64, (f32, f32)) {
    let (from, to) = (
        Point::new(f64::from(a.x), f64::from(a.y)),
        Point::new(f64::from(b.x), f64::from(b.y)),
    );
    let (along, reach) = (to - from, place - from);
    let length2 = along.norm2();
    let t = if length2 > 0.0 {
        (reach.dot(along) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let distance2 = (reach - along * t).norm2();
    let blend = |a: f32, b: f32| (f64::from(a) + t * f64::from(b - a)) as f32;
    (distance2, (blend(a.u, b.u), blend(a.v, b.v)))
}

/// Whether a segment meets the closed rectangle `[left, right] x [top, bottom]`.
fn meets(a: Corner, b: Corner, [left, top, right, bottom]: [i64; 4]) -> bool {
    let apart = |a: i32, b: i32, near: i64, far: i64| {
        i64::from(a.max(b)) < near || i64::from(a.min(b)) > far
    };
    if apart(a.x, b.x, left, right) || apart(a.y, b.y, top, bottom) {
        return false;
    }
    // The boxes overlap, so they are disjoint only if the rectangle lies on one side of the line.
    let (dx, dy) = (
        i128::from(b.x) - i128::from(a.x),
        i128::from(b.y) - i128::from(a.y),
    );
    let side = |x: i64, y: i64| {
        (dx * (i128::from(y) - i128::from(a.y)) - dy * (i128::from(x) - i128::from(a.x))).signum()
    };
    let sides = [
        side(left, top),
        side(right, top),
        side(right, bottom),
        side(left, bottom),
    ];
    !(sides == [1; 4] || sides == [-1; 4])
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "small numbers of the tests themselves"
)]
#[cfg(test)]
mod tests;
