use std::cell::Cell;
use std::sync::Arc;

use serde_json::Value;

use super::*;
use crate::geometry::Point;

fn cases(kind: &str) -> Vec<Value> {
    let file: Value = serde_json::from_str(include_str!("../test_files/rivals.json")).unwrap();
    file[kind].as_array().unwrap().clone()
}

fn point(value: &Value) -> Point {
    Point::new(value[0].as_f64().unwrap(), value[1].as_f64().unwrap())
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().unwrap()
}

/// 1: inside, +: rim.
fn mask_of(rows: &[&str]) -> Mask {
    let [width, height] = [rows[0].len(), rows.len()].map(|side| u32::try_from(side).unwrap());
    let fill = |y: u32, row: &mut [Membership]| {
        for (membership, pixel) in row.iter_mut().zip(rows[y as usize].bytes()) {
            *membership = match pixel {
                b'1' => Membership::Inside,
                b'+' => Membership::Rim,
                _ => Membership::Outside,
            };
        }
    };
    Mask::new(width, height, fill, &|| false).unwrap()
}

fn mask_of_case(case: &Value) -> Mask {
    let rows: Vec<&str> = list(&case["mask"])
        .iter()
        .map(|row| row.as_str().unwrap())
        .collect();
    mask_of(&rows)
}

fn nodes(mask: Mask, stride: usize) -> Arc<Nodes> {
    Arc::new(Nodes::new(Arc::new(mask), stride, 1 << 24, &|| false).unwrap())
}

fn distances(nodes: &Arc<Nodes>, source: PathOrigin) -> Distances {
    Distances::new(nodes, source, &|| false).unwrap().unwrap()
}

fn distance_at(distances: &Distances, nodes: &Nodes, v: Point) -> f64 {
    let pixel = nodes.mask().pixel_at(v, 0.0).unwrap();
    distances.at(pixel, v, &mut Sights::default())
}

#[test]
fn distances_are_those_of_the_reference_cases() {
    for (stride, tolerance) in [(1, 1e-4), (2, 0.75)] {
        for case in cases("geodesic_cases") {
            let nodes = nodes(mask_of_case(&case), stride);
            assert_eq!(
                nodes.corners() as u64,
                case["reflex_corners"].as_u64().unwrap()
            );
            let handles = list(&case["handles"]["points"]).iter();
            for (handle, expected) in handles.zip(list(&case["distances"])) {
                let from_handle = distances(&nodes, PathOrigin::Point(point(&handle["p"])));
                for (v, expected) in list(&case["vertices"]).iter().zip(list(expected)) {
                    let found = distance_at(&from_handle, &nodes, point(v));
                    let is_right = match expected.as_f64() {
                        Some(expected) => (found - expected).abs() <= tolerance,
                        None => found.is_infinite(),
                    };
                    assert!(is_right, "{} {v}: {found}, not {expected}", case["name"]);
                }
            }
        }
    }
}

#[test]
fn the_lattice_has_the_quads_of_the_reference_cases() {
    for case in cases("arap_cases") {
        let mask = mask_of_case(&case);
        let spacing = u32::try_from(case["spacing"].as_u64().unwrap()).unwrap();
        let lattice = CutLattice::new(&mask, spacing, 1 << 20, &|| false).unwrap();
        let quads = list(&case["quads"]);
        assert_eq!(lattice.quads().len(), quads.len(), "{}", case["name"]);
        assert_eq!(lattice.vertices().len(), list(&case["vertices"]).len());
        let mut same = std::collections::BTreeMap::new();
        for (k, (quad, expected)) in lattice.quads().iter().zip(quads).enumerate() {
            assert_eq!(
                u64::from(quad.part),
                case["quad_parts"][k].as_u64().unwrap()
            );
            for (corner, vertex) in quad.vertices.iter().enumerate() {
                let expected = usize::try_from(expected[corner].as_u64().unwrap()).unwrap();
                assert_eq!(*same.entry(*vertex).or_insert(expected), expected);
                let [x, y] = lattice.vertices()[*vertex as usize];
                let at = [x, y].map(|line| f64::from(line * spacing));
                assert_eq!(Point::new(at[0], at[1]), point(&case["vertices"][expected]));
            }
        }
    }
}

