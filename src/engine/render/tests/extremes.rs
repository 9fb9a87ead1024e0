//! Extreme meshes: no panic, no long run time, no access out of bounds.

use super::*;

fn small() -> (Arc<Source>, Grid) {
    (
        Arc::new(Source::new(noise(
            extent(40, 30),
            Channels::Rgba,
            Depth::Eight,
        ))),
        Grid::with_cell(40.0, 30.0, 4.0),
    )
}

#[test]
fn extreme_displacements_are_drawn() {
    let (source, grid) = small();
    for size in [1e4_f32, 1e6, 2.2e6, 1e12, 1e30, f32::MAX, f32::INFINITY] {
        for seed in 0..4 {
            let mut noise = Noise(seed);
            let displacement = (0..grid.len())
                .map(|_| [size * noise.signed() as f32, size * noise.signed() as f32])
                .collect();
            let mesh = Mesh::new(grid, displacement);
            for outside in [Outside::Transparent, Outside::Edge] {
                let options = RenderOptions {
                    outside,
                    ..options(extent(40, 30))
                };
                let (_, best) = draw(&source, &mesh, options);
                assert!(best == draw_on(SimdLevel::Scalar, &source, &mesh, options).1);
            }
        }
    }
}

/// Forty thousand cells, each larger than the target: minutes if all were painted.
#[test]
fn cells_that_cover_one_another_are_not_all_painted() {
    let source = Arc::new(Source::new(noise(
        extent(300, 300),
        Channels::Rgb,
        Depth::Eight,
    )));
    let grid = Grid::with_cell(300.0, 300.0, 1.5);
    let mut noise = Noise(3);
    let mesh = Mesh::new(
        grid,
        (0..grid.len())
            .map(|_| [1e5 * noise.signed() as f32, 1e5 * noise.signed() as f32])
            .collect(),
    );
    let renderer = Renderer::new(source, &mesh, options(extent(300, 300)));
    assert!(
        banded(&renderer, 300)
            .chunks_exact(4)
            .all(|pixel| pixel[3] == 255),
        "this number of cells leaves nothing uncovered"
    );
}

#[test]
fn nan_is_not_met_but_does_no_harm() {
    let (source, grid) = small();
    let mesh = Mesh::new(grid, vec![[f32::NAN, f32::NAN]; grid.len()]);
    draw(
        &source,
        &mesh,
        RenderOptions {
            outside: Outside::Edge,
            ..options(extent(40, 30))
        },
    );
}

#[test]
fn enormous_magnification_shows_one_place() {
    let (source, grid) = small();
    let centre = Point::new(17.5, 11.5);
    let mesh = posed(grid, |p| centre + (p - centre) * 50_000.0);
    let (renderer, out) = draw(&source, &mesh, options(extent(40, 30)));
    assert_eq!(renderer.channels(), Channels::Rgba);
    let at = 11 * 40 + 17;
    let texel = &bytes(source.pixmap())[4 * at..][..4];
    assert!(out.chunks_exact(4).all(|pixel| pixel == texel));
}

#[test]
fn far_off_the_canvas_edge_is_its_nearest_corner() {
    let (source, grid) = small();
    for (dx, dy, corner) in [
        (1e6, 1e6, 0),
        (-1e6, 1e6, 39),
        (1e6, -1e6, 29 * 40),
        (-1e5, -1e5, 29 * 40 + 39),
    ] {
        let mesh = Mesh::new(grid, vec![[dx, dy]; grid.len()]);
        let (_, out) = draw(
            &source,
            &mesh,
            RenderOptions {
                outside: Outside::Edge,
                ..options(extent(40, 30))
            },
        );
        let texel = &bytes(source.pixmap())[4 * corner..][..4];
        assert!(out.chunks_exact(4).all(|pixel| pixel == texel));
        let (_, clear) = draw(&source, &mesh, options(extent(40, 30)));
        assert!(clear.iter().all(|&byte| byte == 0));
    }
}

#[test]
fn source_bytes_bound_what_is_held() {
    for (channels, depth) in [
        (Channels::Rgb, Depth::Eight),
        (Channels::Rgba, Depth::Eight),
        (Channels::Rgba, Depth::Sixteen),
    ] {
        for (width, height) in [(1, 1), (37, 53), (200, 3)] {
            let source = Source::new(noise(extent(width, height), channels, depth));
            let mut held = 0;
            for k in 0..10 {
                let level = source.level(k);
                if k == 0 || level.pixmap().extent() != source.pixmap().extent() {
                    held += level.pixmap().bytes()
                        + level
                            .packed()
                            .map_or(0, |packed| packed.texels.capacity() * 4);
                }
            }
            assert!(
                held as u64 <= Source::bytes(extent(width, height), channels, depth),
                "{width} x {height}"
            );
        }
    }
}

#[test]
fn small_targets_read_reduced_sources() {
    let source = Source::new(noise(extent(501, 333), Channels::Rgb, Depth::Eight));
    let level = |width, height| source.level_for(extent(width, height));
    assert_eq!(
        [
            level(501, 333),
            level(251, 167),
            level(250, 166),
            level(126, 84),
            level(125, 83),
            level(1, 1)
        ],
        [0, 0, 1, 1, 2, 8]
    );
    assert_eq!(level(250, 333), 0, "neither axis is blurred");
    assert_eq!(source.level(1).pixmap().extent(), extent(251, 167));
}
