//! Blocks of cells before they are drawn: which rows of pixels each cell meets, whether it is
//! convex, and the input of its piece. Eight cells at once, in loops without branches.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "rows and columns that vertices reach lie below 2^21"
)]
#![expect(clippy::cast_precision_loss, reason = "sides have at most 15 bits")]
#![expect(
    clippy::inline_always,
    reason = "instruction sets are chosen by the caller into which these are inlined"
)]

use super::cells::{CellMap, Near, Piece, Raster, Root, edge_between, first_pixel, side};
use crate::render::snapped_grid::{
    BLOCK_COLUMNS, Corner, HALF_PX, PX_PER_STEP, STEPS_PER_PX, SnappedGrid,
};

/// The classification of a block of cells.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::render) struct CellBlock {
    /// The open rows of the raster that each cell meets, one bit each.
    pub(in crate::render) rows: [u32; BLOCK_COLUMNS],
    /// The sign of the area if a cell is strictly convex and its sides are short enough for lanes,
    /// else 0.
    pub(in crate::render) convex: [i32; BLOCK_COLUMNS],
    /// Input of convex cells' pieces: [`Near`] if it is accurate, the pixels that they can reach,
    /// and their edges.
    near: [[f32; BLOCK_COLUMNS]; 8],
    is_near: [bool; BLOCK_COLUMNS],
    pixels: [[i32; BLOCK_COLUMNS]; 2],
    edges: [[[i32; BLOCK_COLUMNS]; 3]; 4],
}

/// The cross product of b - a and c - b, lattice steps squared; meaningless if the cell is not
/// small.
#[inline(always)]
fn turn(ax: i32, ay: i32, bx: i32, by: i32, cx: i32, cy: i32) -> i32 {
    let (px, py, qx, qy) = (
        bx.wrapping_sub(ax),
        by.wrapping_sub(ay),
        cx.wrapping_sub(bx),
        cy.wrapping_sub(by),
    );
    px.wrapping_mul(qy).wrapping_sub(py.wrapping_mul(qx))
}

/// Classifies the cells of block `b` of row `j`.
#[inline(always)]
pub(super) fn classify(
    lattice: &SnappedGrid,
    j: usize,
    b: usize,
    raster: &Raster<'_>,
    seen: &mut CellBlock,
) {
    let at = j * lattice.pitch + b * BLOCK_COLUMNS;
    let line = |places: &[i32], at: usize| -> ([i32; BLOCK_COLUMNS], [i32; BLOCK_COLUMNS]) {
        let places = &places[at..=at + BLOCK_COLUMNS];
        (
            places[..BLOCK_COLUMNS].try_into().expect("a block"),
            places[1..].try_into().expect("a block"),
        )
    };
    let ((ax, bx), (dx, cx)) = (line(&lattice.x, at), line(&lattice.x, at + lattice.pitch));
    let ((ay, by), (dy, cy)) = (line(&lattice.y, at), line(&lattice.y, at + lattice.pitch));
    let u = &lattice.u[b * BLOCK_COLUMNS..=(b + 1) * BLOCK_COLUMNS];
    let mut du = [0.0; BLOCK_COLUMNS];
    for k in 0..BLOCK_COLUMNS {
        du[k] = u[k + 1] - u[k];
    }
    let lanes = Lanes {
        x: [ax, bx, cx, dx],
        y: [ay, by, cy, dy],
        du,
        dv: [lattice.v[j + 1] - lattice.v[j]; BLOCK_COLUMNS],
    };
    classify_lanes(&lanes, lattice, raster, seen);
}

/// Classifies single cells.
#[inline(always)]
pub(super) fn classify_parts(
    parts: &[[Corner; 4]; BLOCK_COLUMNS],
    lattice: &SnappedGrid,
    raster: &Raster<'_>,
    seen: &mut CellBlock,
) {
    let mut lanes = Lanes::default();
    for (k, corners) in parts.iter().enumerate() {
        for (n, corner) in corners.iter().enumerate() {
            lanes.x[n][k] = corner.x;
            lanes.y[n][k] = corner.y;
        }
        lanes.du[k] = corners[1].u - corners[0].u;
        lanes.dv[k] = corners[3].v - corners[0].v;
    }
    classify_lanes(&lanes, lattice, raster, seen);
}

/// Cells side by side: the positions of their corners in the order 00, 10, 11, 01, and what they
/// span of the sampler's coordinates.
#[derive(Default)]
struct Lanes {
    x: [[i32; BLOCK_COLUMNS]; 4],
    y: [[i32; BLOCK_COLUMNS]; 4],
    du: [f32; BLOCK_COLUMNS],
    dv: [f32; BLOCK_COLUMNS],
}

