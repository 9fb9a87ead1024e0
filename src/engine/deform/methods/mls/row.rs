//! The rows: all coefficients of vertices that depend on the handles at rest, without q
//! (mathematics 7.1). Equations (1) to (8), (12) to (14), anchored at the heaviest handle and
//! computing ratios first, so that no precision is lost next to a handle, on the extension of a
//! segment, or for large alpha. Cost: O(elements), for segments O(nodes); no allocation once the
//! scratch has grown.
//!
//! N vertices are computed at once: every step is a branch-free loop over them, which the compiler
//! vectorises for the enabled instruction set (`kernel`). One vertex is N = 1. A point is a mass at
//! a position; a segment is one too, with moments along its direction.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over lanes are written alike, whatever they index"
)]

use super::falloff::Falloff;
use super::fit::fit;
use super::incomplete_beta::IncompleteBeta;
use super::metric::Metric;
use super::segment_moments::SegmentMoments;
use super::segments::{Moments, View};
use crate::deform::columns::{HandleElements, PointSource, RestSegment};
use crate::deform::form::CoefficientForm;
use crate::deform::lanes::{Coefficients, PointMass, Vertices};
use crate::deform::workspace::CoefficientScratch;
use crate::geometry::{Point, Vec2};

/// Within this share of the set's extent v lies on a handle.
const SNAP_SHARE: f64 = 1e-12;
/// No source; sources are numbered points first.
const NO_SOURCE: u64 = u64::MAX;

/// The input of a row that depends on the set.
#[derive(Clone, Copy, Debug)]
pub(in crate::deform) struct RowInputs<'a, M> {
    pub(in crate::deform) metric: M,
    pub(in crate::deform) sources: &'a HandleElements,
    pub(in crate::deform) extent: f64,
    pub(in crate::deform) falloff: Falloff,
    /// The closed form of segments, if alpha has one.
    pub(in crate::deform) beta: Option<&'a IncompleteBeta>,
    /// The mass of a point of weight 1, px.
    pub(in crate::deform) point_mass: f64,
    pub(in crate::deform) form: CoefficientForm,
    /// Always use the quadrature nodes, at their full number.
    pub(in crate::deform) exact: bool,
}

/// The heaviest source of each vertex, and the frame of all positions:
/// `(place - o) conj(tau) + shift`.
struct Anchor<const N: usize> {
    weight: [f64; N],
    source: [u64; N],
    /// What is subtracted from positions before the turn: the point itself; for a segment v,
    /// because `shift` then moves the origin to its position nearest to v with all digits.
    o: Vertices<N>,
    /// The direction of the segment; zero until `choose_frame` if a point is the anchor. Points
    /// come first, so they never reset it.
    tau: [[f64; N]; 2],
    /// v minus that position, in the frame, exact; 0 for a point.
    shift: [[f64; N]; 2],
    /// The point that defines the frame of an anchor point; it lies exactly on the axis, at this
    /// distance from the anchor.
    defining: [u64; N],
    reach: [f64; N],
}

