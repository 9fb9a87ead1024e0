use super::*;

fn polygon(vertices: &[(i32, i32)]) -> Border {
    let closed = vertices.iter().chain(vertices.first());
    let vertices = closed
        .map(|&(x, y)| Corner {
            x: x * STEPS_PER_PX,
            y: y * STEPS_PER_PX,
            u: x as f32,
            v: y as f32,
        })
        .collect();
    Border {
        vertices,
        boxes: Vec::new(),
        mirror: None,
    }
}

#[test]
fn border_surrounds_what_it_winds_around() {
    let rectangle = polygon(&[(0, 0), (10, 0), (10, 8), (0, 8)]);
    assert!(rectangle.surrounds(&(0..10), &(0..8)));
    assert!(!rectangle.surrounds(&(0..11), &(0..8)));
    assert!(!rectangle.surrounds(&(0..10), &(0..9)));
    assert!(
        polygon(&[(0, 0), (0, 8), (10, 8), (10, 0)]).surrounds(&(0..10), &(0..8)),
        "flipped"
    );
    assert!(
        !polygon(&[(20, 0), (30, 0), (30, 8), (20, 8)]).surrounds(&(0..10), &(0..8)),
        "beside"
    );
    assert!(
        !polygon(&[(-9, -9), (40, -9), (40, -8), (-8, -8), (-8, 40), (-9, 40)])
            .surrounds(&(0..10), &(0..8)),
        "around a corner only"
    );
    assert!(
        polygon(&[(-30, 4), (5, -30), (40, 4), (5, 40)]).surrounds(&(0..10), &(0..8)),
        "a slanted one"
    );
}

/// The nearest position by a search of the tree for this position alone; it defines the result
/// among equals.
fn by_the_tree(border: &Border, node: usize, place: Point, best: &mut (f64, (f32, f32))) {
    if node + 1 >= border.leaves() {
        let first = (node + 1 - border.leaves()) * LEAF_SEGMENTS;
        for index in first..(first + LEAF_SEGMENTS).min(border.vertices.len() - 1) {
            let (a, b) = border.segment(index);
            let (distance, coordinates) = nearest_on(a, b, place);
            if distance < best.0 {
                *best = (distance, coordinates);
            }
        }
        return;
    }
    let mut children = [2 * node + 1, 2 * node + 2]
        .map(|child| (box_distance(&border.boxes[child], place), child));
    if children[1].0 < children[0].0 {
        children.swap(0, 1);
    }
    for (distance, child) in children {
        if distance < best.0 {
            by_the_tree(border, child, place, best);
        }
    }
}

/// The coordinates of all pixels of a target, and the work per pixel; two bands, the second
/// beginning inside a square.
fn filled(border: &mut Border, width: usize, height: usize) -> (Vec<(f32, f32)>, f64) {
    border.index();
    let mut found = Vec::new();
    let mut work = 0;
    for rows in [0..height / 3, height / 3..height] {
        let pitch = width + 5;
        let (mut u, mut v) = (
            vec![UNCOVERED; rows.len() * pitch],
            vec![0.0; rows.len() * pitch],
        );
        let mut search = BorderSearch::new(border);
        search.fill(&mut UncoveredRows {
            first: rows.start as u32,
            left: 0,
            width,
            pitch,
            u: &mut u,
            v: &mut v,
        });
        work += search.work;
        let pairs = u.chunks_exact(pitch).zip(v.chunks_exact(pitch));
        found.extend(pairs.flat_map(|(u, v)| {
            u[..width]
                .iter()
                .copied()
                .zip(v[..width].iter().copied())
                .collect::<Vec<_>>()
        }));
    }
    (found, work as f64 / (width * height) as f64)
}

