//! The best map of a class for all handles together: least squares over the points and nine
//! positions of each segment, with the weights of the handles and without a fall-off (mathematics
//! 8.1). It brings q to the frame of p, and tells what a pose asks for as a whole (mathematics
//! 10.5).

use super::Handle;
use super::columns::ONE_PLACE_PX;
use super::handles::COINCIDENT_SHARE;
use crate::geometry::{Point, Vec2};

/// Positions of a segment, with equal distances from end to end.
const SEGMENT_SAMPLES: u32 = 9;
/// Below this share of what two sets of the same shape have, their correlation has no direction.
const LEAST_CORRELATION: f64 = 1e-9;

/// A class of maps; each contains the smaller ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// All positions move alike.
    Translation,
    /// Rotations.
    Rigid,
    /// Rotations with a uniform scale.
    Similarity,
    /// All affine maps, also reflections.
    Affine,
}

/// An affine map of the plane: `v -> to + (v - from) M`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneMap {
    from: Point,
    to: Point,
    /// Where M takes the directions x and y.
    axes: [Vec2; 2],
}

impl PlaneMap {
    /// Maps a position.
    #[must_use]
    pub fn map(&self, v: Point) -> Point {
        let (e, [x, y]) = (v - self.from, self.axes);
        self.to + x * e.x + y * e.y
    }

    /// Two rows of three numbers: `x' = a x + b y + c`.
    #[must_use]
    pub fn matrix(&self) -> [[f64; 3]; 2] {
        let ([x, y], origin) = (self.axes, self.map(Point::default()));
        [[x.x, y.x, origin.x], [x.y, y.y, origin.y]]
    }
}

/// The best map of a class from one set of handles to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    /// Its class: a smaller one than requested if the handles do not determine that.
    pub class: Class,
    /// The map.
    pub map: PlaneMap,
    /// The largest distance of a position of the second set from their mean.
    pub extent: f64,
}

/// The best map of a class from the handles `from` to the handles `to` of the same shapes;
/// `weights`: one for each, default 1. `None` without handles. O(positions), without memory.
///
/// ```
/// use mlswarp::deform::{Class, Handle, fitted};
/// use mlswarp::geometry::Point;
/// let points = |places: [(f64, f64); 3]| places.map(|(x, y)| Handle::Point(Point::new(x, y)));
/// let from = points([(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)]);
/// let to = points([(5.0, 0.0), (25.0, 0.0), (5.0, 20.0)]);
/// let best = fitted(Class::Similarity, &from, &to, None).unwrap();
/// let mapped = best.map.map(Point::new(10.0, 10.0));
/// assert!(mapped.distance(Point::new(25.0, 20.0)) < 1e-9);
/// ```
#[must_use]
pub fn fitted(
    class: Class,
    from: &[Handle],
    to: &[Handle],
    weights: Option<&[f64]>,
) -> Option<Fitted> {
    let sums = PairSums::of(&|pair| {
        for (k, (from, to)) in from.iter().zip(to).enumerate() {
            pairs_of(
                from,
                to,
                weights
                    .and_then(|weights| weights.get(k).copied())
                    .unwrap_or(1.0),
                pair,
            );
        }
    })?;
    let (class, map) = sums.best(class);
    Some(Fitted {
        class,
        map,
        extent: sums.to_extent,
    })
}

/// Calls a function with positions that belong together, `from` and `to`, and their weight.
pub(super) type ForEachPair<'a> = &'a dyn Fn(&mut dyn FnMut(Point, Point, f64));

/// The pairs of one handle of weight `weight`; none if the two have different shapes.
fn pairs_of(from: &Handle, to: &Handle, weight: f64, pair: &mut dyn FnMut(Point, Point, f64)) {
    match (from, to) {
        (Handle::Point(from), Handle::Point(to)) => pair(*from, *to, weight),
        (Handle::Polyline(from), Handle::Polyline(to)) if from.len() == to.len() => {
            for (ab, cd) in from.windows(2).zip(to.windows(2)) {
                segment_pairs([ab[0], ab[1]], [cd[0], cd[1]], weight, pair);
            }
        }
        _ => {}
    }
}

/// The pairs of one segment.
pub(super) fn segment_pairs(
    [a, b]: [Point; 2],
    [c, d]: [Point; 2],
    weight: f64,
    pair: &mut dyn FnMut(Point, Point, f64),
) {
    for k in 0..SEGMENT_SAMPLES {
        let t = f64::from(k) / f64::from(SEGMENT_SAMPLES - 1);
        pair(a.lerp(b, t), c.lerp(d, t), weight);
    }
}

/// Sums over pairs, about their means.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairSums {
    from: Point,
    to: Point,
    /// Of the squared distances from the mean.
    pub(super) from_spread: f64,
    pub(super) to_spread: f64,
    /// `sum w conj(from) to` and `sum w from to` as complex numbers: with a rotation, and with a
    /// reflection.
    turned: Vec2,
    mirrored: Vec2,
    affine: Option<Affine>,
    /// The largest distances from the mean.
    from_extent: f64,
    to_extent: f64,
}

/// Coefficients of the affine fit, which is solved along the longest axis of the set first.
#[derive(Clone, Copy, Debug)]
struct Affine {
    axes: [Vec2; 2],
    /// What is left of `to_spread`.
    residual: f64,
}

