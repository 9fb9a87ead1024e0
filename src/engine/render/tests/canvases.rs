//! Canvases: a canvas inside a larger one of the same scale is an exact crop of it.

use super::super::canvas::Canvas;
use super::*;

fn canvas(x: i32, y: i32, width: u32, height: u32) -> Canvas {
    Canvas {
        x,
        y,
        extent: extent(width, height),
    }
}

/// Draws a canvas at a scale (target px per source px as a ratio) in bands; RGBA.
fn drawn(
    source: &Arc<Source>,
    mesh: &Mesh,
    canvas: Option<Canvas>,
    (up, down): (u32, u32),
    options: RenderOptions,
) -> Vec<u8> {
    let shown = canvas.map_or(source.pixmap().extent(), |canvas| canvas.extent);
    assert!(
        shown.width().is_multiple_of(down) && shown.height().is_multiple_of(down),
        "whole px"
    );
    let options = RenderOptions {
        canvas,
        target: extent(shown.width() / down * up, shown.height() / down * up),
        ..options
    };
    let renderer = Renderer::new(source.clone(), mesh, options);
    let out = banded(&renderer, 37);
    match renderer.channels() {
        Channels::Rgba => out,
        Channels::Rgb => {
            let bytes = renderer.depth().bytes();
            out.chunks_exact(3 * bytes)
                .flat_map(|p| p.iter().copied().chain(std::iter::repeat_n(255, bytes)))
                .collect()
        }
    }
}

/// The part of a drawn canvas that another one shows.
fn crop(out: &[u8], whole: Canvas, part: Canvas, (up, down): (u32, u32), bytes: usize) -> Vec<u8> {
    let scaled = |length: u32| (length / down * up) as usize;
    let (left, top) = (
        scaled((part.x - whole.x) as u32),
        scaled((part.y - whole.y) as u32),
    );
    let (pitch, width) = (
        scaled(whole.extent.width()) * 4 * bytes,
        scaled(part.extent.width()) * 4 * bytes,
    );
    let rows = top..top + scaled(part.extent.height());
    rows.flat_map(|row| {
        out[row * pitch + left * 4 * bytes..][..width]
            .iter()
            .copied()
    })
    .collect()
}

fn sources() -> Vec<(&'static str, Arc<Source>)> {
    let rgb = astronaut();
    let alpha = cut_out(&rgb);
    let Samples::Eight(samples) = rgb.samples() else {
        panic!("8 bit")
    };
    let wide = Samples::Sixteen(samples.iter().map(|s| u16::from(*s) * 257).collect());
    let wide = Pixmap::new(rgb.extent(), Channels::Rgb, wide);
    [("RGB", rgb), ("RGBA", alpha), ("16 bit", wide)]
        .map(|(name, pixmap)| (name, Arc::new(Source::new(pixmap))))
        .into()
}

fn meshes() -> Vec<(&'static str, Mesh)> {
    let grid = || Grid::with_counts(512.0, 512.0, 41, 37);
    let turned = posed(grid(), |p| {
        Point::new(60.0 + 0.8 * p.x - 0.5 * p.y, -40.0 + 0.5 * p.x + 0.8 * p.y)
    });
    vec![
        ("identity", Mesh::identity(grid())),
        ("waves", waves(grid(), 3, 14.0)),
        ("folds", waves(grid(), 5, 90.0)),
        ("swirl", swirl(grid(), 4.0)),
        ("turned", turned),
    ]
}

#[test]
fn a_canvas_in_a_larger_one_is_an_exact_crop_of_it() {
    let whole = canvas(-64, -128, 704, 768);
    let parts = [
        None,
        Some(canvas(-64, -128, 8, 768)),
        Some(canvas(-4, 100, 520, 12)),
        Some(canvas(256, 256, 64, 64)),
        Some(canvas(300, -40, 340, 600)),
    ];
    let scales = [(1, 1), (1, 4), (3, 2)];
    // Each source, mesh and border meets each scale; all of them at once only in the long form.
    let is_full = std::env::var_os("MLSWARP_TESTS_FULL").is_some();
    for (i, (name, source)) in sources().into_iter().enumerate() {
        let bytes = source.pixmap().depth().bytes();
        for (j, (shape, mesh)) in meshes().into_iter().enumerate() {
            for (k, (outside, filter)) in [
                (Outside::Transparent, Filter::Bilinear),
                (Outside::Edge, Filter::Nearest),
                (Outside::Colour([9, 8, 7, 200]), Filter::Bilinear),
            ]
            .into_iter()
            .enumerate()
            {
                let met = scales[(i + j + k) % 3];
                for scale in scales.into_iter().filter(|s| is_full || *s == met) {
                    let options = RenderOptions {
                        filter,
                        outside,
                        ..options(extent(1, 1))
                    };
                    let all = drawn(&source, &mesh, Some(whole), scale, options);
                    for part in parts {
                        let out = drawn(&source, &mesh, part, scale, options);
                        let shown = part.unwrap_or(canvas(0, 0, 512, 512));
                        let want = crop(&all, whole, shown, scale, bytes);
                        let differing = out.iter().zip(&want).position(|(a, b)| a != b);
                        assert_eq!(out.len(), want.len());
                        assert_eq!(
                            differing, None,
                            "{name}, {shape}, {outside:?}, {scale:?}, {part:?}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn a_canvas_far_away_shows_what_is_drawn_near_the_origin() {
    let source = Arc::new(Source::new(astronaut()));
    let grid = || Grid::with_counts(512.0, 512.0, 41, 37);
    let near = waves(grid(), 3, 14.0);
    let here = drawn(
        &source,
        &near,
        Some(canvas(-40, -40, 600, 600)),
        (1, 1),
        options(extent(1, 1)),
    );
    for (dx, dy) in [
        (16_384, 0),
        (-100_000, 300_000),
        (-1024, -16_384),
        (16_200, -1200),
    ] {
        let moved = posed(grid(), |p| {
            near.map(p).unwrap() + Vec2::new(f64::from(dx), f64::from(dy))
        });
        let there = drawn(
            &source,
            &moved,
            Some(canvas(dx - 40, dy - 40, 600, 600)),
            (1, 1),
            options(extent(1, 1)),
        );
        // Displacements are f32, so those of a large translation have fewer digits.
        let differ = here
            .iter()
            .zip(&there)
            .filter(|(a, b)| a.abs_diff(**b) > 12)
            .count();
        assert!(
            differ < here.len() / 500,
            "{dx}, {dy}: {differ} of {}",
            here.len()
        );
    }
}

#[test]
fn a_canvas_beside_the_picture_is_empty() {
    let source = Arc::new(Source::new(astronaut()));
    for (shape, mesh) in meshes() {
        let out = drawn(
            &source,
            &mesh,
            Some(canvas(5000, -3000, 64, 64)),
            (1, 1),
            options(extent(1, 1)),
        );
        assert!(out.iter().all(|&sample| sample == 0), "{shape}");
        let edge = RenderOptions {
            outside: Outside::Edge,
            ..options(extent(1, 1))
        };
        let out = drawn(
            &source,
            &mesh,
            Some(canvas(5000, -3000, 64, 64)),
            (1, 1),
            edge,
        );
        assert!(out.chunks_exact(4).all(|pixel| pixel[3] == 255), "{shape}");
    }
}
