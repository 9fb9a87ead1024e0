//! Draws single cells in lanes. Exact integers decide which pixel centres a convex polygon contains
//! (the rule of `edge`); the closed inverse of the bilinear patch gives the source position of each
//! (`patch` derives the root). One branch-free loop over eight pixels of a row, which compilers
//! vectorise; f32 in a fixed order, so all levels give the same bits. Cost: O(rows * blocks of
//! pixels).

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

use std::ops::Range;

use crate::render::snapped_grid::{Corner, HALF_PX, PX_PER_STEP, STEPS_PER_PX, row_centre};

/// Pixels that are processed together.
pub(in crate::render) const LANES: usize = 8;

/// The u of uncovered pixels; no position has it.
pub(in crate::render) const UNCOVERED: f32 = f32::NEG_INFINITY;

/// Rows of pixels whose coordinates are drawn cell by cell.
#[derive(Debug)]
pub(in crate::render) struct Raster<'a> {
    /// The target row of the first row.
    pub(in crate::render) first: u32,
    /// Pixels of a row.
    pub(in crate::render) width: usize,
    /// Pixels from one row to the next: at least `width + LANES`, and none behind `width` is
    /// [`UNCOVERED`].
    pub(in crate::render) pitch: usize,
    pub(in crate::render) u: &'a mut [f32],
    pub(in crate::render) v: &'a mut [f32],
    /// Whether cells come in drawing order and overwrite earlier ones; otherwise they come in
    /// reverse order and fill uncovered pixels only.
    pub(in crate::render) over: bool,
    /// In each row, the range from the first to the last uncovered pixel.
    pub(in crate::render) uncovered: &'a mut [Range<usize>],
    /// Rows that may still be painted, one bit each: those with uncovered pixels.
    pub(in crate::render) open: u32,
}

impl Raster<'_> {
    /// Updates `uncovered` and `open` after painting. O(1) per pixel over all calls together, and
    /// per row and call.
    #[inline]
    pub(in crate::render) fn shrink(&mut self) {
        if self.over {
            return;
        }
        // The ranges only shrink, so each pixel is stepped over once in all calls together.
        let mut left = self.open;
        while left != 0 {
            let row = left.trailing_zeros() as usize;
            left &= left - 1;
            let (uncovered, u) = (&mut self.uncovered[row], &self.u[row * self.pitch..]);
            while uncovered.start < uncovered.end && u[uncovered.start] != UNCOVERED {
                uncovered.start += 1;
            }
            while uncovered.start < uncovered.end && u[uncovered.end - 1] != UNCOVERED {
                uncovered.end -= 1;
            }
            self.open &= !(u32::from(uncovered.start >= uncovered.end) << row);
        }
    }
}

/// A convex polygon (a triangle repeats its last corner) and the map of the source on it: the patch
/// of a cell, or affine.
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct Piece {
    /// The lattice origin of all other coordinates.
    pub(super) x: i32,
    pub(super) y: i32,
    /// The range of pixels of a row that it can reach.
    pub(super) pixels: [i32; 2],
    /// For each edge, the function `x X + y Y + c` that is not negative inside.
    pub(super) edges: [[i32; 3]; 4],
    pub(super) map: CellMap,
    /// Coordinates at the origin (for `CellMap::Near` at the middle), and their growth with s and
    /// t.
    pub(super) u: [f32; 3],
    pub(super) v: [f32; 3],
}

/// How s and t are computed.
#[derive(Clone, Copy, Debug)]
pub(super) enum CellMap {
    Near(Near),
    Root(Root),
}

/// Around the middle of a patch that is nearly affine, with s and t from -1/2 to 1/2:
/// `s = s0 - s t twist.0` and `t = t0 - s t twist.1`, solved by two substitutions; s0 and t0 are
/// the affine inverse, each `x X + y Y + c` in px.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    pub(super) s: [f32; 3],
    pub(super) t: [f32; 3],
    pub(super) twist: [f32; 2],
    /// The angle between the sides is large enough for single precision.
    pub(super) is_wide: bool,
}

/// The root of the quadratic of `patch`; e, f and d in px, `area = e x f`, `bend = -f x d`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Root {
    pub(super) e: [f32; 2],
    pub(super) f: [f32; 2],
    pub(super) d: [f32; 2],
    pub(super) area: f32,
    pub(super) bend: f32,
    pub(super) sign: f32,
}

