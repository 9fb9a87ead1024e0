//! Draws single cells of any shape, in drawing order. A convex cell is its bilinear patch; every
//! other cell is two triangles, each affine. Most cells are drawn in lanes (`kernel::cells`); cells
//! with longer sides are drawn row by row in double precision, between the exact crossings of their
//! edges. Writes sampler coordinates into rows of pixels. Cost: O(rows touched + pixels painted)
//! per cell.

use std::cmp::Ordering;
use std::ops::Range;

use super::edge::{self, Crossing};
use super::kernel::{CellBlock, Kernel, Piece, Raster, UNCOVERED};
use super::patch::{PATCH_TOLERANCE_PX, Patch, Shape, shape, turn};
use super::snapped_grid::{
    BLOCK_COLUMNS, Corner, SnappedGrid, column_centre, first_row, row_centre,
};
use super::subdivided_cells::SnappedSubdividedCell;
use crate::geometry::Point;

/// Blocks of cells after which the uncovered pixels are counted again.
const BLOCKS_PER_LOOK: usize = 16;

/// Draws a row of cells, last cell first, into the open rows: in each block the cells whose bits
/// are set, and of these the rows of their column.
pub(super) fn draw_row(
    kernel: Kernel,
    lattice: &SnappedGrid,
    j: usize,
    blocks: impl Fn(usize) -> u8,
    column: impl Fn(usize) -> u32,
    rows: &Range<u32>,
    raster: &mut Raster<'_>,
) {
    let (mut seen, mut parts) = (CellBlock::default(), PartBlock::default());
    for (n, b) in (0..lattice.blocks()).rev().enumerate() {
        if n % BLOCKS_PER_LOOK == 0 {
            raster.shrink();
        }
        let mut cells = blocks(b);
        if cells == 0 || !lattice.block_touches(j, b, rows) {
            continue;
        }
        if cells & !lattice.fine.in_block(j, b) != 0 {
            kernel.classify(lattice, j, b, raster, &mut seen);
        }
        while cells != 0 {
            let k = cells.ilog2() as usize;
            cells &= !(1 << k);
            let i = b * BLOCK_COLUMNS + k;
            if let Some(cell) = lattice.fine.find(i, j) {
                let beside = cells
                    .checked_ilog2()
                    .map(|k| b * BLOCK_COLUMNS + k as usize);
                let beside = beside.and_then(|i| lattice.fine.find(i, j));
                draw_fine(
                    kernel,
                    lattice,
                    (cell, beside),
                    column(i),
                    &mut parts,
                    raster,
                );
                continue;
            }
            let rows = seen.rows[k] & raster.open & column(i);
            if rows == 0 {
                continue;
            }
            if seen.convex[k] == 0 {
                draw(kernel, &lattice.corners(i, j), lattice, rows, raster);
            } else {
                kernel.fill(&Piece::cell(&seen, k, lattice, (i, j)), rows, raster);
            }
        }
    }
}

/// Draws one cell, in the open rows whose bits are set.
pub(super) fn draw_cell(
    kernel: Kernel,
    lattice: &SnappedGrid,
    (i, j): (usize, usize),
    rows: u32,
    raster: &mut Raster<'_>,
) {
    match lattice.fine.find(i, j) {
        Some(cell) => {
            let mut parts = PartBlock::default();
            draw_fine(kernel, lattice, (cell, None), rows, &mut parts, raster);
        }
        None => draw_part(kernel, &lattice.corners(i, j), lattice, rows, raster),
    }
}

/// Smaller cells of subdivided ones, classified together.
struct PartBlock {
    /// Where the corners of the subdivided cells in either half begin, if they are halved once.
    starts: [Option<usize>; 2],
    corners: [[Corner; 4]; BLOCK_COLUMNS],
    seen: CellBlock,
}

/// The smaller cells of a cell that is halved once.
const HALVED_PARTS: usize = 4;

impl Default for PartBlock {
    fn default() -> Self {
        Self {
            starts: [None; 2],
            corners: [[Corner::default(); 4]; BLOCK_COLUMNS],
            seen: CellBlock::default(),
        }
    }
}

impl PartBlock {
    /// Classifies the parts of a cell from the first one on, as many as there is room for; behind
    /// those of a cell that is halved once, the ones of another.
    fn classify(
        &mut self,
        kernel: Kernel,
        lattice: &SnappedGrid,
        (cell, beside): (&SnappedSubdividedCell, Option<&SnappedSubdividedCell>),
        first: usize,
        raster: &Raster<'_>,
    ) {
        let beside = beside.filter(|beside| cell.level == 1 && beside.level == 1);
        self.starts = [
            (cell.level == 1).then_some(cell.start),
            beside.map(|cell| cell.start),
        ];
        let parts = BLOCK_COLUMNS.min(1 << (2 * cell.level));
        for (k, corners) in self.corners[..parts].iter_mut().enumerate() {
            *corners = lattice.fine.part(cell, first + k);
        }
        if let Some(beside) = beside {
            for (k, corners) in self.corners[HALVED_PARTS..].iter_mut().enumerate() {
                *corners = lattice.fine.part(beside, k);
            }
        }
        kernel.classify_parts(&self.corners, lattice, raster, &mut self.seen);
    }

