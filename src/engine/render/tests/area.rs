//! The coverage of pixels by the posed picture.

use super::super::Coverage;
use super::super::canvas::Canvas;
use super::*;

fn coverage(mesh: &Mesh, target: Extent, canvas: Canvas, band: usize) -> Vec<u8> {
    let drawn = Coverage::new(mesh, target, Some(canvas));
    let (width, height) = (target.width() as usize, target.height() as usize);
    let mut out = vec![7; width * height];
    for (k, out) in out.chunks_mut(width * band).enumerate() {
        let rows = (k * band) as u32..(k * band + out.len() / width) as u32;
        drawn.rows(rows, out, &|| false);
    }
    out
}

/// The area inside the posed border.
fn area(mesh: &Mesh) -> f64 {
    let (right, bottom) = (mesh.grid().columns() - 1, mesh.grid().rows() - 1);
    let top = (0..right).map(|i| (i, 0));
    let down = (0..bottom).map(|j| (right, j));
    let back = (1..=right).rev().map(|i| (i, bottom));
    let up = (1..=bottom).rev().map(|j| (0, j));
    let border: Vec<Point> = top
        .chain(down)
        .chain(back)
        .chain(up)
        .map(|(i, j)| mesh.posed(i, j))
        .collect();
    let turn = |(k, a): (usize, &Point)| {
        let b = border[(k + 1) % border.len()];
        a.x * b.y - a.y * b.x
    };
    border.iter().enumerate().map(turn).sum::<f64>() / 2.0
}

fn around(x: i32, y: i32, width: u32, height: u32) -> Canvas {
    Canvas {
        x,
        y,
        extent: extent(width, height),
    }
}

#[test]
fn the_sum_of_coverage_is_the_area() {
    let grid = || Grid::with_counts(200.0, 150.0, 41, 31);
    let turned = |angle: f64| {
        posed(grid(), move |p| {
            Point::new(
                p.x * angle.cos() - p.y * angle.sin(),
                p.x * angle.sin() + p.y * angle.cos(),
            )
        })
    };
    let meshes = [
        waves(grid(), 3, 0.9),
        waves(grid(), 4, 0.6),
        turned(0.3),
        turned(-1.2),
        posed(grid(), |p| p + Vec2::new(0.3, -0.45)),
    ];
    for (k, mesh) in meshes.iter().enumerate() {
        for (target, scale) in [
            (extent(600, 600), 1.0),
            (extent(300, 300), 0.5),
            (extent(1800, 1800), 3.0),
        ] {
            let drawn = coverage(mesh, target, around(-300, -300, 600, 600), 64);
            let sum = drawn.iter().map(|&value| f64::from(value)).sum::<f64>() / 255.0;
            let (want, partial) = (
                area(mesh) * scale * scale,
                drawn
                    .iter()
                    .filter(|value| !matches!(value, 0 | 255))
                    .count(),
            );
            // Half a step of rounding in pixels at the border, which cancels mostly.
            assert!(
                (sum - want).abs() < 0.05 + 0.1 * partial as f64 / 255.0 + want * 1e-6,
                "{k}, {scale}: {sum} {want}, {partial} px"
            );
            assert!(partial > 100, "{partial}");
        }
    }
}

#[test]
fn the_identity_and_whole_translations_are_all_or_nothing() {
    let grid = || Grid::with_counts(200.0, 150.0, 11, 16);
    for (dx, dy) in [(0, 0), (7, -3)] {
        let mesh = posed(grid(), |p| p + Vec2::new(dx.into(), dy.into()));
        let drawn = coverage(&mesh, extent(260, 200), around(-30, -20, 260, 200), 32);
        for (k, value) in (0..).zip(drawn) {
            let (x, y) = (k % 260 - 30 - dx, k / 260 - 20 - dy);
            assert_eq!(
                value,
                if (0..200).contains(&x) && (0..150).contains(&y) {
                    255
                } else {
                    0
                },
                "{x} {y}"
            );
        }
    }
}

/// Against 16 x 16 samples of each pixel.
#[test]
fn coverage_is_near_that_of_many_samples() {
    let grid = || Grid::with_counts(60.0, 50.0, 16, 11);
    let ring = posed(grid(), |p| {
        // Both ends of the picture overlap.
        let (angle, radius) = (p.x / 60.0 * 7.0, 12.0 + p.y * 0.3);
        Point::new(30.0 + radius * angle.cos(), 25.0 - radius * angle.sin())
    });
    let squeezed = posed(grid(), |p| Point::new(30.0 + (p.x - 30.0) * 1e-3, p.y));
    for (k, mesh) in [
        waves(grid(), 3, 0.9),
        waves(grid(), 5, 5.0),
        swirl(grid(), 4.0),
        ring,
        squeezed,
    ]
    .iter()
    .enumerate()
    {
        let canvas = around(-20, -20, 100, 90);
        let drawn = coverage(mesh, canvas.extent, canvas, 17);
        let fine = super::super::InverseMap::new(mesh, extent(1600, 1440), Some(canvas));
        let mut positions = vec![[0.0; 2]; 1600 * 1440];
        fine.rows(0..1440, &mut positions, &|| false);
        for (at, value) in drawn.iter().enumerate() {
            let (x, y) = (at % 100, at / 100);
            let samples = (0..256)
                .filter(|s| !positions[(16 * y + s / 16) * 1600 + 16 * x + s % 16][0].is_nan())
                .count();
            let differ = (f64::from(*value) / 255.0 - samples as f64 / 256.0).abs();
            assert!(differ < 0.1, "{k}: {x} {y}: {value} {samples}");
        }
    }
}

#[test]
fn bands_give_the_same_bytes_and_extreme_meshes_end() {
    let grid = || Grid::with_counts(200.0, 150.0, 41, 31);
    let mesh = waves(grid(), 5, 6.0);
    let canvas = around(-60, -50, 320, 250);
    assert!(
        coverage(&mesh, canvas.extent, canvas, 250) == coverage(&mesh, canvas.extent, canvas, 1)
    );
    for size in [1e5_f32, 1e12, f32::INFINITY, f32::NAN] {
        let mut noise = Noise(3);
        let mesh = Mesh::new(
            grid(),
            (0..grid().len())
                .map(|_| [size * noise.signed() as f32, size * noise.signed() as f32])
                .collect(),
        );
        coverage(&mesh, extent(100, 80), around(0, 0, 100, 80), 32);
    }
}
