//! The part of a picture that a region changes, on canvases of all kinds, and what depends on it.

use std::sync::atomic::{AtomicU32, Ordering};

use super::*;

#[test]
fn canvases_are_crops_and_bands_do_not_matter() {
    let size = extent(SIDE.0, SIDE.1);
    let image = noise(size, Channels::Rgb, Depth::Eight);
    for (n, case) in cases().into_iter().enumerate() {
        let holes = [Holes::Keep, Holes::Transparent][n % 2];
        let outside = [
            Outside::Transparent,
            Outside::Edge,
            Outside::Reflect,
            Outside::Colour([9, 8, 7, 255]),
        ][n % 4];
        let moved = posed(&case).within(SOFT.region());
        let of = |x, y, width, height| {
            let canvas = CanvasSpec::Box(Canvas {
                x,
                y,
                extent: extent(width, height),
            });
            let output = OutputSpec {
                holes,
                outside,
                canvas,
                ..OutputSpec::default()
            };
            RenderJob::new(
                RasterSource::Image(&image),
                &moved,
                &output,
                &Limits::default(),
                &|| false,
            )
            .unwrap()
        };
        let (large, small) = (
            pixels(&of(-40, -30, 200, 150), 1000, Depth::Eight),
            pixels(&of(-7, 11, 90, 61), 1000, Depth::Eight),
        );
        for (k, pixel) in small.all().enumerate() {
            let (x, y) = (k % 90 + 33, k / 90 + 41);
            assert_eq!(pixel, large.at(y * 200 + x), "{}: pixel {k}", case.name);
        }
        for step in [1, 7, 32, 45] {
            assert!(
                pixels(&of(-40, -30, 200, 150), step, Depth::Eight) == large,
                "{}: bands of {step}",
                case.name
            );
        }
        // What `fit` leaves out has nothing of the picture.
        let output = OutputSpec {
            holes: Holes::Keep,
            canvas: CanvasSpec::Fit,
            ..OutputSpec::default()
        };
        let canvas = output
            .target(size, &moved, &Limits::default(), &|| false)
            .unwrap()
            .canvas
            .unwrap();
        let output = OutputSpec {
            canvas: CanvasSpec::Box(Canvas {
                x: -60,
                y: -60,
                extent: extent(240, 210),
            }),
            ..OutputSpec::default()
        };
        for (k, pixel) in draw(RasterSource::Image(&image), &moved, &output)
            .all()
            .enumerate()
        {
            let (x, y) = (
                (k % 240) as f64 - 60.0 - f64::from(canvas.x),
                (k / 240) as f64 - 60.0 - f64::from(canvas.y),
            );
            let inside = |at: f64, side: u32| (0.0..f64::from(side)).contains(&at);
            let is_inside = inside(x, canvas.extent.width()) && inside(y, canvas.extent.height());
            assert!(is_inside || pixel == [0; 4], "{}: {x}, {y}", case.name);
        }
    }
}

