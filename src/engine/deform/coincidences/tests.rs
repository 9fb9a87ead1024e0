use std::cell::Cell;

use super::search::{COMPARISON_WORK, MOST_WORK, NEAR_POINT_PX, POINTS_PER_BUCKET, point};
use super::*;
use crate::deform::columns::elements;
use crate::deform::{Handle, Handles};
use proptest::prelude::*;

const NEVER: &dyn Fn() -> bool = &|| false;

fn elements_of(handles: Vec<Handle>) -> (Vec<Element>, f64) {
    let handles = Handles::new(handles, None).unwrap();
    (elements(&handles, 1.0).0, handles.extent())
}

fn line(a: (f64, f64), b: (f64, f64)) -> Handle {
    Handle::Polyline(vec![Point::new(a.0, a.1), Point::new(b.0, b.1)])
}

fn dot(x: f64, y: f64) -> Handle {
    Handle::Point(Point::new(x, y))
}

/// Every pair, compared.
fn by_brute_force(elements: &[Element], extent: f64) -> Coincidences {
    let mut search = CoincidenceSearch::new(elements, extent, NEVER);
    for j in 0..elements.len() {
        let mut first = None;
        for i in 0..j {
            if let (Some(p), Some(other)) = (point(&elements[i]), point(&elements[j])) {
                let apart = p.distance(other);
                if apart <= search.coincident {
                    first = first.or(Some(i));
                } else if apart < NEAR_POINT_PX {
                    search.found.near.push((i, j, apart));
                }
            }
            search.found.meet(elements, i, j, search.coincident);
        }
        search
            .found
            .touching
            .extend(first.map(|i| ((i, 0.0), (j, 0.0))));
    }
    search.found.touching.sort_by_key(|(x, y)| (x.0, y.0));
    search.found
}

fn agrees(handles: Vec<Handle>) -> Result<(), TestCaseError> {
    let (elements, extent) = elements_of(handles);
    let (mut found, mut want) = (
        Coincidences::find(&elements, extent, NEVER).unwrap(),
        by_brute_force(&elements, extent),
    );
    prop_assert_eq!(&found.touching, &want.touching);
    found.near.sort_by_key(|near| (near.0, near.1));
    want.near.sort_by_key(|near| (near.0, near.1));
    prop_assert_eq!(found.near, want.near);
    Ok(())
}

/// Places that often coincide, are often near each other, and often lie on one line.
fn place() -> impl Strategy<Value = (f64, f64)> {
    let lattice = (0..6_u8, 0..6_u8).prop_map(|(x, y)| (f64::from(x) * 7.0, f64::from(y) * 7.0));
    let beside = (0..6_u8, 0..3_u8, -3..4_i8)
        .prop_map(|(x, y, d)| (f64::from(x) * 7.0 + f64::from(d) * 0.3, f64::from(y) * 7.0));
    let rounded = (0..6_u8, -9..10_i8).prop_map(|(x, d)| {
        (
            f64::from(x) * 7.0 + f64::from(d) * 5e-9,
            7.0 - f64::from(d) * 3e-9,
        )
    });
    prop_oneof![lattice, beside, rounded, (0.0..40.0, 0.0..40.0)]
}

fn handle() -> impl Strategy<Value = Handle> {
    let point = place().prop_map(|(x, y)| dot(x, y));
    let line = (place(), place())
        .prop_filter("a length", |(a, b)| (a.0 - b.0).hypot(a.1 - b.1) > 1e-3)
        .prop_map(|(a, b)| line(a, b));
    prop_oneof![point, line]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn meetings_are_those_of_a_search_of_all_pairs(handles in prop::collection::vec(handle(),
        0..14)) {
        agrees(handles)?;
    }

    #[test]
    fn meetings_far_from_the_origin_are_too(handles in prop::collection::vec(handle(), 0..9),
        x in -9e5..9e5_f64, y in -9e5..9e5_f64) {
        let moved = |p: &Point| Point::new(p.x + x, p.y + y);
        agrees(handles.iter().map(|h| match h {
            Handle::Point(p) => Handle::Point(moved(p)),
            Handle::Polyline(places) => Handle::Polyline(places.iter().map(moved).collect()),
            Handle::Missing => Handle::Missing,
        }).collect())?;
    }
}

#[test]
fn meetings_of_many_lines_in_one_direction_are_found_along_another() {
    // Their boxes all overlap in x and y, at every angle of the bundle.
    for degrees in [0.0_f64, 11.0, 45.0, 90.0, 130.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let turned = |x: f64, y: f64| (400.0 + x * cos - y * sin, 400.0 + x * sin + y * cos);
        let mut handles: Vec<Handle> = (0..60)
            .map(|k| f64::from(k) - 30.0)
            .map(|y| line(turned(-150.0, y), turned(150.0, y)))
            .collect();
        handles.push(line(turned(0.0, -12.5), turned(1.0, 14.5)));
        let at = turned(10.0, 20.0);
        handles.push(dot(at.0, at.1));
        agrees(handles).unwrap();
    }
}

