//! Warps that are as rigid as possible.

use std::sync::Arc;

use serde_json::Value;

use super::super::{
    Folds, GridSpec, Image, ImageLimits, Limits, Method, Metric, OutputSpec, PosedMesh,
    RasterSource, RenderJob, ResolvedRest, RestMask, RestSpec, Warning, WarpError,
};
use super::geodesic::{HORSE, LEGS, extent, handles, mask, point, points};
use crate::codec::Compression;
use crate::deform::{self, DeformError, Handle};
use crate::geometry::Point;

fn puppet(p: Vec<Handle>, mask: &RestMask, cell: Option<f64>) -> RestSpec {
    RestSpec {
        p,
        method: Method::AsRigidAsPossible,
        own: deform::Parameters::default().with_some("arap/cell", cell),
        mask: Some(mask.clone()),
        ..RestSpec::default()
    }
}

fn resolve(rest: &RestSpec) -> Result<ResolvedRest, WarpError> {
    let extent = extent(rest.mask.as_ref().unwrap());
    ResolvedRest::new(rest, extent, &Limits::default(), &|| false)
}

/// f of positions.
fn mapped(rest: &RestSpec, q: &[Handle], at: &[Point]) -> Vec<Point> {
    let resolved = resolve(rest).unwrap();
    let pose = resolved.pose(q).unwrap();
    let mapped = resolved.transform(&pose).map(at, &|| false).unwrap();
    mapped.into_iter().map(Option::unwrap).collect()
}

fn rows(case: &Value) -> Vec<&str> {
    let rows = case["mask"].as_array().unwrap().iter();
    rows.map(|row| row.as_str().unwrap()).collect()
}

#[test]
fn f_is_that_of_the_reference_cases() {
    let file: Value = serde_json::from_str(include_str!("../../test_files/rivals.json")).unwrap();
    let mut cases = 0;
    for case in file["arap_cases"].as_array().unwrap() {
        if case["triangulation"] != "both" {
            continue;
        }
        cases += 1;
        let mask = mask(&rows(case));
        let rest = puppet(
            handles(&case["handles"], "p"),
            &mask,
            case["spacing"].as_f64(),
        );
        let posed: Vec<Point> = case["expected"]
            .as_array()
            .unwrap()
            .iter()
            .map(point)
            .collect();
        let rest_at: Vec<Point> = case["vertices"]
            .as_array()
            .unwrap()
            .iter()
            .map(point)
            .collect();
        // The centre of each quad is in one component where the whole cell is inside.
        let (mut at, mut expected) = (Vec::new(), Vec::new());
        for quad in case["quads"].as_array().unwrap() {
            let corners: Vec<usize> = quad
                .as_array()
                .unwrap()
                .iter()
                .map(|vertex| usize::try_from(vertex.as_u64().unwrap()).unwrap())
                .collect();
            let mean = |of: &[Point]| {
                let sum = corners
                    .iter()
                    .fold((0.0, 0.0), |(x, y), k| (x + of[*k].x, y + of[*k].y));
                Point::new(sum.0 / 4.0, sum.1 / 4.0)
            };
            let (side, centre) = (case["spacing"].as_f64().unwrap(), mean(&rest_at));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a cell of the lattice"
            )]
            let [x0, y0, side] =
                [centre.x - side / 2.0, centre.y - side / 2.0, side].map(|c| c as usize);
            let (width, height) = mask.mask.size();
            let mut pixels = (y0..(y0 + side).min(height))
                .flat_map(|y| (x0..(x0 + side).min(width)).map(move |x| (x, y)));
            let is_whole = centre.x < width as f64
                && centre.y < height as f64
                && pixels.all(|(x, y)| mask.mask.is_inside(x, y));
            if is_whole {
                at.push(centre);
                expected.push(mean(&posed));
            }
        }
        assert!(at.len() > 3, "{}", case["name"]);
        for (found, expected) in mapped(&rest, &handles(&case["handles"], "q"), &at)
            .iter()
            .zip(expected)
        {
            let distance = found.distance(expected);
            assert!(distance < 1e-8, "{}: {distance}", case["name"]);
        }
    }
    assert!(cases > 5);
}

