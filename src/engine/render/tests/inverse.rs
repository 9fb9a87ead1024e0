//! The inverse map: the position that each pixel shows.

use super::super::InverseMap;
use super::super::canvas::Canvas;
use super::*;

fn positions(mesh: &Mesh, target: Extent, canvas: Option<Canvas>, band: usize) -> Vec<[f32; 2]> {
    banded_on(&InverseMap::new(mesh, target, canvas), band)
}

fn banded_on(map: &InverseMap, band: usize) -> Vec<[f32; 2]> {
    let (width, height) = (
        map.target().width() as usize,
        map.target().height() as usize,
    );
    let mut out = vec![[-7.0; 2]; width * height];
    for (k, out) in out.chunks_mut(width * band).enumerate() {
        let first = k * band;
        let rows = first as u32..(first + out.len() / width) as u32;
        map.rows(rows, out, &|| false);
    }
    out
}

fn bits(positions: &[[f32; 2]]) -> Vec<[u32; 2]> {
    positions
        .iter()
        .map(|position| position.map(f32::to_bits))
        .collect()
}

fn meshes() -> Vec<(&'static str, Mesh)> {
    let grid = || Grid::with_counts(200.0, 150.0, 41, 31);
    let turned = posed(grid(), |p| {
        Point::new(20.0 + 0.8 * p.x - 0.5 * p.y, -10.0 + 0.5 * p.x + 0.8 * p.y)
    });
    let mirrored = posed(grid(), |p| Point::new(200.0 - p.x, p.y));
    vec![
        ("waves", waves(grid(), 3, 0.9)),
        ("folds", waves(grid(), 5, 6.0)),
        ("swirl", swirl(grid(), 4.0)),
        ("turned", turned),
        ("mirrored", mirrored),
        ("refined", subdivided()),
    ]
}

/// Waves, with a few cells that are drawn as smaller ones.
fn subdivided() -> Mesh {
    use crate::geometry::Subdivision;
    let mesh = waves(Grid::with_counts(200.0, 150.0, 21, 16), 8, 0.8);
    let mut subdivision = Subdivision::default();
    for (column, row, level) in [(3_u32, 2_u32, 2_u8), (4, 2, 1), (10, 7, 3), (19, 14, 2)] {
        let (parts, from) = (1 << level, mesh.grid().vertex(column, row));
        let at = |k: u32| 10.0 * f64::from(k) / f64::from(parts);
        let places = (0..=parts).flat_map(|b| (0..=parts).map(move |a| (a, b)));
        let vertices: Vec<[f32; 2]> = places
            .map(|(a, b)| {
                let p = from + Vec2::new(at(a), at(b));
                let bump = ((at(a) * (10.0 - at(a)) * at(b) * (10.0 - at(b))) / 625.0).min(1.0);
                let d = mesh.map(p).unwrap() - p + Vec2::new(bump, -0.7 * bump);
                [d.x as f32, d.y as f32]
            })
            .collect();
        subdivision.push(column, row, level, &vertices);
    }
    subdivision.join(mesh.grid(), |cell, _| cell.level);
    mesh.subdivided(subdivision)
}

#[test]
fn the_identity_is_exact() {
    let mesh = Mesh::identity(Grid::with_counts(200.0, 150.0, 11, 16));
    for (x, y, size) in [
        (0, 0, extent(200, 150)),
        (-3, 5, extent(210, 20)),
        (190, 140, extent(30, 30)),
    ] {
        let map = positions(&mesh, size, Some(Canvas { x, y, extent: size }), 7);
        for (k, position) in (0..).zip(&map) {
            let (at_x, at_y) = (x + k % size.width() as i32, y + k / size.width() as i32);
            let is_inside = (0..200).contains(&at_x) && (0..150).contains(&at_y);
            let want = if is_inside {
                [at_x as f32 + 0.5, at_y as f32 + 0.5]
            } else {
                [f32::NAN; 2]
            };
            assert_eq!(
                position.map(f32::to_bits),
                want.map(f32::to_bits),
                "{at_x}, {at_y}"
            );
        }
    }
}

#[test]
fn a_translation_moves_every_position_by_the_same() {
    let mesh = posed(Grid::with_counts(200.0, 150.0, 11, 16), |p| {
        p + Vec2::new(20.25, -10.5)
    });
    let map = positions(&mesh, extent(200, 150), None, 150);
    for (k, position) in map.iter().enumerate() {
        let (x, y) = (
            (k % 200) as f32 + 0.5 - 20.25,
            (k / 200) as f32 + 0.5 + 10.5,
        );
        if x < 0.0 || y >= 150.0 {
            assert!(position[0].is_nan() && position[1].is_nan(), "{k}");
        } else {
            assert!(
                (position[0] - x).abs() < 1e-3 && (position[1] - y).abs() < 1e-3,
                "{position:?} {x} {y}"
            );
        }
    }
}

