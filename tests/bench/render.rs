//! Times the renderer, mesh to pixels: the astronaut scaled to three sizes, 8-bit RGBA and RGB, a smooth mesh of 100 x 100 vertices, each
//! level that the machine has, on 1 and 2 threads (rayon over bands); then the same with 1 % and 10 % of the cells folded. Median ms (ns a pixel)
//! of as many runs as fit half a second. `cargo bench --bench render [-- FILTER]`; a filter is a part of a row's name.

#![expect(clippy::print_stdout, reason = "the table is the result")]
#![expect(clippy::cast_possible_truncation, reason = "three known sizes")]

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use mlswarp::geometry::{Grid, Mesh, Vec2};
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

/// The rigid moving-least-squares mesh of eleven handles that are moved by 20 to 40 px (of 500), and farther until `folded` of the cells fold.
fn mesh(extent: Extent, folded: f64) -> Mesh {
    const REST: [[f64; 2]; 11] = [
        [0.2, 0.2],
        [0.8, 0.25],
        [0.5, 0.5],
        [0.25, 0.75],
        [0.75, 0.8],
        [0.5, 0.1],
        [0.1, 0.5],
        [0.9, 0.55],
        [0.5, 0.9],
        [0.35, 0.4],
        [0.65, 0.6],
    ];
    const MOVES: [[f64; 2]; 11] = [
        [0.05, 0.04],
        [-0.06, 0.03],
        [0.04, -0.06],
        [-0.05, -0.04],
        [0.05, 0.06],
        [0.0, 0.05],
        [0.06, 0.0],
        [-0.04, -0.03],
        [0.03, -0.05],
        [-0.04, 0.05],
        [0.05, 0.03],
    ];
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    let grid = Grid::with_counts(width, height, VERTICES, VERTICES);
    let place = |[x, y]: [f64; 2]| Vec2::new(x * width, y * height);
    let posed = |strength: f64| {
        let vertices = (0..VERTICES).flat_map(|j| (0..VERTICES).map(move |i| grid.vertex(i, j)));
        let displacement = vertices.map(|v| {
            let v = Vec2::new(v.x, v.y);
            let handles = REST.into_iter().zip(MOVES).map(|(p, d)| (place(p), place(p) + place(d) * strength));
            let weighed = handles.map(|(p, q)| (1.0 / ((p - v).norm2() + 1e-9), p, q));
            let (sum, p_star, q_star) =
                weighed.clone().fold((0.0, Vec2::ZERO, Vec2::ZERO), |(sum, a, b), (w, p, q)| (sum + w, a + p * w, b + q * w));
            let (p_star, q_star) = (p_star * (1.0 / sum), q_star * (1.0 / sum));
            let turn = weighed.fold(Vec2::ZERO, |turn, (w, p, q)| turn + (p - p_star).conj().complex_mul(q - q_star) * w);
            let posed = (v - p_star).complex_mul(turn) * (1.0 / turn.norm()) + q_star;
            [(posed.x - v.x) as f32, (posed.y - v.y) as f32]
        });
        Mesh::new(grid, displacement.collect())
    };
    let wanted = folded * f64::from((VERTICES - 1) * (VERTICES - 1));
    let mut strength = 1.0;
    loop {
        let mesh = posed(strength);
        if mesh.folded_cells().count() as f64 >= wanted {
            return mesh;
        }
        strength += 0.05;
    }
}