impl<M: Metric> RowInputs<'_, M> {
    /// The rows of `v`. The body of every instruction set's function in `kernel`.
    #[inline(always)]
    pub(in crate::deform) fn rows<const N: usize>(
        &self,
        v: &Vertices<N>,
        scratch: &mut CoefficientScratch<N>,
        rows: &mut Coefficients<N>,
    ) {
        scratch
            .places
            .resize(self.sources.points.len(), PointMass::ZERO);
        scratch
            .spans
            .resize(self.sources.segments.len(), SegmentMoments::ZERO);
        // The steps of mathematics 7.1: ratios first, then the anchor, then the frame in which
        // everything is fitted. Each keeps exact what the next one would otherwise have to find as
        // a difference of large numbers.
        let r2min = self.nearest(v, scratch);
        let mut anchor = self.weights(v, &r2min, scratch);
        self.choose_frame(&mut anchor, scratch);
        let at_v = self.in_frame(v, &anchor, scratch);
        fit(self.form, self.sources, &anchor.tau, &at_v, scratch, rows);
        let snap = SNAP_SHARE * self.extent;
        // Computed for every lane and replaced in few: a branch around the steps above would keep
        // the lanes from being computed together. What they hold for a vertex on a handle may be
        // NaN.
        for k in 0..N {
            if r2min[k] <= snap * snap {
                self.unit(k, v, rows);
            }
        }
    }

    /// Squared distance of the nearest source; stores each point's own in its mass.
    #[inline(always)]
    fn nearest<const N: usize>(
        &self,
        v: &Vertices<N>,
        scratch: &mut CoefficientScratch<N>,
    ) -> [f64; N] {
        let mut nearest = [f64::INFINITY; N];
        let points = self.sources.points.iter().zip(&mut scratch.places);
        for (index, (PointSource { p, .. }, place)) in points.enumerate() {
            place.w = self.metric.squared_of_point(index, *p, v);
            lower(&mut nearest, &place.w);
        }
        let segments = self.sources.segments.iter().zip(&mut scratch.spans);
        for (index, (s, span)) in segments.enumerate() {
            span.view = View::new(s, v);
            // The whole segment counts, not its line: beyond an end that is the distance from the
            // end.
            lower(
                &mut nearest,
                &self.metric.squared_of_segment(index, &span.view),
            );
        }
        nearest
    }

    /// Weights relative to the nearest source's, the ratio before the power; the heaviest source
    /// becomes the anchor.
    #[inline(always)]
    fn weights<const N: usize>(
        &self,
        v: &Vertices<N>,
        r2min: &[f64; N],
        scratch: &mut CoefficientScratch<N>,
    ) -> Anchor<N> {
        let mut anchor = Anchor {
            weight: [-1.0; N],
            source: [NO_SOURCE; N],
            o: *v,
            tau: [[0.0; N]; 2],
            shift: [[0.0; N]; 2],
            defining: [NO_SOURCE; N],
            reach: [0.0; N],
        };
        let mut index = 0;
        for (PointSource { p, mass, .. }, PointMass { w, .. }) in
            self.sources.points.iter().zip(&mut scratch.places)
        {
            for k in 0..N {
                // The quotient first and then the power (mathematics 7.1, step 2): every weight
                // lies in (0, 1] times its mass, so nothing overflows at any alpha. On a handle
                // this is 0/0; `unit` replaces that lane.
                w[k] = r2min[k] / w[k];
            }
            self.falloff.of_lanes(w);
            for k in 0..N {
                // The mass comes after the power: it is the weight of the handle, not part of its
                // distance.
                w[k] *= mass;
            }
            anchor.take_point(index, w, *p);
            index += 1;
        }
        let spans = self.sources.segments.iter().zip(&mut scratch.spans);
        for (
            number,
            (
                s,
                SegmentMoments {
                    view,
                    place,
                    first,
                    second,
                    ..
                },
            ),
        ) in spans.enumerate()
        {
            // A segment weighs as the integral of w along it (mathematics 3.2), and its first and
            // second moments stand for the positions along it.
            let r2min = self.metric.r2min_of_segment(number, view, r2min);
            Moments([place.w, *first, *second]) =
                view.moments(s, v, (self.falloff, self.beta), &r2min, self.exact);
            anchor.take_segment(index, &place.w, v, s.tau, &view.off_nearest(s));
            index += 1;
        }
        anchor
    }

    /// If a point is the anchor, the frame points from it to the position with the largest mass *
    /// distance^2.
    #[inline(always)]
    fn choose_frame<const N: usize>(
        &self,
        anchor: &mut Anchor<N>,
        scratch: &CoefficientScratch<N>,
    ) {
        // The search runs for all lanes and is used where a point is the anchor: which kind the
        // anchor is differs from lane to lane, and a choice of values costs less than a branch.
        let mut axis = DirectionSearch {
            moment: [0.0; N],
            x: [1.0; N],
            y: [0.0; N],
            defining: [NO_SOURCE; N],
        };
        for ((PointSource { p, .. }, place), index) in
            self.sources.points.iter().zip(&scratch.places).zip(0..)
        {
            axis.consider(*p, &anchor.o, &place.w, index);
        }
        for (s, span) in self.sources.segments.iter().zip(&scratch.spans) {
            // The ends stand for a segment. Neither defines the frame, because its coordinates are
            // computed from moments and would not lie on the axis exactly.
            axis.consider(s.a, &anchor.o, &span.place.w, NO_SOURCE);
            axis.consider(s.b, &anchor.o, &span.place.w, NO_SOURCE);
        }
        for k in 0..N {
            let reach = (axis.x[k] * axis.x[k] + axis.y[k] * axis.y[k]).sqrt();
            // The direction of a segment has length 1, so zero means that no segment has become the
            // anchor.
            let is_point = anchor.tau[0][k] == 0.0 && anchor.tau[1][k] == 0.0;
            anchor.tau[0][k] = if is_point {
                axis.x[k] / reach
            } else {
                anchor.tau[0][k]
            };
            anchor.tau[1][k] = if is_point {
                axis.y[k] / reach
            } else {
                anchor.tau[1][k]
            };
            anchor.defining[k] = if is_point {
                axis.defining[k]
            } else {
                NO_SOURCE
            };
            anchor.reach[k] = reach;
        }
    }

    /// Transforms all positions to the anchor's frame, computed from the handles themselves: exact
    /// for whole numbers. Returns v's position.
    #[inline(always)]
    fn in_frame<const N: usize>(
        &self,
        v: &Vertices<N>,
        anchor: &Anchor<N>,
        scratch: &mut CoefficientScratch<N>,
    ) -> [[f64; N]; 2] {
        let ([tx, ty], [sx, sy], o) = (&anchor.tau, &anchor.shift, &anchor.o);
        let mut index = 0;
        for (PointSource { p, .. }, place) in self.sources.points.iter().zip(&mut scratch.places) {
            for k in 0..N {
                // From the handles as the client gave them, not from v: differences of whole
                // numbers are exact, and next to a handle v - p has lost the digits that matter.
                let (x, y) = turned(p.x - o.x[k], p.y - o.y[k], tx[k], ty[k]);
                // The anchor is 0 and this point lies on the axis by definition; rounding of the
                // rotation would put it beside the axis, where the affine fit divides by what is
                // left across (step 5).
                let defines = anchor.defining[k] == index;
                place.x[k] = if defines { anchor.reach[k] } else { x + sx[k] };
                place.y[k] = if defines { 0.0 } else { y + sy[k] };
            }
            index += 1;
        }
        for (
            s,
            SegmentMoments {
                view,
                place,
                x: along_x,
                y: along_y,
                ..
            },
        ) in self.sources.segments.iter().zip(&mut scratch.spans)
        {
            // A segment is a mass at its position nearest to v, and a vector along which that mass
            // is spread.
            let along = s.tau * s.length;
            for k in 0..N {
                let (a, b) = (view.share_a[k], view.share_b[k]);
                let nearest = (
                    (s.a.x - o.x[k]) * a + (s.b.x - o.x[k]) * b,
                    (s.a.y - o.y[k]) * a + (s.b.y - o.y[k]) * b,
                );
                let (x, y) = turned(nearest.0, nearest.1, tx[k], ty[k]);
                let (ahead, aside) = turned(along.x, along.y, tx[k], ty[k]);
                // The segment that is the anchor defines origin and axis, so its coordinates are
                // known without computing them.
                let own = anchor.source[k] == index;
                place.x[k] = if own { 0.0 } else { x + sx[k] };
                place.y[k] = if own { 0.0 } else { y + sy[k] };
                along_x[k] = if own { s.length } else { ahead };
                along_y[k] = if own { 0.0 } else { aside };
            }
            index += 1;
        }
        // v itself in the frame. Where a segment is the anchor, o is v, and `shift` alone places
        // it: so v's distance from the line keeps all of its digits.
        let mut at_v = [[0.0; N]; 2];
        for k in 0..N {
            let (x, y) = turned(v.x[k] - o.x[k], v.y[k] - o.y[k], tx[k], ty[k]);
            (at_v[0][k], at_v[1][k]) = (x + sx[k], y + sy[k]);
        }
        at_v
    }

    /// The row of a vertex on handles: the mean of theirs, weighted like the handles.
    #[cold]
    fn unit<const N: usize>(&self, k: usize, v: &Vertices<N>, rows: &mut Coefficients<N>) {
        let v = Point::new(v.x[k], v.y[k]);
        let snap = SNAP_SHARE * self.extent;
        // Everything that the lane holds is replaced, since 0/0 may have spread to each of its
        // numbers (mathematics section 6).
        for (h, wn) in rows.h.iter_mut().zip(&mut rows.wn) {
            (h[0][k], h[1][k], wn[k]) = (0.0, 0.0, 0.0);
        }
        (rows.e[0][k], rows.e[1][k]) = (0.0, 0.0);
        let points = self
            .sources
            .points
            .iter()
            .filter(|mark| (mark.p - v).norm2() <= snap * snap);
        let mut hits: Vec<_> = points
            // Point and line handles share a position by their weights, as in the limit of the
            // formulas; the mass of a point is its weight times `point_mass`, which only compares
            // points with lines.
            .map(|mark| (mark.mass / self.point_mass, mark.column, [1.0, 0.0]))
            .collect();
        let mut before: Option<&RestSegment> = None;
        for s in &self.sources.segments {
            let view = View::new(s, &Vertices::<1>::all(v));
            if view.r2[0] <= snap * snap {
                // The joint of two segments of a polyline counts once.
                if !before.is_some_and(|before| {
                    before.column + 2 == s.column && before.b == s.a && view.share_a[0] == 1.0
                }) {
                    hits.push((s.weight, s.column, [view.share_a[0], view.share_b[0]]));
                }
                before = Some(s);
            }
        }
        let total: f64 = hits.iter().map(|(weight, ..)| weight).sum();
        let mut put = |column: usize, share: f64| match self.form {
            CoefficientForm::Real | CoefficientForm::Complex => rows.h[column][0][k] = share,
            CoefficientForm::Rigid => rows.wn[column][k] = share,
        };
        for (weight, column, [a, b]) in hits {
            // Rigid keeps wn apart, and H = 0 leaves only the mean of the moved handles: no
            // rotation is left to choose.
            put(column, weight / total * a);
            if b != 0.0 {
                put(column + 1, weight / total * b);
            }
        }
    }
}

