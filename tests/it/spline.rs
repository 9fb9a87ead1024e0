//! Laws of the thin-plate spline for random points: interpolation, identity, reproduction,
//! smoothing, degenerate sets, agreement with a solution of Bookstein's system by elimination, and
//! that the plan says what the definition says.

use std::sync::atomic::{AtomicUsize, Ordering};

use mlswarp::deform::{
    CoefficientTable, Coincident, CoincidentPolicy, DeformError, Handle, Handles, IsCancelled,
    NotTaken, Parameters, Pose, RestDeformation, Warning, pose_without_table,
};
use mlswarp::geometry::{Grid, Point, Vec2};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Folds, GridSpec, Method, PosedMesh, Quantity, ResolvedRest, RestSpec, WarpError,
};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::golden::limits;
use crate::support::server::problem;
use crate::support::{Server, photo};

fn handles(points: &[Point]) -> Vec<Handle> {
    points.iter().copied().map(Handle::Point).collect()
}

/// A spline without smoothing.
fn spline(
    rest: Handles,
    coincident: Coincident,
    cancelled: IsCancelled<'_>,
) -> Result<RestDeformation, DeformError> {
    let given = Parameters::default();
    RestDeformation::of(rest, coincident, Method::ThinPlateSpline, &given, cancelled)
}

/// A set of points at rest and posed, with weights.
#[derive(Clone, Debug)]
struct Set {
    p: Vec<Point>,
    q: Vec<Point>,
    weights: Vec<f64>,
}

impl Set {
    fn field(&self, smoothing: f64) -> RestDeformation {
        RestDeformation::spline(
            Handles::new(handles(&self.p), Some(self.weights.clone())).unwrap(),
            smoothing,
        )
        .unwrap()
    }

    fn posed(&self, smoothing: f64) -> (RestDeformation, Pose) {
        let field = self.field(smoothing);
        let pose = field.pose(&handles(&self.q)).unwrap();
        (field, pose)
    }

    fn mapped(&self, f: impl Fn(Point) -> Point) -> Self {
        Self {
            q: self.p.iter().map(|p| f(*p)).collect(),
            ..self.clone()
        }
    }
}

/// Points that lie in different cells of a board with 5 x 5 cells, 100 px wide.
fn sets(least: usize) -> impl Strategy<Value = Set> {
    let cells = proptest::sample::subsequence((0..25u8).collect::<Vec<_>>(), least..=12);
    let places = proptest::collection::vec((0.1f64..0.9, 0.1f64..0.9), 12);
    let moved = proptest::collection::vec((-60.0f64..60.0, -60.0f64..60.0), 12);
    (
        cells,
        places,
        moved,
        proptest::collection::vec(0.2f64..5.0, 12),
    )
        .prop_map(|(cells, places, moved, weights)| {
            let at = |(cell, (x, y)): (&u8, &(f64, f64))| {
                Point::new(
                    100.0 * (f64::from(cell % 5) + x),
                    100.0 * (f64::from(cell / 5) + y),
                )
            };
            let p: Vec<Point> = cells.iter().zip(&places).map(at).collect();
            let q = p
                .iter()
                .zip(&moved)
                .map(|(p, (x, y))| *p + Vec2::new(*x, *y))
                .collect();
            Set {
                weights: weights[..p.len()].to_vec(),
                p,
                q,
            }
        })
}

fn places() -> impl Strategy<Value = Vec<Point>> {
    proptest::collection::vec(
        (-100.0f64..600.0, -100.0f64..600.0).prop_map(|(x, y)| Point::new(x, y)),
        6,
    )
}

fn smoothing() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(0.0),
        (-6.0f64..4.0).prop_map(|exponent| 10f64.powf(exponent))
    ]
}

