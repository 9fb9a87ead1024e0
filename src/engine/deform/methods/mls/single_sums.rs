//! f of one pose at many positions from some dozen points of equal mass with alpha 1, similarity or
//! rigid, in single precision: their weights are computed again for each position, which takes less
//! time than reading as many coefficients from memory.
//!
//! With `w = 1 / |p - v|^2`, the sums are those of w, w p, w d, w conj(p) d and w |p|^2 about the
//! middle of the points, px. Near points the second moment about p* is `n / sum w - |v - p*|^2`
//! instead of the last sum's, since every `w |p - v|^2` is 1: this keeps its digits beside a point.
//! Very near a point and very far from all of them, single precision is not enough, and f is
//! computed in f64 ([`MomentInputs`]); mathematics 7.3.

use std::sync::OnceLock;

use super::falloff::Falloff;
use super::moments::MomentInputs;
use crate::deform::IsCancelled;
use crate::deform::coefficient_table::to_f32;
use crate::deform::columns::PointSource;
use crate::deform::form::CoefficientForm;
use crate::deform::kernel::{LaneWork, run_at};
use crate::deform::lanes::LANES;
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;
use crate::parallel::prelude::*;

/// Positions of a task.
const POSITIONS_PER_TASK: usize = 512;
/// The least squared distance that is divided by, px^2: at a point itself its weight stays finite.
const LEAST_SQUARE: f32 = 1e-12;
/// The least |m| at which single precision is enough.
const LEAST_ROTATION: f32 = 0.0625;
/// Single precision is enough up to this ratio of a position's distance from the origin to that
/// from its nearest point: rounding the sums of this point moves f by about 2^-24 of the ratio,
/// over the number of points, times its displacement.
const MOST_NEARER: f32 = 256.0;
/// The same for the product of |v - p*| and the root of the lesser second moment, over that about
/// p*: 2^-24 of it, times the displacements, whatever the number of points.
const MOST_CANCELLED: f32 = 32.0;

type SingleLanes = [f32; LANES];

/// What the weight of a point is multiplied by.
#[derive(Clone, Copy, Debug)]
struct SingleFactors {
    /// The point from the origin, px.
    p: [f32; 2],
    /// Its displacement beyond the common one, px.
    d: [f32; 2],
    /// conj(p) d.
    p_d: [f32; 2],
    /// |p|^2.
    square: f32,
}

/// The sums of w, w p, w d, w conj(p) d, w |p|^2.
struct WeightSums {
    w: SingleLanes,
    p: [SingleLanes; 2],
    d: [SingleLanes; 2],
    p_d: [SingleLanes; 2],
    square: SingleLanes,
}

/// What does not depend on the positions.
#[derive(Debug)]
pub(super) struct SingleSums<'a> {
    points: &'a [PointSource],
    /// Displacements of the points, px.
    d: &'a [Vec2],
    falloff: Falloff,
    form: CoefficientForm,
    /// The mean of the points, and that of the displacements.
    origin: Point,
    shift: Vec2,
    factors: Vec<SingleFactors>,
    /// The same map in f64, made when a position first needs it.
    in_double: OnceLock<MomentInputs<'a>>,
}

impl<'a> SingleSums<'a> {
    /// Of points of equal mass, which is left out. `d`: their displacements, px.
    pub(super) fn new(
        points: &'a [PointSource],
        d: &'a [Vec2],
        falloff: Falloff,
        form: CoefficientForm,
    ) -> Self {
        let share = 1.0 / points.len() as f64;
        let (mut origin, mut shift) = (points[0].p, Vec2::ZERO);
        for (source, d) in points.iter().zip(d) {
            // Handles far from the origin of the picture, or moved together, lose no digits
            // (mathematics 7.3).
            (origin, shift) = (
                origin + (source.p - points[0].p) * share,
                shift + *d * share,
            );
        }
        let factors = points.iter().zip(d).map(|(source, d)| {
            let (p, d) = (source.p - origin, *d - shift);
            #[expect(clippy::cast_possible_truncation, reason = "single precision")]
            let square = p.norm2() as f32;
            SingleFactors {
                p: to_f32(p),
                d: to_f32(d),
                p_d: to_f32(Vec2::new(p.dot(d), p.cross(d))),
                square,
            }
        });
        Self {
            points,
            d,
            falloff,
            form,
            origin,
            shift,
            factors: factors.collect(),
            in_double: OnceLock::new(),
        }
    }

