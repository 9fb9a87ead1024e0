//! The distance in front of the fall-off: how far a handle is from a vertex when its weight is
//! computed. Positions and displacements are those of the plane under any metric.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over lanes are written alike, whatever they index"
)]

use super::segments::View;
use crate::deform::lanes::Vertices;
use crate::geometry::Point;

/// A metric, which is a type and not a choice at run time: the loops over vertices are compiled for
/// each. One that knows distances of the vertices of a mesh only is made for each block of them.
pub(in crate::deform) trait Metric: Copy {
    /// The squared distances of N vertices from point number `index` of the set, which lies at `p`,
    /// px^2.
    fn squared_of_point<const N: usize>(&self, index: usize, p: Point, v: &Vertices<N>)
    -> [f64; N];

    /// The squared distances of N vertices from segment number `index` of the set, px^2; `view`:
    /// where it is relative to them.
    fn squared_of_segment<const N: usize>(&self, index: usize, view: &View<N>) -> [f64; N];

    /// The value of r2min with which the weights of this segment's positions are computed, px^2:
    /// they use squared distances in the plane, so where the segment is farther by another metric,
    /// r2min is divided by the same factor.
    fn r2min_of_segment<const N: usize>(
        &self,
        index: usize,
        view: &View<N>,
        r2min: &[f64; N],
    ) -> [f64; N];
}

/// The distance in the plane.
#[derive(Clone, Copy, Debug)]
pub(in crate::deform) struct Euclidean;

impl Metric for Euclidean {
    #[inline(always)]
    fn squared_of_point<const N: usize>(
        &self,
        _index: usize,
        p: Point,
        v: &Vertices<N>,
    ) -> [f64; N] {
        let mut squared = [0.0; N];
        for k in 0..N {
            let (x, y) = (p.x - v.x[k], p.y - v.y[k]);
            squared[k] = x * x + y * y;
        }
        squared
    }

    #[inline(always)]
    fn squared_of_segment<const N: usize>(&self, _index: usize, view: &View<N>) -> [f64; N] {
        view.r2
    }

    #[inline(always)]
    fn r2min_of_segment<const N: usize>(
        &self,
        _index: usize,
        _view: &View<N>,
        r2min: &[f64; N],
    ) -> [f64; N] {
        *r2min
    }
}
