use super::outlines::to_segment;
use super::*;
use crate::deform::Handle;
use crate::geometry::Grid;
use crate::pixmap::Extent;
use crate::warp::{Folds, GridSpec, Limits, PosedMesh, Quantity, RestSpec};

const NEVER: IsCancelled<'static> = &|| false;

const P: [(f64, f64); 7] = [
    (40.0, 30.0),
    (250.0, 40.0),
    (150.0, 100.0),
    (60.0, 160.0),
    (230.0, 170.0),
    (120.0, 60.0),
    (180.0, 140.0),
];
const D: [(f64, f64); 7] = [
    (8.0, -6.0),
    (-5.0, 9.0),
    (12.0, 4.0),
    (-7.0, -8.0),
    (4.0, -12.0),
    (-9.0, 3.0),
    (6.0, 11.0),
];

/// Seven handles, each moved by its displacement times `strength`.
fn set(strength: f64) -> (ResolvedRest, Vec<Handle>) {
    let rest = RestSpec {
        p: P.map(|(x, y)| Handle::Point(Point::new(x, y))).to_vec(),
        ..RestSpec::default()
    };
    let q = P
        .iter()
        .zip(D)
        .map(|((x, y), (dx, dy))| Handle::Point(Point::new(x + strength * dx, y + strength * dy)));
    (
        ResolvedRest::new(
            &rest,
            Extent::new(300, 200).unwrap(),
            &Limits::default(),
            &|| false,
        )
        .unwrap(),
        q.collect(),
    )
}

fn square(from: f64, to: f64) -> Vec<Point> {
    [(from, from), (to, from), (to, to), (from, to)]
        .map(|(x, y)| Point::new(x, y))
        .to_vec()
}

#[test]
fn refined_outlines_follow_the_map_and_straight_ones_stay() {
    let (setup, q) = set(1.0);
    let pose = setup.pose(&q).unwrap();
    let f = setup.transform(&pose);
    let places = square(20.0, 180.0);
    let outline = Outline {
        places: &places,
        edges: Edges::Closed,
    };
    let bare = f
        .map_outlines(&[outline], None, NEVER)
        .unwrap()
        .remove(0)
        .unwrap()
        .places;
    assert_eq!(
        bare.iter().copied().map(Some).collect::<Vec<_>>(),
        f.map(&places, NEVER).unwrap()
    );
    for tolerance in [1.0, 0.1, 0.01] {
        let MappedOutline {
            places: refined,
            at,
        } = f
            .map_outlines(&[outline], Some(tolerance), NEVER)
            .unwrap()
            .remove(0)
            .unwrap();
        #[expect(clippy::cast_possible_truncation, reason = "the index of a corner")]
        let of_edge = |at: f64| places[at as usize].lerp(places[(at as usize + 1) % 4], at.fract());
        let there = f
            .map(&at.into_iter().map(of_edge).collect::<Vec<_>>(), NEVER)
            .unwrap();
        assert!(
            there
                .into_iter()
                .zip(&refined)
                .all(|(there, vertex)| there.unwrap().distance(*vertex) < 1e-9)
        );
        assert!(refined.len() > 8, "{}", refined.len());
        assert!(bare.iter().all(|vertex| refined.contains(vertex)));
        let segments: Vec<(Point, Point)> = (0..refined.len())
            .map(|k| (refined[k], refined[(k + 1) % refined.len()]))
            .collect();
        for k in 0..4 {
            for step in 0..=1000 {
                let y = f
                    .map(
                        &[places[k].lerp(places[(k + 1) % 4], f64::from(step) / 1000.0)],
                        NEVER,
                    )
                    .unwrap()[0]
                    .unwrap();
                let nearest = segments
                    .iter()
                    .map(|(a, b)| to_segment(y, *a, *b))
                    .fold(f64::INFINITY, f64::min);
                assert!(
                    nearest <= tolerance,
                    "{tolerance}: {y:?} is {nearest} px away"
                );
            }
        }
    }
    let still = setup.pose(&set(0.0).1).unwrap();
    let straight = setup
        .transform(&still)
        .map_outlines(&[outline], Some(0.1), NEVER)
        .unwrap();
    let at = vec![0.0, 1.0, 2.0, 3.0];
    assert_eq!(
        straight,
        [Some(MappedOutline {
            places: places.clone(),
            at
        })]
    );
}

