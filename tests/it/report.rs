//! Reports of a pose: the figures agree with what is drawn, and no request makes them cost more
//! than a warp.

use serde_json::{Value, json};

use crate::support::Server;
use crate::support::picture::decoded;
use crate::support::server::{form, header, png, problem};

const PICTURE: &[u8] = include_bytes!("../images/rocket.jpg");
/// Of the picture.
const EXTENT: [u32; 2] = [640, 427];

fn warp() -> Value {
    json!({"p": [[120, 80], [500, 90], [300, 300], [900, 100]],
        "q": [[140, 60], [480, 110], [310, 260], [900, 120]]})
}

fn with(warp: &Value, more: Value) -> Value {
    let mut object = warp.as_object().unwrap().clone();
    object.extend(more.as_object().unwrap().clone());
    object.into()
}

async fn report(server: &Server, path: &str, body: &Value) -> Value {
    let response = server.post(path).json(body).send().await.unwrap();
    let (status, text) = (response.status(), response.text().await.unwrap());
    assert_eq!(status, 200, "{text}");
    serde_json::from_str(&text).unwrap()
}

#[tokio::test]
async fn the_figures_are_those_of_the_picture() {
    let server = Server::start(&[]).await;
    for method in ["rigid", "affine", "tps"] {
        let warp = with(
            &warp(),
            json!({"method": method,
                "output": {"canvas": {"x": -40, "y": -20, "width": 700, "height": 500}}}),
        );
        let response = server
            .post("/warp")
            .multipart(form(PICTURE, warp.to_string()))
            .send()
            .await
            .unwrap();
        let (folds, residual) = (
            header(&response, "warp-folds").to_owned(),
            header(&response, "warp-residual").parse::<f64>().unwrap(),
        );
        let picture = decoded(&png(response).await);
        let drawn = picture
            .samples
            .chunks_exact(4)
            .filter(|pixel| pixel[3] > 0)
            .count() as f64
            / (700.0 * 500.0);
        let response = server
            .post("/report")
            .json(&with(&warp, json!({"extent": EXTENT})))
            .send()
            .await
            .unwrap();
        assert_eq!(
            (
                header(&response, "warp-folds"),
                header(&response, "content-type")
            ),
            (folds.as_str(), "application/json")
        );
        let report: Value = response.json().await.unwrap();
        assert!(
            (report["covered"].as_f64().unwrap() - drawn).abs() < 1e-6,
            "{method}: {} of the canvas, {drawn} is drawn",
            report["covered"]
        );
        assert_eq!(
            report["canvas"],
            json!({"x": -40, "y": -20, "width": 700, "height": 500})
        );
        let residuals = report["residuals"].as_array().unwrap();
        let worst = residuals
            .iter()
            .filter_map(Value::as_f64)
            .fold(0.0, f64::max);
        assert!(
            (worst - residual).abs() < 1e-3 && residuals[3].is_null(),
            "{method}: {residuals:?}, {residual}"
        );
        assert_eq!(report["folds"]["cells"].to_string(), folds);
        assert_eq!(
            report["tolerance"],
            json!({"px": 0.25, "met": true, "exceeded": 0})
        );
        assert!(
            report["round_trip"]["max"].as_f64().unwrap() < 1e-6,
            "{report}"
        );
    }
}

#[tokio::test]
async fn a_session_has_the_report_of_its_warp_object() {
    let server = Server::start(&[]).await;
    let warp = with(
        &warp(),
        json!({"folds": "reject", "output": {"canvas": "fit"}}),
    );
    let id = server
        .session(
            PICTURE,
            &json!({"p": warp["p"], "folds": "reject", "output": {"canvas": "fit"}}),
        )
        .await;
    let once = report(&server, "/report", &with(&warp, json!({"extent": EXTENT}))).await;
    let path = format!("/sessions/{id}/report");
    assert_eq!(report(&server, &path, &json!({"q": warp["q"]})).await, once);
    // Half of the way, and another canvas.
    let half = report(
        &server,
        &path,
        &json!({"q": warp["q"], "strength": 0.5, "output": {"canvas": "same"}}),
    )
    .await;
    let want = with(
        &warp,
        json!({"extent": EXTENT, "strength": 0.5, "output": {"canvas": "same"}}),
    );
    assert_eq!(half, report(&server, "/report", &want).await);
    assert_ne!(half["covered"], once["covered"]);
    // On a grid whose cells are too large for the inverse, the round trip is that of a finer one.
    let large = report(
        &server,
        "/report",
        &with(
            &warp,
            json!({"extent": EXTENT, "grid": {"columns": 2, "rows": 2}}),
        ),
    )
    .await;
    assert_eq!(large["round_trip"], once["round_trip"]);
    assert_ne!(large["residuals"], once["residuals"]);
    // Folds are what is asked for, not refused.
    let crossed = json!({"q": [[500, 90], [120, 80], [300, 300], [900, 100]]});
    let folded = report(&server, &path, &crossed).await;
    assert!(
        folded["folds"]["cells"].as_u64().unwrap() > 0
            && folded["area_factor"]["min"].as_f64().unwrap() < 0.0,
        "{folded}"
    );
    assert!(folded["shear"]["max"].as_f64().unwrap() > 90.0);
    let nothing = report(&server, "/report", &json!({"extent": EXTENT})).await;
    assert_eq!(
        (&nothing["residuals"], &nothing["covered"]),
        (&json!([]), &json!(1.0))
    );
    assert!(
        nothing["shear"]["max"].as_f64().unwrap() < 1e-9,
        "{nothing}"
    );
}

