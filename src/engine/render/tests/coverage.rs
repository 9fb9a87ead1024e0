//! The pixels that a mesh paints, and their source positions.

use super::super::canvas::{Canvas, Placement, Window};
use super::super::cell;
use super::super::drawing::Drawing;
use super::super::kernel::{Kernel, LANES, Raster, UNCOVERED};
use super::super::snapped_grid::{STEPS_PER_PX, SnappedGrid, column_centre, row_centre};
use super::*;

/// Draws each cell by itself, in drawing order, in strips of a few rows, and returns the
/// coordinates.
fn cell_by_cell(
    lattice: &SnappedGrid,
    target: Extent,
    level: SimdLevel,
    mut painted: impl FnMut(usize, usize, Point),
) {
    const STRIP: u32 = 7;
    let (width, kernel) = (target.width() as usize, Kernel::new(level));
    let pitch = width + LANES;
    let (mut u, mut v) = (
        vec![UNCOVERED; pitch * STRIP as usize],
        vec![0.0; pitch * STRIP as usize],
    );
    for first in (0..target.height()).step_by(STRIP as usize) {
        let rows = first..target.height().min(first + STRIP);
        for (i, j) in lattice.cells_touching(rows.clone()) {
            u.fill(UNCOVERED);
            u.chunks_exact_mut(pitch)
                .for_each(|row| row[width..].fill(0.0));
            let mut uncovered = vec![0..width; rows.len()];
            let open = (1 << rows.len()) - 1;
            let mut raster = Raster {
                first,
                width,
                pitch,
                u: &mut u,
                v: &mut v,
                over: false,
                uncovered: &mut uncovered,
                open,
            };
            let only = |b: usize| if b == i / 8 { 1 << (i % 8) } else { 0 };
            cell::draw_row(kernel, lattice, j, only, |_| u32::MAX, &rows, &mut raster);
            raster.shrink();
            for (y, uncovered) in rows.clone().zip(uncovered) {
                let row = (y - first) as usize * pitch;
                let left: Vec<_> = (0..width).filter(|x| u[row + x] == UNCOVERED).collect();
                let (first, end) = (left.first().copied(), left.last().map(|x| x + 1));
                assert!(
                    left.is_empty() && uncovered.is_empty()
                        || (first, end) == (Some(uncovered.start), Some(uncovered.end)),
                    "what is uncovered is known"
                );
                for x in (0..width).filter(|x| u[row + x] != UNCOVERED) {
                    painted(
                        x,
                        y as usize,
                        Point::new(f64::from(u[row + x]) / 128.0, f64::from(v[row + x]) / 128.0),
                    );
                }
            }
        }
    }
}

fn lattice(mesh: &Mesh, options: &RenderOptions) -> SnappedGrid {
    let grid = mesh.grid();
    let source = extent(grid.width() as u32, grid.height() as u32);
    let placement = Placement::new(Canvas::of(source), options.target);
    SnappedGrid::new(
        mesh,
        source,
        0,
        options.filter,
        (placement.scale, [0.0; 2]),
        Kernel::new(SimdLevel::detect()),
    )
}

/// A drawing of the whole target.
fn drawing(lattice: SnappedGrid, target: Extent) -> Drawing {
    let window = Window {
        columns: 0..target.width() as usize,
        rows: 0..target.height(),
        first: (0, 0),
        origin: [0.0; 2],
    };
    Drawing::new(
        (lattice, None),
        window,
        target,
        options(target),
        0,
        Kernel::new(SimdLevel::detect()),
    )
}

fn paintings(lattice: &SnappedGrid, target: Extent) -> Vec<u32> {
    let width = target.width() as usize;
    let mut counts = vec![0; width * target.height() as usize];
    cell_by_cell(lattice, target, SimdLevel::detect(), |x, y, _| {
        counts[y * width + x] += 1
    });
    counts
}

