//! Leave one out: the residuals are those of refitting to all other points, and `/fit` and
//! `method: auto` say what they say.

use mlswarp::deform::{Coincident, Handle, Handles, Parameters, RestDeformation};
use mlswarp::geometry::{Point, Vec2};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Candidate, Fit, Method, RestSpec};
use mlswarp_server::pool::WorkClass;
use proptest::prelude::*;
use reqwest::Response;
use serde_json::{Value, json};

use crate::support::server::{header, png, problem};
use crate::support::{Server, eventually, photo};

fn handles(points: &[Point]) -> Vec<Handle> {
    points.iter().copied().map(Handle::Point).collect()
}

/// Root mean square distance from the mean: the unit of a spline.
fn unit(points: &[Point]) -> f64 {
    let count = points.len() as f64;
    let mean = points[0]
        + points
            .iter()
            .fold(Vec2::ZERO, |sum, p| sum + (*p - points[0]))
            * (1.0 / count);
    (points.iter().map(|p| (*p - mean).norm2()).sum::<f64>() / count).sqrt()
}

/// The field of a candidate; `scale`: of the smoothing.
fn field(candidate: Candidate, p: &[Point], weights: &[f64], scale: f64) -> RestDeformation {
    let set = Handles::new(handles(p), Some(weights.to_vec())).unwrap();
    let given = Parameters::default()
        .with_some("alpha", candidate.alpha)
        .with_some(
            "smoothing",
            candidate.smoothing.map(|smoothing| scale * smoothing),
        );
    RestDeformation::of(
        set,
        Coincident::default(),
        candidate.method,
        &given,
        &|| false,
    )
    .unwrap()
}

/// Compares every candidate with refitting.
fn agrees(p: &[Point], q: &[Point], weights: &[f64]) -> Result<(), TestCaseError> {
    let rest = RestSpec {
        p: handles(p),
        weights: Some(weights.to_vec()),
        ..RestSpec::default()
    };
    let fit = Fit::new(
        &rest,
        &handles(q),
        Extent::new(500, 500).unwrap(),
        2000,
        &|| false,
    )
    .unwrap();
    for candidate in Candidate::defaults() {
        let prediction = fit.predict(candidate, &|| false).unwrap();
        for left_out in 0..p.len() {
            let without =
                |points: &[Point]| [&points[..left_out], &points[left_out + 1..]].concat();
            let (others, targets) = (without(p), without(q));
            let scale = (unit(p) / unit(&others)).powi(2);
            let field = field(
                candidate,
                &others,
                &[&weights[..left_out], &weights[left_out + 1..]].concat(),
                scale,
            );
            let refitted =
                q[left_out] - field.map(&field.pose(&handles(&targets)).unwrap(), p[left_out]);
            let residual = prediction.residuals[left_out].unwrap();
            let allowed = 1e-9 * (100.0 + residual.norm());
            prop_assert!(
                (residual - refitted).norm() < allowed,
                "{candidate:?}, {left_out}: {residual:?}, {refitted:?}"
            );
        }
        let lengths: Vec<f64> = prediction
            .residuals
            .iter()
            .flatten()
            .map(|r| r.norm2())
            .collect();
        let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
        prop_assert!((prediction.rms - mean.sqrt()).abs() < 1e-12 * (1.0 + prediction.rms));
    }
    Ok(())
}

