//! Table 1 of the paper (Schaefer, McPhail, Warren 2006) on the layouts of the gallery: q to the
//! posed grid of 100 x 100 vertices, one thread, beside what the paper printed for a processor of
//! 2006; and what is computed once for p. Also the methods and the metric that came later.

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    unused_qualifications,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::large_enum_variant,
    reason = "a program that prints a table"
)]

#[allow(dead_code, reason = "figures are drawn elsewhere")]
#[path = "../../src/engine/examples/gallery/main.rs"]
mod gallery;
#[path = "harness/mod.rs"]
mod harness;

use std::hint::black_box;
use std::path::Path;

use gallery::Picture;
use gallery::figures::{FIGURES, PaperFigure};
use harness::{Contender, Report, contender, medians, pool, time};
use mlswarp::deform::{
    CoefficientTable, Coincident, Handles, Method, Parameters, Pose, RestDeformation,
};
use mlswarp::geometry::Grid;
use mlswarp::warp::{CompiledRest, Folds, Limits, Metric, PosedMesh, ResolvedRest, RestSpec};

/// Vertices along each side, as in the paper.
const VERTICES: u32 = 100;
const ROUNDS: usize = 101;
const PLANS: usize = 11;
/// Milliseconds that the paper prints for figures 1, 4 and 5.
const PRINTED: [(Method, &str, [Option<f64>; 3]); 5] = [
    (Method::Affine, "affine", [Some(1.5), Some(2.2), Some(1.5)]),
    (
        Method::Similarity,
        "similarity",
        [Some(2.3), Some(3.4), Some(1.6)],
    ),
    (Method::Rigid, "rigid", [Some(2.6), Some(3.8), Some(3.3)]),
    (
        Method::ThinPlateSpline,
        "tps (Bookstein)",
        [Some(2.0), Some(2.7), None],
    ),
    (Method::BeierNeely, "beier_neely", [None, None, Some(1.6)]),
];

fn main() {
    // Inside the pool: no hand-over is timed, and no second thread is used.
    pool(1).install(table);
}

fn table() {
    let mut report = Report::new(
        "paper",
        "table 1 of the paper: 100 x 100 vertices, one thread",
    );
    let names = ["figure-1", "figure-4", "figure-5"];
    for (column, name) in names.into_iter().enumerate() {
        let figure = FIGURES.iter().find(|figure| figure.name == name);
        let figure = figure.expect("a figure of the gallery");
        let images = concat!(env!("CARGO_MANIFEST_DIR"), "/test_files/images");
        let picture = Picture::open(&Path::new(images).join(figure.image));
        of_figure(&mut report, figure, &picture.expect("a photograph"), column);
    }
}

/// What the paper has, and what it has not.
struct Posable {
    name: String,
    work: Work,
}

enum Work {
    Table(CoefficientTable, Pose),
    Mesh(ResolvedRest, CompiledRest, Pose),
}

impl Posable {
    fn pose(&self) {
        match &self.work {
            Work::Table(table, pose) => {
                black_box(table.displace(black_box(pose), &|| false));
            }
            Work::Mesh(setup, plan, pose) => {
                let posed =
                    PosedMesh::coarse(setup, plan, black_box(pose), Folds::Report, &|| false);
                black_box(posed.expect("nothing cancels it"));
            }
        }
    }
}

fn of_figure(report: &mut Report, figure: &PaperFigure, picture: &Picture, column: usize) {
    let extent = picture.image.extent();
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    let grid = Grid::with_counts(width, height, VERTICES, VERTICES);
    let (p, q) = (figure.rest.handles(), figure.posed.handles());
    let mut posable = Vec::new();
    let mut plans: Vec<(String, f64)> = Vec::new();
    for (method, name, printed) in PRINTED {
        let Some(printed) = printed[column] else {
            continue;
        };
        let build = || {
            let handles = Handles::new(p.clone(), None).expect("handles");
            let given = Parameters::default();
            RestDeformation::of(handles, Coincident::default(), method, &given, &|| false)
                .expect("handles of the method")
        };
        let field = build();
        let pose = field.pose(&q).expect("handles of the method");
        let plan =
            || CoefficientTable::of_grid(&build(), &grid, &|| false).expect("nothing cancels it");
        let once = medians(PLANS, &mut [contender("", || drop(black_box(plan())))])[0];
        plans.push((name.to_owned(), once));
        posable.push(Posable {
            name: format!("{name} (the paper: {printed:.1} ms)"),
            work: Work::Table(plan(), pose),
        });
    }
    let has_lines = p.iter().any(|handle| handle.places().len() > 1);
    let later = [
        (
            "rigid, geodesic, on its cut grid",
            Method::Rigid,
            Metric::Geodesic,
        ),
        (
            "arap, on its mesh",
            Method::AsRigidAsPossible,
            Metric::Euclidean,
        ),
    ];
    // An opaque photograph has no outline.
    for (name, method, metric) in later.into_iter().filter(|_| !has_lines) {
        let rest = RestSpec {
            p: p.clone(),
            method,
            metric,
            mask: Some(picture.mask.clone()),
            ..RestSpec::default()
        };
        let build = || {
            let setup = ResolvedRest::new(&rest, extent, &Limits::default(), &|| false);
            let setup = setup.expect("handles");
            let plan = setup.plan(&|| false).expect("nothing cancels it");
            (setup, plan)
        };
        let once = medians(3, &mut [contender("", || drop(black_box(build())))])[0];
        let (setup, plan) = build();
        let pose = setup.pose(&q).expect("handles");
        let posed = PosedMesh::coarse(&setup, &plan, &pose, Folds::Report, &|| false);
        let posed = posed.expect("nothing cancels it");
        let vertices = posed
            .mesh()
            .cut_mesh()
            .map_or(0, |cut| cut.displacement().len());
        plans.push((name.to_owned(), once));
        posable.push(Posable {
            name: format!("{name} of {vertices} vertices, with its report"),
            work: Work::Mesh(setup, plan, pose),
        });
    }
    let mut contenders: Vec<Contender<'_>> = posable
        .iter()
        .map(|posable| contender(posable.name.clone(), || posable.pose()))
        .collect();
    report.table(
        &format!("{}, {} handles: a pose", figure.title, p.len()),
        ROUNDS,
        &mut contenders,
    );
    let plans = plans
        .iter()
        .map(|(name, once)| format!("{name} {}", time(*once)));
    let plans: Vec<String> = plans.collect();
    report.line(&format!("Once for p: {}.\n", plans.join(", ")));
}