fn agrees(name: &str, vertices: &[(i32, i32)], width: usize, height: usize) -> f64 {
    let mut border = steps(vertices);
    let (found, work) = filled(&mut border, width, height);
    for (k, found) in found.iter().enumerate() {
        let place = Point::new(
            column_centre(k % width),
            row_centre((k / width) as u32) as f64,
        );
        let mut want = (f64::INFINITY, (0.0, 0.0));
        by_the_tree(&border, 0, place, &mut want);
        assert_eq!(*found, want.1, "{name}: pixel {}, {}", k % width, k / width);
    }
    eprintln!(
        "{name}: {} segments, work {work:.1} a pixel",
        vertices.len()
    );
    work
}

/// In lattice steps; each vertex has its own coordinates.
fn steps(vertices: &[(i32, i32)]) -> Border {
    let closed = vertices.iter().chain(vertices.first()).zip(0_u16..);
    let vertices = closed
        .map(|(&(x, y), k)| Corner {
            x,
            y,
            u: f32::from(k),
            v: -f32::from(k),
        })
        .collect();
    Border {
        vertices,
        boxes: Vec::new(),
        mirror: None,
    }
}

fn numbers(seed: u32) -> impl FnMut(i32) -> i32 {
    let mut state = seed;
    move |below| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((u64::from(state) * below as u64) >> 32) as i32
    }
}

#[test]
fn nearest_places_are_those_of_a_search_for_each_pixel_alone() {
    let spiral: Vec<_> = (0..200)
        .map(|k| (f64::from(k) * 0.7, f64::from(k) * 80.0))
        .map(|(a, r)| ((r * a.sin()) as i32, (r * a.cos()) as i32))
        .collect();
    agrees("spiral", &spiral, 70, 50);
    agrees("one place", &[(300, 400); 50], 40, 40);
    agrees(
        "rectangle",
        &[(2560, 2560), (7680, 2560), (7680, 7680), (2560, 7680)],
        45,
        45,
    );
    // Back and forth on the same line, and mirrored: every result occurs twice at equal
    // distance.
    agrees(
        "there and back",
        &(0..40)
            .chain((0..40).rev())
            .map(|k| (k * 256, 5000))
            .collect::<Vec<_>>(),
        41,
        41,
    );
    agrees(
        "two sides",
        &(0..60)
            .map(|k| (k * 150, if k % 2 == 0 { 256 } else { 38 * 256 }))
            .collect::<Vec<_>>(),
        40,
        39,
    );
    for seed in 0..12 {
        let mut next = numbers(seed);
        let size = [40 * 256, 400 * 256, 1 << 20][seed as usize % 3];
        let vertices: Vec<_> = (0..90)
            .map(|_| (next(2 * size) - size / 2, next(2 * size) - size / 2))
            .collect();
        agrees("any", &vertices, 66, 44);
    }
}

#[test]
fn the_work_a_pixel_is_bounded_for_every_border() {
    let mut next = numbers(7);
    let mut chaos = |count: usize| {
        (0..count)
            .map(|_| (next(256 * 256), next(256 * 256)))
            .collect::<Vec<_>>()
    };
    let few = agrees("400 segments across the target", &chaos(400), 256, 256);
    assert!(few < 100.0, "{few}");
    // More segments than lists can hold, so the per-pixel search is no reference.
    let comb = |count: i32, reach: i32| {
        (0..count)
            .map(|k| (k % 700, if k % 2 == 0 { -reach } else { reach }))
            .collect::<Vec<_>>()
    };
    let sets = [
        ("4,000 across", chaos(4000)),
        ("40,000 across", chaos(40_000)),
        ("40,000 in one line", comb(40_000, 256)),
        ("40,000 afar", comb(40_000, 1 << 28)),
    ];
    for (name, vertices) in sets {
        let mut border = steps(&vertices);
        let (_, work) = filled(&mut border, 256, 256);
        eprintln!("{name}: work {work:.1} a pixel");
        // 2 * 40,000 boxes and segments to 1,024 pixels, 8,192 to 64, 512 to 4, and 128.
        assert!(
            work < 1.25 * (80.0 + 128.0 + 128.0 + 128.0),
            "{name}: {work}"
        );
    }
}
