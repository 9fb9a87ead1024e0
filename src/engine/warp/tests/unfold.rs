//! Folds are removed: the reference cases of `test_files/rivals.json`.

use serde_json::Value;

use crate::deform::{Handle, METHODS, Method};
use crate::geometry::Point;
use crate::warp::{Folds, GridSpec, RestSpec, Warning, WarpError};
use crate::{PosedWarp, Warper};

fn point(v: &Value) -> [f64; 2] {
    [v[0].as_f64().unwrap(), v[1].as_f64().unwrap()]
}

/// The handles of a case on one side.
fn handles(case: &Value, side: &str) -> Vec<Handle> {
    let of = |kind: &str| {
        case["handles"][kind]
            .as_array()
            .cloned()
            .unwrap_or_default()
    };
    let points = of("points")
        .into_iter()
        .map(|handle| point(&handle[side]).into());
    let line = |line: Value| {
        let places = line[side].as_array().unwrap().iter().map(point);
        Handle::Polyline(places.map(|[x, y]| Point::new(x, y)).collect())
    };
    points.chain(of("lines").into_iter().map(line)).collect()
}

fn warper(case: &Value, of: &Value, grid: GridSpec, folds: Folds) -> Warper {
    let mut infos = METHODS
        .iter()
        .filter(|info| Some(info.name) == of[0].as_str());
    let [width, height] = point(&case["extent"]).map(|side| side as u32);
    Warper::builder(&handles(case, "p"))
        .method(infos.next().unwrap().method)
        .with(|rest| rest.alpha = of[1].as_f64())
        .grid(grid)
        .folds(folds)
        .build([width, height])
        .unwrap()
}

/// How far the farthest of nine positions of each handle is from its target.
fn missed(posed: &PosedWarp, p: &[Handle], q: &[Handle]) -> f64 {
    let share = |k: u32| f64::from(k) / 8.0;
    let (mut rest, mut targets) = (Vec::new(), Vec::new());
    for (p, q) in p.iter().zip(q) {
        let [p, q] = [p.places(), q.places()];
        let last = p.len().max(2) - 1;
        for k in 0..last {
            let at = |of: &[Point], t| of[k].lerp(of[(k + 1).min(of.len() - 1)], t);
            rest.extend((0..9).map(|t| at(p, share(t))));
            targets.extend((0..9).map(|t| at(q, share(t))));
        }
    }
    let rest: Vec<[f64; 2]> = rest.iter().map(|v| [v.x, v.y]).collect();
    let mapped = posed.map_points(&rest).unwrap();
    let off = mapped
        .iter()
        .zip(targets)
        .map(|([x, y], q)| Point::new(*x, *y).distance(q));
    off.fold(0.0, f64::max)
}

/// One method of each case; the product alone is examined with all of them, in `deform`.
#[test]
fn folds_of_the_reference_cases_are_removed_and_handles_are_met() {
    let file: Value = serde_json::from_str(include_str!("../../test_files/rivals.json")).unwrap();
    let mut seen = [0; 3];
    for (index, case) in file["fold_cases"].as_array().unwrap().iter().enumerate() {
        let expected = case["expect"].as_str().unwrap();
        // Where handles trade places, folds may remain.
        if expected == "best_effort" {
            continue;
        }
        let (p, q) = (handles(case, "p"), handles(case, "q"));
        let methods = case["methods"].as_array().unwrap();
        let of = &methods[index % methods.len()];
        let about = format!("{} {of}", case["name"]);
        let warper = warper(case, of, GridSpec::Auto, Folds::Remove);
        let posed = warper.pose(&q);
        if expected == "unreachable" {
            assert!(
                matches!(posed, Err(WarpError::Unreachable { .. })),
                "{about}"
            );
            seen[0] += 1;
            continue;
        }
        let posed = posed.unwrap();
        if expected == "identical" {
            let plain = warper.with_folds(Folds::Report).unwrap().pose(&q).unwrap();
            let [one, other] = [&posed, &plain].map(PosedWarp::posed_mesh);
            assert!(
                !one.is_unfolded() && one.digest() == other.digest(),
                "{about}"
            );
            assert_eq!(
                one.mesh().displacement(),
                other.mesh().displacement(),
                "{about}"
            );
            seen[1] += 1;
            continue;
        }
        assert!(
            posed.posed_mesh().is_unfolded() && posed.report().folds == 0,
            "{about}"
        );
        let missed = missed(&posed, &p, &q);
        assert!(missed < 0.05, "{about}: {missed}");
        // What is drawn is inverted.
        let at = |k: u32| {
            [
                f64::from(k % 20) * 24.7 + 9.3,
                f64::from(k / 20) * 20.9 + 3.1,
            ]
        };
        let places: Vec<[f64; 2]> = (0..400).map(at).collect();
        let back = posed
            .unmap_points(&posed.map_points(&places).unwrap())
            .unwrap();
        let off = back.iter().zip(&places).map(|(back, place)| {
            let back = back.expect("a position of the image");
            (back[0] - place[0]).hypot(back[1] - place[1])
        });
        let off = off.fold(0.0, f64::max);
        assert!(off < 1e-6, "{about}: {off}");
        seen[2] += 1;
    }
    assert!(seen[0] >= 5 && seen[1] >= 1 && seen[2] >= 9, "{seen:?}");
}

