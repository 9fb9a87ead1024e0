//! The method `arap` in the service: a mesh of what the image shows, on every route that has an
//! image; what it may cost is bounded.

use reqwest::Response;
use reqwest::multipart::Part;
use serde_json::{Value, json};

use crate::support::picture::{self, decoded};
use crate::support::server::{form, header, png, problem};
use crate::support::{Server, photo};

/// Two legs that join above: 96 x 72 px, 10 px apart below row 20.
fn legs() -> Vec<u8> {
    let mut samples = Vec::new();
    for y in 0..72_u8 {
        for x in 0..96_u8 {
            let is_inside = y < 20 || !(43..53).contains(&x);
            samples.extend([2 * x, 2 * y, 90, 255 * u8::from(is_inside)]);
        }
    }
    picture::png(96, 72, png::ColorType::Rgba, &samples)
}

fn p() -> Value {
    json!([[10, 10], [85, 10], [25, 65], [70, 65]])
}

/// The second leg is bent.
fn q() -> Value {
    json!([[10, 10], [85, 10], [25, 65], [86, 60]])
}

fn puppet() -> Value {
    json!({"p": p(), "q": q(), "method": "arap", "arap": {"cell": 4}})
}

/// The same with other fields.
fn puppet_with(change: &Value) -> Value {
    let mut warp = puppet();
    let fields = warp.as_object_mut().unwrap();
    fields.extend(change.as_object().unwrap().clone());
    warp
}

/// The largest change of a sample in a rectangle of two pictures.
fn change(a: &[u8], b: &[u8], [left, top, right, bottom]: [usize; 4]) -> u8 {
    let (a, b) = (decoded(a), decoded(b));
    let pixels = (top..bottom).flat_map(|y| (left..right).map(move |x| 4 * (y * 96 + x)));
    let samples = pixels.flat_map(|at| at..at + 4);
    samples
        .map(|k| a.samples[k].abs_diff(b.samples[k]))
        .max()
        .unwrap()
}

async fn json_of(response: Response) -> Value {
    assert_eq!(response.status(), 200);
    response.json().await.unwrap()
}

fn distance(a: &Value, b: &Value) -> f64 {
    let [x, y] = [0, 1].map(|k| a[k].as_f64().unwrap() - b[k].as_f64().unwrap());
    (x * x + y * y).sqrt()
}

#[tokio::test]
async fn a_puppet_bends_one_leg() {
    let server = Server::start(&[]).await;
    let image = legs();
    let drawn = server.upload("/warp", &image, &puppet()).await;
    assert!(drawn.headers().get("warp-warning").is_none());
    assert_eq!(header(&drawn, "warp-folds"), "0");
    assert!(header(&drawn, "warp-residual").parse::<f64>().unwrap() < 0.05);
    let drawn = png(drawn).await;
    let foot = [2, 60, 36, 71];
    let other = change(&image, &drawn, foot);
    assert!(other <= 8, "{other}");
    assert!(change(&image, &drawn, [60, 60, 80, 71]) > 20);
    // The identity is exact.
    let rest = puppet_with(&json!({"q": p()}));
    let same = png(server.upload("/warp", &image, &rest).await).await;
    assert_eq!(change(&image, &same, [0, 0, 96, 72]), 0);
    // An image without an outline has a mesh too; lines are held.
    let line = json!({"p": [[[10, 10], [85, 10]], [25, 65]], "q": [[[10, 12], [80, 8]], [30, 60]],
        "method": "arap"});
    let full = server.upload("/warp", &photo(96, 72), &line).await;
    assert!(full.headers().get("warp-warning").is_none());
    png(full).await;
}