/// The box of the cells that have a pixel of the mask within two pixels.
#[test]
fn a_box_contains_the_cells_that_have_some_of_the_mask() {
    type IsMasked<'a> = &'a dyn Fn(u32, u32) -> bool;
    let size = extent(SIDE.0, SIDE.1);
    let masks: [(&str, IsMasked<'_>); 5] = [
        ("nothing", &|_, _| false),
        ("everything", &|_, _| true),
        ("a disc", &|x, y| {
            HARD.value(Point::new(f64::from(x) + 0.5, f64::from(y) + 0.5)) > 0.0
        }),
        ("dots", &|x, y| x % 41 == 7 && y % 37 == 11),
        ("corners", &|x, y| {
            (x == 0 && y == 0) || (x + 1 == SIDE.0 && y + 1 == SIDE.1)
        }),
    ];
    for (name, is_masked) in masks {
        let values = (0..SIDE.1)
            .flat_map(|y| (0..SIDE.0).flat_map(move |x| [255 * u8::from(is_masked(x, y)); 3]))
            .collect();
        let region = Region::new(&Image::of_pixmap(
            name,
            Pixmap::new(size, Channels::Rgb, Samples::Eight(values)),
            true,
        ));
        for (case, grid) in cases().into_iter().flat_map(|case| {
            let grids = [
                GridSpec::Pixel,
                GridSpec::Cell(7.3),
                GridSpec::Counts {
                    columns: 2,
                    rows: 3,
                },
            ];
            grids.map(|grid| {
                (
                    Case {
                        rest: RestSpec {
                            grid,
                            ..case.rest.clone()
                        },
                        ..case.clone()
                    },
                    grid,
                )
            })
        }) {
            let posed = posed(&case);
            let (mesh, grid_lines) = (posed.mesh(), posed.mesh().grid());
            let mut want = [0.0, 0.0, f64::from(SIDE.0), f64::from(SIDE.1)];
            for (i, j) in (0..grid_lines.rows() - 1)
                .flat_map(|j| (0..grid_lines.columns() - 1).map(move |i| (i, j)))
            {
                let (from, to) = (grid_lines.vertex(i, j), grid_lines.vertex(i + 1, j + 1));
                let range = |from: f64, to: f64, side: u32| {
                    ((from - 2.0).floor().max(0.0) as u32).min(side - 1)
                        ..((to + 2.0).ceil() as u32).min(side)
                };
                if range(from.y, to.y, SIDE.1)
                    .any(|y| range(from.x, to.x, SIDE.0).any(|x| is_masked(x, y)))
                {
                    let cell = mesh.cell_bounds(i, j);
                    want = [
                        want[0].min(cell[0]),
                        want[1].min(cell[1]),
                        want[2].max(cell[2]),
                        want[3].max(cell[3]),
                    ];
                }
            }
            assert_eq!(
                region.bounds(mesh, &|| false).unwrap(),
                want,
                "{name}: {}, {grid:?}",
                case.name
            );
        }
    }
}

#[test]
fn the_pixels_of_a_mask_are_read_for_the_first_pose_only() {
    // The pixels of a mask are read row by row, each after a look whether anyone still waits.
    let looks = |region: &Region, posed: &PosedMesh| {
        let looks = AtomicU32::new(0);
        region.bounds(posed.mesh(), &|| {
            looks.fetch_add(1, Ordering::Relaxed);
            false
        });
        looks.into_inner()
    };
    let image = HARD.image(Channels::Rgba, Depth::Eight);
    let region = Region::new(&image);
    for (case, posed) in cases().iter().map(|case| (case, posed(case))) {
        let cells = posed.mesh().grid().rows() - 1;
        let first = looks(
            &Region::new(&HARD.image(Channels::Rgba, Depth::Eight)),
            &posed,
        );
        assert_eq!(first, SIDE.1 + cells, "{}", case.name);
        looks(&region, &posed);
        for region in [&region, &Region::new(&image)] {
            assert_eq!(looks(region, &posed), cells, "{}", case.name);
        }
    }
}

#[test]
fn a_smaller_picture_has_the_smaller_source_outside() {
    let size = extent(SIDE.0, SIDE.1);
    let image = noise(size, Channels::Rgb, Depth::Eight);
    let case = &cases()[0];
    for width in [40, 200] {
        let output = OutputSpec {
            width: Some(width),
            ..OutputSpec::default()
        };
        let (still, part) = (
            draw(RasterSource::Image(&image), &at_rest(case), &output),
            draw(
                RasterSource::Image(&image),
                &posed(case).within(HARD.region()),
                &output,
            ),
        );
        let differ = still.all().zip(part.all()).filter(|(a, b)| a != b).count() as f64
            / still.size.pixels() as f64;
        let disc = std::f64::consts::PI * HARD.radius * HARD.radius / size.pixels() as f64;
        assert!(
            differ > 0.6 * disc && differ < 1.5 * disc,
            "{width}: {differ} of the pixels differ, and the disc has {disc}"
        );
    }
}

#[test]
fn what_a_picture_depends_on_is_in_its_digest() {
    let size = extent(SIDE.0, SIDE.1);
    let image = noise(size, Channels::Rgb, Depth::Eight);
    let case = &cases()[0];
    let etag = |posed: &PosedMesh, holes| {
        let output = OutputSpec {
            holes,
            ..OutputSpec::default()
        };
        RenderJob::new(
            RasterSource::Image(&image),
            posed,
            &output,
            &Limits::default(),
            &|| false,
        )
        .unwrap()
        .etag()
    };
    let (plain, hard, soft) = (
        posed(case),
        posed(case).within(HARD.region()),
        posed(case).within(SOFT.region()),
    );
    let all = [
        etag(&plain, Holes::Keep),
        etag(&hard, Holes::Keep),
        etag(&soft, Holes::Keep),
        etag(&soft, Holes::Transparent),
    ];
    for (k, tag) in all.iter().enumerate() {
        assert!(!all[..k].contains(tag), "{k}");
    }
    assert_eq!(
        etag(&plain, Holes::Keep),
        etag(&plain, Holes::Transparent),
        "without a region there are no holes"
    );
    // A picture of which nothing is posed on the canvas still shows the source.
    let canvas = Canvas {
        x: 0,
        y: 0,
        extent: size,
    };
    let mut away = case.clone();
    away.q = case
        .rest
        .p
        .iter()
        .map(|p| crate::deform::Handle::Point(Point::new(p.places()[0].x + 5000.0, 0.0)))
        .collect();
    let warns = |posed: PosedMesh| {
        posed
            .into_report(Some(canvas), &|| false)
            .unwrap()
            .warnings
            .contains(&Warning::NothingVisible)
    };
    assert!(warns(posed(&away)) && !warns(posed(&away).within(HARD.region())));
    let png = OutputSpec {
        format: Format::Png,
        ..OutputSpec::default()
    };
    assert!(
        RenderJob::new(
            RasterSource::Holes(&HARD.region()),
            &hard,
            &png,
            &Limits::default(),
            &|| false
        )
        .unwrap()
        .etag()
            != all[1]
    );
}

#[test]
fn labels_are_chosen_and_coverage_is_mixed() {
    let size = extent(SIDE.0, SIDE.1);
    let shape = PixelLayout {
        extent: size,
        channels: Channels::Rgb,
        grey: true,
        depth: Depth::Eight,
    };
    let values = (0..size.pixels())
        .map(|k| 1 + (k * 7919 % 251) as u8)
        .collect();
    let labels = LabelImage::of(Labels {
        shape,
        palette: None,
        values,
        is_32_bit: false,
    });
    let (mut counts, mut partly) = ([0; 3], 0);
    for (n, case) in cases().into_iter().enumerate() {
        let disc = [HARD, SOFT][n % 2];
        let (mask, region) = (disc.image(Channels::Rgb, Depth::Eight), disc.region());
        let output = OutputSpec {
            holes: [Holes::Keep, Holes::Transparent][n / 2 % 2],
            ..OutputSpec::default()
        };
        let (whole, still) = (posed(&case), at_rest(&case));
        let moved = posed(&case).within(region.clone());
        let grey = |subject, posed: &PosedMesh| {
            let warp =
                RenderJob::new(subject, posed, &output, &Limits::default(), &|| false).unwrap();
            let mut bytes = vec![0; size.pixels() as usize * warp.drawer.pixel_bytes()];
            warp.drawer.band(0..SIDE.1, &mut bytes, &|| false);
            bytes
                .chunks_exact(warp.drawer.pixel_bytes())
                .map(|pixel| pixel[0])
                .collect::<Vec<u8>>()
        };
        let [there, at_rest, part] =
            [&whole, &still, &moved].map(|posed| grey(RasterSource::Labels(&labels), posed));
        let [covered, parts_covered] =
            [&whole, &moved].map(|posed| grey(RasterSource::Coverage(size), posed));
        let outside = OutputSpec {
            outside: Outside::Colour([0, 0, 0, 255]),
            ..output
        };
        let m: Vec<u16> = draw(RasterSource::Image(&mask), &whole, &outside)
            .all()
            .map(|pixel| pixel[0])
            .collect();
        let holes = grey(RasterSource::Holes(&region), &moved);
        for k in 0..part.len() {
            let is_hole = output.holes == Holes::Transparent && holes[k] >= 128;
            let (want, kind) = match (m[k] >= 128, is_hole) {
                (true, _) => (there[k], 0),
                (false, true) => (0, 1),
                (false, false) => (at_rest[k], 2),
            };
            assert_eq!(part[k], want, "{}: pixel {k}", case.name);
            counts[kind] += 1;
            let open = if output.holes == Holes::Transparent {
                holes[k]
            } else {
                0
            };
            if covered[k] == 255 {
                assert_eq!(parts_covered[k], 255 - open, "{}: pixel {k}", case.name);
                partly += usize::from(open > 0);
            }
        }
    }
    assert!(
        counts.into_iter().all(|count| count > 100) && partly > 100,
        "{counts:?} {partly}"
    );
}
