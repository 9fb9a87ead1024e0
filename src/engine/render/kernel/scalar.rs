//! The reference kernels, which define every result. Snapping: f64 to the nearest 1/256 px. Column
//! crossings: f32. Bilinear samples: integers (`bilinear`). The functions are inlined so that
//! `avx2` can compile them again for wider registers.

#![expect(
    clippy::cast_possible_truncation,
    reason = "values are clamped to their range before they are narrowed"
)]
#![expect(
    clippy::inline_always,
    reason = "instruction sets are chosen by the caller into which these are inlined"
)]

use std::ops::Range;

#[cfg(target_arch = "x86_64")]
pub(super) use super::bilinear::blend;
#[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
pub(super) use super::bilinear::sample;
pub(in crate::render) use super::bilinear::{ROUND_SAMPLE, fixed};
pub(super) use super::cell_block::{classify, classify_parts};
pub(super) use super::cells::fill;
pub(super) use super::footprints::{footprints, positions, shapes, unmark};
pub(super) use super::rounding::ROUND_F32;
use super::rounding::ROUNDING_SUMMAND;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
pub(super) use super::simd128::sample;
use crate::render::snapped_grid::{BLOCK_COLUMNS, MAX_STEPS, PX_PER_STEP, SnappedGrid, YRange};

/// Pixels that are written together.
const LANES: usize = 8;

#[inline(always)]
pub(super) fn snap(
    rest_x: &[f64],
    rest_y: f64,
    displacement: &[[f32; 2]],
    scale: [f64; 2],
    x: &mut [i32],
    y: &mut [i32],
) {
    let limit = f64::from(MAX_STEPS);
    let snapped = |rest: f64, displacement: f32, scale: f64| {
        // Clamped, because a fold may throw a vertex anywhere; an edge to it keeps nearly its
        // direction.
        let place = ((rest + f64::from(displacement)) * scale)
            .max(-limit)
            .min(limit);
        // The summand moves the integer to the lowest bits of the f64: rounding to nearest even
        // without a conversion, alike at all levels.
        (place + ROUNDING_SUMMAND).to_bits() as i32
    };
    for (((x, y), rest), d) in x.iter_mut().zip(y).zip(rest_x).zip(displacement) {
        *x = snapped(*rest, d[0], scale[0]);
        *y = snapped(rest_y, d[1], scale[1]);
    }
}

/// The y that each block along a line reaches: by its vertices and the next one.
#[inline(always)]
pub(super) fn y_ranges(y: &[i32], y_ranges: &mut [YRange]) {
    for (b, range) in y_ranges.iter_mut().enumerate() {
        let block = block(&y[b * BLOCK_COLUMNS..]);
        // The last cell of a block ends at the first vertex of the next one.
        let right = y[(b * BLOCK_COLUMNS + BLOCK_COLUMNS).min(y.len() - 1)];
        let (top, bottom) = block.iter().fold((right, right), |(top, bottom), &y| {
            (top.min(y), bottom.max(y))
        });
        *range = YRange { top, bottom };
    }
}

/// A row of cells: its two lines of vertices, lattice steps, padded by one block beyond whole
/// blocks.
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct CellRow<'a> {
    pub(in crate::render) top: (&'a [i32], &'a [i32]),
    pub(in crate::render) bottom: (&'a [i32], &'a [i32]),
    /// The sampler's coordinate of each column.
    pub(in crate::render) u: &'a [f32],
    /// Height at rest, px of the sampled image.
    pub(in crate::render) height: f32,
    /// Px of the sampled image for one of `u`.
    pub(in crate::render) unit: f32,
    /// Largest error of drawn coordinates relative to the patch, px of the sampled image.
    pub(in crate::render) tolerance: f32,
}

/// The y at which the pixels in a row have their centres, px.
#[inline(always)]
pub(super) fn centre(row: u32) -> f32 {
    row as f32 + 0.5
}

#[inline(always)]
fn px(place: i32) -> f32 {
    place as f32 * PX_PER_STEP
}