/// Largest error of `Near`, px of the sampled image, times 16.
const NEAR_ERROR: f32 = 16.0 / 64.0;
/// The smallest squared sine between sides that single precision can use.
const NARROWEST_SQUARED_SINE: f32 = 1e-6;
/// Each substitution at least halves the remaining error.
const LARGEST_TWIST: f32 = 0.5;

impl Piece {
    /// The patch of a single cell; `None` if it is not strictly convex, or has a side longer than
    /// `longest_side`.
    #[inline(always)]
    pub(in crate::render) fn patch(
        corners: &[Corner; 4],
        longest_side: i32,
        unit: f32,
    ) -> Option<Self> {
        let [a, b, c, d] = corners;
        let (left, right) = (
            a.x.min(b.x).min(c.x.min(d.x)),
            a.x.max(b.x).max(c.x.max(d.x)),
        );
        let (top, bottom) = (
            a.y.min(b.y).min(c.y.min(d.y)),
            a.y.max(b.y).max(c.y.max(d.y)),
        );
        // Longer sides would overflow the products of two differences in 32 bits.
        if (right - left).max(bottom - top) > longest_side {
            return None;
        }
        let turn = |a: &Corner, b: &Corner, c: &Corner| {
            (b.x - a.x) * (c.y - b.y) - (b.y - a.y) * (c.x - b.x)
        };
        // Strictly convex if all four turns have one sign; only then has each position one pair of
        // s and t, and four edges bound the cell.
        let turns = [turn(d, a, b), turn(a, b, c), turn(b, c, d), turn(c, d, a)];
        let sign = i32::from(turns.iter().all(|&turn| turn > 0))
            - i32::from(turns.iter().all(|&turn| turn < 0));
        if sign == 0 {
            return None;
        }
        let (e, f, e1) = (side(a, b), side(a, d), side(d, c));
        let twist = [e1[0] - e[0], e1[1] - e[1]];
        let near = Near::new(e, f, twist);
        let (du, dv) = (b.u - a.u, d.v - a.v);
        // `Near` counts from the middle of the cell, where its error is smallest; `Root` from the
        // first corner.
        let (map, off) = if near.is_accurate(du, dv, unit) {
            (CellMap::Near(near), 0.5)
        } else {
            (CellMap::Root(Root::new(e, f, twist, sign)), 0.0)
        };
        let mut edges = [[0; 3]; 4];
        for k in 0..4 {
            edges[k] = edge(&corners[k], &corners[(k + 1) & 3], a, sign);
        }
        let pixels = [first_pixel(left), first_pixel(right)];
        Some(Self {
            x: a.x,
            y: a.y,
            pixels,
            edges,
            map,
            u: [a.u + off * du, du, 0.0],
            v: [a.v + off * dv, 0.0, dv],
        })
    }

    /// A triangle, which repeats its last corner.
    #[inline(always)]
    pub(in crate::render) fn triangle(corners: &[Corner; 4], sign: i32) -> Self {
        let [a, b, c, _] = corners;
        let (e, f, flat) = (side(a, b), side(a, c), [0.0, 0.0]);
        // A triangle is a patch without twist: the same code, and exactly affine.
        let near = Near::new(e, f, flat);
        let (map, off) = if near.is_wide {
            (CellMap::Near(near), 0.5)
        } else {
            (CellMap::Root(Root::new(e, f, flat, sign)), 0.0)
        };
        let along = |a: f32, b: f32, c: f32| [a + off * ((b - a) + (c - a)), b - a, c - a];
        let mut edges = [[0; 3]; 4];
        for k in 0..4 {
            edges[k] = edge(&corners[k], &corners[(k + 1) & 3], a, sign);
        }
        let [x0, x1, x2, _] = corners.map(|c| c.x);
        let pixels = [
            first_pixel(x0.min(x1).min(x2)),
            first_pixel(x0.max(x1).max(x2)),
        ];
        Self {
            x: a.x,
            y: a.y,
            pixels,
            edges,
            map,
            u: along(a.u, b.u, c.u),
            v: along(a.v, b.v, c.v),
        }
    }
}

/// The function that is not negative inside an edge, where the inside is on the right of `from` to
/// `to` if `sign` is 1.
#[inline(always)]
fn edge(from: &Corner, to: &Corner, origin: &Corner, sign: i32) -> [i32; 3] {
    edge_between([from.x, from.y], [to.x, to.y], [origin.x, origin.y], sign)
}

