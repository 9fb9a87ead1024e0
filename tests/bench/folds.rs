//! Poses whose folds are removed: the `fold_free` cases of `tests/rivals.json`, 500 x 500 px in
//! cells of 5 px, one thread, by parts. Each figure is the least of several runs.

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    reason = "a program that prints a table"
)]

#[path = "harness/mod.rs"]
mod harness;

use std::sync::Arc;
use std::time::Instant;

use harness::{Goal, Report, pool, time};
use mlswarp::deform::{
    CoefficientTable, Falloff, FoldFree, Handle, Handles, METHODS, Method, ProductWork,
    RestDeformation,
};
use mlswarp::geometry::{Point, untangle};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Folds, GridSpec, Limits, PosedMesh, ResolvedRest, RestSpec};
use serde_json::Value;

const RUNS: usize = 20;

/// Seconds of the parts of a pose, and what they did.
struct Parts {
    plain: f64,
    product: f64,
    vertices: f64,
    repair: f64,
    /// Of all that is done for a pose, with the report.
    whole: f64,
    factors: usize,
    mended: u64,
    evaluations: u32,
}

fn main() {
    // Inside the pool: no second thread is used.
    pool(1).install(table);
}

fn table() {
    let mut report = Report::new("folds", "poses whose folds are removed, one thread");
    report.line(
        "| case | map | plain | product | its vertices | repair | whole | factors | cells mended \
         | evaluations |\n|---|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    );
    let file: Value = serde_json::from_str(include_str!("../rivals.json")).expect("cases");
    let cases = file["fold_cases"].as_array().expect("cases").iter();
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for case in cases.filter(|case| case["expect"] == "fold_free") {
        let title = case["name"].as_str().expect("a name");
        for of in case["methods"].as_array().expect("methods") {
            let (method, alpha) = (of[0].as_str().expect("a method"), of[1].as_f64());
            let map = format!("{method} {}", alpha.expect("alpha"));
            if !harness::wanted(&format!("{title} {map}")) {
                continue;
            }
            let parts = parts(case, method, alpha);
            let [plain, product, vertices, repair, whole] = [
                parts.plain,
                parts.product,
                parts.vertices,
                parts.repair,
                parts.whole,
            ]
            .map(time);
            let title = title.trim_start_matches("public-fold-");
            report.line(&format!(
                "| {title} | {map} | {plain} | {product} | {vertices} | {repair} | {whole} | {} \
                 | {} | {} |",
                parts.factors, parts.mended, parts.evaluations
            ));
            if parts.mended > 0 {
                with.push(parts.whole);
            } else {
                // In poses of the plain f, of the same line.
                without.push(parts.whole / parts.plain);
            }
        }
    }
    report.line("");
    for (what, figures, goal) in [
        ("with repair, s: median", &mut with, 0.06),
        ("without repair, plain poses: median", &mut without, 20.0),
    ] {
        figures.sort_unstable_by(f64::total_cmp);
        let Some(largest) = figures.last() else {
            continue;
        };
        report.goal(what, figures[figures.len() / 2], Goal::AtMost(goal));
        report.goal("the largest of these", *largest, Goal::AtMost(goal));
    }
}

fn parts(case: &Value, method: &str, alpha: Option<f64>) -> Parts {
    let (p, q) = (handles(case, "p"), handles(case, "q"));
    let [width, height] = [0, 1].map(|k| case["extent"][k].as_f64().expect("px") as u32);
    let extent = Extent::new(width, height).expect("a size");
    let method = METHODS.iter().find(|info| info.name == method);
    let rest = RestSpec {
        p: p.clone(),
        method: method.map_or(Method::Rigid, |info| info.method),
        alpha,
        grid: GridSpec::Cell(5.0),
        ..RestSpec::default()
    };
    let never = &|| false;
    let setup = ResolvedRest::new(&rest, extent, &Limits::default(), never).expect("handles");
    let plan = setup.plan(never).expect("nothing cancels it");
    let pose = setup.pose(&q).expect("handles");
    let field = Handles::new(p.clone(), None).expect("handles");
    let mass = field.mean_segment_length();
    let falloff = Falloff::new(alpha.unwrap_or(1.0), mass.is_some()).expect("alpha");
    let field = RestDeformation::new(field, rest.method, falloff, mass.unwrap_or(1.0));
    let field = Arc::new(field.expect("handles"));
    let posed = |folds| PosedMesh::coarse(&setup, &plan, &pose, folds, never);
    let mut work = ProductWork {
        of_position: 1,
        of_factor: 1,
        most: u64::MAX,
        taken: 0,
    };
    let (plain, plain_mesh) = least(|| posed(Folds::Report).expect("nothing cancels it"));
    let (product, f) = least(|| {
        FoldFree::of(&field, &pose, plain_mesh.mesh(), &mut work, never).expect("reachable")
    });
    let f = f.expect("folds");
    let table = CoefficientTable::of_grid(&field, setup.grid(), never);
    let drawn = || f.mesh(setup.grid(), table.as_ref(), never);
    let (vertices, mesh) = least(|| drawn().expect("nothing cancels it"));
    let targets: Vec<(Point, Point)> = (p.iter().zip(&q))
        .flat_map(|(p, q)| targets(p, q))
        .collect();
    let (repair, mended) =
        least(|| untangle(&mesh, &targets, u32::MAX, never).expect("nothing cancels it"));
    let (whole, _) = least(|| posed(Folds::Remove).expect("nothing cancels it"));
    Parts {
        plain,
        product,
        vertices,
        repair,
        whole,
        factors: f.count(),
        mended: mended.mended,
        evaluations: mended.evaluations,
    }
}

/// The least seconds of some runs, and what the last one gave.
fn least<T>(mut work: impl FnMut() -> T) -> (f64, T) {
    let mut run = || {
        let start = Instant::now();
        let made = work();
        (start.elapsed().as_secs_f64(), made)
    };
    let (mut seconds, mut made) = run();
    for _ in 1..RUNS {
        let (again, other) = run();
        (seconds, made) = (seconds.min(again), other);
    }
    (seconds, made)
}

fn point(v: &Value) -> Point {
    Point::new(v[0].as_f64().expect("x"), v[1].as_f64().expect("y"))
}

fn handles(case: &Value, side: &str) -> Vec<Handle> {
    let of = |kind: &str| {
        case["handles"][kind]
            .as_array()
            .cloned()
            .unwrap_or_default()
    };
    let line = |line: &Value| {
        let places = line[side].as_array().expect("places").iter().map(point);
        Handle::Polyline(places.collect())
    };
    let points = of("points").into_iter();
    let points = points.map(|handle| Handle::Point(point(&handle[side])));
    points.chain(of("lines").iter().map(line)).collect()
}

/// Positions of a handle, and where they go: nine of each segment.
fn targets(p: &Handle, q: &Handle) -> Vec<(Point, Point)> {
    if let (Handle::Point(p), Handle::Point(q)) = (p, q) {
        return vec![(*p, *q)];
    }
    let segments = p.places().windows(2).zip(q.places().windows(2));
    let along = |(ab, cd): (&[Point], &[Point])| {
        let at = |k: u32| f64::from(k) / 8.0;
        let pair = |k| (ab[0].lerp(ab[1], at(k)), cd[0].lerp(cd[1], at(k)));
        (0..9).map(pair).collect::<Vec<_>>()
    };
    segments.flat_map(along).collect()
}