#[inline(always)]
pub(super) fn bends(above: &CellRow<'_>, below: &CellRow<'_>, bends: &mut [f32]) {
    let (per_above, per_below) = (1.0 / above.height, 1.0 / below.height);
    let n = bends.len();
    let (x0, y0, x1, y1) = (
        &above.top.0[..n],
        &above.top.1[..n],
        &below.top.0[..n],
        &below.top.1[..n],
    );
    let (x2, y2) = (&below.bottom.0[..n], &below.bottom.1[..n]);
    for c in 0..n {
        let jump =
            |a: i32, b: i32, c: i32| (px(c) - px(b)) * per_below - (px(b) - px(a)) * per_above;
        // By how much the direction of a column changes at this line, per px of height: chords that
        // cross the line bend by it.
        let (x, y) = (jump(x0[c], x1[c], x2[c]), jump(y0[c], y1[c], y2[c]));
        bends[c] = x * x + y * y;
    }
}

/// The Jacobian of the posed by the rest position, of differences of the displacement along x and
/// y: x and y along x, x and y along y.
#[inline(always)]
pub(in crate::render) fn jacobian(
    along_x: [f32; 2],
    along_y: [f32; 2],
    [per_x, per_y]: [f32; 2],
) -> [f32; 4] {
    [
        1.0 + along_x[0] * per_x,
        along_x[1] * per_x,
        along_y[0] * per_y,
        1.0 + along_y[1] * per_y,
    ]
}

#[inline(always)]
pub(super) fn shrinks(
    (above, below): (&[[f32; 2]], &[[f32; 2]]),
    per: [f32; 2],
    least: f32,
    shrinking: &mut [u8],
) {
    let cells = above.iter().zip(&above[1..]).zip(below);
    for (shrinking, ((a, right), below)) in shrinking.iter_mut().zip(cells) {
        let [xx, yx, xy, yy] = jacobian(
            [right[0] - a[0], right[1] - a[1]],
            [below[0] - a[0], below[1] - a[1]],
            per,
        );
        let det = xx * yy - xy * yx;
        // Compared by squares and multiplied by the determinant: no root, no division, and a folded
        // cell, where it is 0, counts as shrinking.
        let limit = least * least * det * det;
        // A pixel of the target shows a parallelogram of the source: is a side of it too long?
        *shrinking = u8::from((yy * yy + yx * yx > limit) | (xx * xx + xy * xy > limit));
    }
}

/// The smallest area of a cell, as a share of its area at rest, at which crossings are used.
const LEAST_AREA: f32 = 0.02;
/// Coordinates beyond this are inexact in f32, px.
const FARTHEST_PX: f32 = 32_768.0;

/// A convex cell whose columns lead downwards: it lies between its columns, in order.
pub(in crate::render) const UPRIGHT: u8 = 1;
/// An upright cell that column crossings draw accurately.
pub(in crate::render) const SOUND: u8 = 2;
/// The most rows of cells that a row of pixels may cross between two neighbouring columns.
const STEEPEST_CROSSING_ROWS: f32 = 4.0;

/// A cell whose chords may cross more cells than its neighbours; [`steepness`] classifies it.
pub(in crate::render) const STEEP: u8 = 4;

/// Vectors from vertex to vertex, lattice steps: along a grid line, or along the columns of a row
/// of cells per px at rest.
#[derive(Clone, Debug, Default)]
pub(in crate::render) struct Edges {
    pub(in crate::render) x: Vec<f32>,
    pub(in crate::render) y: Vec<f32>,
}

/// `from` and `to` hold the positions of the vertices; the vectors are multiplied by `scale`.
#[inline(always)]
pub(super) fn edges(from: (&[i32], &[i32]), to: (&[i32], &[i32]), scale: f32, edges: &mut Edges) {
    for (edges, from, to) in [(&mut edges.x, from.0, to.0), (&mut edges.y, from.1, to.1)] {
        for ((edge, from), to) in edges.iter_mut().zip(from).zip(to) {
            // Positions lie within +-LIMIT, so differences do not overflow.
            *edge = to.wrapping_sub(*from) as f32 * scale;
        }
    }
}

