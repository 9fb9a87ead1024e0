//! The bilinear patch of a cell, `P(s, t) = P00 + s e + t f + s t d` with `e = P10 - P00`,
//! `f = P01 - P00`, `d = P11 - P10 - P01 + P00`, and its inverse. With `h = X - P00` the condition
//! `cross(h - t f, e + t d) = 0` is quadratic in t; the root of the patch is the one at which the
//! derivative, the Jacobian, has the sign of the four corner cross products. Lattice steps in,
//! sampler coordinates out.

use super::snapped_grid::Corner;
use crate::geometry::{Point, Vec2};

/// Largest error of drawn coordinates relative to the patch, px of the sampled image: half of the
/// contract's tolerance.
pub(super) const PATCH_TOLERANCE_PX: f64 = 1.0 / 32.0;

/// The shape of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// Strictly convex; +1 when oriented as at rest, -1 when flipped.
    Convex(i8),
    /// Any other shape: drawn as two triangles.
    Other,
}

/// Corners in the order 00, 10, 11, 01.
pub(super) fn shape(corners: &[Corner; 4]) -> Shape {
    let cross = |k: usize| {
        let (a, b, c) = (corners[(k + 3) % 4], corners[k], corners[(k + 1) % 4]);
        turn(a, b, c).signum()
    };
    match [cross(0), cross(1), cross(2), cross(3)] {
        [1, 1, 1, 1] => Shape::Convex(1),
        [-1, -1, -1, -1] => Shape::Convex(-1),
        _ => Shape::Other,
    }
}

/// Twice the signed area of a triangle, exactly.
pub(super) fn turn(a: Corner, b: Corner, c: Corner) -> i64 {
    let (abx, aby) = (
        i64::from(b.x) - i64::from(a.x),
        i64::from(b.y) - i64::from(a.y),
    );
    let (bcx, bcy) = (
        i64::from(c.x) - i64::from(b.x),
        i64::from(c.y) - i64::from(b.y),
    );
    abx * bcy - aby * bcx
}

/// The patch of a convex cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    origin: Point,
    e: Vec2,
    f: Vec2,
    d: Vec2,
    sign: f64,
    u: [f64; 2],
    v: [f64; 2],
}

impl Patch {
    /// Corners in the order 00, 10, 11, 01; `sign` from [`Shape::Convex`].
    pub(super) fn new(corners: &[Corner; 4], sign: i8) -> Self {
        let [p00, p10, p11, p01] = corners.map(|c| Point::new(f64::from(c.x), f64::from(c.y)));
        let (e, f) = (p10 - p00, p01 - p00);
        Self {
            origin: p00,
            e,
            f,
            d: p11 - p10 - f,
            sign: f64::from(sign),
            u: [f64::from(corners[0].u), f64::from(corners[2].u)],
            v: [f64::from(corners[0].v), f64::from(corners[2].v)],
        }
    }

    /// The sampler's coordinates at a position inside the cell.
    pub(super) fn inverse(&self, place: Point) -> (f64, f64) {
        let h = place - self.origin;
        let (a, b, c) = (
            -self.f.cross(self.d),
            h.cross(self.d) + self.e.cross(self.f),
            h.cross(self.e),
        );
        let root = self.sign * (b * b - 4.0 * a * c).max(0.0).sqrt();
        let t = if b * root >= 0.0 {
            -2.0 * c / (b + root)
        } else {
            (root - b) / (2.0 * a)
        };
        let t = within(t);
        let (along, rest) = (self.e + self.d * t, h - self.f * t);
        let s = if along.x.abs() > along.y.abs() {
            rest.x / along.x
        } else {
            rest.y / along.y
        };
        let s = within(s);
        (
            self.u[0] + s * (self.u[1] - self.u[0]),
            self.v[0] + t * (self.v[1] - self.v[0]),
        )
    }

    /// Bounds the error, px of the sampled image, of coordinates interpolated linearly between
    /// two border positions. Between parameters that differ by (Δs, Δt) the chord leaves the patch
    /// by at most `|Δs Δt d| / 4`, and the inverse Jacobian maps that back.
    pub(super) fn linear_error(&self, unit: f32) -> f64 {
        let (e, f, d) = (self.e, self.f, self.d);
        let (e1, f1) = (e + d, f + d);
        let area = [e.cross(f), e.cross(f1), e1.cross(f), e1.cross(f1)]
            .map(|cross| cross * self.sign)
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        let lowest = |a: f64, b: f64| {
            if a * b > 0.0 {
                a.abs().min(b.abs())
            } else {
                0.0
            }
        };
        let slant = (e.y.abs().max(e1.y.abs()) / lowest(f.y, f1.y)).min(1.0);
        let (width, height) = (
            (self.u[1] - self.u[0]) / f64::from(unit),
            (self.v[1] - self.v[0]) / f64::from(unit),
        );
        let reach2 = (f.norm2().max(f1.norm2()) * width * width)
            .max(e.norm2().max(e1.norm2()) * height * height);
        0.25 * slant * (d.norm2() * reach2).sqrt() / area
    }
}

/// Clamps to [0, 1]. A cell whose area vanishes in f64 gives 0/0, which becomes a border position
/// and never NaN.
fn within(share: f64) -> f64 {
    if share.is_nan() {
        0.0
    } else {
        share.clamp(0.0, 1.0)
    }
}