#[tokio::test]
async fn a_session_answers_as_the_image_alone_does() {
    let server = Server::start(&[]).await;
    let image = legs();
    let drawn = png(server.upload("/warp", &image, &puppet()).await).await;
    let rest = json!({"p": p(), "method": "arap", "arap": {"cell": 4}});
    let id = server.session(&image, &rest).await;
    let session = json_of(server.get(&format!("/sessions/{id}")).send().await.unwrap()).await;
    assert_eq!(
        (&session["method"], &session["arap"], &session["alpha"]),
        (&json!("arap"), &json!({"cell": 4.0}), &Value::Null)
    );
    let posed = json!({"q": q()});
    assert_eq!(png(server.drag(&id, &posed).await).await, drawn);
    let post = async |route: &str, body: Value| {
        let path = format!("/sessions/{id}/{route}");
        server.post(&path).json(&body).send().await.unwrap()
    };
    // There and back; the handles are met.
    let at = json!([[12.0, 30.5], [70.0, 65.0], [80.25, 40.5], [47.0, 5.0]]);
    let there = json_of(post("points", json!({"q": q(), "points": at})).await).await;
    let there = &there["points"];
    assert!(distance(&there[1], &json!([86, 60])) < 1e-6, "{there}");
    let back = json!({"q": q(), "points": there, "inverse": true});
    let back = json_of(post("points", back).await).await;
    for (back, at) in back["points"]
        .as_array()
        .unwrap()
        .iter()
        .zip(at.as_array().unwrap())
    {
        assert!(distance(back, at) < 1e-5, "{back} {at}");
    }
    let report = json_of(post("report", posed.clone()).await).await;
    assert_eq!(report["folds"]["cells"], 0);
    assert!(
        report["round_trip"]["max"].as_f64().unwrap() < 1e-4,
        "{report}"
    );
    for body in [json!({"q": q()}), json!({"q": q(), "direction": "forward"})] {
        assert_eq!(post("map", body).await.status(), 200);
    }
    assert_eq!(
        post("batch", json!({"q": q(), "steps": 3})).await.status(),
        200
    );
    assert_eq!(post("fit", posed.clone()).await.status(), 200);
    let plan = server
        .get(&format!("/sessions/{id}/plan"))
        .send()
        .await
        .unwrap();
    let refused = problem(plan, 422, "no_table").await;
    assert!(
        refused["detail"].as_str().unwrap().contains("arap"),
        "{refused}"
    );

    // Other handles keep the cell; another method drops it.
    let put = async |body: Value| {
        let path = server.url(&format!("/sessions/{id}/handles"));
        server.client.put(path).json(&body).send().await.unwrap()
    };
    server.app.clear_caches();
    let shown = json_of(put(json!({"p": [[10, 10], [70, 65]]})).await).await;
    assert_eq!(
        (&shown["method"], &shown["arap"]),
        (&json!("arap"), &json!({"cell": 4.0}))
    );
    let shown = json_of(put(json!({"method": "rigid"})).await).await;
    assert_eq!(
        (&shown["method"], &shown["arap"]),
        (&json!("rigid"), &Value::Null)
    );
    // By default about 3,000 cells of 4 px or more.
    let shown = json_of(put(json!({"method": "arap"})).await).await;
    assert_eq!(shown["arap"], json!({"cell": 4.0}));
    let before = shown["rest_revision"].clone();
    let shown = json_of(put(json!({"arap": {"cell": 9}})).await).await;
    assert_ne!(shown["rest_revision"], before);
}

#[tokio::test]
async fn a_region_is_the_puppet() {
    let server = Server::start(&[]).await;
    let region: Vec<u8> = (0..72 * 96_u32)
        .map(|k| 255 * u8::from(k % 96 < 60))
        .collect();
    let region = picture::png(96, 72, png::ColorType::Grayscale, &region);
    let warp = json!({"p": [[10, 10], [25, 65], [36, 30]], "q": [[12, 10], [25, 60], [30, 30]],
        "method": "arap"});
    let upload = async |warp: &Value| {
        let form =
            form(&photo(96, 72), warp.to_string()).part("region", Part::bytes(region.clone()));
        server.post("/warp").multipart(form).send().await.unwrap()
    };
    assert_eq!(upload(&warp).await.status(), 200);
    let mut outside = warp.clone();
    outside["p"][2] = json!([80, 30]);
    problem(upload(&outside).await, 422, "outside_mask").await;
}