/// The winding number of the snapped border around a position, in exact integers; `None` on the
/// border itself.
fn winding(lattice: &SnappedGrid, x: i64, y: i64) -> Option<i64> {
    let (c, r) = (lattice.columns - 1, lattice.rows - 1);
    let loop_ = (0..c)
        .map(|i| (i, 0))
        .chain((0..r).map(|j| (c, j)))
        .chain((1..=c).rev().map(|i| (i, r)))
        .chain((1..=r).rev().map(|j| (0, j)));
    let vertices: Vec<_> = loop_
        .map(|(i, j)| lattice.corner(i, j))
        .map(|v| (i64::from(v.x) - x, i64::from(v.y) - y))
        .collect();
    let mut turns = 0;
    for (k, &(ax, ay)) in vertices.iter().enumerate() {
        let (bx, by) = vertices[(k + 1) % vertices.len()];
        let cross = ax * by - ay * bx;
        if cross == 0 && ax * bx <= 0 && ay * by <= 0 {
            return None;
        }
        turns +=
            i64::from(ay <= 0 && by > 0 && cross > 0) - i64::from(by <= 0 && ay > 0 && cross < 0);
    }
    Some(turns)
}

#[test]
fn each_pixel_inside_is_painted_once_where_nothing_folds() {
    let grids = [
        Grid::with_cell(71.0, 53.0, 5.0),
        Grid::with_counts(71.0, 53.0, 18, 18),
        Grid::with_cell(71.0, 53.0, 1.0),
        Grid::with_counts(71.0, 53.0, 2, 2),
    ];
    let mut inside = 0;
    for (seed, grid) in (0..32).zip(grids.into_iter().cycle()) {
        let mesh = waves(grid, seed, 0.8);
        assert_eq!(
            mesh.folded_cells().count(),
            0,
            "the law is about unfolded meshes"
        );
        let target = if seed % 3 == 0 {
            extent(38, 29)
        } else {
            extent(71, 53)
        };
        let lattice = lattice(&mesh, &options(target));
        for (k, count) in paintings(&lattice, target).into_iter().enumerate() {
            let (x, y) = (k as u32 % target.width(), k as u32 / target.width());
            if let Some(turns) = winding(&lattice, column_centre(x as usize) as i64, row_centre(y))
            {
                assert_eq!(i64::from(count), turns, "seed {seed}, pixel {x}, {y}");
                inside += count;
            }
        }
    }
    assert!(inside > 50_000);
}

#[test]
fn each_pixel_is_painted_once_on_vertices_and_edges() {
    // Every vertex lies on a pixel's centre: all decisions are ties.
    let grid = Grid::with_cell(44.0, 40.0, 4.0);
    let target = extent(44, 40);
    for (mesh, area) in [
        (
            posed(grid, |p| Point::new(p.x / 2.0 + 10.5, p.y / 2.0 + 8.5)),
            440,
        ),
        (
            posed(grid, |p| Point::new(32.5 - p.x / 2.0, 28.5 - p.y / 2.0)),
            440,
        ),
        (
            posed(grid, |p| {
                Point::new((p.x + p.y) / 4.0 + 10.5, (p.y - p.x) / 4.0 + 15.5)
            }),
            220,
        ),
        (
            posed(grid, |p| Point::new(32.5 - p.x / 2.0, p.y / 2.0 + 8.5)),
            440,
        ),
    ] {
        let lattice = lattice(&mesh, &options(target));
        let counts = paintings(&lattice, target);
        for (k, &count) in counts.iter().enumerate() {
            let turns = winding(
                &lattice,
                column_centre(k % 44) as i64,
                row_centre((k / 44) as u32),
            );
            assert!(
                turns.is_none_or(|turns| u64::from(count) == turns.unsigned_abs()) && count <= 1,
                "pixel {k}: {count}"
            );
        }
        // Half-open edges: as many pixels as the area says.
        assert_eq!(counts.into_iter().sum::<u32>(), area);
    }
}

#[test]
fn rows_cover_the_same_pixels_either_way() {
    let (mut fast, mut general) = (0, 0);
    for seed in 0..24 {
        let grid = if seed % 2 == 0 {
            Grid::with_cell(160.0, 120.0, 5.0)
        } else {
            Grid::with_counts(160.0, 120.0, 100, 70)
        };
        let mesh = if seed % 5 == 0 {
            swirl(grid, 0.1 * seed as f64)
        } else {
            waves(grid, seed, 0.9)
        };
        let target = extent(160, 120);
        let lattice = lattice(&mesh, &options(target));
        let counts = paintings(&lattice, target);
        let drawing = drawing(lattice, target);
        for row in 0..target.height() {
            *if drawing.is_plain(row) {
                &mut fast
            } else {
                &mut general
            } += 1;
            let (_, _, runs) = drawing.row(row);
            let mut covered = [0; 160];
            runs.into_iter().for_each(|run| covered[run].fill(1));
            assert_eq!(
                counts[row as usize * 160..][..160],
                covered,
                "seed {seed}, row {row}"
            );
        }
        let whole = counts.iter().all(|&count| count > 0);
        assert!(
            whole || !drawing.covered,
            "coverage is not promised where it is not"
        );
    }
    assert!(fast > 500 && general > 200, "{fast} {general}");
}