const P: [(f64, f64); 4] = [(2.5, 1.5), (21.25, 1.5), (9.0, 10.5), (15.0, 10.5)];

fn everywhere() -> Vec<Point> {
    let row = |y: u8| (0..24_u8).map(move |x| (x, y));
    let all = (0..12).flat_map(row);
    all.map(|(x, y)| Point::new(f64::from(x) + 0.3, f64::from(y) + 0.6))
        .collect()
}

#[test]
fn the_laws_hold() {
    let mask = mask(&LEGS);
    let at = everywhere();
    for cell in [2.0, 4.0, 5.0] {
        let p = points(&P);
        let rest = puppet(p.clone(), &mask, Some(cell));
        assert_eq!(mapped(&rest, &p, &at), at);
        let near = |found: &[Point], expected: &dyn Fn(Point) -> Point| {
            for (found, at) in found.iter().zip(&at) {
                let distance = found.distance(expected(*at));
                assert!(distance < 1e-9, "{cell} {at:?}: {distance}");
            }
        };
        let shift = |x: f64, y: f64| (x + 3.0, y - 2.5);
        let moved = mapped(&rest, &points(&P.map(|(x, y)| shift(x, y))), &at);
        near(&moved, &|v| {
            let (x, y) = shift(v.x, v.y);
            Point::new(x, y)
        });
        let turn = |x: f64, y: f64| (0.6 * x - 0.8 * y + 4.0, 0.8 * x + 0.6 * y);
        let turned = mapped(&rest, &points(&P.map(|(x, y)| turn(x, y))), &at);
        // Outside of the mask, between the legs, two pixels belong to what is near them.
        near(&turned, &|v| {
            let (x, y) = turn(v.x, v.y);
            Point::new(x, y)
        });
        let q = points(&[(2.5, 1.5), (22.0, 2.0), (7.0, 11.0), (17.0, 9.0)]);
        let places: Vec<Point> = P.iter().map(|(x, y)| Point::new(*x, *y)).collect();
        let at_handles = mapped(&rest, &q, &places);
        let is_met = |(at, q): (&Point, &Handle)| at.distance(q.places()[0]) < 1e-9;
        assert!(at_handles.iter().zip(&q).all(is_met), "{at_handles:?}");
        let (mut reversed_p, mut reversed_q) = (p.clone(), q.clone());
        reversed_p.reverse();
        reversed_q.reverse();
        let reversed = mapped(&puppet(reversed_p, &mask, Some(cell)), &reversed_q, &at);
        let found = mapped(&rest, &q, &at);
        assert!(
            found
                .iter()
                .zip(&reversed)
                .all(|(a, b)| a.distance(*b) < 1e-9)
        );
        // The legs do not pull each other: what is between them belongs to one or the other.
        assert!(found.iter().all(|v| v.is_finite()));
    }
}

#[test]
fn few_handles_and_handles_that_coincide_have_a_map() {
    let mask = mask(&LEGS);
    let at = everywhere();
    let one = puppet(points(&P[..1]), &mask, Some(4.0));
    let moved = mapped(&one, &points(&[(5.5, 0.5)]), &at);
    assert!(
        moved
            .iter()
            .zip(&at)
            .all(|(a, b)| a.distance(Point::new(b.x + 3.0, b.y - 1.0)) < 1e-12)
    );
    let warnings = resolve(&one).unwrap();
    let pose = warnings.pose(&points(&[(5.5, 0.5)])).unwrap();
    let translation = Warning::Deform(deform::Warning::TranslationOnly);
    assert_eq!(warnings.warnings(&pose, None), [translation]);
    assert_eq!(mapped(&puppet(vec![], &mask, None), &[], &at), at);
    // Twice the same point is one; many in one cell are held softly, and near ones too.
    for (p, q) in [
        (vec![(2.5, 1.5), (2.5, 1.5)], vec![(5.5, 0.5), (5.5, 0.5)]),
        (
            vec![(2.5, 1.5), (2.5, 1.5), (9.0, 10.5)],
            vec![(3.5, 1.5), (5.5, 1.5), (9.0, 9.5)],
        ),
        (
            vec![(2.5, 1.5), (2.5 + 1e-8, 1.5), (9.0, 10.5)],
            vec![(5.5, 0.5), (5.5, 1.5), (9.0, 9.5)],
        ),
        (
            (0..9).map(|k| (1.0 + 0.3 * f64::from(k), 1.5)).collect(),
            (0..9).map(|k| (3.0, f64::from(k))).collect(),
        ),
        (
            vec![(2.0, 1.5), (9.0, 1.5), (20.0, 1.5)],
            vec![(2.0, 1.5), (2.0, 1.5), (2.0, 1.5)],
        ),
    ] {
        let rest = puppet(points(&p), &mask, Some(4.0));
        for found in mapped(&rest, &points(&q), &at) {
            assert!(
                found.is_finite() && found.x.abs() < 1e4 && found.y.abs() < 1e4,
                "{p:?}"
            );
        }
        assert_eq!(mapped(&rest, &points(&p), &at), at, "{p:?}");
    }
}

