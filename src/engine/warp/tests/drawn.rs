//! A picture whose samples are its own coordinates is warped, decoded, and compared with f at every
//! pixel.

use std::sync::Arc;

use super::sets::Case;
use crate::deform::{IsCancelled, Pose};
use crate::geometry::{Point, Vec2};
use crate::pixmap::{Channels, Extent, Pixmap, Samples};
use crate::render::{Filter, Outside, RenderOptions, Renderer, Source};
use crate::warp::{
    CompiledRest, Folds, GridSpec, Limits, PosedMesh, ResolvedRest, RestSpec, WarpError,
};

/// The error of coordinates in 16 bits, of sampling between 1/128 px, and of snapping vertices, px
/// of the source.
const ENCODED: f64 = 1.0 / 64.0;
/// Within this of the picture's border samples repeat the outermost pixel, px.
const BORDER: f64 = 1.0;
/// Positions that are compared at once.
const AT_ONCE: usize = 4096;

/// How far a drawn picture is from f.
#[derive(Debug)]
pub(super) struct Drawn {
    /// Pixels that were compared: all that are drawn, but not those of cells that are reported to
    /// exceed the tolerance.
    pub(super) compared: usize,
    /// The largest distance from f, px.
    pub(super) error: f64,
    /// Pixels that are farther than the tolerance.
    pub(super) over: usize,
    /// The pixel that is farthest from f.
    pub(super) farthest: String,
    /// Uncovered pixels inside.
    pub(super) cracks: Vec<(usize, usize)>,
    pub(super) posed: PosedMesh,
}