#[test]
fn coordinates_are_those_of_the_bilinear_patch() {
    let (mut worst, mut fast, mut compared) = (0.0_f64, 0, 0);
    for seed in 0..12 {
        let cell = [5.0, 11.0, 24.0][seed as usize % 3];
        let grid = Grid::with_cell(240.0, 180.0, cell);
        let mesh = if seed % 4 == 0 {
            swirl(grid, 0.3 + 0.05 * seed as f64)
        } else {
            waves(grid, seed, 0.9)
        };
        assert_eq!(mesh.folded_cells().count(), 0, "one place a pixel");
        let target = extent(240, 180);
        let drawing = drawing(lattice(&mesh, &options(target)), target);
        let reference = reference::places(&mesh, target);
        for row in 0..target.height() {
            fast += usize::from(drawing.is_plain(row));
            let (u, v, runs) = drawing.row(row);
            for x in runs.into_iter().flatten() {
                let drawn = Point::new(
                    (f64::from(u[x]) + 63.5) / 128.0,
                    (f64::from(v[x]) + 63.5) / 128.0,
                );
                if let Some(place) = reference[row as usize * 240 + x] {
                    worst = worst.max(drawn.distance(place));
                    compared += 1;
                }
            }
        }
    }
    assert!(worst < 1.0 / 16.0, "{worst} px");
    assert!(fast > 600 && compared > 400_000, "{fast} {compared}");
}

/// Compares all rows with painting the cells one after the other; returns the number of painted
/// pixels.
fn as_painted_in_order(drawing: &Drawing, target: Extent, what: &str) -> usize {
    let (width, mut painted) = (target.width() as usize, 0);
    let mut places = vec![None; width * target.height() as usize];
    cell_by_cell(
        &drawing.lattice,
        target,
        SimdLevel::detect(),
        |x, y, place| places[y * width + x] = Some(place),
    );
    for row in 0..target.height() {
        let (u, v, runs) = drawing.row(row);
        let mut covered = vec![false; width];
        runs.into_iter().for_each(|run| covered[run].fill(true));
        for x in 0..width {
            let place = places[row as usize * width + x];
            assert_eq!(place.is_some(), covered[x], "{what}, pixel {x}, {row}");
            if let Some(place) = place {
                let drawn = Point::new(f64::from(u[x]) / 128.0, f64::from(v[x]) / 128.0);
                assert!(
                    drawn.distance(place) < 1.0 / 16.0,
                    "{what}, pixel {x}, {row}: {drawn:?}, not {place:?}"
                );
                painted += 1;
            }
        }
    }
    painted
}

#[test]
fn folded_rows_are_those_of_painting_in_order() {
    let (mut painted, mut folded) = (0, 0);
    for seed in 0..30 {
        let grid = Grid::with_cell(120.0, 90.0, 5.0);
        let mesh = if seed % 3 == 0 {
            swirl(grid, 2.0 + 0.2 * seed as f64)
        } else {
            waves(grid, seed, 1.5 + 0.2 * seed as f64)
        };
        folded += mesh.folded_cells().count();
        let target = extent(120, 90);
        let drawing = drawing(lattice(&mesh, &options(target)), target);
        painted += as_painted_in_order(&drawing, target, &format!("seed {seed}"));
    }
    assert!(painted > 100_000 && folded > 1000, "{painted} {folded}");
}