/// Solves `a x = b` by elimination with pivots.
fn eliminated(mut a: Vec<Vec<f64>>, mut b: Vec<Vec2>) -> Vec<Vec2> {
    let n = b.len();
    for c in 0..n {
        let pivot = (c..n)
            .max_by(|i, j| a[*i][c].abs().total_cmp(&a[*j][c].abs()))
            .unwrap();
        a.swap(c, pivot);
        b.swap(c, pivot);
        for row in c + 1..n {
            let share = a[row][c] / a[c][c];
            let (above, below) = a.split_at_mut(row);
            below[0][c..]
                .iter_mut()
                .zip(&above[c][c..])
                .for_each(|(x, known)| *x -= share * known);
            let known = b[c] * share;
            b[row] = b[row] - known;
        }
    }
    for c in (0..n).rev() {
        for k in c + 1..n {
            let known = b[k] * a[c][k];
            b[c] = b[c] - known;
        }
        b[c] = b[c] * (1.0 / a[c][c]);
    }
    b
}

/// The spline by its definition, in the normalised coordinates of the contract.
fn bookstein(set: &Set, smoothing: f64, places: &[Point]) -> Vec<Point> {
    let n = set.p.len();
    let sum = set
        .p
        .iter()
        .fold(Vec2::ZERO, |sum, p| sum + (*p - Point::default()));
    let mean = Point::default() + sum * (1.0 / n as f64);
    let unit = (set.p.iter().map(|p| (*p - mean).norm2()).sum::<f64>() / n as f64).sqrt();
    let at = |p: Point| (p - mean) * (1.0 / unit);
    let u = |a: Vec2, b: Vec2| {
        let r2 = (a + b * -1.0).norm2();
        if r2 > 0.0 { r2 * r2.ln() } else { 0.0 }
    };
    let mut a = vec![vec![0.0; n + 3]; n + 3];
    let mut b = vec![Vec2::ZERO; n + 3];
    for i in 0..n {
        let here = at(set.p[i]);
        for (a, p) in a[i].iter_mut().zip(&set.p) {
            *a = u(here, at(*p));
        }
        a[i][i] += smoothing / set.weights[i];
        for (k, value) in [1.0, here.x, here.y].into_iter().enumerate() {
            (a[i][n + k], a[n + k][i]) = (value, value);
        }
        b[i] = set.q[i] - set.p[i];
    }
    let w = eliminated(a, b);
    let map = |v: &Point| {
        let here = at(*v);
        let polynomials = w[n] + w[n + 1] * here.x + w[n + 2] * here.y;
        *v + set
            .p
            .iter()
            .zip(&w)
            .fold(polynomials, |sum, (p, w)| sum + *w * u(here, at(*p)))
    };
    places.iter().map(map).collect()
}