pub(super) type PoseAs =
    fn(&ResolvedRest, &CompiledRest, &Pose, Folds, IsCancelled<'_>) -> Result<PosedMesh, WarpError>;

/// Red and green are x and y.
fn coordinates(extent: Extent) -> Arc<Source> {
    let code = |k: u32, of: u32| ((f64::from(k) + 0.5) / f64::from(of) * 65_535.0).round() as u16;
    let pixels = (0..extent.height()).flat_map(|y| (0..extent.width()).map(move |x| (x, y)));
    let samples = pixels
        .flat_map(|(x, y)| [code(x, extent.width()), code(y, extent.height()), 0])
        .collect();
    Arc::new(Source::new(Pixmap::new(
        extent,
        Channels::Rgb,
        Samples::Sixteen(samples),
    )))
}

/// The position of the source that every pixel of a drawn picture shows, if it is covered.
pub(super) fn shown(posed: &PosedMesh, extent: Extent) -> Vec<Option<Point>> {
    let options = RenderOptions {
        target: extent,
        canvas: None,
        filter: Filter::Bilinear,
        outside: Outside::Transparent,
        force_alpha: false,
    };
    let mut renderer = Renderer::new(coordinates(extent), posed.mesh(), options);
    // A mean over what a pixel shows is no position.
    renderer.sample_points();
    let (pixels, channels) = (
        extent.width() as usize * extent.height() as usize,
        renderer.channels().count(),
    );
    let mut out = vec![0; pixels * channels * 2];
    renderer.band(0..extent.height(), &mut out, &|| false);
    let pixel = |samples: &[u8]| {
        let sample = |c: usize| {
            f64::from(u16::from_be_bytes([samples[2 * c], samples[2 * c + 1]])) / 65_535.0
        };
        let is_covered = channels == 3 || sample(3) > 0.0;
        is_covered.then(|| {
            Point::new(
                sample(0) * f64::from(extent.width()),
                sample(1) * f64::from(extent.height()),
            )
        })
    };
    out.chunks_exact(2 * channels).map(pixel).collect()
}

/// Uncovered pixels that are not connected to the border of the picture.
fn cracks(shown: &[Option<Point>], width: usize) -> Vec<(usize, usize)> {
    let height = shown.len() / width;
    let mut is_known: Vec<bool> = shown.iter().map(Option::is_some).collect();
    let is_border = |k: usize| {
        let (x, y) = (k % width, k / width);
        x == 0 || y == 0 || x + 1 == width || y + 1 == height
    };
    let mut open: Vec<usize> = (0..shown.len()).filter(|&k| is_border(k)).collect();
    while let Some(k) = open.pop() {
        if std::mem::replace(&mut is_known[k], true) {
            continue;
        }
        let (x, y) = (k % width, k / width);
        let beside = [
            (x > 0).then(|| k - 1),
            (x + 1 < width).then(|| k + 1),
            (y > 0).then(|| k - width),
            (y + 1 < height).then(|| k + width),
        ];
        open.extend(beside.into_iter().flatten());
    }
    (0..shown.len())
        .filter(|&k| !is_known[k])
        .map(|k| (k % width, k / width))
        .collect()
}

/// Draws a case with a tolerance. Of the pixels, one in `each` is compared.
pub(super) fn draw(case: &Case, tolerance: f64, each: usize, pose_as: PoseAs) -> Drawn {
    let extent = case.extent;
    let rest = RestSpec {
        grid: GridSpec::Tolerance(tolerance),
        ..case.rest.clone()
    };
    let setup = ResolvedRest::new(&rest, extent, &Limits::default(), &|| false).unwrap();
    let (plan, pose) = (setup.plan(&|| false).unwrap(), setup.pose(&case.q).unwrap());
    let posed = pose_as(&setup, &plan, &pose, Folds::Report, &|| false).unwrap();
    let width = extent.width() as usize;
    let shown = shown(&posed, extent);
    let cracks = cracks(&shown, width);
    let inside = |c: f64, of: u32| c > BORDER && c < f64::from(of) - BORDER;
    let is_inside = |p: &Point| inside(p.x, extent.width()) && inside(p.y, extent.height());
    let exceeded: std::collections::HashSet<_> = posed.exceeded_cells().iter().copied().collect();
    let grid = *posed.mesh().grid();
    let cell = |p: Point| grid.locate(p).map(|(i, j, ..)| (i, j)).unwrap();
    let places: Vec<(usize, Point)> = (0..shown.len())
        .step_by(each)
        .filter_map(|k| Some((k, shown[k].filter(is_inside)?)))
        .filter(|(_, p)| exceeded.is_empty() || !exceeded.contains(&cell(*p)))
        .collect();
    let mut drawn = Drawn {
        compared: places.len(),
        error: 0.0,
        over: 0,
        farthest: String::new(),
        cracks,
        posed,
    };
    let f = setup.transform(&pose);
    let map = |places: &[Point]| {
        f.map(places, &|| false)
            .unwrap()
            .into_iter()
            .map(|place| place.expect("f"))
            .collect::<Vec<_>>()
    };
    // The larger singular value of the derivatives.
    let stretch = |p: Point| {
        const STEP: f64 = 1e-3;
        let around = map(&[p, p + Vec2::new(STEP, 0.0), p + Vec2::new(0.0, STEP)]);
        let [fx, fy] = [1, 2].map(|k| (around[k] - around[0]) * (1.0 / STEP));
        let (sum, area) = (fx.norm2() + fy.norm2(), fx.cross(fy));
        (0.5 * (sum + (sum * sum - 4.0 * area * area).max(0.0).sqrt())).sqrt()
    };
    for places in places.chunks(AT_ONCE) {
        let f = map(&places.iter().map(|(_, p)| *p).collect::<Vec<_>>());
        for (&(k, p), f) in places.iter().zip(f) {
            let target = Point::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5);
            let error = f.distance(target);
            drawn.over += usize::from(
                error > tolerance + ENCODED && error > tolerance + ENCODED * stretch(p),
            );
            if error > drawn.error {
                drawn.error = error;
                let (i, j) = cell(p);
                let subdivided = drawn
                    .posed
                    .mesh()
                    .subdivision()
                    .find(i, j)
                    .map(|cell| (cell.level, cell.edges));
                let of_mesh = drawn.posed.mesh().map(p).unwrap().distance(f);
                drawn.farthest = format!(
                    "{target:?} shows {p:?}, of the mesh {of_mesh:.3}, cell ({i}, {j}) \
                     {subdivided:?}"
                );
            }
        }
    }
    drawn
}