/// A few folds in a smooth mesh, which reach under and over the rows drawn by crossings.
#[test]
fn divided_rows_are_those_of_painting_in_order() {
    let (mut painted, mut divided) = (0, 0);
    for seed in 0..60 {
        let mut noise = Noise(seed);
        let mut random = || noise.signed();
        let cell = 2.5 + 2.0 * random().abs();
        let grid = Grid::with_cell(160.0, 120.0, cell);
        let slants = [0.5 * random(), 0.5 * random()];
        let pulls: Vec<[f64; 5]> = (0..1 + seed % 3)
            .map(|_| {
                let (radius, angle) = (3.0 + 3.0 * random().abs(), std::f64::consts::PI * random());
                let reach = radius * (1.0 + 4.0 * random().abs());
                [
                    80.0 + 75.0 * random(),
                    60.0 + 55.0 * random(),
                    radius,
                    reach * angle.cos(),
                    reach * angle.sin(),
                ]
            })
            .collect();
        let smooth = waves(grid, seed, 0.3);
        let mesh = posed(grid, |p| {
            let place = smooth.map(p).unwrap();
            let place = Point::new(
                place.x + slants[0] * (p.y - 60.0),
                place.y + slants[1] * (p.x - 80.0),
            );
            pulls.iter().fold(place, |place, [x, y, radius, dx, dy]| {
                let weight = (-((p.x - x).powi(2) + (p.y - y).powi(2)) / (radius * radius)).exp();
                place + Vec2::new(dx * weight, dy * weight)
            })
        });
        let target = extent(160, 120);
        let drawing = drawing(lattice(&mesh, &options(target)), target);
        divided += (0..target.height())
            .filter(|&row| drawing.is_mixed(row))
            .count();
        painted += as_painted_in_order(&drawing, target, &format!("seed {seed}"));
    }
    assert!(painted > 300_000 && divided > 500, "{painted} {divided}");
}

#[test]
fn folds_leave_no_holes() {
    for seed in 0..8 {
        let mut noise = Noise(seed);
        let grid = Grid::with_cell(60.0, 60.0, 6.0);
        let jittered = posed(grid, |p| {
            let inner = p.x > 0.0 && p.y > 0.0 && p.x < 60.0 && p.y < 60.0;
            let jitter = if inner { 9.0 } else { 0.0 };
            // The generator advances by position, so that the closure stays pure.
            let mut local = Noise(seed * 7919 + (p.x * 61.0 + p.y) as u64);
            local.next();
            p + Vec2::new(jitter * local.signed(), jitter * local.signed())
        });
        noise.next();
        assert!(jittered.folded_cells().count() > 20);
        let target = extent(60, 60);
        assert!(
            paintings(&lattice(&jittered, &options(target)), target)
                .into_iter()
                .all(|count| count > 0),
            "seed {seed}"
        );
    }
}

#[test]
fn cells_without_area_paint_nothing() {
    let grid = Grid::with_cell(20.0, 20.0, 4.0);
    let target = extent(20, 20);
    for mesh in [
        posed(grid, |_| Point::new(7.5, 7.5)),
        posed(grid, |p| Point::new(p.x, 7.5)),
        posed(grid, |p| Point::new(7.5, p.y)),
        posed(grid, |p| Point::new(p.x, p.x)),
    ] {
        assert_eq!(
            paintings(&lattice(&mesh, &options(target)), target)
                .into_iter()
                .sum::<u32>(),
            0
        );
    }
    assert_eq!(STEPS_PER_PX, 256, "lattice steps in the places above");
}

