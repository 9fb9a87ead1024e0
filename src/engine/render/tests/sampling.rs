//! Filters and what lies outside: laws that hold exactly, and the error of area-aware sampling
//! against a supersampled reference.

use super::super::canvas::Canvas;
use super::*;

fn with(filter: Filter, outside: Outside, target: Extent) -> RenderOptions {
    RenderOptions {
        filter,
        outside,
        ..options(target)
    }
}

fn grid(side: u32) -> Grid {
    Grid::with_counts(side.into(), side.into(), 17, 15)
}

/// A source of every shape.
fn sources(extent: Extent) -> Vec<Arc<Source>> {
    let shapes = [Channels::Rgb, Channels::Rgba]
        .into_iter()
        .flat_map(|c| [Depth::Eight, Depth::Sixteen].map(|d| (c, d)));
    shapes
        .map(|(channels, depth)| Arc::new(Source::new(noise(extent, channels, depth))))
        .collect()
}

/// The pixel of a mirrored row, counted one by one.
fn walked(at: i32, side: i32) -> i32 {
    let (mut x, mut step) = (0, 1);
    let (count, towards) = if at >= 0 { (at, 1) } else { (-at, -1) };
    if towards < 0 {
        step = 0;
    }
    for _ in 0..count {
        if step == 0 {
            step = 1;
        } else if x + step < 0 || x + step >= side {
            step = -step;
        } else {
            x += step;
        }
    }
    x
}

#[test]
fn the_identity_is_mirrored_exactly_on_a_larger_canvas() {
    let (width, height) = (23, 17);
    for source in sources(extent(width, height)) {
        let pixmap = source.pixmap();
        let pixel = pixmap.channels().count() * pixmap.depth().bytes();
        let canvas = Canvas {
            x: -60,
            y: -41,
            extent: extent(150, 120),
        };
        let mesh = Mesh::identity(Grid::with_counts(width.into(), height.into(), 5, 4));
        let options = RenderOptions {
            canvas: Some(canvas),
            ..with(Filter::Bilinear, Outside::Reflect, canvas.extent)
        };
        let (renderer, out) = draw(&source, &mesh, options);
        assert_eq!(renderer.channels(), pixmap.channels());
        let all = bytes(pixmap);
        for (k, found) in out.chunks_exact(pixel).enumerate() {
            let (x, y) = (
                walked(k as i32 % 150 - 60, width as i32),
                walked(k as i32 / 150 - 41, height as i32),
            );
            let at = (y * width as i32 + x) as usize * pixel;
            assert_eq!(found, &all[at..at + pixel], "{k}");
        }
    }
}