    /// `f(v) - v`, px, and |m| (rigid), else 1, of every place. `None` when cancelled.
    pub(super) fn displaced_at(
        &self,
        level: SimdLevel,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<[f32; 3]>> {
        let parts: Option<Vec<_>> = places
            .par_chunks(POSITIONS_PER_TASK)
            .map(|places| {
                let inputs = self;
                (!cancelled()).then(|| run_at(level, SingleDisplacements { inputs, places }))
            })
            .collect();
        let (mut out, mut again) = (Vec::with_capacity(places.len()), Vec::new());
        for (moved, of_part) in parts? {
            again.extend(of_part.into_iter().map(|index: usize| out.len() + index));
            out.extend(moved);
        }
        if again.is_empty() {
            return Some(out);
        }
        // Tiles are not worth their time for the few positions.
        let new = || MomentInputs::new(self.points, self.d, self.falloff, self.form, false);
        let there: Vec<Point> = again.iter().map(|index| places[*index]).collect();
        let moved = (self.in_double.get_or_init(new)).displaced_at(level, &there, cancelled)?;
        for (index, moved) in again.into_iter().zip(moved) {
            out[index] = moved;
        }
        Some(out)
    }

    /// Displacements and |m| of positions from the origin, and whether single precision is enough.
    #[cfg_attr(not(optimized_for_size), inline(always))]
    #[cfg_attr(optimized_for_size, inline(never))]
    fn fitted(
        &self,
        sums: &WeightSums,
        x: &SingleLanes,
        y: &SingleLanes,
    ) -> ([SingleLanes; 3], [bool; LANES]) {
        let (mut out, mut is_enough) = ([[0.0; LANES]; 3], [false; LANES]);
        #[expect(clippy::cast_precision_loss, reason = "few points")]
        let count = self.points.len() as f32;
        let [shift_x, shift_y] = to_f32(self.shift);
        let is_rigid = self.form == CoefficientForm::Rigid;
        for k in 0..LANES {
            let per_weight = 1.0 / sums.w[k];
            let (px, py) = (sums.p[0][k] * per_weight, sums.p[1][k] * per_weight);
            let (dx, dy) = (sums.d[0][k] * per_weight, sums.d[1][k] * per_weight);
            let (ex, ey) = (x[k] - px, y[k] - py);
            let reach = ex * ex + ey * ey;
            // The second moments about v and about the origin. The smaller one cancels less.
            let (about_v, about_origin) = (count * per_weight, sums.square[k] * per_weight);
            let is_near = about_v < about_origin;
            let about = if is_near { about_v } else { about_origin };
            let spread = about - if is_near { reach } else { px * px + py * py };
            let per_spread = 1.0 / spread;
            let ux = (sums.p_d[0][k] * per_weight - (px * dx + py * dy)) * per_spread;
            let uy = (sums.p_d[1][k] * per_weight - (px * dy - py * dx)) * per_spread;
            // rho(u) as in `kernel/scalar.rs`. Where |m| is small, f is computed in f64.
            let mx = 1.0 + ux;
            let n = (mx * mx + uy * uy).sqrt();
            let is_ahead = mx > 0.0;
            let more = if is_ahead { n + mx } else { 1.0 };
            let over = if is_ahead { -(uy * uy) } else { mx - n };
            let scale = 1.0 / (n * more);
            let (rx, ry) = if is_rigid {
                (over * scale, uy * (more * scale))
            } else {
                (ux, uy)
            };
            out[0][k] = shift_x + (dx + (ex * rx - ey * ry));
            out[1][k] = shift_y + (dy + (ex * ry + ey * rx));
            out[2][k] = if is_rigid { n } else { 1.0 };
            let from_origin = x[k] * x[k] + y[k] * y[k];
            is_enough[k] = from_origin * sums.w[k] <= MOST_NEARER * MOST_NEARER
                && about * reach <= MOST_CANCELLED * MOST_CANCELLED * spread * spread
                && spread > 0.0
                && (!is_rigid || n > LEAST_ROTATION);
        }
        (out, is_enough)
    }
}

/// The sums at a block of positions from the origin.
#[cfg_attr(not(optimized_for_size), inline(always))]
#[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
fn sums(factors: &[SingleFactors], x: &SingleLanes, y: &SingleLanes) -> WeightSums {
    let mut w_sum = [0.0; LANES];
    let [
        mut px,
        mut py,
        mut dx,
        mut dy,
        mut dot,
        mut cross,
        mut squares,
    ] = [[0.0; LANES]; 7];
    for factors in factors {
        let SingleFactors {
            p,
            d,
            p_d,
            square: p_p,
        } = factors;
        for k in 0..LANES {
            let (rx, ry) = (p[0] - x[k], p[1] - y[k]);
            let square = rx * rx + ry * ry;
            let w = 1.0
                / if square > LEAST_SQUARE {
                    square
                } else {
                    LEAST_SQUARE
                };
            w_sum[k] += w;
            px[k] += w * p[0];
            py[k] += w * p[1];
            dx[k] += w * d[0];
            dy[k] += w * d[1];
            dot[k] += w * p_d[0];
            cross[k] += w * p_d[1];
            squares[k] += w * p_p;
        }
    }
    WeightSums {
        w: w_sum,
        p: [px, py],
        d: [dx, dy],
        p_d: [dot, cross],
        square: squares,
    }
}

/// The displacements of some positions, and the indices of those for which single precision is not
/// enough.
struct SingleDisplacements<'s, 'a> {
    inputs: &'s SingleSums<'a>,
    places: &'s [Point],
}

impl LaneWork for SingleDisplacements<'_, '_> {
    type Output = (Vec<[f32; 3]>, Vec<usize>);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let (mut out, mut again) = (Vec::with_capacity(self.places.len()), Vec::new());
        for places in self.places.chunks(LANES) {
            let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
            for k in 0..LANES {
                // Lanes beyond the last place repeat it.
                [x[k], y[k]] = to_f32(places[k.min(places.len() - 1)] - self.inputs.origin);
            }
            let sums = sums(&self.inputs.factors, &x, &y);
            let ([dx, dy, m], is_enough) = self.inputs.fitted(&sums, &x, &y);
            for k in 0..places.len() {
                if !is_enough[k] {
                    again.push(out.len());
                }
                out.push([dx[k], dy[k], m[k]]);
            }
        }
        (out, again)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;

