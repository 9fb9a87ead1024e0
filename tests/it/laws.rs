//! Laws of the method for random handles, every family, kind and alpha: interpolation, identity,
//! reproduction, equivariance, and that the plan says what the definition says. Handles lie in
//! separate cells of a 4 x 4 board, so that no two lines cross.

use mlswarp::deform::{CoefficientTable, Falloff, Handle, Handles, Method, Pose, RestDeformation};
use mlswarp::geometry::{Grid, Point, Vec2};
use proptest::prelude::*;

const METHODS: [Method; 3] = [Method::Affine, Method::Similarity, Method::Rigid];
const SIDE: f64 = 500.0;

/// A random set: rest and posed handles, and weights.
#[derive(Clone, Debug)]
struct Set {
    p: Vec<Handle>,
    q: Vec<Handle>,
    weights: Vec<f64>,
    alpha: f64,
    point_mass: f64,
}

impl Set {
    fn field(&self, method: Method) -> RestDeformation {
        self.field_of(&self.p, method)
    }

    fn field_of(&self, p: &[Handle], method: Method) -> RestDeformation {
        let rest = Handles::new(p.to_vec(), Some(self.weights.clone())).unwrap();
        let falloff = Falloff::new(self.alpha, rest.has_lines()).unwrap();
        RestDeformation::new(rest, method, falloff, self.point_mass).unwrap()
    }

    /// Largest displacement of a handle, px.
    fn reach(&self) -> f64 {
        self.p
            .iter()
            .zip(&self.q)
            .flat_map(|(p, q)| p.places().iter().zip(q.places()))
            .map(|(p, q)| p.distance(*q))
            .fold(0.0, f64::max)
    }
}

fn map_handles(handles: &[Handle], f: impl Fn(Point) -> Point) -> Vec<Handle> {
    handles
        .iter()
        .map(|h| match h {
            Handle::Point(p) => Handle::Point(f(*p)),
            Handle::Polyline(places) => Handle::Polyline(places.iter().map(|p| f(*p)).collect()),
            Handle::Missing => Handle::Missing,
        })
        .collect()
}

/// A handle inside the unit square, as fractions: a point, a segment, or a polyline of three
/// places.
fn fractions() -> impl Strategy<Value = Vec<(f64, f64)>> {
    let place = (0.05f64..0.95, 0.05f64..0.95);
    prop_oneof![
        2 => proptest::collection::vec(place, 1),
        1 => (0.05f64..0.95, 0.05f64..0.4, 0.05f64..0.95, 0.6f64..0.95).prop_map(|(x, y, x2,
            y2)| vec![(x, y), (x2, y2)]),
        1 => (0.1f64..0.3, 0.1f64..0.9, 0.45f64..0.55, 0.1f64..0.9, 0.7f64..0.9, 0.1f64..0.9)
            .prop_map(|(x, y, x2, y2, x3, y3)| vec![(x, y), (x2, y2), (x3, y3)]),
    ]
}

fn sets() -> impl Strategy<Value = Set> {
    let cells = proptest::sample::subsequence((0..16usize).collect::<Vec<_>>(), 3..=8);
    let moved = proptest::collection::vec((-60.0f64..60.0, -60.0f64..60.0), 40);
    let alpha = prop_oneof![
        0.05f64..0.5,
        Just(0.5),
        Just(1.0),
        Just(1.5),
        Just(2.0),
        Just(3.0),
        0.5f64..8.0
    ];
    (
        cells,
        proptest::collection::vec(fractions(), 8),
        moved,
        proptest::collection::vec(0.2f64..5.0, 8),
        alpha,
        1.0f64..200.0,
    )
        .prop_map(|(cells, shapes, moved, weights, alpha, point_mass)| {
            let cell = SIDE / 4.0;
            let mut moved = moved.into_iter();
            let mut set = Set {
                p: vec![],
                q: vec![],
                weights: weights[..cells.len()].to_vec(),
                alpha,
                point_mass,
            };
            let has_lines = shapes[..cells.len()].iter().any(|shape| shape.len() > 1);
            set.alpha = if has_lines { alpha.max(0.5) } else { alpha };
            for (&at, shape) in cells.iter().zip(&shapes) {
                let corner = Vec2::new((at % 4) as f64 * cell, (at / 4) as f64 * cell);
                let places: Vec<Point> = shape
                    .iter()
                    .map(|(x, y)| Point::new(x * cell, y * cell) + corner)
                    .collect();
                let posed = places
                    .iter()
                    .map(|p| *p + moved.next().map(|(x, y)| Vec2::new(x, y)).unwrap())
                    .collect::<Vec<_>>();
                let handle = |places: Vec<Point>| {
                    if places.len() == 1 {
                        Handle::Point(places[0])
                    } else {
                        Handle::Polyline(places)
                    }
                };
                set.p.push(handle(places));
                set.q.push(handle(posed));
            }
            set
        })
}

