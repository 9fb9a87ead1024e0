//! The poses of a batch: in-betweens with an easing, and seeded jitter.

use super::chacha::ChaCha8;
use super::{ResolvedRest, Units};
use crate::deform::Handle;
use crate::geometry::Point;
use crate::pixmap::Extent;

/// How in-betweens follow one another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Easing {
    /// In equal steps.
    #[default]
    Linear,
    /// Slowly at both ends: 3 t^2 - 2 t^3.
    EaseInOut,
}

impl Easing {
    /// The share of the way from rest to pose of one of `steps` frames: 0 for the first, 1 for the
    /// last; 1 if there is one frame.
    ///
    /// ```
    /// use mlswarp::warp::Easing;
    /// let shares: Vec<f64> = (0..5).map(|frame| Easing::Linear.at(frame, 5)).collect();
    /// assert_eq!(shares, [0.0, 0.25, 0.5, 0.75, 1.0]);
    /// assert!(Easing::EaseInOut.at(1, 5) < 0.25);
    /// ```
    #[must_use]
    pub fn at(self, frame: u32, steps: u32) -> f64 {
        if frame.saturating_add(1) >= steps {
            return 1.0;
        }
        let t = f64::from(frame) / f64::from(steps - 1);
        match self {
            Self::Linear => t,
            Self::EaseInOut => t * t * (3.0 - 2.0 * t),
        }
    }
}

/// Handles along each side of [`jitter_grid`].
const HANDLES_PER_SIDE: u32 = 5;

/// The handles by which a picture without handles is jittered: 5 x 5 points from corner to corner,
/// row by row.
///
/// ```
/// use mlswarp::pixmap::Extent;
/// use mlswarp::warp::{Units, jitter_grid};
/// assert_eq!(jitter_grid(Units::Px, Extent::new(640, 480).unwrap()).len(), 25);
/// ```
#[must_use]
pub fn jitter_grid(units: Units, extent: Extent) -> Vec<Handle> {
    let (width, height) = match units {
        Units::Px => (f64::from(extent.width()), f64::from(extent.height())),
        Units::Normalized => (1.0, 1.0),
    };
    let share = |k: u32| f64::from(k) / f64::from(HANDLES_PER_SIDE - 1);
    let row = |y: u32| {
        (0..HANDLES_PER_SIDE)
            .map(move |x| Handle::Point(Point::new(width * share(x), height * share(y))))
    };
    (0..HANDLES_PER_SIDE).flat_map(row).collect()
}

/// Plane waves of a frame.
const PLANE_WAVES: usize = 64;
/// The longest wavelength, in shortest ones.
const LONGEST_WAVELENGTH: f64 = 4.0;

/// Random displacements that vary smoothly over the plane: a sum of 64 plane waves of random
/// direction, wavelength, phase and polarisation. The shortest wavelength is the mean (root mean
/// square) distance between the handles, the longest is four times as long. Along each axis, the
/// displacements have the standard deviation `sigma` over all frames.
///
/// The waves of a frame depend on the seed and the frame's number alone, and only on operations
/// that IEEE 754 defines exactly, so that every machine computes the same bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jitter {
    /// Chooses the waves.
    pub seed: u64,
    /// Standard deviation along each axis, px.
    pub sigma: f64,
}

/// One plane wave.
struct Wave {
    /// Periods per shortest wavelength, along each axis.
    periods: (f64, f64),
    /// In periods.
    phase: f64,
    /// The direction of its displacements, of length 1.
    polarisation: (f64, f64),
}

impl Jitter {
    /// The largest displacement along an axis, in `sigma`: all waves at their largest.
    const MOST_SIGMAS: f64 = 16.0;

    /// `q` displaced as far as possible, to the left top and to the right bottom.
    #[must_use]
    pub fn extremes(&self, setup: &ResolvedRest, q: &[Handle]) -> [Vec<Handle>; 2] {
        let unit = setup.unit();
        let farthest = self.sigma * Self::MOST_SIGMAS;
        [-farthest, farthest].map(|d| {
            let moved = |place: &Point| Point::new(place.x + d / unit.0, place.y + d / unit.1);
            let handle = |handle: &Handle| match handle {
                Handle::Point(place) => Handle::Point(moved(place)),
                Handle::Polyline(places) => Handle::Polyline(places.iter().map(moved).collect()),
                Handle::Missing => Handle::Missing,
            };
            q.iter().map(handle).collect()
        })
    }

