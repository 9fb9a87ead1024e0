//! The general way: one cell at a time, in painter's order, any shape. A convex cell is its bilinear patch: along a row of pixel centres the
//! coordinates are exact where the row enters and leaves the cell and linear between, in as many pieces as the tolerance asks for. Every other
//! cell is two triangles, each affine. Sampler coordinates into rows of pixels; O(rows touched + pixels painted) a cell.

use std::ops::Range;

use super::edge::Crossing;
use super::kernel::Kernel;
use super::lattice::{Corner, Lattice, ONE, column_centre, first_row, row_centre};
use super::patch::{Patch, Shape, TOLERANCE, shape, turn};
use crate::geometry::Point;

/// More pieces than a row can have.
const MANY: usize = 1 << 31;

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
    /// Whether cells come from the last one back, and earlier paint stays.
    fn backwards(&self) -> bool {
        false
    }
    /// Paints a run of pixels of a row.
    fn paint(&mut self, row: u32, pixels: Range<usize>, line: Line);
}

/// Draws what a cell covers of the pixels `[0, width)` of target rows; `sound` as the kernels decide.
pub(super) fn draw(
    kernel: Kernel,
    lattice: &Lattice,
    (i, j): (usize, usize),
    sound: bool,
    rows: &Range<u32>,
    width: u32,
    canvas: &mut impl Canvas,
) {
    let corners = [lattice.corner(i, j), lattice.corner(i + 1, j), lattice.corner(i + 1, j + 1), lattice.corner(i, j + 1)];
    let (left, right) = bounds(corners.map(|c| c.x));
    if right <= 0 || i64::from(left) >= i64::from(width) * i64::from(ONE) {
        return;
    }
    let window = Window { kernel, rows, width: i64::from(width), column: i };
    if sound {
        // Convex, and near enough to linear.
        return window.polygon(&corners, canvas, |span, row, canvas| span.straight(row, canvas));
    }
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
                    reason = "float to integer saturates, and NaN is taken out"
                )]
                let pieces = if pieces.is_nan() { MANY } else { (pieces.ceil() as usize).min(MANY) };
                window.polygon(&corners, canvas, |span, row, canvas| span.bent(row, &patch, pieces, canvas));
            }
        }
        Shape::Other => {
            let mut triangles = triangles(&corners);
            if canvas.backwards() {
                triangles.reverse();
            }
            for triangle in triangles {
                window.polygon(&triangle, canvas, |span, row, canvas| span.straight(row, canvas));
            }
        }
    }
}

/// A cell that is not convex, divided along the diagonal 00-11 unless only the other one gives two triangles of one orientation (a dart whose
/// notch is at 10 or 01). Triangles have their last corner twice.
fn triangles([a, b, c, d]: &[Corner; 4]) -> [[Corner; 4]; 2] {
    let same = |p: i64, q: i64| p.signum() * q.signum() >= 0;
    if !same(turn(*a, *b, *c), turn(*a, *c, *d)) && same(turn(*a, *b, *d), turn(*b, *c, *d)) {
        [[*a, *b, *d, *d], [*b, *c, *d, *d]]
    } else {
        [[*a, *b, *c, *c], [*a, *c, *d, *d]]
    }
}

fn bounds<const N: usize>(places: [i32; N]) -> (i32, i32) {
    places.iter().fold((i32::MAX, i32::MIN), |(low, high), &p| (low.min(p), high.max(p)))
}

struct Window<'a> {
    kernel: Kernel,
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
    /// Walks the rows of a convex polygon.
    fn polygon<C: Canvas>(&self, corners: &[Corner; 4], canvas: &mut C, mut paint: impl FnMut(&Span, u32, &mut C)) {
        let (top, bottom) = bounds(corners.map(|c| c.y));
        let clip = |row: i64| u32::try_from(row.max(0)).unwrap_or(u32::MAX).clamp(self.rows.start, self.rows.end);
        let (first, end) = (clip(first_row(top)), clip(first_row(bottom)));
        if first >= end {
            return;
        }
        self.kernel.walk(corners, first..end, |row, a, b| {
            if canvas.wants(row, self.column)
                && let Some(span) = self.span(a, b, row_centre(row))
            {
                paint(&span, row, canvas);
            }
        });
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
    #[inline]
    fn straight(&self, row: u32, canvas: &mut impl Canvas) {
        canvas.paint(row, self.first..self.end, between(&self.left, &self.right, self.first));
    }

    /// Linear in pieces of equal breadth, between places where the patch is inverted; at every pixel where pieces would be shorter than two.
    fn bent(&self, row: u32, patch: &Patch, pieces: usize, canvas: &mut impl Canvas) {
        if self.end - self.first < 2 * pieces {
            for pixel in self.first..self.end {
                let at = self.inverse(patch, column_centre(pixel));
                canvas.paint(row, pixel..pixel + 1, line((at.u, at.v), (0.0, 0.0)));
            }
            return;
        }
        #[expect(clippy::cast_precision_loss, reason = "fewer pieces than pixels")]
        let breadth = (self.right.x - self.left.x) / pieces as f64;
        let (mut from, mut first) = (self.left, self.first);
        for piece in 1..=pieces {
            #[expect(clippy::cast_precision_loss, reason = "fewer pieces than pixels")]
            let to = if piece == pieces { self.right } else { self.inverse(patch, self.left.x + breadth * piece as f64) };
            let end = if piece == pieces { self.end } else { usize::try_from(to.pixel).unwrap_or(0).clamp(first, self.end) };
            if first < end {
                canvas.paint(row, first..end, between(&from, &to, first));
            }
            (from, first) = (to, end);
        }
    }

    /// The row at lattice x; the pixel but for rounding.
    fn inverse(&self, patch: &Patch, x: f64) -> Crossing {
        let (u, v) = patch.inverse(Point::new(x, self.y));
        #[expect(clippy::cast_possible_truncation, reason = "float to integer saturates")]
        let pixel = (x / f64::from(ONE) + 0.5) as i64;
        Crossing { pixel, x, u, v }
    }
}

/// From pixel `first` on, the line between two places of a row.
#[inline]
fn between(left: &Crossing, right: &Crossing, first: usize) -> Line {
    let per_step = 1.0 / (right.x - left.x);
    // Between 0 and 1 but for rounding, which a hair's breadth would magnify; a second pixel only exists where the breadth is one at least.
    let share = ((column_centre(first) - left.x) * per_step).clamp(0.0, 1.0);
    let (du, dv) = (right.u - left.u, right.v - left.v);
    let step = f64::from(ONE) * per_step;
    line((left.u + share * du, left.v + share * dv), (step * du, step * dv))
}

#[expect(clippy::cast_possible_truncation, reason = "sampler coordinates are f32")]
fn line(from: (f64, f64), step: (f64, f64)) -> Line {
    Line { u: from.0 as f32, du: step.0 as f32, v: from.1 as f32, dv: step.1 as f32 }
}