/// A row of cells and its neighbours (itself at an end of the grid), as input of [`soundness`].
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct Neighbours<'a> {
    /// Lines above and below the previous row, this row, and the next row.
    pub(in crate::render) lines: [&'a Edges; 4],
    /// Columns of the same rows.
    pub(in crate::render) columns: [&'a Edges; 3],
    /// The least height of these rows at rest, px of the sampled image.
    pub(in crate::render) height: f32,
    /// The sampler's coordinate of each column.
    pub(in crate::render) u: &'a [f32],
    /// Px of the sampled image for one of `u`.
    pub(in crate::render) unit: f32,
    /// Largest error of drawn coordinates relative to the patch, px of the sampled image.
    pub(in crate::render) tolerance: f32,
}

/// How cells may be drawn: [`UPRIGHT`], [`SOUND`] and [`STEEP`].
///
/// A chord is drawn from a column, at the height V0 of the source, to the next one, at V1. Its
/// error relative to the patches that it crosses is `δ = λ (1 - λ) (V1 - V0) (B' - A')`, where A'
/// and B' are the derivatives of the two columns, each a mean over its side of λ. In a cell whose
/// chords cross at most one grid line, B' - A' is a mean of this cell's twist and of the difference
/// between one cell's column and the next cell's other column; each bounds the error of this cell's
/// pixels by `|ΔV| / 4 |cross(column, B' - A')| width / area` in u and
/// `|ΔV| / 4 |cross(line, B' - A')| / area` in v, with columns and area per px of height. The area
/// is the one in the middle, minus half of its decrease to one side, because `4 λ (1 - λ)`
/// decreases as well.
#[inline(always)]
pub(super) fn soundness(cells: &Neighbours<'_>, soundness: &mut [u8]) {
    let n = soundness.len();
    let lines = |k: usize| (&cells.lines[k].x[..n], &cells.lines[k].y[..n]);
    let columns = |k: usize| (&cells.columns[k].x[..=n], &cells.columns[k].y[..=n]);
    let ((_, over_y), (top_x, top_y), (bottom_x, bottom_y), (_, under_y)) =
        (lines(0), lines(1), lines(2), lines(3));
    let ((above_x, above_y), (here_x, here_y), (below_x, below_y)) =
        (columns(0), columns(1), columns(2));
    let u = &cells.u[..=n];
    let cross = |a: (f32, f32), b: (f32, f32)| a.0 * b.1 - a.1 * b.0;
    let least = |a: f32, b: f32| if a < b { a } else { b };
    let most = |a: f32, b: f32| if a > b { a } else { b };
    let minus = |a: (f32, f32), b: (f32, f32)| (a.0 - b.0, a.1 - b.1);
    let choose = |which: bool, a: (f32, f32), b: (f32, f32)| {
        (if which { a.0 } else { b.0 }, if which { a.1 } else { b.1 })
    };
    for c in 0..n {
        let (top, bottom) = ((top_x[c], top_y[c]), (bottom_x[c], bottom_y[c]));
        let (over_left, over_right) = ((above_x[c], above_y[c]), (above_x[c + 1], above_y[c + 1]));
        let (left, right) = ((here_x[c], here_y[c]), (here_x[c + 1], here_y[c + 1]));
        let (under_left, under_right) =
            ((below_x[c], below_y[c]), (below_x[c + 1], below_y[c + 1]));

        let (areas_top, areas_bottom) = (
            (cross(top, left), cross(top, right)),
            (cross(bottom, left), cross(bottom, right)),
        );
        let (least_top, least_bottom) = (
            least(areas_top.0, areas_top.1),
            least(areas_bottom.0, areas_bottom.1),
        );
        // Four times the area.
        let middle = least(
            2.0 * least_top + (areas_top.0 + areas_top.1),
            2.0 * least_bottom + (areas_bottom.0 + areas_bottom.1),
        );
        let width = (u[c + 1] - u[c]) * cells.unit;
        // All lengths in px of the sampled image; the columns are per px of height already.
        let fall = least(left.1, right.1);
        let slant = most(top.1.abs(), bottom.1.abs());
        let least_fall = least(
            fall,
            least(
                least(over_left.1, over_right.1),
                least(under_left.1, under_right.1),
            ),
        );
        let most_slant = most(slant, most(over_y[c].abs(), under_y[c].abs()));

        // The cell's own twist, and the difference of columns across a line. Where a line falls to
        // the right, a row comes from the cell below.
        let twist = minus(right, left);
        let across_top = choose(
            top.1 > 0.0,
            minus(over_right, left),
            minus(right, over_left),
        );
        let across_bottom = choose(
            bottom.1 > 0.0,
            minus(right, under_left),
            minus(under_right, left),
        );
        let off = |one: (f32, f32), other: (f32, f32), twist: (f32, f32)| {
            most(cross(one, twist).abs(), cross(other, twist).abs())
        };
        let off_u = most(
            cross(left, right).abs(),
            most(
                off(left, right, across_top),
                off(left, right, across_bottom),
            ),
        );
        let off_v = most(
            off(top, bottom, twist),
            most(
                off(top, bottom, across_top),
                off(top, bottom, across_bottom),
            ),
        );
        // The bound of the comment above, multiplied by its denominators: they are positive for
        // upright cells, and the others are dropped below.
        let near = slant * most(off_u * width, off_v) <= cells.tolerance * middle * least_fall;
        let upright = (least(least_top, least_bottom)
            > LEAST_AREA / (PX_PER_STEP * PX_PER_STEP) * width)
            & (fall > 0.0);
        // Its chords cross at most one line of the grid, also in the rows above and below: what the
        // bound requires.
        let flat = most_slant < least_fall * cells.height;
        soundness[c] = u8::from(upright)
            + u8::from(upright & flat & near)
            + if upright & !flat { STEEP } else { 0 };
    }
}

/// How steep cells may be drawn, whose chords may cross many cells. A cell is sound if it is not
/// too steep (|dt| rows of cells between columns) and the chord between its columns stays near its
/// patch: with r = |dt| (|d| + lines * height * bend) / 4 the distance of the chord in target px
/// (each grid line that it crosses bends it once), r |column| width / area and r |line| height /
/// area bound the error in u and v. All terms are squared and multiplied by the denominators.
#[inline(always)]
pub(super) fn steepness(cells: &CellRow<'_>, above: &[f32], below: &[f32], soundness: &mut [u8]) {
    let n = soundness.len();
    let (xa, ya) = (&cells.top.0[..=n], &cells.top.1[..=n]);
    let (xb, yb) = (&cells.bottom.0[..=n], &cells.bottom.1[..=n]);
    let (above, below, u) = (&above[..=n], &below[..=n], &cells.u[..=n]);
    let height2 = cells.height * cells.height;
    for c in 0..n {
        let (ax, ay, bx, by) = (px(xa[c]), px(ya[c]), px(xa[c + 1]), px(ya[c + 1]));
        let (dx, dy, cx, cy) = (px(xb[c]), px(yb[c]), px(xb[c + 1]), px(yb[c + 1]));
        let (top, bottom) = ((bx - ax, by - ay), (cx - dx, cy - dy));
        let (left, right) = ((dx - ax, dy - ay), (cx - bx, cy - by));
        let cross = |a: (f32, f32), b: (f32, f32)| a.0 * b.1 - a.1 * b.0;
        let least = |a: f32, b: f32| if a < b { a } else { b };
        let most = |a: f32, b: f32| if a > b { a } else { b };
        let norm2 = |a: (f32, f32)| a.0 * a.0 + a.1 * a.1;
        let area = least(
            least(cross(top, left), cross(top, right)),
            least(cross(bottom, left), cross(bottom, right)),
        );
        let width = (u[c + 1] - u[c]) * cells.unit;
        let fall = least(left.1, right.1);
        let slant = most(top.1.abs(), bottom.1.abs());
        let twist2 = norm2((right.0 - left.0, right.1 - left.1));
        let bend2 = most(most(above[c], above[c + 1]), most(below[c], below[c + 1]));
        let reach2 = most(
            most(norm2(left), norm2(right)) * (width * width),
            most(norm2(top), norm2(bottom)) * height2,
        );
        let fall2 = fall * fall;
        // Lines that a row of pixels crosses between the columns, times fall: one where |dt| < 1,
        // else at most 1 + |dt|.
        let lines = if slant < fall { fall } else { fall + slant };
        let off = slant * (twist2.sqrt() * fall + (height2 * bend2).sqrt() * lines);
        let near = off * off * reach2
            <= 16.0 * cells.tolerance * cells.tolerance * (area * area) * (fall2 * fall2);
        let far = most(
            most(most(ax.abs(), ay.abs()), most(bx.abs(), by.abs())),
            most(most(cx.abs(), cy.abs()), most(dx.abs(), dy.abs())),
        );
        let upright =
            (area > LEAST_AREA * width * cells.height) & (fall > 0.0) & (far < FARTHEST_PX);
        let sound = upright & (slant <= STEEPEST_CROSSING_ROWS * fall) & near;
        soundness[c] = u8::from(upright) + u8::from(sound);
    }
}

/// A block of values.
#[inline(always)]
fn block<T>(values: &[T]) -> &[T; BLOCK_COLUMNS] {
    values
        .first_chunk()
        .expect("arrays are padded to whole blocks")
}

#[inline(always)]
pub(super) fn crossings(lattice: &SnappedGrid, rows: Range<u32>, x: &mut [f32], v: &mut [f32]) {
    let blocks = lattice.pitch / BLOCK_COLUMNS;
    let stride = lattice.pitch + BLOCK_COLUMNS;
    for j in (0..lattice.rows - 1).filter(|&j| lattice.row_ranges[j].meets(&rows)) {
        let (top, fall) = (lattice.v[j], lattice.v[j + 1] - lattice.v[j]);
        for b in 0..blocks {
            let touched = lattice.block_ranges[j * blocks + b].rows(&rows);
            if touched.is_empty() {
                continue;
            }
            let at = j * lattice.pitch + b * BLOCK_COLUMNS;
            let (xa, ya) = (block(&lattice.x[at..]), block(&lattice.y[at..]));
            let (xb, yb) = (
                block(&lattice.x[at + lattice.pitch..]),
                block(&lattice.y[at + lattice.pitch..]),
            );
            let (mut x0, mut y0, mut y1) = (
                [0.0_f32; BLOCK_COLUMNS],
                [0.0_f32; BLOCK_COLUMNS],
                [0.0_f32; BLOCK_COLUMNS],
            );
            let (mut slope_x, mut slope_v) = ([0.0_f32; BLOCK_COLUMNS], [0.0_f32; BLOCK_COLUMNS]);
            for c in 0..BLOCK_COLUMNS {
                (x0[c], y0[c], y1[c]) = (px(xa[c]), px(ya[c]), px(yb[c]));
                let per_px = 1.0 / (y1[c] - y0[c]);
                slope_x[c] = (px(xb[c]) - x0[c]) * per_px;
                slope_v[c] = fall * per_px;
            }
            // A block reaches rows that only some of its columns cross. The others keep what they
            // have: the crossing of another row of cells.
            for row in touched {
                let at = (row - rows.start) as usize * stride + b * BLOCK_COLUMNS;
                let x: &mut [f32; BLOCK_COLUMNS] =
                    x[at..].first_chunk_mut().expect("a row has all blocks");
                let v: &mut [f32; BLOCK_COLUMNS] =
                    v[at..].first_chunk_mut().expect("a row has all blocks");
                let centre = centre(row);
                for c in 0..BLOCK_COLUMNS {
                    let below = centre - y0[c];
                    // Half open: a centre exactly on a line of vertices belongs to the cells below
                    // it, so two rows of cells never both claim it.
                    let crosses = (below >= 0.0) & (centre < y1[c]);
                    x[c] = if crosses {
                        x0[c] + below * slope_x[c]
                    } else {
                        x[c]
                    };
                    v[c] = if crosses {
                        top + below * slope_v[c]
                    } else {
                        v[c]
                    };
                }
            }
        }
    }
}

/// Input and buffers of the spans of a row.
#[derive(Debug)]
pub(in crate::render) struct Spans<'a> {
    /// Crossings of the columns, px.
    pub(in crate::render) x: &'a [f32],
    /// Coordinates there.
    pub(in crate::render) v: &'a [f32],
    /// The sampler's coordinate of each column.
    pub(in crate::render) u: &'a [f32],
    /// Number of columns.
    pub(in crate::render) columns: usize,
    /// Pixels of the target row.
    pub(in crate::render) width: usize,
    /// The covered pixels, exactly.
    pub(in crate::render) covered: Range<usize>,
    /// Output of [`note`]: see [`NOTES`].
    pub(in crate::render) notes: &'a mut [[f32; BLOCK_COLUMNS]],
    /// The first pixel of each span.
    pub(in crate::render) first: &'a mut [u32],
}

