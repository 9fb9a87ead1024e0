//! f at N vertices from the moments of the weights, without a row of coefficients: for poses of
//! many points whose rows are used once. Equations (1) to (8).
//!
//! The moments are sums about one origin of the set, so that a vertex and a point take a division
//! and about twenty operations; what does not depend on the vertex is computed once per pose. Where
//! almost all weight is that of one point, such sums cancel. The vertices at which they do are
//! computed again, anchored at their heaviest point: its position and displacement are the origin
//! of all others, so every sum consists of relatively exact terms (mathematics 7.1), at several
//! times the cost.

use super::falloff::Falloff;
use super::fitted_moments::{
    AFFINE_SUMS, FittedSums, Means, SIMILARITY_SUMS, affine_factors, similarity_factors,
};
use crate::deform::IsCancelled;
use crate::deform::columns::PointSource;
use crate::deform::form::{CoefficientForm, rho};
use crate::deform::kernel::{LaneWork, run_at};
use crate::deform::tiles::{
    RadialKernel, TILE_LANES, Tile, TileRules, TileSource, Tiles, squared_distances,
};
use crate::geometry::lane_math::hypot;
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;

#[cfg(test)]
pub(super) use self::tests::set;

/// Vertices that are anchored at once.
const ANCHORED_VERTICES: usize = 8;
/// Nodes of a tile along each axis: those of the Chebyshev polynomial of this degree.
const TILE_NODES: usize = 8;
const NODES: [f64; TILE_NODES] = [
    -0.980_785_280_403_230_4,
    -0.831_469_612_302_545_2,
    -0.555_570_233_019_602_2,
    -0.195_090_322_016_128_27,
    0.195_090_322_016_128_27,
    0.555_570_233_019_602_2,
    0.831_469_612_302_545_2,
    0.980_785_280_403_230_4,
];
/// A point is far from a tile if their distance is at least this many times half the tile's side.
/// That holds for alpha up to 1; beyond it, each 1 of alpha adds [`FAR_PER_ALPHA`]. Then its weight
/// is within 1e-5 of itself (mathematics 7.4).
const FAR_AT_ALPHA_1: f64 = 3.5;
const FAR_PER_ALPHA: f64 = 1.5;
/// Above this alpha all weights are summed: those of distant points hardly count in any case.
const MOST_TILED: f64 = 2.0;
/// The side of the smallest tile, px.
const SMALLEST_TILE: f64 = 4.0;
/// A tile with at most this number of points nearby is not divided: its nodes would take longer.
const MOST_NEAR: usize = 40;
/// Affine: the least determinant of the second moments, as a share of the product of both.
const SINGULAR_DETERMINANT_SHARE: f64 = 1e-14;
/// The input that does not depend on the vertices.
#[derive(Debug)]
pub(in crate::deform) struct MomentInputs<'a> {
    points: &'a [PointSource],
    /// Displacements of the points, px.
    d: &'a [Vec2],
    falloff: Falloff,
    form: CoefficientForm,
    /// The origins of positions and displacements.
    origin: Point,
    shift: Vec2,
    sums: MomentTiles,
}

/// The sums of the weights times, of each point,
#[derive(Debug)]
enum MomentTiles {
    /// 1, p, d, |p|^2, conj(p) d.
    Similar(Tiles<Falloff, SIMILARITY_SUMS, TILE_NODES>),
    /// 1, p, d, x x, x y, y y, x d, y d.
    Affine(Tiles<Falloff, AFFINE_SUMS, TILE_NODES>),
}

impl RadialKernel for Falloff {
    #[inline(always)]
    fn weights_from_squares(self, squares: &mut [f64]) {
        self.apply_to_squared(squares);
    }
}

/// The heaviest point of each vertex, which is the origin of its sums: squared distance, mass,
/// position, displacement.
struct MomentOrigin {
    r2: [f64; ANCHORED_VERTICES],
    mass: [f64; ANCHORED_VERTICES],
    p: [Point; ANCHORED_VERTICES],
    d: [Vec2; ANCHORED_VERTICES],
}

impl<'a> MomentInputs<'a> {
    /// Whether what is far away takes next to no time.
    pub(in crate::deform) fn are_tiled(falloff: Falloff) -> bool {
        falloff.alpha() <= MOST_TILED
    }