/// A handle is dragged far, in small pictures: many folds are at their borders, where mended cells
/// once lay on others.
#[test]
fn what_is_mended_covers_no_position_twice() {
    let mut state = 7_u32;
    let mut next = |most: f64| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1_u32 << 24) * most
    };
    let (mut mended, mut remain) = (0, 0);
    for k in 0..20 {
        let place = |(x, y): (f64, f64)| Handle::Point(Point::new(x, y));
        let count = 4 + k % 9;
        let places: Vec<(f64, f64)> = (0..count).map(|_| (next(120.0), next(96.0))).collect();
        let (angle, way) = (next(6.3), 16.0 + next(56.0));
        let (sin, cos) = angle.sin_cos();
        let p: Vec<Handle> = places.iter().copied().map(place).collect();
        let mut q = p.clone();
        q[0] = place((places[0].0 + way * cos, places[0].1 + way * sin));
        let warper = Warper::builder(&p)
            .method([Method::Rigid, Method::Similarity, Method::Affine][k % 3])
            .with(|rest| rest.alpha = Some([1.0, 2.0][k / 3 % 2]))
            .grid(GridSpec::Cell(4.0))
            .folds(Folds::Remove)
            .build([120, 96])
            .unwrap();
        let Ok(posed) = warper.pose(&q) else {
            continue;
        };
        let warnings = &posed.report().warnings;
        let has_folds = warnings
            .iter()
            .any(|warning| matches!(warning, Warning::FoldsRemain { .. }));
        let removed = posed.posed_mesh().removed_folds();
        if removed.is_none_or(|removed| removed.mended == 0) || has_folds {
            remain += u32::from(has_folds);
            continue;
        }
        let places: Vec<[f64; 2]> = (0..30 * 24)
            .map(|k| [f64::from(k % 30) * 4.0 + 2.0, f64::from(k / 30) * 4.0 + 2.0])
            .collect();
        let back = posed
            .unmap_points(&posed.map_points(&places).unwrap())
            .unwrap();
        let is_same = |(back, place): (&Option<[f64; 2]>, &[f64; 2])| {
            back.is_some_and(|v| (v[0] - place[0]).hypot(v[1] - place[1]) < 1e-6)
        };
        let twice = back
            .iter()
            .zip(&places)
            .filter(|pair| !is_same(*pair))
            .count();
        assert_eq!(twice, 0, "{k}");
        mended += 1;
    }
    assert!(mended >= 10 && remain <= 2, "{mended}, {remain}");
}

#[test]
fn a_refusal_names_the_methods_whose_folds_can_be_removed() {
    let told = WarpError::NotUnfolded.to_string();
    for info in METHODS {
        let rest = RestSpec {
            method: info.method,
            ..RestSpec::default()
        };
        let is_accepted = rest.check_folds(Folds::Remove).is_ok();
        assert_eq!(told.contains(info.name), is_accepted, "{told}");
    }
    assert!(told.contains(", and tps without smoothing"), "{told}");
}