#[test]
fn the_rim_follows_what_it_touches_and_joins_nothing() {
    let mask = mask_of(&[
        "11111111++", //
        "11++++1100",
        "11+00+1100",
        "11++++110+",
    ]);
    let lattice = CutLattice::new(&mask, 10, 100, &|| false).unwrap();
    // The legs are one piece above; the stray pixel is another one.
    assert_eq!(lattice.quads().len(), 2);
    // Below the body they are two, each with its rim.
    let lattice = CutLattice::new(&mask, 2, 100, &|| false).unwrap();
    let quad = |x, y| {
        lattice
            .quad_at(&mask, x, y)
            .map(|quad| lattice.quads()[quad])
    };
    assert_eq!(quad(2, 2).map(|quad| quad.cell), Some([1, 1]));
    assert_ne!(quad(2, 3), quad(5, 3));
    assert_eq!(lattice.quads_of(1, 1).len(), 1);
    assert_eq!(quad(3, 2), None);
    let [left, right] = [quad(2, 3), quad(5, 3)].map(|quad| quad.unwrap().vertices);
    assert!(left.iter().all(|vertex| !right.contains(vertex)));
    let stray = quad(9, 3).unwrap().part;
    assert!(quad(9, 0).unwrap().part != stray && mask.is_stray(9, 3));
    assert_eq!(mask.root(9, 0), Some((7, 0)));
}

#[test]
fn stray_rim_is_a_part_of_its_own() {
    let mask = mask_of(&["0000000", "0+++000", "0+0+001", "0+++000"]);
    let lattice = CutLattice::new(&mask, 3, 100, &|| false).unwrap();
    assert_eq!(lattice.parts(), 2);
    assert!((1..4).all(|x| mask.is_stray(x, 1) && mask.is_stray(x, 3)));
    // Alone with a pixel inside, above or below it.
    for (distance, goes_with) in [(16, true), (17, false)] {
        let mut rows = vec!["0"; distance + 1];
        (rows[0], rows[distance]) = ("1", "+");
        assert_eq!(mask_of(&rows).root(0, distance).is_some(), goes_with);
        rows.reverse();
        assert_eq!(mask_of(&rows).root(0, 0).is_some(), goes_with);
    }
    // Where there is nothing inside, each row is looked at five times, and nothing is searched.
    let looks = Cell::new(0);
    let look = || {
        looks.set(looks.get() + 1);
        false
    };
    let mask = Mask::new(9, 400, |_, row| row.fill(Membership::Rim), &look).unwrap();
    assert!(mask.is_stray(4, 200) && mask.root(4, 200).is_none() && looks.get() <= 5 * 400);
}

#[test]
fn dust_goes_with_the_nearest_pixel_inside() {
    // Without an order: the body, dust near it, and what reaches farther than dust does.
    let noise = |y: u32, row: &mut [Membership]| {
        for (x, membership) in (0_u32..).zip(row) {
            *membership = match (x * 7919 + y * 104_729 + (x * y) % 13 * 31) % 97 {
                0 if x < 70 => Membership::Inside,
                1..30 => Membership::Rim,
                _ => Membership::Outside,
            };
        }
    };
    let mask = Mask::new(120, 90, noise, &|| false).unwrap();
    let all = || (0..90).flat_map(|y| (0..120).map(move |x| (x, y)));
    let distance2 =
        |a: (usize, usize), b: (usize, usize)| a.0.abs_diff(b.0).pow(2) + a.1.abs_diff(b.1).pow(2);
    let nearest = |pixel| {
        let inside = all().filter(|(x, y)| mask.is_inside(*x, *y));
        let of = |inside| (distance2(pixel, inside), inside.1, inside.0);
        let (distance2, y, x) = inside.map(of).min().unwrap();
        (distance2 <= 256).then_some((x, y))
    };
    let mut found = [0; 3];
    for (x, y) in all().filter(|(x, y)| mask.is_stray(*x, *y)) {
        let (root, expected) = (mask.root(x, y), nearest((x, y)));
        // A piece that is somewhere far from all goes with nothing.
        let beside = [(x + 1, y), (x, y + 1)];
        let mut beside = beside.iter().filter(|(x, y)| mask.is_stray(*x, *y));
        assert!(beside.all(|(x, y)| mask.root(*x, *y).is_some() == root.is_some()));
        assert!(root.is_none() || root == expected, "{x} {y}");
        let kind = usize::from(expected.is_some()) + usize::from(root.is_some());
        found[kind] += 1;
    }
    assert!(found.iter().all(|kind| *kind > 10), "{found:?}");
}

#[test]
fn a_full_mask_has_straight_distances_and_one_part() {
    let rows = vec!["1".repeat(300); 200];
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let nodes = nodes(mask_of(&rows), 1);
    assert!(nodes.mask().is_everything() && nodes.corners() == 0);
    let p = Point::new(17.3, 181.0);
    let from_p = distances(&nodes, PathOrigin::Point(p));
    for k in 0..500 {
        let v = Point::new(f64::from(k * 37 % 300), f64::from(k * 11 % 200) + 0.25);
        assert_eq!(distance_at(&from_p, &nodes, v), p.distance(v));
    }
    let lattice = CutLattice::new(nodes.mask(), 7, 1 << 20, &|| false).unwrap();
    assert_eq!((lattice.parts(), lattice.quads().len()), (1, 43 * 29));
    assert_eq!(lattice.vertices().len(), 44 * 30);
}