    /// Draws some of the parts, in the rows whose bits are set.
    fn draw(
        &self,
        kernel: Kernel,
        lattice: &SnappedGrid,
        parts: Range<usize>,
        rows: u32,
        raster: &mut Raster<'_>,
    ) {
        let (first, last) = (parts.start, parts.end - 1);
        for k in parts {
            let k = if raster.over { k } else { first + (last - k) };
            let rows = self.seen.rows[k] & raster.open & rows;
            if rows == 0 {
                continue;
            }
            let corners @ [a, b, _, d] = &self.corners[k];
            if self.seen.convex[k] == 0 {
                draw(kernel, corners, lattice, rows, raster);
            } else {
                let piece = Piece::lane(&self.seen, k, *a, (b.u - a.u, d.v - a.v), || *corners);
                kernel.fill(&piece, rows, raster);
            }
        }
    }
}

/// Draws a subdivided cell as smaller ones, in the rows whose bits are set. `beside`: the one that
/// may come next.
fn draw_fine(
    kernel: Kernel,
    lattice: &SnappedGrid,
    (cell, beside): (&SnappedSubdividedCell, Option<&SnappedSubdividedCell>),
    rows: u32,
    parts: &mut PartBlock,
    raster: &mut Raster<'_>,
) {
    if rows & raster.open & rows_between(cell.y.top, cell.y.bottom, raster) == 0 {
        return;
    }
    let slivers = |raster: &mut Raster<'_>| {
        for [a, b, c] in lattice.fine.slivers(cell, raster.over) {
            draw_triangle(kernel, &[a, b, c, c], lattice, rows, raster);
        }
    };
    if raster.over {
        slivers(raster);
    }
    if cell.level == 1 {
        let half = match parts
            .starts
            .iter()
            .position(|start| *start == Some(cell.start))
        {
            Some(half) => half,
            None => {
                parts.classify(kernel, lattice, (cell, beside), 0, raster);
                0
            }
        };
        let first = half * HALVED_PARTS;
        parts.draw(kernel, lattice, first..first + HALVED_PARTS, rows, raster);
    } else {
        let blocks = (1_usize << (2 * cell.level)) / BLOCK_COLUMNS;
        for block in 0..blocks {
            let block = if raster.over {
                block
            } else {
                blocks - 1 - block
            };
            parts.classify(kernel, lattice, (cell, None), block * BLOCK_COLUMNS, raster);
            parts.draw(kernel, lattice, 0..BLOCK_COLUMNS, rows, raster);
        }
    }
    if !raster.over {
        slivers(raster);
    }
}

/// Draws one quad into the open rows.
pub(super) fn draw_single(
    kernel: Kernel,
    corners: &[Corner; 4],
    lattice: &SnappedGrid,
    raster: &mut Raster<'_>,
) {
    draw_part(kernel, corners, lattice, u32::MAX, raster);
}

/// Draws a quad of any shape, in the rows whose bits are set.
fn draw_part(
    kernel: Kernel,
    corners: &[Corner; 4],
    lattice: &SnappedGrid,
    rows: u32,
    raster: &mut Raster<'_>,
) {
    let rows = rows & raster.open & rows_of(corners, raster);
    if rows == 0 {
        return;
    }
    match Piece::patch(corners, lattice.longest_side, lattice.unit) {
        Some(piece) => kernel.fill(&piece, rows, raster),
        None => draw(kernel, corners, lattice, rows, raster),
    }
}

/// Draws a cell that is not convex or has long sides.
fn draw(
    kernel: Kernel,
    corners: &[Corner; 4],
    lattice: &SnappedGrid,
    rows: u32,
    raster: &mut Raster<'_>,
) {
    match shape(corners) {
        Shape::Convex(sign) => large(
            corners,
            Some(Patch::new(corners, sign)),
            lattice.unit,
            rows,
            raster,
        ),
        Shape::Other => {
            for triangle in triangles(corners).into_iter().rev() {
                draw_triangle(kernel, &triangle, lattice, rows, raster);
            }
        }
    }
}

/// Draws a triangle, which repeats its last corner.
fn draw_triangle(
    kernel: Kernel,
    triangle: &[Corner; 4],
    lattice: &SnappedGrid,
    rows: u32,
    raster: &mut Raster<'_>,
) {
    let rows = rows & raster.open & rows_of(triangle, raster);
    let sign = turn(triangle[0], triangle[1], triangle[2]).signum();
    if rows == 0 || sign == 0 {
        return;
    }
    let ((left, right), (top, bottom)) =
        (bounds(triangle.map(|c| c.x)), bounds(triangle.map(|c| c.y)));
    // Vertices lie within +-LIMIT, so differences do not overflow.
    if (right - left).max(bottom - top) <= lattice.longest_side {
        kernel.fill(
            &Piece::triangle(triangle, if sign > 0 { 1 } else { -1 }),
            rows,
            raster,
        );
    } else {
        large(triangle, None, lattice.unit, rows, raster);
    }
}