/// Values noted per span: u and v at the first pixel, and their steps.
pub(in crate::render) const NOTES: usize = 4;

/// The first pixel whose centre is not left of x, except for rounding; also as a float.
#[inline(always)]
fn first_pixel(x: f32, width: f32) -> (u32, f32) {
    let x = if x > 0.0 { x } else { 0.0 };
    let x = (if x < width { x } else { width }) + ROUND_F32;
    (x.to_bits() & 0x007f_ffff, x - ROUND_F32)
}

#[inline(always)]
pub(super) fn spans(spans: &mut Spans<'_>, u: &mut [f32], v: &mut [f32]) {
    note(spans);
    for c in 0..spans.columns - 1 {
        let (mut at, end) = (spans.first[c] as usize, spans.first[c + 1] as usize);
        let [nu, ndu, nv, ndv]: &[[f32; BLOCK_COLUMNS]; NOTES] =
            notes(spans.notes, c / BLOCK_COLUMNS);
        let c = c % BLOCK_COLUMNS;
        let (nu, ndu, nv, ndv) = (nu[c], ndu[c], nv[c], ndv[c]);
        let mut k = 0.0;
        while at < end {
            // Whole groups: values written beyond the end belong to later spans or lie outside.
            let (u, v): (&mut [f32; LANES], &mut [f32; LANES]) = (
                u[at..].first_chunk_mut().expect("there is slack"),
                v[at..].first_chunk_mut().expect("there is slack"),
            );
            for lane in 0..LANES {
                let k = k + lane as f32;
                u[lane] = nu + k * ndu;
                v[lane] = nv + k * ndv;
            }
            at += LANES;
            k += LANES as f32;
        }
    }
}

