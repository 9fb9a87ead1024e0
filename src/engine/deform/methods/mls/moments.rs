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
use crate::deform::columns::PointSource;
use crate::deform::form::CoefficientForm;
use crate::deform::form::rho;
use crate::deform::lanes::Vertices;
use crate::geometry::lane_math::hypot;
use crate::geometry::{Point, Vec2};

/// Vertices that are anchored at once.
const ANCHORED_VERTICES: usize = 8;
/// Points whose weights are computed at once: a loop long enough that powers are vectorised.
const AT_ONCE: usize = 32;
/// Sums over the points: of w, w p, w d, and the second moments that similarities and affine maps
/// need.
const SIMILARITY_SUMS: usize = 8;
const AFFINE_SUMS: usize = 12;
/// Affine: the least determinant of the second moments, as a share of the product of both.
const SINGULAR_DETERMINANT_SHARE: f64 = 1e-14;
/// Squared distances are at least this, px^2: the heaviest point at no distance has the ratio 1 and
/// not 0/0.
const MIN_SQUARED_DISTANCE: f64 = f64::MIN_POSITIVE;
/// The largest ratio of the moment about the origin to that about p*, and the largest product of it
/// and |v - p*|, px, at which the sums about the origin are used: they are precise to about 1e-15.
const MOST_CANCELLED: f64 = 1e12;
const MOST_CANCELLED_PX: f64 = 3e7;

/// The input that does not depend on the vertices.
#[derive(Clone, Debug)]
pub(in crate::deform) struct MomentInputs<'a> {
    points: &'a [PointSource],
    /// Displacements of the points, px.
    d: &'a [Vec2],
    falloff: Falloff,
    form: CoefficientForm,
    /// The origins of positions and displacements.
    origin: Point,
    shift: Vec2,
    terms: Terms,
}

/// Per point its position, and the factors of its weight in the sums, times its mass.
#[derive(Clone, Debug)]
enum Terms {
    /// 1, p, d, |p|^2, conj(p) d.
    Similar(Vec<Term<SIMILARITY_SUMS>>),
    /// 1, p, d, x x, x y, y y, x d, y d.
    Affine(Vec<Term<AFFINE_SUMS>>),
}

#[derive(Clone, Debug)]
struct Term<const SUMS: usize> {
    p: Point,
    factors: [f64; SUMS],
}

/// What the heaviest point of each vertex is the origin of.
struct MomentOrigin {
    r2: [f64; ANCHORED_VERTICES],
    mass: [f64; ANCHORED_VERTICES],
    p: [Point; ANCHORED_VERTICES],
    d: [Vec2; ANCHORED_VERTICES],
}

/// The means of one vertex, by weight, from some origin.
struct Means {
    p: Vec2,
    d: Vec2,
    /// Second moments about p: of x x, x y, y y, x d, y d.
    xx: f64,
    xy: f64,
    yy: f64,
    x_d: Vec2,
    y_d: Vec2,
}

impl<'a> MomentInputs<'a> {
    /// `d`: the displacements of the points, px.
    pub(in crate::deform) fn new(
        points: &'a [PointSource],
        d: &'a [Vec2],
        falloff: Falloff,
        form: CoefficientForm,
    ) -> Self {
        let sum = points
            .iter()
            .fold(Vec2::ZERO, |sum, source| sum + (source.p - points[0].p));
        let (origin, shift) = (points[0].p + sum * (1.0 / points.len() as f64), d[0]);
        let terms = if form == CoefficientForm::Real {
            let factors = |p: Vec2, d: Vec2| {
                [
                    1.0,
                    p.x,
                    p.y,
                    d.x,
                    d.y,
                    p.x * p.x,
                    p.x * p.y,
                    p.y * p.y,
                    p.x * d.x,
                    p.x * d.y,
                    p.y * d.x,
                    p.y * d.y,
                ]
            };
            Terms::Affine(terms(points, d, |p, d| factors(p - origin, d - shift)))
        } else {
            let factors =
                |p: Vec2, d: Vec2| [1.0, p.x, p.y, d.x, d.y, p.norm2(), p.dot(d), p.cross(d)];
            Terms::Similar(terms(points, d, |p, d| factors(p - origin, d - shift)))
        };
        Self {
            points,
            d,
            falloff,
            form,
            origin,
            shift,
            terms,
        }
    }

