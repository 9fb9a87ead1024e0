//! f of one pose at positions that are used once, without their rows: the weights are summed as
//! they are computed, those of segments as moments from an end (mathematics 7.3). A position beside
//! a handle, at which such sums cancel, needs its row.

use super::falloff::Falloff;
use super::fitted_moments::{FittedSums, SIMILARITY_SUMS, similarity_factors};
use super::incomplete_beta::IncompleteBeta;
use super::segments::{Moments, View};
use crate::deform::columns::{HandleElements, RestSegment};
use crate::deform::form::MotionLanes;
use crate::deform::kernel::{LaneWork, run_at};
use crate::deform::lanes::{LANES, Vertices, gather};
use crate::deform::point_map::PosedOnce;
use crate::deform::tiles::{TILE_LANES, TileSource, add_sources, plus};
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;

/// What does not depend on the positions, for similarities and rigid maps.
#[derive(Debug)]
pub(super) struct PosedSums<'a> {
    origin: Point,
    falloff: Falloff,
    /// The closed form of segments, if alpha has one.
    beta: Option<&'a IncompleteBeta>,
    points: Vec<TileSource<SIMILARITY_SUMS>>,
    /// What the mass and the first two moments of each are multiplied by.
    segments: Vec<(RestSegment, [[f64; SIMILARITY_SUMS]; 3])>,
}

impl<'a> PosedSums<'a> {
    /// `d`: the displacements of the columns, px.
    pub(super) fn new(
        elements: &HandleElements,
        d: &[Vec2],
        (falloff, beta): (Falloff, Option<&'a IncompleteBeta>),
    ) -> Self {
        let points = elements.points.iter().map(|source| source.p);
        let segments = elements.segments.iter();
        let places: Vec<Point> = points.chain(segments.map(|s| s.a.lerp(s.b, 0.5))).collect();
        let first = places.first().copied().unwrap_or_default();
        let sum = places.iter().fold(Vec2::ZERO, |sum, p| sum + (*p - first));
        // About the middle of the handles, sums lose fewest digits (mathematics 7.3).
        let origin = first + sum * (1.0 / places.len() as f64);
        let points = elements.points.iter().map(|source| {
            let factors = similarity_factors(source.p - origin, d[source.column]);
            TileSource {
                p: source.p,
                factors: factors.map(|factor| factor * source.mass),
            }
        });
        let segments = elements.segments.iter().map(|s| {
            // The factors at a share t of the way from a to b are c0 + c1 t + c2 t^2.
            let (da, db) = (d[s.column], d[s.column + 1]);
            let [at_a, middle, at_b] = [0.0, 0.5, 1.0]
                .map(|t| similarity_factors(s.a.lerp(s.b, t) - origin, da * (1.0 - t) + db * t));
            let mut c = [at_a; 3];
            for k in 0..SIMILARITY_SUMS {
                let (half, whole) = (middle[k] - at_a[k], at_b[k] - at_a[k]);
                (c[1][k], c[2][k]) = (4.0 * half - whole, 2.0 * whole - 4.0 * half);
            }
            (*s, c)
        });
        Self {
            origin,
            falloff,
            beta,
            points: points.collect(),
            segments: segments.collect(),
        }
    }

    /// The sums at the first and at the second half of the positions.
    #[inline(always)]
    fn sums(&self, v: &Vertices<LANES>) -> [[[f64; TILE_LANES]; SIMILARITY_SUMS]; 2] {
        let weight = (self.falloff, self.beta);
        let mut sums = [[[0.0; TILE_LANES]; SIMILARITY_SUMS]; 2];
        for (half, sums) in sums.iter_mut().enumerate() {
            let (x, y) = (half_of(&v.x, half), half_of(&v.y, half));
            add_sources(self.falloff, &self.points, &x, &y, sums);
        }
        for (s, [c0, c1, c2]) in &self.segments {
            let view = View::new(s, v);
            let Moments([m0, mut m1, mut m2]) = view.moments(s, v, weight, &[1.0; LANES], false);
            for k in 0..LANES {
                // From moments about the nearest position to moments about a.
                let b = view.share_b[k];
                m2[k] += b * (2.0 * m1[k] + b * m0[k]);
                m1[k] += b * m0[k];
            }
            for (half, sums) in sums.iter_mut().enumerate() {
                let [m0, m1, m2] = [half_of(&m0, half), half_of(&m1, half), half_of(&m2, half)];
                let mut at = *sums;
                for k in 0..SIMILARITY_SUMS {
                    at[k] = plus(plus(plus(at[k], c0[k], m0), c1[k], m1), c2[k], m2);
                }
                *sums = at;
            }
        }
        sums
    }
}

#[inline(always)]
fn half_of(lanes: &[f64; LANES], half: usize) -> [f64; TILE_LANES] {
    let mut of_half = [0.0; TILE_LANES];
    of_half.copy_from_slice(&lanes[half * TILE_LANES..][..TILE_LANES]);
    of_half
}

/// The work on some positions.
struct SumsAtPlaces<'a> {
    sums: &'a PosedSums<'a>,
    places: &'a [Point],
    out: &'a mut Vec<MotionLanes<TILE_LANES>>,
}

impl LaneWork for SumsAtPlaces<'_> {
    type Output = Vec<usize>;

    #[inline(always)]
    fn run(self) -> Vec<usize> {
        let (origin, mut imprecise) = (self.sums.origin, Vec::new());
        for (first, places) in (0..).step_by(LANES).zip(self.places.chunks(LANES)) {
            let v = gather(|lane| places[lane.min(places.len() - 1)]);
            let sums = self.sums.sums(&v);
            for (half, sums) in sums
                .iter()
                .take(places.len().div_ceil(TILE_LANES))
                .enumerate()
            {
                let (mut x, mut y) = (half_of(&v.x, half), half_of(&v.y, half));
                for k in 0..TILE_LANES {
                    (x[k], y[k]) = (x[k] - origin.x, y[k] - origin.y);
                }
                let fitted = sums.fitted(&x, &y);
                self.out.push(fitted.motion);
                let lanes = (half * TILE_LANES..places.len()).zip(fitted.is_precise);
                imprecise.extend(
                    lanes
                        .filter(|(_, precise)| !precise)
                        .map(|(lane, _)| first + lane),
                );
            }
        }
        imprecise
    }
}

impl PosedOnce for PosedSums<'_> {
    fn motions(&self, places: &[Point], out: &mut Vec<MotionLanes<TILE_LANES>>) -> Vec<usize> {
        let sums = self;
        run_at(SimdLevel::detect(), SumsAtPlaces { sums, places, out })
    }
}