    use super::super::moments::set;
    use super::*;
    use crate::deform::{Handle, Handles, Method, Pose, RestDeformation};

    const METHODS: [Method; 2] = [Method::Similarity, Method::Rigid];

    fn by_single_sums(
        field: &RestDeformation,
        d: &[Vec2],
        places: &[Point],
        level: SimdLevel,
    ) -> Vec<[f32; 3]> {
        let (points, falloff) = (&field.set.sources.points, Falloff::new(1.0, false).unwrap());
        let sums = SingleSums::new(points, d, falloff, field.form());
        sums.displaced_at(level, places, &|| false).unwrap()
    }

    /// The largest distance from where exact evaluation takes some places, px.
    fn off(field: &RestDeformation, pose: &Pose, places: &[Point], level: SimdLevel) -> f64 {
        let moved = by_single_sums(field, pose.displacements(), places, level);
        let each = moved.into_iter().zip(places).map(|([x, y, _], place)| {
            (*place + Vec2::new(x.into(), y.into())).distance(field.map(pose, *place))
        });
        each.fold(0.0, f64::max)
    }

    proptest! {
        /// Anywhere, also a hair beside points and far away.
        #[test]
        fn single_sums_give_what_rows_give(
            method in prop::sample::select(&METHODS[..]),
            (count, half) in (3..=128_u32, 0..500_u32),
            (x, y) in (-200.0..700.0_f64, -200.0..600.0_f64),
            (angle, far) in (0.0..TAU, 0.0..5.0_f64),
        ) {
            let (field, pose) = set(method, 1.0, count, 2 * half);
            let Handle::Point(p) = field.handles().handles()[0] else { unreachable!() };
            let at = |r: f64| p + Vec2::new(angle.cos(), angle.sin()) * r;
            let mut places: Vec<Point> = (-9..3).map(|k| at(10f64.powi(k))).collect();
            places.extend([p, Point::new(x.round(), y), Point::new(x, y)]);
            for level in SimdLevel::available() {
                // Displacements differ by up to 42 px. Sets of few points have a table instead.
                let allowed = if count > 32 { 3e-4 } else { 1e-3 };
                let off_near = off(&field, &pose, &places, *level);
                prop_assert!(off_near <= allowed, "{off_near} px");
                // Far away, a position turns about the points.
                let distance = 10f64.powf(far);
                let off_far = off(&field, &pose, &[at(distance)], *level);
                prop_assert!(off_far <= allowed + 1e-6 * distance, "{distance}: {off_far} px");
            }
        }
    }

