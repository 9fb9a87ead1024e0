//! Folds are removed: the reference cases of `test_files/rivals.json`.

use serde_json::Value;

use crate::deform::{Handle, METHODS};
use crate::geometry::Point;
use crate::warp::{Folds, GridSpec, WarpError};
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
