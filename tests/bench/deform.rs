//! Posing 10,000 vertices from the A_j table, beside merely reading a table of that size, and
//! beside the crates that deform the same vertices; and 100,000 points mapped exactly, forwards and
//! back.

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::should_implement_trait,
    reason = "a program that prints a table"
)]

#[path = "harness/mod.rs"]
mod harness;
mod sets;

use std::hint::black_box;

use harness::{Report, contender, pool};
use mlswarp::Warper;
use mlswarp::deform::{CoefficientTable, Handle, Method, pose_without_table};
use mlswarp::geometry::{Grid, Point};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Folds, Limits, PosedMesh, ResolvedRest, RestSpec};

/// Reads a table once: the sum of its numbers, in as many chains as keep the loads busy.
fn read(table: &[[f32; 64]]) -> f32 {
    let mut sums = [0.0f32; 64];
    for row in table {
        for (sum, x) in sums.iter_mut().zip(row) {
            *sum += x;
        }
    }
    sums.iter().sum()
}

fn main() {
    // Inside the pool: no hand-over is timed, and no second thread is used.
    pool(1).install(if std::env::args().any(|arg| arg == ONE_LEVEL) {
        one_level
    } else {
        tables
    });
}

fn tables() {
    let mut report = Report::new(
        "deform",
        "10,000 vertices (100 x 100 over 500 x 500 px), rigid, alpha 1, one thread",
    );
    let grid = Grid::with_counts(sets::SIDE, sets::SIDE, 100, 100);
    for n in [7, 11, 100] {
        let (field, pose) = sets::point_field(n, Method::Rigid, 1.0);
        let plan = CoefficientTable::of_grid(&field, &grid, &|| false).expect("nothing cancels it");
        let table = vec![[1.0f32; 64]; usize::try_from(plan.bytes()).expect("fits") / 256];
        let (p, q) = sets::points(n);
        let single = |list: &[Point]| {
            list.iter()
                .map(|p| (p.x as f32, p.y as f32))
                .collect::<Vec<_>>()
        };
        let (p32, q32) = (single(&p), single(&q));
        let mut piston = deform_grid::DeformGrid::new([0.0, 0.0, sets::SIDE, sets::SIDE], 99, 99);
        for (p, q) in p.iter().zip(&q) {
            piston.add_control_point([p.x, p.y]);
            let last = piston.qs.len() - 1;
            piston.set_current(last, [q.x, q.y]);
        }
        let mut contenders = vec![
            contender("read a table of this size", || {
                black_box(read(black_box(&table)));
            }),
            contender("mlswarp", || {
                black_box(plan.displace(black_box(&pose), &|| false));
            }),
        ];
        contenders.push(contender("moving-least-squares 0.1 (f32, rigid)", || {
            for j in 0..100 {
                for i in 0..100 {
                    let v = grid.vertex(i, j);
                    black_box(moving_least_squares::deform_rigid(
                        &p32,
                        &q32,
                        (v.x as f32, v.y as f32),
                    ));
                }
            }
        }));
        contenders.push(contender(
            "piston2d-deform_grid 0.15 (f64, rigid)",
            move || piston.update(),
        ));
        report.table(
            &format!("{n} handles, table of {:.2} MB", plan.bytes() as f64 / 1e6),
            31,
            &mut contenders,
        );
    }
    many(&mut report);
    annotations(&mut report);
    unfolded(&mut report);
    levels(&mut report);
    growth(&mut report);
}

/// Points beside whose table the moments of each pose take less memory and time; 70 of 5,000
/// coincide with others.
fn many(report: &mut Report) {
    let grid = Grid::with_counts(sets::SIDE, sets::SIDE, 101, 101);
    let two = pool(2);
    for n in [1000, 5000] {
        let sets = [1.0, 2.0, 1.3].map(|alpha| (alpha, sets::point_field(n, Method::Rigid, alpha)));
        let mut contenders = Vec::new();
        for (alpha, (field, pose)) in &sets {
            let pose = move || {
                black_box(pose_without_table(field, &grid, black_box(pose), &|| false));
            };
            let two = &two;
            contenders.push(contender(format!("alpha {alpha}, 1 thread"), pose));
            contenders.push(contender(format!("alpha {alpha}, 2 threads"), move || {
                two.install(pose)
            }));
        }
        report.table(
            &format!("{n} handles without a table, 10,201 vertices"),
            7,
            &mut contenders,
        );
    }
}

