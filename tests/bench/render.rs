//! Times the renderer, mesh to pixels: the astronaut scaled to three sizes, 8-bit RGBA and RGB, a smooth mesh of 100 x 100 vertices, each
//! level that the machine has, on 1 and 2 threads (rayon over bands); then the same with 1 % and 10 % of the cells folded. Median ms (ns a pixel)
//! of as many runs as fit half a second. `cargo bench --bench render [-- FILTER]`; a filter is a part of a row's name.

#![expect(clippy::print_stdout, reason = "the table is the result")]
#![expect(clippy::cast_possible_truncation, reason = "three known sizes")]

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use mlswarp::geometry::{Grid, Mesh};
use mlswarp::level::Level;
use mlswarp::pixmap::{Channels, Depth, Extent, Pixmap, Samples};
use mlswarp::render::{Filter, Outside, RenderOptions, Renderer, Source};
use rayon::prelude::*;

const SIZES: [(u32, u32); 3] = [(500, 500), (1920, 1080), (3840, 2160)];
const VERTICES: u32 = 100;
const BUDGET: Duration = Duration::from_millis(500);

fn main() {
    let filter = std::env::args().skip(1).find(|argument| !argument.starts_with('-')).unwrap_or_default();
    println!("{:<44} {:>16} {:>16}", "render, mesh to pixels", "1 thread", "2 threads");
    for (width, height) in SIZES {
        let extent = Extent::new(width, height).expect("sizes are not zero");
        for channels in [Channels::Rgba, Channels::Rgb] {
            let source = Arc::new(Source::new(photograph(extent, channels)));
            for (folded, share) in [("", 0.0), (" 1 % folded", 0.01), (" 10 % folded", 0.1)] {
                let mesh = mesh(extent, share);
                for &level in Level::available() {
                    let name = format!("{width}x{height} {channels:?} {level:?}{folded}");
                    if name.contains(&filter) {
                        report(&name, &source, &mesh, extent, level);
                    }
                }
            }
        }
    }
}

fn report(name: &str, source: &Arc<Source>, mesh: &Mesh, extent: Extent, level: Level) {
    let mut out = vec![0; extent.pixels() as usize * 4];
    let columns = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started");
        let rows = extent.height() / if threads == 1 { 1 } else { 8 };
        let ms = pool.install(|| median(|| draw(source, mesh, extent, level, rows, &mut out)));
        format!("{ms:.3} ({:.2})", ms * 1e6 / extent.pixels() as f64)
    });
    println!("{name:<44} {:>16} {:>16}", columns[0], columns[1]);
}

fn draw(source: &Arc<Source>, mesh: &Mesh, extent: Extent, level: Level, rows: u32, out: &mut [u8]) {
    let options = RenderOptions { target: extent, filter: Filter::Bilinear, outside: Outside::Transparent };
    let renderer = Renderer::with_level(source.clone(), mesh, options, level);
    let row = extent.width() as usize * renderer.channels().count();
    let out = &mut out[..row * extent.height() as usize];
    if rows == extent.height() {
        return renderer.band(0..rows, out);
    }
    out.par_chunks_mut(row * rows as usize).enumerate().for_each(|(k, band)| {
        let first = k as u32 * rows;
        renderer.band(first..first + (band.len() / row) as u32, band);
    });
}

/// Milliseconds.
fn median(mut run: impl FnMut()) -> f64 {
    run();
    let (begin, mut times) = (Instant::now(), Vec::new());
    while times.len() < 5 || begin.elapsed() < BUDGET {
        let start = Instant::now();
        run();
        times.push(start.elapsed());
    }
    times.sort_unstable();
    times[times.len() / 2].as_secs_f64() * 1e3
}

/// The astronaut at a size, by the renderer itself.
fn photograph(extent: Extent, channels: Channels) -> Pixmap {
    let file = std::fs::File::open(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/images/astronaut.png")).expect("the photograph is there");
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
    let mut samples = vec![0; reader.output_buffer_size().expect("a small picture")];
    let info = reader.next_frame(&mut samples).expect("a whole picture");
    let whole = Pixmap::new(Extent::new(info.width, info.height).expect("not empty"), Channels::Rgb, Samples::Eight(samples));
    let grid = Grid::with_counts(f64::from(info.width), f64::from(info.height), 2, 2);
    let options = RenderOptions { target: extent, filter: Filter::Bilinear, outside: Outside::Edge };
    let renderer = Renderer::new(Arc::new(Source::new(whole)), &Mesh::identity(grid), options);
    assert_eq!((renderer.channels(), renderer.depth()), (Channels::Rgb, Depth::Eight), "a photograph");
    let mut samples = vec![0; extent.pixels() as usize * 3];
    renderer.band(0..extent.height(), &mut samples);
    if channels == Channels::Rgba {
        samples = samples.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], u8::MAX]).collect();
    }
    Pixmap::new(extent, channels, Samples::Eight(samples))
}

/// Seven places are pulled by 20 to 40 px (of 500), fading like a Gaussian; so much more at forty smaller places that `folded` of the cells fold.
fn mesh(extent: Extent, folded: f64) -> Mesh {
    const PULLS: [[f64; 5]; 7] = [
        [0.2, 0.2, 0.05, 0.04, 0.15],
        [0.8, 0.25, -0.06, 0.03, 0.15],
        [0.5, 0.5, 0.04, -0.06, 0.15],
        [0.25, 0.75, -0.05, -0.04, 0.15],
        [0.75, 0.8, 0.05, 0.06, 0.15],
        [0.5, 0.1, 0.0, 0.05, 0.15],
        [0.1, 0.5, 0.06, 0.0, 0.15],
    ];
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    let grid = Grid::with_counts(width, height, VERTICES, VERTICES);
    let mut noise = 1_u64;
    let mut random = || {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from((noise >> 40) as u32) / f64::from(1 << 24)
    };
    let jitter: Vec<[f64; 5]> = (0..40).map(|_| [random(), random(), random() - 0.5, random() - 0.5, 0.05]).collect();
    let pulled = |strength: f64| {
        let jitter = jitter.iter().map(|[x, y, dx, dy, size]| [*x, *y, dx * strength, dy * strength, *size]);
        let pulls: Vec<_> = PULLS.into_iter().chain(jitter).collect();
        let vertices = (0..VERTICES).flat_map(|j| (0..VERTICES).map(move |i| grid.vertex(i, j)));
        let displacement = vertices.map(|p| {
            let (x, y) = (p.x / width, p.y / height);
            let pull = pulls.iter().fold([0.0, 0.0], |sum, [px, py, dx, dy, size]| {
                let near = (-((x - px).powi(2) + (y - py).powi(2)) / (2.0 * size * size)).exp();
                [sum[0] + dx * near * width, sum[1] + dy * near * height]
            });
            pull.map(|d| d as f32)
        });
        Mesh::new(grid, displacement.collect())
    };
    let wanted = folded * f64::from((VERTICES - 1) * (VERTICES - 1));
    let mut strength = 0.0;
    loop {
        let mesh = pulled(strength);
        if mesh.folded_cells().count() as f64 >= wanted {
            return mesh;
        }
        strength += 0.01;
    }
}