    /// `q` displaced by the waves of a frame. Each position moves by the displacement at its
    /// position at rest, `p`, so that handles which coincide at rest move together. Both are in the
    /// client's units; positions of `q` without one of `p` stay.
    #[must_use]
    pub fn displace(
        &self,
        setup: &ResolvedRest,
        p: &[Handle],
        q: &[Handle],
        frame: u32,
    ) -> Vec<Handle> {
        let unit = setup.unit();
        let waves = self.waves(frame);
        let per_px = 1.0 / mean_distance(p, unit).unwrap_or(1.0);
        let moved = |rest: &Point, posed: &Point| {
            let (dx, dy) =
                self.displacement(&waves, rest.x * unit.0 * per_px, rest.y * unit.1 * per_px);
            Point::new(posed.x + dx / unit.0, posed.y + dy / unit.1)
        };
        let handle = |(k, q): (usize, &Handle)| match (p.get(k), q) {
            (Some(Handle::Point(rest)), Handle::Point(posed)) => Handle::Point(moved(rest, posed)),
            (Some(Handle::Polyline(rest)), Handle::Polyline(posed))
                if rest.len() == posed.len() =>
            {
                Handle::Polyline(
                    rest.iter()
                        .zip(posed)
                        .map(|(rest, posed)| moved(rest, posed))
                        .collect(),
                )
            }
            _ => q.clone(),
        };
        q.iter().enumerate().map(handle).collect()
    }

    /// Each frame has a stream of its own of the generator that the seed chooses.
    fn waves(&self, frame: u32) -> [Wave; PLANE_WAVES] {
        let mut random = ChaCha8::new(self.seed, frame);
        std::array::from_fn(|_| {
            let periods = in_ring(&mut random, 1.0 / LONGEST_WAVELENGTH);
            let phase = uniform(&mut random);
            let (x, y) = in_ring(&mut random, 1.0 / LONGEST_WAVELENGTH);
            let length = (x * x + y * y).sqrt();
            Wave {
                periods,
                phase,
                polarisation: (x / length, y / length),
            }
        })
    }

    /// The displacement at a position in shortest wavelengths, px.
    fn displacement(&self, waves: &[Wave; PLANE_WAVES], x: f64, y: f64) -> (f64, f64) {
        let (mut dx, mut dy) = (0.0, 0.0);
        for Wave {
            periods,
            phase,
            polarisation,
        } in waves
        {
            let height = sine(periods.0 * x + periods.1 * y + phase);
            dx += polarisation.0 * height;
            dy += polarisation.1 * height;
        }
        // The mean squares of a sine and of a coordinate of a random direction are 1/2.
        let scale = self.sigma * Self::MOST_SIGMAS / PLANE_WAVES as f64;
        (dx * scale, dy * scale)
    }
}

/// The root mean square of the distances between all positions, px; `None` if they coincide.
fn mean_distance(handles: &[Handle], unit: (f64, f64)) -> Option<f64> {
    let places = || handles.iter().flat_map(Handle::places);
    let count = places().count().max(1) as f64;
    let (x, y) = places().fold((0.0, 0.0), |(x, y), place| (x + place.x, y + place.y));
    let (x, y) = (x / count, y / count);
    let square = |place: &Point| {
        ((place.x - x) * unit.0) * ((place.x - x) * unit.0)
            + ((place.y - y) * unit.1) * ((place.y - y) * unit.1)
    };
    // The mean square of the differences of two is twice the variance; each position is compared
    // with `count - 1` others.
    let sum: f64 = places().map(square).sum();
    let mean = 2.0 * sum / (count - 1.0).max(1.0);
    (mean > 0.0).then(|| mean.sqrt())
}

/// Uniform in 0 to 1.
fn uniform(random: &mut ChaCha8) -> f64 {
    const UNIT_STEP: f64 = 1.0 / (1_u64 << 53) as f64;
    (random.next_u64() >> 11) as f64 * UNIT_STEP
}

/// Uniform in the ring between `inner` and 1.
fn in_ring(random: &mut ChaCha8, inner: f64) -> (f64, f64) {
    loop {
        let (x, y) = (2.0 * uniform(random) - 1.0, 2.0 * uniform(random) - 1.0);
        let square = x * x + y * y;
        if (inner * inner..=1.0).contains(&square) {
            return (x, y);
        }
    }
}

