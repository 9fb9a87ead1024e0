//! Long work asks at least every 10 ms whether it is still needed. Each kind of work, at the limits of a request, is measured in processor time of its
//! own thread from one question to the next; the figures are printed (`--nocapture`).

use std::cell::Cell;
use std::time::Duration;

use mlswarp::codec::{self, Encoding, StepCounter};
use mlswarp::deform::{Handle, IsCancelled};
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Candidate, CompactLattice, CoordinateMap, Edges, Fit, Folds, GridSpec, Limits, MapSpec, Method, Outline, OutputSpec, Posed, Quality, RestSpec,
    Setup, Table, choose,
};
use rustix::time::{ClockId, clock_gettime};

fn processor_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

thread_local! {
    static LAST: Cell<Duration> = const { Cell::new(Duration::ZERO) };
    static LONGEST: Cell<Duration> = const { Cell::new(Duration::ZERO) };
    static ASKED: Cell<u64> = const { Cell::new(0) };
}

fn asked() -> bool {
    let now = processor_time();
    LONGEST.set(LONGEST.get().max(now - LAST.replace(now)));
    ASKED.set(ASKED.get() + 1);
    false
}

const NEVER: IsCancelled<'static> = &|| false;

/// The longest processor time without a question.
fn measure(name: &str, work: impl FnOnce(IsCancelled<'_>) + Send) -> Duration {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    one.install(|| {
        let began = processor_time();
        LAST.set(began);
        LONGEST.set(Duration::ZERO);
        ASKED.set(0);
        work(&asked);
        asked();
        let (took, longest) = (processor_time() - began, LONGEST.get());
        eprintln!("{name}: {:.0} ms, asked {} times, longest without a question {:.1} ms", took.as_secs_f64() * 1e3, ASKED.get(), longest.as_secs_f64() * 1e3);
        longest
    })
}

fn noise(k: u32) -> f64 {
    f64::from(k.wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 24)
}

fn points(count: u32, (width, height): (f64, f64), seed: u32) -> Vec<Handle> {
    (0..count).map(|k| Handle::Point(Point::new(width * noise(4 * k + seed), height * noise(4 * k + seed + 1)))).collect()
}

fn lines(count: u32, (width, height): (f64, f64), seed: u32) -> Vec<Handle> {
    let place = |k: u32| Point::new(width * noise(4 * k + seed), height * noise(4 * k + seed + 1));
    let line = |k: u32| {
        let a = place(k);
        Handle::Polyline(vec![a, Point::new(a.x + 1.0 + noise(k), a.y + noise(k + 99))])
    };
    (0..count).map(line).collect()
}

fn moved(p: &[Handle]) -> Vec<Handle> {
    let place = |(k, p): (u32, &Point)| Point::new(p.x + 9.0 * noise(k + 7) - 3.0, p.y + 9.0 * noise(k + 77) - 5.0);
    p.iter()
        .zip(0_u32..)
        .map(|(handle, k)| match handle {
            Handle::Point(p) => Handle::Point(place((k, p))),
            Handle::Polyline(places) => Handle::Polyline(places.iter().map(|p| place((k, p))).collect()),
        })
        .collect()
}

