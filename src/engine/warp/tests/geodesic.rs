//! Warps inside the mask of an image.

use std::sync::Arc;

use serde_json::Value;

use super::super::{
    Digest, Folds, GridSpec, Image, ImageLimits, Limits, Method, Metric, OutputSpec, PosedMesh,
    Quantity, RasterSource, RenderJob, ResolvedRest, RestMask, RestSpec, Warning, WarpError,
};
use super::is_full;
use crate::codec::Compression;
use crate::deform::{DeformError, Handle};
use crate::geometry::Point;
use crate::pixmap::Extent;
use crate::topology::{Mask, Membership};

pub(super) fn point(value: &Value) -> Point {
    Point::new(value[0].as_f64().unwrap(), value[1].as_f64().unwrap())
}

pub(super) fn handles(value: &Value, side: &str) -> Vec<Handle> {
    let points = value["points"].as_array().unwrap().iter();
    points
        .map(|handle| Handle::Point(point(&handle[side])))
        .collect()
}

pub(super) fn mask(rows: &[&str]) -> RestMask {
    let [width, height] = [rows[0].len(), rows.len()].map(|side| u32::try_from(side).unwrap());
    let row = |y: u32, row: &mut [Membership]| {
        for (membership, pixel) in row.iter_mut().zip(rows[y as usize].bytes()) {
            *membership = match pixel {
                b'1' => Membership::Inside,
                b'2' => Membership::Rim,
                _ => Membership::Outside,
            };
        }
    };
    RestMask {
        mask: Arc::new(Mask::new(width, height, row, &|| false).unwrap()),
        digest: Digest::of(rows.concat().as_bytes()),
    }
}

pub(super) fn extent(mask: &RestMask) -> Extent {
    let (width, height) = mask.mask.size();
    let [width, height] = [width, height].map(|side| u32::try_from(side).unwrap());
    Extent::new(width, height).unwrap()
}

fn inside(p: Vec<Handle>, method: Method, mask: &RestMask) -> RestSpec {
    RestSpec {
        p,
        method,
        metric: Metric::Geodesic,
        mask: Some(mask.clone()),
        ..RestSpec::default()
    }
}

fn resolve(rest: &RestSpec) -> Result<ResolvedRest, WarpError> {
    ResolvedRest::new(
        rest,
        extent(rest.mask.as_ref().unwrap()),
        &Limits::default(),
        &|| false,
    )
}

/// f of positions.
fn mapped(rest: &RestSpec, q: &[Handle], at: &[Point]) -> Vec<Point> {
    let resolved = resolve(rest).unwrap();
    let pose = resolved.pose(q).unwrap();
    let mapped = resolved.transform(&pose).map(at, &|| false).unwrap();
    mapped.into_iter().map(Option::unwrap).collect()
}

#[test]
fn f_is_that_of_the_reference_cases() {
    let file: Value = serde_json::from_str(include_str!("../../test_files/rivals.json")).unwrap();
    for case in file["geodesic_cases"].as_array().unwrap() {
        let rows = case["mask"].as_array().unwrap().iter();
        let rows: Vec<&str> = rows.map(|row| row.as_str().unwrap()).collect();
        let mask = mask(&rows);
        let (p, q) = (
            handles(&case["handles"], "p"),
            handles(&case["handles"], "q"),
        );
        let at: Vec<Point> = case["vertices"]
            .as_array()
            .unwrap()
            .iter()
            .map(point)
            .collect();
        for (name, expected) in case["expected"].as_object().unwrap() {
            let (method, alpha) = name.split_once('-').unwrap();
            let method = match method {
                "affine" => Method::Affine,
                "similarity" => Method::Similarity,
                _ => Method::Rigid,
            };
            let rest = RestSpec {
                alpha: alpha.parse().ok(),
                ..inside(p.clone(), method, &mask)
            };
            let found = mapped(&rest, &q, &at);
            for (found, expected) in found.iter().zip(expected.as_array().unwrap()) {
                let distance = found.distance(point(expected));
                assert!(distance < 1e-4, "{} {name}: {distance}", case["name"]);
            }
        }
    }
}

/// Two legs, which join above.
pub(super) const LEGS: [&str; 12] = [
    "111111111111111111111111",
    "111111111111111111111111",
    "111111111111111111111111",
    "111111111111111111111111",
    "111111111110011111111111",
    "111111111110011111111111",
    "111111111110011111111111",
    "111111111110011111111111",
    "111111111110011111111111",
    "111111111110011111111111",
    "111111111110011111111111",
    "111111111110011111111111",
];

