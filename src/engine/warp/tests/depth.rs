//! Depths of handles: which of what overlaps is in front.

use super::super::{
    CompiledRest, Folds, GridSpec, Limits, Method, Metric, PosedMesh, ResolvedRest, RestSpec,
    WarpError,
};
use super::drawn::shown;
use super::geodesic::{extent as extent_of, mask};
use crate::deform::{DeformError, Handle};
use crate::geometry::{DrawingOrder, Point};
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
            let found = setup.inverse(&pose, &posed).map(&at, &|| false);
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
            let inverse = setup.inverse(&pose, &posed);
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

#[test]
fn depths_far_from_0_are_told_apart_and_one_handle_has_none() {
    let (p, q, extent) = sheet();
    let p_of_one = points(&[(30.0, 60.0)]);
    for method in OF_POINTS {
        let order = |depths: [f64; 3]| {
            let rest = of_method(method, p.clone(), Some(pairs(depths)));
            posed(&rest, &q, extent).2.mesh().order().cloned()
        };
        let [two, three] = [order([0.0, 0.0, 1.0]), order([1.0, 0.0, 0.5])];
        assert!(two.is_some() && three.is_some());
        for least in [
            -1000.0,
            -1e-300,
            0.0,
            1e-12,
            0.1,
            999.0,
            1000_f64.next_down(),
        ] {
            let above = f64::next_up(least);
            assert_eq!(order([least, least, above]), two, "{method:?} {least}");
            assert_eq!(order([least; 3]), None);
        }
        for (least, half) in [
            (-1000.0, 1000.0),
            (999.0, 1e-9),
            (0.0, 5e-324),
            (0.0, 1e-310),
        ] {
            let [middle, most] = [least + half, least + half + half];
            if middle - least == most - middle {
                let found = order([most, least, middle]);
                assert_eq!(found, three, "{method:?} {least} {half}");
            }
        }
        let one = of_method(method, p_of_one.clone(), Some(vec![1000.0]));
        let (setup, _, posed) = posed(&one, &p_of_one, extent);
        assert_eq!((posed.mesh().order(), setup.order_bytes()), (None, 0));
    }
}

#[test]
fn the_order_is_computed_once_for_all_setups_that_share_it() {
    let (p, _, extent) = sheet();
    let rest = RestSpec {
        grid: GridSpec::Pixel,
        ..of_method(Method::Rigid, p, Some(pairs([0.0, 0.0, 1.0])))
    };
    let new = || ResolvedRest::new(&rest, extent, &Limits::default(), &|| false).unwrap();
    let (setup, other) = (new(), new());
    let plan = setup.plan(&|| false).unwrap();
    let key = setup.lacks_order();
    assert!(key.is_some() && key == other.lacks_order());
    other.keep_order(&setup.order(&plan, &|| false).unwrap());
    // Nothing is left to be cancelled.
    other.order(&plan, &|| true).unwrap();
    assert_eq!((setup.lacks_order(), other.lacks_order()), (None, None));
    // On the grid on which the inverse is searched, too.
    let to_invert = || setup.to_invert(&Limits::default()).unwrap();
    assert_ne!(to_invert().plan_key(), setup.plan_key());
    assert!(to_invert().lacks_order().is_some() && to_invert().lacks_order() != key);
    let plan = to_invert().plan(&|| false).unwrap();
    let _ = to_invert().order(&plan, &|| false).unwrap();
    assert_eq!(to_invert().lacks_order(), None);
    let bytes = |setup: &ResolvedRest| DrawingOrder::bytes_for(setup.grid().len() as u64);
    assert!(setup.order_bytes() > bytes(&setup) + bytes(&to_invert()));
}

#[test]
fn an_order_that_nobody_waits_for_is_given_up_and_its_work_is_estimated() {
    let (p, _, extent) = sheet();
    let legs = mask(&super::geodesic::LEGS);
    let inside = points(&[(2.5, 1.5), (21.25, 1.5), (9.0, 10.5)]);
    for method in [Method::Rigid, Method::Similarity, Method::ThinPlateSpline] {
        for is_cut in [false, true] {
            if is_cut && method == Method::ThinPlateSpline {
                continue;
            }
            let (p, extent) = match is_cut {
                true => (inside.clone(), extent_of(&legs)),
                false => (p.clone(), extent),
            };
            let mut depth = vec![0.0; p.len()];
            depth[0] = 1.0;
            let with = RestSpec {
                mask: is_cut.then(|| legs.clone()),
                metric: match is_cut {
                    true => Metric::Geodesic,
                    false => Metric::Euclidean,
                },
                grid: match is_cut {
                    true => GridSpec::Cell(4.0),
                    false => GridSpec::Auto,
                },
                ..of_method(method, p, Some(depth))
            };
            let without = RestSpec {
                depth: None,
                ..with.clone()
            };
            let new = |rest: &RestSpec, work: u64| {
                let limits = Limits {
                    work,
                    ..Limits::default()
                };
                ResolvedRest::new(rest, extent, &limits, &|| false)
            };
            let setup = new(&with, u64::MAX).unwrap();
            // What every sort needs, and what is carried without weights.
            let vertices = setup.grid().len() as u64;
            let least = match method {
                Method::ThinPlateSpline => (512 << 10) + 48 * vertices.min(1 << 16),
                _ => 512 << 10,
            };
            assert!(setup.order_peak_bytes() > least, "{method:?} {is_cut}");
            let plan = setup.plan(&|| false).unwrap();
            let given_up = setup.order(&plan, &|| true).unwrap_err();
            assert_eq!(given_up, WarpError::Cancelled, "{method:?} {is_cut}");
            // The least limit at which there is a setup without depths is too small for one with.
            let (mut refused, mut taken) = (0, 1 << 40);
            while refused + 1 < taken {
                let middle = u64::midpoint(refused, taken);
                match new(&without, middle) {
                    Ok(_) => taken = middle,
                    Err(_) => refused = middle,
                }
            }
            let is_too_much = |setup: Result<ResolvedRest, WarpError>| {
                matches!(setup, Err(WarpError::TooMuchWork { .. }))
            };
            // The largest task of a mask may be its distances.
            let limited = new(&without, taken).unwrap();
            if !is_cut {
                assert!(is_too_much(new(&with, taken)), "{method:?}");
                assert!(is_too_much(limited.with_depth(&with)), "{method:?}");
            }
            assert!(new(&with, 2 * taken).is_ok(), "{method:?} {is_cut}");
        }
    }
}
