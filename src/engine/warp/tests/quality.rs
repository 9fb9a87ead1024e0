//! The figures of a pose against maps whose figures are known.

use super::is_full;
use super::sets::{Case, FEW_HANDLES, LINES, MIXED, extent, random, randoms};
use crate::deform::Handle;
use crate::geometry::{FoldRegions, Orientation, Point};
use crate::render::Canvas;
use crate::warp::{
    Folds, GridSpec, Limits, Method, PosedMesh, Quality, ResolvedRest, RestSpec, Units,
};

fn quality_on(case: &Case, canvas: Canvas) -> (Quality, PosedMesh) {
    let setup = ResolvedRest::new(&case.rest, case.extent, &Limits::default(), &|| false).unwrap();
    let pose = setup.pose(&case.q).unwrap();
    let posed = PosedMesh::new(
        &setup,
        &setup.plan(&|| false).unwrap(),
        &pose,
        Folds::Report,
        &|| false,
    )
    .unwrap();
    let to_invert = setup.to_invert(&Limits::default()).unwrap();
    let inverse = PosedMesh::coarse(
        &to_invert,
        &to_invert.plan(&|| false).unwrap(),
        &pose,
        Folds::Report,
        &|| false,
    )
    .unwrap();
    (
        Quality::of(
            &setup,
            &case.q,
            &pose,
            &posed,
            &inverse,
            Some(canvas),
            &|| false,
        )
        .unwrap(),
        posed,
    )
}

fn quality(case: &Case) -> (Quality, PosedMesh) {
    quality_on(case, Canvas::of(case.extent))
}

fn points(places: &[(f64, f64)]) -> Vec<Handle> {
    places
        .iter()
        .map(|(x, y)| Handle::Point(Point::new(*x, *y)))
        .collect()
}

/// Three corners under an affine map of the positions.
fn affine(map: impl Fn(f64, f64) -> (f64, f64)) -> Case {
    let p = [(10.0, 10.0), (150.0, 20.0), (30.0, 110.0)];
    let rest = RestSpec {
        p: points(&p),
        method: Method::Affine,
        ..RestSpec::default()
    };
    Case {
        name: String::new(),
        extent: extent(160, 120),
        rest,
        q: points(&p.map(|(x, y)| map(x, y))),
    }
}

#[test]
fn an_affine_map_has_one_area_factor_and_one_shear() {
    for (map, area, shear, covered) in [
        (
            &(|x, y| (x, y)) as &dyn Fn(f64, f64) -> (f64, f64),
            1.0,
            0.0,
            1.0,
        ),
        (&|x, y| (x + 80.0, y), 1.0, 0.0, 0.5),
        (
            &|x, y| (2.0 * x, y),
            2.0,
            90.0 - 2.0 * 0.5_f64.atan().to_degrees(),
            1.0,
        ),
        (&|x, y| (0.5 * x, 0.5 * y), 0.25, 0.0, 0.25),
        (&|x, y| (x, 120.0 - y), -1.0, 0.0, 1.0),
        (
            &|x, y| (160.0 - 2.0 * x, y),
            -2.0,
            90.0 - 2.0 * 0.5_f64.atan().to_degrees(),
            1.0,
        ),
    ] {
        let (quality, _) = quality(&affine(map));
        let (area_factor, shears) = (
            quality.distortion.area_factor.unwrap(),
            quality.distortion.shear.unwrap(),
        );
        for value in [area_factor.min, area_factor.median, area_factor.max] {
            assert!((value - area).abs() < 1e-3, "{value}, not {area}");
        }
        for value in [shears.min, shears.median, shears.max] {
            assert!((value - shear).abs() < 0.05, "{value}, not {shear}");
        }
        assert!(
            (quality.covered - covered).abs() < 1e-9,
            "{} is covered, not {covered}",
            quality.covered
        );
        assert!(
            quality
                .residuals
                .iter()
                .all(|residual| residual.unwrap() < 1e-3),
            "{:?}",
            quality.residuals
        );
        assert_eq!(quality.folds, FoldRegions::default());
        assert_eq!(
            quality.orientation == Orientation::Mirrored,
            area < 0.0,
            "{area}"
        );
        assert_eq!(quality.tolerance.unwrap().exceeded, 0);
        assert_eq!(
            (quality.round_trip.positions, quality.round_trip.in_folds),
            (1024, 0)
        );
        assert!(
            quality.round_trip.distance.unwrap().max < 1e-9,
            "{:?}",
            quality.round_trip
        );
    }
}

