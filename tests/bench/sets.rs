//! Handle sets of the benchmarks: seven or more handles spread over 500 x 500 px, moved by 20 to 40
//! px.

#![allow(dead_code, reason = "each benchmark uses a part of the sets")]

use mlswarp::deform::{Falloff, Handle, Handles, Method, Pose, RestDeformation};
use mlswarp::geometry::Point;

pub const SIDE: f64 = 500.0;

/// A repeatable stream of fractions in [0, 1).
pub struct Fractions(u64);

impl Fractions {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// `n` points 0.25 px off the vertices of a 100 x 100 grid, and where they go.
pub fn points(n: usize) -> (Vec<Point>, Vec<Point>) {
    let mut random = Fractions::new(7);
    let p: Vec<Point> = (0..n)
        .map(|_| {
            Point::new(
                (40.0 + 420.0 * random.next()).floor() + 0.25,
                (40.0 + 420.0 * random.next()).floor() + 0.25,
            )
        })
        .collect();
    let q = p
        .iter()
        .map(|p| {
            let (sin, cos) = (random.next() * std::f64::consts::TAU).sin_cos();
            let reach = if n > 50 {
                4.0
            } else {
                20.0 + 20.0 * random.next()
            };
            Point::new(p.x + reach * cos, p.y + reach * sin)
        })
        .collect();
    (p, q)
}

pub fn point_field(n: usize, method: Method, alpha: f64) -> (RestDeformation, Pose) {
    let (p, q) = points(n);
    let handles = |list: Vec<Point>| list.into_iter().map(Handle::Point).collect::<Vec<_>>();
    field(handles(p), handles(q), method, alpha)
}

/// `n` segments side by side, none crossing another.
pub fn line_field(n: usize, method: Method, alpha: f64) -> (RestDeformation, Pose) {
    let mut random = Fractions::new(11);
    let (mut p, mut q) = (vec![], vec![]);
    for k in 0..n {
        let x = SIDE * (k as f64 + 0.5) / n as f64;
        let mut end =
            |y: f64| Point::new(x + 20.0 * random.next() - 10.0, y + 60.0 * random.next());
        let ab = vec![end(80.0), end(300.0)];
        q.push(Handle::Polyline(
            ab.iter()
                .map(|p| Point::new(p.x + 25.0, p.y - 10.0 * (k % 3) as f64))
                .collect(),
        ));
        p.push(Handle::Polyline(ab));
    }
    field(p, q, method, alpha)
}

fn field(p: Vec<Handle>, q: Vec<Handle>, method: Method, alpha: f64) -> (RestDeformation, Pose) {
    let rest = Handles::new(p, None).expect("well-formed handles");
    let falloff = Falloff::new(alpha, rest.has_lines()).expect("alpha in range");
    let field = RestDeformation::new(rest, method, falloff, 1.0).expect("a regular set");
    let pose = field.pose(&q).expect("targets that agree");
    (field, pose)
}
