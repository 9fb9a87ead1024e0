//! f of one pose at positions that are used once, without their rows: the weights are summed as
//! they are computed, those of segments as moments from an end (mathematics 7.3). A position beside
//! a handle, at which such sums cancel, needs its row; one on a handle moves with it.

use super::falloff::{Falloff, Power};
use super::fitted_moments::FittedSums;
use super::incomplete_beta::IncompleteBeta;
use super::segments::{Moments, View, quick_moments};
use crate::deform::columns::{HandleElements, RestSegment};
use crate::deform::form::MotionLanes;
use crate::deform::kernel::{LaneWork, run_at};
use crate::deform::lanes::{LANES, Vertices, gather};
use crate::deform::point_map::PosedOnce;
use crate::deform::tiles::{TILE_LANES, TileSource, add_sources, plus, squared_distances};
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;

/// Within this distance of a handle a position moves with it, px.
const ON_HANDLE_PX: f64 = 1e-9;

/// What does not depend on the positions.
#[derive(Debug)]
pub(super) struct PosedSums<'a, const SUMS: usize> {
    origin: Point,
    falloff: Falloff,
    /// The closed form of segments, if alpha has one.
    beta: Option<&'a IncompleteBeta>,
    points: Vec<TileSource<SUMS>>,
    /// What the mass and the first two moments of each are multiplied by.
    segments: Vec<(RestSegment, [[f64; SUMS]; 3])>,
    elements: &'a HandleElements,
    d: &'a [Vec2],
}