#[test]
fn the_inverse_returns_outside_folds() {
    let (mut positions, mut folded, mut smooth) = (0, 0, 0);
    let seeds = if is_full() { 0..2 } else { 0..1 };
    for case in randoms(extent(160, 120), seeds) {
        let (
            Quality {
                folds,
                round_trip,
                residuals,
                ..
            },
            posed,
        ) = quality(&case);
        assert_eq!(folds.cells, posed.report().folds, "{}", case.name);
        assert_eq!(folds.cells, posed.mesh().folded_cells().count() as u64);
        assert!(
            (folds.cells > 0) == (folds.share > 0.0)
                && folds.boxes.len() as u64 == folds.regions.min(100)
        );
        assert_eq!(round_trip.missing, 0, "{}: {round_trip:?}", case.name);
        if let Some(distance) = round_trip.distance {
            assert!(distance.median < 1e-7, "{}: {round_trip:?}", case.name);
            // Where f is nearly singular, beside folds and at cusps and creases, positions differ
            // by more than their images.
            let is_smooth = folds.cells == 0 && case.rest.alpha.is_none_or(|alpha| alpha >= 1.5);
            smooth += usize::from(is_smooth);
            assert!(
                !is_smooth || distance.max < 1e-6,
                "{}: {round_trip:?}",
                case.name
            );
        }
        positions += round_trip.positions;
        folded += u64::from(folds.cells > 0);
        if case.rest.smoothing.is_none() {
            let worst = residuals.into_iter().flatten().fold(0.0, f64::max);
            assert!(
                (worst - posed.report().residual).abs() < 1e-4,
                "{}: {worst}, {}",
                case.name,
                posed.report().residual
            );
        }
    }
    assert!(
        positions > 20_000 && folded > 0 && smooth > 5,
        "{positions} {folded} {smooth}"
    );
}

/// The grid is what is drawn, not where the inverse is sought.
#[test]
fn the_round_trip_does_not_depend_on_the_grid() {
    for kind in [FEW_HANDLES, LINES, MIXED] {
        let case = random(extent(160, 120), kind, Method::Rigid, 2.0, 5);
        let on = |grid| {
            quality(&Case {
                rest: RestSpec {
                    grid,
                    ..case.rest.clone()
                },
                ..case.clone()
            })
            .0
        };
        let (auto, two) = (
            on(GridSpec::Auto),
            on(GridSpec::Counts {
                columns: 2,
                rows: 2,
            }),
        );
        assert_eq!(two.round_trip, auto.round_trip, "{}", case.name);
        assert!(
            auto.round_trip.positions > 500 && two.residuals != auto.residuals,
            "{}",
            case.name
        );
    }
}

#[test]
fn residuals_are_those_of_the_drawn_mesh() {
    // A grid of four vertices follows no handle inside, and one that rests outside is not drawn.
    let mut case = affine(|x, y| (x, y));
    case.rest.grid = GridSpec::Counts {
        columns: 2,
        rows: 2,
    };
    case.rest.p.extend(points(&[(80.0, 60.0), (300.0, 60.0)]));
    case.rest.p.push(Handle::Polyline(vec![
        Point::new(-50.0, 50.0),
        Point::new(50.0, 50.0),
    ]));
    case.q = case.rest.p.clone();
    case.q[3] = points(&[(80.0, 100.0)]).remove(0);
    let (quality, _) = quality(&case);
    let residual = |index: usize| quality.residuals[index];
    assert!(
        residual(3).unwrap() > 5.0 && residual(4).is_none() && residual(5).is_some(),
        "{:?}",
        quality.residuals
    );
    assert_eq!(quality.tolerance, None);
    // Positions of the unit square: the same figures, in px.
    let mut normalized = affine(|x, y| (x + 8.0, y));
    let want = quality_on(&normalized, Canvas::of(normalized.extent)).0;
    for handles in [&mut normalized.rest.p, &mut normalized.q] {
        for handle in handles {
            *handle = Handle::Point(Point::new(
                handle.places()[0].x / 160.0,
                handle.places()[0].y / 120.0,
            ));
        }
    }
    normalized.rest.units = Units::Normalized;
    let found = quality_on(&normalized, Canvas::of(normalized.extent)).0;
    assert!(
        (found.covered - want.covered).abs() < 1e-9
            && found
                .residuals
                .iter()
                .flatten()
                .all(|residual| *residual < 1e-3)
    );
    assert_eq!(found.round_trip.positions, want.round_trip.positions);
}

#[test]
fn conflicts_are_listed_and_work_can_be_cancelled() {
    let mut case = affine(|x, y| (x, y));
    case.rest.p.extend(points(&[(80.0, 60.0), (80.0, 60.0)]));
    case.q.extend(points(&[(84.0, 60.0), (76.0, 60.0)]));
    let (quality, _) = quality(&case);
    assert_eq!(
        (
            quality.coincident.len(),
            quality.coincident[0].handles.as_slice()
        ),
        (1, &[3, 4][..])
    );
    assert!(
        (quality.coincident[0].spread - 4.0).abs() < 1e-9 && quality.residuals[3].unwrap() > 3.9
    );
    for kind in [FEW_HANDLES, LINES, MIXED] {
        let case = random(extent(160, 120), kind, Method::Rigid, 2.0, 3);
        let setup =
            ResolvedRest::new(&case.rest, case.extent, &Limits::default(), &|| false).unwrap();
        let pose = setup.pose(&case.q).unwrap();
        let posed = PosedMesh::new(
            &setup,
            &setup.plan(&|| false).unwrap(),
            &pose,
            Folds::Report,
            &|| false,
        )
        .unwrap();
        assert!(
            Quality::of(
                &setup,
                &case.q,
                &pose,
                &posed,
                &posed,
                Some(Canvas::of(case.extent)),
                &|| true
            )
            .is_err()
        );
    }
}