/// The sum of the lengths of the terms whose sum is the displacement at `v`: a coefficient, which
/// is the displacement when one point alone moves by 1 px, times how far its point moves.
fn size_of_terms(field: &RestDeformation, set: &Set, v: Point) -> f64 {
    let term = |(j, (p, q)): (usize, (&Point, &Point))| {
        let mut moved = set.p.clone();
        moved[j] = *p + Vec2::new(1.0, 0.0);
        let alone = field.pose(&handles(&moved)).unwrap();
        (field.map(&alone, v) - v).norm() * (*q - *p).norm()
    };
    set.p.iter().zip(&set.q).enumerate().map(term).sum()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None,
        ..ProptestConfig::default() })]

    #[test]
    fn spline_is_the_solution_of_booksteins_system(set in sets(4), at in places(),
        smoothing in smoothing()) {
        let (field, pose) = set.posed(smoothing);
        for (v, want) in at.iter().zip(bookstein(&set, smoothing, &at)) {
            let got = field.map(&pose, *v);
            prop_assert!(got.distance(want) < 1e-7, "{v:?} -> {got:?}, expected {want:?}, \
                smoothing {smoothing}");
        }
    }

    #[test]
    fn spline_goes_through_the_targets_whatever_the_weights(set in sets(1)) {
        let (field, pose) = set.posed(0.0);
        for (p, q) in set.p.iter().zip(&set.q) {
            for v in [*p, *p + Vec2::new(1e-9, 0.0)] {
                prop_assert!(field.map(&pose, v).distance(*q) < 1e-5, "{p:?} -> {:?}, expected \
                    {q:?}", field.map(&pose, v));
            }
        }
        prop_assert!(field.achieved_displacements(&pose, &|| false) == Some(None));
    }

    #[test]
    fn spline_identity_is_bit_exact(set in sets(1), at in places(), smoothing in smoothing()) {
        let field = set.field(smoothing);
        let pose = field.pose(&handles(&set.p)).unwrap();
        for v in &at {
            prop_assert_eq!(field.map(&pose, *v), *v);
        }
        let table = CoefficientTable::of_vertices(&field, at.len(), |k| at[k]);
        let (displacement, _) = table.displace(&pose, &|| false).unwrap();
        prop_assert!(displacement.iter().all(|d| *d == [0.0, 0.0]));
    }

    #[test]
    fn spline_reproduces_affine_maps_with_any_smoothing(
        set in sets(4), at in places(), m in proptest::array::uniform4(-2.0f64..2.0),
            smoothing in smoothing()
    ) {
        let affine = |p: Point| Point::new(m[0] * p.x + m[1] * p.y + 5.0,
            m[2] * p.x + m[3] * p.y - 9.0);
        let (field, pose) = set.mapped(affine).posed(smoothing);
        for v in &at {
            prop_assert!(field.map(&pose, *v).distance(affine(*v)) < 1e-6, "smoothing {smoothing}");
        }
    }

    #[test]
    fn spline_with_much_smoothing_is_the_weighted_affine_fit(set in sets(4), at in places()) {
        // The normal equations of sum w |(1, x, y) a - d|^2.
        let (mut a, mut b) = (vec![vec![0.0; 3]; 3], vec![Vec2::ZERO; 3]);
        let row = |p: &Point| [1.0, p.x / 100.0, p.y / 100.0];
        for ((p, q), w) in set.p.iter().zip(&set.q).zip(&set.weights) {
            for i in 0..3 {
                (0..3).for_each(|j| a[i][j] += w * row(p)[i] * row(p)[j]);
                b[i] += (*q - *p) * (w * row(p)[i]);
            }
        }
        let fit = eliminated(a, b);
        let off = |smoothing: f64| {
            let (field, pose) = set.posed(smoothing);
            let fitted = |v: &Point| *v + fit.iter().zip(row(v)).fold(Vec2::ZERO, |sum, (a, x)| sum
                + *a * x);
            at.iter().map(|v| field.map(&pose, *v).distance(fitted(v))).fold(0.0, f64::max)
        };
        prop_assert!(off(1e6) < 2e-1 && off(1e9) < 2e-4, "{} {}", off(1e6), off(1e9));
    }

    #[test]
    fn spline_plan_says_what_the_definition_says(set in sets(1), at in places(),
        smoothing in smoothing(), line in any::<bool>()) {
        let set = if line { on_a_line(&set) } else { set };
        let (field, pose) = set.posed(smoothing);
        let table = CoefficientTable::of_vertices(&field, at.len(), |k| at[k]);
        let (displacement, _) = table.displace(&pose, &|| false).unwrap();
        for (v, d) in at.iter().zip(displacement) {
            let off = (field.map(&pose, *v) - *v - Vec2::new(d[0].into(), d[1].into())).norm();
            // Single precision rounds each term, and those of near points, or of points that are
            // almost on a line, are much larger than their sum.
            let most = 1e-3 + 1e-6 * size_of_terms(&field, &set, *v);
            prop_assert!(off <= most, "off by {off:e} of {most:e} at {v:?}, smoothing {smoothing}");
        }
    }

    #[test]
    fn spline_on_a_line_goes_through_the_targets_and_reproduces_similarities(
        set in sets(2), at in places(), m in (-2.0f64..2.0, -2.0f64..2.0), smoothing in smoothing()
    ) {
        let set = on_a_line(&set);
        let (field, pose) = set.posed(0.0);
        prop_assert_eq!(field.warnings(&pose), [Warning::TpsDegenerateUsedSimilarity]);
        for (p, q) in set.p.iter().zip(&set.q) {
            prop_assert!(field.map(&pose, *p).distance(*q) < 1e-6);
        }
        let similar = |p: Point| Point::new(12.0, 30.0) + Vec2::new(m.0,
            m.1).complex_mul(p - Point::default());
        let (field, pose) = set.mapped(similar).posed(smoothing);
        for v in &at {
            prop_assert!(field.map(&pose, *v).distance(similar(*v)) < 1e-5, "{v:?}, smoothing \
                {smoothing}");
        }
    }

    #[test]
    fn spline_of_points_that_coincide_is_that_of_one_with_their_weights(set in sets(1),
        at in places(), smoothing in smoothing()) {
        let (field, pose) = set.posed(smoothing);
        let mut doubled = set.clone();
        doubled.weights.iter_mut().for_each(|w| *w *= 0.5);
        doubled.p.extend(set.p.iter().map(|p| *p + Vec2::new(1e-10, 0.0)));
        doubled.q.extend(&set.q);
        doubled.weights.extend(doubled.weights.clone());
        let (twice, pose_twice) = doubled.posed(smoothing);
        for v in at.iter().chain(&set.p) {
            let (want, got) = (field.map(&pose, *v), twice.map(&pose_twice, *v));
            prop_assert!(want.distance(got) < 1e-6, "{v:?}: {want:?} {got:?}");
        }
    }

    #[test]
    fn spline_turns_grows_and_moves_with_the_plane(
        set in sets(1), at in places(), smoothing in smoothing(), angle in -3.0f64..3.0,
            scale in 0.1f64..10.0
    ) {
        let m = Vec2::new(angle.cos(), angle.sin()) * scale;
        let g = |p: &Point| Point::new(100.0, 50.0) + m.complex_mul(*p - Point::default());
        let there = Set { p: set.p.iter().map(g).collect(), q: set.q.iter().map(g).collect(),
            ..set.clone() };
        let ((here, pose), (elsewhere, pose_there)) = (set.posed(smoothing),
            there.posed(smoothing));
        for v in &at {
            let (want, got) = (g(&here.map(&pose, *v)), elsewhere.map(&pose_there, g(v)));
            prop_assert!(got.distance(want) < 1e-6 * scale.max(1.0), "{v:?}: {got:?}, expected \
                {want:?}");
        }
    }

    #[test]
    fn spline_is_finite_everywhere_for_any_sizes(
        set in sets(1),
        scale in -7.0f64..3.3,
        near in proptest::option::of((-13.0f64..0.0, 0..12usize)),
        flat in prop_oneof![Just(1.0), Just(0.0),
            (-14.0f64..0.0).prop_map(|exponent| 10f64.powf(exponent))],
        weights in proptest::collection::vec(-9.0f64..9.0, 13),
        smoothing in prop_oneof![Just(0.0), Just(1e9),
            (-12.0f64..9.0).prop_map(|exponent| 10f64.powf(exponent))],
        jump in prop_oneof![Just(1.0), Just(1e4)],
    ) {
        let to = |p: &Point| Point::new(p.x * 10f64.powf(scale), p.y * flat * 10f64.powf(scale));
        let far = |p: &Point| Point::new((p.x * jump).clamp(-1e6, 1e6),
            (p.y * jump).clamp(-1e6, 1e6));
        let mut p: Vec<Point> = set.p.iter().map(to).collect();
        let mut q: Vec<Point> = set.q.iter().map(far).collect();
        if let Some((exponent, beside)) = near {
            // A hair beside another, with a target of its own.
            let beside = p[beside % p.len()];
            p.push(beside + Vec2::new(10f64.powf(scale + 2.0 + exponent), 0.0));
            q.push(Point::new(1e6, -1e6));
        }
        let weights = p.iter().zip(weights).map(|(_, exponent)| 10f64.powf(exponent).clamp(1e-9,
            1e9)).collect();
        let field = RestDeformation::spline(Handles::new(handles(&p), Some(weights)).unwrap(),
            smoothing).unwrap();
        let Ok(pose) = field.pose(&handles(&q)) else { return Ok(()) };
        let mut at = vec![Point::new(0.0, 0.0), Point::new(1e6, -1e6), Point::new(250.0, 250.0)];
        at.extend(p.iter().flat_map(|p| [*p, *p + Vec2::new(1e-9, 0.0)]));
        let table = CoefficientTable::of_vertices(&field, at.len(), |k| at[k]);
        let (displacement, _) = table.displace(&pose, &|| false).unwrap();
        for (v, d) in at.iter().zip(displacement) {
            prop_assert!(field.map(&pose, *v).is_finite(), "{v:?}: {:?}", field.map(&pose, *v));
            prop_assert!(d.iter().all(|c| c.is_finite()), "{v:?}: {d:?}");
        }
    }
}

