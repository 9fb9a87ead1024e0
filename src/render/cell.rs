//! The general way: one cell at a time, in painter's order, any shape. A convex cell is its bilinear patch: along a row of pixel centres the
//! coordinates are exact where the row enters and leaves the cell and linear between, in as many pieces as the tolerance asks for. Every other
//! cell is two triangles, each affine. Sampler coordinates into rows of pixels; O(rows touched + pixels painted) a cell.

use std::ops::Range;

use super::edge::{Crossing, Edge};
use super::lattice::{Corner, Lattice, ONE, column_centre, first_row, row_centre};
use super::patch::{Patch, Shape, TOLERANCE, shape, turn};
use crate::geometry::Point;

/// Coordinates along a run of pixels: `u + k du`, `v + k dv` at the k-th.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub(super) u: f32,
    pub(super) du: f32,
    pub(super) v: f32,
    pub(super) dv: f32,
}

/// What cells are drawn on.
pub(super) trait Canvas {
    /// Whether cells of a column are drawn in a target row at all.
    fn wants(&self, row: u32, column: usize) -> bool;
    /// Paints a run of pixels of a row; later paint covers earlier paint.
    fn paint(&mut self, row: u32, pixels: Range<usize>, line: Line);
}

/// Draws what a cell covers of the pixels `[0, width)` of target rows.
pub(super) fn draw(lattice: &Lattice, (i, j): (usize, usize), rows: &Range<u32>, width: u32, canvas: &mut impl Canvas) {
    let corners = [lattice.corner(i, j), lattice.corner(i + 1, j), lattice.corner(i + 1, j + 1), lattice.corner(i, j + 1)];
    let (left, right) = bounds(corners.map(|c| c.x));
    if right <= 0 || i64::from(left) >= i64::from(width) * i64::from(ONE) {
        return;
    }
    let window = Window { rows, width: i64::from(width), column: i };
    match shape(&corners) {
        Shape::Convex(sign) => {
            let patch = Patch::new(&corners, sign);
            // NaN where the area is lost in f64: the largest number of pieces.
            let pieces = (patch.linear_error(lattice.unit) / TOLERANCE).sqrt();
            if pieces <= 1.0 {
                window.polygon(&corners, canvas, |span, row, canvas| span.straight(row, canvas));
            } else {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "float to integer saturates; NaN is infinity here"
                )]
                let pieces = if pieces.is_nan() { usize::MAX } else { pieces.ceil() as usize + 1 };
                window.polygon(&corners, canvas, |span, row, canvas| span.bent(row, &patch, pieces, canvas));
            }
        }
        Shape::Other => {
            for triangle in triangles(&corners) {
                window.polygon(&triangle, canvas, |span, row, canvas| span.straight(row, canvas));
            }
        }
    }
}

/// A cell that is not convex, divided along the diagonal 00-11 unless only the other one gives two triangles of one orientation (a dart whose
/// notch is at 10 or 01).
fn triangles([a, b, c, d]: &[Corner; 4]) -> [[Corner; 3]; 2] {
    let same = |p: i64, q: i64| p.signum() * q.signum() >= 0;
    if !same(turn(*a, *b, *c), turn(*a, *c, *d)) && same(turn(*a, *b, *d), turn(*b, *c, *d)) {
        [[*a, *b, *d], [*b, *c, *d]]
    } else {
        [[*a, *b, *c], [*a, *c, *d]]
    }
}

fn bounds<const N: usize>(places: [i32; N]) -> (i32, i32) {
    places.iter().fold((i32::MAX, i32::MIN), |(low, high), &p| (low.min(p), high.max(p)))
}

struct Window<'a> {
    rows: &'a Range<u32>,
    width: i64,
    column: usize,
}

/// What a row meets of a convex polygon: pixels `[first, end)`, and the crossings at either side.
struct Span {
    first: usize,
    end: usize,
    left: Crossing,
    right: Crossing,
    /// Lattice y of the row's centres.
    y: f64,
}