#[inline(always)]
pub(super) fn edge_between(from: [i32; 2], to: [i32; 2], origin: [i32; 2], sign: i32) -> [i32; 3] {
    let (dx, dy) = (
        (to[0].wrapping_sub(from[0])).wrapping_mul(sign),
        (to[1].wrapping_sub(from[1])).wrapping_mul(sign),
    );
    // Horizontal edges decide nothing: the rows of the polygon are known.
    let dx = if dy == 0 { 0 } else { dx };
    let (x, y) = (
        from[0].wrapping_sub(origin[0]),
        from[1].wrapping_sub(origin[1]),
    );
    // Two cells that share an edge must give each pixel on it to one of them: the left and upper
    // edge belong to a cell. One less makes `>= 0` strict on the others.
    // Pixels on a right edge are outside.
    [
        dy.wrapping_neg(),
        dx,
        x.wrapping_mul(dy)
            .wrapping_sub(y.wrapping_mul(dx))
            .wrapping_sub(i32::from(dy > 0)),
    ]
}

/// The first pixel whose centre is not left of x.
#[inline(always)]
pub(super) fn first_pixel(x: i32) -> i32 {
    x.wrapping_add(STEPS_PER_PX - 1 - HALF_PX) >> STEPS_PER_PX.trailing_zeros()
}

/// The vector between two corners, px.
#[inline(always)]
pub(super) fn side(from: &Corner, to: &Corner) -> [f32; 2] {
    [
        (to.x - from.x) as f32 * PX_PER_STEP,
        (to.y - from.y) as f32 * PX_PER_STEP,
    ]
}

impl Root {
    #[inline(always)]
    pub(super) fn new(e: [f32; 2], f: [f32; 2], d: [f32; 2], sign: i32) -> Self {
        Self {
            e,
            f,
            d,
            area: cross(e, f),
            bend: -cross(f, d),
            sign: sign as f32,
        }
    }
}

#[inline(always)]
fn norm2(a: [f32; 2]) -> f32 {
    a[0] * a[0] + a[1] * a[1]
}

#[inline(always)]
fn cross(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[1] - a[1] * b[0]
}

impl Near {
    #[inline(always)]
    pub(super) fn new(e: [f32; 2], f: [f32; 2], d: [f32; 2]) -> Self {
        // The sides in the middle of the patch: there the affine map agrees with the patch in value
        // and first derivative.
        let [middle_e, middle_f] = [e, f].map(|side| [side[0] + 0.5 * d[0], side[1] + 0.5 * d[1]]);
        let middle = [
            0.5 * (e[0] + f[0]) + 0.25 * d[0],
            0.5 * (e[1] + f[1]) + 0.25 * d[1],
        ];
        let area = cross(middle_e, middle_f);
        let per_area = 1.0 / area;
        let s = [middle_f[1] * per_area, -middle_f[0] * per_area];
        let t = [-middle_e[1] * per_area, middle_e[0] * per_area];
        Self {
            s: [s[0], s[1], -(s[0] * middle[0] + s[1] * middle[1])],
            t: [t[0], t[1], -(t[0] * middle[0] + t[1] * middle[1])],
            twist: [s[0] * d[0] + s[1] * d[1], t[0] * d[0] + t[1] * d[1]],
            is_wide: area * area > NARROWEST_SQUARED_SINE * (norm2(middle_e) * norm2(middle_f)),
        }
    }

    /// Whether two substitutions suffice for a cell that spans `du` and `dv`; false if the area
    /// vanishes.
    #[inline(always)]
    pub(super) fn is_accurate(&self, du: f32, dv: f32, unit: f32) -> bool {
        let [ds, dt] = self.twist.map(f32::abs);
        let (off_u, off_v, both) = (ds * du.abs(), dt * dv.abs(), ds + dt);
        // Each substitution multiplies the error by the twist; two leave its third power, in the
        // units of the larger coordinate.
        let off = (if off_u > off_v { off_u } else { off_v }) * (both * both);
        self.is_wide & (both < LARGEST_TWIST) & (off < NEAR_ERROR * unit)
    }
}

