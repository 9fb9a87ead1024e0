//! Alignment: laws over random sets of points and lines, in both units (mathematics 8.1).

use crate::deform::{Class, Handle, PlaneMap};
use crate::geometry::{Point, Vec2};
use crate::pixmap::Extent;
use crate::warp::{Align, Limits, ResolvedRest, RestSpec, Units};

const CLASSES: [(Align, Class); 3] = [
    (Align::Rigid, Class::Rigid),
    (Align::Similarity, Class::Similarity),
    (Align::Affine, Class::Affine),
];

fn extent() -> Extent {
    Extent::new(320, 200).unwrap()
}

fn numbers(seed: u32) -> impl FnMut(f64, f64) -> f64 {
    let mut state = seed;
    move |least, most| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        least + (most - least) * f64::from(state >> 8) / f64::from(1_u32 << 24)
    }
}

/// `count` handles, every third of which is a line.
fn set(seed: u32, count: usize) -> Vec<Handle> {
    let mut number = numbers(seed);
    let mut place = || Point::new(number(0.0, 320.0), number(0.0, 200.0));
    (0..count)
        .map(|k| {
            if k % 3 == 2 {
                Handle::Polyline(vec![place(), place(), place()])
            } else {
                Handle::Point(place())
            }
        })
        .collect()
}

fn each(handles: &[Handle], map: impl Fn(Point) -> Point) -> Vec<Handle> {
    let of = |handle: &Handle| match handle {
        Handle::Point(p) => Handle::Point(map(*p)),
        Handle::Polyline(places) => Handle::Polyline(places.iter().map(|p| map(*p)).collect()),
        Handle::Missing => Handle::Missing,
    };
    handles.iter().map(of).collect()
}

fn places(handles: &[Handle]) -> Vec<Point> {
    handles
        .iter()
        .flat_map(|handle| handle.places().to_vec())
        .collect()
}

fn far(a: &[Handle], b: &[Handle]) -> f64 {
    places(a)
        .iter()
        .zip(places(b))
        .map(|(a, b)| a.distance(b))
        .fold(0.0, f64::max)
}

fn rest(p: &[Handle], align: Align) -> RestSpec {
    RestSpec {
        p: p.to_vec(),
        align,
        ..RestSpec::default()
    }
}

fn aligned(rest: &RestSpec, q: &[Handle]) -> Vec<Handle> {
    rest.posed(q.to_vec(), 1.0, extent()).0
}

/// A map of a class: a turn, and what the class has besides.
fn member(align: Align, k: u32) -> impl Fn(Point) -> Point {
    let (sin, cos) = (0.7 * f64::from(k) - 1.0).sin_cos();
    let scale = if align == Align::Rigid {
        1.0
    } else {
        0.1 * f64::from(k) + 0.05
    };
    let (stretch, shear) = if align == Align::Affine {
        (-1.5, 0.4)
    } else {
        (1.0, 0.0)
    };
    move |v: Point| {
        let (x, y) = (v.x + shear * v.y, stretch * v.y);
        Point::new(
            30.0 + scale * (cos * x - sin * y),
            7.0 - 50.0 * f64::from(k) + scale * (sin * x + cos * y),
        )
    }
}

#[test]
fn a_member_of_the_class_is_undone_bit_for_bit() {
    for (align, class) in CLASSES {
        for (k, count) in [(1, 3), (2, 4), (5, 9), (9, 30), (90, 8)] {
            let p = set(k, count);
            for units in [Units::Px, Units::Normalized] {
                let unit = if units == Units::Px {
                    (1.0, 1.0)
                } else {
                    (320.0, 200.0)
                };
                let to_units = |v: Point| Point::new(v.x / unit.0, v.y / unit.1);
                let rest = RestSpec {
                    units,
                    ..rest(&each(&p, to_units), align)
                };
                let q = each(&p, |v| to_units(member(align, k)(v)));
                let (posed, alignment) = rest.posed(q, 1.0, extent());
                assert_eq!(posed, rest.p, "{align:?} {count} {units:?}");
                assert_eq!(alignment.unwrap().class, class);
                let setup =
                    ResolvedRest::new(&rest, extent(), &Limits::default(), &|| false).unwrap();
                assert!(setup.pose(&posed).unwrap().is_identity());
            }
        }
    }
}

