//! Folds are removed: the reference cases of `test_files/rivals.json`.

use serde_json::Value;

use crate::deform::{Handle, METHODS, Method};
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

#[test]
fn folds_of_the_reference_cases_are_removed_and_handles_are_met() {
    let file: Value = serde_json::from_str(include_str!("../../test_files/rivals.json")).unwrap();
    for case in file["fold_cases"].as_array().unwrap() {
        let expected = case["expect"].as_str().unwrap();
        let (p, q) = (handles(case, "p"), handles(case, "q"));
        for of in case["methods"].as_array().unwrap() {
            for grid in [GridSpec::Cell(5.0), GridSpec::Auto] {
                let began = std::time::Instant::now();
                let about = format!("{} {of} {grid:?}", case["name"]);
                let w = warper(case, of, grid, Folds::Remove);
                let posed = w.pose(&q);
                let took = began.elapsed();
                match posed {
                    Err(e) => eprintln!("{about} {expected}: {e}"),
                    Ok(posed) => {
                        let r = posed.report();
                        let back = {
                            let pts: Vec<[f64; 2]> = (0..100)
                                .map(|k| {
                                    [
                                        f64::from(k % 10) * 38.3 + 10.2,
                                        f64::from(k / 10) * 37.7 + 11.1,
                                    ]
                                })
                                .collect();
                            let there = posed.map_points(&pts).unwrap();
                            let back = posed.unmap_points(&there).unwrap();
                            let lost = back.iter().filter(|b| b.is_none()).count();
                            let d = back
                                .iter()
                                .zip(&pts)
                                .filter_map(|(b, p)| b.map(|b| (b[0] - p[0]).hypot(b[1] - p[1])))
                                .fold(0.0, f64::max);
                            (lost, d)
                        };
                        eprintln!(
                            "{about} {expected}: unfolded {} folds {} residual {:.4} missed {:.4} back {back:?} {took:?}",
                            posed.posed_mesh().is_unfolded(),
                            r.folds,
                            r.residual,
                            missed(&posed, &p, &q)
                        );
                    }
                }
            }
        }
    }
}
