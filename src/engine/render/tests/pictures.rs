//! Small pictures: identity, translations, half turns, channels, halos, outside.

use super::*;

const SIZES: [(u32, u32); 6] = [(1, 1), (1, 9), (9, 1), (3, 2), (37, 53), (64, 48)];

fn grids(extent: Extent) -> Vec<Grid> {
    let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
    vec![
        Grid::with_cell(width, height, 4.0),
        Grid::with_cell(width, height, 1.0),
        Grid::with_cell(width, height, 1000.0),
        Grid::with_counts(width, height, 100, 100),
        Grid::with_counts(width, height, 7, 3),
    ]
}

fn kinds() -> impl Iterator<Item = (Channels, Depth)> + Clone {
    [Channels::Rgb, Channels::Rgba]
        .into_iter()
        .flat_map(|channels| [(channels, Depth::Eight), (channels, Depth::Sixteen)])
}

#[test]
fn identity_returns_the_pixels() {
    for (size, (channels, depth)) in SIZES
        .into_iter()
        .flat_map(|size| kinds().map(move |kind| (size, kind)))
    {
        let extent = extent(size.0, size.1);
        let source = Arc::new(Source::new(noise(extent, channels, depth)));
        for grid in grids(extent) {
            let (renderer, out) = draw(&source, &Mesh::identity(grid), options(extent));
            assert_eq!(renderer.channels(), channels);
            assert_eq!(
                out,
                bytes(source.pixmap()),
                "{size:?} {channels:?} {depth:?}"
            );
        }
    }
}

