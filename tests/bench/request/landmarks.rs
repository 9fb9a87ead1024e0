//! Poses of many landmarks in 500 x 500 px with the default grid: the deformation alone, until the
//! mesh may be drawn. The landmarks lie in 180 x 220 px, on a shaken lattice or at random places,
//! and move in waves of 4 px or each by up to a quarter of their distance.

use std::time::Instant;

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::pixmap::{Channels, Extent};
use mlswarp::warp::{GridSpec, Method, RestSpec};

use crate::drag::{self, Drag};
use crate::harness::pictures::{SMALL, extent, photograph};
use crate::harness::{Report, pool};

const WIDTH: f64 = 180.0;
const HEIGHT: f64 = 220.0;
const POSES: u32 = 8;
const ROUNDS: u32 = 24;

#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    is_even: bool,
    moves_smoothly: bool,
}

/// Landmarks, and the bar of a pose, ms.
type Bars = [(u32, f64); 4];

const KINDS: [(Kind, Bars); 3] = [
    (
        Kind {
            name: "evenly, waves",
            is_even: true,
            moves_smoothly: true,
        },
        [(68, 0.5), (106, 1.0), (478, 15.0), (1000, 30.0)],
    ),
    (
        Kind {
            name: "at random, waves",
            is_even: false,
            moves_smoothly: true,
        },
        [(68, 0.7), (106, 1.5), (478, 25.0), (1000, 50.0)],
    ),
    (
        Kind {
            name: "evenly, each for itself",
            is_even: true,
            moves_smoothly: false,
        },
        [(68, 1.0), (106, 3.0), (478, 40.0), (1000, 60.0)],
    ),
];
const SPLINES: Bars = [(68, f64::NAN), (106, f64::NAN), (478, 20.0), (1000, 50.0)];

pub fn table(report: &mut Report, title: &str) {
    let two = pool(2);
    report.line(&format!(
        "## {title}\n\n| method | landmarks | lie, move | setup, ms | first picture, ms | pose, ms \
            (least) | median | bar | plan at most, MiB |"
    ));
    report.line("|---|---|---|---|---|---|---|---|---|");
    let file = drag::file(&photograph(extent(SMALL), Channels::Rgba));
    let rigid = KINDS.map(|(kind, bars)| (Method::Rigid, "rigid", kind, bars));
    let spline = (Method::ThinPlateSpline, "tps", KINDS[2].0, SPLINES);
    for (method, method_name, kind, bars) in rigid.into_iter().chain([spline]) {
        for (count, bar) in bars {
            let (p, q) = landmarks(count, kind, extent(SMALL));
            two.install(|| {
                let ms = |began: Instant| 1e3 * began.elapsed().as_secs_f64();
                let spec = RestSpec {
                    p,
                    method,
                    grid: GridSpec::Auto,
                    ..RestSpec::default()
                };
                let began = Instant::now();
                let mut drag = Drag::of_handles(&file, spec, q);
                let setup = ms(began);
                let began = Instant::now();
                drag.picture(1);
                let first = ms(began);
                let mut poses: Vec<f64> = (0..ROUNDS)
                    .map(|_| {
                        let began = Instant::now();
                        drag.pose();
                        ms(began)
                    })
                    .collect();
                poses.sort_by(f64::total_cmp);
                let (least, median) = (poses[0], poses[poses.len() / 2]);
                let memory = drag.plan_bytes() as f64 / f64::from(1 << 20);
                report.line(&format!(
                    "| {method_name} | {count} | {} | {setup:.1} | {first:.1} | {least:.2} | \
                        {median:.2} | {bar} | {memory:.0} |",
                    kind.name
                ));
            });
        }
    }
    report.line("");
}

fn landmarks(count: u32, kind: Kind, extent: Extent) -> (Vec<Handle>, Vec<Vec<Handle>>) {
    let noise = |k: u32, n: u32| {
        let mixed = u64::from(k * 64 + n + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mixed = (mixed ^ mixed >> 31).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        (mixed >> 40) as f64 / f64::from(1_u32 << 24) - 0.5
    };
    let columns = (f64::from(count) * WIDTH / HEIGHT).sqrt().ceil();
    let rows = (f64::from(count) / columns).ceil();
    let (left, top) = (
        0.5 * (f64::from(extent.width()) - WIDTH),
        0.5 * (f64::from(extent.height()) - HEIGHT),
    );
    let place = |k: u32| {
        let (i, j) = (f64::from(k) % columns, (f64::from(k) / columns).floor());
        let (x, y) = if kind.is_even {
            (
                (i + 0.5 + 0.3 * noise(k, 0)) / columns,
                (j + 0.5 + 0.3 * noise(k, 1)) / rows,
            )
        } else {
            (0.5 + noise(k, 0), 0.5 + noise(k, 1))
        };
        Point::new(left + WIDTH * x, top + HEIGHT * y)
    };
    let apart = (WIDTH * HEIGHT / f64::from(count)).sqrt();
    let moved = |k: u32, pose: u32| {
        let (p, time) = (place(k), 0.1 * f64::from(pose));
        if kind.moves_smoothly {
            Point::new(
                p.x + 4.0 * (p.y / 30.0 + time).sin(),
                p.y + 4.0 * (p.x / 35.0 + time).cos(),
            )
        } else {
            Point::new(
                p.x + 0.5 * apart * noise(k, 2 + 2 * pose),
                p.y + 0.5 * apart * noise(k, 3 + 2 * pose),
            )
        }
    };
    let posed = |pose| (0..count).map(|k| Handle::Point(moved(k, pose))).collect();
    (
        (0..count).map(|k| Handle::Point(place(k))).collect(),
        (0..POSES).map(posed).collect(),
    )
}