#[inline(always)]
fn classify_lanes(lanes: &Lanes, lattice: &SnappedGrid, raster: &Raster<'_>, seen: &mut CellBlock) {
    let ([ax, bx, cx, dx], [ay, by, cy, dy]) = (&lanes.x, &lanes.y);
    // y of the centres of the raster's first row, and x of its right edge, in steps.
    let (first, right_end) = (
        raster.first as i32 * STEPS_PER_PX + HALF_PX,
        raster.width as i32 * STEPS_PER_PX,
    );
    for k in 0..BLOCK_COLUMNS {
        let (left, right_side) = (
            ax[k].min(bx[k]).min(cx[k].min(dx[k])),
            ax[k].max(bx[k]).max(cx[k].max(dx[k])),
        );
        let (top, bottom) = (
            ay[k].min(by[k]).min(cy[k].min(dy[k])),
            ay[k].max(by[k]).max(cy[k].max(dy[k])),
        );
        // The first row whose centre is not above y, relative to the raster's first.
        let row = |y: i32| {
            ((y - first + (STEPS_PER_PX - 1)) >> STEPS_PER_PX.trailing_zeros()).clamp(0, 32) as u64
        };
        let below = |row: u64| (0xffff_ffff_u64 << row) as u32;
        // Rows between the highest and the lowest corner, as bits: a cell of few pixels usually
        // meets one or two of 32.
        let rows = below(row(top)) & !below(row(bottom)) & raster.open;
        seen.rows[k] = if (right_side > 0) & (left < right_end) {
            rows
        } else {
            0
        };
        // See `Piece::patch`: beyond this, products wrap. Lanes cannot return early, so they
        // compute on and the result is dropped.
        let small = (right_side - left).max(bottom - top) <= lattice.longest_side;
        let turns = [
            turn(dx[k], dy[k], ax[k], ay[k], bx[k], by[k]),
            turn(ax[k], ay[k], bx[k], by[k], cx[k], cy[k]),
            turn(bx[k], by[k], cx[k], cy[k], dx[k], dy[k]),
            turn(cx[k], cy[k], dx[k], dy[k], ax[k], ay[k]),
        ];
        let right = (turns[0] > 0) & (turns[1] > 0) & (turns[2] > 0) & (turns[3] > 0) & small;
        let flipped = (turns[0] < 0) & (turns[1] < 0) & (turns[2] < 0) & (turns[3] < 0) & small;
        seen.convex[k] = i32::from(right) - i32::from(flipped);
        seen.pixels[0][k] = first_pixel(left);
        seen.pixels[1][k] = first_pixel(right_side);
    }
    // Most blocks of a strip meet none of its open rows. What follows costs several times as much.
    if seen.rows.iter().all(|&rows| rows == 0) {
        return;
    }
    for k in 0..BLOCK_COLUMNS {
        let (a, b, c, d) = (
            [ax[k], ay[k]],
            [bx[k], by[k]],
            [cx[k], cy[k]],
            [dx[k], dy[k]],
        );
        let side = |a: [i32; 2], b: [i32; 2]| {
            [
                b[0].wrapping_sub(a[0]) as f32 * PX_PER_STEP,
                b[1].wrapping_sub(a[1]) as f32 * PX_PER_STEP,
            ]
        };
        let (e, f, e1) = (side(a, b), side(a, d), side(d, c));
        let near = Near::new(e, f, [e1[0] - e[0], e1[1] - e[1]]);
        seen.is_near[k] = near.is_accurate(lanes.du[k], lanes.dv[k], lattice.unit);
        let [s, t, twist] = [near.s, near.t, [near.twist[0], near.twist[1], 0.0]];
        for (lanes, value) in seen
            .near
            .iter_mut()
            .zip([s[0], s[1], s[2], t[0], t[1], t[2], twist[0], twist[1]])
        {
            lanes[k] = value;
        }
        for (lanes, (from, to)) in seen.edges.iter_mut().zip([(a, b), (b, c), (c, d), (d, a)]) {
            for (lanes, value) in lanes
                .iter_mut()
                .zip(edge_between(from, to, a, seen.convex[k]))
            {
                lanes[k] = value;
            }
        }
    }
}

impl Piece {
    /// Cell `k` of a classified block, `(i, j)` of the lattice; it must be convex there.
    #[inline(always)]
    pub(in crate::render) fn cell(
        seen: &CellBlock,
        k: usize,
        lattice: &SnappedGrid,
        (i, j): (usize, usize),
    ) -> Self {
        // Not all corners: an array of them would be written to memory in small parts and read in
        // larger ones, which waits.
        let a = lattice.corner(i, j);
        let spans = (lattice.u[i + 1] - a.u, lattice.v[j + 1] - a.v);
        Self::lane(seen, k, a, spans, || lattice.corners(i, j))
    }

    /// Cell `k` of a classified block, which begins at a corner and spans that much of the
    /// sampler's coordinates; it must be convex there.
    #[inline(always)]
    pub(in crate::render) fn lane(
        seen: &CellBlock,
        k: usize,
        a: Corner,
        (du, dv): (f32, f32),
        corners: impl FnOnce() -> [Corner; 4],
    ) -> Self {
        // Two maps from the position to s and t: a patch that is nearly a parallelogram needs no
        // root. Which one was chosen must not depend on lanes, so `classify` decides for both
        // kernels.
        let (map, u, v) = if seen.is_near[k] {
            let [s0, s1, s2, t0, t1, t2, ds, dt] = std::array::from_fn(|n| seen.near[n][k]);
            (
                CellMap::Near(Near {
                    s: [s0, s1, s2],
                    t: [t0, t1, t2],
                    twist: [ds, dt],
                    is_wide: true,
                }),
                a.u + 0.5 * du,
                a.v + 0.5 * dv,
            )
        } else {
            let [a, b, c, d] = &corners();
            let (e, f, e1) = (side(a, b), side(a, d), side(d, c));
            (
                CellMap::Root(Root::new(
                    e,
                    f,
                    [e1[0] - e[0], e1[1] - e[1]],
                    seen.convex[k],
                )),
                a.u,
                a.v,
            )
        };
        Self {
            x: a.x,
            y: a.y,
            pixels: [seen.pixels[0][k], seen.pixels[1][k]],
            edges: std::array::from_fn(|e| std::array::from_fn(|n| seen.edges[e][n][k])),
            map,
            u: [u, du, 0.0],
            v: [v, 0.0, dv],
        }
    }
}
