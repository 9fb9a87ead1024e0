//! Cells that are drawn in another order than row by row.

use super::*;
use crate::geometry::DrawingOrder;
use crate::render::InverseMap;

/// Folded waves, and an order by waves of depth across them.
fn ordered(side: f64, seed: u64) -> Mesh {
    let grid = Grid::with_cell(150.0, 110.0, side);
    let mesh = waves(grid, seed, 6.0);
    let vertices = (0..grid.rows()).flat_map(|j| (0..grid.columns()).map(move |i| (i, j)));
    let depth: Vec<f32> = vertices
        .map(|(i, j)| grid.vertex(i, j))
        .map(|p| ((p.x * 0.07).sin() + (p.y * 0.11).cos()) as f32)
        .collect();
    let order = DrawingOrder::of_grid(&grid, &depth, &|| false).unwrap();
    mesh.in_order(order.map(Arc::new))
}

#[test]
fn the_cell_of_the_highest_rank_is_drawn_at_every_level() {
    let size = extent(150, 110);
    for (side, seed) in [(4.0, 1), (6.0, 2)] {
        let mesh = ordered(side, seed);
        let plain = mesh.clone().in_order(None);
        let expected = reference::places(&mesh, size);
        let differs = |a: &Option<Point>, b: &Option<Point>| match (a, b) {
            (Some(a), Some(b)) => a.distance(*b) > 1.0,
            _ => false,
        };
        let by_rows = reference::places(&plain, size);
        let matters: Vec<bool> = expected
            .iter()
            .zip(&by_rows)
            .map(|(a, b)| differs(a, b))
            .collect();
        let mut first: Option<Vec<[f32; 2]>> = None;
        for level in [SimdLevel::Scalar, SimdLevel::Avx2, SimdLevel::Avx512] {
            for rows in [1, 7, 32, 110] {
                let map = InverseMap::with_level(&mesh, size, None, level);
                let mut drawn = vec![[0.0; 2]; 150 * 110];
                for (k, out) in drawn.chunks_mut(150 * rows).enumerate() {
                    let top = (k * rows) as u32;
                    map.rows(top..top + (out.len() / 150) as u32, out, &|| false);
                }
                let bits = |all: &[[f32; 2]]| {
                    let all = all.iter();
                    all.map(|at| at.map(f32::to_bits)).collect::<Vec<_>>()
                };
                match &first {
                    Some(first) => assert_eq!(bits(&drawn), bits(first), "{level:?} {rows}"),
                    None => first = Some(drawn),
                }
            }
        }
        let shown = |at: &[f32; 2]| {
            let [x, y] = at.map(f64::from);
            (!x.is_nan()).then(|| Point::new(x, y))
        };
        let drawn = first.unwrap();
        let of_order = drawn.iter().map(shown).zip(&expected).zip(matters);
        let of_order: Vec<bool> = of_order
            .filter(|(_, matters)| *matters)
            .map(|((drawn, expected), _)| !differs(&drawn, expected))
            .collect();
        let right = of_order.iter().filter(|right| **right).count();
        // Cells that are not convex are two triangles here, and none in the reference.
        assert!(
            of_order.len() > 50 && right * 10 > of_order.len() * 8,
            "{right} of {}, cells of {side}",
            of_order.len()
        );
    }
}

#[test]
fn bands_that_nobody_waits_for_are_given_up_at_the_next_look() {
    let size = extent(150, 110);
    let ordered = ordered(2.0, 1);
    let source = Arc::new(Source::new(noise(size, Channels::Rgba, Depth::Eight)));
    for (name, mesh) in [
        ("plain", ordered.clone().in_order(None)),
        ("ordered", ordered),
    ] {
        let map = InverseMap::new(&mesh, size, None);
        let options = RenderOptions {
            target: size,
            canvas: None,
            filter: Filter::Bilinear,
            outside: Outside::Transparent,
            force_alpha: true,
        };
        let renderer = Renderer::new(Arc::clone(&source), &mesh, options);
        let asked = std::cell::Cell::new(0);
        let draw = |after: usize| {
            asked.set(0);
            let cancelled = || {
                asked.set(asked.get() + 1);
                asked.get() > after
            };
            map.rows(0..110, &mut vec![[0.0; 2]; 150 * 110], &cancelled);
            let of_map = asked.take();
            renderer.band(0..110, &mut vec![0; 150 * 110 * 4], &cancelled);
            [of_map, asked.get()]
        };
        let looks = draw(usize::MAX);
        // More than one for each strip.
        assert!(looks.iter().all(|looks| *looks > 20), "{name}: {looks:?}");
        for after in [0, 1, looks[0] / 3, looks[0] - 1] {
            let [of_map, of_band] = draw(after);
            // One more look at most, where a strip ends.
            let soon = after + 1..=after + 2;
            assert!(soon.contains(&of_map), "{name}: {of_map} after {after}");
            assert!(soon.contains(&of_band), "{name}: {of_band} after {after}");
        }
    }
}