fn places() -> impl Strategy<Value = Vec<Point>> {
    proptest::collection::vec(
        (-100.0f64..600.0, -100.0f64..600.0).prop_map(|(x, y)| Point::new(x, y)),
        6,
    )
}

/// `z -> m z + t`.
fn similarity(m: Vec2, t: Vec2) -> impl Fn(Point) -> Point + Copy {
    move |p| Point::default() + m.complex_mul(p - Point::default()) + t
}

fn assert_reproduces(set: &Set, method: Method, at: &[Point], g: impl Fn(Point) -> Point) {
    let field = set.field(method);
    let pose = field.pose(&map_handles(&set.p, &g)).unwrap();
    for v in at {
        let (got, want) = (field.map(&pose, *v), g(*v));
        assert!(
            got.distance(want) < 1e-6,
            "{method:?} alpha {}: {v:?} -> {got:?}, expected {want:?}",
            set.alpha
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None,
        ..ProptestConfig::default() })]

    #[test]
    fn interpolation_handles_land_on_their_targets(set in sets()) {
        for method in METHODS {
            let field = set.field(method);
            let pose = field.pose(&set.q).unwrap();
            for (p, q) in set.p.iter().zip(&set.q) {
                for (p, q) in p.places().iter().zip(q.places()) {
                    prop_assert!(field.map(&pose, *p).distance(*q) < 1e-6, "{method:?} alpha {}",
                        set.alpha);
                }
                for (p, q) in p.places().windows(2).zip(q.places().windows(2)) {
                    for t in [0.125, 0.5, 0.8] {
                        // A vertex this near to the line is moved as the line: the limit, also
                        // where it is reached slowly (alpha 1/2).
                        let (v, want) = (p[0].lerp(p[1], t), q[0].lerp(q[1], t));
                        let allowed = if set.alpha < 1.0 { 12.0 } else { 1e-3 };
                        prop_assert!(field.map(&pose, v).distance(want) < allowed, "{method:?} \
                            alpha {} on a line", set.alpha);
                    }
                }
            }
        }
    }

    #[test]
    fn identity_is_bit_exact(set in sets(), at in places()) {
        for method in METHODS {
            let field = set.field(method);
            let pose = field.pose(&set.p).unwrap();
            for v in &at {
                prop_assert_eq!(field.map(&pose, *v), *v);
            }
            let table = CoefficientTable::of_vertices(&field, at.len(), |k| at[k]);
            let (displacement, _) = table.displace(&pose, &|| false).unwrap();
            prop_assert!(displacement.iter().all(|d| *d == [0.0, 0.0]));
        }
    }

    #[test]
    fn translation_is_reproduced_by_every_family(set in sets(), at in places(),
        x in -300.0f64..300.0, y in -300.0f64..300.0) {
        for method in METHODS {
            assert_reproduces(&set, method, &at, |p| p + Vec2::new(x, y));
        }
    }

    #[test]
    fn rotation_is_reproduced_by_every_family(set in sets(), at in places(),
        angle in -3.1f64..3.1) {
        for method in METHODS {
            assert_reproduces(&set, method, &at, similarity(Vec2::new(angle.cos(), angle.sin()),
                Vec2::new(12.0, -7.0)));
        }
    }

    #[test]
    fn similarity_is_reproduced_by_similarity_and_affine(set in sets(), at in places(),
        x in -2.0f64..2.0, y in -2.0f64..2.0) {
        for method in [Method::Similarity, Method::Affine] {
            assert_reproduces(&set, method, &at, similarity(Vec2::new(x, y), Vec2::new(40.0, 3.0)));
        }
    }

    #[test]
    fn affine_maps_are_reproduced_by_affine(set in sets(), at in places(),
        m in proptest::array::uniform4(-2.0f64..2.0)) {
        assert_reproduces(&set, Method::Affine, &at, |p| Point::new(m[0] * p.x + m[1] * p.y + 5.0,
            m[2] * p.x + m[3] * p.y - 9.0));
    }

    #[test]
    fn plan_says_what_the_definition_says(set in sets(), at in places()) {
        for method in METHODS {
            let field = set.field(method);
            let pose = field.pose(&set.q).unwrap();
            let table = CoefficientTable::of_vertices(&field, at.len(), |k| at[k]);
            let (displacement, _) = table.displace(&pose, &|| false).unwrap();
            for (v, d) in at.iter().zip(displacement) {
                let exact = field.map(&pose, *v) - *v;
                let off = (exact - Vec2::new(d[0].into(), d[1].into())).norm();
                // 2e-6 max|d| max(1, sum|C|/10): sum|C| is at least |f(v) - v| / max|d|.
                let allowed = 2e-6 * set.reach() * (exact.norm() / set.reach()).max(20.0);
                prop_assert!(off <= allowed, "{method:?} alpha {}: off by {off:e} at {v:?}",
                    set.alpha);
            }
        }
    }

    #[test]
    fn equivariance_the_plane_may_be_turned_scaled_and_moved(set in sets(), at in places(),
        angle in -3.0f64..3.0, scale in 0.1f64..10.0) {
        let g = similarity(Vec2::new(angle.cos(), angle.sin()) * scale, Vec2::new(100.0, 50.0));
        let there = Set { p: map_handles(&set.p, g), q: map_handles(&set.q, g),
            point_mass: set.point_mass * scale, ..set.clone() };
        for method in METHODS {
            let (here, elsewhere) = (set.field(method), there.field(method));
            let (pose, pose_there) = (here.pose(&set.q).unwrap(),
                elsewhere.pose(&there.q).unwrap());
            for v in &at {
                let (got, want) = (elsewhere.map(&pose_there, g(*v)), g(here.map(&pose, *v)));
                prop_assert!(got.distance(want) < 1e-5 * scale.max(1.0), "{method:?} alpha {}: \
                    {got:?} {want:?}", set.alpha);
            }
        }
    }

    #[test]
    fn composition_a_rigid_motion_of_the_targets_moves_the_result(set in sets(), at in places(),
        angle in -3.0f64..3.0) {
        let g = similarity(Vec2::new(angle.cos(), angle.sin()), Vec2::new(-30.0, 77.0));
        for method in METHODS {
            let field = set.field(method);
            let (pose, moved) = (field.pose(&set.q).unwrap(),
                field.pose(&map_handles(&set.q, g)).unwrap());
            for v in &at {
                prop_assert!(field.map(&moved, *v).distance(g(field.map(&pose, *v))) < 1e-5);
            }
        }
    }

    #[test]
    fn lines_may_be_reversed_and_cut_and_handles_reordered(set in sets(), at in places(),
        cut in 0.2f64..0.8) {
        let reversed = |handles: &[Handle]| -> Vec<Handle> {
            handles.iter().map(|h| match h {
                Handle::Polyline(places) => Handle::Polyline(
                    places.iter().rev().copied().collect()),
                point => point.clone(),
            }).rev().collect()
        };
        let divided = |handles: &[Handle]| -> Vec<Handle> {
            handles.iter().map(|h| match h {
                Handle::Polyline(places) => {
                    let mut all = vec![places[0]];
                    for ab in places.windows(2) {
                        all.extend([ab[0].lerp(ab[1], cut), ab[1]]);
                    }
                    Handle::Polyline(all)
                }
                point => point.clone(),
            }).collect()
        };
        for method in METHODS {
            let field = set.field(method);
            let pose = field.pose(&set.q).unwrap();
            let weights = set.weights.iter().rev().copied().collect();
            let backwards = Set { p: reversed(&set.p), weights, ..set.clone() }.field(method);
            let backwards_pose = backwards.pose(&reversed(&set.q)).unwrap();
            let cut_field = set.field_of(&divided(&set.p), method);
            let cut_pose = cut_field.pose(&divided(&set.q)).unwrap();
            for v in &at {
                let want = field.map(&pose, *v);
                prop_assert!(backwards.map(&backwards_pose, *v).distance(want) < 1e-7,
                    "{method:?} alpha {} reversed", set.alpha);
                prop_assert!(cut_field.map(&cut_pose, *v).distance(want) < 1e-7, "{method:?} \
                    alpha {} cut", set.alpha);
            }
        }
    }

    #[test]
    fn finite_everywhere_for_any_sizes(
        set in sets(),
        far in prop_oneof![Just(1.0), Just(1e-4), Just(2e3)],
        jump in prop_oneof![Just(1.0), Just(1e4)],
    ) {
        let g = |p: Point| Point::new(p.x * far, p.y * far);
        let p = map_handles(&set.p, g);
        let q: Vec<Handle> = map_handles(&set.q, |p| Point::new((p.x * jump).clamp(-1e6, 1e6),
            (p.y * jump).clamp(-1e6, 1e6)));
        for method in METHODS {
            let field = set.field_of(&p, method);
            let Ok(pose) = field.pose(&q) else { continue };
            let grid = Grid::with_counts(SIDE * far, SIDE * far, 9, 9);
            let table = CoefficientTable::of_grid(&field, &grid, &|| false).unwrap();
            let mesh = table.pose(&grid, &pose, &|| false).unwrap().0;
            prop_assert!(mesh.displacement().iter().flatten().all(|c| c.is_finite()), "{method:?} \
                alpha {}", set.alpha);
        }
    }
}