    /// A set of points without weights, and a pose.
    fn posed(method: Method, p: &[Point], q: &[Point]) -> (RestDeformation, Pose) {
        let handles = |places: &[Point]| places.iter().map(|p| Handle::Point(*p)).collect();
        let rest = Handles::new(handles(p), None).unwrap();
        let falloff = Falloff::new(1.0, false).unwrap();
        let field = RestDeformation::new(rest, method, falloff, 1.0).unwrap();
        let pose = field.pose(&handles(q)).unwrap();
        (field, pose)
    }

    /// Clusters, close pairs and points on a line; noise, a turn, and points drawn together; beside
    /// points and between them, and up to many times as far away as they are.
    #[test]
    fn errors_are_a_small_share_of_the_displacements() {
        let mut state = 7_u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1_u32 << 23) - 1.0
        };
        for (kind, method) in (0..4).flat_map(|kind| METHODS.map(|method| (kind, method))) {
            let p: Vec<Point> = (0..64)
                .map(|k| {
                    let (k, end) = (f64::from(k), 1500.0 * f64::from(k % 2));
                    let (x, y) = (noise(), noise());
                    match kind {
                        0 => Point::new(500.0 * x, 400.0 * y),
                        1 => Point::new(end + 5.0 * x, 700.0 + 5.0 * y),
                        2 => Point::new((k / 2.0).floor() * 9.0 + (k % 2.0) * 1.5, 1.0 + y),
                        _ => Point::new(7.0 * k + x, 300.0),
                    }
                })
                .collect();
            let middle = Point::new(300.0, 200.0);
            let turned = Vec2::new(0.6f64.cos(), 0.6f64.sin());
            for shape in [Vec2::new(1.0, 0.0), turned, Vec2::new(0.1, 0.0)] {
                let q: Vec<Point> = p
                    .iter()
                    .map(|p| middle + shape.complex_mul(*p - middle) + Vec2::new(noise(), noise()))
                    .collect();
                let (field, pose) = posed(method, &p, &q);
                let d = pose.displacements();
                let mean = d.iter().fold(Vec2::ZERO, |sum, d| sum + *d) * (1.0 / d.len() as f64);
                let largest = d.iter().map(|d| (*d - mean).norm()).fold(0.0, f64::max);
                let places: Vec<Point> = (0..600)
                    .map(|k| {
                        let angle = Vec2::new(noise(), noise());
                        p[k % p.len()] + angle * 10f64.powf(k as f64 / 100.0 - 2.0)
                    })
                    .collect();
                let moved = by_single_sums(&field, d, &places, SimdLevel::detect());
                for ([x, y, _], place) in moved.into_iter().zip(&places) {
                    let (got, want) = (
                        Vec2::new(x.into(), y.into()),
                        field.map(&pose, *place) - *place,
                    );
                    let share = (got - want).norm() / (largest + (want - mean).norm());
                    assert!(
                        share <= 4e-5,
                        "{kind} {method:?} {shape:?} {place:?}: {share:e}"
                    );
                }
            }
        }
    }

    #[test]
    fn every_level_gives_the_same_bits_and_points_are_met_exactly() {
        for method in METHODS {
            let (field, pose) = set(method, 1.0, 100, 4);
            let d = pose.displacements();
            let points: Vec<Point> = field.set.sources.points.iter().map(|s| s.p).collect();
            let met = by_single_sums(&field, d, &points, SimdLevel::Scalar);
            assert!(
                met.iter()
                    .zip(d)
                    .all(|([x, y, _], d)| [*x, *y] == to_f32(*d))
            );
            let beside: Vec<Point> = points.iter().map(|p| *p + Vec2::new(3.1, -0.7)).collect();
            let reference = by_single_sums(&field, d, &beside, SimdLevel::Scalar);
            for level in SimdLevel::available() {
                let moved = by_single_sums(&field, d, &beside, *level);
                assert_eq!(moved, reference, "{level:?} {method:?}");
            }
        }
    }

    /// Translations to the last bit, rotations about any centre; among the points, and as far away
    /// as single precision goes.
    #[test]
    fn motions_of_all_points_are_reproduced() {
        let places: Vec<Point> = (0..2500_u32)
            .map(|k| Point::new(f64::from(k % 50) * 60.0, f64::from(k / 50) * 60.0))
            .collect();
        for method in METHODS {
            let (field, _) = set(method, 1.0, 100, 4);
            let points: Vec<Point> = field.set.sources.points.iter().map(|s| s.p).collect();
            let d = vec![Vec2::new(31.7, -12.3); points.len()];
            let moved = by_single_sums(&field, &d, &places, SimdLevel::detect());
            assert!(moved.iter().all(|[x, y, _]| [*x, *y] == to_f32(d[0])));
            let centre = Point::new(900.0, -300.0);
            let turn = Vec2::new(0.6f64.cos(), 0.6f64.sin());
            let turned = |p: Point| centre + turn.complex_mul(p - centre) - p;
            let d: Vec<Vec2> = points.iter().map(|p| turned(*p)).collect();
            let moved = by_single_sums(&field, &d, &places, SimdLevel::detect());
            for ([x, y, _], place) in moved.into_iter().zip(&places) {
                let off = (Vec2::new(x.into(), y.into()) - turned(*place)).norm();
                // The points move by up to 530 px from each other.
                assert!(off < 4e-5 * 530.0, "{place:?}: {off} px");
            }
        }
    }

    /// The bits depend neither on the other positions nor on the number of threads.
    #[test]
    fn a_position_has_its_own_bits() {
        let (field, pose) = set(Method::Rigid, 1.0, 100, 4);
        let places: Vec<Point> = (0..1200_u32)
            .map(|k| Point::new(f64::from(k % 40) * 15.0, f64::from(k / 40) * 15.0))
            .collect();
        let d = pose.displacements();
        let of = |places: &[Point]| by_single_sums(&field, d, places, SimdLevel::detect());
        let together = of(&places);
        for first in [1, 7, 500] {
            assert_eq!(of(&places[first..]), together[first..]);
        }
        for threads in [1, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            assert_eq!(pool.unwrap().install(|| of(&places)), together);
        }
    }
}