fn scratch_works() {
    let extent = Extent::new(3000, 3000).unwrap();
    let size = (3000.0, 3000.0);
    let limits = Limits::default();
    let many = RestSpec { p: points(10_000, size, 0), alpha: Some(1.0), ..RestSpec::default() };
    let slow = RestSpec { p: lines(5_000, size, 0), alpha: Some(1.4997), ..RestSpec::default() };
    let spline = RestSpec { p: points(2_000, size, 0), method: Method::ThinPlateSpline, ..RestSpec::default() };
    let few = RestSpec { p: points(8, size, 0), ..RestSpec::default() };
    for (name, rest) in [("points", &many), ("lines", &slow), ("spline", &spline)] {
        measure(&format!("setup {name}"), |cancelled| drop(Setup::new_unless(rest, extent, &limits, cancelled).unwrap()));
        let rest = RestSpec { grid: GridSpec::Counts { columns: 20, rows: 20 }, ..rest.clone() };
        let setup = Setup::new_unless(&rest, extent, &limits, NEVER).unwrap();
        let q = moved(&rest.p);
        let pose = setup.pose(&q).unwrap();
        measure(&format!("plan {name}"), |cancelled| drop(setup.plan_unless(cancelled).unwrap()));
        let plan = setup.plan_unless(NEVER).unwrap();
        measure(&format!("pose {name}"), |cancelled| drop(Posed::coarse(&setup, &plan, &pose, Folds::Report, cancelled).unwrap()));
        let places: Vec<Point> = points(500, size, 3).iter().map(|h| h.places()[0]).collect();
        measure(&format!("positions {name}"), |cancelled| drop(setup.transform(&pose).map(&places, cancelled).unwrap()));
        let outline = [Outline { places: &places[..20], edges: Edges::Closed }];
        measure(&format!("outlines {name}"), |cancelled| drop(setup.transform(&pose).map_outlines(&outline, Some(0.1), cancelled)));
        let to_invert = setup.to_invert(&limits).unwrap();
        let coarse = Setup::new_unless(&RestSpec { grid: GridSpec::Counts { columns: 40, rows: 40 }, ..rest.clone() }, extent, &limits, NEVER).unwrap();
        let posed = Posed::coarse(&coarse, &coarse.plan_unless(NEVER).unwrap(), &pose, Folds::Report, NEVER).unwrap();
        let _ = to_invert;
        measure(&format!("inverse {name}"), |cancelled| drop(coarse.inverse(&pose, posed.mesh()).map(&places, cancelled).unwrap()));
    }
    let tolerant = RestSpec { grid: GridSpec::Tolerance(0.1), ..many.clone() };
    let setup = Setup::new_unless(&tolerant, Extent::new(1000, 1000).unwrap(), &limits, NEVER).unwrap();
    let plan = setup.plan_unless(NEVER).unwrap();
    let pose = setup.pose(&moved(&tolerant.p)).unwrap();
    measure("refined points", |cancelled| drop(Posed::new(&setup, &plan, &pose, Folds::Report, cancelled).unwrap()));
    // Large grids.
    let pixel = RestSpec { grid: GridSpec::Pixel, ..few.clone() };
    let setup = Setup::new_unless(&pixel, extent, &limits, NEVER).unwrap();
    measure("plan of a large grid", |cancelled| drop(setup.plan_unless(cancelled).unwrap()));
    let plan = setup.plan_unless(NEVER).unwrap();
    let q = moved(&pixel.p);
    let pose = setup.pose(&q).unwrap();
    measure("pose of a large grid", |cancelled| drop(Posed::new(&setup, &plan, &pose, Folds::Report, cancelled).unwrap()));
    let posed = Posed::new(&setup, &plan, &pose, Folds::Report, NEVER).unwrap();
    measure("quality of a large grid", |cancelled| {
        let canvas = mlswarp::render::Canvas::of(extent);
        drop(Quality::of(&setup, &q, &pose, &posed, &posed, Some(canvas), cancelled));
    });
    measure("numbers of a large grid", |cancelled| drop(posed.numbers(cancelled)));
    measure("compact lattice of a large grid", |cancelled| {
        let lattice = CompactLattice::new(&setup, &plan, 0.5, cancelled).unwrap();
        drop(lattice.numbers(&posed, cancelled).unwrap());
    });
    let spec = MapSpec::default();
    measure("map of a large grid", |cancelled| {
        let target = spec.target(&posed, extent, &limits).unwrap();
        cancelled();
        let map = CoordinateMap::new(&spec, &posed, target).unwrap();
        cancelled();
        for band in 0..map.bands().min(20) {
            drop(map.band(band));
            cancelled();
        }
    });
    measure("bounds of a large grid", |_| drop(posed.bounds()));
    // Fits.
    let q = moved(&spline.p);
    let points_only = RestSpec { p: spline.p.clone(), ..RestSpec::default() };
    let fit = Fit::new(&points_only, &q, extent, 2000, NEVER).unwrap();
    for candidate in [
        Candidate { method: Method::Rigid, alpha: Some(1.3), smoothing: None },
        Candidate { method: Method::ThinPlateSpline, alpha: None, smoothing: Some(0.1) },
    ] {
        measure(&format!("fit of {:?}", candidate.method), |cancelled| drop(fit.predict(candidate, cancelled).unwrap()));
    }
}

#[test]
fn scratch() {
    scratch_works();
}
