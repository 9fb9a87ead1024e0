//! The tolerance of a grid: a picture whose samples are its own coordinates is warped, decoded, and compared with f at every pixel.

use std::sync::Arc;

use super::{Folds, GridSpec, Limits, Posed, RestSpec, Setup};
use crate::deform::{Handle, Method};
use crate::geometry::{Point, Vec2};
use crate::pixmap::{Channels, Extent, Pixmap, Samples};
use crate::render::{Filter, Outside, RenderOptions, Renderer, Source};

/// 16 bits for the coordinates of a picture: the error of rounding them, and of sampling between 1/128 px, px.
const ENCODED: f64 = 1.0 / 64.0;
/// Within this of the picture's border samples repeat the outermost pixel, px.
const BORDER: f64 = 1.0;

/// Red and green are x and y.
fn coordinates(extent: Extent) -> Arc<Source> {
    let code = |k: u32, of: u32| ((f64::from(k) + 0.5) / f64::from(of) * 65_535.0).round() as u16;
    let pixels = (0..extent.height()).flat_map(|y| (0..extent.width()).map(move |x| (x, y)));
    let samples = pixels.flat_map(|(x, y)| [code(x, extent.width()), code(y, extent.height()), 0]).collect();
    Arc::new(Source::new(Pixmap::new(extent, Channels::Rgb, Samples::Sixteen(samples))))
}

/// What a drawn picture is off from f.
#[derive(Debug)]
struct Drawn {
    /// The largest distance, px, and where.
    worst: (f64, Point),
    /// Pixels farther than the tolerance.
    over: usize,
    /// Pixels that were compared.
    compared: usize,
    posed: Posed,
}

fn draw(source: &Arc<Source>, rest: &RestSpec, q: &[Handle], tolerance: f64, coarse: bool) -> Drawn {
    let extent = source.pixmap().extent();
    let setup = Setup::new(rest, extent, &Limits::default()).unwrap();
    let (plan, pose) = (setup.plan(), setup.pose(q).unwrap());
    let pose_as = if coarse { Posed::coarse } else { Posed::new };
    let posed = pose_as(&setup, &plan, &pose, Folds::Report, &|| false).unwrap();
    let options = RenderOptions { target: extent, filter: Filter::Bilinear, outside: Outside::Transparent };
    let renderer = Renderer::new(Arc::clone(source), posed.mesh(), options);
    let (width, channels) = (extent.width() as usize, renderer.channels().count());
    let mut out = vec![0; extent.pixels() as usize * channels * 2];
    renderer.band(0..extent.height(), &mut out);
    let (mut shown, mut targets) = (Vec::new(), Vec::new());
    for (k, pixel) in out.chunks_exact(2 * channels).enumerate() {
        let sample = |c: usize| f64::from(u16::from_be_bytes([pixel[2 * c], pixel[2 * c + 1]]));
        if channels == 4 && sample(3) == 0.0 {
            continue;
        }
        let decoded = |c: usize, of: u32| sample(c) / 65_535.0 * f64::from(of);
        let place = Point::new(decoded(0, extent.width()), decoded(1, extent.height()));
        let inside = |x: f64, of: u32| x > BORDER && x < f64::from(of) - BORDER;
        if inside(place.x, extent.width()) && inside(place.y, extent.height()) {
            shown.push(place);
            targets.push(Point::new((k % width) as f64 + 0.5, (k / width) as f64 + 0.5));
        }
    }
    let exact = setup.map(&pose, &shown, &|| false).unwrap();
    let errors = exact.iter().zip(&targets).map(|(f, target)| (f.distance(*target), *target));
    let over = errors.clone().filter(|(error, _)| *error > tolerance + ENCODED).count();
    let worst = errors.fold((0.0, Point::new(0.0, 0.0)), |worst, error| if error.0 > worst.0 { error } else { worst });
    Drawn { worst, over, compared: shown.len(), posed }
}

/// A generator of numbers in [-1, 1), the same on every run.
struct Noise(u64);

impl Noise {
    fn signed(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

fn random(n: u64, extent: Extent, reach: f64, seed: u64) -> (Vec<Handle>, Vec<Handle>) {
    let mut noise = Noise(seed * 977 + n);
    let centre = Point::new(f64::from(extent.width()) / 2.0, f64::from(extent.height()) / 2.0);
    let place = |noise: &mut Noise| centre + Vec2::new(0.95 * centre.x * noise.signed(), 0.95 * centre.y * noise.signed());
    let p: Vec<Point> = (0..n).map(|_| place(&mut noise)).collect();
    let q = p.iter().map(|p| Handle::Point(*p + Vec2::new(reach * noise.signed(), reach * noise.signed()))).collect();
    (p.into_iter().map(Handle::Point).collect(), q)
}

#[test]
fn the_drawn_picture_is_within_the_tolerance() {
    let extent = Extent::new(240, 200).unwrap();
    let source = coordinates(extent);
    for (n, reach, seeds) in [(7, 25.0, 4), (11, 20.0, 3), (40, 6.0, 3)] {
        for method in [Method::Affine, Method::Similarity, Method::Rigid] {
            for alpha in [0.75, 1.0, 1.5, 2.0, 3.0] {
                for seed in 0..seeds {
                    let (p, q) = random(n, extent, reach, seed);
                    for (grid, tolerance) in [(GridSpec::Tolerance(0.5), 0.5), (GridSpec::Auto, 0.25), (GridSpec::Tolerance(0.1), 0.1)] {
                        let rest = RestSpec { p: p.clone(), method, alpha: Some(alpha), grid, ..RestSpec::default() };
                        let coarse = std::env::var("COARSE").is_ok();
                        let drawn = draw(&source, &rest, &q, tolerance, coarse);
                        let cells = drawn.posed.mesh().refinement().cells().len();
                        let report = drawn.posed.report();
                        if drawn.over > 0 {
                        println!(
                            "{n} {method:?} {alpha} {seed} {tolerance}: worst {:.3} at {:?}, over {} of {}, {cells} cells, residual {:.3}, exceeded {}, folds {}",
                            drawn.worst.0, drawn.worst.1, drawn.over, drawn.compared, report.residual, report.exceeded, report.folds
                        );
                        }
                    }
                }
            }
        }
    }
}
