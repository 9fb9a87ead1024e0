//! Leave one out: the residuals are those of refitting to all other points, and `/fit` and `method: auto` say what they say.

use mlswarp::deform::{Coincident, Falloff, Field, Handle, Handles, Method as Family};
use mlswarp::geometry::{Point, Vec2};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Candidate, Fit, Method, RestSpec};
use proptest::prelude::*;

fn handles(points: &[Point]) -> Vec<Handle> {
    points.iter().copied().map(Handle::Point).collect()
}

/// Root mean square distance from the mean: the unit of a spline.
fn unit(points: &[Point]) -> f64 {
    let count = points.len() as f64;
    let mean = points[0] + points.iter().fold(Vec2::ZERO, |sum, p| sum + (*p - points[0])) * (1.0 / count);
    (points.iter().map(|p| (*p - mean).norm2()).sum::<f64>() / count).sqrt()
}

/// The field of a candidate; `scale`: of the smoothing.
fn field(candidate: Candidate, p: &[Point], weights: &[f64], scale: f64) -> Field {
    let set = Handles::new(handles(p), Some(weights.to_vec())).unwrap();
    let family = match candidate.method {
        Method::ThinPlateSpline => return Field::spline(set, scale * candidate.smoothing.unwrap()).unwrap(),
        Method::GlobalAffine => return Field::global_affine_unless(set, Coincident::default(), 1.0, &|| false).unwrap(),
        Method::Affine => Family::Affine,
        Method::Similarity => Family::Similarity,
        Method::Rigid => Family::Rigid,
    };
    Field::new(set, family, Falloff::new(candidate.alpha.unwrap(), false).unwrap(), 1.0).unwrap()
}

/// Compares every candidate with refitting.
fn agrees(p: &[Point], q: &[Point], weights: &[f64]) -> Result<(), TestCaseError> {
    let rest = RestSpec { p: handles(p), weights: Some(weights.to_vec()), ..RestSpec::default() };
    let fit = Fit::new(&rest, &handles(q), Extent::new(500, 500).unwrap(), 2000, &|| false).unwrap();
    for candidate in Candidate::defaults() {
        let prediction = fit.predict(candidate, &|| false).unwrap();
        for left_out in 0..p.len() {
            let without = |points: &[Point]| [&points[..left_out], &points[left_out + 1..]].concat();
            let (others, targets) = (without(p), without(q));
            let scale = (unit(p) / unit(&others)).powi(2);
            let field = field(candidate, &others, &[&weights[..left_out], &weights[left_out + 1..]].concat(), scale);
            let refitted = q[left_out] - field.map(&field.pose(&handles(&targets)).unwrap(), p[left_out]);
            let residual = prediction.residuals[left_out];
            let allowed = 1e-9 * (100.0 + residual.norm());
            prop_assert!((residual - refitted).norm() < allowed, "{candidate:?}, {left_out}: {residual:?}, {refitted:?}");
        }
        let lengths: Vec<f64> = prediction.residuals.iter().map(|r| r.norm2()).collect();
        let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
        prop_assert!((prediction.rms - mean.sqrt()).abs() < 1e-12 * (1.0 + prediction.rms));
    }
    Ok(())
}

fn points(count: usize) -> impl Strategy<Value = (Vec<Point>, Vec<Point>, Vec<f64>)> {
    let cells = proptest::sample::subsequence((0..25u8).collect::<Vec<_>>(), count);
    let places = proptest::collection::vec((0.1f64..0.9, 0.1f64..0.9), count);
    let moved = proptest::collection::vec((-40.0f64..40.0, -40.0f64..40.0), count);
    (cells, places, moved, proptest::collection::vec(0.2f64..5.0, count)).prop_map(|(cells, places, moved, weights)| {
        let at = |(cell, (x, y)): (&u8, &(f64, f64))| Point::new(100.0 * (f64::from(cell % 5) + x), 100.0 * (f64::from(cell / 5) + y));
        let p: Vec<Point> = cells.iter().zip(&places).map(at).collect();
        let q = p.iter().zip(&moved).map(|(p, (x, y))| *p + Vec2::new(*x, *y)).collect();
        (p, q, weights)
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn residuals_are_those_of_refitting((p, q, weights) in (4_usize..14).prop_flat_map(points)) {
        agrees(&p, &q, &weights)?;
    }

    /// On a line, and with one point beside it, without which the rest is on it.
    #[test]
    fn residuals_of_degenerate_sets_are_those_of_refitting((p, q, weights) in points(8), beside in any::<bool>()) {
        let direction = Vec2::new(0.6, 0.8);
        let mut p: Vec<Point> = p.iter().map(|at| Point::new(50.0, 20.0) + direction * (*at - Point::new(0.0, 0.0)).dot(direction)).collect();
        if beside {
            p[3] = p[3] + Vec2::new(-80.0, 60.0);
        }
        agrees(&p, &q, &weights)?;
    }
}

#[test]
fn the_global_affine_map_is_that_of_least_squares() {
    // A segment counts like many points along it.
    let (a, b) = (Point::new(20.0, 30.0), Point::new(220.0, 130.0));
    let (c, d) = (Point::new(25.0, 10.0), Point::new(190.0, 160.0));
    let places = [(Point::new(100.0, 200.0), Point::new(120.0, 190.0)), (Point::new(300.0, 20.0), Point::new(280.0, 60.0))];
    let point_mass = 37.0;
    let p = vec![Handle::Polyline(vec![a, b]), Handle::Point(places[0].0), Handle::Point(places[1].0)];
    let q = vec![Handle::Polyline(vec![c, d]), Handle::Point(places[0].1), Handle::Point(places[1].1)];
    let field = Field::global_affine_unless(Handles::new(p, None).unwrap(), Coincident::default(), point_mass, &|| false).unwrap();
    let pose = field.pose(&q).unwrap();
    const PIECES: u32 = 20_000;
    let along = (0..PIECES).map(|k| {
        let t = (f64::from(k) + 0.5) / f64::from(PIECES);
        (a.lerp(b, t), c.lerp(d, t), a.distance(b) / f64::from(PIECES))
    });
    let masses: Vec<(Point, Point, f64)> = along.chain(places.map(|(p, q)| (p, q, point_mass))).collect();
    // At the minimum the residuals are orthogonal to every affine function.
    let mut moments = [Vec2::ZERO; 3];
    for (p, q, mass) in masses {
        let residual = (q - field.map(&pose, p)) * mass;
        for (moment, share) in moments.iter_mut().zip([1.0, p.x / 100.0, p.y / 100.0]) {
            *moment += residual * share;
        }
    }
    assert!(moments.iter().all(|moment| moment.norm() < 1e-3), "{moments:?}");
}

#[test]
fn a_fit_stops_when_it_is_no_longer_wanted() {
    let p: Vec<Point> = (0..60).map(|k| Point::new(f64::from(k * 37 % 199), f64::from(k * 61 % 193))).collect();
    let rest = RestSpec { p: handles(&p), ..RestSpec::default() };
    let fit = Fit::new(&rest, &handles(&p), Extent::new(200, 200).unwrap(), 2000, &|| false).unwrap();
    for candidate in Candidate::defaults() {
        assert!(fit.predict(candidate, &|| true).is_err(), "{candidate:?}");
    }
}