#[test]
fn lines_are_held_at_every_cell() {
    let mask = mask(&LEGS);
    let line = |places: &[(f64, f64)]| {
        Handle::Polyline(places.iter().map(|(x, y)| Point::new(*x, *y)).collect())
    };
    // A chain of two, which share an end; and a point on its first end.
    let p = vec![
        line(&[(2.5, 2.0), (12.0, 2.0), (21.5, 2.0)]),
        points(&[(2.5, 2.0)]).remove(0),
    ];
    let q = vec![
        line(&[(2.5, 3.0), (12.0, 1.0), (21.5, 3.0)]),
        points(&[(2.5, 3.0)]).remove(0),
    ];
    let rest = puppet(p.clone(), &mask, Some(4.0));
    let at = [
        (2.5, 2.0),
        (12.0, 2.0),
        (21.5, 2.0),
        (5.666_666_666_666_667, 2.0),
    ];
    let expected = [
        (2.5, 3.0),
        (12.0, 1.0),
        (21.5, 3.0),
        (5.666_666_666_666_667, 2.333_333_333_333_333),
    ];
    let at = at.map(|(x, y)| Point::new(x, y));
    for (found, (x, y)) in mapped(&rest, &q, &at).iter().zip(expected) {
        assert!(found.distance(Point::new(x, y)) < 1e-9, "{found:?}");
    }
    assert_eq!(mapped(&rest, &p, &everywhere()), everywhere());
    // Alone, a line turns its part.
    let alone = puppet(vec![line(&[(2.0, 1.0), (6.0, 1.0)])], &mask, Some(4.0));
    let turned = mapped(&alone, &[line(&[(2.0, 1.0), (2.0, 5.0)])], &everywhere());
    for (found, at) in turned.iter().zip(everywhere()) {
        assert!(found.distance(Point::new(3.0 - at.y, at.x - 1.0)) < 1e-9);
    }
}

#[test]
fn what_is_drawn_is_f() {
    // The last cells are narrower than the mesh's.
    let mask = mask(&LEGS);
    let rest = puppet(points(&P), &mask, Some(5.0));
    let q = points(&[(2.5, 1.5), (22.0, 2.0), (7.0, 11.0), (17.0, 9.0)]);
    let resolved = resolve(&rest).unwrap();
    let pose = resolved.pose(&q).unwrap();
    let posed = PosedMesh::new(
        &resolved,
        &resolved.plan(&|| false).unwrap(),
        &pose,
        Folds::Report,
        &|| false,
    )
    .unwrap();
    assert!(
        posed.report().residual < 1e-5,
        "{}",
        posed.report().residual
    );
    let f = resolved.transform(&pose);
    let at: Vec<Point> = everywhere()
        .into_iter()
        .filter(|v| mask.mask.pixel_at(*v, 0.0).is_some())
        .collect();
    for (at, f) in at.iter().zip(f.map(&at, &|| false).unwrap()) {
        let drawn = posed.mesh().map(*at).unwrap();
        assert!(drawn.distance(f.unwrap()) < 1e-5, "{at:?}");
    }
    assert!(resolved.plan_bytes().is_none() && resolved.tolerance().is_none());
    let own: Vec<_> = resolved.own_parameters().iter().collect();
    assert_eq!(own, [("arap/cell", 5.0)]);
}