/// Sets of 10,000 columns, each the worst of its kind: all of them take a bounded amount of
/// work, and end.
#[test]
fn the_work_of_the_worst_sets_is_bounded() {
    const N: u32 = 10_000;
    let share = |k: u32| f64::from(k.wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
    let (half, all) = (
        || 0..N / 2,
        || (0..N).map(|k| (k, share(k), share(k ^ 0x5bd1))),
    );
    let bundle = |angle: f64, spread: f64| {
        let (sin, cos) = angle.sin_cos();
        let turned = move |x: f64, y: f64| (x * cos - y * sin, x * sin + y * cos);
        half()
            .map(|k| spread * f64::from(k))
            .map(|y| line(turned(0.0, y), turned(400.0, y)))
            .collect::<Vec<_>>()
    };
    let sets: Vec<(&str, Vec<Handle>)> = vec![
        (
            "points within 1 px",
            all()
                .map(|(_, x, y)| dot(100.0 + 0.7 * x, 100.0 + 0.7 * y))
                .collect(),
        ),
        (
            "points at one place",
            all()
                .map(|_| dot(3.0, 4.0))
                .chain([dot(900.0, 0.0)])
                .collect(),
        ),
        (
            "points within a millionth of a px",
            all()
                .map(|(_, x, y)| dot(1e-6 * x, 1e-6 * y))
                .chain([dot(900.0, 0.0)])
                .collect(),
        ),
        (
            "points of one x",
            all().map(|(_, x, _)| dot(7.0, 4000.0 * x)).collect(),
        ),
        (
            "points of one x, 1/100 px apart",
            all().map(|(k, ..)| dot(7.0, 0.01 * f64::from(k))).collect(),
        ),
        (
            "points on one slanted line",
            all().map(|(_, x, _)| dot(2000.0 * x, 2000.0 * x)).collect(),
        ),
        ("parallel lines along x", bundle(0.0, 0.01)),
        (
            "parallel lines between two directions",
            bundle(std::f64::consts::PI / 16.0, 0.01),
        ),
        (
            "parallel lines far apart",
            bundle(std::f64::consts::PI / 16.0, 0.5),
        ),
        (
            "a star",
            half()
                .map(|k| f64::from(k).sin_cos())
                .map(|(s, c)| {
                    line(
                        (500.0 + 9.0 * c, 500.0 + 9.0 * s),
                        (500.0 + 400.0 * c, 500.0 + 400.0 * s),
                    )
                })
                .collect(),
        ),
        (
            "all cross",
            half()
                .map(|k| f64::from(k) / 5000.0)
                .map(|t| line((0.0, 400.0 * t), (400.0, 400.0 * (1.0 - t))))
                .collect(),
        ),
        (
            "points beside lines",
            (0..N / 3)
                .flat_map(|k| {
                    [
                        dot(200.0 + share(k), 3.0),
                        line(
                            (0.0, 0.01 * f64::from(k)),
                            (400.0, 5.0 + 0.01 * f64::from(k)),
                        ),
                    ]
                })
                .collect(),
        ),
    ];
    for (name, handles) in sets {
        let (elements, extent) = elements_of(handles);
        let began = std::time::Instant::now();
        let mut search = CoincidenceSearch::new(&elements, extent, NEVER);
        let outcome = search.run().map_err(|e| e.to_string());
        let (n, found) = (elements.len() as u64, &search.found);
        eprintln!(
            "{name}: {} elements, {} comparisons of points, {} work, {} meetings, {} near, \
                {:.1} ms, {:?}",
            n,
            search.compared,
            search.work,
            found.touching.len(),
            found.near.len(),
            began.elapsed().as_secs_f64() * 1e3,
            outcome
        );
        assert!(
            search.compared <= n * (9 + 25) * POINTS_PER_BUCKET as u64,
            "{name}: {}",
            search.compared
        );
        assert!(
            search.work <= MOST_WORK + 2 * COMPARISON_WORK,
            "{name}: {}",
            search.work
        );
    }
}

/// A point may be a group of thousands.
#[test]
fn the_members_of_an_element_are_listed_once_for_a_position() {
    let lines = (0..300).map(|k| f64::from(k).sin_cos()).map(|(s, c)| {
        line(
            (50.0 - 40.0 * s, 50.0 - 40.0 * c),
            (50.0 + 40.0 * s, 50.0 + 40.0 * c),
        )
    });
    let (elements, extent) = elements_of([dot(50.0, 50.0)].into_iter().chain(lines).collect());
    let coincidences = Coincidences::find(&elements, extent, NEVER).unwrap();
    assert!(
        coincidences.touching.len() > 40_000,
        "{}",
        coincidences.touching.len()
    );
    let displacements: Vec<Vec2> = (0..601).map(|k| Vec2::new(f64::from(k % 7), 0.0)).collect();
    let (mut found, listed) = (Conflicts::new(coincidences.tolerance()), Cell::new(0));
    coincidences.add_conflicts(
        &mut found,
        &elements,
        &displacements,
        |element, displacement| {
            listed.set(listed.get() + 1);
            [Member {
                element,
                handle: element,
                weight: 1.0,
                displacement,
            }]
        },
    );
    assert_eq!((listed.get(), found.finish().listed[0].total), (301, 301));
}

#[test]
fn a_search_that_nobody_waits_for_ends_at_the_next_element() {
    let points = (0..500).map(|k| dot(f64::from(k), 0.0));
    let lines = (0..500).map(|k| line((f64::from(k), 1.0), (f64::from(k), 500.0)));
    let (elements, extent) = elements_of(points.chain(lines).collect());
    for looks in [0, 1, 499, 501, 520, 900] {
        let asked = Cell::new(0);
        let cancelled = || asked.replace(asked.get() + 1) >= looks;
        assert_eq!(
            Coincidences::find(&elements, extent, &cancelled).unwrap_err(),
            DeformError::Cancelled
        );
        assert_eq!(asked.get(), looks + 1);
    }
}