    /// `d`: the displacements of the points, px; without tiles, all points are summed at every
    /// position, which is quicker for a few positions.
    pub(in crate::deform) fn new(
        points: &'a [PointSource],
        d: &'a [Vec2],
        falloff: Falloff,
        form: CoefficientForm,
        are_tiled: bool,
    ) -> Self {
        let sum = points
            .iter()
            .fold(Vec2::ZERO, |sum, source| sum + (source.p - points[0].p));
        // Sums are taken about the middle of the points and beyond the first displacement: handles
        // far from the origin of the picture, or moved together, lose no digits (mathematics 7.3).
        let (origin, shift) = (points[0].p + sum * (1.0 / points.len() as f64), d[0]);
        let alpha = falloff.alpha();
        let rules = TileRules {
            nodes: NODES,
            far: FAR_AT_ALPHA_1 + FAR_PER_ALPHA * (alpha - 1.0).max(0.0),
            // Otherwise nothing counts as far, and one tile has all points nearby.
            smallest: if are_tiled {
                SMALLEST_TILE
            } else {
                f64::INFINITY
            },
            largest: f64::INFINITY,
            most_near: MOST_NEAR,
        };
        let sums = if form == CoefficientForm::Real {
            let sources = sources(points, d, |p, d| affine_factors(p - origin, d - shift));
            MomentTiles::Affine(Tiles::new(falloff, sources, rules))
        } else {
            let sources = sources(points, d, |p, d| similarity_factors(p - origin, d - shift));
            MomentTiles::Similar(Tiles::new(falloff, sources, rules))
        };
        Self {
            points,
            d,
            falloff,
            form,
            origin,
            shift,
            sums,
        }
    }

