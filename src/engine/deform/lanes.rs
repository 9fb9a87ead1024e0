//! N vertices at once, one per lane: their positions, the coefficients of their rows, and masses
//! relative to each of them.

use crate::geometry::Point;

/// Vertices in a block.
pub(super) const LANES: usize = 16;

/// N vertices, px.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertices<const N: usize> {
    pub(super) x: [f64; N],
    pub(super) y: [f64; N],
    /// The pixel to which each belongs, counted row by row, or [`ON_PLANE`]; only maps inside a
    /// mask look at it.
    pub(super) pixel: [u32; N],
}

/// A vertex that belongs to the pixel of its position.
pub(super) const ON_PLANE: u32 = u32::MAX;

/// The coefficients of N vertices. Shapes: `[columns]`.
#[derive(Clone, Debug)]
pub(super) struct Coefficients<const N: usize> {
    /// Real and imaginary parts. Affine: C (its real part). Similarity: C. Rigid: H, 1/px.
    pub(super) h: Vec<[[f64; N]; 2]>,
    /// Rigid: the normalised weights.
    pub(super) wn: Vec<[f64; N]>,
    /// Rigid: v - p*, px.
    pub(super) e: [[f64; N]; 2],
}

/// A mass and its position (of a segment: the position nearest to v), first from the anchor in the
/// frame, later from p*.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointMass<const N: usize> {
    pub(super) x: [f64; N],
    pub(super) y: [f64; N],
    pub(super) w: [f64; N],
}

impl<const N: usize> Vertices<N> {
    /// The same vertex in every lane.
    pub(super) const fn all(v: Point) -> Self {
        Self {
            x: [v.x; N],
            y: [v.y; N],
            pixel: [ON_PLANE; N],
        }
    }
}

impl<const N: usize> Coefficients<N> {
    pub(super) fn zeroed(columns: usize) -> Self {
        Self {
            h: vec![[[0.0; N]; 2]; columns],
            wn: vec![[0.0; N]; columns],
            e: [[0.0; N]; 2],
        }
    }

    pub(super) fn clear(&mut self) {
        *self = Self::zeroed(self.h.len());
    }
}

impl<const N: usize> PointMass<N> {
    pub(super) const ZERO: Self = Self {
        x: [0.0; N],
        y: [0.0; N],
        w: [0.0; N],
    };
}

/// N vertices, by lane.
pub(super) fn gather<const N: usize>(vertex: impl Fn(usize) -> Point) -> Vertices<N> {
    let mut v = Vertices::all(Point::new(0.0, 0.0));
    for lane in 0..N {
        let Point { x, y } = vertex(lane);
        (v.x[lane], v.y[lane]) = (x, y);
    }
    v
}