#[test]
fn the_inverse_of_a_mapped_outline_is_the_outline() {
    let (setup, q) = set(1.0);
    let pose = setup.pose(&q).unwrap();
    let posed = PosedMesh::coarse(
        &setup,
        &setup.plan(&|| false).unwrap(),
        &pose,
        Folds::Report,
        NEVER,
    )
    .unwrap();
    let (f, back) = (setup.transform(&pose), setup.inverse(&pose, &posed));
    let places = square(30.0, 170.0);
    let there = f
        .map_outlines(
            &[Outline {
                places: &places,
                edges: Edges::Closed,
            }],
            Some(0.1),
            NEVER,
        )
        .unwrap()
        .remove(0)
        .unwrap()
        .places;
    let again = back
        .map_outlines(
            &[Outline {
                places: &there,
                edges: Edges::Closed,
            }],
            None,
            NEVER,
        )
        .unwrap()
        .remove(0)
        .unwrap()
        .places;
    for place in again {
        let nearest = (0..4)
            .map(|k| to_segment(place, places[k], places[(k + 1) % 4]))
            .fold(f64::INFINITY, f64::min);
        assert!(nearest < 1e-6, "{place:?}");
    }
    let outside = [Point::new(100.0, 100.0), Point::new(-5000.0, 0.0)];
    assert_eq!(
        back.map_outlines(
            &[Outline {
                places: &outside,
                edges: Edges::Open
            }],
            Some(0.1),
            NEVER
        )
        .unwrap(),
        [None]
    );
}

#[test]
fn the_inverse_is_found_whatever_size_the_cells_have() {
    let rest = |grid| RestSpec {
        p: P.map(|(x, y)| Handle::Point(Point::new(x, y))).to_vec(),
        grid,
        ..RestSpec::default()
    };
    let (extent, limits) = (Extent::new(300, 200).unwrap(), Limits::default());
    let places: Vec<Point> = (0..200)
        .map(|k| {
            Point::new(
                f64::from(k * 37 % 101) * 2.97,
                f64::from(k * 53 % 103) * 1.94,
            )
        })
        .collect();
    for grid in [
        GridSpec::Counts {
            columns: 2,
            rows: 2,
        },
        GridSpec::Cell(50.0),
        GridSpec::Pixel,
        GridSpec::Cell(6.0),
    ] {
        let client = ResolvedRest::new(&rest(grid), extent, &limits, &|| false).unwrap();
        let setup = client.to_invert(&limits).unwrap();
        assert_eq!(
            setup.plan_key() == client.plan_key(),
            grid == GridSpec::Cell(6.0)
        );
        let pose = setup.pose(&set(1.0).1).unwrap();
        let posed = PosedMesh::coarse(
            &setup,
            &setup.plan(&|| false).unwrap(),
            &pose,
            Folds::Report,
            NEVER,
        )
        .unwrap();
        let there: Vec<Point> = client
            .transform(&pose)
            .map(&places, NEVER)
            .unwrap()
            .into_iter()
            .flatten()
            .collect();
        let back = setup.inverse(&pose, &posed).map(&there, NEVER).unwrap();
        for (place, back) in places.iter().zip(back) {
            assert!(
                back.is_some_and(|back| back.distance(*place) < 1e-6),
                "{grid:?}: {place:?} {back:?}"
            );
        }
    }
}

/// Positions that are mapped part by part have one inverse for each part.
#[test]
fn inverses_of_one_pose_share_its_tree() {
    let (setup, q) = set(1.0);
    let (pose, plan) = (setup.pose(&q).unwrap(), setup.plan(NEVER).unwrap());
    let posed = PosedMesh::coarse(&setup, &plan, &pose, Folds::Report, NEVER);
    let mut posed = posed.unwrap();
    let inverse = |posed: &PosedMesh| {
        let questions = AtomicUsize::new(0);
        let count = || questions.fetch_add(1, Ordering::Relaxed) == usize::MAX;
        let found = setup.inverse(&pose, posed);
        let found = found.map(&[Point::new(100.0, 90.0)], &count).unwrap();
        (questions.into_inner(), found)
    };
    let (alone, found) = inverse(&posed);
    posed.keep_tree(NEVER).unwrap();
    let (kept, again) = inverse(&posed);
    // A tree asks for each row of the grid.
    let rows = posed.mesh().grid().rows() as usize - 1;
    assert!(kept + rows <= alone && found == again, "{kept}, {alone}");
    assert!(posed.tree_bytes() > 0 && posed.keep_tree(&|| true).is_err());
}