#[test]
fn the_mesh_takes_every_position_to_its_pixel() {
    for (name, mesh) in meshes() {
        for (target, canvas) in [
            (extent(200, 150), None),
            (extent(400, 300), None),
            (
                extent(300, 260),
                Some(Canvas {
                    x: -40,
                    y: -30,
                    extent: extent(300, 260),
                }),
            ),
            (
                extent(75, 65),
                Some(Canvas {
                    x: -40,
                    y: -30,
                    extent: extent(300, 260),
                }),
            ),
        ] {
            let map = positions(&mesh, target, canvas, 64);
            let [left, top, right, bottom] =
                canvas.map_or([0.0, 0.0, 200.0, 150.0], |canvas| canvas.edges());
            let (px, py) = (
                (right - left) / f64::from(target.width()),
                (bottom - top) / f64::from(target.height()),
            );
            let (mut drawn, mut far) = (0, 0);
            for (k, [x, y]) in map.iter().enumerate().filter(|(_, [x, _])| !x.is_nan()) {
                let at = Point::new(
                    left + px * ((k % target.width() as usize) as f64 + 0.5),
                    top + py * ((k / target.width() as usize) as f64 + 0.5),
                );
                let shown = mesh
                    .map(Point::new((*x).into(), (*y).into()))
                    .expect("in the source");
                drawn += 1;
                // 1/16 px of the source, which folded cells may exceed, and the snapping of
                // vertices.
                far += usize::from(shown.distance(at) > 0.13);
            }
            assert!(drawn * 4 > map.len(), "{name}: {drawn}");
            let most = if name == "folds" || name == "swirl" {
                drawn / 20
            } else {
                0
            };
            assert!(far <= most, "{name}, {target:?}: {far} of {drawn}");
        }
    }
}

/// In every pixel the position lies in the source pixel that the nearest filter shows, in folds as
/// well, and NaN is where it shows nothing.
#[test]
fn positions_are_those_that_the_nearest_filter_samples() {
    let size = extent(200, 150);
    let samples = (0..150_u16)
        .flat_map(|y| (0..200_u16).flat_map(move |x| [x + 1, y + 1, 0, u16::MAX]))
        .collect();
    let source = Arc::new(Source::new(Pixmap::new(
        size,
        Channels::Rgba,
        Samples::Sixteen(samples),
    )));
    for (name, mesh) in meshes() {
        for canvas in [
            None,
            Some(Canvas {
                x: -1050,
                y: -30,
                extent: extent(1300, 220),
            }),
        ] {
            let target = canvas.map_or(size, |canvas| canvas.extent);
            let (_, drawn) = draw(
                &source,
                &mesh,
                RenderOptions {
                    target,
                    canvas,
                    filter: Filter::Nearest,
                    outside: Outside::Transparent,
                    force_alpha: false,
                },
            );
            let map = positions(&mesh, target, canvas, 50);
            for (k, (pixel, [x, y])) in drawn.as_chunks::<8>().0.iter().zip(&map).enumerate() {
                let shown = [0, 1].map(|c| u16::from_be_bytes([pixel[2 * c], pixel[2 * c + 1]]));
                let want = if x.is_nan() {
                    [0, 0]
                } else {
                    [x.min(199.0) as u16 + 1, y.min(149.0) as u16 + 1]
                };
                assert_eq!(shown, want, "{name}, pixel {k}: {x} {y}");
            }
        }
    }
}

#[test]
fn bands_canvases_and_levels_give_the_same_bits() {
    let whole = Canvas {
        x: -60,
        y: -50,
        extent: extent(320, 250),
    };
    for (name, mesh) in meshes() {
        let all = bits(&positions(&mesh, whole.extent, Some(whole), 250));
        assert!(
            all == bits(&positions(&mesh, whole.extent, Some(whole), 3)),
            "{name}"
        );
        for level in [SimdLevel::Scalar, SimdLevel::Avx2] {
            let map = InverseMap::with_level(&mesh, whole.extent, Some(whole), level);
            assert!(all == bits(&banded_on(&map, 32)), "{name}, {level:?}");
        }
        let part = Canvas {
            x: -10,
            y: 40,
            extent: extent(77, 60),
        };
        let crop = bits(&positions(&mesh, part.extent, Some(part), 13));
        for (k, row) in crop.chunks_exact(77).enumerate() {
            assert!(*row == all[(90 + k) * 320 + 50..][..77], "{name}, row {k}");
        }
    }
}
