//! A recorded drag: six strokes, each of which takes a handle, carries it along an arc as people do
//! (slow, fast, slow) and holds it, trembling, before the next. A device that reports 125 times a
//! second is not punctual, and neither is this one. The same every time.

use std::time::Duration;

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

/// Poses of the recording.
pub const POSES: u64 = 600;
/// Between two reports of the device, seconds.
const PERIOD: f64 = 0.008;
/// How late a report may be, seconds.
const LATE: f64 = 0.0015;
/// Poses of a stroke, and how many of them move.
const STROKE: (u64, u64) = (100, 70);
/// Of the picture's height: how a held handle trembles.
const TREMOR: f64 = 0.0004;

/// When each pose is reported.
pub fn times() -> Vec<Duration> {
    let mut noise = Noise(7);
    (0..POSES)
        .map(|n| Duration::from_secs_f64(n as f64 * PERIOD + LATE * noise.next()))
        .collect()
}

/// The handles at each report: `rest`, taken one after the other to where they are in `target`.
pub fn poses(rest: &[Handle], target: &[Handle], height: f64) -> Vec<Vec<Handle>> {
    let mut noise = Noise(11);
    let mut q = rest.to_vec();
    (0..POSES)
        .map(|n| {
            let (stroke, step) = (n / STROKE.0, n % STROKE.0);
            let index = (2 * stroke as usize + 1) % rest.len();
            let (Handle::Point(from), Handle::Point(to)) = (&rest[index], &target[index]) else {
                panic!("the drag moves points")
            };
            let t = (step as f64 / STROKE.1 as f64).min(1.0);
            // The smoothest way from rest to rest.
            let s = t * t * t * (10.0 - 15.0 * t + 6.0 * t * t);
            let way = *to - *from;
            let bow = 0.25 * (std::f64::consts::PI * s).sin();
            let tremor = height * TREMOR;
            let (x, y) = (
                from.x + way.x * s - way.y * bow,
                from.y + way.y * s + way.x * bow,
            );
            q[index] = Handle::Point(Point::new(
                x + tremor * (noise.next() - 0.5),
                y + tremor * (noise.next() - 0.5),
            ));
            q.clone()
        })
        .collect()
}

/// Numbers in 0 to 1 that look random.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1_u64 << 24) as f64
    }
}