pub(super) fn points(places: &[(f64, f64)]) -> Vec<Handle> {
    places
        .iter()
        .map(|(x, y)| Handle::Point(Point::new(*x, *y)))
        .collect()
}

const P: [(f64, f64); 4] = [(2.5, 1.5), (21.25, 1.5), (9.0, 10.5), (15.0, 10.5)];

#[test]
fn the_laws_of_moving_least_squares_hold_inside_a_mask() {
    let mask = mask(&LEGS);
    let at: Vec<Point> = (0..24)
        .flat_map(|x| (0..12).map(move |y| Point::new(f64::from(x) + 0.3, f64::from(y) + 0.6)))
        .collect();
    let p = points(&P);
    for method in [Method::Rigid, Method::Similarity, Method::Affine] {
        let rest = inside(p.clone(), method, &mask);
        assert_eq!(mapped(&rest, &p, &at), at);
        let moved = points(&P.map(|(x, y)| (x + 3.0, y - 2.5)));
        for (found, at) in mapped(&rest, &moved, &at).iter().zip(&at) {
            assert!(found.distance(Point::new(at.x + 3.0, at.y - 2.5)) < 1e-9);
        }
        let turn = |(x, y): (f64, f64)| (0.6 * x - 0.8 * y + 4.0, 0.8 * x + 0.6 * y);
        for (found, at) in mapped(&rest, &points(&P.map(turn)), &at).iter().zip(&at) {
            let (x, y) = turn((at.x, at.y));
            assert!(found.distance(Point::new(x, y)) < 1e-9);
        }
        let q = points(&[(2.5, 1.5), (22.0, 2.0), (7.0, 11.0), (17.0, 9.0)]);
        let places: Vec<Point> = P.iter().map(|(x, y)| Point::new(*x, *y)).collect();
        let at_handles = mapped(&rest, &q, &places);
        assert!(
            at_handles
                .iter()
                .zip(&q)
                .all(|(at, q)| at.distance(q.places()[0]) < 1e-9)
        );
        let (mut reversed_p, mut reversed_q) = (p.clone(), q.clone());
        reversed_p.reverse();
        reversed_q.reverse();
        let reversed = mapped(&inside(reversed_p, method, &mask), &reversed_q, &at);
        let found = mapped(&rest, &q, &at);
        assert!(
            found
                .iter()
                .zip(&reversed)
                .all(|(a, b)| a.distance(*b) < 1e-9)
        );
    }
}

#[test]
fn a_full_mask_is_the_plane() {
    let rows = vec!["1".repeat(40); 30];
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let full = mask(&rows);
    let (p, q) = (
        points(&P),
        points(&[(2.5, 1.5), (30.0, 2.0), (7.0, 20.0), (17.0, 9.0)]),
    );
    let rest = inside(p, Method::Rigid, &full);
    let resolved = resolve(&rest).unwrap();
    assert_eq!(resolved.rest_warnings(), [Warning::MaskIsEverything]);
    let plane = RestSpec {
        metric: Metric::Euclidean,
        mask: None,
        alpha: Some(2.0),
        ..rest.clone()
    };
    let plane = ResolvedRest::new(&plane, extent(&full), &Limits::default(), &|| false).unwrap();
    assert_eq!(resolved.plan_key(), plane.plan_key());
    // Nearly full: one corner is missing, and nothing lies behind it.
    let rows: Vec<String> = (0..30)
        .map(|y| {
            if y == 29 {
                format!("{}0", "1".repeat(39))
            } else {
                "1".repeat(40)
            }
        })
        .collect();
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let nearly = inside(rest.p, Method::Rigid, &mask(&rows));
    let at: Vec<Point> = (0..38).map(|k| Point::new(f64::from(k), 3.0)).collect();
    let pose = plane.pose(&q).unwrap();
    let expected = plane.transform(&pose).map(&at, &|| false).unwrap();
    for (found, expected) in mapped(&nearly, &q, &at).iter().zip(expected) {
        assert!(found.distance(expected.unwrap()) < 1e-9);
    }
}