/// Steep grid lines, and columns that bend at some of them: a chord between columns crosses several
/// cells, of which only one may be out of shape.
#[test]
fn steep_lines_beside_bent_columns_are_drawn_as_their_patches() {
    let (mut worst, mut mended) = (0.0_f64, 0);
    let target = extent(200, 200);
    let is_full = std::env::var_os("MLSWARP_TESTS_FULL").is_some();
    for seed in 0..if is_full { 120 } else { 30 } {
        let mut noise = Noise(seed);
        let mut random = || noise.signed().abs();
        let grid = Grid::with_cell(200.0, 200.0, 3.0 + 12.0 * random());
        let steep = (0.2 + 1.2 * random()) * if seed % 2 == 0 { 1.0 } else { -1.0 };
        let (bends, heights, falls) = (1.5 * random(), random(), random());
        // How far apart lines are and how far they are shifted along, and how steep columns are.
        let walk = |count: u32, mut step: Box<dyn FnMut(u32) -> f64 + '_>| {
            (1..count).fold(vec![0.0], |mut places, k| {
                places.push(places[k as usize - 1] + step(k));
                places
            })
        };
        let (mut a, mut b, mut c) = (Noise(seed + 1000), Noise(seed + 2000), Noise(seed + 3000));
        let (width, height) = grid.cell();
        let down = walk(
            grid.rows(),
            Box::new(|k| {
                height
                    * if k % 4 == 0 {
                        (1.0 + heights * a.signed()).max(0.15)
                    } else {
                        1.0
                    }
            }),
        );
        let along = walk(
            grid.rows(),
            Box::new(|k| {
                if k % 4 == 0 {
                    height * bends * b.signed()
                } else {
                    0.0
                }
            }),
        );
        let fall = walk(
            grid.columns(),
            Box::new(|k| {
                1.7 * steep
                    * width
                    * if k % 5 == 0 {
                        1.0 + falls * c.signed()
                    } else {
                        1.0
                    }
            }),
        );
        let (rows, columns) = (grid.rows() as usize, grid.columns() as usize);
        let centre = Vec2::new(along[rows / 2], down[rows / 2] + fall[columns / 2]);
        let mesh = posed(grid, |p| {
            let (i, j) = (
                (p.x / width).round() as usize,
                (p.y / height).round() as usize,
            );
            let place = Vec2::new(
                100.0 + (p.x - 100.0) * (0.7 + 0.5 * steep.abs()) + along[j],
                down[j] + fall[i] + 100.0,
            );
            Point::new(place.x - centre.x, place.y - centre.y)
        });
        let drawing = drawing(lattice(&mesh, &options(target)), target);
        let mut exact = vec![None; 200 * 200];
        cell_by_cell(
            &drawing.lattice,
            target,
            SimdLevel::detect(),
            |x, y, place| exact[y * 200 + x] = Some(place),
        );
        for row in (0..200).filter(|&row| drawing.crosses(row)) {
            mended += usize::from(!drawing.is_plain(row));
            let (u, v, runs) = drawing.row(row);
            for x in runs.into_iter().flatten() {
                let drawn = Point::new(f64::from(u[x]) / 128.0, f64::from(v[x]) / 128.0);
                worst = exact[row as usize * 200 + x]
                    .map_or(worst, |place| worst.max(drawn.distance(place)));
            }
        }
    }
    assert!(worst < 1.0 / 16.0, "{worst} px");
    assert!(mended > if is_full { 1000 } else { 250 }, "{mended} rows");
}

/// Single wedge-shaped cells: along a row t is far from linear, however the row is split.
#[test]
fn cells_with_long_sides_are_drawn_as_their_patches() {
    let (mut worst, mut compared) = (0.0_f64, 0);
    let target = extent(230, 90);
    for seed in 0..60 {
        let mut noise = Noise(seed);
        // On the lattice, because a thin end would magnify snapping errors.
        let mut off = || (3072.0 * noise.signed()).round() / 256.0;
        let mut near = |x: f64, y: f64| Point::new(x + off(), y + off());
        // One end is high, the other low, and both are off the middle.
        let corners = [
            near(8.0, 42.0),
            near(222.0, 20.0),
            near(222.0, 70.0 + 0.25 * seed as f64),
            near(8.0, 56.0),
        ];
        let mesh = posed(Grid::with_counts(230.0, 90.0, 2, 2), |p| {
            let corner = match (p.x > 0.0, p.y > 0.0) {
                (false, false) => 0,
                (true, false) => 1,
                (true, true) => 2,
                (false, true) => 3,
            };
            corners[corner]
        });
        if mesh.folded_cells().count() > 0 {
            continue;
        }
        let drawing = drawing(lattice(&mesh, &options(target)), target);
        let reference = reference::places(&mesh, target);
        for row in 0..target.height() {
            let (u, v, runs) = drawing.row(row);
            for x in runs.into_iter().flatten() {
                let drawn = Point::new(
                    (f64::from(u[x]) + 63.5) / 128.0,
                    (f64::from(v[x]) + 63.5) / 128.0,
                );
                if let Some(place) = reference[row as usize * 230 + x] {
                    worst = worst.max(drawn.distance(place));
                    compared += 1;
                }
            }
        }
    }
    assert!(worst < 1.0 / 16.0, "{worst} px");
    assert!(compared > 200_000, "{compared}");
}