    /// `f(v) - v`, px, and |m| (rigid), else 1. The body of every instruction set's function in
    /// `kernel`; `LANES`: vertices whose sums fit into its registers.
    #[inline(always)]
    pub(in crate::deform) fn displacements<const LANES: usize, const N: usize>(
        &self,
        v: &Vertices<N>,
    ) -> ([[f64; N]; 2], [f64; N]) {
        let (mut moved, mut rotation) = ([[0.0; N]; 2], [1.0; N]);
        let (mut again, mut count) = ([0; N], 0);
        for first in (0..N).step_by(LANES) {
            let at = |of: &[f64; N]| std::array::from_fn(|k| of[(first + k).min(N - 1)]);
            let (x, y): ([f64; LANES], [f64; LANES]) = (at(&v.x), at(&v.y));
            let fitted: [Option<(Vec2, f64)>; LANES] = match &self.terms {
                Terms::Similar(terms) => {
                    let sums = self.sums(terms, &x, &y);
                    std::array::from_fn(|k| {
                        self.similar(Point::new(x[k], y[k]) - self.origin, &sums, k)
                    })
                }
                Terms::Affine(terms) => {
                    let sums = self.sums(terms, &x, &y);
                    std::array::from_fn(|k| affine(Point::new(x[k], y[k]) - self.origin, &sums, k))
                }
            };
            for (k, fitted) in (first..N).zip(fitted) {
                if let Some((d, m)) = fitted {
                    (moved[0][k], moved[1][k], rotation[k]) =
                        (self.shift.x + d.x, self.shift.y + d.y, m);
                } else {
                    again[count] = k;
                    count += 1;
                }
            }
        }
        for again in again[..count].chunks(ANCHORED_VERTICES) {
            let at = |of: &[f64; N]| std::array::from_fn(|k| of[again[k.min(again.len() - 1)]]);
            let (x, y) = (at(&v.x), at(&v.y));
            let anchor = self.anchor(&x, &y);
            let sums = self.anchored_sums(&x, &y, &anchor);
            for (k, &lane) in again.iter().enumerate() {
                let (d, m) =
                    self.anchored(Point::new(x[k], y[k]) - anchor.p[k], &Means::of(&sums, k));
                (moved[0][lane], moved[1][lane], rotation[lane]) =
                    (anchor.d[k].x + d.x, anchor.d[k].y + d.y, m);
            }
        }
        (moved, rotation)
    }

    /// The sums of w times each factor, about the origin.
    #[inline(always)]
    fn sums<const LANES: usize, const SUMS: usize>(
        &self,
        terms: &[Term<SUMS>],
        x: &[f64; LANES],
        y: &[f64; LANES],
    ) -> [[f64; LANES]; SUMS] {
        let (mut sums, mut weights) = ([[0.0; LANES]; SUMS], [[1.0; LANES]; AT_ONCE]);
        for terms in terms.chunks(AT_ONCE) {
            for (w, term) in weights.iter_mut().zip(terms) {
                *w = squared_distances(term.p, x, y);
            }
            self.falloff.apply_to_squared(weights.as_flattened_mut());
            for (w, term) in weights.iter().zip(terms) {
                for (sum, factor) in sums.iter_mut().zip(&term.factors) {
                    for k in 0..LANES {
                        sum[k] += w[k] * factor;
                    }
                }
            }
        }
        sums
    }

    /// The displacement of vertex k, at `v` from the origin, and |m|; `None` where the sums cancel.
    #[inline(always)]
    fn similar<const LANES: usize>(
        &self,
        v: Vec2,
        sums: &[[f64; LANES]; SIMILARITY_SUMS],
        k: usize,
    ) -> Option<(Vec2, f64)> {
        let per_weight = 1.0 / sums[0][k];
        let mean = |n: usize| sums[n][k] * per_weight;
        let (p, d) = (Vec2::new(mean(1), mean(2)), Vec2::new(mean(3), mean(4)));
        let (e, spread) = (v - p, mean(5) - p.norm2());
        let u = Vec2::new(mean(6) - p.dot(d), mean(7) - p.cross(d)) * (1.0 / spread);
        is_precise(e, mean(5), spread).then(|| self.turned(e, d, u))
    }

    /// The family's map of similarity `1 + u` at e, beyond e.
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

impl Means {
    #[inline(always)]
    fn of<const LANES: usize>(sums: &[[f64; LANES]; AFFINE_SUMS], k: usize) -> Self {
        let per_weight = 1.0 / sums[0][k];
        let mean = |n: usize| sums[n][k] * per_weight;
        let (p, d) = (Vec2::new(mean(1), mean(2)), Vec2::new(mean(3), mean(4)));
        let (xx, xy, yy) = (
            mean(5) - p.x * p.x,
            mean(6) - p.x * p.y,
            mean(7) - p.y * p.y,
        );
        Self {
            p,
            d,
            xx,
            xy,
            yy,
            x_d: Vec2::new(mean(8), mean(9)) - d * p.x,
            y_d: Vec2::new(mean(10), mean(11)) - d * p.y,
        }
    }