impl<const N: usize> Anchor<N> {
    /// Makes point `index` the anchor of the vertices for which it is heavier than all earlier
    /// points.
    #[inline(always)]
    fn take_point(&mut self, index: u64, w: &[f64; N], p: Point) {
        for k in 0..N {
            // Strictly heavier, so that the first of equal handles wins whatever the number of
            // lanes is.
            let heavier = w[k] > self.weight[k];
            self.weight[k] = if heavier { w[k] } else { self.weight[k] };
            self.source[k] = if heavier { index } else { self.source[k] };
            self.o.x[k] = if heavier { p.x } else { self.o.x[k] };
            self.o.y[k] = if heavier { p.y } else { self.o.y[k] };
        }
    }

    /// Like [`Self::take_point`] for a segment, seen from `o = v`.
    #[inline(always)]
    fn take_segment(
        &mut self,
        index: u64,
        w: &[f64; N],
        o: &Vertices<N>,
        tau: Vec2,
        shift: &[[f64; N]; 2],
    ) {
        for k in 0..N {
            let heavier = w[k] > self.weight[k];
            self.weight[k] = if heavier { w[k] } else { self.weight[k] };
            self.source[k] = if heavier { index } else { self.source[k] };
            self.o.x[k] = if heavier { o.x[k] } else { self.o.x[k] };
            self.o.y[k] = if heavier { o.y[k] } else { self.o.y[k] };
            self.tau[0][k] = if heavier { tau.x } else { self.tau[0][k] };
            self.tau[1][k] = if heavier { tau.y } else { self.tau[1][k] };
            self.shift[0][k] = if heavier {
                shift[0][k]
            } else {
                self.shift[0][k]
            };
            self.shift[1][k] = if heavier {
                shift[1][k]
            } else {
                self.shift[1][k]
            };
        }
    }
}