    /// `f(v) - v`, px, and |m| (rigid), else 1, of every place. `None` when cancelled.
    pub(in crate::deform) fn displaced_at(
        &self,
        level: SimdLevel,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<[f32; 3]>> {
        match &self.sums {
            MomentTiles::Similar(tiles) => self.displaced(level, tiles, places, cancelled),
            MomentTiles::Affine(tiles) => self.displaced(level, tiles, places, cancelled),
        }
    }

    fn displaced<const SUMS: usize>(
        &self,
        level: SimdLevel,
        tiles: &Tiles<Falloff, SUMS, TILE_NODES>,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<[f32; 3]>>
    where
        [[f64; TILE_LANES]; SUMS]: FittedSums<TILE_LANES>,
    {
        tiles.map(level, places, cancelled, |tile, places, out| {
            run_at(
                level,
                TileDisplacements {
                    inputs: self,
                    tiles,
                    tile,
                    places,
                    out,
                },
            );
        })
    }

    /// The displacements of at most [`ANCHORED_VERTICES`] places from the sums about their heaviest
    /// points.
    #[inline(always)]
    fn anchor_again(&self, again: &[usize], places: &[Point], out: &mut [[f32; 3]]) {
        let (mut x, mut y) = ([0.0; ANCHORED_VERTICES], [0.0; ANCHORED_VERTICES]);
        // Lanes beyond the last place repeat it, so that no lane has to be left out.
        for k in 0..ANCHORED_VERTICES {
            let place = places[again[k.min(again.len() - 1)]];
            (x[k], y[k]) = (place.x, place.y);
        }
        let anchor = self.anchor(&x, &y);
        let sums = self.anchored_sums(&x, &y, &anchor);
        for (k, &place) in again.iter().enumerate() {
            let (d, m) = self.anchored(Point::new(x[k], y[k]) - anchor.p[k], &Means::of(&sums, k));
            out[place] = single(anchor.d[k] + d, m);
        }
    }

    /// The displacement of v, px, and `|m|` (mathematics 2.3): `e = v - p*`, `d` the mean
    /// displacement.
    fn turned(&self, e: Vec2, d: Vec2, u: Vec2) -> (Vec2, f64) {
        match self.form {
            CoefficientForm::Rigid => (d + e.complex_mul(rho(u)), hypot(1.0 + u.x, u.y)),
            CoefficientForm::Real | CoefficientForm::Complex => (d + e.complex_mul(u), 1.0),
        }
    }

    #[inline(always)]
    fn anchor(&self, x: &[f64; ANCHORED_VERTICES], y: &[f64; ANCHORED_VERTICES]) -> MomentOrigin {
        let (mut most, mut index) = ([-1.0; ANCHORED_VERTICES], [0; ANCHORED_VERTICES]);
        for (PointSource { p, mass, .. }, n) in self.points.iter().zip(0_u64..) {
            let mut w = squared_distances(*p, x, y);
            self.falloff.apply_to_squared(&mut w);
            for k in 0..ANCHORED_VERTICES {
                let w = w[k] * mass;
                index[k] = if w > most[k] { n } else { index[k] };
                most[k] = if w > most[k] { w } else { most[k] };
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "an index of the points")]
        let (points, d) = (
            index.map(|n| self.points[n as usize]),
            index.map(|n| self.d[n as usize]),
        );
        let r2 = std::array::from_fn(|k| squared_distances(points[k].p, &[x[k]], &[y[k]])[0]);
        MomentOrigin {
            r2,
            mass: points.map(|point| point.mass),
            p: points.map(|point| point.p),
            d,
        }
    }

    /// The sums of affine maps, from the anchors; the anchor has the weight 1.
    #[inline(always)]
    fn anchored_sums(
        &self,
        x: &[f64; ANCHORED_VERTICES],
        y: &[f64; ANCHORED_VERTICES],
        anchor: &MomentOrigin,
    ) -> [[f64; ANCHORED_VERTICES]; AFFINE_SUMS] {
        let (x0, y0, dx0, dy0) = (
            anchor.p.map(|p| p.x),
            anchor.p.map(|p| p.y),
            anchor.d.map(|d| d.x),
            anchor.d.map(|d| d.y),
        );
        let mut sums = [[0.0; ANCHORED_VERTICES]; AFFINE_SUMS];
        for (PointSource { p, mass, .. }, d) in self.points.iter().zip(self.d) {
            let mut w = squared_distances(*p, x, y);
            // The ratio before the power (mathematics 7.1, step 2). The anchor itself gets exactly
            // 1, and its position and displacement are 0: it adds nothing that could cancel.
            for (w, r2) in w.iter_mut().zip(&anchor.r2) {
                *w = r2 / *w;
            }
            self.falloff.of_lanes(&mut w);
            for k in 0..ANCHORED_VERTICES {
                let w = w[k] * (mass / anchor.mass[k]);
                let (px, py, dx, dy) = (p.x - x0[k], p.y - y0[k], d.x - dx0[k], d.y - dy0[k]);
                let (wx, wy) = (w * px, w * py);
                sums[0][k] += w;
                sums[1][k] += wx;
                sums[2][k] += wy;
                sums[3][k] += w * dx;
                sums[4][k] += w * dy;
                sums[5][k] += wx * px;
                sums[6][k] += wx * py;
                sums[7][k] += wy * py;
                sums[8][k] += wx * dx;
                sums[9][k] += wx * dy;
                sums[10][k] += wy * dx;
                sums[11][k] += wy * dy;
            }
        }
        sums
    }

    /// The displacement beyond that of the anchor of a vertex at `v` from it; and |m|.
    fn anchored(&self, v: Vec2, means: &Means) -> (Vec2, f64) {
        let (e, spread) = (v - means.p, means.xx + means.yy);
        if self.form == CoefficientForm::Real {
            let is_singular =
                means.determinant() <= SINGULAR_DETERMINANT_SHARE * means.xx * means.yy;
            return (
                if is_singular {
                    means.d
                } else {
                    means.affine(e)
                },
                1.0,
            );
        }
        if spread <= 0.0 {
            // Only the anchor has a weight that a number can hold.
            return (means.d, 1.0);
        }
        let u = Vec2::new(means.x_d.x + means.y_d.y, means.x_d.y - means.y_d.x) * (1.0 / spread);
        self.turned(e, means.d, u)
    }
}

/// The displacements at positions of one tile.
struct TileDisplacements<'a, const SUMS: usize> {
    inputs: &'a MomentInputs<'a>,
    tiles: &'a Tiles<Falloff, SUMS, TILE_NODES>,
    tile: &'a Tile<SUMS>,
    places: &'a [Point],
    out: &'a mut [[f32; 3]],
}

impl<const SUMS: usize> LaneWork for TileDisplacements<'_, SUMS>
where
    [[f64; TILE_LANES]; SUMS]: FittedSums<TILE_LANES>,
{
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { inputs, places, .. } = self;
        let mut again = Vec::new();
        for (first, out) in (0..)
            .step_by(TILE_LANES)
            .zip(self.out.chunks_mut(TILE_LANES))
        {
            let (mut x, mut y) = ([0.0; TILE_LANES], [0.0; TILE_LANES]);
            for k in 0..TILE_LANES {
                let Point { x: px, y: py } = places[(first + k).min(places.len() - 1)];
                (x[k], y[k]) = (px, py);
            }
            let sums = self.tiles.sums(self.tile, &x, &y);
            for k in 0..TILE_LANES {
                (x[k], y[k]) = (x[k] - inputs.origin.x, y[k] - inputs.origin.y);
            }
            let fitted = sums.fitted(&x, &y);
            let ([dx, dy], m) = fitted.motion.at(inputs.form, 1.0);
            for (k, out) in out.iter_mut().enumerate() {
                *out = single(inputs.shift + Vec2::new(dx[k], dy[k]), m[k]);
                if !fitted.is_precise[k] {
                    again.push(first + k);
                }
            }
        }
        for again in again.chunks(ANCHORED_VERTICES) {
            inputs.anchor_again(again, places, self.out);
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the precision of a table")]
const fn single(d: Vec2, m: f64) -> [f32; 3] {
    [d.x as f32, d.y as f32, m as f32]
}

fn sources<const SUMS: usize>(
    points: &[PointSource],
    d: &[Vec2],
    factors: impl Fn(Point, Vec2) -> [f64; SUMS],
) -> Vec<TileSource<SUMS>> {
    let each = points.iter().zip(d);
    each.map(|(PointSource { p, mass, .. }, d)| TileSource {
        p: *p,
        factors: factors(*p, *d).map(|factor| factor * mass),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::deform::{Handle, Handles, Method, Pose, RestDeformation};
    use crate::level::SimdLevel;

    const METHODS: [Method; 3] = [Method::Affine, Method::Similarity, Method::Rigid];

    /// Scattered points and their pose; of odd seeds they have weights.
    pub(in super::super) fn set(
        method: Method,
        alpha: f64,
        count: u32,
        seed: u32,
    ) -> (RestDeformation, Pose) {
        let noise = |k: u32, n: u32| {
            f64::from((k * 4 + n + 977 * seed).wrapping_mul(2_654_435_761) >> 8)
                / f64::from(1_u32 << 24)
        };
        let place = |k: u32| Point::new((500.0 * noise(k, 0)).round(), 400.0 * noise(k, 1));
        let moved =
            |k: u32| Handle::Point(place(k) + Vec2::new(30.0 * noise(k, 2), 30.0 * noise(k, 3)));
        let weights = (method != Method::Affine && seed % 2 == 1).then(|| {
            (0..count)
                .map(|k| 0.001 * 10f64.powf(f64::from(k % 7)))
                .collect()
        });
        let rest = Handles::new(
            (0..count).map(|k| Handle::Point(place(k))).collect(),
            weights,
        )
        .unwrap();
        let field =
            RestDeformation::new(rest, method, Falloff::new(alpha, false).unwrap(), 1.0).unwrap();
        let pose = field
            .pose(&(0..count).map(moved).collect::<Vec<_>>())
            .unwrap();
        (field, pose)
    }

    fn by_moments(
        field: &RestDeformation,
        pose: &Pose,
        places: &[Point],
        level: SimdLevel,
    ) -> Vec<[f32; 3]> {
        let points = &field.set.sources.points;
        let alpha = field.parameters().get("alpha").unwrap();
        let falloff = Falloff::new(alpha, false).unwrap();
        let (d, are_tiled) = (pose.displacements(), MomentInputs::are_tiled(falloff));
        let moments = MomentInputs::new(points, d, falloff, field.form(), are_tiled);
        moments.displaced_at(level, places, &|| false).unwrap()
    }

    proptest! {
        /// Anywhere, also a hair beside points and far away; of few points, whose tile is not
        /// divided, and of many.
        #[test]
        fn moments_give_what_rows_give(
            method in prop::sample::select(&METHODS[..]),
            alpha in prop::sample::select(&[0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5][..]),
            (count, seed) in (prop_oneof![3..40_u32, 100..400_u32], 0..1000_u32),
            angle in 0.0..std::f64::consts::TAU,
            (x, y) in (-200.0..700.0_f64, -200.0..600.0_f64),
        ) {
            let alpha = if method == Method::Affine { f64::min(alpha, 2.0) } else { alpha };
            let (field, pose) = set(method, alpha, count, seed);
            let Handle::Point(p) = field.handles().handles()[0] else { unreachable!() };
            let near = |r: f64| p + Vec2::new(angle.cos(), angle.sin()) * r;
            let mut places: Vec<Point> = (-9..3).map(|k| near(10f64.powi(k))).collect();
            places.extend([p, Point::new(x.round(), y), Point::new(x, y), near(1e6)]);
            // Displacements differ by up to 42 px. What is far is within 1e-5 of itself.
            let share = if count < 40 { 1e-6 } else { 1e-4 };
            for level in SimdLevel::available() {
                let moved = by_moments(&field, &pose, &places, *level);
                for ([dx, dy, _], place) in moved.into_iter().zip(&places) {
                    let want = field.map(&pose, *place) - *place;
                    // Far away, affine maps extrapolate.
                    let allowed = share * (1.0 + want.norm());
                    let off = (Vec2::new(dx.into(), dy.into()) - want).norm();
                    prop_assert!(off <= allowed, "{place:?}: {off} px of {want:?}");
                }
            }
        }
    }

    #[test]
    fn every_level_gives_the_same_bits_and_points_are_met_exactly() {
        for ((method, alpha), count) in METHODS
            .into_iter()
            .flat_map(|method| [0.5, 1.0, 1.3, 2.0, 8.0].map(|alpha| (method, alpha)))
            .flat_map(|each| [30, 300].map(|count| (each, count)))
        {
            let alpha = if method == Method::Affine {
                f64::min(alpha, 2.0)
            } else {
                alpha
            };
            let (field, pose) = set(method, alpha, count, 5);
            let points: Vec<Point> = field
                .handles()
                .handles()
                .iter()
                .map(|handle| handle.places()[0])
                .collect();
            let met = by_moments(&field, &pose, &points, SimdLevel::Scalar);
            for (moved, d) in met.iter().zip(pose.displacements()) {
                assert_eq!(moved[..2], single(*d, 1.0)[..2], "{method:?} {alpha}");
            }
            let beside: Vec<Point> = points.iter().map(|p| *p + Vec2::new(3.1, -0.7)).collect();
            let reference = by_moments(&field, &pose, &beside, SimdLevel::Scalar);
            for level in SimdLevel::available() {
                assert_eq!(
                    by_moments(&field, &pose, &beside, *level),
                    reference,
                    "{level:?} {method:?} {alpha}"
                );
            }
        }
    }

    /// The bits depend neither on the order of the positions nor on the number of threads.
    #[test]
    fn a_position_has_its_own_bits() {
        let (field, pose) = set(Method::Rigid, 1.0, 300, 5);
        let places: Vec<Point> = (0..400_u32)
            .map(|k| Point::new(f64::from(k % 20) * 30.0, f64::from(k / 20) * 25.0))
            .collect();
        let of = |places: &[Point]| by_moments(&field, &pose, places, SimdLevel::detect());
        let together = of(&places);
        let mut turned: Vec<Point> = places.iter().rev().copied().collect();
        turned.truncate(333);
        let backwards = of(&turned);
        assert!(together.iter().rev().zip(&backwards).all(|(a, b)| a == b));
        for (place, moved) in places.iter().zip(&together).step_by(37) {
            assert_eq!(of(&[*place])[0], *moved);
        }
        for threads in [1, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            assert_eq!(pool.unwrap().install(|| of(&places)), together);
        }
    }
}