/// The sine of a number of periods, to 1e-11: a C library's sine may differ from another's in the
/// last bit.
fn sine(periods: f64) -> f64 {
    let rest = periods - (periods + 0.5).floor();
    let quarter = if rest > 0.25 {
        0.5 - rest
    } else if rest < -0.25 {
        -0.5 - rest
    } else {
        rest
    };
    let x = quarter * std::f64::consts::TAU;
    // x (1 - x^2 / (2 * 3) (1 - x^2 / (4 * 5) (...))).
    let series = (1..=8).rev().fold(1.0, |series, k| {
        1.0 - x * x / f64::from(2 * k * (2 * k + 1)) * series
    });
    x * series
}

#[cfg(test)]
mod tests {
    use super::super::{Limits, RestSpec};
    use super::*;

    fn setup(p: &[Handle], units: Units) -> ResolvedRest {
        let rest = RestSpec {
            p: p.to_vec(),
            units,
            ..RestSpec::default()
        };
        ResolvedRest::new(
            &rest,
            Extent::new(200, 100).unwrap(),
            &Limits::default(),
            &|| false,
        )
        .unwrap()
    }

    fn point(x: f64, y: f64) -> Handle {
        Handle::Point(Point::new(x, y))
    }

    fn face() -> Vec<Handle> {
        (0..40)
            .map(|k| {
                point(
                    100.0 + 60.0 * f64::from(k % 8) / 8.0,
                    20.0 + 60.0 * f64::from(k / 8) / 5.0,
                )
            })
            .collect()
    }

    fn moves(p: &[Handle], moved: &[Handle]) -> Vec<(f64, f64)> {
        let places = |handles: &[Handle]| {
            handles
                .iter()
                .flat_map(|h| h.places().to_vec())
                .collect::<Vec<_>>()
        };
        places(p)
            .iter()
            .zip(places(moved))
            .map(|(p, q)| (q.x - p.x, q.y - p.y))
            .collect()
    }

    #[test]
    fn easings_begin_at_rest_end_at_the_pose_and_rise() {
        for easing in [Easing::Linear, Easing::EaseInOut] {
            assert_eq!(
                (easing.at(0, 1), easing.at(0, 2), easing.at(1, 2)),
                (1.0, 0.0, 1.0)
            );
            for steps in [2, 3, 24, 10_000] {
                let t: Vec<f64> = (0..steps).map(|k| easing.at(k, steps)).collect();
                assert_eq!((t[0], t[t.len() - 1]), (0.0, 1.0));
                assert!(t.windows(2).all(|t| t[0] < t[1]));
                let mirrored = t
                    .iter()
                    .zip(t.iter().rev())
                    .all(|(a, b)| (a + b - 1.0).abs() < 1e-12);
                assert!(mirrored, "both halves are alike");
            }
        }
        assert_eq!(
            (Easing::Linear.at(1, 5), Easing::EaseInOut.at(1, 5)),
            (0.25, 0.156_25)
        );
    }

    #[test]
    fn the_sine_is_that_of_the_library() {
        for k in -40_000..40_000 {
            let periods = f64::from(k) / 9973.0;
            assert!(
                (sine(periods) - (periods * std::f64::consts::TAU).sin()).abs() < 2e-11,
                "{periods}"
            );
        }
    }

    /// Computed once; every machine must find the same bits.
    #[test]
    fn a_seed_gives_the_same_bits_everywhere() {
        let (p, jitter) = (
            face(),
            Jitter {
                seed: 7,
                sigma: 3.0,
            },
        );
        let moved = jitter.displace(&setup(&p, Units::Px), &p, &p, 5);
        let bits = moved
            .iter()
            .flat_map(|h| h.places().to_vec())
            .fold(0_u64, |sum, p| {
                sum.rotate_left(7) ^ p.x.to_bits() ^ p.y.to_bits().rotate_left(32)
            });
        assert_eq!(bits, 0xC937_F807_DE3B_CC15, "{bits:#x}");
    }

