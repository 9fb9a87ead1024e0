//! The tolerance of a grid: a picture whose samples are its own coordinates is warped, decoded, and compared with f at every pixel.

#![expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small numbers of the tests themselves")]

use std::sync::Arc;

use serde_json::Value;

use super::{Folds, GridSpec, Limits, Method, Posed, RestSpec, Setup, Warning};
use crate::deform::Handle;
use crate::geometry::{Point, Vec2};
use crate::pixmap::{Channels, Extent, Pixmap, Samples};
use crate::render::{Filter, Outside, RenderOptions, Renderer, Source};

/// The error of coordinates in 16 bits, of sampling between 1/128 px, and of snapping vertices, px.
const ENCODED: f64 = 1.0 / 64.0;
/// Within this of the picture's border samples repeat the outermost pixel, px.
const BORDER: f64 = 1.0;
/// The renderer guarantees its own accuracy where areas do not shrink by more.
const LEAST_AREA: f64 = 0.1;

fn extent(width: u32, height: u32) -> Extent {
    Extent::new(width, height).unwrap()
}

/// Red and green are x and y.
fn coordinates(extent: Extent) -> Arc<Source> {
    let code = |k: u32, of: u32| ((f64::from(k) + 0.5) / f64::from(of) * 65_535.0).round() as u16;
    let pixels = (0..extent.height()).flat_map(|y| (0..extent.width()).map(move |x| (x, y)));
    let samples = pixels.flat_map(|(x, y)| [code(x, extent.width()), code(y, extent.height()), 0]).collect();
    Arc::new(Source::new(Pixmap::new(extent, Channels::Rgb, Samples::Sixteen(samples))))
}

/// A set of handles and where they go.
#[derive(Clone, Debug)]
struct Case {
    name: String,
    extent: Extent,
    rest: RestSpec,
    q: Vec<Handle>,
}

/// How far a drawn picture is from f.
#[derive(Debug)]
struct Drawn {
    /// Pixels that were compared.
    compared: usize,
    /// Pixels that are farther than the tolerance: in all, and where the renderer guarantees its accuracy.
    over: usize,
    over_sound: usize,
    /// The pixel that is farthest over.
    worst: String,
    /// Uncovered pixels between two covered ones.
    cracks: usize,
    posed: Posed,
}

