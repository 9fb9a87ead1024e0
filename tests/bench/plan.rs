//! Building the A_j table of 10,000 vertices, beside what a crate without a plan takes to deform
//! the same vertices once.

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
use mlswarp::deform::{CoefficientTable, Method};
use mlswarp::geometry::Grid;

fn main() {
    let mut report = Report::new(
        "plan",
        "the A_j of 10,000 vertices (100 x 100 over 500 x 500 px), rigid",
    );
    let grid = Grid::with_counts(sets::SIDE, sets::SIDE, 100, 100);
    let (one, two) = (pool(1), pool(2));
    let (p, q) = sets::points(7);
    let single = |list: &[mlswarp::geometry::Point]| {
        list.iter()
            .map(|p| (p.x as f32, p.y as f32))
            .collect::<Vec<_>>()
    };
    let (p32, q32) = (single(&p), single(&q));
    let (a, _) = sets::point_field(7, Method::Rigid, 1.0);
    let (b, _) = sets::point_field(7, Method::Rigid, 1.3);
    let (c, _) = sets::line_field(7, Method::Rigid, 2.0);
    let (d, _) = sets::line_field(7, Method::Rigid, 1.3);
    let mut contenders = vec![contender(
        "moving-least-squares 0.1 deforms them once (7 points, alpha 1)",
        || {
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
        },
    )];
    for (name, field) in [
        ("7 points alpha 1", &a),
        ("7 points alpha 1.3", &b),
        ("7 lines alpha 2", &c),
        ("7 lines alpha 1.3", &d),
    ] {
        for (threads, pool) in [(1, &one), (2, &two)] {
            contenders.push(contender(
                format!("{name}, {threads} thread(s)"),
                move || {
                    pool.install(|| {
                        black_box(
                            CoefficientTable::of_grid(black_box(field), &grid, &|| false)
                                .expect("nothing cancels it"),
                        )
                    });
                },
            ));
        }
    }
    report.table("plan", 15, &mut contenders);
}