#[test]
fn weights_a_doubled_weight_is_a_doubled_point() {
    let at = |x: f64, y: f64| Handle::Point(Point::new(x, y));
    let falloff = Falloff::new(1.0, false).unwrap();
    for method in METHODS {
        let p = vec![
            at(10.0, 10.0),
            at(200.0, 40.0),
            at(90.0, 300.0),
            at(400.0, 420.0),
        ];
        let q = vec![
            at(20.0, 0.0),
            at(210.0, 60.0),
            at(80.0, 310.0),
            at(390.0, 400.0),
        ];
        let weighted = RestDeformation::new(
            Handles::new(p.clone(), Some(vec![1.0, 1.0, 2.0, 1.0])).unwrap(),
            method,
            falloff,
            1.0,
        )
        .unwrap();
        let doubled = |list: &[Handle]| [list, &list[2..3]].concat();
        let twice = RestDeformation::new(
            Handles::new(doubled(&p), None).unwrap(),
            method,
            falloff,
            1.0,
        )
        .unwrap();
        let (pose, pose_twice) = (
            weighted.pose(&q).unwrap(),
            twice.pose(&doubled(&q)).unwrap(),
        );
        for v in [
            Point::new(0.0, 0.0),
            Point::new(250.0, 250.0),
            Point::new(91.0, 299.0),
        ] {
            assert!(weighted.map(&pose, v).distance(twice.map(&pose_twice, v)) < 1e-9);
        }
    }
}

