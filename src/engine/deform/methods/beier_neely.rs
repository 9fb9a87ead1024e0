//! Field morphing by lines (Beier, Neely 1992; mathematics 10.3), forwards: every line
//! carries its surroundings along, without a fit, and the nearest lines count most.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over lanes are written alike, whatever they index"
)]

use std::sync::Arc;

use super::mls::falloff::Falloff;
use super::{AcceptedHandles, Interpolation, Method, MethodInfo};
use crate::deform::columns::{Rank, RestSegment};
use crate::deform::form::CoefficientForm;
use crate::deform::lanes::Vertices;
use crate::deform::point_map::{BuiltMap, CoefficientsOf, Identity, MapInput, PointMap, RestSet};
use crate::deform::workspace::Workspace;
use crate::deform::{DeformError, IsCancelled, Parameter};
use crate::geometry::lane_math::pow;
use crate::geometry::{Point, Vec2};

/// In keys of plans and digests of handles at rest.
const IDENTITY: u64 = 5;
/// Three real coefficients for each segment, of `dP`, `dd` and `dn`.
const LAYOUT: u32 = 3;
/// Coefficients of a segment.
const TERMS: usize = 3;
/// Within this share of the set's extent v lies on a line.
const SNAP_SHARE: f64 = 1e-12;
/// A posed segment that is shorter has no direction, px.
const SHORTEST_SEGMENT: f64 = 1e-6;

const A: &str = "beier_neely/a";
const B: &str = "beier_neely/b";
const P: &str = "beier_neely/p";

static PARAMETERS: [Parameter; 3] = [
    Parameter {
        path: A,
        least: 0.0,
        most: 1e6,
        rule: "lie between 0 and 1000000 px",
        default: |_| 1.0,
        sentence: "Softens the pull next to a line, in px; at 0 the lines are met exactly.",
    },
    Parameter {
        path: B,
        least: 0.5,
        most: 2.0,
        rule: "lie between 0.5 and 2",
        default: |_| 2.0,
        sentence: "How quickly the influence of a line falls off with distance.",
    },
    Parameter {
        path: P,
        least: 0.0,
        most: 1.0,
        rule: "lie between 0 and 1",
        default: |_| 0.0,
        sentence: "How much more longer lines pull; at 0 all pull alike.",
    },
];

/// The row of the table.
pub(super) static INFO: MethodInfo = MethodInfo {
    method: Method::BeierNeely,
    name: "beier_neely",
    title: "Morph",
    sentence: "Every line carries its surroundings along, as in the morphs of films. It stretches \
        along a line and not across it, and reaches far.",
    handles: AcceptedHandles::Lines,
    parameters: &PARAMETERS,
    has_object: true,
    interpolation: Interpolation::IfZero(A),
    can_unfold: false,
    can_mirror: false,
    can_scale: true,
    candidates: &[],
    candidate_order: 5,
    system: None,
    mesh: None,
    geodesic: None,
    resolve: |handles, given| given.resolved(&PARAMETERS, handles),
    map,
};

fn map(input: &MapInput<'_>) -> Result<BuiltMap, DeformError> {
    let value = |path| input.parameters.get(path).unwrap_or_default();
    let (a, p) = (value(A), value(P));
    // Moving least squares raise ratios of distances to the same power.
    let power = Falloff::new(value(B), false)?;
    let pull = |segment: &RestSegment| pow(segment.length, p);
    let segments = input.sources.segments.clone();
    let rank = if segments.is_empty() {
        Rank::Empty
    } else {
        Rank::Full
    };
    let map = Arc::new(BeierNeely {
        pulls: segments.iter().map(pull).collect(),
        segments,
        a,
        power,
        p,
    });
    Ok(BuiltMap {
        map,
        rank,
        form: CoefficientForm::Real,
        warnings: vec![],
    })
}

/// The map of a set of segments.
#[derive(Debug)]
struct BeierNeely {
    segments: Vec<RestSegment>,
    /// L^p of each.
    pulls: Vec<f64>,
    a: f64,
    power: Falloff,
    p: f64,
}

impl BeierNeely {
    /// The positions in a segment's own coordinates: u along it, in its length, and v across it,
    /// px; and their distances from it.
    #[inline(always)]
    fn seen<const N: usize>(s: &RestSegment, at: &Vertices<N>) -> [[f64; N]; 3] {
        let [mut u, mut v, mut distance] = [[0.0; N]; 3];
        for k in 0..N {
            let (x, y) = (at.x[k] - s.a.x, at.y[k] - s.a.y);
            let (to_x, to_y) = (at.x[k] - s.b.x, at.y[k] - s.b.y);
            let along = x * s.tau.x + y * s.tau.y;
            v[k] = s.tau.x * y - s.tau.y * x;
            u[k] = along / s.length;
            distance[k] = if u[k] < 0.0 {
                (x * x + y * y).sqrt()
            } else if u[k] > 1.0 {
                (to_x * to_x + to_y * to_y).sqrt()
            } else {
                v[k].abs()
            };
        }
        [u, v, distance]
    }