/// The header has codes only; the report has an entry for each, in the same order.
#[tokio::test]
async fn the_warnings_of_the_header_are_entries_of_the_report() {
    let server = Server::start(&[]).await;
    let same = json!([[120, 80], [120, 80], [9000, 300]]);
    for warp in [
        warp(),
        json!({"p": same, "q": [[120, 80], [180, 80], [0.5, 1.5]]}),
        json!({"p": [[0.5, 0.2]], "q": [[9e5, 0.2]]}),
    ] {
        let response = server
            .post("/report")
            .json(&with(&warp, json!({"extent": EXTENT})))
            .send()
            .await
            .unwrap();
        let header = response
            .headers()
            .get("warp-warning")
            .map_or("", |codes| codes.to_str().unwrap())
            .to_owned();
        let report: Value = response.json().await.unwrap();
        let codes: Vec<&str> = report["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .map(|entry| entry["code"].as_str().unwrap())
            .collect();
        assert_eq!(codes.join(", "), header, "{report}");
        assert_eq!(codes.is_empty(), warp == self::warp(), "{codes:?}");
    }
}

#[tokio::test]
async fn wrong_and_hostile_requests_are_refused() {
    let server = Server::start(&[]).await;
    let ask = async |body: Value| server.post("/report").json(&body).send().await.unwrap();
    for (body, code, pointer) in [
        (warp(), "bad_value", "/extent"),
        (
            with(&warp(), json!({"extent": [0, 4]})),
            "bad_value",
            "/extent/0",
        ),
        (json!({"extent": [9, 9], "p": [[1, 1]]}), "bad_value", "/q"),
        (
            json!({"extent": [9, 9], "p": [[1, 1]], "q": [[1, 1], [2, 2]]}),
            "shape_mismatch",
            "/q",
        ),
        (
            json!({"extent": [9, 9], "points": []}),
            "unknown_field",
            "/points",
        ),
    ] {
        assert_eq!(
            problem(ask(body.clone()).await, 422, code).await["pointer"],
            pointer,
            "{body}"
        );
    }
    let huge = with(
        &warp(),
        json!({"extent": [4_000_000_000_u32, 4_000_000_000_u32]}),
    );
    problem(ask(huge).await, 413, "too_large").await;
    let canvas = json!({"extent": [9, 9],
        "output": {"canvas": {"x": 0, "y": 0, "width": 2_000_000, "height": 2_000_000}}});
    problem(ask(canvas).await, 413, "too_large").await;
    // Far away, on as large a canvas as there may be, of a long picture.
    let far = json!({"extent": [2_000_000, 1], "p": [[1, 0]], "q": [[-900_000, 900_000]],
        "output": {"canvas": "same"}});
    let report: Value = ask(far).await.json().await.unwrap();
    assert_eq!(report["covered"], 0.0, "{report}");
    problem(
        server
            .post("/sessions/00000000-0000-4000-8000-000000000000/report")
            .json(&json!({"q": []}))
            .send()
            .await
            .unwrap(),
        404,
        "no_such_session",
    )
    .await;
    let id = server.session(PICTURE, &json!({"p": warp()["p"]})).await;
    let refused = server
        .post(&format!("/sessions/{id}/report"))
        .json(&json!({"q": warp()["q"], "seq": 1}))
        .send()
        .await
        .unwrap();
    assert_eq!(
        problem(refused, 422, "unknown_field").await["pointer"],
        "/seq"
    );
    server.is_well().await;
}