#[test]
fn what_has_no_distances_inside_the_mask_is_refused() {
    let mask = mask(&LEGS);
    let rest = |p: &[(f64, f64)]| inside(points(p), Method::Rigid, &mask);
    assert_eq!(
        resolve(&rest(&[(2.0, 2.0), (12.0, 18.0)])).unwrap_err(),
        WarpError::Rest(DeformError::OutsideMask { handle: 1 })
    );
    // From one leg to the other.
    let line = Handle::Polyline(vec![Point::new(4.0, 9.0), Point::new(20.0, 9.0)]);
    let across = inside(vec![points(&P).remove(0), line], Method::Rigid, &mask);
    assert_eq!(
        resolve(&across).unwrap_err(),
        WarpError::Rest(DeformError::OutsideMask { handle: 1 })
    );
    let spline = inside(points(&P), Method::ThinPlateSpline, &mask);
    assert_eq!(
        resolve(&spline).unwrap_err(),
        WarpError::Rest(DeformError::NoMetric { method: "tps" })
    );
    let empty = inside(
        points(&P),
        Method::Rigid,
        &super::geodesic::mask(&["0000", "0200"]),
    );
    assert_eq!(
        resolve(&empty).unwrap_err(),
        WarpError::Rest(DeformError::EmptyMask)
    );
    let no_mask = RestSpec {
        mask: None,
        ..rest(&P)
    };
    let extent = extent(&mask);
    let refused = ResolvedRest::new(&no_mask, extent, &Limits::default(), &|| false);
    assert_eq!(refused.unwrap_err(), WarpError::NoImage);
    let uneven = RestSpec {
        grid: GridSpec::Cell(2.5),
        ..rest(&P)
    };
    assert!(matches!(resolve(&uneven), Err(WarpError::BadGrid(_))));
    let little = Limits {
        plan_bytes: 20_000,
        ..Limits::default()
    };
    let refused = ResolvedRest::new(&rest(&P), extent, &little, &|| false).unwrap_err();
    assert!(
        matches!(refused, WarpError::Rest(DeformError::MaskTooLarge { .. })),
        "{refused:?}"
    );
}

#[test]
fn a_grid_whose_quads_take_too_much_memory_is_refused() {
    let [even, odd] = ["10", "01"].map(|pair| pair.repeat(150));
    let rows: Vec<&str> = [&*even, &*odd].into_iter().cycle().take(300).collect();
    let mask = mask(&rows);
    let rest = RestSpec {
        grid: GridSpec::Cell(128.0),
        ..inside(points(&[(0.5, 0.5)]), Method::Rigid, &mask)
    };
    let limits = Limits {
        plan_bytes: 64 << 20,
        ..Limits::default()
    };
    let is_refused = |error: &WarpError| {
        matches!(error, WarpError::TooLarge { what: Quantity::PlanBytes, limit, actual }
            if *limit == 64 << 20 && actual > limit)
    };
    let refused = rest.field_bytes(&limits, &|| false).unwrap_err();
    assert!(is_refused(&refused), "{refused:?}");
    let refused = ResolvedRest::new(&rest, extent(&mask), &limits, &|| false).unwrap_err();
    assert!(is_refused(&refused), "{refused:?}");
    let stopped = rest.field_bytes(&limits, &|| true);
    assert_eq!(stopped.unwrap_err(), WarpError::Cancelled);
    let bytes = rest.field_bytes(&Limits::default(), &|| false).unwrap();
    assert!(bytes.peak > 300 * 150 * 2048 && bytes.kept < bytes.peak);
}