/// Draws a piece in the rows of the raster whose bits are set; all must lie between its highest and
/// its lowest corner.
#[inline(always)]
pub(super) fn fill(piece: &Piece, rows: u32, raster: &mut Raster<'_>) {
    let (from, to) = reach(piece, raster.width);
    // Relative to the corner of the cell: within `longest_side` of it nothing overflows, and
    // farther pixels, where the functions wrap, are never reached.
    let x0 = column(from).wrapping_sub(piece.x);
    let mut left = rows;
    while left != 0 {
        let row = left.trailing_zeros();
        left &= left - 1;
        let y = line(raster.first + row).wrapping_sub(piece.y);
        let mut inside = piece.edges.map(|[gx, gy, g]| {
            gx.wrapping_mul(x0)
                .wrapping_add(gy.wrapping_mul(y))
                .wrapping_add(g)
        });
        let pixels = row as usize * raster.pitch + from..row as usize * raster.pitch + to.max(from);
        let (mut x, y) = (x0 as f32 * PX_PER_STEP, y as f32 * PX_PER_STEP);
        for (u, v) in raster.u[pixels.clone()]
            .iter_mut()
            .zip(&mut raster.v[pixels])
        {
            // The sign bit of the union: inside if none of the four is negative.
            if inside[0] | inside[1] | inside[2] | inside[3] >= 0
                && (raster.over || *u == UNCOVERED)
            {
                (*u, *v) = piece.place(x, y);
            }
            for (inside, [gx, ..]) in inside.iter_mut().zip(&piece.edges) {
                *inside = inside.wrapping_add(gx.wrapping_mul(STEPS_PER_PX));
            }
            x += 1.0;
        }
    }
}

/// The pixels of a row that a piece can reach.
#[inline(always)]
pub(super) fn reach(piece: &Piece, width: usize) -> (usize, usize) {
    let clip = |pixel: i32| usize::try_from(pixel).unwrap_or(0).min(width);
    (clip(piece.pixels[0]), clip(piece.pixels[1]))
}

/// The x at which the pixels in a column have their centres, in lattice steps; of columns that
/// vertices can reach.
#[inline(always)]
pub(super) fn column(pixel: usize) -> i32 {
    (pixel as i32)
        .wrapping_mul(STEPS_PER_PX)
        .wrapping_add(HALF_PX)
}

/// The y at which the pixels in a row have their centres, in lattice steps.
#[inline(always)]
pub(super) fn line(row: u32) -> i32 {
    row_centre(row) as i32
}

impl Piece {
    /// The coordinates at px (x, y) from the origin.
    #[inline(always)]
    fn place(&self, x: f32, y: f32) -> (f32, f32) {
        let (s, t) = match &self.map {
            CellMap::Near(near) => {
                let s0 = (near.s[1] * y + near.s[2]) + near.s[0] * x;
                let t0 = (near.t[1] * y + near.t[2]) + near.t[0] * x;
                // Two substitutions of the product s t into the equations of the patch (`Near`),
                // from the affine solution.
                let once = s0 * t0;
                let (s1, t1) = (s0 - once * near.twist[0], t0 - once * near.twist[1]);
                let twice = s1 * t1;
                (s0 - twice * near.twist[0], t0 - twice * near.twist[1])
            }
            CellMap::Root(root) => {
                let ([ex, ey], [fx, fy], [dx, dy]) = (root.e, root.f, root.d);
                // The quadratic for t, which `patch` derives.
                let b = (root.area - y * dx) + x * dy;
                let c = x * ey - y * ex;
                let under = b * b - (4.0 * root.bend) * c;
                let m = (if under > 0.0 { under } else { 0.0 }).sqrt() * root.sign;
                // The form of the root in which b and m have the same sign, so that nothing
                // cancels; also right where the quadratic term vanishes.
                let same = b * m >= 0.0;
                let t = within(
                    (if same { -2.0 * c } else { m - b })
                        / (if same { b + m } else { 2.0 * root.bend }),
                );
                let (along_x, along_y) = (ex + dx * t, ey + dy * t);
                let (rest_x, rest_y) = (x - fx * t, y - fy * t);
                // Divided by the larger component: the other one may be 0.
                let wide = along_x.abs() > along_y.abs();
                (
                    within(
                        (if wide { rest_x } else { rest_y })
                            / (if wide { along_x } else { along_y }),
                    ),
                    t,
                )
            }
        };
        (
            self.u[0] + s * self.u[1] + t * self.u[2],
            self.v[0] + s * self.v[1] + t * self.v[2],
        )
    }
}

/// Clamps to [0, 1]; NaN becomes 0.
#[inline(always)]
fn within(share: f32) -> f32 {
    let share = if share > 0.0 { share } else { 0.0 };
    if share < 1.0 { share } else { 1.0 }
}