/// Nothing but rounding is left of the kernel beyond the polynomials.
#[test]
fn a_spline_of_points_a_hair_apart_is_finite() {
    let size = 10f64.powf(-3.094_024_258_833_591_6);
    for exponent in [-9.2, -8.575_902_570_309_777, -8.0, -7.0] {
        let (a, b) = (
            Point::new(210.0 * size, 10.0 * size),
            Point::new(482.837_072_702_206_34 * size, 210.0 * size),
        );
        let p = [a, b, b + Vec2::new(size * 10f64.powf(2.0 + exponent), 0.0)];
        let q = [
            Point::new(210.0, 10.0),
            Point::new(480.0, 200.0),
            Point::new(1e6, -1e6),
        ];
        let field = RestDeformation::spline(Handles::new(handles(&p), None).unwrap(), 0.0).unwrap();
        let pose = field.pose(&handles(&q)).unwrap();
        for v in [Point::new(0.0, 0.0), Point::new(1e6, -1e6), a, b] {
            assert!(
                field.map(&pose, v).is_finite(),
                "{exponent}, {v:?}: {:?}",
                field.map(&pose, v)
            );
        }
    }
}

/// The x coordinates of a set, on a line that is not straight to the last bit.
fn on_a_line(set: &Set) -> Set {
    Set {
        p: set
            .p
            .iter()
            .zip(1..)
            .map(|(p, k)| {
                Point::new(0.6, 1.3) + Vec2::new(0.8, 0.6) * (0.1 * p.x + 50.0 * f64::from(k))
            })
            .collect(),
        ..set.clone()
    }
}

