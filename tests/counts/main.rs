//! One stage of a warp, run once where callgrind counts its instructions: `counts STAGE`.
//! Everything that the stage needs is prepared and the stage is run once before, uncounted, so that
//! tables made at first use and the dynamic linker are not in the figure. Without a stage it prints
//! their names and the level in use (`MLSWARP_LEVEL` lowers it). `tests/counts/run` starts it and
//! compares.
//!
//! `counts files FOLDER` writes the hostile files and the seeds of the fuzz target, and prints the
//! bytes and the claimed pixels of each; `counts decode FOLDER` decodes them in the order of their
//! names, each counted by itself.

#![allow(
    missing_docs,
    unreachable_pub,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::should_implement_trait,
    reason = "a program that is started by a script"
)]

#[allow(
    dead_code,
    clippy::unwrap_used,
    reason = "of a test, which uses the rest of it"
)]
#[path = "../it/support/bombs.rs"]
mod bombs;
#[path = "../bench/sets.rs"]
mod sets;

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mlswarp::codec::{self, Compression, ImageLimits, PixelLayout, PngWriter, StepCounter};
use mlswarp::deform::{CoefficientTable, Method};
use mlswarp::geometry::{Grid, Mesh};
use mlswarp::level::SimdLevel;
use mlswarp::pixmap::{Channels, Depth, Extent, Pixmap, Samples};
use mlswarp::render::{Filter, Outside, RenderOptions, Renderer, Source};

const SIDE: u32 = 500;
const VERTICES: u32 = 100;
const STAGES: [(&str, fn()); 5] = [
    ("deform", deform),
    ("plan", plan),
    ("plan-lines", plan_lines),
    ("render", render),
    ("png", png),
];

fn main() {
    let mut arguments = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with('-'));
    let (wanted, folder) = (arguments.next(), arguments.next());
    let Some(wanted) = wanted else {
        println!("level {}", SimdLevel::detect().name());
        STAGES.iter().for_each(|(name, _)| println!("{name}"));
        return;
    };
    match (wanted.as_str(), folder) {
        ("files", Some(folder)) => return files(Path::new(&folder)),
        ("decode", Some(folder)) => return decode(Path::new(&folder)),
        _ => {}
    }
    let stage = STAGES
        .iter()
        .find(|(name, _)| *name == wanted)
        .unwrap_or_else(|| panic!("no such stage: {wanted}"))
        .1;
    // One thread: what a stage splits is counted whole, and no second thread waits in a loop.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a pool of one thread");
    pool.install(stage);
}

fn listed(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = std::fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("a file").path())
        .collect();
    paths.sort();
    paths
}

fn files(folder: &Path) {
    let kept = |name: &str| {
        listed(
            &Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("../../tests/fuzz")
                .join(name)
                .join("image"),
        )
    };
    for path in kept("seeds").into_iter().chain(kept("found")) {
        std::fs::copy(&path, folder.join(path.file_name().expect("a file"))).expect("a copy");
    }
    let tables = std::fs::read(folder.join("webp-code-tables")).expect("a file that is kept");
    for (name, bytes, _) in bombs::all(&tables) {
        std::fs::write(folder.join(format!("bomb: {name}")), bytes).expect("a file");
    }
    let limits = ImageLimits::default();
    for path in listed(folder) {
        let bytes = std::fs::read(&path).expect("a file");
        let header = codec::probe(&bytes, &StepCounter::new(&|| false))
            .ok()
            .filter(|header| limits.check(header.extent).is_ok());
        let pixels = header.map_or(0, |header| header.extent.pixels());
        println!(
            "{}\t{pixels}\t{}",
            bytes.len(),
            path.file_name().expect("a file").to_string_lossy()
        );
    }
}

fn decode(folder: &Path) {
    // A damaged palette makes a decoder panic, which is caught; its message would be counted.
    std::panic::set_hook(Box::new(|_| {}));
    let files: Vec<_> = listed(folder)
        .into_iter()
        .map(|path| std::fs::read(path).expect("a file"))
        .collect();
    for bytes in files {
        counted_stage(&mut || {
            drop(black_box(codec::decode(
                black_box(&bytes),
                &ImageLimits::default(),
                &|| false,
            )))
        });
    }
}

fn measure(mut work: impl FnMut()) {
    work();
    counted_stage(&mut work);
}

/// Callgrind collects between entering and leaving this function; it is known by its name.
#[inline(never)]
fn counted_stage(work: &mut dyn FnMut()) {
    work();
    // Something after the call: a jump to `work` would never come back here.
    black_box(());
}