type PoseAs = fn(&Setup, &super::Plan, &crate::deform::Pose, Folds, crate::deform::IsCancelled<'_>) -> Result<Posed, super::WarpError>;

fn draw(case: &Case, tolerance: f64, pose_as: PoseAs) -> Drawn {
    let extent = case.extent;
    let rest = RestSpec { grid: GridSpec::Tolerance(tolerance), ..case.rest.clone() };
    let setup = Setup::new(&rest, extent, &Limits::default()).unwrap();
    let (plan, pose) = (setup.plan(), setup.pose(&case.q).unwrap());
    let posed = pose_as(&setup, &plan, &pose, Folds::Report, &|| false).unwrap();
    let options = RenderOptions { target: extent, canvas: None, filter: Filter::Bilinear, outside: Outside::Transparent };
    let renderer = Renderer::new(coordinates(extent), posed.mesh(), options);
    let (width, height, channels) = (extent.width() as usize, extent.height() as usize, renderer.channels().count());
    let mut out = vec![0; width * height * channels * 2];
    renderer.band(0..extent.height(), &mut out);
    let sample = |k: usize, c: usize| {
        let at = (k * channels + c) * 2;
        f64::from(u16::from_be_bytes([out[at], out[at + 1]])) / 65_535.0
    };
    let covered: Vec<bool> = (0..width * height).map(|k| channels == 3 || sample(k, 3) > 0.0).collect();
    let is_crack = |k: &usize| {
        let (x, y) = (k % width, k / width);
        let between = |a: usize, b: usize| covered[a] && covered[b];
        !covered[*k] && (x > 0 && x + 1 < width && between(k - 1, k + 1) || y > 0 && y + 1 < height && between(k - width, k + width))
    };
    let cracks = (0..width * height).filter(is_crack).count();
    let place = |k: usize| Point::new(sample(k, 0) * width as f64, sample(k, 1) * height as f64);
    let inside = |x: f64, of: usize| x > BORDER && x < of as f64 - BORDER;
    let is_decoded = |k: &usize| covered[*k] && inside(place(*k).x, width) && inside(place(*k).y, height);
    let shown: Vec<usize> = (0..width * height).filter(is_decoded).collect();
    // f and its derivatives.
    let step = 1e-3;
    let around = |k: &usize| [Vec2::ZERO, Vec2::new(step, 0.0), Vec2::new(0.0, step)].map(|offset| place(*k) + offset);
    let exact = setup.map(&pose, &shown.iter().flat_map(around).collect::<Vec<_>>(), &|| false).unwrap();
    let drawn_within = f64::from(posed.mesh().refinement().drawn_within());
    let (mut over, mut over_sound, mut compared, mut excess, mut worst) = (0, 0, 0, 0.0, String::new());
    for (&k, f) in shown.iter().zip(exact.chunks_exact(3)) {
        let (i, j, ..) = posed.mesh().grid().locate(place(k)).unwrap();
        if posed.exceeded_cells().contains(&(i, j)) {
            continue;
        }
        compared += 1;
        let target = Point::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
        let (fx, fy) = ((f[1] - f[0]) * (1.0 / step), (f[2] - f[0]) * (1.0 / step));
        let (sum, area) = (fx.norm2() + fy.norm2(), fx.cross(fy));
        // The larger singular value: the renderer's own accuracy is in px of the source.
        let stretch = (0.5 * (sum + (sum * sum - 4.0 * area * area).max(0.0).sqrt())).sqrt();
        let bound = tolerance - drawn_within + (drawn_within + ENCODED) * stretch.max(1.0);
        let error = f[0].distance(target);
        if error > bound {
            over += 1;
            over_sound += usize::from(area >= LEAST_AREA);
            if error - bound > excess {
                excess = error - bound;
                let (mesh, level) =
                    (posed.mesh().map(place(k)).unwrap(), posed.mesh().refinement().find(i, j).map(|cell| (cell.level, cell.edges)));
                worst = format!(
                    "{target:?} shows {:?}: {error:.3} > {bound:.3}, stretch {stretch:.2}, area {area:.3}, of the mesh {:.3}, {level:?}",
                    place(k),
                    mesh.distance(f[0])
                );
            }
        }
    }
    Drawn { compared, over, over_sound, worst, cracks, posed }
}

/// A generator of numbers in [-1, 1), the same on every run.
struct Noise(u64);

impl Noise {
    fn signed(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// `points` points, and `lines` polylines of three positions which do not cross, each moved by up to `reach` px along both axes.
fn random(points: usize, lines: usize, reach: f64, method: Method, alpha: f64, seed: u64) -> Case {
    let extent = extent(240, 200);
    let mut noise = Noise(seed * 977 + points as u64 * 31 + lines as u64);
    let mut p: Vec<Vec<Point>> =
        (0..points).map(|_| vec![Point::new(120.0 + 114.0 * noise.signed(), 100.0 + 95.0 * noise.signed())]).collect();
    for line in 0..lines {
        // A band of its own, from left to right.
        let (band, height) = (line as f64 + 0.5, 200.0 / lines as f64);
        let at = |k: u32, noise: &mut Noise| {
            Point::new(40.0 + 80.0 * f64::from(k) + 30.0 * noise.signed(), height * (band + 0.45 * noise.signed()))
        };
        p.push((0..3).map(|k| at(k, &mut noise)).collect());
    }
    let handle = |places: &Vec<Point>| if places.len() == 1 { Handle::Point(places[0]) } else { Handle::Polyline(places.clone()) };
    let mut moved = || Vec2::new(reach * noise.signed(), reach * noise.signed());
    let q: Vec<Vec<Point>> = p.iter().map(|places| places.iter().map(|p| *p + moved()).collect()).collect();
    let rest = RestSpec { p: p.iter().map(handle).collect(), method, alpha: Some(alpha), ..RestSpec::default() };
    let name = format!("{points} points, {lines} lines, {method:?}, alpha {alpha}, seed {seed}");
    Case { name, extent, rest, q: q.iter().map(handle).collect() }
}

const METHODS: [Method; 3] = [Method::Affine, Method::Similarity, Method::Rigid];

/// Each tenth of a hundred sets, all of them in a full run.
fn cases() -> Vec<Case> {
    let full = std::env::var_os("MLSWARP_TESTS_FULL").is_some();
    let kinds = [(7, 0, 25.0), (11, 0, 20.0), (40, 0, 6.0), (3, 2, 12.0), (0, 4, 12.0)];
    let sets = (0..100).map(|seed| {
        let (points, lines, reach) = kinds[seed % kinds.len()];
        let alpha = if lines > 0 { [1.5, 2.0, 3.0][seed / 5 % 3] } else { [0.75, 1.0, 1.5, 2.0, 3.0][seed / 5 % 5] };
        random(points, lines, reach, METHODS[seed / 7 % 3], alpha, seed as u64)
    });
    sets.enumerate().filter(|(seed, _)| full || seed % 9 == 0).map(|(_, case)| case).collect()
}

/// Sets of the independent reference on 500 x 500 px, at two fifths of the size. Not those with a crease at each line.
fn oracle() -> Vec<Case> {
    const SIZE: f64 = 0.4;
    let file: Value = serde_json::from_str(include_str!("../../../tests/oracle.json")).unwrap();
    let point = |v: &Value| Point::new(SIZE * v[0].as_f64().unwrap(), SIZE * v[1].as_f64().unwrap());
    let case = |case: &Value| {
        let method = METHODS[["affine", "similarity", "rigid"].iter().position(|name| *name == case["method"])?];
        let list = |kind: &str| case["handles"][kind].as_array().cloned().unwrap_or_default();
        let (points, lines, alpha) = (list("points"), list("lines"), case["alpha"].as_f64().unwrap());
        let side = |end: &str| -> Vec<Handle> {
            let segment = |h: &Value| Handle::Polyline(h[end].as_array().unwrap().iter().map(point).collect());
            points.iter().map(|h| Handle::Point(point(&h[end]))).chain(lines.iter().map(segment)).collect()
        };
        let (p, q) = (side("p"), side("q"));
        let far = p.iter().flat_map(Handle::places).fold(0.0_f64, |far, p| far.max(p.x).max(p.y));
        let point_mass = case["point_mass"].as_f64().map(|mass| SIZE * mass);
        let rest = RestSpec { p, method, alpha: Some(alpha), point_mass, ..RestSpec::default() };
        let is_usable = far <= 200.0 && (lines.is_empty() || alpha > 1.0);
        is_usable.then(|| Case { name: case["name"].to_string(), extent: extent(200, 200), rest, q })
    };
    file["cases"].as_array().unwrap().iter().filter_map(case).collect()
}

/// Draws the cases with a tolerance; returns what is wrong.
fn wrong(cases: &[Case], tolerance: f64) -> Vec<String> {
    let mut wrong = Vec::new();
    for case in cases {
        let drawn = draw(case, tolerance, Posed::new);
        let report = drawn.posed.report();
        assert_eq!(report.warnings.contains(&Warning::ToleranceExceeded), report.exceeded > 0);
        let residual = report.exceeded == 0 && report.residual > tolerance;
        if drawn.over_sound > 0 || drawn.over > drawn.compared / 10_000 || residual || report.folds == 0 && drawn.cracks > 0 {
            wrong.push(format!(
                "{} at {tolerance}: {} px of {} over, {} cracks, residual {}, {}",
                case.name, drawn.over, drawn.compared, drawn.cracks, report.residual, drawn.worst
            ));
        }
    }
    wrong
}

#[test]
fn a_drawn_picture_is_within_its_tolerance() {
    for tolerance in [1.0, 0.25, 0.1, 0.05] {
        let wrong = wrong(&cases(), tolerance);
        assert!(wrong.is_empty(), "{wrong:#?}");
    }
}

#[test]
fn reference_sets_are_drawn_within_their_tolerance() {
    let cases = oracle();
    assert!(cases.len() > 10, "{} cases are usable", cases.len());
    let wrong = wrong(&cases, 0.25);
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_undivided_grid_is_farther_than_the_tolerance() {
    let is_over = |case: &&Case| draw(case, 0.1, Posed::coarse).over_sound > 0;
    let cases = cases();
    let over = cases.iter().filter(is_over).count();
    assert!(over * 10 >= cases.len() * 9, "{over} of {}: the pictures above would pass without any refinement", cases.len());
}

#[test]
fn kept_rows_do_not_change_a_mesh() {
    let case = random(40, 0, 6.0, Method::Rigid, 2.0, 1);
    let posed = |limits: &Limits, warm: bool| {
        let setup = Setup::new(&case.rest, case.extent, limits).unwrap();
        let plan = setup.plan();
        let pose = |q: &[Handle]| Posed::new(&setup, &plan, &setup.pose(q).unwrap(), Folds::Report, &|| false).unwrap();
        if warm {
            // Another pose keeps other rows first.
            pose(&random(40, 0, 9.0, Method::Rigid, 2.0, 1).q);
        }
        (pose(&case.q), plan.bytes())
    };
    let limits = Limits::default();
    let (cold, bytes) = posed(&limits, false);
    assert!(!cold.mesh().refinement().is_empty());
    let tight = Limits { plan_bytes: bytes / 5, ..limits };
    let (unkept, unkept_bytes) = posed(&tight, false);
    assert_eq!(unkept_bytes, bytes / 5, "nothing is left for exact rows");
    for other in [posed(&limits, true).0, unkept] {
        assert_eq!(cold.mesh().refinement(), other.mesh().refinement());
        assert_eq!(cold.report(), other.report());
    }
}

#[test]
fn rest_handles_and_undefined_rotations() {
    let case = random(11, 0, 20.0, Method::Rigid, 1.0, 3);
    let at_rest = Case { q: case.rest.p.clone(), ..case.clone() };
    assert!(draw(&at_rest, 0.05, Posed::new).posed.mesh().refinement().is_empty());
    // Four points exchanged across the middle: the rotation is undefined there.
    let corner = |k: u32| Point::new(if k & 1 == 0 { 60.0 } else { 180.0 }, if k & 2 == 0 { 50.0 } else { 150.0 });
    let handles = |places: [u32; 4]| places.map(|k| Handle::Point(corner(k))).to_vec();
    let rest = RestSpec { p: handles([0, 1, 2, 3]), ..case.rest.clone() };
    let mirrored = Case { rest, q: handles([1, 0, 2, 3]), ..case };
    let drawn = draw(&mirrored, 0.25, Posed::new);
    assert!(drawn.posed.report().exceeded > 0, "{:?}", drawn.posed.report());
    assert!(drawn.posed.report().warnings.contains(&Warning::ToleranceExceeded));
}