#[test]
fn the_map_is_the_best_of_its_class_and_aligning_twice_is_aligning_once() {
    for (align, _) in CLASSES {
        for k in 1..12 {
            let (p, noise) = (set(k, 7), places(&set(k + 100, 7)));
            let rest = RestSpec {
                weights: Some((1..8).map(f64::from).collect()),
                ..rest(&p, align)
            };
            let mut noise = noise
                .into_iter()
                .map(|v| (v - Point::new(160.0, 100.0)) * 0.2);
            let moved: Vec<Point> = places(&each(&p, member(align, k)))
                .into_iter()
                .map(|v| v + noise.next().unwrap())
                .collect();
            let mut moved = moved.into_iter();
            let q: Vec<Handle> = p
                .iter()
                .map(|handle| match handle {
                    Handle::Point(_) => Handle::Point(moved.next().unwrap()),
                    Handle::Polyline(line) => {
                        Handle::Polyline(line.iter().map(|_| moved.next().unwrap()).collect())
                    }
                    Handle::Missing => Handle::Missing,
                })
                .collect();
            let once = aligned(&rest, &q);
            assert!(far(&aligned(&rest, &once), &once) < 1e-9, "{align:?} {k}");
            // What the class can undo changes nothing.
            let other = aligned(&rest, &each(&q, member(align, k + 3)));
            assert!(
                far(&other, &once) < 1e-8,
                "{align:?} {k}: {}",
                far(&other, &once)
            );
            // No map of the class that is nearly the same is better.
            let least = squares(&rest, &once);
            for (dx, dy, turn, scale) in [
                (0.1, 0.0, 0.0, 1.0),
                (0.0, -0.1, 0.0, 1.0),
                (0.0, 0.0, 1e-3, 1.0),
                (0.0, 0.0, 0.0, 1.001),
            ] {
                if align != Align::Rigid || (scale - 1.0_f64).abs() < 1e-9 {
                    let near = |v: Point| {
                        Point::new(
                            scale * (v.x - turn * v.y) + dx,
                            scale * (v.y + turn * v.x) + dy,
                        )
                    };
                    assert!(squares(&rest, &each(&once, near)) > least, "{align:?} {k}");
                }
            }
            if align == Align::Affine {
                assert!(
                    squares(&rest, &each(&once, |v| Point::new(v.x + 1e-3 * v.y, v.y))) > least
                );
                assert!(squares(&rest, &each(&once, |v| Point::new(v.x, v.y * 1.001))) > least);
            }
            // The order of handles does not matter.
            let turned = |handles: &[Handle]| handles.iter().rev().cloned().collect::<Vec<_>>();
            let reversed = RestSpec {
                weights: Some((1..8).rev().map(f64::from).collect()),
                ..self::rest(&turned(&p), align)
            };
            assert!(far(&turned(&aligned(&reversed, &turned(&q))), &once) < 1e-9);
        }
    }
}

/// The weighted sum of squares over points and nine positions of each segment, by its definition.
fn squares(rest: &RestSpec, q: &[Handle]) -> f64 {
    let mut sum = 0.0;
    for ((p, q), weight) in rest.p.iter().zip(q).zip(rest.weights.as_ref().unwrap()) {
        match p {
            Handle::Point(p) => sum += weight * p.distance(q.places()[0]).powi(2),
            Handle::Polyline(line) => {
                for (ab, cd) in line.windows(2).zip(q.places().windows(2)) {
                    for k in 0..9 {
                        let t = f64::from(k) / 8.0;
                        sum += weight * ab[0].lerp(ab[1], t).distance(cd[0].lerp(cd[1], t)).powi(2);
                    }
                }
            }
            Handle::Missing => {}
        }
    }
    sum
}