#[test]
fn distances_from_a_segment_are_the_least_from_its_positions() {
    let case = &cases("geodesic_cases")[2];
    let nodes = nodes(mask_of_case(case), 1);
    let (a, b) = (Point::new(2.25, 3.5), Point::new(11.5, 4.25));
    let from_segment = distances(&nodes, PathOrigin::Segment(a, b));
    let along = (0..=400).map(|k| a.lerp(b, f64::from(k) / 400.0));
    let from_points: Vec<Distances> = along
        .map(|p| distances(&nodes, PathOrigin::Point(p)))
        .collect();
    for v in list(&case["vertices"]) {
        let v = point(v);
        let least = from_points
            .iter()
            .map(|from| distance_at(from, &nodes, v))
            .fold(f64::INFINITY, f64::min);
        let found = distance_at(&from_segment, &nodes, v);
        assert!((found - least).abs() < 0.01, "{v:?}: {found}, not {least}");
    }
    let across = PathOrigin::Segment(Point::new(1.0, 30.0), Point::new(35.0, 30.0));
    assert!(Distances::new(&nodes, across, &|| false).is_err());
}

#[test]
fn a_handle_beside_the_mask_is_on_its_nearest_pixel() {
    let nodes = nodes(mask_of(&["00000000", "01100000", "01100000"]), 1);
    let from = |x, y| Distances::new(&nodes, PathOrigin::Point(Point::new(x, y)), &|| false);
    assert!(
        from(5.9, 2.0)
            .unwrap()
            .is_some_and(|distances| distances.reaches(1, 1))
    );
    assert!(from(6.1, 2.0).is_err() && from(-1e6, f64::MAX).is_err());
    assert!(Distances::new(&nodes, PathOrigin::Point(Point::new(2.0, 2.0)), &|| true).is_ok());
}

/// One pixel wide, to the middle and nowhere else.
fn spiral(side: usize) -> Vec<String> {
    let mut rows = vec![vec![b'0'; side]; side];
    let (mut x, mut y, mut dx, mut dy) = (0_usize, 0_usize, 1_isize, 0_isize);
    let (mut length, mut leg) = (side - 1, 0);
    rows[0][0] = b'1';
    while length > 1 {
        for _ in 0..length {
            x = x.checked_add_signed(dx).unwrap();
            y = y.checked_add_signed(dy).unwrap();
            rows[y][x] = b'1';
        }
        (dx, dy, leg) = (-dy, dx, leg + 1);
        if leg >= 3 && leg % 2 == 1 {
            length = length.saturating_sub(2);
        }
    }
    rows.into_iter()
        .map(|row| String::from_utf8(row).unwrap())
        .collect()
}

/// One part for every second pixel.
fn checkerboard(y: u32, row: &mut [Membership]) {
    for (x, membership) in (0..).zip(row) {
        let is_inside = (x + y).is_multiple_of(2);
        *membership = if is_inside {
            Membership::Inside
        } else {
            Membership::Outside
        };
    }
}

#[test]
fn hostile_masks_take_bounded_work_and_memory() {
    let rows = spiral(301);
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let pixels = rows
        .iter()
        .flat_map(|row| row.bytes())
        .filter(|pixel| *pixel == b'1')
        .count();
    let nodes = nodes(mask_of(&rows), 1);
    let from_end = distances(&nodes, PathOrigin::Point(Point::new(0.5, 0.5)));
    let middle = (0..301)
        .flat_map(|y| (0..301).map(move |x| (x, y)))
        .filter(|(x, y)| nodes.mask().is_inside(*x, *y))
        .map(|(x, y)| {
            distance_at(
                &from_end,
                &nodes,
                Point::new(x as f64 + 0.5, y as f64 + 0.5),
            )
        })
        .fold(0.0, f64::max);
    assert!(
        middle > 0.99 * pixels as f64 && middle < pixels as f64,
        "{middle} of {pixels}"
    );

    let mask = Arc::new(Mask::new(600, 400, checkerboard, &|| false).unwrap());
    let too_many = Nodes::new(Arc::clone(&mask), Nodes::stride_of(&mask), 1000, &|| false);
    assert_eq!(too_many.unwrap_err(), NoNodes::TooMany(120_000));
    let stride = Nodes::stride_of(&mask);
    let size = Nodes::size(&mask, stride, &|| false).unwrap();
    assert_eq!((size.nodes, size.split), (120_000, size.blocks));
    let all = Nodes::new(Arc::clone(&mask), stride, 1 << 20, &|| false).unwrap();
    assert!(all.bytes() <= Nodes::kept_bytes(size.nodes) + size.block_bytes(stride));
    assert!(Nodes::size(&mask, stride, &|| true).is_none());
    assert!(CutLattice::new(&mask, 8, 1000, &|| false).is_none());
    let all = CutLattice::new(&mask, 8, 1 << 20, &|| false).unwrap();
    assert_eq!((all.quads().len(), all.parts()), (120_000, 120_000));
    assert!(Mask::new(600, 400, checkerboard, &|| true).is_none());
}