    /// The coefficients of position k on lines that are met exactly: their mean, weighted as
    /// nearby, where the quotient of two weights that are both infinite says nothing.
    #[cold]
    fn on_lines<const N: usize>(&self, k: usize, at: Point, snap: f64, h: &mut [[[f64; N]; 2]]) {
        let mut total = 0.0;
        let lines = self.segments.iter().zip(&self.pulls);
        for ((s, pull), h) in lines.zip(h.chunks_exact_mut(TERMS)) {
            let [[u], _, [distance]] = Self::seen(s, &Vertices::<1>::all(at));
            let mut weight = [*pull];
            self.power.of_lanes(&mut weight);
            let [weight] = if distance <= snap { weight } else { [0.0] };
            let weight = weight * s.weight;
            total += weight;
            // Across the line there is no distance.
            for (h, coefficient) in h.iter_mut().zip([weight, weight * u, 0.0]) {
                h[0][k] = coefficient;
            }
        }
        h.iter_mut().for_each(|h| h[0][k] /= total);
    }
}

impl<const N: usize> CoefficientsOf<N> for BeierNeely {
    fn coefficients(
        &self,
        set: &RestSet,
        v: &Vertices<N>,
        _exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        let (h, ratios) = (&mut workspace.rows.h, &mut workspace.scratch.sides);
        ratios.clear();
        let (mut least, mut nearest) = ([f64::INFINITY; N], [f64::INFINITY; N]);
        let lines = self.segments.iter().zip(&self.pulls);
        for ((s, pull), h) in lines.zip(h.chunks_exact_mut(TERMS)) {
            let [u, across, distance] = Self::seen(s, v);
            let mut ratio = [0.0; N];
            for k in 0..N {
                ratio[k] = (self.a + distance[k]) / pull;
                least[k] = least[k].min(ratio[k]);
                nearest[k] = nearest[k].min(distance[k]);
            }
            ratios.push(ratio);
            (h[1][0], h[2][0]) = (u, across);
        }
        // Only ratios of weights matter: the largest is 1, so that nothing overflows.
        let mut total = [0.0; N];
        for (ratio, s) in ratios.iter_mut().zip(&self.segments) {
            for k in 0..N {
                ratio[k] = least[k] / ratio[k];
            }
            self.power.of_lanes(ratio);
            for k in 0..N {
                ratio[k] *= s.weight;
                total[k] += ratio[k];
            }
        }
        for (weight, h) in ratios.iter().zip(h.chunks_exact_mut(TERMS)) {
            for k in 0..N {
                let share = weight[k] / total[k];
                h[0][0][k] = share;
                h[1][0][k] *= share;
                h[2][0][k] *= share;
            }
        }
        let snap = SNAP_SHARE * set.extent;
        // On a line the weights are 0/0 without `a`; such a lane is replaced.
        for k in 0..if self.a == 0.0 { N } else { 0 } {
            if nearest[k] <= snap {
                self.on_lines(k, Point::new(v.x[k], v.y[k]), snap, h);
            }
        }
    }
}

/// The normal of length 1.
fn normal(d: Vec2) -> Vec2 {
    let length = d.norm();
    Vec2::new(-d.y / length, d.x / length)
}

impl PointMap for BeierNeely {
    fn identity(&self, _form: CoefficientForm) -> Identity {
        Identity {
            plan: IDENTITY,
            rest: IDENTITY,
            numbers: vec![self.a, self.power.alpha(), self.p],
        }
    }

    fn is_smooth(&self, _set: &RestSet) -> bool {
        // It has a crease along two perpendiculars of each line, and cusps at its ends.
        false
    }

    fn of_part(&self, _part: &RestSet, _cancelled: IsCancelled<'_>) -> Option<Arc<dyn PointMap>> {
        // Methods are compared on points.
        None
    }

    fn segment_operations(&self) -> u64 {
        // One distance and one power.
        5
    }

    fn terms(&self, columns: usize) -> usize {
        TERMS * columns / 2
    }

    fn terms_of(&self, displacements: &[Vec2]) -> Option<Vec<Vec2>> {
        // f is linear in the posed start, direction and normal of each segment; the normal is not
        // linear in its ends.
        let terms = self.segments.iter().zip(displacements.chunks_exact(2));
        let terms = terms.flat_map(|(s, d)| {
            let (rest, moved) = (s.b - s.a, d[1] - d[0]);
            let posed = rest + moved;
            let turned = if posed.norm2() > 0.0 {
                normal(posed) - normal(rest)
            } else {
                Vec2::ZERO
            };
            [d[0], moved, turned]
        });
        Some(terms.collect())
    }

    fn undefined(&self, displacements: &[Vec2]) -> Option<usize> {
        let is_short =
            |(s, d): (&RestSegment, &[Vec2])| (s.b - s.a + (d[1] - d[0])).norm() < SHORTEST_SEGMENT;
        let mut lines = self.segments.iter().zip(displacements.chunks_exact(2));
        lines
            .position(is_short)
            .map(|line| self.segments[line].column)
    }

    fn layout(&self, _form: CoefficientForm) -> u32 {
        LAYOUT
    }
}