#[test]
fn dust_goes_with_the_subject_and_is_no_fold() {
    let (body, empty) = ("1".repeat(40) + &"0".repeat(50), "0".repeat(90));
    let near = "0".repeat(20) + "22" + &"0".repeat(68);
    let far = "0".repeat(80) + "2222" + &"0".repeat(6);
    let rows: Vec<&str> = std::iter::repeat_n(&*body, 20)
        .chain([&*empty; 5])
        .chain([&*near])
        .chain([&*empty; 14])
        .chain([&*far])
        .collect();
    let mask = mask(&rows);
    let (p, dust) = ([(5.5, 5.5), (35.5, 14.5)], (21.0, 25.5));
    // Turned upside down; q of what is not dust is seen from (20, 10).
    let turned = |(x, y): (f64, f64)| (40.0 - x, 20.0 - y);
    let q = points(&p.map(turned));
    let geodesic = RestSpec {
        method: Method::Rigid,
        own: deform::Parameters::default(),
        metric: Metric::Geodesic,
        ..puppet(points(&p), &mask, None)
    };
    for rest in [puppet(points(&p), &mask, Some(8.0)), geodesic] {
        let resolved = resolve(&rest).unwrap();
        let pose = resolved.pose(&q).unwrap();
        let plan = resolved.plan(&|| false).unwrap();
        let posed = PosedMesh::new(&resolved, &plan, &pose, Folds::Report, &|| false).unwrap();
        let f = resolved.transform(&pose);
        for (at, expected) in [(dust, turned(dust)), ((82.0, 40.5), (82.0, 40.5))] {
            let [at, expected] = [at, expected].map(|(x, y)| Point::new(x, y));
            let drawn = posed.mesh().map(at).unwrap();
            assert!(drawn.distance(expected) < 1e-4, "{drawn:?}");
            let f = f.map(&[at], &|| false).unwrap()[0].unwrap();
            assert!(f.distance(expected) < 1e-4, "{f:?}");
        }
        assert_eq!(posed.report().folds, 0);
    }
    let on_dust = puppet(points(&[p[0], dust]), &mask, None);
    let refused = resolve(&on_dust).unwrap_err();
    assert_eq!(
        refused,
        WarpError::Rest(DeformError::OutsideMask { handle: 1 })
    );
}

#[test]
fn what_has_no_mesh_is_refused() {
    let mask = mask(&LEGS);
    let rest = |p: &[(f64, f64)]| puppet(points(p), &mask, Some(4.0));
    assert_eq!(
        resolve(&rest(&[(2.0, 2.0), (12.0, 18.0)])).unwrap_err(),
        WarpError::Rest(DeformError::OutsideMask { handle: 1 })
    );
    let no_image = RestSpec {
        mask: None,
        ..rest(&P)
    };
    let extent = extent(&mask);
    assert_eq!(
        ResolvedRest::new(&no_image, extent, &Limits::default(), &|| false).unwrap_err(),
        WarpError::Rest(DeformError::NeedsMask { method: "arap" })
    );
    for cell in [2.5, 1.0, 65.0, -3.0] {
        let refused = resolve(&puppet(points(&P), &mask, Some(cell))).unwrap_err();
        assert!(
            matches!(refused, WarpError::Rest(DeformError::BadParameter { .. })),
            "{refused:?}"
        );
    }
    for grid in [GridSpec::Pixel, GridSpec::Cell(4.0)] {
        let refused = resolve(&RestSpec { grid, ..rest(&P) }).unwrap_err();
        assert!(matches!(refused, WarpError::BadGrid(_)));
    }
    let metric = Metric::Geodesic;
    let refused = resolve(&RestSpec { metric, ..rest(&P) }).unwrap_err();
    assert_eq!(
        refused,
        WarpError::Rest(DeformError::NoMetric { method: "arap" })
    );
    let alpha = Some(1.0);
    let refused = resolve(&RestSpec { alpha, ..rest(&P) }).unwrap_err();
    assert!(matches!(refused, WarpError::ForeignParameter { .. }));
    let empty = super::geodesic::mask(&["0000", "0200"]);
    let refused = resolve(&puppet(points(&[(1.0, 1.0)]), &empty, None)).unwrap_err();
    assert_eq!(refused, WarpError::Rest(DeformError::EmptyMask));
    let large = super::geodesic::mask(&vec![&*"1".repeat(700); 700]);
    let refused = resolve(&puppet(points(&P), &large, Some(2.0))).unwrap_err();
    assert_eq!(
        refused,
        WarpError::Rest(DeformError::TooManyVertices { limit: 60_000 })
    );
}