impl PairSums {
    /// `None` without pairs. O(pairs), in four passes, without memory.
    pub(super) fn of(pairs: ForEachPair<'_>) -> Option<Self> {
        let (mut first, mut total, mut from, mut to) = (None, 0.0, Vec2::ZERO, Vec2::ZERO);
        pairs(&mut |a, b, w| {
            let (a0, b0) = *first.get_or_insert((a, b));
            (total, from, to) = (total + w, from + (a - a0) * w, to + (b - b0) * w);
        });
        let (a0, b0) = first?;
        let (from, to) = (a0 + from * (1.0 / total), b0 + to * (1.0 / total));
        let mut sums = Self {
            from,
            to,
            from_spread: 0.0,
            to_spread: 0.0,
            turned: Vec2::ZERO,
            mirrored: Vec2::ZERO,
            affine: None,
            from_extent: 0.0,
            to_extent: 0.0,
        };
        let (mut from_axis, mut to_axis) = (Vec2::ZERO, Vec2::ZERO);
        pairs(&mut |a, b, w| {
            let (a, b) = (a - from, b - to);
            sums.from_spread += w * a.norm2();
            sums.to_spread += w * b.norm2();
            sums.turned += Vec2::new(a.dot(b), a.cross(b)) * w;
            sums.mirrored += Vec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x) * w;
            // (a.x + i a.y)^2 has twice the angle of the longest axis.
            from_axis += Vec2::new(a.x * a.x - a.y * a.y, 2.0 * a.x * a.y) * w;
            to_axis += Vec2::new(b.x * b.x - b.y * b.y, 2.0 * b.x * b.y) * w;
            sums.from_extent = sums.from_extent.max(a.norm());
            sums.to_extent = sums.to_extent.max(b.norm());
        });
        sums.affine = sums.affine_of(pairs, [from_axis, to_axis]);
        Some(sums)
    }

    /// The affine fit; `None` if either side lies on one line.
    fn affine_of(&self, pairs: ForEachPair<'_>, axes: [Vec2; 2]) -> Option<Affine> {
        let [tau, to_tau] = axes.map(Vec2::half_angle);
        let (mut along, mut slope, mut off, mut to_off) = (0.0, 0.0, 0.0_f64, 0.0_f64);
        pairs(&mut |a, b, w| {
            let (x, y) = ((a - self.from).dot(tau), tau.cross(a - self.from));
            (along, slope) = (along + w * x * x, slope + w * x * y);
            (off, to_off) = (
                off.max(y.abs()),
                to_off.max(to_tau.cross(b - self.to).abs()),
            );
        });
        if off <= COINCIDENT_SHARE * self.from_extent || to_off <= COINCIDENT_SHARE * self.to_extent
        {
            return None;
        }
        // As in a row: along the longest axis first, then across what is left (mathematics 8.1), so
        // that positions nearly on one line still determine a map.
        slope /= along;
        let (mut across, mut with_along, mut with_across) = (0.0, Vec2::ZERO, Vec2::ZERO);
        pairs(&mut |a, b, w| {
            let (x, y) = ((a - self.from).dot(tau), tau.cross(a - self.from));
            let (y, b) = (y - slope * x, b - self.to);
            (across, with_along, with_across) = (
                across + w * y * y,
                with_along + b * (w * x),
                with_across + b * (w * y),
            );
        });
        let (p, q) = (with_along * (1.0 / along), with_across * (1.0 / across));
        let axes = [
            p * tau.x - q * (tau.y + slope * tau.x),
            p * tau.y + q * (tau.x - slope * tau.y),
        ];
        let residual = self.to_spread - p.dot(with_along) - q.dot(with_across);
        let is_finite = axes
            .iter()
            .all(|axis| axis.x.is_finite() && axis.y.is_finite());
        is_finite.then_some(Affine {
            axes,
            residual: residual.max(0.0),
        })
    }

    /// The best map of a class, or of the next smaller one that the positions determine.
    pub(super) fn best(&self, class: Class) -> (Class, PlaneMap) {
        let [x, y] = [Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0)];
        let complex = |m: Vec2| [m, Vec2::new(-m.y, m.x)];
        let (class, axes) = match (class, self.affine, self.rotation()) {
            (Class::Affine, Some(Affine { axes, .. }), _) => (Class::Affine, axes),
            (Class::Affine | Class::Similarity, _, Some(_)) => (
                Class::Similarity,
                complex(self.turned * (1.0 / self.from_spread)),
            ),
            (Class::Rigid, _, Some(rotation)) => (Class::Rigid, complex(rotation)),
            _ => (Class::Translation, [x, y]),
        };
        (
            class,
            PlaneMap {
                from: self.from,
                to: self.to,
                axes,
            },
        )
    }

    /// The rotation of the best similarity; `None` if either side is one position, or none is
    /// better than another.
    fn rotation(&self) -> Option<Vec2> {
        let (length, most) = (
            self.turned.norm(),
            (self.from_spread * self.to_spread).sqrt(),
        );
        let has_extent = self.from_extent > ONE_PLACE_PX && self.to_extent > ONE_PLACE_PX;
        (has_extent && length > LEAST_CORRELATION * most).then(|| self.turned * (1.0 / length))
    }

    /// Residual sums of squares: of the best rigid map, of the best similarity, of the best one
    /// with a reflection, and of the best affine map if there is one.
    pub(super) fn residuals(&self) -> Residuals {
        let after =
            |correlation: Vec2| (self.to_spread - correlation.norm2() / self.from_spread).max(0.0);
        Residuals {
            rigid: (self.from_spread + self.to_spread - 2.0 * self.turned.norm()).max(0.0),
            similarity: after(self.turned),
            mirrored: after(self.mirrored),
            affine: self.affine.map(|affine| affine.residual),
        }
    }

    /// Where the best affine map takes the directions x and y.
    pub(super) fn affine_axes(&self) -> Option<[Vec2; 2]> {
        self.affine.map(|affine| affine.axes)
    }
}

/// See [`PairSums::residuals`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Residuals {
    pub(super) rigid: f64,
    pub(super) similarity: f64,
    pub(super) mirrored: f64,
    pub(super) affine: Option<f64>,
}
