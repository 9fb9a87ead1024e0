//! The general way: one cell at a time, in painter's order, any shape. A convex cell is its bilinear patch, every other cell is two triangles,
//! each affine. Cells as they are as a rule are drawn in lanes (`kernel::cells`); of those with longer sides, the coordinates along a row of pixel
//! centres are exact where the row enters and leaves the cell and linear between, in as many pieces as the tolerance asks for. Sampler
//! coordinates into rows of pixels; O(rows touched + pixels painted) a cell.

use std::ops::Range;

use super::edge::{self, Crossing};
use super::kernel::{BARE, Canvas, Glance, Kernel, LONGEST_SIDE, Piece};
use super::lattice::{BLOCK, Corner, Lattice, ONE, column_centre, first_row, row_centre};
use super::patch::{Patch, Shape, TOLERANCE, shape, turn};
use crate::geometry::Point;

/// More pieces than a row can have.
const MANY: usize = 1 << 31;

/// Coordinates along a run of pixels: `u + k du`, `v + k dv` at the k-th.
#[derive(Clone, Copy, Debug)]
struct Line {
    u: f32,
    du: f32,
    v: f32,
    dv: f32,
}

/// Draws what a row of cells covers of the rows that are open, from its last cell to its first; of each block of cells those whose bits are set.
pub(super) fn draw_row(
    kernel: Kernel,
    lattice: &Lattice,
    j: usize,
    blocks: impl Fn(usize) -> u8,
    rows: &Range<u32>,
    canvas: &mut Canvas<'_>,
) {
    let mut seen = Glance::default();
    for b in (0..lattice.blocks()).rev() {
        let mut cells = blocks(b);
        if cells == 0 || !lattice.block_touches(j, b, rows) {
            continue;
        }
        kernel.glance(lattice, j, b, canvas, &mut seen);
        while cells != 0 {
            let k = cells.ilog2() as usize;
            cells &= !(1 << k);
            let (i, rows) = (b * BLOCK + k, seen.rows[k] & canvas.open);
            if rows == 0 {
                continue;
            }
            let corners = [lattice.corner(i, j), lattice.corner(i + 1, j), lattice.corner(i + 1, j + 1), lattice.corner(i, j + 1)];
            if seen.convex[k] == 0 {
                draw(kernel, &corners, lattice.unit, rows, canvas);
            } else {
                kernel.fill(&Piece::cell(&seen, k, &corners), rows, canvas);
            }
        }
    }
}

/// Draws a cell that is not convex, or has long sides.
fn draw(kernel: Kernel, corners: &[Corner; 4], unit: f32, rows: u32, canvas: &mut Canvas<'_>) {
    match shape(corners) {
        Shape::Convex(sign) => large(corners, Some(sign), unit, rows, canvas),
        Shape::Other => {
            let ((left, right), (top, bottom)) = (bounds(corners.map(|c| c.x)), bounds(corners.map(|c| c.y)));
            // Vertices lie within +-LIMIT, so differences fit.
            let small = (right - left).max(bottom - top) <= LONGEST_SIDE;
            for triangle in triangles(corners).into_iter().rev() {
                let rows = rows & canvas.open & rows_of(&triangle, canvas);
                let sign = turn(triangle[0], triangle[1], triangle[2]).signum();
                if rows == 0 || sign == 0 {
                    continue;
                }
                if small {
                    kernel.fill(&Piece::triangle(&triangle, if sign > 0 { 1 } else { -1 }), rows, canvas);
                } else {
                    large(&triangle, None, unit, rows, canvas);
                }
            }
        }
    }
}

/// The rows of the canvas that a polygon meets.
fn rows_of(corners: &[Corner; 4], canvas: &Canvas<'_>) -> u32 {
    let (top, bottom) = bounds(corners.map(|c| c.y));
    let from_first = |y: i32| (first_row(y) - i64::from(canvas.first)).clamp(0, i64::from(u32::BITS));
    #[expect(clippy::cast_possible_truncation, reason = "32 bits are kept of 64")]
    let below = |row: i64| (u64::from(u32::MAX) << row) as u32;
    below(from_first(top)) & !below(from_first(bottom))
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

/// What a row meets of a convex polygon: pixels `[first, end)`, and the crossings at either side.
struct Span {
    first: usize,
    end: usize,
    left: Crossing,
    right: Crossing,
    /// Lattice y of the row's centres.
    y: f64,
}

/// A polygon with sides that are long: row by row between its exact crossings, linear in as many pieces as the tolerance asks for.
fn large(corners: &[Corner; 4], convex: Option<i8>, unit: f32, rows: u32, canvas: &mut Canvas<'_>) {
    let bent = convex.map(|sign| {
        let patch = Patch::new(corners, sign);
        // NaN where the area is lost in f64: the largest number of pieces.
        let pieces = (patch.linear_error(unit) / TOLERANCE).sqrt();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "float to integer saturates, and NaN is taken out")]
        let pieces = if pieces.is_nan() { MANY } else { (pieces.ceil() as usize).clamp(1, MANY) };
        (patch, pieces)
    });
    let range = canvas.first + rows.trailing_zeros()..canvas.first + (u32::BITS - rows.leading_zeros());
    edge::walk(corners, range, |row, a, b| {
        if rows >> (row - canvas.first) & 1 == 1
            && let Some(span) = span(a, b, row_centre(row), canvas.width)
        {
            match &bent {
                Some((patch, pieces)) if *pieces > 1 => span.bent(row, patch, *pieces, canvas),
                _ => span.straight(row, canvas),
            }
        }
    });
}

fn span(a: Crossing, b: Crossing, y: i64, width: usize) -> Option<Span> {
    let (left, right) = if a.pixel <= b.pixel { (a, b) } else { (b, a) };
    let clip = |pixel: i64| usize::try_from(pixel.max(0)).unwrap_or(0).min(width);
    let (first, end) = (clip(left.pixel), clip(right.pixel));
    (first < end).then_some(Span { first, end, left, right, y: y as f64 })
}

impl Span {
    /// Linear from the left crossing to the right one.
    #[inline]
    fn straight(&self, row: u32, canvas: &mut Canvas<'_>) {
        paint(canvas, row, self.first..self.end, between(&self.left, &self.right, self.first));
    }

    /// Linear in pieces of equal breadth, between places where the patch is inverted; at every pixel where pieces would be shorter than two.
    fn bent(&self, row: u32, patch: &Patch, pieces: usize, canvas: &mut Canvas<'_>) {
        if self.end - self.first < 2 * pieces {
            for pixel in self.first..self.end {
                let at = self.inverse(patch, column_centre(pixel));
                paint(canvas, row, pixel..pixel + 1, line((at.u, at.v), (0.0, 0.0)));
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
                paint(canvas, row, first..end, between(&from, &to, first));
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

/// Paints a run of pixels.
fn paint(canvas: &mut Canvas<'_>, row: u32, pixels: Range<usize>, line: Line) {
    let index = (row - canvas.first) as usize;
    let start = index * canvas.pitch;
    let (u, v) = (&mut canvas.u[start..][pixels.clone()], &mut canvas.v[start..][pixels]);
    let (mut k, mut painted) = (0.0, 0);
    for (u, v) in u.iter_mut().zip(v) {
        if canvas.over || *u == BARE {
            *u = line.u + k * line.du;
            *v = line.v + k * line.dv;
            painted += 1;
        }
        k += 1.0;
    }
    canvas.count(index, painted);
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
