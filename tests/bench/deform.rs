//! Posing 10,000 vertices from the A_j table, beside merely reading a table of that size, and beside the crates that deform the same vertices.

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
use mlswarp::deform::{Method, Plan};
use mlswarp::geometry::Grid;

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
    pool(1).install(tables);
}

fn tables() {
    let mut report = Report::new("deform", "10,000 vertices (100 x 100 over 500 x 500 px), rigid, alpha 1, one thread");
    let grid = Grid::with_counts(sets::SIDE, sets::SIDE, 100, 100);
    for n in [7, 11, 100] {
        let (field, pose) = sets::point_field(n, Method::Rigid, 1.0);
        let plan = Plan::of_grid(&field, &grid);
        let table = vec![[1.0f32; 64]; usize::try_from(plan.bytes()).expect("fits") / 256];
        let (p, q) = sets::points(n);
        let single = |list: &[mlswarp::geometry::Point]| list.iter().map(|p| (p.x as f32, p.y as f32)).collect::<Vec<_>>();
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
                black_box(plan.displace(black_box(&pose)));
            }),
        ];
        contenders.push(contender("moving-least-squares 0.1 (f32, rigid)", || {
            for j in 0..100 {
                for i in 0..100 {
                    let v = grid.vertex(i, j);
                    black_box(moving_least_squares::deform_rigid(&p32, &q32, (v.x as f32, v.y as f32)));
                }
            }
        }));
        contenders.push(contender("piston2d-deform_grid 0.15 (f64, rigid)", move || piston.update()));
        report.table(&format!("{n} handles, table of {:.2} MB", plan.bytes() as f64 / 1e6), 31, &mut contenders);
    }
    growth(&mut report);
}

/// Log-log slope in vertices and in handles: 1 is linear.
fn growth(report: &mut Report) {
    let time = |side: u32, n: usize| {
        let grid = Grid::with_counts(sets::SIDE, sets::SIDE, side, side);
        let (field, pose) = sets::point_field(n, Method::Rigid, 1.0);
        let plan = Plan::of_grid(&field, &grid);
        harness::medians(
            15,
            &mut [contender("", || {
                black_box(plan.displace(black_box(&pose)));
            })],
        )[0]
    };
    let vertices = (time(200, 20) / time(100, 20)).ln() / 4f64.ln();
    let handles = (time(100, 40) / time(100, 10)).ln() / 4f64.ln();
    report.line(&format!("Growth: slope {vertices:.2} in vertices (100^2 to 200^2, 20 handles), {handles:.2} in handles (10 to 40)."));
}
