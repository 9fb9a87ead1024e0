//! Fits the map at a vertex (steps 4 and 5 of mathematics 7.1): centroid, second moments, and the
//! rows of the class, rotated back from the frame. The mass of a segment is distributed along its
//! direction; sums need only its moments, so it adds a few terms to those of a point.

use super::segment_moments::SegmentMoments;
use crate::deform::columns::{HandleElements, PointSource, RestSegment};
use crate::deform::form::CoefficientForm;
use crate::deform::lanes::{Coefficients, PointMass};
use crate::deform::workspace::CoefficientScratch;

/// `tau`: direction of the frame, `at_v`: v in it. Leaves positions relative to p* and masses that
/// add up to 1.
#[inline(always)]
pub(in crate::deform) fn fit<const N: usize>(
    form: CoefficientForm,
    sources: &HandleElements,
    tau: &[[f64; N]; 2],
    at_v: &[[f64; N]; 2],
    scratch: &mut CoefficientScratch<N>,
    rows: &mut Coefficients<N>,
) {
    let (e, per_mu) = centre(at_v, scratch);
    // Affine maps divide by the matrix S, the others by the number mu (mathematics 2.2).
    if form == CoefficientForm::Real {
        return affine(sources, &e, &per_mu, scratch, rows);
    }
    let turn = Rotation {
        rigid: form == CoefficientForm::Rigid,
        tau,
        e: &e,
    };
    for (PointSource { column, .. }, PointMass { x, y, w }) in
        sources.points.iter().zip(&scratch.places)
    {
        let (mut gx, mut gy) = ([0.0; N], [0.0; N]);
        for k in 0..N {
            let g = w[k] * per_mu[k];
            (gx[k], gy[k]) = (g * x[k], g * y[k]);
        }
        turn.put(&gx, &gy, w, &mut rows.h[*column], &mut rows.wn[*column]);
    }
    for (RestSegment { column, .. }, span) in sources.segments.iter().zip(&scratch.spans) {
        let SegmentMoments {
            place: PointMass { x, y, .. },
            x: tx,
            y: ty,
            ..
        } = span;
        // The two ends share the mass as 1 - t and t: `ga` and `gb` of mathematics 3.1. Here the
        // moments are about the position nearest to v, so each is a mass there, and a first moment
        // along the segment.
        for (column, [mass, along]) in [(*column, span.of_a()), (column + 1, span.of_b())] {
            let (mut gx, mut gy) = ([0.0; N], [0.0; N]);
            for k in 0..N {
                gx[k] = (mass[k] * x[k] + along[k] * tx[k]) * per_mu[k];
                gy[k] = (mass[k] * y[k] + along[k] * ty[k]) * per_mu[k];
            }
            turn.put(&gx, &gy, &mass, &mut rows.h[column], &mut rows.wn[column]);
        }
    }
    // A pose multiplies e by a rotation in the axes of the image, so e is turned back too.
    let ([ex, ey], [tx, ty]) = (&e, tau);
    for k in 0..N {
        rows.e[0][k] = ex[k] * tx[k] - ey[k] * ty[k];
        rows.e[1][k] = ex[k] * ty[k] + ey[k] * tx[k];
    }
}

/// The final step of similarity and rigid.
struct Rotation<'a, const N: usize> {
    rigid: bool,
    tau: &'a [[f64; N]; 2],
    e: &'a [[f64; N]; 2],
}

impl<const N: usize> Rotation<'_, N> {
    /// From `g p^` and `wn` of a column, with `H = g conj(p^)`: rigid keeps H, rotated back by
    /// conj(tau), and wn; similarity `C = wn + e H`, where the rotation cancels.
    #[inline(always)]
    fn put(
        &self,
        gx: &[f64; N],
        gy: &[f64; N],
        w: &[f64; N],
        h: &mut [[f64; N]; 2],
        wn: &mut [f64; N],
    ) {
        let ([tx, ty], [ex, ey], [re, im]) = (self.tau, self.e, h);
        if self.rigid {
            for k in 0..N {
                re[k] = gx[k] * tx[k] - gy[k] * ty[k];
                im[k] = -(gx[k] * ty[k] + gy[k] * tx[k]);
                wn[k] = w[k];
            }
        } else {
            for k in 0..N {
                re[k] = w[k] + (ex[k] * gx[k] + ey[k] * gy[k]);
                im[k] = ey[k] * gx[k] - ex[k] * gy[k];
            }
        }
    }
}