/// 100,000 points by the exact map and back.
fn annotations(report: &mut Report) {
    let p = sets::points(7).0.into_iter().map(Handle::Point).collect();
    let rest = RestSpec {
        p,
        ..RestSpec::default()
    };
    let side = sets::SIDE as u32;
    let extent = Extent::new(side, side).expect("a size");
    let setup =
        ResolvedRest::new(&rest, extent, &Limits::default(), &|| false).expect("seven points");
    let pose = setup
        .pose(
            &sets::points(7)
                .1
                .into_iter()
                .map(Handle::Point)
                .collect::<Vec<_>>(),
        )
        .expect("seven points");
    let posed = PosedMesh::coarse(
        &setup,
        &setup.plan(&|| false).expect("nothing cancels it"),
        &pose,
        Folds::Report,
        &|| false,
    )
    .expect("a mesh");
    let place = |k: u32| {
        Point::new(
            f64::from(k * 7919 % 99_991) * sets::SIDE / 99_991.0,
            f64::from(k) * sets::SIDE / 1e5,
        )
    };
    let places: Vec<Point> = (0..100_000).map(place).collect();
    let there: Vec<Point> = setup
        .transform(&pose)
        .map(&places, &|| false)
        .expect("in range")
        .into_iter()
        .flatten()
        .collect();
    let mut contenders = vec![
        contender("f", || {
            black_box(
                setup
                    .transform(&pose)
                    .map(black_box(&places), &|| false)
                    .expect("in range"),
            );
        }),
        contender("its inverse", || {
            black_box(
                setup
                    .inverse(&pose, &posed)
                    .map(black_box(&there), &|| false)
                    .expect("in range"),
            );
        }),
    ];
    report.table("100,000 points, 7 handles", 7, &mut contenders);
}

/// A handle between four others is pulled across the image: not far, and farther.
fn unfolded(report: &mut Report) {
    let corners = [[50.0, 50.0], [450.0, 50.0], [50.0, 450.0], [450.0, 450.0]];
    let handles = |x: f64| [&corners[..], &[[x, 250.0]]].concat();
    for (about, x) in [("nearly folds", 190.0), ("folds", 380.0)] {
        let posed = [Folds::Report, Folds::Remove].map(|folds| {
            let warper = Warper::builder(&handles(120.0)).folds(folds);
            let warper = warper.build([500, 500]).expect("five points");
            let q = handles(x);
            contender(format!("{folds:?}"), move || {
                black_box(warper.pose(black_box(&q)).expect("can be posed"));
            })
        });
        let title = format!("A pose that {about}: 5 handles, rigid, 500 x 500 px, cells of 5 px");
        report.table(&title, 7, &mut Vec::from(posed));
    }
}

/// Log-log slope in vertices and in handles: 1 is linear. All tables lie in L2 (1 MB and more on
/// the processors of today) and not in L1: across two levels the slope would be that of the memory.
fn growth(report: &mut Report) {
    let time = |side: u32, n: usize| {
        let grid = Grid::with_counts(sets::SIDE, sets::SIDE, side, side);
        let (field, pose) = sets::point_field(n, Method::Rigid, 1.0);
        let plan = CoefficientTable::of_grid(&field, &grid, &|| false).expect("nothing cancels it");
        let median = harness::medians(
            31,
            &mut [contender("", || {
                black_box(plan.displace(black_box(&pose), &|| false));
            })],
        )[0];
        (median, plan.bytes() as f64 / 1e6)
    };
    let slope =
        |(few, _): (f64, f64), (many, _): (f64, f64), times: f64| (many / few).ln() / times.ln();
    let (small, large) = (time(40, 7), time(80, 7));
    let (few, many) = (time(32, 30), time(32, 60));
    report.line(&format!(
        "Growth within L2: slope {:.2} in vertices (40^2 to 80^2, 7 handles, tables of {:.2} and \
            {:.2} MB), {:.2} in handles (30 to 60, 32^2 vertices, \
         {:.2} and {:.2} MB).",
        slope(small, large, 4.0),
        small.1,
        large.1,
        slope(few, many, 2.0),
        few.1,
        many.1
    ));
}

/// The time of 7 and 100 handles on every level of the machine: this program again, with the level
/// lowered as a user would lower it.
fn levels(report: &mut Report) {
    report
        .line("## Levels, 10,000 vertices\n\n| level | 7 handles | 100 handles |\n|---|---:|---:|");
    let program = std::env::current_exe().expect("a program knows where it is");
    for level in mlswarp::level::SimdLevel::available() {
        let child = std::process::Command::new(&program)
            .arg(ONE_LEVEL)
            .env("MLSWARP_LEVEL", level.name())
            .output()
            .expect("runs again");
        let line = String::from_utf8(child.stdout).expect("prints text");
        report.line(&format!("| {} | {} |", level.name(), line.trim()));
    }
    report.line("");
}

/// Asks this program for one row of the table of levels.
const ONE_LEVEL: &str = "--one-level";

fn one_level() {
    let grid = Grid::with_counts(sets::SIDE, sets::SIDE, 100, 100);
    let row: Vec<String> = [7, 100]
        .into_iter()
        .map(|n| {
            let (field, pose) = sets::point_field(n, Method::Rigid, 1.0);
            let plan =
                CoefficientTable::of_grid(&field, &grid, &|| false).expect("nothing cancels it");
            let work = contender("", || {
                black_box(plan.displace(black_box(&pose), &|| false));
            });
            harness::time(harness::medians(31, &mut [work])[0])
        })
        .collect();
    println!("{}", row.join(" | "));
}
