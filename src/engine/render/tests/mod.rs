//! Tests of the renderer: properties of every mesh, small pictures, and a photograph against a slow
//! reference.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "small numbers of the tests themselves"
)]

mod area;
mod canvases;
mod coverage;
mod cut;
mod extremes;
mod inverse;
mod order;
mod photograph;
mod pictures;
mod reference;
mod sampling;

use std::sync::Arc;

use crate::level::SimdLevel;

use super::{Filter, Outside, RenderOptions, Renderer, Source};
use crate::geometry::{Grid, Mesh, Point, Vec2};
use crate::pixmap::{Channels, Depth, Extent, Pixmap, Samples};

fn extent(width: u32, height: u32) -> Extent {
    Extent::new(width, height).unwrap()
}

/// Options for a target, bilinear on transparent.
fn options(target: Extent) -> RenderOptions {
    RenderOptions {
        target,
        canvas: None,
        filter: Filter::Bilinear,
        outside: Outside::Transparent,
        force_alpha: false,
    }
}

/// A generator of numbers in [0, 2^32), the same on every run.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 32) as u32
    }

    /// In [-1, 1).
    fn signed(&mut self) -> f64 {
        f64::from(self.next()) / f64::from(1_u32 << 31) - 1.0
    }
}

/// A picture of noise with alpha; every seventh pixel is transparent and every fifth opaque.
fn noise(extent: Extent, channels: Channels, depth: Depth) -> Pixmap {
    let mut noise = Noise(17);
    let mut samples: Vec<u16> = (0..extent.pixels() * channels.count() as u64)
        .map(|_| (noise.next() >> 16) as u16)
        .collect();
    if channels == Channels::Rgba {
        for (k, pixel) in samples.chunks_exact_mut(4).enumerate() {
            pixel[3] = if k % 7 == 0 {
                0
            } else if k % 5 == 0 {
                u16::MAX
            } else {
                pixel[3]
            };
        }
    }
    let samples = match depth {
        Depth::Eight => Samples::Eight(samples.iter().map(|s| (s >> 8) as u8).collect()),
        Depth::Sixteen => Samples::Sixteen(samples),
    };
    Pixmap::new(extent, channels, samples)
}

/// The samples as [`Renderer::band`] writes them.
fn bytes(pixmap: &Pixmap) -> Vec<u8> {
    match pixmap.samples() {
        Samples::Eight(samples) => samples.clone(),
        Samples::Sixteen(samples) => samples.iter().flat_map(|s| s.to_be_bytes()).collect(),
    }
}

/// The mesh that poses every vertex by a function of its rest position.
fn posed(grid: Grid, f: impl Fn(Point) -> Point) -> Mesh {
    let vertices =
        (0..grid.rows()).flat_map(|j| (0..grid.columns()).map(move |i| grid.vertex(i, j)));
    let displacement = vertices
        .map(|p| f(p) - p)
        .map(|d| [d.x as f32, d.y as f32])
        .collect();
    Mesh::new(grid, displacement)
}

/// A smooth warp: waves of `strength` times the largest that cannot fold, over lengths of 90 px and
/// more.
fn waves(grid: Grid, seed: u64, strength: f64) -> Mesh {
    let mut noise = Noise(seed);
    let waves: Vec<[f64; 5]> = (0..6)
        .map(|_| {
            let (angle, length) = (
                noise.signed() * std::f64::consts::PI,
                90.0 + 200.0 * noise.signed().abs(),
            );
            let wave = std::f64::consts::TAU / length;
            let push = strength / wave / 6.0;
            [
                wave * angle.cos(),
                wave * angle.sin(),
                noise.signed() * 3.0,
                push * noise.signed(),
                push * noise.signed(),
            ]
        })
        .collect();
    posed(grid, |p| {
        waves.iter().fold(p, |sum, [kx, ky, phase, dx, dy]| {
            let sine = (kx * p.x + ky * p.y + phase).sin();
            sum + Vec2::new(dx * sine, dy * sine)
        })
    })
}

/// Rotates by `angle` at the centre, less with the distance.
fn swirl(grid: Grid, angle: f64) -> Mesh {
    let centre = Point::new(grid.width() / 2.0, grid.height() / 2.0);
    let radius = grid.width().min(grid.height()) / 2.2;
    posed(grid, |p| {
        let arm = p - centre;
        let turn = angle * (-(arm.norm2() / (radius * radius)) * 2.0).exp();
        centre + arm.complex_mul(Vec2::new(turn.cos(), turn.sin()))
    })
}

/// Draws the whole target at once on the best level.
fn draw(source: &Arc<Source>, mesh: &Mesh, options: RenderOptions) -> (Renderer, Vec<u8>) {
    draw_on(SimdLevel::detect(), source, mesh, options)
}

fn draw_on(
    level: SimdLevel,
    source: &Arc<Source>,
    mesh: &Mesh,
    options: RenderOptions,
) -> (Renderer, Vec<u8>) {
    let renderer = Renderer::with_level(source.clone(), mesh, options, level);
    let out = banded(&renderer, options.target.height());
    (renderer, out)
}

/// Draws in bands of this number of rows.
fn banded(renderer: &Renderer, rows: u32) -> Vec<u8> {
    let target = renderer.target();
    let row = target.width() as usize * renderer.channels().count() * renderer.depth().bytes();
    let mut out = vec![0xA5; row * target.height() as usize];
    for (k, band) in out.chunks_mut(row * rows as usize).enumerate() {
        let first = k as u32 * rows;
        renderer.band(first..first + (band.len() / row) as u32, band, &|| false);
    }
    out
}

/// The astronaut, 8-bit RGB, 512 x 512.
fn astronaut() -> Pixmap {
    let picture = image::open(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/test_files/images/astronaut.png"
    ))
    .unwrap();
    let image::DynamicImage::ImageRgb8(rgb) = picture else {
        panic!("8-bit RGB")
    };
    Pixmap::new(
        extent(rgb.width(), rgb.height()),
        Channels::Rgb,
        Samples::Eight(rgb.into_raw()),
    )
}

/// The same picture with an alpha that is opaque in a disc, soft at its edge, and transparent
/// outside.
fn cut_out(picture: &Pixmap) -> Pixmap {
    let Samples::Eight(samples) = picture.samples() else {
        panic!("8 bit")
    };
    let (width, height) = (
        picture.extent().width() as usize,
        picture.extent().height() as usize,
    );
    let centre = Point::new(width as f64 / 2.0, height as f64 / 2.0);
    let pixels = samples.chunks_exact(3).enumerate().flat_map(|(k, p)| {
        let distance = Point::new((k % width) as f64, (k / width) as f64).distance(centre);
        let alpha = ((width as f64 * 0.4 - distance) * 20.0).clamp(0.0, 255.0) as u8;
        [p[0], p[1], p[2], alpha]
    });
    Pixmap::new(
        picture.extent(),
        Channels::Rgba,
        Samples::Eight(pixels.collect()),
    )
}