#[inline(always)]
fn notes(notes: &[[f32; BLOCK_COLUMNS]], block: usize) -> &[[f32; BLOCK_COLUMNS]; NOTES] {
    notes[block * NOTES..]
        .first_chunk()
        .expect("there is room for whole blocks")
}

/// Notes the first pixel of every span, and the coordinates there with their steps.
#[cfg_attr(not(optimized_for_size), inline(always))]
#[cfg_attr(optimized_for_size, inline(never))]
pub(super) fn note(spans: &mut Spans<'_>) {
    let width = spans.width as f32;
    for b in 0..spans.columns.div_ceil(BLOCK_COLUMNS) {
        let at = b * BLOCK_COLUMNS;
        let (x0, x1) = (block(&spans.x[at..]), block(&spans.x[at + 1..]));
        let (v0, v1) = (block(&spans.v[at..]), block(&spans.v[at + 1..]));
        let (u0, u1) = (block(&spans.u[at..]), block(&spans.u[at + 1..]));
        let first: &mut [u32; BLOCK_COLUMNS] = spans.first[at..]
            .first_chunk_mut()
            .expect("there is room for whole blocks");
        let [nu, ndu, nv, ndv]: &mut [[f32; BLOCK_COLUMNS]; NOTES] = spans.notes[b * NOTES..]
            .first_chunk_mut()
            .expect("there is room for whole blocks");
        for c in 0..BLOCK_COLUMNS {
            let (pixel, place) = first_pixel(x0[c], width);
            let per_px = 1.0 / (x1[c] - x0[c]);
            let (du, dv) = ((u1[c] - u0[c]) * per_px, (v1[c] - v0[c]) * per_px);
            let inside = place + 0.5 - x0[c];
            first[c] = pixel;
            (nu[c], ndu[c], nv[c], ndv[c]) = (u0[c] + inside * du, du, v0[c] + inside * dv, dv);
        }
    }
    pin_ends(spans);
}

/// Sets the ends of a run to their exact values, free of f32 errors.
#[inline(always)]
pub(super) fn pin_ends(spans: &mut Spans<'_>) {
    let inside = spans.covered.start as f32 + 0.5 - spans.x[0];
    spans.notes[0][0] = spans.u[0] + inside * spans.notes[1][0];
    spans.notes[2][0] = spans.v[0] + inside * spans.notes[3][0];
    spans.first[0] = spans.covered.start as u32;
    spans.first[spans.columns - 1] = spans.covered.end as u32;
}
