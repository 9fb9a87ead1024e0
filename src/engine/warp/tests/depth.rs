//! Depths of handles: which of what overlaps is in front.

use super::super::{
    CompiledRest, Folds, Limits, Method, Metric, PosedMesh, ResolvedRest, RestSpec, WarpError,
};
use super::drawn::shown;
use super::geodesic::{extent as extent_of, mask};
use crate::deform::{DeformError, Handle};
use crate::geometry::Point;
use crate::pixmap::Extent;

fn points(places: &[(f64, f64)]) -> Vec<Handle> {
    let points = places.iter();
    points
        .map(|(x, y)| Handle::Point(Point::new(*x, *y)))
        .collect()
}

fn posed(rest: &RestSpec, q: &[Handle], extent: Extent) -> (ResolvedRest, CompiledRest, PosedMesh) {
    let setup = ResolvedRest::new(rest, extent, &Limits::default(), &|| false).unwrap();
    let (plan, pose) = (setup.plan(&|| false).unwrap(), setup.pose(q).unwrap());
    let posed = PosedMesh::new(&setup, &plan, &pose, Folds::Report, &|| false).unwrap();
    (setup, plan, posed)
}

/// Two handles at each x.
fn two_rows(xs: [f64; 3]) -> Vec<Handle> {
    points(&xs.map(|x| [(x, 30.0), (x, 90.0)]).concat())
}

/// The depths of the three pairs.
fn pairs(depths: [f64; 3]) -> Vec<f64> {
    depths.map(|depth| [depth; 2]).concat()
}

/// A sheet whose right end is laid over its left half.
fn sheet() -> (Vec<Handle>, Vec<Handle>, Extent) {
    (
        two_rows([30.0, 100.0, 170.0]),
        two_rows([30.0, 100.0, 60.0]),
        Extent::new(200, 120).unwrap(),
    )
}

fn of_method(method: Method, p: Vec<Handle>, depth: Option<Vec<f64>>) -> RestSpec {
    RestSpec {
        p,
        method,
        depth,
        ..RestSpec::default()
    }
}

const OF_POINTS: [Method; 4] = [
    Method::Rigid,
    Method::Similarity,
    Method::Affine,
    Method::ThinPlateSpline,
];

#[test]
fn a_folded_sheet_shows_the_layer_in_front() {
    let extent = Extent::new(200, 120).unwrap();
    let p = points(&[(30.0, 60.0), (100.0, 50.0), (170.0, 60.0)]);
    let q = points(&[(30.0, 60.0), (100.0, 50.0), (60.0, 60.0)]);
    let middle = |posed: &PosedMesh| shown(posed, extent)[60 * 200 + 60].unwrap();
    for method in [Method::Rigid, Method::Similarity] {
        for (depth, expected) in [(1.0, 170.0), (-1.0, 60.0)] {
            let rest = of_method(method, p.clone(), Some(vec![0.0, 0.0, depth]));
            let (setup, _, posed) = posed(&rest, &q, extent);
            let seen = middle(&posed);
            assert!(
                (seen.x - expected).abs() < 25.0,
                "{method:?} {depth}: {seen:?}"
            );
            // The inverse finds what is drawn.
            let pose = setup.pose(&q).unwrap();
            let at = [Point::new(60.5, 60.5)];
            let found = setup.inverse(&pose, posed.mesh()).map(&at, &|| false);
            let found = found.unwrap()[0].unwrap();
            assert!(
                found.distance(seen) < 1.5,
                "{method:?} {depth}: {found:?} {seen:?}"
            );
        }
    }
}

#[test]
fn equal_depths_are_none() {
    let (p, q, extent) = sheet();
    for method in OF_POINTS {
        let of = |depth| posed(&of_method(method, p.clone(), depth), &q, extent);
        let (plain, _, without) = of(None);
        let (setup, _, equal) = of(Some(vec![7.5; 6]));
        assert!(equal.mesh().order().is_none());
        assert_eq!(
            (setup.plan_key(), equal.digest()),
            (plain.plan_key(), without.digest())
        );
        assert_eq!(setup.order_bytes(), 0);
        let (setup, plan, other) = of(Some(pairs([0.0, 0.0, 1.0])));
        assert_eq!(setup.plan_key(), plain.plan_key());
        assert_ne!(other.digest(), without.digest());
        // Only the differences count, and other depths cost nothing but their order.
        for depth in [pairs([-500.0, -500.0, -100.0]), pairs([0.0, 0.0, 1e-6])] {
            assert_eq!(of(Some(depth)).2.mesh().order(), other.mesh().order());
        }
        let rest = of_method(method, p.clone(), Some(pairs([0.0, 0.0, 1.0])));
        let again = plain.with_depth(&rest).unwrap();
        let pose = again.pose(&q).unwrap();
        let again = PosedMesh::new(&again, &plan, &pose, Folds::Report, &|| false).unwrap();
        assert_eq!(again.mesh().order(), other.mesh().order());
        assert_eq!(again.digest(), other.digest());
    }
}