/// Masks of noise, a comb of thin teeth, a spiral: each has a map or is refused.
#[test]
fn hostile_masks_have_a_map_or_are_refused() {
    let side = 192_usize;
    let picture = |inside: &dyn Fn(usize, usize) -> bool| {
        let row = |y: usize| -> String {
            (0..side)
                .map(|x| if inside(x, y) { '1' } else { '0' })
                .collect()
        };
        let rows: Vec<String> = (0..side).map(row).collect();
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        mask(&rows)
    };
    let ring = |x: usize, y: usize| x.min(y).min(side - 1 - x).min(side - 1 - y);
    for mask in [
        picture(&|x, y| (x + y) % 2 == 0),
        picture(&|x, y| x.wrapping_mul(2_654_435_761).wrapping_add(y * 40_503) / 7 % 3 > 0),
        picture(&|x, y| y < 2 || x % 2 == 0),
        picture(&|x, y| ring(x, y) % 2 == 0 || (x == side / 2 && y < side / 2)),
    ] {
        for cell in [2.0, 7.0, 64.0] {
            let p = points(&[(0.5, 0.5), (96.5, 0.5), (0.5, 150.5)]);
            let rest = puppet(p.clone(), &mask, Some(cell));
            let Ok(resolved) = resolve(&rest) else {
                continue;
            };
            let pose = resolved
                .pose(&points(&[(4.5, 0.5), (90.5, 3.5), (0.5, 170.5)]))
                .unwrap();
            let plan = resolved.plan(&|| false).unwrap();
            let posed = PosedMesh::new(&resolved, &plan, &pose, Folds::Report, &|| false).unwrap();
            let cut = posed.mesh().cut_mesh().unwrap();
            assert!(cut.displacement().iter().flatten().all(|c| c.is_finite()));
        }
    }
}

#[test]
fn a_dragged_hoof_leaves_the_others_nearly_where_they_are() {
    let file = include_bytes!("../../test_files/images/horse-cutout.png");
    let image = Arc::new(Image::decode(file, &ImageLimits::default(), &|| false).unwrap());
    let mask = RestMask::of_image(&image, None, RestMask::THRESHOLD, &|| false).unwrap();
    let (p, mut q) = (points(&HORSE), HORSE);
    q[3] = (614.0, 584.0);
    let rest = puppet(p, &mask, None);
    let resolved = resolve(&rest).unwrap();
    assert_eq!(resolved.own_parameters().get("arap/cell"), Some(8.0));
    let pose = resolved.pose(&points(&q)).unwrap();
    let plan = resolved.plan(&|| false).unwrap();
    let posed = PosedMesh::new(&resolved, &plan, &pose, Folds::Report, &|| false).unwrap();
    assert!(
        posed.report().residual < 0.05,
        "{}",
        posed.report().residual
    );
    let worst = (575..image.extent().height())
        .flat_map(|y| (0..530).map(move |x| (x, y)))
        .filter(|(x, y)| mask.mask.is_inside(*x as usize, *y as usize))
        .map(|(x, y)| Point::new(f64::from(x) + 0.5, f64::from(y) + 0.5))
        .map(|at| posed.mesh().map(at).unwrap().distance(at))
        .fold(0.0, f64::max);
    assert!(worst <= 6.5, "{worst}");
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
    // The picture that MATHEMATICS.md speaks of; `MLSWARP_BLESS` draws it again.
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/test_files/images/hoof-puppet.png"
    );
    if std::env::var_os("MLSWARP_BLESS").is_some() {
        std::fs::write(path, &png).unwrap();
    }
    assert!(std::fs::read(path).unwrap() == png, "{path} differs");
}