/// The search for the direction of a frame: the position with the largest moment so far, from the
/// anchor.
struct DirectionSearch<const N: usize> {
    moment: [f64; N],
    x: [f64; N],
    y: [f64; N],
    defining: [u64; N],
}

impl<const N: usize> DirectionSearch<N> {
    #[inline(always)]
    fn consider(&mut self, place: Point, o: &Vertices<N>, w: &[f64; N], index: u64) {
        for k in 0..N {
            let (x, y) = (place.x - o.x[k], place.y - o.y[k]);
            let moment = w[k] * (x * x + y * y);
            let better = moment > self.moment[k];
            self.moment[k] = if better { moment } else { self.moment[k] };
            self.x[k] = if better { x } else { self.x[k] };
            self.y[k] = if better { y } else { self.y[k] };
            self.defining[k] = if better { index } else { self.defining[k] };
        }
    }
}

#[inline(always)]
fn lower<const N: usize>(least: &mut [f64; N], by: &[f64; N]) {
    for k in 0..N {
        least[k] = if by[k] < least[k] { by[k] } else { least[k] };
    }
}

/// `(x, y) conj(tau)`.
#[inline(always)]
fn turned(x: f64, y: f64, tx: f64, ty: f64) -> (f64, f64) {
    (x * tx + y * ty, y * tx - x * ty)
}