impl<'a, const SUMS: usize> PosedSums<'a, SUMS> {
    /// `d`: the displacements of the columns, px. `factors`: of a position and its displacement.
    pub(super) fn new(
        elements: &'a HandleElements,
        d: &'a [Vec2],
        (falloff, beta): (Falloff, Option<&'a IncompleteBeta>),
        factors: impl Fn(Vec2, Vec2) -> [f64; SUMS],
    ) -> Self {
        let points = elements.points.iter().map(|source| source.p);
        let segments = elements.segments.iter();
        let places: Vec<Point> = points.chain(segments.map(|s| s.a.lerp(s.b, 0.5))).collect();
        let first = places.first().copied().unwrap_or_default();
        let sum = places.iter().fold(Vec2::ZERO, |sum, p| sum + (*p - first));
        // About the middle of the handles, sums lose fewest digits (mathematics 7.3).
        let origin = first + sum * (1.0 / places.len() as f64);
        let points = elements.points.iter().map(|source| {
            let factors = factors(source.p - origin, d[source.column]);
            TileSource {
                p: source.p,
                factors: factors.map(|factor| factor * source.mass),
            }
        });
        let segments = elements.segments.iter().map(|s| {
            // The factors at a share t of the way from a to b are c0 + c1 t + c2 t^2.
            let (da, db) = (d[s.column], d[s.column + 1]);
            let [at_a, middle, at_b] = [0.0, 0.5, 1.0]
                .map(|t| factors(s.a.lerp(s.b, t) - origin, da * (1.0 - t) + db * t));
            let mut c = [at_a; 3];
            for k in 0..SUMS {
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
            elements,
            d,
        }
    }

    /// The sums at the first and at the second half of the positions.
    #[inline(always)]
    fn sums(&self, v: &Vertices<LANES>) -> [[[f64; TILE_LANES]; SUMS]; 2] {
        let mut sums = [[[0.0; TILE_LANES]; SUMS]; 2];
        for (half, sums) in sums.iter_mut().enumerate() {
            let (x, y) = (half_of(&v.x, half), half_of(&v.y, half));
            if self.falloff.power() == Power::Other {
                add_sources(self.falloff, &self.points, &x, &y, sums);
                continue;
            }
            let mut at = *sums;
            for source in &self.points {
                // One source after the other: its weight waits for a division while the sums of
                // those before are added.
                let mut w = squared_distances(source.p, &x, &y);
                self.falloff.apply_to_squared(&mut w);
                at = plus_all(at, &source.factors, w);
            }
            *sums = at;
        }
        for (s, factors) in &self.segments {
            let moments = self.moments_from_a(s, v);
            for (half, sums) in sums.iter_mut().enumerate() {
                let mut at = *sums;
                for (factors, moment) in factors.iter().zip(&moments) {
                    at = plus_all(at, factors, half_of(moment, half));
                }
                *sums = at;
            }
        }
        sums
    }

    #[inline(always)]
    fn moments_from_a(&self, s: &RestSegment, v: &Vertices<LANES>) -> [[f64; LANES]; 3] {
        if self.falloff.power() == Power::Two {
            return quick_moments(s, v);
        }
        let weight = (self.falloff, self.beta);
        let view = View::new(s, v);
        let Moments([m0, mut m1, mut m2]) = view.moments(s, v, weight, &[1.0; LANES], false);
        for k in 0..LANES {
            // From moments about the nearest position to moments about a.
            let b = view.share_b[k];
            m2[k] += b * (2.0 * m1[k] + b * m0[k]);
            m1[k] += b * m0[k];
        }
        [m0, m1, m2]
    }

    /// How a position on a handle moves; `None`: on none, or on several that move differently.
    fn on_handle(&self, v: Point) -> Option<Vec2> {
        let points = self.elements.points.iter();
        let points = points.map(|source| (source.p, self.d[source.column]));
        let nearest = |s: &RestSegment| {
            let t = ((v - s.a).dot(s.tau) / s.length).clamp(0.0, 1.0);
            let [a, b] = [self.d[s.column], self.d[s.column + 1]];
            (s.a.lerp(s.b, t), a * (1.0 - t) + b * t)
        };
        let handles = points.chain(self.elements.segments.iter().map(nearest));
        let mut here = handles.filter(|(p, _)| p.distance(v) <= ON_HANDLE_PX);
        let (_, d) = here.next()?;
        here.all(|(_, other)| (other - d).norm() <= ON_HANDLE_PX)
            .then_some(d)
    }
}

#[inline(always)]
fn half_of(lanes: &[f64; LANES], half: usize) -> [f64; TILE_LANES] {
    let mut of_half = [0.0; TILE_LANES];
    of_half.copy_from_slice(&lanes[half * TILE_LANES..][..TILE_LANES]);
    of_half
}

/// Adds some lanes times each factor. In groups of four sums, which are written out: of a loop over
/// many sums the compiler makes vectors of one lane of several sums, and gathers them.
#[inline(always)]
fn plus_all<const SUMS: usize>(
    mut sums: [[f64; TILE_LANES]; SUMS],
    factors: &[f64; SUMS],
    lanes: [f64; TILE_LANES],
) -> [[f64; TILE_LANES]; SUMS] {
    const { assert!(SUMS == 8 || SUMS == 12, "two or three groups") };
    plus_four(&mut sums[..4], &factors[..4], lanes);
    plus_four(&mut sums[4..8], &factors[4..8], lanes);
    if SUMS > 8 {
        plus_four(&mut sums[8..], &factors[8..], lanes);
    }
    sums
}

#[inline(always)]
fn plus_four(sums: &mut [[f64; TILE_LANES]], factors: &[f64], lanes: [f64; TILE_LANES]) {
    sums[0] = plus(sums[0], factors[0], lanes);
    sums[1] = plus(sums[1], factors[1], lanes);
    sums[2] = plus(sums[2], factors[2], lanes);
    sums[3] = plus(sums[3], factors[3], lanes);
}

/// The work on some positions.
struct SumsAtPlaces<'a, const SUMS: usize> {
    sums: &'a PosedSums<'a, SUMS>,
    places: &'a [Point],
    out: &'a mut [MotionLanes<TILE_LANES>],
}

impl<const SUMS: usize> LaneWork for SumsAtPlaces<'_, SUMS>
where
    [[f64; TILE_LANES]; SUMS]: FittedSums<TILE_LANES>,
{
    type Output = Vec<usize>;

    #[inline(always)]
    fn run(self) -> Vec<usize> {
        let (origin, mut imprecise) = (self.sums.origin, Vec::new());
        let blocks = self.places.chunks(LANES).zip(self.out.chunks_mut(2));
        for (first, (places, out)) in (0..).step_by(LANES).zip(blocks) {
            let v = gather(|lane| places[lane.min(places.len() - 1)]);
            let sums = self.sums.sums(&v);
            for (half, (sums, out)) in sums.iter().zip(out).enumerate() {
                let (mut x, mut y) = (half_of(&v.x, half), half_of(&v.y, half));
                for k in 0..TILE_LANES {
                    (x[k], y[k]) = (x[k] - origin.x, y[k] - origin.y);
                }
                let fitted = sums.fitted(&x, &y);
                *out = fitted.motion;
                if fitted.is_precise.iter().fold(true, |all, lane| all & lane) {
                    continue;
                }
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

impl<const SUMS: usize> PosedOnce for PosedSums<'_, SUMS>
where
    [[f64; TILE_LANES]; SUMS]: FittedSums<TILE_LANES>,
{
    fn motions(&self, places: &[Point], out: &mut [MotionLanes<TILE_LANES>]) -> Vec<usize> {
        let (sums, work_out) = (self, &mut *out);
        let work = SumsAtPlaces {
            sums,
            places,
            out: work_out,
        };
        let mut imprecise = run_at(SimdLevel::detect(), work);
        imprecise.retain(|index| {
            let on_handle = self.on_handle(places[*index]);
            if let Some(d) = on_handle {
                let motion = [d, Vec2::ZERO, Vec2::ZERO];
                out[index / TILE_LANES].put(index % TILE_LANES, motion);
            }
            on_handle.is_none()
        });
        imprecise
    }
}