#[test]
fn moved_by_whole_pixels_every_filter_copies_and_mirrors() {
    let side = 40;
    for source in sources(extent(side, side)) {
        let pixel = source.pixmap().channels().count() * source.pixmap().depth().bytes();
        let moved = posed(grid(side), |p| p + Vec2::new(7.0, -5.0));
        let all = bytes(source.pixmap());
        for filter in [Filter::Nearest, Filter::Bilinear, Filter::Bicubic] {
            for level in [SimdLevel::Scalar, SimdLevel::Avx2, SimdLevel::Avx512] {
                let (_, out) = draw_on(
                    level,
                    &source,
                    &moved,
                    with(filter, Outside::Reflect, extent(side, side)),
                );
                for (k, found) in out.chunks_exact(pixel).enumerate() {
                    let (x, y) = (walked(k as i32 % 40 - 7, 40), walked(k as i32 / 40 + 5, 40));
                    let want = &all[(y * 40 + x) as usize * pixel..][..pixel];
                    let is_hidden = pixel % 4 == 0 && want[3 * pixel / 4..].iter().all(|b| *b == 0);
                    assert!(
                        found == want
                            || is_hidden && found[3 * pixel / 4..] == want[3 * pixel / 4..],
                        "{filter:?} {level:?} {k}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_turned_picture_is_mirrored_at_its_turned_border() {
    // A quarter turn and twice the size: exact positions everywhere.
    let source = Arc::new(Source::new(noise(
        extent(16, 16),
        Channels::Rgb,
        Depth::Eight,
    )));
    let turned = posed(Grid::with_counts(16.0, 16.0, 5, 5), |p| {
        Point::new(48.0 - p.y * 2.0, 16.0 + p.x * 2.0)
    });
    let canvas = Canvas {
        x: -32,
        y: -32,
        extent: extent(128, 128),
    };
    let options = RenderOptions {
        canvas: Some(canvas),
        ..with(Filter::Nearest, Outside::Reflect, canvas.extent)
    };
    let (_, out) = draw(&source, &turned, options);
    let all = bytes(source.pixmap());
    for (k, found) in out.chunks_exact(3).enumerate() {
        let (x, y) = (k as i32 % 128 - 32, k as i32 / 128 - 32);
        let (u, v) = (
            walked((y - 16).div_euclid(2), 16),
            walked((47 - x).div_euclid(2), 16),
        );
        assert_eq!(found, &all[(v * 16 + u) as usize * 3..][..3], "{x} {y}");
    }
}

#[test]
fn mirrored_pictures_are_exact_crops_and_continuous() {
    let source = Arc::new(Source::new(astronaut()));
    let mesh = waves(Grid::with_counts(512.0, 512.0, 41, 37), 3, 14.0);
    let options = with(Filter::Bicubic, Outside::Reflect, extent(1, 1));
    let drawn = |x, y, width, height| {
        let canvas = Canvas {
            x,
            y,
            extent: extent(width, height),
        };
        draw(
            &source,
            &mesh,
            RenderOptions {
                canvas: Some(canvas),
                target: canvas.extent,
                ..options
            },
        )
        .1
    };
    let (all, part) = (drawn(-700, -128, 1400, 300), drawn(-300, -28, 500, 60));
    for row in 0..60 {
        assert!(
            part[row * 1500..][..1500] == all[((row + 100) * 1400 + 400) * 3..][..1500],
            "{row}"
        );
    }
    if let Ok(folder) = std::env::var("MLSWARP_PICTURES") {
        let all = drawn(-300, -300, 1100, 1100);
        image::save_buffer(
            format!("{folder}/reflect.png"),
            &all,
            1100,
            1100,
            image::ExtendedColorType::Rgb8,
        )
        .unwrap();
    }
}

#[test]
fn bicubic_reproduces_ramps_exactly() {
    for depth in [Depth::Eight, Depth::Sixteen] {
        let step = match depth {
            Depth::Eight => 4,
            Depth::Sixteen => 1024,
        };
        let samples: Vec<u16> = (0..60 * 60)
            .flat_map(|k| [k % 60 * step, k / 60 * step, 9 * step])
            .collect();
        let samples = match depth {
            Depth::Eight => Samples::Eight(samples.iter().map(|s| *s as u8).collect()),
            Depth::Sixteen => Samples::Sixteen(samples),
        };
        let source = Arc::new(Source::new(Pixmap::new(
            extent(60, 60),
            Channels::Rgb,
            samples,
        )));
        let moved = posed(grid(60), |p| p + Vec2::new(0.75, -0.25));
        let (_, out) = draw(
            &source,
            &moved,
            with(Filter::Bicubic, Outside::Edge, extent(60, 60)),
        );
        let (count, quarter) = (3 * depth.bytes(), i32::from(step) / 4);
        let read = |pixel: &[u8], k: usize| match depth {
            Depth::Eight => i32::from(pixel[k]),
            Depth::Sixteen => i32::from(u16::from_be_bytes([pixel[2 * k], pixel[2 * k + 1]])),
        };
        for y in 3..56 {
            for x in 3..56 {
                let pixel = &out[(y * 60 + x) * count..][..count];
                let want = [
                    (4 * x as i32 - 3) * quarter,
                    (4 * y as i32 + 1) * quarter,
                    36 * quarter,
                ];
                assert_eq!(
                    [read(pixel, 0), read(pixel, 1), read(pixel, 2)],
                    want,
                    "{depth:?} {x} {y}"
                );
            }
        }
    }
}

#[test]
fn bicubic_neither_overflows_nor_shows_colours_under_alpha_0() {
    // Stripes of the extremes, red where opaque and green where transparent.
    for depth in [Depth::Eight, Depth::Sixteen] {
        let pixels = (0..40 * 40).flat_map(|k| {
            if k % 40 / 3 % 2 == 0 {
                [u16::MAX, 0, 0, u16::MAX]
            } else {
                [0, u16::MAX, 0, 0]
            }
        });
        let samples = match depth {
            Depth::Eight => Samples::Eight(pixels.map(|s| s as u8).collect()),
            Depth::Sixteen => Samples::Sixteen(pixels.collect()),
        };
        let source = Arc::new(Source::new(Pixmap::new(
            extent(40, 40),
            Channels::Rgba,
            samples,
        )));
        for shrink in [1.0, 0.4] {
            let moved = posed(grid(40), |p| {
                Point::new(p.x * shrink + 0.4, p.y * shrink + 0.3)
            });
            let (_, out) = draw(
                &source,
                &moved,
                with(Filter::Bicubic, Outside::Transparent, extent(40, 40)),
            );
            for pixel in out.chunks_exact(4 * depth.bytes()) {
                let at = |k: usize| pixel[k * depth.bytes()];
                assert!(
                    at(3) == 0 || (at(0) == 255 && at(1) == 0 && at(2) == 0),
                    "{pixel:?}"
                );
            }
        }
    }
}

/// Samples of the reference along each side of a pixel.
fn reference_samples() -> usize {
    if std::env::var_os("MLSWARP_TESTS_FULL").is_some() {
        16
    } else {
        8
    }
}

/// What else is usual: two box-reduced copies, chosen by the longer side of the footprint, each
/// sampled bilinearly, and blended.
fn trilinear(picture: &Pixmap, mesh: &Mesh, side: u32) -> Vec<u8> {
    let places = reference::places(mesh, extent(side, side));
    let copies: Vec<Pixmap> = (0..5)
        .map(|k| picture.reduced(k, &|| false).unwrap())
        .collect();
    let width = side as usize;
    let pixel = |k: usize| {
        let Some(place) = places[k] else {
            return [0; 3];
        };
        let beside = |at: Option<usize>| at.and_then(|at| *places.get(at)?);
        let length = |before: Option<Point>, after: Option<Point>| match (before, after) {
            (Some(before), Some(after)) => 0.5 * before.distance(after),
            (Some(other), None) | (None, Some(other)) => place.distance(other),
            (None, None) => 1.0,
        };
        let longest = length(beside(k.checked_sub(1)), beside(Some(k + 1))).max(length(
            beside(k.checked_sub(width)),
            beside(Some(k + width)),
        ));
        let level = longest.log2().clamp(0.0, 3.999);
        let [low, high] = [0.0, 1.0].map(|up| {
            let k = level.floor() + up;
            reference::sample(&copies[k as usize], place, k.exp2())
        });
        let blend = level - level.floor();
        [0, 1, 2].map(|c| (low[c] + blend * (high[c] - low[c])).round() as u8)
    };
    (0..width * width).flat_map(pixel).collect()
}

/// For each pixel that the mesh covers whole, the mean of many bilinear samples.
fn supersampled(picture: &Pixmap, mesh: &Mesh, side: u32) -> Vec<Option<[f64; 3]>> {
    let n = reference_samples();
    let places = reference::places(mesh, extent(side * n as u32, side * n as u32));
    let side = side as usize;
    let mean = |x: usize, y: usize| {
        let mut total = [0.0; 3];
        for at in (0..n * n).map(|k| (y * n + k / n) * side * n + x * n + k % n) {
            let sample = reference::sample(picture, places[at]?, 1.0);
            total
                .iter_mut()
                .zip(sample)
                .for_each(|(total, sample)| *total += sample);
        }
        Some(total.map(|total| total / (n * n) as f64))
    };
    (0..side * side).map(|k| mean(k % side, k / side)).collect()
}

/// The root of the mean squared difference of covered samples from the reference.
fn error(reference: &[Option<[f64; 3]>], out: &[u8]) -> f64 {
    let pixels = reference
        .iter()
        .zip(out.chunks_exact(out.len() / reference.len()));
    let (mut sum, mut count) = (0.0, 0_u32);
    for (mean, found) in pixels.filter_map(|(mean, found)| Some((mean.as_ref()?, found))) {
        for (mean, found) in mean.iter().zip(found) {
            sum += (mean - f64::from(*found)).powi(2);
            count += 1;
        }
    }
    (sum / f64::from(count)).sqrt()
}

#[test]
fn shrunken_pictures_are_near_the_supersampled_reference() {
    let whole = astronaut();
    let Samples::Eight(samples) = whole.samples() else {
        panic!("8 bit")
    };
    // A detail, so that the reference is quick.
    let side = 192;
    let rows = samples.chunks_exact(512 * 3).skip(120).take(side);
    let picture = Pixmap::new(
        extent(192, 192),
        Channels::Rgb,
        Samples::Eight(
            rows.flat_map(|row| row[300..300 + side * 3].to_vec())
                .collect(),
        ),
    );
    let source = Arc::new(Source::new(picture.clone()));
    let grid = || Grid::with_counts(192.0, 192.0, 25, 25);
    let turned = |by: f64, across: f64, down: f64| {
        posed(grid(), move |p| {
            let arm = Vec2::new((p.x - 96.0) * across, (p.y - 96.0) * down);
            Point::new(96.3, 96.4) + arm.complex_mul(Vec2::new(by.cos(), by.sin()))
        })
    };
    let pinched = posed(grid(), |p| {
        let arm = p - Point::new(96.0, 96.0);
        Point::new(96.0, 96.0) + arm * (1.0 - 0.75 * (-arm.norm2() / 1800.0).exp())
    });
    let cases = [
        ("by 2", turned(0.0, 0.5, 0.5), 2.6),
        ("by 4", turned(0.0, 0.25, 0.25), 1.3),
        ("by 8", turned(0.0, 0.125, 0.125), 1.5),
        ("by 2, turned", turned(0.4, 0.5, 0.5), 2.7),
        ("by 3, turned", turned(0.4, 0.33, 0.33), 1.6),
        ("by 6 across, turned", turned(0.3, 1.0 / 6.0, 1.0), 1.8),
        ("pinched by 4", pinched, 4.4),
    ];
    for (name, mesh, most) in cases {
        let reference = supersampled(&picture, &mesh, 192);
        let errors = [Filter::Nearest, Filter::Bilinear, Filter::Bicubic].map(|filter| {
            let (_, out) = draw(
                &source,
                &mesh,
                with(filter, Outside::Edge, extent(192, 192)),
            );
            if let Ok(folder) = std::env::var("MLSWARP_PICTURES") {
                image::save_buffer(
                    format!("{folder}/{name} {filter:?}.png"),
                    &out,
                    192,
                    192,
                    image::ExtendedColorType::Rgb8,
                )
                .unwrap();
            }
            error(&reference, &out)
        });
        let (_, points) = draw_points(
            &source,
            &mesh,
            with(Filter::Bilinear, Outside::Edge, extent(192, 192)),
        );
        let before = error(&reference, &points);
        let copies = error(&reference, &trilinear(&picture, &mesh, 192));
        let [nearest, bilinear, bicubic] = errors;
        println!(
            "| {name} | {nearest:.2} | {before:.2} | {copies:.2} | {bilinear:.2} | {bicubic:.2} |"
        );
        assert!(bilinear < copies, "{name}: {bilinear}, trilinear {copies}");
        assert!(
            errors[1] < most && errors[2] < most && errors[1] < before,
            "{name}: {errors:?} of {most}, {before}"
        );
    }
}

/// Draws without footprints.
fn draw_points(source: &Arc<Source>, mesh: &Mesh, options: RenderOptions) -> (Renderer, Vec<u8>) {
    let mut renderer = Renderer::new(source.clone(), mesh, options);
    renderer.sample_points();
    let out = banded(&renderer, options.target.height());
    (renderer, out)
}

#[test]
fn every_level_and_every_band_gives_the_same_bytes() {
    for source in sources(extent(90, 90)) {
        for (mesh, shape) in [
            (swirl(grid(90), 5.0), "swirl"),
            (waves(grid(90), 5, 60.0), "folds"),
            (
                posed(grid(90), |p| Point::new(p.x * 0.3, p.y * 0.3)),
                "small",
            ),
        ] {
            for filter in [Filter::Bilinear, Filter::Bicubic] {
                for target in [extent(90, 90), extent(50, 50)] {
                    let options = with(filter, Outside::Reflect, target);
                    let (_, want) = draw_on(SimdLevel::Scalar, &source, &mesh, options);
                    for level in [SimdLevel::Scalar, SimdLevel::Avx2, SimdLevel::Avx512] {
                        let renderer = Renderer::with_level(source.clone(), &mesh, options, level);
                        assert!(banded(&renderer, 7) == want, "{shape} {filter:?} {level:?}");
                    }
                }
            }
        }
    }
}
