//! f of one pose at positions that are used once, without their rows: the weights are summed as
//! they are computed, those of segments as moments from an end (mathematics 7.3). A position beside
//! a handle, at which such sums cancel, needs its row; one on a handle moves with it.

use super::falloff::{Falloff, Power};
use super::fitted_moments::{FittedLanes, FittedSums};
use super::incomplete_beta::IncompleteBeta;
use super::quick_moments::{SeenSegment, factor};
use super::segments::{Moments, View};
use crate::deform::columns::{HandleElements, RestSegment};
use crate::deform::form::{CoefficientForm, MotionLanes};
use crate::deform::kernel::{LaneWork, run_at};
use crate::deform::lanes::{LANES, Vertices};
use crate::deform::point_map::PosedOnce;
use crate::deform::tiles::{TILE_LANES, TileSource, add_sources, plus, squared_distances};
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;

/// Segments whose quick moments are computed before they are summed.
const QUICK_AT_ONCE: usize = 8;
/// Within this distance of a handle a position moves with it, px: that of displacements in single
/// precision.
const ON_HANDLE_PX: f64 = 1e-4;

/// Moments of segments at some positions.
struct MomentScratch {
    seen: [SeenSegment<TILE_LANES>; QUICK_AT_ONCE],
    quick: [[[f64; TILE_LANES]; 3]; QUICK_AT_ONCE],
    /// If they are not quick, of all segments and lanes.
    beyond: Vec<[[f64; LANES]; 3]>,
}

impl MomentScratch {
    const fn new() -> Self {
        Self {
            seen: [SeenSegment::ZERO; QUICK_AT_ONCE],
            quick: [[[0.0; TILE_LANES]; 3]; QUICK_AT_ONCE],
            beyond: Vec::new(),
        }
    }
}

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
            let is_quick = falloff.power() == Power::Two;
            let scale = if is_quick { factor(s) } else { 1.0 };
            let [at_a, middle, at_b] = [0.0, 0.5, 1.0].map(|t| {
                let factors = factors(s.a.lerp(s.b, t) - origin, da * (1.0 - t) + db * t);
                factors.map(|factor| scale * factor)
            });
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

    /// How half of the positions move.
    #[cfg_attr(not(optimized_for_size), inline(always))]
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    fn fitted(
        &self,
        x: &[f64; TILE_LANES],
        y: &[f64; TILE_LANES],
        half: usize,
        scratch: &mut MomentScratch,
    ) -> FittedLanes<TILE_LANES>
    where
        [[f64; TILE_LANES]; SUMS]: FittedSums<TILE_LANES>,
    {
        let mut sums = [[0.0; TILE_LANES]; SUMS];
        if self.falloff.power() == Power::Other {
            add_sources(self.falloff, &self.points, x, y, &mut sums);
        } else {
            for source in &self.points {
                // One source after the other: its weight waits for a division while the sums of
                // those before are added.
                let mut w = squared_distances(source.p, x, y);
                self.falloff.apply_to_squared(&mut w);
                sums = plus_all(sums, &source.factors, w);
            }
        }
        if self.falloff.power() == Power::Two {
            for segments in self.segments.chunks(QUICK_AT_ONCE) {
                let MomentScratch { seen, quick, .. } = &mut *scratch;
                for ((s, _), seen) in segments.iter().zip(&mut *seen) {
                    seen.see(s, x, y);
                }
                for (seen, moments) in seen[..segments.len()].iter().zip(&mut *quick) {
                    seen.put(moments);
                }
                for ((_, factors), moments) in segments.iter().zip(&*quick) {
                    sums = plus_segment(sums, factors, moments);
                }
            }
        } else {
            for ((_, factors), moments) in self.segments.iter().zip(&scratch.beyond) {
                for (factors, moment) in factors.iter().zip(moments) {
                    sums = plus_all(sums, factors, half_of(moment, half));
                }
            }
        }
        let (mut from_x, mut from_y) = (*x, *y);
        for k in 0..TILE_LANES {
            (from_x[k], from_y[k]) = (x[k] - self.origin.x, y[k] - self.origin.y);
        }
        sums.fitted(&from_x, &from_y)
    }

    /// Moments from a at all alphas but 2.
    #[cfg_attr(not(optimized_for_size), inline(always))]
    #[cfg_attr(optimized_for_size, inline(never))]
    fn put_moments(&self, v: &Vertices<LANES>, moments: &mut Vec<[[f64; LANES]; 3]>) {
        moments.clear();
        if self.falloff.power() == Power::Two {
            return;
        }
        let weight = (self.falloff, self.beta);
        for (s, _) in &self.segments {
            let view = View::new(s, v);
            let Moments([m0, mut m1, mut m2]) = view.moments(s, v, weight, &[1.0; LANES], false);
            for k in 0..LANES {
                // From moments about the nearest position to moments about a.
                let b = view.share_b[k];
                m2[k] += b * (2.0 * m1[k] + b * m0[k]);
                m1[k] += b * m0[k];
            }
            moments.push([m0, m1, m2]);
        }
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

/// Adds the moments of a segment. Along it, 1 is constant, p and d are linear, and second moments
/// are quadratic.
#[inline(always)]
fn plus_segment<const SUMS: usize>(
    sums: [[f64; TILE_LANES]; SUMS],
    factors: &[[f64; SUMS]; 3],
    moments: &[[f64; TILE_LANES]; 3],
) -> [[f64; TILE_LANES]; SUMS] {
    let mut sums = plus_all(sums, &factors[0], moments[0]);
    plus_four(&mut sums[1..5], &factors[1][1..5], moments[1]);
    for k in 1..3 {
        plus_three(&mut sums[5..8], &factors[k][5..8], moments[k]);
        if SUMS > 8 {
            plus_four(&mut sums[8..], &factors[k][8..], moments[k]);
        }
    }
    sums
}

#[inline(always)]
fn plus_three(sums: &mut [[f64; TILE_LANES]], factors: &[f64], lanes: [f64; TILE_LANES]) {
    sums[0] = plus(sums[0], factors[0], lanes);
    sums[1] = plus(sums[1], factors[1], lanes);
    sums[2] = plus(sums[2], factors[2], lanes);
}

#[inline(always)]
fn plus_four(sums: &mut [[f64; TILE_LANES]], factors: &[f64], lanes: [f64; TILE_LANES]) {
    sums[0] = plus(sums[0], factors[0], lanes);
    sums[1] = plus(sums[1], factors[1], lanes);
    sums[2] = plus(sums[2], factors[2], lanes);
    sums[3] = plus(sums[3], factors[3], lanes);
}

/// Positions by lane; the last one is repeated.
#[inline(always)]
fn lanes_of(places: &[Point]) -> Vertices<LANES> {
    let mut v = Vertices::all(places[places.len() - 1]);
    for (k, place) in places.iter().enumerate() {
        (v.x[k], v.y[k]) = (place.x, place.y);
    }
    v
}

/// Indices of the positions from `first` on that are not precise.
#[inline(always)]
fn note(is_precise: [bool; TILE_LANES], first: usize, end: usize, imprecise: &mut Vec<usize>) {
    if !is_precise.iter().fold(true, |all, lane| all & lane) {
        let lanes = (first..end).zip(is_precise);
        imprecise.extend(
            lanes
                .filter(|(_, precise)| !precise)
                .map(|(index, _)| index),
        );
    }
}

/// How some positions move.
struct MotionsOfPlaces<'a, const SUMS: usize> {
    sums: &'a PosedSums<'a, SUMS>,
    places: &'a [Point],
    out: &'a mut [MotionLanes<TILE_LANES>],
}