#[test]
fn spline_of_nothing_and_of_one_position() {
    let v = Point::new(70.0, 30.0);
    let none = Set {
        p: vec![],
        q: vec![],
        weights: vec![],
    };
    let (field, pose) = none.posed(0.0);
    assert_eq!((field.map(&pose, v), field.warnings(&pose)), (v, vec![]));
    for (p, q) in [
        (vec![(10.0, 20.0)], (15.0, 18.0)),
        (vec![(10.0, 20.0); 3], (15.0, 18.0)),
    ] {
        let p: Vec<Point> = p.into_iter().map(|(x, y)| Point::new(x, y)).collect();
        let set = Set {
            q: vec![Point::new(q.0, q.1); p.len()],
            weights: vec![2.0; p.len()],
            p,
        };
        for smoothing in [0.0, 0.5] {
            let (field, pose) = set.posed(smoothing);
            assert!(field.map(&pose, v).distance(v + Vec2::new(5.0, -2.0)) < 1e-12);
            assert_eq!(field.warnings(&pose), [Warning::TranslationOnly]);
        }
    }
}

#[test]
fn spline_refuses_what_it_does_not_take() {
    let points = || {
        Handles::new(
            handles(&[Point::new(1.0, 2.0), Point::new(30.0, 5.0)]),
            None,
        )
        .unwrap()
    };
    for value in [-1e-9, 1.1e9, f64::INFINITY] {
        assert_eq!(
            RestDeformation::spline(points(), value).unwrap_err(),
            DeformError::BadParameter {
                path: "smoothing",
                value,
                rule: "lie between 0 and 1e9"
            }
        );
    }
    assert!(matches!(
        RestDeformation::spline(points(), f64::NAN),
        Err(DeformError::BadParameter { .. })
    ));
    let line = Handle::Polyline(vec![Point::new(1.0, 2.0), Point::new(3.0, 4.0)]);
    let mixed = Handles::new(
        [handles(&[Point::new(0.0, 0.0)]), vec![line]].concat(),
        None,
    )
    .unwrap();
    assert_eq!(
        RestDeformation::spline(mixed, 0.0).unwrap_err(),
        DeformError::NotTaken {
            handle: 1,
            method: "tps",
            reason: NotTaken::Line
        }
    );
}

