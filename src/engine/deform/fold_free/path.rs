//! The way of the handles from p to their targets: points, and the positions of polylines of more
//! than one segment, go straight, a segment goes by its centre, its direction and the logarithm of
//! its length, and handles that would come too near go round each other.

use super::super::{Handle, IsCancelled};
use crate::geometry::{Point, Vec2};

/// Positions of each handle.
pub(super) type HandlePlaces = Vec<Vec<Point>>;

/// Cosine of the largest turn of a segment in one leg.
const LEAST_COSINE: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Positions of a segment that are compared with those of others.
pub(super) const SAMPLES: u32 = 9;
/// Positions nearer to each other than this share of the extent are one.
pub(super) const SAME_SHARE: f64 = 1e-6;
/// Handles that come nearer than this share of the extent go round each other.
const NEAR_SHARE: f64 = 0.005;
/// How far they step aside: a share of their distance at rest, and of the extent at least.
const ASIDE_SHARE: f64 = 0.1;
const LEAST_DISTANCE_SHARE: f64 = 0.02;

pub(super) struct Path {
    rest: HandlePlaces,
    legs: Vec<HandlePlaces>,
}

impl Path {
    /// `None` when cancelled. O(handles^2).
    pub(super) fn new(
        rest: HandlePlaces,
        targets: HandlePlaces,
        cancelled: IsCancelled<'_>,
    ) -> Option<Self> {
        let extent = extent_of(&rest);
        let turns = rest.iter().zip(&targets).filter_map(|(p, t)| turn(p, t));
        let least = turns.map(|turn| turn.x).fold(1.0, f64::min);
        let halvings = if least >= LEAST_COSINE {
            0
        } else if least >= 0.0 {
            1
        } else {
            2
        };
        let asides = asides(&rest, &targets, extent, cancelled)?;
        let halvings = if asides.is_empty() {
            halvings
        } else {
            halvings.max(1)
        };
        let count = 1_u32 << halvings;
        let leg = |k: u32| {
            if k == count {
                return Some(targets.clone());
            }
            let pairs = rest.iter().zip(&targets);
            let mut leg = pairs.map(|(p, t)| on_way(p, t, k, halvings)).collect();
            join(&rest, &targets, &mut leg, SAME_SHARE * extent, cancelled)?;
            if 2 * k == count {
                for (handle, aside) in &asides {
                    leg[*handle].iter_mut().for_each(|v| *v = *v + *aside);
                }
            }
            Some(leg)
        };
        let legs = (1..=count).map(leg).collect::<Option<_>>()?;
        Some(Self { rest, legs })
    }

    pub(super) const fn rest(&self) -> &HandlePlaces {
        &self.rest
    }

    pub(super) fn legs(&self) -> &[HandlePlaces] {
        &self.legs
    }
}

pub(super) fn places_of(handles: &[Handle]) -> HandlePlaces {
    let places = |handle: &Handle| handle.places().to_vec();
    handles.iter().map(places).collect()
}

/// Handles of the same forms at these positions.
pub(super) fn handles_like(forms: &[Handle], places: &HandlePlaces) -> Vec<Handle> {
    let handle = |(form, places): (&Handle, &Vec<Point>)| match form {
        Handle::Point(_) => Handle::Point(places[0]),
        Handle::Polyline(_) => Handle::Polyline(places.clone()),
        Handle::Missing => Handle::Missing,
    };
    forms.iter().zip(places).map(handle).collect()
}

pub(super) fn between(a: &HandlePlaces, b: &HandlePlaces, share: f64) -> HandlePlaces {
    let handle = |(a, b): (&Vec<Point>, &Vec<Point>)| {
        a.iter().zip(b).map(|(a, b)| a.lerp(*b, share)).collect()
    };
    a.iter().zip(b).map(handle).collect()
}

/// The largest distance of a position from the first one.
pub(super) fn extent_of(places: &HandlePlaces) -> f64 {
    let all = || places.iter().flatten();
    let Some(first) = all().next() else {
        return 0.0;
    };
    all().map(|v| v.distance(*first)).fold(0.0, f64::max)
}

/// By how much a segment turns, as a unit complex number; `None` for other handles.
fn turn(p: &[Point], t: &[Point]) -> Option<Vec2> {
    let ([a, b], [c, d]) = (p, t) else {
        return None;
    };
    let (u, v) = (*b - *a, *d - *c);
    let turn = Vec2::new(u.dot(v), u.cross(v));
    let length = turn.norm();
    Some(if length > 0.0 {
        turn * (1.0 / length)
    } else {
        Vec2::new(1.0, 0.0)
    })
}