impl<const SUMS: usize> LaneWork for MotionsOfPlaces<'_, SUMS>
where
    [[f64; TILE_LANES]; SUMS]: FittedSums<TILE_LANES>,
{
    type Output = Vec<usize>;

    #[inline(always)]
    fn run(self) -> Vec<usize> {
        let (mut imprecise, mut scratch) = (Vec::new(), MomentScratch::new());
        let blocks = self.places.chunks(LANES).zip(self.out.chunks_mut(2));
        for (start, (places, out)) in (0..).step_by(LANES).zip(blocks) {
            let (v, end) = (lanes_of(places), start + places.len());
            self.sums.put_moments(&v, &mut scratch.beyond);
            for (half, out) in out.iter_mut().enumerate() {
                let (x, y) = (half_of(&v.x, half), half_of(&v.y, half));
                let fitted = self.sums.fitted(&x, &y, half, &mut scratch);
                *out = fitted.motion;
                note(
                    fitted.is_precise,
                    start + half * TILE_LANES,
                    end,
                    &mut imprecise,
                );
            }
        }
        imprecise
    }
}

/// Where some positions go.
struct MappedPlaces<'a, const SUMS: usize> {
    sums: &'a PosedSums<'a, SUMS>,
    form: CoefficientForm,
    places: &'a [Point],
    out: &'a mut [Point],
}

impl<const SUMS: usize> LaneWork for MappedPlaces<'_, SUMS>
where
    [[f64; TILE_LANES]; SUMS]: FittedSums<TILE_LANES>,
{
    type Output = Vec<usize>;

    #[inline(always)]
    fn run(self) -> Vec<usize> {
        let (mut imprecise, mut scratch) = (Vec::new(), MomentScratch::new());
        let blocks = self.places.chunks(LANES).zip(self.out.chunks_mut(LANES));
        for (start, (places, out)) in (0..).step_by(LANES).zip(blocks) {
            let (v, end) = (lanes_of(places), start + places.len());
            self.sums.put_moments(&v, &mut scratch.beyond);
            for (half, out) in out.chunks_mut(TILE_LANES).enumerate() {
                let (x, y) = (half_of(&v.x, half), half_of(&v.y, half));
                let fitted = self.sums.fitted(&x, &y, half, &mut scratch);
                let ([dx, dy], _) = fitted.motion.at(self.form, 1.0);
                let mut mapped = [Point::default(); TILE_LANES];
                for k in 0..TILE_LANES {
                    mapped[k] = Point::new(x[k] + dx[k], y[k] + dy[k]);
                }
                out.copy_from_slice(&mapped[..out.len()]);
                note(
                    fitted.is_precise,
                    start + half * TILE_LANES,
                    end,
                    &mut imprecise,
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
        let work = MotionsOfPlaces {
            sums: self,
            places,
            out: &mut *out,
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

    fn map(&self, form: CoefficientForm, places: &[Point], out: &mut [Point]) -> Vec<usize> {
        let work = MappedPlaces {
            sums: self,
            form,
            places,
            out: &mut *out,
        };
        let mut imprecise = run_at(SimdLevel::detect(), work);
        imprecise.retain(|index| {
            let on_handle = self.on_handle(places[*index]);
            if let Some(d) = on_handle {
                out[*index] = places[*index] + d;
            }
            on_handle.is_none()
        });
        imprecise
    }
}