/// A group of points is one handle, whatever the policy; the mean of a group may lie on another
/// point.
#[test]
fn spline_moves_coincident_points_by_their_mean() {
    let at = |x: f64, y: f64| Point::new(x, y);
    let p = [
        at(10.0, 20.0),
        at(90.0, 15.0),
        at(20.0, 80.0),
        at(10.0, 20.0),
    ];
    let q = [
        at(14.0, 20.0),
        at(90.0, 25.0),
        at(20.0, 80.0),
        at(10.0, 26.0),
    ];
    let field = |policy, within, p: &[Point]| {
        let rest = Handles::new(handles(p), None).unwrap();
        spline(rest, Coincident { policy, within }, &|| false).unwrap()
    };
    let mean = field(CoincidentPolicy::Mean, 0.0, &p);
    let pose = mean.pose(&handles(&q)).unwrap();
    assert_eq!(
        (mean.groups(), mean.warnings(&pose)),
        (vec![vec![0, 3]], vec![Warning::CoincidentHandles])
    );
    assert!(
        mean.map(&pose, p[0]).distance(at(12.0, 23.0)) < 1e-9,
        "{:?}",
        mean.map(&pose, p[0])
    );
    assert!(mean.map(&pose, p[1]).distance(q[1]) < 1e-9);
    let refused = field(CoincidentPolicy::Reject, 0.0, &p)
        .pose(&handles(&q))
        .unwrap_err();
    assert!(
        matches!(refused, DeformError::Contradictory { total: 1, .. }),
        "{refused:?}"
    );

    // A ring, whose mean is the point in its middle.
    let mut p: Vec<Point> = (0..8)
        .map(|k| f64::from(k) * std::f64::consts::FRAC_PI_4)
        .map(|a| at(50.0 + 8.0 * a.cos(), 50.0 + 8.0 * a.sin()))
        .collect();
    p.extend([
        at(50.0, 50.0),
        at(0.0, 0.0),
        at(200.0, 10.0),
        at(20.0, 170.0),
    ]);
    let mut q = p.clone();
    q[8] = at(58.0, 50.0);
    let ring = field(CoincidentPolicy::Mean, 7.0, &p);
    assert_eq!(ring.groups(), [(0..8).collect::<Vec<_>>()]);
    let pose = ring.pose(&handles(&q)).unwrap();
    // The group of eight stays, and has eight times the weight of the one that moves by 8 px.
    let middle = ring.map(&pose, at(50.0, 50.0));
    assert!(
        middle.distance(at(50.0 + 8.0 / 9.0, 50.0)) < 1e-6,
        "{middle:?}"
    );
}

fn scattered(count: u32) -> Vec<Point> {
    let mut state = 5u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24)
    };
    (0..count)
        .map(|_| Point::new(400.0 * next(), 300.0 * next()))
        .collect()
}

#[test]
fn spline_that_nobody_waits_for_is_given_up_at_the_next_look() {
    let rest = Handles::new(handles(&scattered(120)), None).unwrap();
    let asked = AtomicUsize::new(0);
    assert!(
        spline(rest.clone(), Coincident::default(), &|| asked
            .fetch_add(1, Ordering::Relaxed)
            == usize::MAX)
        .is_ok()
    );
    let looks = asked.into_inner();
    // Each point, each row and each panel.
    assert!(looks >= 120 + 120 + 120 / 8, "{looks}");
    for after in [0, 1, looks / 2, looks - 1] {
        let asked = AtomicUsize::new(0);
        let given_up = spline(rest.clone(), Coincident::default(), &|| {
            asked.fetch_add(1, Ordering::Relaxed) >= after
        });
        assert_eq!(
            (given_up.unwrap_err(), asked.into_inner()),
            (DeformError::Cancelled, after + 1)
        );
    }
}