/// The rows of the raster that a polygon meets.
fn rows_of(corners: &[Corner; 4], raster: &Raster<'_>) -> u32 {
    let (top, bottom) = bounds(corners.map(|c| c.y));
    rows_between(top, bottom, raster)
}

/// The rows of the raster whose centres lie between two lattice y.
fn rows_between(top: i32, bottom: i32, raster: &Raster<'_>) -> u32 {
    let from_first =
        |y: i32| (first_row(y) - i64::from(raster.first)).clamp(0, i64::from(u32::BITS));
    #[expect(clippy::cast_possible_truncation, reason = "32 bits are kept of 64")]
    let below = |row: i64| (u64::from(u32::MAX) << row) as u32;
    below(from_first(top)) & !below(from_first(bottom))
}

/// Splits a cell that is not convex along the diagonal 00-11, unless only the other diagonal gives
/// two triangles of one orientation (a dart with its notch at 10 or 01). Triangles repeat their
/// last corner.
fn triangles([a, b, c, d]: &[Corner; 4]) -> [[Corner; 4]; 2] {
    let same = |p: i64, q: i64| p.signum() * q.signum() >= 0;
    if !same(turn(*a, *b, *c), turn(*a, *c, *d)) && same(turn(*a, *b, *d), turn(*b, *c, *d)) {
        [[*a, *b, *d, *d], [*b, *c, *d, *d]]
    } else {
        [[*a, *b, *c, *c], [*a, *c, *d, *d]]
    }
}

fn bounds<const N: usize>(places: [i32; N]) -> (i32, i32) {
    places.iter().fold((i32::MAX, i32::MIN), |(low, high), &p| {
        (low.min(p), high.max(p))
    })
}

/// Draws a polygon with long sides row by row between its exact crossings. Coordinates are linear
/// along the row, or the exact inverse of the patch where that differs too much.
fn large(
    corners: &[Corner; 4],
    patch: Option<Patch>,
    unit: f32,
    rows: u32,
    raster: &mut Raster<'_>,
) {
    // If the area vanishes in f64, the error is NaN and the patch is used.
    let patch = patch.filter(|patch| {
        patch
            .linear_error(unit)
            .partial_cmp(&PATCH_TOLERANCE_PX)
            .is_none_or(Ordering::is_gt)
    });
    let range =
        raster.first + rows.trailing_zeros()..raster.first + (u32::BITS - rows.leading_zeros());
    edge::walk(corners, range, |row, a, b| {
        if rows >> (row - raster.first) & 1 == 0 {
            return;
        }
        let (left, right) = if a.pixel <= b.pixel { (a, b) } else { (b, a) };
        let clip = |pixel: i64| usize::try_from(pixel.max(0)).unwrap_or(0).min(raster.width);
        let (first, end) = (clip(left.pixel), clip(right.pixel));
        if first >= end {
            return;
        }
        if let Some(patch) = &patch {
            let y = row_centre(row) as f64;
            paint(raster, row, first..end, |pixel| {
                patch.inverse(Point::new(column_centre(pixel), y))
            });
        } else {
            let along = RowLine::new(&left, &right);
            paint(raster, row, first..end, |pixel| along.at(pixel));
        }
    });
}

/// The line between two positions of a row.
struct RowLine {
    x: f64,
    per_step: f64,
    u: [f64; 2],
    v: [f64; 2],
}

impl RowLine {
    fn new(left: &Crossing, right: &Crossing) -> Self {
        let breadth = right.x - left.x;
        // Crossings that only integers can distinguish: one position.
        let per_step = if breadth > 0.0 { 1.0 / breadth } else { 0.0 };
        Self {
            x: left.x,
            per_step,
            u: [left.u, right.u - left.u],
            v: [left.v, right.v - left.v],
        }
    }

    fn at(&self, pixel: usize) -> (f64, f64) {
        // Between 0 and 1 except for rounding, which a very short breadth would magnify.
        let share = ((column_centre(pixel) - self.x) * self.per_step).clamp(0.0, 1.0);
        (self.u[0] + share * self.u[1], self.v[0] + share * self.v[1])
    }
}

/// Paints a run of pixels, each at its own position.
fn paint(
    raster: &mut Raster<'_>,
    row: u32,
    pixels: Range<usize>,
    place: impl Fn(usize) -> (f64, f64),
) {
    let index = (row - raster.first) as usize;
    let start = index * raster.pitch;
    let pixels = if raster.over {
        pixels
    } else {
        pixels.start.max(raster.uncovered[index].start)..pixels.end.min(raster.uncovered[index].end)
    };
    if pixels.is_empty() {
        return;
    }
    let (u, v) = (
        &mut raster.u[start..][pixels.clone()],
        &mut raster.v[start..][pixels.clone()],
    );
    for (pixel, (u, v)) in pixels.zip(u.iter_mut().zip(v)) {
        if raster.over || *u == UNCOVERED {
            let at = place(pixel);
            #[expect(
                clippy::cast_possible_truncation,
                reason = "sampler coordinates are f32"
            )]
            ((*u, *v) = (at.0 as f32, at.1 as f32));
        }
    }
}