/// Normalises masses and moves positions to p*. Returns `v - p*` in the frame, and 1/mu.
#[inline(always)]
fn centre<const N: usize>(
    at_v: &[[f64; N]; 2],
    scratch: &mut CoefficientScratch<N>,
) -> ([[f64; N]; 2], [f64; N]) {
    let (mut total, mut px, mut py, mut mu) = ([0.0; N], [0.0; N], [0.0; N], [0.0; N]);
    for PointMass { x, y, w } in places(scratch) {
        for k in 0..N {
            total[k] += w[k];
            px[k] += x[k] * w[k];
            py[k] += y[k] * w[k];
        }
    }
    // The place of a segment is its position nearest to v; its first moment moves the centre of its
    // mass from there along its direction.
    for SegmentMoments { first, x, y, .. } in &scratch.spans {
        for k in 0..N {
            px[k] += x[k] * first[k];
            py[k] += y[k] * first[k];
        }
    }
    let mut e = [[0.0; N]; 2];
    for k in 0..N {
        total[k] = 1.0 / total[k];
        px[k] *= total[k];
        py[k] *= total[k];
        (e[0][k], e[1][k]) = (at_v[0][k] - px[k], at_v[1][k] - py[k]);
    }
    // mu is summed from what remains after p* is subtracted, not as the difference of two moments:
    // beside a handle everything else weighs next to nothing, and the difference would have no
    // digit left.
    for PointMass { x, y, w } in scratch
        .places
        .iter_mut()
        .chain(scratch.spans.iter_mut().map(|span| &mut span.place))
    {
        for k in 0..N {
            x[k] -= px[k];
            y[k] -= py[k];
            w[k] *= total[k];
            mu[k] += w[k] * (x[k] * x[k] + y[k] * y[k]);
        }
    }
    for SegmentMoments {
        place,
        first,
        second,
        x: tx,
        y: ty,
        ..
    } in &mut scratch.spans
    {
        for k in 0..N {
            first[k] *= total[k];
            second[k] *= total[k];
            mu[k] += 2.0 * first[k] * (place.x[k] * tx[k] + place.y[k] * ty[k])
                + second[k] * (tx[k] * tx[k] + ty[k] * ty[k]);
        }
    }
    for mu in &mut mu {
        *mu = 1.0 / *mu;
    }
    (e, mu)
}

/// The masses of points and segments.
#[inline(always)]
fn places<const N: usize>(scratch: &CoefficientScratch<N>) -> impl Iterator<Item = &PointMass<N>> {
    scratch
        .places
        .iter()
        .chain(scratch.spans.iter().map(|span| &span.place))
}

/// `C = wn + e S^-1 (w p^)^T` by LDL^T with the frame's tangent first, because next to a line S has
/// a condition of h^(3 - 2 alpha).
#[inline(always)]
fn affine<const N: usize>(
    sources: &HandleElements,
    e: &[[f64; N]; 2],
    per_mu: &[f64; N],
    scratch: &CoefficientScratch<N>,
    rows: &mut Coefficients<N>,
) {
    // The pivot a is along the frame's axis, which passes through the position with the largest
    // moment, or along the line that v is beside: it is not the small one of the two.
    let (mut a, mut b, mut c) = ([0.0; N], [0.0; N], [0.0; N]);
    for PointMass { x, y, w } in places(scratch) {
        for k in 0..N {
            let g = w[k] * per_mu[k];
            a[k] += g * x[k] * x[k];
            b[k] += g * x[k] * y[k];
        }
    }
    for SegmentMoments {
        place: PointMass { x, y, .. },
        first,
        second,
        x: tx,
        y: ty,
        ..
    } in &scratch.spans
    {
        for k in 0..N {
            a[k] += (2.0 * first[k] * x[k] * tx[k] + second[k] * tx[k] * tx[k]) * per_mu[k];
            b[k] +=
                (first[k] * (x[k] * ty[k] + tx[k] * y[k]) + second[k] * tx[k] * ty[k]) * per_mu[k];
        }
    }
    let mut r = [0.0; N];
    for k in 0..N {
        r[k] = b[k] / a[k];
    }
    // Elimination would have c as a difference, `sum g y^2 - b^2/a`. The squares of what is left
    // across the axis add up to the same without cancelling.
    for PointMass { x, y, w } in places(scratch) {
        for k in 0..N {
            let y = y[k] - r[k] * x[k];
            c[k] += w[k] * per_mu[k] * y * y;
        }
    }
    for SegmentMoments {
        place: PointMass { x, y, .. },
        first,
        second,
        x: tx,
        y: ty,
        ..
    } in &scratch.spans
    {
        for k in 0..N {
            let (y, ty) = (y[k] - r[k] * x[k], ty[k] - r[k] * tx[k]);
            c[k] += (2.0 * first[k] * y * ty + second[k] * ty * ty) * per_mu[k];
        }
    }
    // The solution is applied to e, once for a vertex, instead of to each control.
    let (mut ex, mut ey) = ([0.0; N], [0.0; N]);
    for k in 0..N {
        ey[k] = (e[1][k] - r[k] * e[0][k]) / c[k] * per_mu[k];
        ex[k] = e[0][k] / a[k] * per_mu[k];
    }
    for (PointSource { column, .. }, PointMass { x, y, w }) in
        sources.points.iter().zip(&scratch.places)
    {
        let [h, _] = &mut rows.h[*column];
        for k in 0..N {
            h[k] = w[k] + w[k] * (ex[k] * x[k] + ey[k] * (y[k] - r[k] * x[k]));
        }
    }
    for (RestSegment { column, .. }, span) in sources.segments.iter().zip(&scratch.spans) {
        let SegmentMoments {
            place: PointMass { x, y, .. },
            x: tx,
            y: ty,
            ..
        } = span;
        for (column, [mass, along]) in [(*column, span.of_a()), (column + 1, span.of_b())] {
            let [h, _] = &mut rows.h[column];
            for k in 0..N {
                let px = mass[k] * x[k] + along[k] * tx[k];
                let py = mass[k] * (y[k] - r[k] * x[k]) + along[k] * (ty[k] - r[k] * tx[k]);
                h[k] = mass[k] + (ex[k] * px + ey[k] * py);
            }
        }
    }
}