#[test]
fn many_points_are_posed_without_a_table_and_quickly() {
    let extent = Extent::new(400, 300).unwrap();
    let setup = |count: u32, method, smoothing| {
        let rest = RestSpec {
            p: handles(&scattered(count)),
            method,
            smoothing,
            grid: GridSpec::Cell(20.0),
            ..RestSpec::default()
        };
        ResolvedRest::new(&rest, extent, &limits(), &|| false)
    };
    for (count, method, has_table) in [
        (64, Method::ThinPlateSpline, true),
        (65, Method::ThinPlateSpline, false),
        (32, Method::Rigid, true),
        (33, Method::Rigid, false),
        (128, Method::Similarity, false),
        (100, Method::Affine, true),
    ] {
        let setup = setup(count, method, None).unwrap();
        assert_eq!(
            setup.plan_bytes().is_some(),
            has_table,
            "{count} {method:?}"
        );
        // Steps of its drags are admitted as drags, with a table or without.
        assert!(setup.is_quickly_posed(), "{count} {method:?}");
    }
    assert!(
        setup(65, Method::Affine, None)
            .unwrap()
            .plan_bytes()
            .is_some()
    );
    let error = setup(2001, Method::ThinPlateSpline, None).unwrap_err();
    assert_eq!(
        error,
        WarpError::TooLarge {
            what: Quantity::SystemHandles(Method::ThinPlateSpline),
            limit: 2000,
            actual: 2001
        }
    );
    assert_eq!(
        setup(9, Method::Affine, Some(0.0)).unwrap_err(),
        WarpError::ForeignParameter {
            parameter: "smoothing"
        }
    );

    let p = scattered(100);
    let set = Set {
        q: p.iter()
            .map(|p| *p + Vec2::new(4.0 * (p.y / 30.0).sin(), 3.0))
            .collect(),
        weights: vec![1.0; p.len()],
        p,
    };
    let (field, pose) = set.posed(0.0);
    let grid = Grid::with_counts(400.0, 300.0, 20, 15);
    let (table, without) = (
        CoefficientTable::of_grid(&field, &grid, &|| false)
            .unwrap()
            .pose(&grid, &pose, &|| false)
            .unwrap()
            .0,
        pose_without_table(&field, &grid, &pose, &|| false)
            .unwrap()
            .0,
    );
    for (a, b) in table.displacement().iter().zip(without.displacement()) {
        assert!(
            (a[0] - b[0]).abs() < 1e-3 && (a[1] - b[1]).abs() < 1e-3,
            "{a:?} {b:?}"
        );
    }
}

#[test]
fn spline_setups_differ_by_their_smoothing_and_report_what_is_drawn() {
    let extent = Extent::new(400, 300).unwrap();
    let set: Vec<Point> = scattered(9);
    let posed: Vec<Point> = set
        .iter()
        .zip(0..)
        .map(|(p, k)| *p + Vec2::new(20.0 * f64::from(k % 2), 5.0))
        .collect();
    let residual = |smoothing| {
        let rest = RestSpec {
            p: handles(&set),
            method: Method::ThinPlateSpline,
            smoothing,
            grid: GridSpec::Cell(2.0),
            ..RestSpec::default()
        };
        let setup = ResolvedRest::new(&rest, extent, &limits(), &|| false).unwrap();
        assert_eq!(
            (setup.alpha(), setup.point_mass(), setup.smoothing()),
            (None, None, Some(smoothing.unwrap_or(0.0)))
        );
        let pose = setup.pose(&handles(&posed)).unwrap();
        let mapped = setup.transform(&pose).map(&set, &|| false).unwrap();
        let off = mapped
            .iter()
            .flatten()
            .zip(&posed)
            .map(|(f, q)| f.distance(*q))
            .fold(0.0, f64::max);
        (
            PosedMesh::new(
                &setup,
                &setup.plan(&|| false).unwrap(),
                &pose,
                Folds::Report,
                &|| false,
            )
            .unwrap()
            .report()
            .residual,
            off,
            setup.plan_key(),
        )
    };
    let ((drawn, off, key), (drawn_smooth, off_smooth, key_smooth)) =
        (residual(None), residual(Some(0.1)));
    assert!(drawn < 0.1 && off < 1e-9, "{drawn} {off}");
    // f is off its targets by pixels; what is drawn is not off f.
    assert!(
        drawn_smooth < 0.1 && off_smooth > 2.0,
        "{drawn_smooth} {off_smooth}"
    );
    assert!(key != key_smooth && key == residual(Some(0.0)).2);
}

