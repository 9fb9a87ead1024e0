//! Building the A_j table of 10,000 vertices, beside what a crate without a plan takes to deform
//! the same vertices once; and what handles inside an outline take, with their distances.

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::should_implement_trait,
    reason = "a program that prints a table"
)]

#[allow(dead_code, reason = "figures are drawn elsewhere")]
#[path = "../../src/engine/examples/gallery/main.rs"]
mod gallery;
#[path = "harness/mod.rs"]
mod harness;
mod sets;

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use gallery::Picture;
use gallery::figures::{FIGURES, PaperFigure};
use harness::{Goal, Report, contender, inside, pool};
use mlswarp::deform::{CoefficientTable, Handle, Method, Parameters, factorisation};
use mlswarp::geometry::{Grid, Point};
use mlswarp::pixmap::Extent;
use mlswarp::topology::{Mask, Membership};
use mlswarp::warp::{
    CompiledRest, Folds, GridSpec, Limits, Metric, PosedMesh, ResolvedRest, RestMask, RestSpec,
};

fn main() {
    let mut report = Report::new(
        "plan",
        "the A_j of 10,000 vertices (100 x 100 over 500 x 500 px), rigid",
    );
    let grid = Grid::with_counts(sets::SIDE, sets::SIDE, 100, 100);
    let (one, two) = (pool(1), pool(2));
    let (p, q) = sets::points(7);
    let single = |list: &[Point]| {
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
    if harness::wanted("plan") {
        report.table("plan", 15, &mut contenders);
    }
    inside_an_outline(&mut report);
    as_rigid_as_possible(&mut report);
}

/// A figure of the gallery, and its photograph.
fn figure(name: &str) -> (&'static PaperFigure, Picture) {
    let figure = FIGURES.iter().find(|figure| figure.name == name);
    let figure = figure.expect("a figure of the gallery");
    let images = concat!(env!("CARGO_MANIFEST_DIR"), "/test_files/images");
    let picture = Picture::open(&Path::new(images).join(figure.image)).expect("a photograph");
    (figure, picture)
}

/// What is computed once for handles at rest.
fn compiled(rest: &RestSpec, extent: Extent) -> (ResolvedRest, CompiledRest) {
    let limits = Limits::default();
    let setup = ResolvedRest::new(rest, extent, &limits, &|| false).expect("handles");
    let plan = setup.plan(&|| false).expect("nothing cancels it");
    (setup, plan)
}

/// The mesh of the horse in pieces of 8 px, and those of whole pictures of 400 x 200 and 500 x 500
/// px in pieces of 5, with 11 handles each: once for handles at rest, of which the vertices are
/// ordered and two matrices factorised, and a pose.
fn as_rigid_as_possible(report: &mut Report) {
    let (figure, picture) = figure("figure-4");
    let all = |_, row: &mut [Membership]| row.fill(Membership::Inside);
    let whole = |width: u32, height: u32| RestMask {
        mask: Arc::new(Mask::new(width, height, all, &|| false).expect("nothing cancels it")),
        digest: picture.mask.digest,
    };
    let points = |width: u32, height: u32| {
        let share = [width, height].map(|side| f64::from(side) / sets::SIDE);
        let inside = |at: Point| Handle::Point(Point::new(at.x * share[0], at.y * share[1]));
        let (p, q) = sets::points(11);
        let [p, q] = [p, q].map(|places| places.into_iter().map(inside).collect::<Vec<_>>());
        (p, q)
    };
    let horse = (figure.rest.handles(), figure.posed.handles());
    let (wide, square) = (whole(400, 200), whole(500, 500));
    // Of the horse, whose mesh has several parts, a bar for a pose alone was named.
    let (of_wide, of_square) = (Some((10.0, 5.0)), Some((50.0, 20.0)));
    let scenes = [
        ("the horse", picture.mask.clone(), horse, 8, 0.35, None),
        ("a wide picture", wide, points(400, 200), 5, 0.35, of_wide),
        (
            "a whole picture",
            square,
            points(500, 500),
            5,
            1.3,
            of_square,
        ),
    ];
    for (name, mask, (p, q), cell, of_pose, bars) in scenes {
        let held: Vec<Point> = p.iter().flat_map(Handle::places).copied().collect();
        let factorise = factorisation(&mask.mask, cell, &held);
        let (width, height) = mask.mask.size();
        let extent = Extent::new(width as u32, height as u32).expect("a size");
        let rest = RestSpec {
            p,
            method: Method::AsRigidAsPossible,
            own: Parameters::default().with("arap/cell", f64::from(cell)),
            mask: Some(mask),
            ..RestSpec::default()
        };
        let build = || compiled(&rest, extent);
        let (setup, plan) = build();
        let pose = setup.pose(&q).expect("handles of the method");
        let posed = || {
            let (pose, folds) = (black_box(&pose), Folds::Report);
            PosedMesh::coarse(&setup, &plan, pose, folds, &|| false).expect("nothing cancels it")
        };
        let vertices = posed()
            .mesh()
            .cut_mesh()
            .map_or(0, |cut| cut.displacement().len());
        let title = format!("as rigid as possible, {name}, {vertices} vertices");
        if !harness::wanted(&title) {
            continue;
        }
        let (one, shown) = (pool(1), posed());
        let folds = || {
            black_box(shown.mesh().folding(&|| false));
        };
        let mut contenders = vec![
            inside(&one, "a pose".to_owned(), || drop(black_box(posed()))),
            inside(&one, "its report: folded cells".to_owned(), folds),
            inside(&one, "once for p".to_owned(), || drop(black_box(build()))),
        ];
        if let Some(factorise) = factorise {
            let name = "of it, order and two factors".to_owned();
            contenders.push(inside(&one, name, factorise));
        }
        let times = report.table(&title, 25, &mut contenders);
        let pose = 1e3 * (times[0] - times[1]);
        report.goal("a pose without its report, ms", pose, Goal::AtMost(of_pose));
        if let Some((of_rest, of_factors)) = bars {
            report.goal("once for p, ms", 1e3 * times[2], Goal::AtMost(of_rest));
            let (what, time) = ("of it, order and two factors, ms", 1e3 * times[3]);
            report.goal(what, time, Goal::AtMost(of_factors));
        }
    }
}

/// The horse of the gallery, in cells of 4 px.
fn inside_an_outline(report: &mut Report) {
    let (figure, picture) = figure("hoof");
    let extent = picture.image.extent();
    let rest = RestSpec {
        p: figure.rest.handles(),
        method: Method::Rigid,
        metric: Metric::Geodesic,
        mask: Some(picture.mask.clone()),
        grid: GridSpec::Cell(4.0),
        ..RestSpec::default()
    };
    let build = || compiled(&rest, extent);
    let mask = &picture.mask.mask;
    let (one, two) = (pool(1), pool(2));
    let of_threads = |threads: &str| {
        format!(
            "the outline of the horse, {} handles, {} of its pixels, {threads}",
            rest.p.len(),
            mask.inside(),
        )
    };
    let mut contenders = [
        inside(&one, of_threads("1 thread"), || drop(black_box(build()))),
        inside(&two, of_threads("2 threads"), || drop(black_box(build()))),
    ];
    let title = "geodesic plan of about 12,000 vertices";
    if harness::wanted(title) {
        let times = report.table(title, 9, &mut contenders);
        report.goal("1 thread, s", times[0], Goal::AtMost(0.6));
        report.goal("2 threads, s", times[1], Goal::AtMost(0.3));
    }
}
