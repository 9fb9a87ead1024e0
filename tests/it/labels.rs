//! Label images under 200 random warps: no label is invented, and each is that of the exact inverse
//! of its pixel's centre, unless a border between labels passes within half a pixel.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::warp::{
    Folds, LabelImage, Limits, Method, OutputSpec, PosedMesh, RasterSource, RenderJob,
    ResolvedRest, RestSpec,
};

use crate::support::picture::png_of;

const SIDE: (u32, u32) = (160, 120);

/// Numbers in 0..1 that depend on a seed.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / f64::from(1_u32 << 31)
    }

    fn place(&mut self) -> Point {
        Point::new(8.0 + 144.0 * self.next(), 8.0 + 104.0 * self.next())
    }

    fn moved(&mut self, p: Point) -> Point {
        Point::new(p.x + 8.0 * self.next() - 4.0, p.y + 8.0 * self.next() - 4.0)
    }
}

/// Discs and fields of 16-bit labels.
fn label(x: usize, y: usize) -> u16 {
    let near = |a: usize, b: usize, radius: usize| {
        x.abs_diff(a).pow(2) + y.abs_diff(b).pow(2) < radius * radius
    };
    match () {
        () if near(60, 50, 22) => 40_000,
        () if near(110, 80, 15) => 257,
        () => (x / 40 * 300 + y / 40 * 7 + 1) as u16,
    }
}

fn warp(seed: u64) -> (RestSpec, Vec<Handle>) {
    let mut noise = Noise(seed * 977 + 13);
    for _ in 0..4 {
        noise.next();
    }
    let (mut p, mut q) = (Vec::new(), Vec::new());
    for _ in 0..4 + seed % 5 {
        let place = noise.place();
        q.push(Handle::Point(noise.moved(place)));
        p.push(Handle::Point(place));
    }
    if seed.is_multiple_of(3) {
        let line = [noise.place(), noise.place()];
        q.push(Handle::Polyline(
            line.map(|place| noise.moved(place)).to_vec(),
        ));
        p.push(Handle::Polyline(line.to_vec()));
    }
    let method = [Method::Rigid, Method::Similarity, Method::Affine][(seed % 3) as usize];
    (
        RestSpec {
            p,
            method,
            alpha: Some(1.0 + noise.next()),
            ..RestSpec::default()
        },
        q,
    )
}

#[test]
fn labels_follow_the_inverse_of_the_pixel_centre() {
    let limits = Limits::default();
    let all: BTreeSet<u16> = (0..120)
        .flat_map(|y| (0..160).map(move |x| label(x, y)))
        .chain([0])
        .collect();
    let samples: Vec<u8> = (0..120)
        .flat_map(|y| (0..160).flat_map(move |x| label(x, y).to_be_bytes()))
        .collect();
    let file = png_of(
        SIDE.0,
        SIDE.1,
        png::ColorType::Grayscale,
        png::BitDepth::Sixteen,
        &samples,
    );
    let image = LabelImage::decode(&file, &limits, &|| false).unwrap();
    let (mut compared, mut near_borders, mut usable) = (0, 0, 0);
    for seed in 0..200 {
        let (rest, q) = warp(seed);
        let setup = ResolvedRest::new(&rest, image.extent(), &limits, &|| false).unwrap();
        let pose = setup.pose(&q).unwrap();
        let posed = PosedMesh::new(
            &setup,
            &setup.plan(&|| false).unwrap(),
            &pose,
            Folds::Report,
            &|| false,
        )
        .unwrap();
        let mut out = Vec::new();
        let _ = RenderJob::new(
            RasterSource::Labels(&image),
            &posed,
            &OutputSpec::default(),
            &limits,
            &|| false,
        )
        .unwrap()
        .write(0, &(), &mut |bytes| {
            out.extend(bytes);
            ControlFlow::Continue(())
        });
        let mut reader = png::Decoder::new(std::io::Cursor::new(&out))
            .read_info()
            .unwrap();
        let mut samples = vec![0; reader.output_buffer_size().unwrap()];
        let read = reader.next_frame(&mut samples).unwrap();
        assert_eq!(
            (read.color_type, read.bit_depth),
            (png::ColorType::Grayscale, png::BitDepth::Sixteen),
            "no alpha, and 16 bit"
        );
        let drawn: Vec<u16> = samples
            .as_chunks::<2>()
            .0
            .iter()
            .map(|bytes| u16::from_be_bytes(*bytes))
            .collect();
        assert!(
            drawn.iter().all(|value| all.contains(value)),
            "{seed}: an invented label"
        );
        if posed.report().folds > 0 || posed.report().exceeded > 0 {
            continue;
        }
        usable += 1;
        // Every third pixel, and places half a pixel around its centre.
        let pixels: Vec<(usize, usize)> = (1..119)
            .step_by(3)
            .flat_map(|y| (1..159).step_by(3).map(move |x| (x, y)))
            .collect();
        let offsets = [-0.5, 0.0, 0.5].map(|dy| [-0.5, 0.0, 0.5].map(|dx| (dx, dy)));
        let around = |(x, y): &(usize, usize)| {
            let (x, y) = (*x as f64 + 0.5, *y as f64 + 0.5);
            offsets
                .as_flattened()
                .iter()
                .map(move |(dx, dy)| Point::new(x + dx, y + dy))
                .collect::<Vec<_>>()
        };
        let places: Vec<Point> = pixels.iter().flat_map(around).collect();
        let sources = setup
            .inverse(&pose, &posed)
            .map(&places, &|| false)
            .unwrap();
        for ((x, y), sources) in pixels.iter().zip(sources.chunks_exact(9)) {
            let labels: BTreeSet<u16> = sources
                .iter()
                .map(|source| {
                    source.map_or(0, |p| {
                        label((p.x as usize).min(159), (p.y as usize).min(119))
                    })
                })
                .collect();
            let [only] = labels.iter().copied().collect::<Vec<_>>()[..] else {
                near_borders += 1;
                continue;
            };
            assert_eq!(
                drawn[y * 160 + x],
                only,
                "{seed}: {x}, {y}: {:?}",
                sources[4]
            );
            compared += 1;
        }
    }
    assert!(
        usable > 100 && compared > 10 * near_borders / 2 && near_borders > 1000,
        "{usable} warps, {compared} px, {near_borders} near borders"
    );
}