#[tokio::test]
async fn spline_sessions_keep_their_smoothing_and_map_points_as_drawn() {
    let server = Server::start(&[]).await;
    let (p, q) = (
        json!([[4, 4], [60, 5], [8, 40], [50, 44], [30, 20]]),
        json!([[6, 4], [58, 9], [8, 44], [50, 40], [34, 26]]),
    );
    let id = server
        .session(
            &photo(64, 48),
            &json!({"p": p, "method": "tps", "smoothing": 0.1}),
        )
        .await;
    let path = format!("/sessions/{id}");
    let told = |response: reqwest::Response| async { response.json::<Value>().await.unwrap() };
    let object = told(server.get(&path).send().await.unwrap()).await;
    assert_eq!(
        (&object["method"], &object["smoothing"]),
        (&json!("tps"), &json!(0.1))
    );
    assert!(
        object.get("alpha").is_none() && object.get("point_mass").is_none(),
        "{object}"
    );

    let once = json!({"p": p, "q": q, "method": "tps", "smoothing": 0.1, "extent": [64, 48],
        "points": [[1, 2], [30, 20], [63, 47]]});
    let once = told(server.post("/points").json(&once).send().await.unwrap()).await;
    let mapped = server
        .post(&format!("{path}/points"))
        .json(&json!({"q": q, "points": [[1, 2], [30, 20], [63, 47]]}));
    assert_eq!(told(mapped.send().await.unwrap()).await, once);
    assert!(
        once["points"][1][0].as_f64().unwrap() < 33.9,
        "smoothing holds the middle back: {once}"
    );
    let (drawn, again) = (
        server.drag(&id, &json!({"q": q})).await,
        server.drag(&id, &json!({"q": q})).await,
    );
    assert_eq!(
        (drawn.status(), &drawn.headers()["etag"]),
        (reqwest::StatusCode::OK, &again.headers()["etag"])
    );
    assert!(
        drawn.headers()["warp-residual"]
            .to_str()
            .unwrap()
            .parse::<f64>()
            .unwrap()
            < 0.5,
        "{:?}",
        drawn.headers()
    );

    let handles = |body: Value| {
        let request = server
            .client
            .put(server.url(&format!("{path}/handles")))
            .json(&body);
        async { request.send().await.unwrap() }
    };
    let other =
        told(handles(json!({"p": [[4, 4], [60, 5], [8, 41], [50, 44], [30, 20]]})).await).await;
    assert_eq!(
        (&other["method"], &other["smoothing"]),
        (&json!("tps"), &json!(0.1))
    );
    let exact = told(handles(json!({"smoothing": 0})).await).await;
    assert_eq!(exact["smoothing"], json!(0.0));
    assert_ne!(
        server.drag(&id, &json!({"q": q})).await.headers()["etag"],
        drawn.headers()["etag"]
    );
    problem(handles(json!({"alpha": 2})).await, 422, "bad_value").await;
    problem(
        handles(json!({"p": [[1, 1], [[2, 2], [3, 3]]]})).await,
        422,
        "bad_value",
    )
    .await;
    let rigid = told(handles(json!({"method": "rigid"})).await).await;
    assert_eq!(
        (&rigid["method"], &rigid["alpha"], rigid.get("smoothing")),
        (&json!("rigid"), &json!(1.0), None)
    );
    problem(handles(json!({"smoothing": 0.1})).await, 422, "bad_value").await;
    server.is_well().await;
}