#[tokio::test]
async fn what_has_no_mesh_is_refused_with_the_reason() {
    let server = Server::start(&[]).await;
    for (route, more) in [
        ("/points", json!({"points": [[3, 4]]})),
        ("/map", json!({})),
        ("/report", json!({})),
    ] {
        let mut body = puppet_with(&more);
        body["extent"] = json!([96, 72]);
        let refused = server.post(route).json(&body).send().await.unwrap();
        let refused = problem(refused, 422, "not_supported").await;
        let detail = refused["detail"].as_str().unwrap();
        assert!(detail.contains("needs an image"), "{detail}");
        assert_eq!(refused["pointer"], "/method");
    }
    let refused = async |change: Value, code: &str, pointer: &str| {
        let refused = server.upload("/warp", &legs(), &puppet_with(&change)).await;
        let refused = problem(refused, 422, code).await;
        assert_eq!(refused["pointer"], pointer, "{refused}");
    };
    for cell in [json!(1), json!(65), json!(2.5), json!(-4), json!(1e300)] {
        refused(json!({"arap": {"cell": cell}}), "bad_value", "/arap/cell").await;
    }
    refused(
        json!({"arap": {"cells": 4}}),
        "unknown_field",
        "/arap/cells",
    )
    .await;
    refused(json!({"arap": 4}), "bad_value", "/arap").await;
    refused(json!({"alpha": 1}), "bad_value", "/alpha").await;
    refused(json!({"grid": {"cell": 4}}), "bad_value", "/grid").await;
    refused(json!({"method": "rigid"}), "bad_value", "/arap").await;
    let edge = json!({"output": {"outside": "edge"}});
    refused(edge, "not_supported", "/output/outside").await;
    refused(json!({"metric": "geodesic"}), "not_supported", "/metric").await;
    refused(
        json!({"p": [[10, 10], [85, 10], [25, 65], [48, 65]]}),
        "outside_mask",
        "/p/3",
    )
    .await;
    refused(json!({"mask": {"threshold": 1}}), "empty_mask", "/mask").await;
}

/// Noise and a checkerboard: more vertices than a mesh may have, or pieces that no handle moves.
#[tokio::test]
async fn hostile_masks_and_many_handles_are_refused_or_bounded() {
    let server = Server::start(&[]).await;
    let hostile = |kind: &str| {
        let mut state = 7_u32;
        let mut samples = Vec::new();
        for k in 0..400 * 400_u32 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let is_inside = match kind {
                "noise" => state >> 31 == 0,
                _ => (k % 400 + k / 400).is_multiple_of(2),
            };
            samples.extend([200, 255 * u8::from(is_inside)]);
        }
        picture::png(400, 400, png::ColorType::GrayscaleAlpha, &samples)
    };
    for kind in ["noise", "checkerboard"] {
        let few = json!({"p": [[1, 0.5], [0.5, 1]], "q": [[2, 0.5], [0.5, 3]], "method": "arap",
            "arap": {"cell": 2}});
        let answer = server.upload("/warp", &hostile(kind), &few).await;
        problem(answer, 422, "too_many_vertices").await;
    }
    let at = |k: u16| json!([1.5 * f64::from(k % 60), 0.39 * f64::from(k / 60)]);
    let many: Value = (0..3000).map(at).collect();
    let warp = json!({"p": many, "q": many, "method": "arap"});
    let refused = problem(
        server.upload("/warp", &legs(), &warp).await,
        413,
        "too_large",
    )
    .await;
    assert_eq!(refused["limit_name"], "arap_positions", "{refused}");
    server.is_well().await;
}