fn points(count: usize) -> impl Strategy<Value = (Vec<Point>, Vec<Point>, Vec<f64>)> {
    let cells = proptest::sample::subsequence((0..25u8).collect::<Vec<_>>(), count);
    let places = proptest::collection::vec((0.1f64..0.9, 0.1f64..0.9), count);
    let moved = proptest::collection::vec((-40.0f64..40.0, -40.0f64..40.0), count);
    (
        cells,
        places,
        moved,
        proptest::collection::vec(0.2f64..5.0, count),
    )
        .prop_map(|(cells, places, moved, weights)| {
            let at = |(cell, (x, y)): (&u8, &(f64, f64))| {
                Point::new(
                    100.0 * (f64::from(cell % 5) + x),
                    100.0 * (f64::from(cell / 5) + y),
                )
            };
            let p: Vec<Point> = cells.iter().zip(&places).map(at).collect();
            let q = p
                .iter()
                .zip(&moved)
                .map(|(p, (x, y))| *p + Vec2::new(*x, *y))
                .collect();
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
    fn residuals_of_degenerate_sets_are_those_of_refitting((p, q, weights) in points(8),
        beside in any::<bool>()) {
        let direction = Vec2::new(0.6, 0.8);
        let along = |(at, k): (&Point, i32)| 60.0 * f64::from(k) + 0.3 * at.x.rem_euclid(100.0);
        let mut p: Vec<Point> = p.iter().zip(0..).map(|at| Point::new(50.0, 20.0)
            + direction * along(at)).collect();
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
    let places = [
        (Point::new(100.0, 200.0), Point::new(120.0, 190.0)),
        (Point::new(300.0, 20.0), Point::new(280.0, 60.0)),
    ];
    let point_mass = 37.0;
    let p = vec![
        Handle::Polyline(vec![a, b]),
        Handle::Point(places[0].0),
        Handle::Point(places[1].0),
    ];
    let q = vec![
        Handle::Polyline(vec![c, d]),
        Handle::Point(places[0].1),
        Handle::Point(places[1].1),
    ];
    let field = RestDeformation::of(
        Handles::new(p, None).unwrap(),
        Coincident::default(),
        Method::GlobalAffine,
        &Parameters::default().with("point_mass", point_mass),
        &|| false,
    )
    .unwrap();
    let pose = field.pose(&q).unwrap();
    const PIECES: u32 = 20_000;
    let along = (0..PIECES).map(|k| {
        let t = (f64::from(k) + 0.5) / f64::from(PIECES);
        (
            a.lerp(b, t),
            c.lerp(d, t),
            a.distance(b) / f64::from(PIECES),
        )
    });
    let masses: Vec<(Point, Point, f64)> = along
        .chain(places.map(|(p, q)| (p, q, point_mass)))
        .collect();
    // At the minimum the residuals are orthogonal to every affine function.
    let mut moments = [Vec2::ZERO; 3];
    for (p, q, mass) in masses {
        let residual = (q - field.map(&pose, p)) * mass;
        for (moment, share) in moments.iter_mut().zip([1.0, p.x / 100.0, p.y / 100.0]) {
            *moment += residual * share;
        }
    }
    assert!(
        moments.iter().all(|moment| moment.norm() < 1e-3),
        "{moments:?}"
    );
}

#[test]
fn a_fit_stops_when_it_is_no_longer_wanted() {
    let p: Vec<Point> = (0..60)
        .map(|k| Point::new(f64::from(k * 37 % 199), f64::from(k * 61 % 193)))
        .collect();
    let rest = RestSpec {
        p: handles(&p),
        ..RestSpec::default()
    };
    let fit = Fit::new(
        &rest,
        &handles(&p),
        Extent::new(200, 200).unwrap(),
        2000,
        &|| false,
    )
    .unwrap();
    for candidate in Candidate::defaults() {
        assert!(fit.predict(candidate, &|| true).is_err(), "{candidate:?}");
    }
}

/// Points of a smooth map with noise of half a pixel, and one that is wrong by 40 px.
fn landmarks(count: u32) -> (Value, Value) {
    let places = (0..count).map(|k| (f64::from(k * 137 % 397), f64::from(k * 89 % 293)));
    let (mut p, mut q) = (Vec::new(), Vec::new());
    for (k, (x, y)) in places.enumerate() {
        let noise = f64::from(u32::try_from(k * 7 % 11).unwrap()) / 11.0 - 0.5;
        p.push(json!([x, y]));
        q.push(json!([
            1.05 * x + 0.1 * y + noise + if k == 5 { 40.0 } else { 0.0 },
            0.97 * y - 0.08 * x + 20.0 - noise
        ]));
    }
    (json!(p), json!(q))
}

async fn answered(response: Response) -> Value {
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    response.json().await.unwrap()
}

#[tokio::test]
async fn the_best_candidate_is_named_with_residuals_and_outliers() {
    let server = Server::start(&[]).await;
    let (p, q) = landmarks(20);
    let body = json!({"p": p, "q": q, "extent": [400, 300]});
    let fit = answered(server.post("/fit").json(&body).send().await.unwrap()).await;
    let candidates = fit["candidates"].as_array().unwrap();
    assert_eq!(candidates.len(), 17);
    let least = candidates
        .iter()
        .min_by(|a, b| {
            a["rms"]
                .as_f64()
                .unwrap()
                .total_cmp(&b["rms"].as_f64().unwrap())
        })
        .unwrap();
    for name in ["method", "alpha", "smoothing"] {
        assert_eq!(fit["best"][name], least[name]);
        assert!(
            candidates
                .iter()
                .all(|candidate| candidate.get(name).is_some()),
            "{name} is always present"
        );
    }
    let affine = candidates
        .iter()
        .find(|candidate| candidate["method"] == "global_affine")
        .unwrap();
    assert_eq!(
        (
            &affine["outliers"],
            &affine["alpha"],
            affine["residuals"].as_array().unwrap().len()
        ),
        (&json!([5]), &Value::Null, 20)
    );

    // The same of a session, and with normalised units residuals are px too.
    let id = server.session(&photo(400, 300), &json!({"p": p})).await;
    let posed = json!({"q": q});
    assert_eq!(
        answered(
            server
                .post(&format!("/sessions/{id}/fit"))
                .json(&posed)
                .send()
                .await
                .unwrap()
        )
        .await,
        fit
    );
    let shares = |places: &Value| -> Value {
        places
            .as_array()
            .unwrap()
            .iter()
            .map(|at| {
                json!([
                    at[0].as_f64().unwrap() / 400.0,
                    at[1].as_f64().unwrap() / 300.0
                ])
            })
            .collect()
    };
    let body = json!({"p": shares(&p), "q": shares(&q), "units": "normalized", "extent": [400, 300],
        "candidates": [{"method": "global_affine"}]});
    let normalized = answered(server.post("/fit").json(&body).send().await.unwrap()).await;
    let difference =
        normalized["candidates"][0]["rms"].as_f64().unwrap() - affine["rms"].as_f64().unwrap();
    assert!(difference.abs() < 1e-9, "{difference}");
}

#[tokio::test]
async fn auto_is_chosen_once_and_named() {
    let server = Server::start(&[]).await;
    let (p, q) = landmarks(12);
    let image = photo(400, 300);
    let fit = answered(
        server
            .post("/fit")
            .json(&json!({"p": p, "q": q, "extent": [400, 300]}))
            .send()
            .await
            .unwrap(),
    )
    .await;
    let best = &fit["best"];
    let warp = json!({"p": p, "q": q, "method": "auto"});
    let drawn = server.upload("/warp", &image, &warp).await;
    let method = header(&drawn, "warp-method").to_owned();
    assert!(
        method.starts_with(best["method"].as_str().unwrap()),
        "{method}: {best}"
    );
    let picture = png(drawn).await;
    // The choice written out is the same request.
    let mut chosen = json!({"p": p, "q": q});
    for name in ["method", "alpha", "smoothing"] {
        chosen[name] = best[name].clone();
    }
    let explicit = server.upload("/warp", &image, &chosen).await;
    assert!(explicit.headers().get("warp-method").is_none());
    assert_eq!(png(explicit).await, picture);
    // A session keeps it, and a drag does not choose again.
    let opened = server.upload("/sessions", &image, &warp).await;
    assert_eq!(header(&opened, "warp-method"), method);
    let opened: Value = opened.json().await.unwrap();
    assert_eq!(opened["method"], best["method"]);
    let id = opened["id"].as_str().unwrap();
    assert_eq!(png(server.drag(id, &json!({"q": q})).await).await, picture);
    // Too few to compare.
    let few = server
        .upload(
            "/warp",
            &image,
            &json!({"p": [[9, 9], [30, 40]], "q": [[9, 9], [35, 40]], "method": "auto"}),
        )
        .await;
    assert_eq!(header(&few, "warp-method"), "rigid;alpha=1");
    // New handles may choose again, by the pose of the session; other handles without `q` have
    // none.
    let handles = |body: Value| {
        server
            .client
            .put(server.url(&format!("/sessions/{id}/handles")))
            .json(&body)
            .send()
    };
    assert_eq!(
        header(
            &handles(json!({"method": "auto"})).await.unwrap(),
            "warp-method"
        ),
        method
    );
    let (p, q) = landmarks(30);
    problem(
        handles(json!({"p": p, "method": "auto"})).await.unwrap(),
        422,
        "bad_value",
    )
    .await;
    let revised = handles(json!({"p": p, "q": q, "method": "auto"}))
        .await
        .unwrap();
    let method = header(&revised, "warp-method").to_owned();
    assert!(method.starts_with(answered(revised).await["method"].as_str().unwrap()));
    let points =
        json!({"p": p, "q": q, "method": "auto", "extent": [400, 300], "points": [[10, 10]]});
    let mapped = server.post("/points").json(&points).send().await.unwrap();
    assert_eq!(header(&mapped, "warp-method"), method);
    assert_eq!(
        answered(mapped).await["points"].as_array().unwrap().len(),
        1
    );
}

#[tokio::test]
async fn what_cannot_be_compared_is_refused() {
    let server = Server::start(&["--max-fit-handles", "10"]).await;
    let fit = async |body: Value| server.post("/fit").json(&body).send().await.unwrap();
    let (p, q) = landmarks(11);
    let refused = problem(
        fit(json!({"p": p, "q": q, "extent": [400, 300]})).await,
        413,
        "too_large",
    )
    .await;
    assert_eq!(
        (
            &refused["limit_name"],
            &refused["limit"],
            &refused["actual"]
        ),
        (&json!("fit_handles"), &json!(10), &json!(11))
    );
    let refused = problem(
        server
            .upload(
                "/warp",
                &photo(40, 30),
                &json!({"p": p, "q": q, "method": "auto"}),
            )
            .await,
        413,
        "too_large",
    )
    .await;
    assert_eq!(refused["pointer"], "/p");
    let (p, q) = landmarks(6);
    let with = |more: Value| {
        let mut body = json!({"p": p, "q": q, "extent": [400, 300]});
        body.as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        body
    };
    let mut line = p.clone();
    line[2] = json!([[1, 2], [3, 4]]);
    let cases = [
        (
            with(json!({"candidates": [{"method": "rigid"}, {"method": "rigid", "alpha": 9}]})),
            "alpha_out_of_range",
            "/candidates/1/alpha",
        ),
        (
            with(json!({"candidates": [{"method": "tps", "alpha": 1}]})),
            "bad_value",
            "/candidates/0/alpha",
        ),
        (
            with(json!({"candidates": [{"method": "affine", "smoothing": 1}]})),
            "bad_value",
            "/candidates/0/smoothing",
        ),
        (
            with(json!({"candidates": [{"method": "affine"}, {"method": "arap"}]})),
            "not_supported",
            "/candidates/1/method",
        ),
        (
            with(json!({"candidates": [{"method": "beier_neely"}]})),
            "not_supported",
            "/candidates/0/method",
        ),
        (with(json!({"p": line, "q": line})), "bad_value", "/p/2"),
        (
            with(json!({"p": [[1, 1], [2, 2], [3, 4], [1, 1]],
                    "q": [[1, 1], [2, 2], [3, 4], [1, 1]]})),
            "bad_value",
            "/p",
        ),
    ];
    for (body, code, pointer) in cases {
        assert_eq!(
            problem(fit(body).await, 422, code).await["pointer"],
            pointer
        );
    }
    let met = json!({"p": [[1, 1], [1, 1], [9, 9], [3, 4], [8, 2]],
        "q": [[1, 1], [5, 1], [9, 9], [3, 4], [8, 2]], "extent": [400, 300]});
    let shared = answered(fit(met).await).await;
    assert_eq!(
        shared["candidates"][0]["residuals"][0],
        shared["candidates"][0]["residuals"][1]
    );
}

/// A comparison of splines takes long; a client that leaves ends it.
#[tokio::test]
async fn a_comparison_ends_with_its_client() {
    // An estimate would refuse it.
    let server = Server::start(&["--workers", "1", "--max-work", "1000G"]).await;
    let (p, q) = landmarks(2000);
    let candidates = vec![json!({"method": "tps", "smoothing": 0.1}); 64];
    let body = json!({"p": p, "q": q, "extent": [400, 300], "candidates": candidates,
        "coincident": {"within": 0}});
    let request = server.post("/fit").json(&body).send();
    assert!(
        tokio::time::timeout(std::time::Duration::from_millis(700), request)
            .await
            .is_err(),
        "64 splines take minutes"
    );
    let pool = server.app.pool().clone();
    eventually("the comparison ends", || {
        pool.load(WorkClass::Upload).running == 0
    })
    .await;
}