    #[test]
    fn a_frame_depends_on_the_seed_and_its_number_alone() {
        let (p, setup) = (face(), setup(&face(), Units::Px));
        let moved = |seed, frame| Jitter { seed, sigma: 3.0 }.displace(&setup, &p, &p, frame);
        assert_eq!(moved(7, 5), moved(7, 5));
        assert_ne!(moved(7, 5), moved(7, 6));
        assert_ne!(moved(7, 5), moved(8, 5));
        // The other handles change the wavelengths, not the waves: those of one handle alone do not
        // depend on where it is.
        let twice = Jitter {
            seed: 7,
            sigma: 6.0,
        }
        .displace(&setup, &p, &p, 5);
        for (one, two) in moves(&p, &moved(7, 5)).iter().zip(moves(&p, &twice)) {
            assert!((2.0 * one.0 - two.0).abs() < 1e-9 && (2.0 * one.1 - two.1).abs() < 1e-9);
        }
        // From another pose, the same displacements.
        let q: Vec<Handle> = p
            .iter()
            .map(|h| point(h.places()[0].x * 0.5, 7.0))
            .collect();
        let other = Jitter {
            seed: 7,
            sigma: 3.0,
        }
        .displace(&setup, &p, &q, 5);
        for (a, b) in moves(&p, &moved(7, 5)).iter().zip(moves(&q, &other)) {
            assert!((a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9);
        }
    }

    #[test]
    fn displacements_have_the_standard_deviation_and_a_bound() {
        let (p, setup) = (face(), setup(&face(), Units::Px));
        let jitter = Jitter {
            seed: 1,
            sigma: 2.5,
        };
        let (mut sum, mut mean, mut count, mut most) = ([0.0; 2], [0.0; 2], 0.0, 0.0_f64);
        for frame in 0..2000 {
            for (dx, dy) in moves(&p, &jitter.displace(&setup, &p, &p, frame)) {
                sum = [sum[0] + dx * dx, sum[1] + dy * dy];
                mean = [mean[0] + dx, mean[1] + dy];
                most = most.max(dx.abs()).max(dy.abs());
                count += 1.0;
            }
        }
        for axis in 0..2 {
            let deviation = (sum[axis] / count).sqrt();
            assert!(
                (deviation / 2.5 - 1.0).abs() < 0.03,
                "axis {axis}: {deviation}"
            );
            assert!(
                (mean[axis] / count).abs() < 0.1,
                "axis {axis}: {}",
                mean[axis] / count
            );
        }
        assert!(most > 5.0 && most < Jitter::MOST_SIGMAS * 2.5, "{most}");
    }

    #[test]
    fn neighbours_move_together_and_distant_handles_do_not() {
        let mut p = face();
        // A hair beside the first, and a line through both.
        p.push(point(100.001, 20.0));
        p.push(Handle::Polyline(vec![
            Point::new(100.0, 20.0),
            Point::new(100.001, 20.0),
        ]));
        let setup = setup(&p, Units::Px);
        let jitter = Jitter {
            seed: 3,
            sigma: 5.0,
        };
        let mut apart = 0.0_f64;
        for frame in 0..200 {
            let moves = moves(&p, &jitter.displace(&setup, &p, &p, frame));
            let differ =
                |a: usize, b: usize| (moves[a].0 - moves[b].0).hypot(moves[a].1 - moves[b].1);
            assert!(
                differ(0, 40) < 0.002 && differ(0, 41) == 0.0 && differ(40, 42) == 0.0,
                "{}",
                differ(0, 40)
            );
            apart += differ(0, 39) / 200.0;
        }
        assert!(
            apart > 4.0,
            "the corners of the set move independently: {apart}"
        );
    }

    #[test]
    fn normalized_handles_move_by_as_many_pixels() {
        let p = face();
        let small: Vec<Handle> = p
            .iter()
            .map(|h| point(h.places()[0].x / 200.0, h.places()[0].y / 100.0))
            .collect();
        let jitter = Jitter {
            seed: 9,
            sigma: 4.0,
        };
        let px = moves(&p, &jitter.displace(&setup(&p, Units::Px), &p, &p, 2));
        let normalized = moves(
            &small,
            &jitter.displace(&setup(&small, Units::Normalized), &small, &small, 2),
        );
        for (px, n) in px.iter().zip(normalized) {
            assert!((px.0 - 200.0 * n.0).abs() < 1e-6 && (px.1 - 100.0 * n.1).abs() < 1e-6);
        }
    }

    #[test]
    fn one_handle_or_none_is_no_special_case() {
        let one = [point(10.0, 10.0)];
        let moved = Jitter {
            seed: 1,
            sigma: 2.0,
        }
        .displace(&setup(&one, Units::Px), &one, &one, 0);
        let [(dx, dy)] = moves(&one, &moved)[..] else {
            panic!()
        };
        assert!(dx.hypot(dy) > 0.0 && dx.hypot(dy) < 64.0);
        assert!(
            Jitter {
                seed: 1,
                sigma: 2.0
            }
            .displace(&setup(&[], Units::Px), &[], &[], 0)
            .is_empty()
        );
        let still = Jitter {
            seed: 1,
            sigma: 0.0,
        }
        .displace(&setup(&one, Units::Px), &one, &one, 0);
        assert_eq!(still, one);
    }
}
