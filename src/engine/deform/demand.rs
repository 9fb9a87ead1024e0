//! What a pose asks of the map as a whole: to mirror the picture, or another size (mathematics
//! 10.5). Landmarks of a section that lies face down ask for it; handles that are dragged far, or
//! past one another, do not: there is no map of that kind that explains them all.

use std::ops::RangeInclusive;

use super::overall::{PairSums, Residuals, segment_pairs};
use super::{Handle, Pose, RestDeformation};
use crate::geometry::{Point, Vec2};

/// Scales that a map without scale can follow, if not well.
const FOLLOWED_SCALES: RangeInclusive<f64> = 0.5 - 1e-9..=2.0 + 1e-9;
/// A map explains a pose if it leaves at most this share of what is left without it.
const EXPLAINED_SHARE: f64 = 0.25;
/// Fewer controls than this fit many maps by chance: then what is left must be this small a share
/// of the spread, or, with more controls than an affine map needs, of what is left without it.
const FEW_CONTROLS: usize = 8;
const LEFT_OF_FEW: f64 = 0.05;
const EXACT_SHARE: f64 = 0.01;
const LEAST_FOR_EXACT: usize = 4;
/// A pose is not mirrored if a rotation with a scale leaves less than this share of its spread:
/// handles nearly on a line look the same in a mirror.
const LEAST_LEFT: f64 = 0.04;
/// A map with less area than this, relative to the squares of its two scales, is flattened, not
/// mirrored.
const LEAST_AREA: f64 = 0.1;

/// What a pose asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand {
    /// A map that mirrors: the determinant of the best affine map.
    Mirrored {
        /// Negative.
        determinant: f64,
    },
    /// Another size: the scale of the best affine map, the root of its determinant.
    Scaled {
        /// Below 1/2 or above 2.
        scale: f64,
    },
}

impl RestDeformation {
    /// What a pose asks for beyond rotations of about the same size; nothing of handles at one
    /// position or on one line. O(columns).
    #[must_use]
    pub fn demand(&self, pose: &Pose) -> Option<Demand> {
        if pose.is_identity() {
            return None;
        }
        let sums = PairSums::of(&|pair| self.pairs(pose, pair))?;
        demand(&sums, self.handles.columns())
    }

    /// The positions of handles at rest and posed.
    fn pairs(&self, pose: &Pose, pair: &mut dyn FnMut(Point, Point, f64)) {
        let mut d = pose.displacements().iter();
        let mut next = || d.next().copied().unwrap_or(Vec2::ZERO);
        for (handle, &weight) in self.handles.handles().iter().zip(self.handles.weights()) {
            match handle {
                Handle::Point(p) => pair(*p, *p + next(), weight),
                Handle::Polyline(places) => {
                    for ab in places.windows(2) {
                        let posed = [ab[0] + next(), ab[1] + next()];
                        segment_pairs([ab[0], ab[1]], posed, weight, pair);
                    }
                }
                Handle::Missing => {}
            }
        }
    }
}