#[test]
fn lines_act_inside_a_mask_as_points_do() {
    let mask = mask(&LEGS);
    let line = |places: &[(f64, f64)]| {
        Handle::Polyline(places.iter().map(|(x, y)| Point::new(*x, *y)).collect())
    };
    let p = vec![
        line(&[(9.0, 10.5), (9.0, 6.0), (5.0, 2.0)]),
        line(&[(15.5, 10.0), (15.0, 5.0)]),
        points(&P).remove(1),
    ];
    let q = vec![
        line(&[(9.0, 10.5), (9.0, 6.0), (5.0, 2.0)]),
        line(&[(18.5, 9.0), (15.0, 5.0)]),
        points(&P).remove(1),
    ];
    let at: Vec<Point> = (0..24)
        .flat_map(|x| (0..12).map(move |y| Point::new(f64::from(x) + 0.3, f64::from(y) + 0.6)))
        .filter(|at| mask.mask.pixel_at(*at, 0.0).is_some())
        .collect();
    for method in [Method::Rigid, Method::Similarity, Method::Affine] {
        let rest = inside(p.clone(), method, &mask);
        assert_eq!(mapped(&rest, &p, &at), at);
        let turn = |v: &Point| Point::new(0.6 * v.x - 0.8 * v.y + 4.0, 0.8 * v.x + 0.6 * v.y);
        let turned: Vec<Handle> = p
            .iter()
            .map(|handle| match handle {
                Handle::Point(at) => Handle::Point(turn(at)),
                line => Handle::Polyline(line.places().iter().map(turn).collect()),
            })
            .collect();
        for (found, at) in mapped(&rest, &turned, &at).iter().zip(&at) {
            assert!(found.distance(turn(at)) < 1e-9, "{method:?}");
        }
        let on_lines = [
            Point::new(9.0, 8.0),
            Point::new(7.0, 4.0),
            Point::new(15.25, 7.5),
        ];
        let moved = [on_lines[0], on_lines[1], Point::new(16.75, 7.0)];
        for (found, want) in mapped(&rest, &q, &on_lines).iter().zip(moved) {
            assert!(
                found.distance(want) < 1e-6,
                "{method:?}: {found:?} {want:?}"
            );
        }
        // The foot beside the one that bends stays; in the plane it does not.
        let foot = [Point::new(10.5, 11.5)];
        let far = |rest: &RestSpec| mapped(rest, &q, &foot)[0].distance(foot[0]);
        let plane = RestSpec {
            metric: Metric::Euclidean,
            ..rest.clone()
        };
        assert!(
            far(&rest) < 0.5 * far(&plane),
            "{method:?}: {} {}",
            far(&rest),
            far(&plane)
        );
    }
    // Without a wall, a line in the mask is one in the plane.
    let rows: Vec<String> = (0..30)
        .map(|y| {
            if y == 29 {
                format!("{}0", "1".repeat(39))
            } else {
                "1".repeat(40)
            }
        })
        .collect();
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let nearly = inside(p.clone(), Method::Rigid, &super::geodesic::mask(&rows));
    let plane = RestSpec {
        metric: Metric::Euclidean,
        alpha: Some(2.0),
        ..nearly.clone()
    };
    for (a, b) in mapped(&nearly, &q, &at).iter().zip(mapped(&plane, &q, &at)) {
        assert!(a.distance(b) < 1e-6, "{a:?} {b:?}");
    }
}

/// A hind and a front hoof are pinned each, and one front hoof is dragged.
pub(super) const HORSE: [(f64, f64); 11] = [
    (122.0, 606.0),
    (248.0, 600.0),
    (512.0, 604.0),
    (562.0, 614.0),
    (150.0, 240.0),
    (330.0, 215.0),
    (545.0, 300.0),
    (600.0, 120.0),
    (700.0, 70.0),
    (752.0, 180.0),
    (62.0, 470.0),
];

#[test]
fn a_dragged_hoof_leaves_the_others_where_they_are() {
    let file = include_bytes!("../../test_files/images/horse-cutout.png");
    let image = Arc::new(Image::decode(file, &ImageLimits::default(), &|| false).unwrap());
    let mask = RestMask::of_image(&image, None, RestMask::THRESHOLD, &|| false).unwrap();
    let (p, mut q) = (points(&HORSE), HORSE);
    q[3] = (614.0, 584.0);
    let q = points(&q);
    let geodesic = inside(p, Method::Rigid, &mask);
    let plane = RestSpec {
        metric: Metric::Euclidean,
        alpha: Some(2.0),
        ..geodesic.clone()
    };
    let mut moves = Vec::new();
    for (name, rest) in [("plane", plane), ("inside", geodesic)] {
        let resolved = resolve(&rest).unwrap();
        let pose = resolved.pose(&q).unwrap();
        let plan = resolved.plan(&|| false).unwrap();
        let posed = PosedMesh::new(&resolved, &plan, &pose, Folds::Report, &|| false).unwrap();
        assert!(posed.report().residual < 0.3, "{}", posed.report().residual);
        let worst = (575..image.extent().height())
            .flat_map(|y| (0..530).map(move |x| (x, y)))
            .filter(|(x, y)| mask.mask.is_inside(*x as usize, *y as usize))
            .map(|(x, y)| Point::new(f64::from(x) + 0.5, f64::from(y) + 0.5))
            .map(|at| posed.mesh().map(at).unwrap().distance(at))
            .fold(0.0, f64::max);
        moves.push(worst);
        let output = OutputSpec {
            width: Some(320),
            compression: Compression::Best,
            ..OutputSpec::default()
        };
        let (subject, limits) = (RasterSource::Image(&image), Limits::default());
        let job = RenderJob::new(subject, &posed, &output, &limits, &|| false).unwrap();
        let mut png = Vec::new();
        let _ = job.write(0, &(), &mut |bytes| {
            png.extend(bytes);
            std::ops::ControlFlow::Continue(())
        });
        // The pictures that MATHEMATICS.md speaks of; `MLSWARP_BLESS` draws them again.
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/test_files/images");
        let path = format!("{folder}/hoof-{name}.png");
        if std::env::var_os("MLSWARP_BLESS").is_some() {
            std::fs::write(&path, &png).unwrap();
        }
        assert!(std::fs::read(&path).unwrap() == png, "{path} differs");
    }
    assert!(moves[0] > 10.0 && moves[1] <= 1.0, "{moves:?}");
}