/// A handle after `k` of `2^halvings` equal parts of its way. Angles and lengths are halved, which
/// needs square roots only.
fn on_way(p: &[Point], t: &[Point], k: u32, halvings: u32) -> Vec<Point> {
    let share = f64::from(k) / f64::from(1_u32 << halvings);
    let (Some(mut part), [a, b], [c, d]) = (turn(p, t), p, t) else {
        return p.iter().zip(t).map(|(p, t)| p.lerp(*t, share)).collect();
    };
    let mut stretch = (*d - *c).norm() / (*b - *a).norm();
    for _ in 0..halvings {
        (part, stretch) = (part.half_angle(), stretch.sqrt());
    }
    let times = |a: Vec2, b: Vec2| Vec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
    let half = (0..k).fold((*b - *a) * 0.5, |half, _| times(half, part) * stretch);
    let centre = a.lerp(*b, 0.5).lerp(c.lerp(*d, 0.5), share);
    vec![centre + half * -1.0, centre + half]
}

/// Ends that are one at rest and posed stay one. `None` when cancelled.
fn join(
    p: &HandlePlaces,
    t: &HandlePlaces,
    leg: &mut HandlePlaces,
    same: f64,
    cancelled: IsCancelled<'_>,
) -> Option<()> {
    let of = |handle: usize| (0..p[handle].len()).map(move |k| (handle, k));
    let mut ends: Vec<(usize, usize)> = (0..p.len()).flat_map(of).collect();
    let place = |places: &HandlePlaces, (handle, k): (usize, usize)| places[handle][k];
    while let Some(end) = ends.pop() {
        if cancelled() {
            return None;
        }
        let is_one = |other: &(usize, usize)| {
            [p, t]
                .iter()
                .all(|places| place(places, end).distance(place(places, *other)) <= same)
        };
        let mut joined: Vec<(usize, usize)> = ends.iter().copied().filter(is_one).collect();
        if joined.is_empty() {
            continue;
        }
        ends.retain(|other| !joined.contains(other));
        joined.push(end);
        let origin = place(leg, end);
        let offsets = joined.iter().map(|other| place(leg, *other) - origin);
        let (sum, count) = offsets.fold((Vec2::ZERO, 0.0), |(sum, count), offset| {
            (sum + offset, count + 1.0)
        });
        for (handle, k) in joined {
            leg[handle][k] = origin + sum * (1.0 / count);
        }
    }
    Some(())
}

/// Positions of a handle, several of each segment.
pub(super) fn samples(places: &[Point]) -> Vec<Point> {
    if places.len() < 2 {
        return places.to_vec();
    }
    let share = |k: u32| f64::from(k) / f64::from(SAMPLES - 1);
    let segments = places.windows(2).map(|ab| [ab[0], ab[1]]);
    segments
        .flat_map(|[a, b]| (0..SAMPLES).map(move |k| a.lerp(b, share(k))))
        .collect()
}

/// How far handles step aside half-way, where two of them come too near. `None` when cancelled.
fn asides(
    p: &HandlePlaces,
    t: &HandlePlaces,
    extent: f64,
    cancelled: IsCancelled<'_>,
) -> Option<Vec<(usize, Vec2)>> {
    let all = |places: &HandlePlaces| places.iter().map(|of| samples(of)).collect::<Vec<_>>();
    let (p, t) = (all(p), all(t));
    let mut asides = Vec::new();
    for i in 0..p.len() {
        if cancelled() {
            return None;
        }
        for j in 0..i {
            if let Some(aside) = aside([&p[i], &t[i]], [&p[j], &t[j]], extent) {
                asides.extend([(i, aside), (j, aside * -1.0)]);
            }
        }
    }
    Some(asides)
}

fn aside(one: [&Vec<Point>; 2], other: [&Vec<Point>; 2], extent: f64) -> Option<Vec2> {
    let (mut nearest, mut touch) = (f64::INFINITY, [f64::INFINITY; 2]);
    let (mut way, mut apart) = (Vec2::ZERO, 0.0);
    for (a, to) in one[0].iter().zip(one[1]) {
        for (b, goal) in other[0].iter().zip(other[1]) {
            let (from, d) = (*a - *b, (*to - *goal) - (*a - *b));
            touch = [
                touch[0].min(from.norm()),
                touch[1].min((*to - *goal).norm()),
            ];
            let share = (-from.dot(d) / d.norm2()).clamp(0.0, 1.0);
            // Both go the same way.
            let share = if share.is_nan() { 0.0 } else { share };
            let distance = (from + d * share).norm();
            if distance < nearest {
                (nearest, way, apart) = (distance, d, from.norm());
            }
        }
    }
    let is_joined = touch
        .iter()
        .all(|distance| *distance <= SAME_SHARE * extent);
    let length = way.norm();
    let is_near = nearest < NEAR_SHARE * extent && !is_joined && length > 0.0;
    let size = ASIDE_SHARE * apart.max(LEAST_DISTANCE_SHARE * extent);
    is_near.then(|| Vec2::new(-way.y, way.x) * (size / length))
}