#[test]
fn work_is_bounded_and_positions_are_checked() {
    let (setup, q) = set(1.0);
    let pose = setup.pose(&q).unwrap();
    let f = setup.transform(&pose);
    let far: Vec<Point> = (0..12_000)
        .map(|k| Point::new(if k % 2 == 0 { -9e5 } else { 9e5 }, f64::from(k)))
        .collect();
    let error = f
        .map_outlines(
            &[Outline {
                places: &far,
                edges: Edges::Closed,
            }],
            Some(0.1),
            NEVER,
        )
        .unwrap_err();
    assert!(
        matches!(
            error,
            WarpError::TooLarge {
                what: Quantity::OutlineSamples,
                ..
            }
        ),
        "{error}"
    );
    // What has been examined counts for the next part of the task.
    let of_next = |next: Transform<'_>| {
        let outline = Outline {
            places: &far[..2],
            edges: Edges::Open,
        };
        next.map_outlines(&[outline], Some(0.1), NEVER)
    };
    assert!(of_next(setup.transform(&pose)).is_ok());
    assert!(matches!(
        of_next(setup.transform(&pose).after(f.taken())),
        Err(WarpError::TooLarge { .. })
    ));
    let (near, bad) = (
        square(1.0, 9.0),
        [Point::new(0.0, 0.0), Point::new(0.0, 2e6)],
    );
    let outlines = [
        Outline {
            places: &near,
            edges: Edges::Closed,
        },
        Outline {
            places: &bad,
            edges: Edges::Open,
        },
    ];
    let error = setup
        .transform(&pose)
        .map_outlines(&outlines, None, NEVER)
        .unwrap_err();
    assert!(
        matches!(error, WarpError::BadPlace { index: 5, .. }),
        "{error}"
    );
    assert_eq!(
        setup.transform(&pose).map(&near, &|| true),
        Err(WarpError::Cancelled)
    );
}

/// The patches of a mesh whose cells all lie on one line are beside the position, and their boxes
/// are not: no estimate knows, so what a search looks at is counted.
#[test]
fn an_inverse_that_tries_every_cell_is_refused_in_the_middle() {
    let (setup, _) = set(1.0);
    let grid = Grid::with_counts(300.0, 200.0, 301, 201);
    let to_line = |k: usize| {
        let [i, j] = [k % 301, k / 301].map(|line| u16::try_from(line).unwrap());
        let share = f32::from((i + j) % 2) * 100.0;
        [share - f32::from(i), share - f32::from(j)]
    };
    let mesh = Mesh::new(grid, (0..grid.len()).map(to_line).collect());
    let places = [Point::new(20.0, 80.0); 20 * PLACES_PER_TASK];
    let inverse = Transform {
        max_work: 2_000_000,
        ..Transform::new(PositionMap::Inverse(Inverse::of_mesh(&mesh)), &setup)
    };
    inverse.check_positions(places.len()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(2)
        .build()
        .unwrap();
    let error = pool.install(|| inverse.map(&places, NEVER)).unwrap_err();
    assert!(
        matches!(
            error,
            WarpError::TooMuchWork {
                task: Task::Positions,
                ..
            }
        ),
        "{error}"
    );
    // The parts of a response are one task.
    let next = |before| {
        let part = Transform {
            max_work: 2_000_000,
            ..Transform::new(PositionMap::Inverse(Inverse::of_mesh(&mesh)), &setup)
        };
        part.after(before).map(&places[..1], NEVER)
    };
    assert!(next(Taken::default()).is_ok());
    assert!(matches!(
        next(inverse.taken()),
        Err(WarpError::TooMuchWork { .. })
    ));
    let PositionMap::Inverse(inverse) = &inverse.map else {
        unreachable!()
    };
    // Tasks that had begun end.
    let boxes = inverse.boxes();
    assert!(boxes < 8 * PLACES_PER_TASK as u64 * 90_000, "{boxes}");
}