/// A pixel in every seven by seven: a million parts.
fn dots(y: u32, row: &mut [Membership]) {
    for (x, membership) in (0_u32..).zip(row) {
        *membership = match [x, y].map(|c| c % 7) {
            [3, 3] => Membership::Inside,
            _ => Membership::Outside,
        };
    }
}

/// Every second pixel.
fn checkerboard(y: u32, row: &mut [Membership]) {
    for (x, membership) in (0_u32..).zip(row) {
        *membership = match (x + y) % 2 {
            0 => Membership::Inside,
            _ => Membership::Outside,
        };
    }
}

/// Walls a pixel wide from side to side in turn: one path through all of the image.
fn winding(y: u32, row: &mut [Membership]) {
    let last = row.len() - 1;
    for (x, membership) in row.iter_mut().enumerate() {
        let is_gap = x == if y % 4 == 1 { last } else { 0 };
        *membership = match y.is_multiple_of(2) || is_gap {
            true => Membership::Inside,
            false => Membership::Outside,
        };
    }
}

#[test]
fn fifty_megapixels_of_noise_are_refused_before_they_are_computed() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    let limits = Limits::default();
    let (one, many): (&[i32], &[i32]) = match is_full() {
        true => (&[1], &[1, 10_000]),
        false => (&[1], &[10_000]),
    };
    for (name, picture, counts) in [
        ("dots", dots as fn(u32, &mut [Membership]), many),
        ("checkerboard", checkerboard, one),
        ("winding", winding, one),
    ] {
        let mask = RestMask {
            mask: Arc::new(Mask::new(7000, 7000, picture, &|| false).unwrap()),
            digest: Digest::of(name.as_bytes()),
        };
        let extent = extent(&mask);
        for &count in counts {
            let at = |k: i32| {
                (
                    f64::from(k % 100) * 70.0 + 3.5,
                    f64::from(k / 100) * 70.0 + 3.5,
                )
            };
            let p = points(&(0..count).map(at).collect::<Vec<_>>());
            let rest = inside(p, Method::Rigid, &mask);
            // The estimate of memory is bounded, or refuses the mask itself.
            match rest.field_bytes(&limits, &|| false) {
                Ok(bytes) => assert!(bytes.peak < 3 * limits.plan_bytes, "{name} {count}"),
                Err(error) => assert!(matches!(error, WarpError::TooLarge { .. }), "{error:?}"),
            }
            let asked = AtomicUsize::new(0);
            let new = |after: usize| {
                asked.store(0, Ordering::Relaxed);
                let cancelled = || asked.fetch_add(1, Ordering::Relaxed) >= after;
                // What is resolved would be printed with all of its pixels.
                let resolved = ResolvedRest::new(&rest, extent, &limits, &cancelled);
                let Err(refused) = resolved else {
                    panic!("it is refused");
                };
                refused
            };
            let refused = new(usize::MAX);
            let WarpError::Rest(refused) = refused else {
                panic!("{refused:?}");
            };
            let is_winding = matches!(refused, DeformError::MaskTooWinding { .. });
            let is_large = matches!(refused, DeformError::MaskTooLarge { .. });
            assert!(is_large || is_winding && count == 1, "{name}: {refused:?}");
            let looks = asked.load(Ordering::Relaxed);
            assert!(looks >= 7000, "{name} {count}: {looks}");
            assert_eq!(new(looks / 3), WarpError::Cancelled, "{name} {count}");
            assert_eq!(
                asked.load(Ordering::Relaxed),
                looks / 3 + 1,
                "{name} {count}"
            );
        }
    }
}