/// Not the copied identity: displacements too small to matter, so that every pixel is sampled.
#[test]
fn identity_by_samples_returns_the_pixels() {
    for (size, (channels, depth)) in SIZES
        .into_iter()
        .flat_map(|size| kinds().map(move |kind| (size, kind)))
    {
        let extent = extent(size.0, size.1);
        let source = Arc::new(Source::new(noise(extent, channels, depth)));
        for grid in grids(extent) {
            let mesh = Mesh::new(grid, vec![[1e-6, -1e-6]; grid.len()]);
            for level in SimdLevel::available() {
                for filter in [Filter::Nearest, Filter::Bilinear] {
                    let (renderer, out) = draw_on(
                        *level,
                        &source,
                        &mesh,
                        RenderOptions {
                            filter,
                            ..options(extent)
                        },
                    );
                    assert_eq!(renderer.channels(), channels, "all is covered");
                    assert_eq!(
                        out,
                        bytes(source.pixmap()),
                        "{size:?} {channels:?} {depth:?} {filter:?} {level:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn whole_translations_move_pixels() {
    let extent = extent(37, 29);
    for (channels, depth) in kinds() {
        let source = Arc::new(Source::new(noise(extent, channels, depth)));
        let pixel = channels.count() * depth.bytes();
        for (grid, (dx, dy)) in
            grids(extent)
                .into_iter()
                .zip([(3_i32, -2_i32), (-5, 1), (0, 7), (36, 28), (-11, 0)])
        {
            let mesh = Mesh::new(grid, vec![[dx as f32, dy as f32]; grid.len()]);
            let (renderer, out) = draw(
                &source,
                &mesh,
                RenderOptions {
                    outside: Outside::Colour([1, 2, 3, 255]),
                    ..options(extent)
                },
            );
            assert_eq!(renderer.channels(), channels);
            let original = bytes(source.pixmap());
            for (k, drawn) in out.chunks_exact(pixel).enumerate() {
                let (x, y) = (k as i32 % 37 - dx, k as i32 / 37 - dy);
                let outside: Vec<u8> = [1_u8, 2, 3, 255][..channels.count()]
                    .iter()
                    .flat_map(|&c| vec![c; depth.bytes()])
                    .collect();
                let expected = if (0..37).contains(&x) && (0..29).contains(&y) {
                    &original[(y * 37 + x) as usize * pixel..][..pixel]
                } else {
                    &outside[..]
                };
                assert_eq!(
                    drawn, expected,
                    "pixel {k} of {channels:?} {depth:?}, moved by {dx}, {dy}"
                );
            }
        }
    }
}

#[test]
fn half_turn_twice_is_the_identity() {
    for (width, height) in SIZES {
        let extent = extent(width, height);
        for channels in [Channels::Rgb, Channels::Rgba] {
            let picture = noise(extent, channels, Depth::Eight);
            for grid in grids(extent) {
                let turn = posed(grid, |p| {
                    Point::new(grid.width() - p.x, grid.height() - p.y)
                });
                let source = Arc::new(Source::new(picture.clone()));
                let (renderer, once) = draw(&source, &turn, options(extent));
                assert_eq!(renderer.channels(), channels, "all is covered");
                let mut backwards: Vec<_> = bytes(&picture)
                    .chunks_exact(channels.count())
                    .rev()
                    .flatten()
                    .copied()
                    .collect();
                assert_eq!(once, backwards);
                let again = Arc::new(Source::new(Pixmap::new(
                    extent,
                    channels,
                    Samples::Eight(once),
                )));
                backwards = draw(&again, &turn, options(extent)).1;
                assert_eq!(backwards, bytes(&picture));
            }
        }
    }
}

#[test]
fn channels_follow_source_and_outside() {
    let extent = extent(20, 20);
    let rgb = Arc::new(Source::new(noise(extent, Channels::Rgb, Depth::Eight)));
    let grid = Grid::with_cell(20.0, 20.0, 5.0);
    let moved = Mesh::new(grid, vec![[3.0, 0.0]; grid.len()]);
    let grown = posed(grid, |p| Point::new(p.x * 1.5 - 5.0, p.y * 1.5 - 5.0));
    let channels = |mesh, outside| {
        Renderer::new(
            rgb.clone(),
            mesh,
            RenderOptions {
                outside,
                ..options(extent)
            },
        )
        .channels()
    };
    assert_eq!(channels(&moved, Outside::Transparent), Channels::Rgba);
    assert_eq!(
        channels(&moved, Outside::Colour([9, 9, 9, 254])),
        Channels::Rgba
    );
    assert_eq!(
        channels(&moved, Outside::Colour([9, 9, 9, 255])),
        Channels::Rgb
    );
    assert_eq!(channels(&moved, Outside::Edge), Channels::Rgb);
    assert_eq!(channels(&grown, Outside::Transparent), Channels::Rgb);
    assert_eq!(
        channels(&Mesh::identity(grid), Outside::Transparent),
        Channels::Rgb
    );
}

#[test]
fn requested_alpha_is_opaque_where_the_picture_covers() {
    let extent = extent(20, 20);
    let grid = Grid::with_cell(20.0, 20.0, 5.0);
    let grown = posed(grid, |p| Point::new(p.x * 1.5 - 5.0, p.y * 1.5 - 5.0));
    for depth in [Depth::Eight, Depth::Sixteen] {
        let source = Arc::new(Source::new(noise(extent, Channels::Rgb, depth)));
        for mesh in [&Mesh::identity(grid), &grown] {
            let (without, rgb) = draw(&source, mesh, options(extent));
            let (with, rgba) = draw(
                &source,
                mesh,
                RenderOptions {
                    force_alpha: true,
                    ..options(extent)
                },
            );
            assert_eq!(
                (without.channels(), with.channels()),
                (Channels::Rgb, Channels::Rgba)
            );
            assert_eq!((without.adds_alpha(), with.adds_alpha()), (false, true));
            let bytes = depth.bytes();
            for (rgb, rgba) in rgb.chunks(3 * bytes).zip(rgba.chunks(4 * bytes)) {
                assert!(
                    rgba[..3 * bytes] == *rgb && rgba[3 * bytes..].iter().all(|byte| *byte == 255)
                );
            }
        }
    }
}

#[test]
fn colours_under_alpha_zero_leave_no_halo() {
    let size = 64;
    let pixels = (0..size * size).flat_map(|k| {
        let (x, y) = (f64::from(k % size) - 31.5, f64::from(k / size) - 31.5);
        if x.hypot(y) < 20.0 {
            [255, 0, 0, 255]
        } else {
            [0, 255, 0, 0]
        }
    });
    let source = Arc::new(Source::new(Pixmap::new(
        extent(64, 64),
        Channels::Rgba,
        Samples::Eight(pixels.collect()),
    )));
    let grid = Grid::with_cell(64.0, 64.0, 4.0);
    for (mesh, target) in [
        (swirl(grid, 1.0), extent(64, 64)),
        (waves(grid, 3, 0.8), extent(64, 64)),
        (waves(grid, 4, 0.5), extent(27, 27)),
        (swirl(grid, 0.3), extent(150, 150)),
    ] {
        let (_, out) = draw(&source, &mesh, options(target));
        let mut edge = 0;
        for pixel in out.chunks_exact(4) {
            assert!(pixel[3] == 0 || pixel[1] == 0, "{pixel:?}");
            assert!(pixel[3] == 0 || pixel[0] == 255, "{pixel:?}");
            edge += usize::from(pixel[3] > 0 && pixel[3] < 255);
        }
        assert!(edge > 20, "the disc has soft pixels");
    }
}

#[test]
fn outside_edge_repeats_the_border() {
    let source = Arc::new(Source::new(noise(
        extent(12, 10),
        Channels::Rgb,
        Depth::Eight,
    )));
    let grid = Grid::with_cell(12.0, 10.0, 3.0);
    let mesh = Mesh::new(grid, vec![[4.0, 3.0]; grid.len()]);
    let (_, out) = draw(
        &source,
        &mesh,
        RenderOptions {
            outside: Outside::Edge,
            ..options(extent(12, 10))
        },
    );
    let original = bytes(source.pixmap());
    for (k, drawn) in out.chunks_exact(3).enumerate() {
        let (x, y) = ((k % 12).saturating_sub(4), (k / 12).saturating_sub(3));
        assert_eq!(drawn, &original[(y * 12 + x) * 3..][..3], "pixel {k}");
    }
}

#[test]
fn later_cell_wins_where_the_picture_folds() {
    // Two columns of cells, the right one folded back over the left one.
    let grid = Grid::with_counts(20.0, 10.0, 3, 2);
    let pixels = (0..200)
        .flat_map(|k| {
            if k % 20 < 10 {
                [255, 0, 0]
            } else {
                [0, 0, 255]
            }
        })
        .collect();
    let source = Arc::new(Source::new(Pixmap::new(
        extent(20, 10),
        Channels::Rgb,
        Samples::Eight(pixels),
    )));
    let folded = posed(grid, |p| {
        Point::new(if p.x > 10.0 { 2.0 } else { p.x }, p.y)
    });
    let options = RenderOptions {
        outside: Outside::Colour([0, 255, 0, 255]),
        filter: Filter::Nearest,
        ..options(extent(20, 10))
    };
    let (_, out) = draw(&source, &folded, options);
    for (k, pixel) in out.chunks_exact(3).enumerate() {
        let expected = match k % 20 {
            0..2 => [255, 0, 0],
            2..10 => [0, 0, 255],
            _ => [0, 255, 0],
        };
        assert_eq!(pixel, expected, "pixel {k}");
    }
}

/// A wide source: positions beyond 512 px take more than 16 bits of fixed point.
#[test]
fn levels_give_the_same_bytes_across_wide_sources() {
    for (channels, depth) in kinds() {
        let wide = extent(8200, 11);
        let source = Arc::new(Source::new(noise(wide, channels, depth)));
        let grid = Grid::with_cell(8200.0, 11.0, 41.0);
        for (mesh, target) in [
            (Mesh::new(grid, vec![[1.0, 0.0]; grid.len()]), wide),
            (Mesh::new(grid, vec![[0.37, 0.21]; grid.len()]), wide),
            (waves(grid, 3, 0.3), extent(4100, 6)),
        ] {
            let reference = draw_on(SimdLevel::Scalar, &source, &mesh, options(target)).1;
            for &level in SimdLevel::available() {
                assert!(
                    draw_on(level, &source, &mesh, options(target)).1 == reference,
                    "{channels:?} {depth:?} {level:?}"
                );
            }
        }
        let shifted = Mesh::new(grid, vec![[1.0, 0.0]; grid.len()]);
        let (renderer, out) = draw(&source, &shifted, options(wide));
        if renderer.channels() == channels && channels == Channels::Rgba && depth == Depth::Eight {
            let Samples::Eight(samples) = source.pixmap().samples() else {
                panic!("eight bits")
            };
            for (got, want) in out
                .chunks_exact(8200 * 4)
                .zip(samples.chunks_exact(8200 * 4))
            {
                assert!(
                    got[4..] == want[..8199 * 4],
                    "a shift by one pixel moves pixels"
                );
            }
        }
    }
}

#[test]
fn levels_give_the_same_bytes() {
    for (seed, (channels, depth)) in (0..24).zip(kinds().cycle()) {
        let (width, height) = (30 + 13 * (seed as u32 % 7), 25 + 11 * (seed as u32 % 5));
        let source = Arc::new(Source::new(noise(extent(width, height), channels, depth)));
        let grid = Grid::with_counts(
            f64::from(width),
            f64::from(height),
            5 + 9 * (seed as u32 % 4),
            30 - 7 * (seed as u32 % 4),
        );
        let mesh = waves(grid, seed, [0.3, 0.9, 3.0][seed as usize % 3]);
        let outside = [
            Outside::Transparent,
            Outside::Edge,
            Outside::Colour([200, 100, 50, 128]),
        ][seed as usize / 2 % 3];
        let options = RenderOptions {
            outside,
            ..options(if seed % 2 == 0 {
                extent(width, height)
            } else {
                extent(2 * width + 3, height)
            })
        };
        let reference = draw_on(SimdLevel::Scalar, &source, &mesh, options).1;
        for level in SimdLevel::available() {
            assert!(
                draw_on(*level, &source, &mesh, options).1 == reference,
                "seed {seed}, {level:?}"
            );
        }
    }
}

#[test]
fn any_banding_gives_the_same_bytes() {
    let source = Arc::new(Source::new(noise(
        extent(90, 75),
        Channels::Rgba,
        Depth::Eight,
    )));
    let grid = Grid::with_cell(90.0, 75.0, 5.0);
    for (mesh, outside) in [
        (waves(grid, 1, 0.8), Outside::Edge),
        (waves(grid, 2, 4.0), Outside::Transparent),
        (swirl(grid, 2.0), Outside::Colour([1, 2, 3, 4])),
    ] {
        let renderer = Renderer::new(
            source.clone(),
            &mesh,
            RenderOptions {
                outside,
                ..options(extent(90, 75))
            },
        );
        let whole = banded(&renderer, 75);
        for rows in [1, 2, 7, 16, 33] {
            assert!(banded(&renderer, rows) == whole, "bands of {rows}");
        }
    }
}

/// Alpha 127 and 255 differ only in the sign of the stored value.
#[test]
fn half_transparent_texels_beside_opaque_ones_are_weighed_on_every_level() {
    let mut random = Noise(5);
    for _ in 0..40 {
        let samples = (0..60 * 40).flat_map(|_| {
            let colour = random.next();
            [
                colour as u8,
                (colour >> 8) as u8,
                (colour >> 16) as u8,
                if random.next() >> 31 == 0 { 127 } else { 255 },
            ]
        });
        let source = Arc::new(Source::new(Pixmap::new(
            extent(60, 40),
            Channels::Rgba,
            Samples::Eight(samples.collect()),
        )));
        // One column of texels, drawn broad: groups in which each pixel sees both.
        let mesh = posed(Grid::with_counts(60.0, 40.0, 2, 2), |p| {
            Point::new(p.x * 40.0 - 600.0, p.y)
        });
        let reference = draw_on(SimdLevel::Scalar, &source, &mesh, options(extent(60, 40))).1;
        for &level in SimdLevel::available() {
            assert!(
                draw_on(level, &source, &mesh, options(extent(60, 40))).1 == reference,
                "{level:?}"
            );
        }
    }
}