/// Segments are the limit of dense weighted points (the definition of section 3): the error of n
/// midpoints falls as 1/n^2.
#[test]
fn segments_are_the_limit_of_dense_points() {
    let (a, b, c, d) = (
        Point::new(100.0, 120.0),
        Point::new(380.0, 200.0),
        Point::new(80.0, 160.0),
        Point::new(400.0, 130.0),
    );
    let (e, f, g, h) = (
        Point::new(150.0, 400.0),
        Point::new(420.0, 330.0),
        Point::new(170.0, 380.0),
        Point::new(400.0, 420.0),
    );
    for method in METHODS {
        for alpha in [0.5, 1.0, 1.3, 2.0, 4.0] {
            let lines = Handles::new(
                vec![Handle::Polyline(vec![a, b]), Handle::Polyline(vec![e, f])],
                None,
            )
            .unwrap();
            let field =
                RestDeformation::new(lines, method, Falloff::new(alpha, true).unwrap(), 1.0)
                    .unwrap();
            let pose = field
                .pose(&[Handle::Polyline(vec![c, d]), Handle::Polyline(vec![g, h])])
                .unwrap();
            let dense = |n: usize, v: Point| {
                let (mut p, mut q, mut weights) = (vec![], vec![], vec![]);
                for (ab, cd) in [((a, b), (c, d)), ((e, f), (g, h))] {
                    for k in 0..n {
                        let t = (k as f64 + 0.5) / n as f64;
                        p.push(Handle::Point(ab.0.lerp(ab.1, t)));
                        q.push(Handle::Point(cd.0.lerp(cd.1, t)));
                        weights.push(ab.0.distance(ab.1) / n as f64);
                    }
                }
                let falloff = Falloff::new(alpha, false).unwrap();
                let field = RestDeformation::new(
                    Handles::new(p, Some(weights)).unwrap(),
                    method,
                    falloff,
                    1.0,
                )
                .unwrap();
                let pose: Pose = field.pose(&q).unwrap();
                field.map(&pose, v)
            };
            for v in [
                Point::new(250.0, 250.0),
                Point::new(10.0, 480.0),
                Point::new(300.0, 60.0),
                Point::new(240.0, 190.0),
            ] {
                let want = field.map(&pose, v);
                let (coarse, fine) = (dense(300, v).distance(want), dense(1200, v).distance(want));
                assert!(fine < 1e-3, "{method:?} alpha {alpha}: {fine:e} at {v:?}");
                assert!(
                    fine < coarse / 8.0 || coarse < 1e-9,
                    "{method:?} alpha {alpha}: {coarse:e} -> {fine:e} is not a limit"
                );
            }
        }
    }
}