#[test]
fn the_order_of_handles_and_the_number_of_threads_do_not_matter() {
    let (p, q, extent) = sheet();
    let depth = pairs([0.3, 0.0, 1.0]);
    let backwards = |handles: &[Handle]| handles.iter().rev().cloned().collect::<Vec<_>>();
    for method in OF_POINTS {
        let rest = of_method(method, p.clone(), Some(depth.clone()));
        let expected = posed(&rest, &q, extent).2;
        let reversed = depth.iter().rev().copied().collect();
        let rest = of_method(method, backwards(&p), Some(reversed));
        let other = posed(&rest, &backwards(&q), extent).2;
        let moved = |(a, b): (Option<Point>, Option<Point>)| match (a, b) {
            (Some(a), Some(b)) => a.distance(b) > 0.1,
            (a, b) => a.is_some() != b.is_some(),
        };
        let pixels = shown(&expected, extent)
            .into_iter()
            .zip(shown(&other, extent));
        assert_eq!(pixels.filter(|pair| moved(*pair)).count(), 0, "{method:?}");
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let rest = of_method(method, p.clone(), Some(depth.clone()));
            let same = pool.build().unwrap().install(|| posed(&rest, &q, extent).2);
            assert_eq!(
                same.mesh().order(),
                expected.mesh().order(),
                "{method:?} {threads}"
            );
        }
    }
}

/// Two legs that cross below a bridge.
#[test]
fn the_leg_in_front_covers_the_other() {
    let leg = |x: usize| (10..18).contains(&x) || (40..48).contains(&x);
    let row = |y: usize| {
        let is_inside = |x: usize| y < 12 && (10..48).contains(&x) || leg(x);
        (0..58)
            .map(|x| if is_inside(x) { '1' } else { '0' })
            .collect::<String>()
    };
    let rows: Vec<String> = (0..60).map(row).collect();
    let mask = mask(&rows.iter().map(String::as_str).collect::<Vec<_>>());
    let extent = extent_of(&mask);
    let p = points(&[(14.0, 6.0), (44.0, 6.0), (14.0, 56.0), (44.0, 56.0)]);
    let q = points(&[(14.0, 6.0), (44.0, 6.0), (40.0, 50.0), (18.0, 50.0)]);
    for method in [
        Method::Rigid,
        Method::Similarity,
        Method::Affine,
        Method::AsRigidAsPossible,
    ] {
        let metric = match method {
            Method::AsRigidAsPossible => Metric::Euclidean,
            _ => Metric::Geodesic,
        };
        let drawn = |front: usize| {
            let mut depth = vec![0.0; 4];
            depth[front] = 1.0;
            let rest = RestSpec {
                metric,
                mask: Some(mask.clone()),
                ..of_method(method, p.clone(), Some(depth))
            };
            let (setup, _, posed) = posed(&rest, &q, extent);
            let at = |k: usize| Point::new((k % 58) as f64 + 0.5, (k / 58) as f64 + 0.5);
            let shown = shown(&posed, extent);
            let pose = setup.pose(&q).unwrap();
            let inverse = setup.inverse(&pose, posed.mesh());
            for (k, seen) in shown.iter().enumerate().filter(|(k, _)| k % 7 == 0) {
                let found = inverse.map(&[at(k)], &|| false).unwrap()[0];
                if let (Some(seen), Some(found)) = (seen, found) {
                    assert!(
                        found.distance(*seen) < 3.0,
                        "{method:?} {k}: {seen:?} {found:?}"
                    );
                }
            }
            shown
        };
        let (left, right) = (drawn(2), drawn(3));
        let mut crossing = 0;
        for (left, right) in left.into_iter().zip(right) {
            assert_eq!(left.is_some(), right.is_some());
            if let (Some(left), Some(right)) = (left, right)
                && left.distance(right) > 2.0
            {
                crossing += 1;
                assert!(
                    left.x < 29.0 && right.x > 29.0,
                    "{method:?}: {left:?} {right:?}"
                );
            }
        }
        assert!(crossing > 20, "{method:?}: {crossing}");
    }
}

#[test]
fn depths_are_one_for_each_handle_and_within_their_range() {
    let (p, _, extent) = sheet();
    let refused = |depth: Vec<f64>| {
        let rest = of_method(Method::Rigid, p.clone(), Some(depth));
        let refused = ResolvedRest::new(&rest, extent, &Limits::default(), &|| false);
        match refused.unwrap_err() {
            WarpError::Rest(error) => error,
            error => panic!("{error}"),
        }
    };
    let count = DeformError::DepthCount { rest: 6, depths: 2 };
    assert_eq!(refused(vec![0.0; 2]), count);
    for wrong in [1e300, -1000.1, f64::NAN, f64::INFINITY] {
        let error = refused(vec![0.0, wrong, 0.0, 0.0, 0.0, 0.0]);
        assert!(
            matches!(error, DeformError::BadDepth { handle: 1, .. }),
            "{error}"
        );
    }
}