#[test]
fn handles_that_do_not_determine_a_class_take_the_next_smaller_one() {
    let points = |places: &[(f64, f64)]| {
        places
            .iter()
            .map(|(x, y)| Handle::Point(Point::new(*x, *y)))
            .collect::<Vec<_>>()
    };
    let class = |p: &[(f64, f64)], q: &[(f64, f64)], align: Align| {
        let (posed, alignment) = rest(&points(p), align).posed(points(q), 1.0, extent());
        assert!(places(&posed).iter().all(|p| p.is_finite()), "{posed:?}");
        alignment.map(|alignment| alignment.class)
    };
    let (square, mirrored) = (
        [(0.0, 0.0), (9.0, 0.0), (9.0, 9.0), (0.0, 9.0)],
        [(9.0, 0.0), (0.0, 0.0), (0.0, 9.0), (9.0, 9.0)],
    );
    let (line, one) = (
        [(1.0, 1.0), (2.0, 3.0), (4.0, 7.0), (7.0, 13.0)],
        [(5.0, 5.0); 4],
    );
    let (two, other_two) = ([(1.0, 2.0), (8.0, 9.0)], [(50.0, 20.0), (10.0, 90.0)]);
    for (p, q, affine, similarity, rigid) in [
        (
            &square[..],
            &mirrored[..],
            Class::Affine,
            Class::Translation,
            Class::Translation,
        ),
        (
            &square,
            &line,
            Class::Similarity,
            Class::Similarity,
            Class::Rigid,
        ),
        (
            &line,
            &square,
            Class::Similarity,
            Class::Similarity,
            Class::Rigid,
        ),
        (
            &square,
            &one,
            Class::Translation,
            Class::Translation,
            Class::Translation,
        ),
        (
            &one,
            &square,
            Class::Translation,
            Class::Translation,
            Class::Translation,
        ),
        (
            &two,
            &other_two,
            Class::Similarity,
            Class::Similarity,
            Class::Rigid,
        ),
        (
            &two[..1],
            &other_two[..1],
            Class::Translation,
            Class::Translation,
            Class::Translation,
        ),
    ] {
        for (align, want) in [
            (Align::Affine, affine),
            (Align::Similarity, similarity),
            (Align::Rigid, rigid),
        ] {
            assert_eq!(class(p, q, align), Some(want), "{align:?} {p:?} {q:?}");
        }
    }
    assert_eq!(class(&[], &[], Align::Affine), None);
    assert_eq!(class(&square, &line, Align::None), None);
    // A line turns, like two points; a reflection is affine alone.
    let segment = |a: (f64, f64), b: (f64, f64)| {
        vec![Handle::Polyline(vec![
            Point::new(a.0, a.1),
            Point::new(b.0, b.1),
        ])]
    };
    let (p, q) = (
        segment((1.0, 1.0), (9.0, 1.0)),
        segment((5.0, 40.0), (5.0, 56.0)),
    );
    assert!(
        far(&aligned(&rest(&p, Align::Affine), &q), &p) == 0.0,
        "two ends determine a similarity"
    );
    assert_eq!(
        aligned(&rest(&points(&square), Align::Affine), &points(&mirrored)),
        points(&square)
    );
}

/// Shapes that differ, and positions that are out of range, are refused as they were sent.
#[test]
fn what_cannot_be_posed_is_not_aligned() {
    let p = set(3, 4);
    let rest = rest(&p, Align::Similarity);
    for q in [
        set(4, 3),
        vec![p[0].clone(), p[1].clone(), p[0].clone(), p[3].clone()],
        each(&p, |v| v + Vec2::new(2e6, 0.0)),
    ] {
        let (same, alignment) = rest.posed(q.clone(), 1.0, extent());
        assert_eq!((same, alignment), (q.clone(), None));
        assert!(
            ResolvedRest::new(&rest, extent(), &Limits::default(), &|| false)
                .unwrap()
                .pose(&q)
                .is_err()
        );
    }
    let infinite = each(&p, |_| Point::new(f64::INFINITY, f64::NAN));
    assert_eq!(rest.posed(infinite, 1.0, extent()).1, None);
}

#[test]
fn strength_counts_after_the_alignment() {
    let p = set(5, 6);
    let rest = rest(&p, Align::Similarity);
    let q = each(&set(6, 6), member(Align::Similarity, 4));
    let once = aligned(&rest, &q);
    for strength in [-1.5, 0.0, 0.5, 1.0, 2.0] {
        let (posed, alignment) = rest.posed(q.clone(), strength, extent());
        let want = places(&p)
            .into_iter()
            .zip(places(&once))
            .map(|(p, q)| p + (q - p) * strength);
        assert!(
            places(&posed)
                .into_iter()
                .zip(want)
                .all(|(posed, want)| posed.distance(want) < 1e-9)
        );
        // The map is that of q, whatever the strength.
        let map: PlaneMap = alignment.unwrap().map;
        assert!(
            places(&q)
                .iter()
                .zip(places(&once))
                .all(|(q, once)| map.map(*q).distance(once) < 1e-6)
        );
        let [[a, b, c], [d, e, f]] = map.matrix();
        let v = Point::new(13.0, -7.0);
        assert!(
            map.map(v)
                .distance(Point::new(a * v.x + b * v.y + c, d * v.x + e * v.y + f))
                < 1e-9
        );
    }
}