#[test]
fn quads_draw_their_texels_and_those_beside_them() {
    // Inside, rim and nothing without an order, a body with legs, and what is drawn whole.
    let noise = |y: u32, row: &mut [Membership]| {
        for (x, membership) in (0_u32..).zip(row) {
            let hash = (x * 7919 + y * 104_729 + (x * y) % 13 * 31) % 17;
            *membership = match hash {
                _ if y < 9 || x > 30 && x % 4 < 2 => Membership::Inside,
                0..8 => Membership::Inside,
                8..11 => Membership::Rim,
                _ => Membership::Outside,
            };
        }
    };
    let mask = Mask::new(53, 41, noise, &|| false).unwrap();
    for side in [1_u32, 2, 5, 8, 20, 64] {
        let lattice = CutLattice::new(&mask, side, 1 << 20, &|| false).unwrap();
        let cells = lattice.cells_of(&mask, &|| false).unwrap();
        assert_eq!(cells.cells().len(), lattice.quads().len());
        for (k, (quad, drawn)) in lattice.quads().iter().zip(cells.cells()).enumerate() {
            let mut is_whole = true;
            let mut is_loose = false;
            for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
                let [px, py] = [quad.cell[0] * side + x, quad.cell[1] * side + y];
                let [px, py] = [px as usize, py as usize];
                if px >= 53 || py >= 41 {
                    continue;
                }
                let around = (py.saturating_sub(1)..py + 2)
                    .flat_map(|y| (px.saturating_sub(1)..px + 2).map(move |x| (x, y)));
                let draws = if mask.is_visible(px, py) {
                    lattice.quad_at(&mask, px, py) == Some(k)
                } else {
                    around
                        .filter_map(|(x, y)| lattice.quad_at(&mask, x, y))
                        .any(|other| {
                            let beside = lattice.quads()[other];
                            other == k || beside.part == quad.part && beside.cell != quad.cell
                        })
                };
                assert_eq!(cells.draws(drawn, x, y), draws, "{side} {quad:?} {x} {y}");
                is_whole &= draws;
                is_loose |= draws && mask.is_stray(px, py);
            }
            assert_eq!(drawn.texels.is_none(), is_whole, "{side} {quad:?}");
            assert_eq!(drawn.is_loose, is_loose, "{side} {quad:?}");
        }
    }
}

#[test]
fn the_work_of_a_lattice_grows_with_its_pixels() {
    let looks_at = |height: u32| {
        let mask = Mask::new(256, height, checkerboard, &|| false).unwrap();
        let (size, sides) = (CutLattice::size(&mask, 64, u64::MAX, &|| false), 64 * 64);
        let looks = Cell::new(0);
        let is_cancelled = || {
            looks.set(looks.get() + 1);
            false
        };
        let lattice = CutLattice::new(&mask, 64, 1 << 20, &|| false).unwrap();
        let cells = lattice.cells_of(&mask, &is_cancelled).unwrap();
        let pixels = lattice.pixels(&mask, &is_cancelled).unwrap();
        assert!(pixels.iter().all(Option::is_some));
        let size = size.unwrap();
        let quads = u64::from(128 * height);
        assert_eq!((size.quads, size.sets), (quads, quads));
        assert_eq!(size.split * 2 * sides, 256 * u64::from(height) * 2);
        assert!(lattice.bytes() + cells.bytes() < size.bytes(64));
        looks.get()
    };
    // Words of the sets, of which each quad has one, and pixels.
    let (single, double) = (looks_at(256), looks_at(512));
    assert!((10..30).contains(&single), "{single}");
    assert!(double <= 2 * single + 2, "{double} {single}");
    // Each look comes before much is done.
    let mask = Mask::new(256, 256, checkerboard, &|| false).unwrap();
    let lattice = CutLattice::new(&mask, 64, 1 << 20, &|| false).unwrap();
    assert!(lattice.cells_of(&mask, &|| true).is_none());
    assert!(CutLattice::size(&mask, 64, u64::MAX, &|| true).is_none());
    let some = CutLattice::size(&mask, 64, 1 << 20, &|| false).unwrap();
    assert!(some.quads < 4096 && some.bytes(64) > 1 << 20);
}