#[test]
fn a_mesh_stops_when_nobody_waits_for_it() {
    use std::sync::atomic::{AtomicU32, Ordering};
    let rows = vec!["1".repeat(300); 300];
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let mask = mask(&rows);
    let rest = puppet(points(&[(10.0, 10.0), (200.0, 90.0)]), &mask, Some(3.0));
    let asked = AtomicU32::new(0);
    let count = || {
        asked.fetch_add(1, Ordering::Relaxed);
        false
    };
    ResolvedRest::new(&rest, extent(&mask), &Limits::default(), &count).unwrap();
    let all = asked.load(Ordering::Relaxed);
    assert!(all > 1000, "{all}");
    for at in (0..all).step_by(all as usize / 40) {
        let asked = AtomicU32::new(0);
        let cancelled = || asked.fetch_add(1, Ordering::Relaxed) >= at;
        let refused = ResolvedRest::new(&rest, extent(&mask), &Limits::default(), &cancelled);
        assert_eq!(refused.unwrap_err(), WarpError::Cancelled, "{at}");
    }
}

/// Each step of the largest mesh, with more handles than whose motions are kept.
#[test]
fn the_largest_mesh_is_given_up_at_the_next_look() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    let rows = vec!["1".repeat(486); 486];
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let mask = mask(&rows);
    let places: Vec<(f64, f64)> = (0..36)
        .map(|k| {
            (
                f64::from(k % 6) * 80.0 + 40.0,
                f64::from(k / 6) * 80.0 + 40.0,
            )
        })
        .collect();
    let mut depth = vec![0.0; places.len()];
    depth[7] = 1.0;
    let rest = RestSpec {
        depth: Some(depth),
        ..puppet(points(&places), &mask, Some(2.0))
    };
    let resolve = |cancelled: deform::IsCancelled<'_>| {
        ResolvedRest::new(&rest, extent(&mask), &Limits::default(), cancelled)
    };
    let resolved = resolve(&|| false).unwrap();
    assert_eq!(resolved.grid().len(), 244 * 244);
    let mut q = places;
    q[7] = (150.0, 90.0);
    let pose = resolved.pose(&points(&q)).unwrap();
    let plan = resolved.plan(&|| false).unwrap();
    type GivesUp<'a> = &'a dyn Fn(deform::IsCancelled<'_>) -> Result<(), WarpError>;
    let works: [(&str, usize, GivesUp<'_>); 3] = [
        ("factorising", 100_000, &|cancelled| {
            resolve(cancelled).map(drop)
        }),
        ("posing", 20_000, &|cancelled| {
            PosedMesh::new(&resolved, &plan, &pose, Folds::Report, cancelled).map(drop)
        }),
        ("ordering", 8_000, &|cancelled| {
            resolved
                .with_depth(&rest)?
                .order(&plan, cancelled)
                .map(drop)
        }),
    ];
    for (name, least, work) in works {
        let asked = AtomicUsize::new(0);
        let count = |after: usize| {
            asked.store(0, Ordering::Relaxed);
            work(&|| asked.fetch_add(1, Ordering::Relaxed) >= after)
        };
        count(usize::MAX).unwrap();
        let looks = asked.load(Ordering::Relaxed);
        assert!(looks > least, "{name}: {looks}");
        for after in [0, looks / 50, looks / 10, looks / 3] {
            assert_eq!(count(after), Err(WarpError::Cancelled), "{name}");
            let soon = asked.load(Ordering::Relaxed) - after;
            assert!((1..=2).contains(&soon), "{name}: {soon} after {after}");
        }
    }
}