impl Window<'_> {
    /// Walks the rows of a convex polygon or a triangle.
    fn polygon<const N: usize, C: Canvas>(&self, corners: &[Corner; N], canvas: &mut C, mut paint: impl FnMut(&Span, u32, &mut C)) {
        let (top, bottom) = bounds(corners.map(|c| c.y));
        let clip = |row: i64| u32::try_from(row.max(0)).unwrap_or(u32::MAX).clamp(self.rows.start, self.rows.end);
        let (first, end) = (clip(first_row(top)), clip(first_row(bottom)));
        if first >= end {
            return;
        }
        let mut edges = [None; N];
        for (k, edge) in edges.iter_mut().enumerate() {
            *edge = Edge::new(corners[k], corners[(k + 1) % N]);
        }
        for row in first..end {
            if !canvas.wants(row, self.column) {
                continue;
            }
            let y = row_centre(row);
            let mut crossings = edges.iter().flatten().filter_map(|edge| edge.crossing(y));
            if let (Some(a), Some(b)) = (crossings.next(), crossings.next())
                && let Some(span) = self.span(a, b, y)
            {
                paint(&span, row, canvas);
            }
        }
    }

    fn span(&self, a: Crossing, b: Crossing, y: i64) -> Option<Span> {
        let (left, right) = if a.pixel <= b.pixel { (a, b) } else { (b, a) };
        let clip = |pixel: i64| usize::try_from(pixel.clamp(0, self.width)).unwrap_or(0);
        let (first, end) = (clip(left.pixel), clip(right.pixel));
        (first < end).then_some(Span { first, end, left, right, y: y as f64 })
    }
}

impl Span {
    /// Linear from the left crossing to the right one.
    fn straight(&self, row: u32, canvas: &mut impl Canvas) {
        let (left, right) = (&self.left, &self.right);
        let breadth = right.x - left.x;
        // Between 0 and 1 but for rounding, which a hair's breadth would magnify; a second pixel only exists where the breadth is one at least.
        let share = ((self.place(self.first) - left.x) / breadth).clamp(0.0, 1.0);
        let (du, dv) = (right.u - left.u, right.v - left.v);
        let step = f64::from(ONE) / breadth;
        canvas.paint(row, self.first..self.end, line((left.u + share * du, left.v + share * dv), (step * du, step * dv)));
    }

    /// Linear in pieces between places where the patch is inverted.
    fn bent(&self, row: u32, patch: &Patch, pieces: usize, canvas: &mut impl Canvas) {
        let length = (self.end - self.first).div_ceil(pieces);
        let mut at = self.inverse(patch, self.first);
        for first in (self.first..self.end).step_by(length) {
            let end = first + length;
            if end >= self.end {
                // The last piece ends at its last pixel.
                let count = self.end - first - 1;
                let to = if count == 0 { at } else { self.inverse(patch, self.end - 1) };
                canvas.paint(row, first..self.end, between(at, to, count));
                return;
            }
            let to = self.inverse(patch, end);
            canvas.paint(row, first..end, between(at, to, length));
            at = to;
        }
    }

    fn inverse(&self, patch: &Patch, pixel: usize) -> (f64, f64) {
        patch.inverse(Point::new(self.place(pixel), self.y))
    }

    /// Lattice x of a pixel's centre.
    fn place(&self, pixel: usize) -> f64 {
        column_centre(pixel)
    }
}

/// From one place to another in `count` pixels.
fn between(from: (f64, f64), to: (f64, f64), count: usize) -> Line {
    let step = 1.0 / (count.max(1) as f64);
    line(from, ((to.0 - from.0) * step, (to.1 - from.1) * step))
}

#[expect(clippy::cast_possible_truncation, reason = "sampler coordinates are f32")]
fn line(from: (f64, f64), step: (f64, f64)) -> Line {
    Line { u: from.0 as f32, du: step.0 as f32, v: from.1 as f32, dv: step.1 as f32 }
}