fn demand(sums: &PairSums, controls: usize) -> Option<Demand> {
    let Residuals {
        rigid,
        similarity,
        mirrored,
        affine,
    } = sums.residuals();
    let (affine, [x, y]) = (affine?, sums.affine_axes()?);
    let (determinant, is_few) = (x.cross(y), controls < FEW_CONTROLS);
    if determinant < 0.0 {
        let is_flat = -2.0 * determinant < LEAST_AREA * (x.norm2() + y.norm2());
        let is_thin = similarity < LEAST_LEFT * sums.to_spread;
        let is_exact = controls >= LEAST_FOR_EXACT && affine <= EXACT_SHARE * similarity;
        let is_alike = mirrored <= LEFT_OF_FEW * sums.to_spread;
        let is_explained = if is_few {
            is_exact || is_alike
        } else {
            affine <= EXPLAINED_SHARE * similarity
        };
        return (!is_flat && !is_thin && is_explained).then_some(Demand::Mirrored { determinant });
    }
    let scale = determinant.sqrt();
    let is_alike = !is_few || similarity <= LEFT_OF_FEW * sums.to_spread;
    let is_scaled =
        !FOLLOWED_SCALES.contains(&scale) && similarity <= EXPLAINED_SHARE * rigid && is_alike;
    is_scaled.then_some(Demand::Scaled { scale })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deform::{Falloff, Handles, Method};

    fn numbers(seed: u32) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1_u32 << 24)
        }
    }

    fn demand_of(p: &[Handle], q: &[Handle]) -> Option<Demand> {
        let handles = Handles::new(p.to_vec(), None).unwrap();
        let falloff = Falloff::new(1.0, handles.has_lines()).unwrap();
        let field = RestDeformation::new(handles, Method::Rigid, falloff, 1.0).unwrap();
        field.demand(&field.pose(q).unwrap())
    }

    fn of_points(p: &[Point], q: &[Point]) -> Option<Demand> {
        let points =
            |places: &[Point]| places.iter().map(|p| Handle::Point(*p)).collect::<Vec<_>>();
        demand_of(&points(p), &points(q))
    }

    /// `count` points in a picture of 300 x 200, mapped by `map` with an error of at most `noise`
    /// px.
    fn mapped(
        seed: u32,
        count: usize,
        noise: f64,
        map: impl Fn(Point) -> Point,
    ) -> [Vec<Point>; 2] {
        let mut number = numbers(seed);
        let p: Vec<Point> = (0..count)
            .map(|_| Point::new(300.0 * number(), 200.0 * number()))
            .collect();
        let q = p
            .iter()
            .map(|p| map(*p) + Vec2::new(number() - 0.5, number() - 0.5) * (2.0 * noise))
            .collect();
        [p, q]
    }

    fn turned(angle: f64, scale: f64, flip: bool) -> impl Fn(Point) -> Point {
        let (sin, cos) = angle.sin_cos();
        move |p: Point| {
            let (x, y) = (if flip { -p.x } else { p.x }, p.y);
            Point::new(
                40.0 + scale * (cos * x - sin * y),
                scale * (sin * x + cos * y) - 20.0,
            )
        }
    }

    /// Of 100 sets, how many ask for a mirror and for a scale.
    fn asked(count: usize, noise: f64, map: impl Fn(Point) -> Point) -> (u32, u32) {
        let (mut mirrored, mut scaled) = (0, 0);
        for seed in 0..100 {
            let [p, q] = mapped(seed, count, noise, &map);
            match of_points(&p, &q) {
                Some(Demand::Mirrored { determinant }) => mirrored += u32::from(determinant < 0.0),
                Some(Demand::Scaled { scale }) => {
                    scaled += u32::from(!FOLLOWED_SCALES.contains(&scale))
                }
                None => {}
            }
        }
        (mirrored, scaled)
    }

    #[test]
    fn mirrors_are_found_through_noise_turns_and_scales() {
        for (count, least) in [(4, 90), (6, 95), (8, 98), (12, 100), (40, 100)] {
            for (angle, scale) in [
                (0.0, 1.0),
                (std::f64::consts::FRAC_PI_2, 1.0),
                (2.0, 0.1),
                (-1.0, 10.0),
            ] {
                for noise in [0.0, 2.0, 5.0] {
                    let (mirrored, scaled) =
                        asked(count, noise * scale, turned(angle, scale, true));
                    assert!(
                        mirrored >= least && scaled == 0,
                        "{count} points, {noise} px: {mirrored}"
                    );
                    let (mirrored, _) = asked(count, noise * scale, turned(angle, scale, false));
                    assert_eq!(mirrored, 0, "{count} points, {noise} px");
                }
            }
        }
    }

    #[test]
    fn scales_are_found_from_a_half_and_from_twice() {
        for count in [4, 8, 20] {
            for (scale, is_other) in [
                (0.1, true),
                (0.4, true),
                (0.55, false),
                (1.0, false),
                (1.8, false),
                (2.5, true),
                (10.0, true),
            ] {
                let (mirrored, scaled) = asked(count, 3.0 * scale, turned(1.0, scale, false));
                assert!(
                    mirrored == 0 && if is_other { scaled >= 92 } else { scaled <= 2 },
                    "{count} at {scale}: {scaled}"
                );
            }
        }
        let [p, q] = mapped(1, 9, 0.0, turned(0.3, 4.0, false));
        assert!(matches!(of_points(&p, &q),
                Some(Demand::Scaled { scale }) if (scale - 4.0).abs() < 1e-9));
        let [p, q] = mapped(1, 9, 0.0, turned(0.3, 2.0, false));
        assert_eq!(of_points(&p, &q), None, "twice is within the range");
    }

    /// Edits by hand: some handles go anywhere, the others stay. With three handles any pose is
    /// affine.
    #[test]
    fn handles_that_are_dragged_far_ask_for_nothing() {
        for (moved, count, most) in [
            (1, 4, 8),
            (1, 6, 3),
            (1, 8, 1),
            (2, 5, 6),
            (2, 8, 1),
            (3, 12, 1),
            (6, 12, 1),
        ] {
            let mut asked = 0;
            for seed in 0..200 {
                let mut number = numbers(977 * seed + 3);
                let [p, mut q] = mapped(seed, count, 0.0, |p| p);
                for q in q.iter_mut().take(moved) {
                    *q = Point::new(500.0 * number() - 100.0, 400.0 * number() - 100.0);
                }
                asked += u32::from(of_points(&p, &q).is_some());
            }
            assert!(asked <= most, "{moved} of {count} handles: {asked} of 200");
        }
    }

    #[test]
    fn degenerate_sets_ask_for_nothing() {
        let line = |count: u32, dx: f64, dy: f64| {
            (0..count)
                .map(|k| Point::new(dx * f64::from(k), dy * f64::from(k)))
                .collect::<Vec<_>>()
        };
        let [scattered, _] = mapped(3, 6, 0.0, |p| p);
        for (p, q) in [
            (line(2, 50.0, 0.0), line(2, -500.0, 0.0)),
            (line(6, 30.0, 10.0), line(6, -300.0, 10.0)),
            (line(6, 30.0, 10.0), scattered.clone()),
            (scattered.clone(), line(6, 300.0, 100.0)),
            (scattered.clone(), vec![Point::new(5.0, 5.0); 6]),
            (vec![Point::new(5.0, 5.0); 6], scattered.clone()),
            (vec![Point::new(5.0, 5.0)], vec![Point::new(5.0, 50.0)]),
            (vec![], vec![]),
        ] {
            assert_eq!(of_points(&p, &q), None, "{p:?} to {q:?}");
        }
        // Nearly on a line: noise turns it over. A smile that becomes a frown is no mirror image.
        let nearly = |seed| mapped(seed, 9, 0.0, |p| Point::new(p.x, 0.02 * p.y));
        let [_, p] = nearly(1);
        let flipped: Vec<Point> = p.iter().map(|p| Point::new(p.x, -p.y)).collect();
        assert_eq!(of_points(&p, &flipped), None);
        // Flattened across itself.
        let flat: Vec<Point> = scattered
            .iter()
            .map(|p| Point::new(p.x, -0.01 * p.y))
            .collect();
        assert_eq!(of_points(&scattered, &flat), None);
    }

    #[test]
    fn lines_count_as_their_positions_do() {
        let mut number = numbers(5);
        let mut place = || Point::new(300.0 * number(), 200.0 * number());
        let p: Vec<Handle> = (0..4)
            .map(|_| Handle::Polyline(vec![place(), place(), place()]))
            .collect();
        let map = |scale: f64, flip: bool| {
            let map = turned(0.4, scale, flip);
            p.iter()
                .map(|line| Handle::Polyline(line.places().iter().map(|p| map(*p)).collect()))
                .collect::<Vec<_>>()
        };
        assert!(matches!(demand_of(&p, &map(1.0, true)),
                Some(Demand::Mirrored { determinant }) if (determinant + 1.0).abs() < 1e-9));
        assert!(matches!(demand_of(&p, &map(0.2, false)),
                Some(Demand::Scaled { scale }) if (scale - 0.2).abs() < 1e-9));
        assert_eq!(demand_of(&p, &map(1.0, false)), None);
    }
}