fn grid() -> Grid {
    Grid::with_counts(sets::SIDE, sets::SIDE, VERTICES, VERTICES)
}

/// 10,000 vertices posed by 7 points.
fn deform() {
    let (grid, (field, pose)) = (grid(), sets::point_field(7, Method::Rigid, 1.0));
    let plan = CoefficientTable::of_grid(&field, &grid, &|| false).expect("nothing cancels it");
    measure(|| {
        black_box(plan.pose(&grid, black_box(&pose), &|| false));
    });
}

/// The table of 10,000 vertices and 7 points.
fn plan() {
    let (grid, (field, _)) = (grid(), sets::point_field(7, Method::Rigid, 1.0));
    measure(|| {
        black_box(
            CoefficientTable::of_grid(black_box(&field), &grid, &|| false)
                .expect("nothing cancels it"),
        );
    });
}

/// The same of 7 segments, alpha 2.
fn plan_lines() {
    let (grid, (field, _)) = (grid(), sets::line_field(7, Method::Rigid, 2.0));
    measure(|| {
        black_box(
            CoefficientTable::of_grid(black_box(&field), &grid, &|| false)
                .expect("nothing cancels it"),
        );
    });
}

/// Mesh to pixels, 500 x 500 RGBA.
fn render() {
    let (source, mesh) = (source(), mesh());
    let mut samples = Vec::new();
    measure(|| {
        draw(&source, black_box(&mesh), &mut samples);
    });
}

/// The pixels of `render` to a file.
fn png() {
    let mut samples = Vec::new();
    let channels = draw(&source(), &mesh(), &mut samples);
    let shape = PixelLayout {
        extent: extent(),
        channels,
        grey: false,
        depth: Depth::Eight,
    };
    let row = SIDE as usize * channels.count();
    let mut file = Vec::with_capacity(2 * samples.len());
    measure(|| {
        file.clear();
        let writer = PngWriter::new(shape, Compression::Fast, None);
        file.extend_from_slice(&writer.head());
        let strip = |index: usize| {
            let rows = writer.rows(index);
            writer.strip_into(
                index,
                &samples[rows.start as usize * row..rows.end as usize * row],
                &mut file,
            )
        };
        let checksums: Vec<_> = (0..writer.strips()).map(strip).collect();
        file.extend_from_slice(&writer.tail(&checksums));
    });
}

fn extent() -> Extent {
    Extent::new(SIDE, SIDE).expect("not empty")
}

/// The astronaut, cropped, as RGBA.
fn source() -> Arc<Source> {
    let file = include_bytes!("../images/astronaut.png");
    let photograph = codec::decode(file, &ImageLimits::default(), &|| false)
        .expect("a whole file")
        .pixmap;
    let Samples::Eight(samples) = photograph.samples() else {
        panic!("the photograph has 8 bits")
    };
    let (channels, width) = (
        photograph.channels().count(),
        photograph.extent().width() as usize,
    );
    let row = |y: usize| &samples[y * width * channels..][..SIDE as usize * channels];
    let rgba = (0..SIDE as usize).flat_map(|y| {
        row(y)
            .chunks_exact(channels)
            .flat_map(|p| [p[0], p[1], p[2], 255])
    });
    Arc::new(Source::new(Pixmap::new(
        extent(),
        Channels::Rgba,
        Samples::Eight(rgba.collect()),
    )))
}

fn mesh() -> Mesh {
    let (grid, (field, pose)) = (grid(), sets::point_field(7, Method::Rigid, 1.0));
    CoefficientTable::of_grid(&field, &grid, &|| false)
        .expect("nothing cancels it")
        .pose(&grid, &pose, &|| false)
        .expect("nothing cancels it")
        .0
}

/// All rows in bands of 64.
fn draw(source: &Arc<Source>, mesh: &Mesh, samples: &mut Vec<u8>) -> Channels {
    let options = RenderOptions {
        target: extent(),
        canvas: None,
        filter: Filter::Bilinear,
        outside: Outside::Transparent,
        force_alpha: false,
    };
    let renderer = Renderer::new(Arc::clone(source), mesh, options);
    let row = SIDE as usize * renderer.channels().count();
    samples.resize(SIDE as usize * row, 0);
    for first in (0..SIDE).step_by(64) {
        let rows = first..SIDE.min(first + 64);
        let out = &mut samples[rows.start as usize * row..rows.end as usize * row];
        renderer.band(rows, out, &|| false);
    }
    renderer.channels()
}