    fn determinant(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// The affine map at e, beyond e.
    fn affine(&self, e: Vec2) -> Vec2 {
        let determinant = self.determinant();
        let (across, down) = (
            (e.x * self.yy - e.y * self.xy) / determinant,
            (e.y * self.xx - e.x * self.xy) / determinant,
        );
        self.d + self.x_d * across + self.y_d * down
    }
}

/// Like [`MomentInputs::similar`] for affine maps.
#[inline(always)]
fn affine<const LANES: usize>(
    v: Vec2,
    sums: &[[f64; LANES]; AFFINE_SUMS],
    k: usize,
) -> Option<(Vec2, f64)> {
    let means = Means::of(sums, k);
    let (e, about_origin) = (v - means.p, (sums[5][k] + sums[7][k]) / sums[0][k]);
    let least = means.determinant() / (means.xx + means.yy);
    is_precise(e, about_origin, least).then(|| (means.affine(e), 1.0))
}

/// Whether a second moment about p* is the precise difference of one about the origin; false for
/// NaN.
#[inline(always)]
fn is_precise(e: Vec2, about_origin: f64, spread: f64) -> bool {
    spread * MOST_CANCELLED > about_origin && spread * MOST_CANCELLED_PX > about_origin * e.norm()
}

fn terms<const SUMS: usize>(
    points: &[PointSource],
    d: &[Vec2],
    factors: impl Fn(Point, Vec2) -> [f64; SUMS],
) -> Vec<Term<SUMS>> {
    let each = points.iter().zip(d);
    each.map(|(PointSource { p, mass, .. }, d)| Term {
        p: *p,
        factors: factors(*p, *d).map(|factor| factor * mass),
    })
    .collect()
}

#[inline(always)]
fn squared_distances<const LANES: usize>(
    p: Point,
    x: &[f64; LANES],
    y: &[f64; LANES],
) -> [f64; LANES] {
    let mut r2 = [0.0; LANES];
    for k in 0..LANES {
        let (to_x, to_y) = (p.x - x[k], p.y - y[k]);
        r2[k] = (to_x * to_x + to_y * to_y).max(MIN_SQUARED_DISTANCE);
    }
    r2
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::deform::kernel::moments_at;
    use crate::deform::{Handle, Handles, Method, Pose, RestDeformation};
    use crate::level::SimdLevel;

    const METHODS: [Method; 3] = [Method::Affine, Method::Similarity, Method::Rigid];

    fn set(method: Method, alpha: f64, count: u32, seed: u32) -> (RestDeformation, Pose) {
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
        places: &[Point; 16],
        level: SimdLevel,
    ) -> ([[f64; 16]; 2], [f64; 16]) {
        let mut v = Vertices::all(places[0]);
        for (k, place) in places.iter().enumerate() {
            (v.x[k], v.y[k]) = (place.x, place.y);
        }
        let points = &field.set.sources.points;
        let alpha = field.parameters().get("alpha").unwrap();
        let falloff = Falloff::new(alpha, false).unwrap();
        let moments = MomentInputs::new(points, pose.displacements(), falloff, field.form());
        moments_at(level, &moments, &v)
    }

    proptest! {
        /// Anywhere, also a hair beside points and far away.
        #[test]
        fn moments_give_what_rows_give(
            method in prop::sample::select(&METHODS[..]),
            alpha in prop::sample::select(&[0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5][..]),
            (count, seed) in (3..40_u32, 0..1000_u32),
            angle in 0.0..std::f64::consts::TAU,
            (x, y) in (-200.0..700.0_f64, -200.0..600.0_f64),
        ) {
            let alpha = if method == Method::Affine { f64::min(alpha, 2.0) } else { alpha };
            let (field, pose) = set(method, alpha, count, seed);
            let Handle::Point(p) = field.handles().handles()[0] else { unreachable!() };
            let near = |r: f64| p + Vec2::new(angle.cos(), angle.sin()) * r;
            let mut places = [Point::new(x, y); 16];
            for (place, exponent) in places[..12].iter_mut().zip(-9..) {
                *place = near(10f64.powi(exponent));
            }
            (places[12], places[13]) = (p, Point::new(x.round(), y));
            for level in SimdLevel::available() {
                let ([dx, dy], _) = by_moments(&field, &pose, &places, *level);
                for (k, place) in places.iter().enumerate() {
                    let want = field.map(&pose, *place) - *place;
                    // Far away, affine maps extrapolate.
                    let allowed = 1e-7 * (1.0 + want.norm());
                    let off = (Vec2::new(dx[k], dy[k]) - want).norm();
                    prop_assert!(off <= allowed, "{place:?}: {off} px of {want:?}");
                }
            }
        }
    }

    #[test]
    fn every_level_gives_the_same_bits_and_points_are_met_exactly() {
        for (method, alpha) in METHODS
            .into_iter()
            .flat_map(|method| [0.5, 1.0, 1.3, 2.0, 8.0].map(|alpha| (method, alpha)))
        {
            let alpha = if method == Method::Affine {
                f64::min(alpha, 2.0)
            } else {
                alpha
            };
            let (field, pose) = set(method, alpha, 30, 5);
            let places: [Point; 16] =
                std::array::from_fn(|k| field.handles().handles()[k].places()[0]);
            let reference = by_moments(&field, &pose, &places, SimdLevel::Scalar);
            for (k, d) in pose.displacements()[..16].iter().enumerate() {
                assert_eq!(
                    (reference.0[0][k], reference.0[1][k]),
                    (d.x, d.y),
                    "{method:?} {alpha}"
                );
            }
            let beside = places.map(|p| p + Vec2::new(3.1, -0.7));
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
}
