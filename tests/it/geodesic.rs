//! The metric `geodesic` in the service: handles act inside what the image shows, on every route
//! that has an image, and what hostile masks may cost is bounded.

use reqwest::Response;
use reqwest::multipart::Part;
use serde_json::{Value, json};

use crate::support::picture::{self, Decoded, decoded};
use crate::support::program::Program;
use crate::support::server::{form, header, png, problem};
use crate::support::{Scratch, Server, photo};

/// Two legs that join above: 96 x 72 px, 10 px apart below row 20. `bottom`: the first row that is
/// not visible.
fn legs(bottom: u32) -> Vec<u8> {
    let mut samples = Vec::new();
    for y in 0..72_u32 {
        for x in 0..96_u32 {
            let is_inside = y < bottom && (y < 20 || !(43..53).contains(&x));
            let [r, g] = [x, y].map(|at| u8::try_from(2 * at).unwrap());
            samples.extend([r, g, 90, if is_inside { 255 } else { 0 }]);
        }
    }
    picture::png(96, 72, png::ColorType::Rgba, &samples)
}

/// A mask of the same size in which nothing lies right of a column.
fn left_of(column: u32) -> Vec<u8> {
    let samples: Vec<u8> = (0..72 * 96_u32)
        .map(|k| if k % 96 < column { 255 } else { 0 })
        .collect();
    picture::png(96, 72, png::ColorType::Grayscale, &samples)
}

fn p() -> Value {
    json!([[10, 10], [85, 10], [25, 65], [70, 65]])
}

/// The second leg is bent.
fn q() -> Value {
    json!([[10, 10], [85, 10], [25, 65], [86, 60]])
}

fn bent() -> Value {
    json!({"p": p(), "q": q(), "metric": "geodesic"})
}

/// The largest change of a sample in a rectangle of two pictures.
fn change(a: &[u8], b: &[u8], [left, top, right, bottom]: [usize; 4]) -> u8 {
    let (a, b) = (decoded(a), decoded(b));
    let at = |x: usize, y: usize| 4 * (y * 96 + x);
    let rows = (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y)));
    rows.flat_map(|(x, y)| {
        let at = at(x, y);
        (0..4).map(move |k| at + k)
    })
    .map(|k| a.samples[k].abs_diff(b.samples[k]))
    .max()
    .unwrap()
}

#[tokio::test]
async fn a_leg_bends_without_its_neighbour() {
    let server = Server::start(&[]).await;
    let image = legs(72);
    let inside = server.upload("/warp", &image, &bent()).await;
    assert!(inside.headers().get("warp-warning").is_none());
    let inside = png(inside).await;
    let plane = json!({"p": p(), "q": q(), "alpha": 2});
    let plane = png(server.upload("/warp", &image, &plane).await).await;
    // The other foot.
    let foot = [2, 60, 36, 71];
    assert!(
        change(&image, &inside, foot) <= 3,
        "{}",
        change(&image, &inside, foot)
    );
    assert!(change(&image, &plane, foot) > 3 * change(&image, &inside, foot));
    let moved = [60, 60, 80, 71];
    assert!(change(&image, &inside, moved) > 20);
    // The identity is exact.
    let rest = json!({"p": p(), "q": p(), "metric": "geodesic"});
    let same = png(server.upload("/warp", &image, &rest).await).await;
    assert_eq!(change(&image, &same, [0, 0, 96, 72]), 0);
    // An image without an outline is the plane, and says so.
    let full = server.upload("/warp", &photo(96, 72), &bent()).await;
    assert_eq!(header(&full, "warp-warning"), "mask_is_everything");
    let plane = json!({"p": p(), "q": q(), "alpha": 2});
    let plane = png(server.upload("/warp", &photo(96, 72), &plane).await).await;
    assert_eq!(png(full).await, plane);
}

async fn grey(response: Response) -> image::GrayImage {
    assert_eq!(response.status(), 200);
    let file = response.bytes().await.unwrap();
    image::load_from_memory(&file).unwrap().to_luma8()
}

async fn json_of(response: Response) -> Value {
    assert_eq!(response.status(), 200);
    response.json().await.unwrap()
}

#[tokio::test]
async fn a_session_answers_as_the_image_alone_does() {
    let server = Server::start(&[]).await;
    let image = legs(72);
    let drawn = png(server.upload("/warp", &image, &bent()).await).await;
    let id = server
        .session(&image, &json!({"p": p(), "metric": "geodesic"}))
        .await;
    let session = json_of(server.get(&format!("/sessions/{id}")).send().await.unwrap()).await;
    assert_eq!(
        (&session["metric"], &session["mask"], &session["alpha"]),
        (&json!("geodesic"), &json!({"threshold": 0.5}), &json!(2.0))
    );
    let posed = json!({"q": q()});
    assert_eq!(png(server.drag(&id, &posed).await).await, drawn);
    // Positions go there and back; nothing of the picture is drawn between the feet.
    let post = async |route: &str, body: Value| {
        let path = format!("/sessions/{id}/{route}");
        server.post(&path).json(&body).send().await.unwrap()
    };
    let at = json!([[12.0, 30.5], [70.0, 65.0], [80.25, 40.5], [47.0, 5.0]]);
    let there = json_of(post("points", json!({"q": q(), "points": at})).await).await;
    let there = &there["points"];
    let distance = |a: &Value, b: &Value| {
        let [x, y] = [0, 1].map(|k| a[k].as_f64().unwrap() - b[k].as_f64().unwrap());
        x.hypot(y)
    };
    assert!(distance(&there[1], &json!([86, 60])) < 1e-6);
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
    let between = json!({"q": q(), "points": [[46.0, 70.0]], "inverse": true});
    assert_eq!(
        json_of(post("points", between).await).await["points"],
        json!([null])
    );
    let report = json_of(post("report", posed.clone()).await).await;
    assert!(
        report["round_trip"]["max"].as_f64().unwrap() < 1e-5,
        "{report}"
    );
    assert!(report["covered"].as_f64().unwrap() < 0.95);
    assert_eq!(report["folds"]["cells"], 0);
    for body in [json!({"q": q()}), json!({"q": q(), "direction": "forward"})] {
        assert_eq!(post("map", body).await.status(), 200);
    }
    let coverage = post("warp", json!({"q": q(), "layer": "@coverage"})).await;
    let coverage = grey(coverage).await;
    let share = |x, y| coverage.get_pixel(x, y).0[0];
    assert_eq!([share(10, 10), share(47, 65), share(20, 50)], [255, 0, 255]);
    let batch = post("batch", json!({"q": q(), "steps": 3})).await;
    assert_eq!(batch.status(), 200);
    // A mesh has one vertex at each place of the grid; coefficients of all would say the same.
    assert_eq!(post("mesh", posed.clone()).await.status(), 200);
    let plan = format!("/sessions/{id}/plan");
    problem(
        server.get(&plan).send().await.unwrap(),
        422,
        "not_supported",
    )
    .await;
    let edge = json!({"q": q(), "output": {"outside": "edge"}});
    problem(post("warp", edge).await, 422, "not_supported").await;
}

#[tokio::test]
async fn labels_and_new_handles_follow_the_mask() {
    let server = Server::start(&[]).await;
    let (image, plain) = (legs(72), json!({"p": p()}));
    let id = server.session(&image, &plain).await;
    let path = format!("/sessions/{id}/layers/parts?kind=labels");
    let labels = server.client.put(server.url(&path)).body(left_of(48));
    assert_eq!(labels.send().await.unwrap().status(), 201);
    let put = async |body: Value| {
        let path = server.url(&format!("/sessions/{id}/handles"));
        server.client.put(path).json(&body).send().await.unwrap()
    };
    let revision = async || {
        let session = json_of(server.get(&format!("/sessions/{id}")).send().await.unwrap()).await;
        session["rest_revision"].clone()
    };
    let before = revision().await;
    // The image is read again for its mask.
    server.app.clear_caches();
    let shown = json_of(put(json!({"metric": "geodesic"})).await).await;
    assert_eq!(shown["metric"], "geodesic");
    let inside = revision().await;
    assert_ne!(inside, before);
    let drawn = server.drag(&id, &json!({"q": q(), "layer": "parts"})).await;
    let drawn = grey(drawn).await;
    // Beyond the foot there is nothing, on it its label.
    assert_eq!(
        [(47, 68), (20, 65)].map(|(x, y)| drawn.get_pixel(x, y).0),
        [[0], [255]]
    );
    // Another threshold is another mask, though it has the same pixels here.
    let shown = json_of(put(json!({"mask": {"threshold": 0.25}})).await).await;
    assert_eq!(shown["mask"], json!({"threshold": 0.25}));
    assert_ne!(revision().await, inside);
    // It belongs to the metric.
    let shown = json_of(put(json!({"metric": "euclidean"})).await).await;
    assert_eq!((&shown["mask"], revision().await), (&Value::Null, before));
    problem(
        put(json!({"mask": {"threshold": 0.25}})).await,
        422,
        "bad_value",
    )
    .await;
}

#[tokio::test]
async fn a_new_region_is_a_new_rest_revision() {
    let server = Server::start(&[]).await;
    let p = json!([[10, 10], [25, 65], [36, 30]]);
    let id = server
        .session(&photo(96, 72), &json!({"p": p, "metric": "geodesic"}))
        .await;
    let region = async |file: Vec<u8>| {
        let path = server.url(&format!("/sessions/{id}/layers/region"));
        server.client.put(path).body(file).send().await.unwrap()
    };
    let revision = async || {
        let session = json_of(server.get(&format!("/sessions/{id}")).send().await.unwrap()).await;
        session["rest_revision"].clone()
    };
    let everything = revision().await;
    assert_eq!(region(left_of(48)).await.status(), 201);
    let half = revision().await;
    assert_ne!(half, everything);
    assert_eq!(region(left_of(60)).await.status(), 200);
    assert_ne!(revision().await, half);
    // A region without a handle is not stored.
    let refused = problem(region(left_of(30)).await, 422, "outside_mask").await;
    assert_eq!(
        (&refused["handle"], &refused["pointer"]),
        (&json!(2), &json!("/p/2"))
    );
    let posed = json!({"q": [[12, 10], [25, 60], [30, 30]]});
    let drawn = png(server.drag(&id, &posed).await).await;
    // What is not in the region stays as it is.
    assert_eq!(change_of_colour(&photo(96, 72), &drawn, 70), 0);
    let path = server.url(&format!("/sessions/{id}/layers/region"));
    assert_eq!(
        server.client.delete(path).send().await.unwrap().status(),
        204
    );
    assert_eq!(revision().await, everything);
    // As a part of an upload too.
    let form = form(
        &photo(96, 72),
        json!({"p": p, "q": posed["q"], "metric": "geodesic"}).to_string(),
    )
    .part("region", Part::bytes(left_of(60)));
    let uploaded = server.post("/warp").multipart(form).send().await.unwrap();
    assert_eq!(png(uploaded).await, drawn);
}

/// The largest change of a sample right of a column, of pictures with and without alpha.
fn change_of_colour(a: &[u8], b: &[u8], column: usize) -> u8 {
    let (a, b) = (decoded(a), decoded(b));
    let channels = |picture: &Decoded| picture.samples.len() / (96 * 72);
    let (of_a, of_b) = (channels(&a), channels(&b));
    let pixels = (0..96 * 72).filter(|k| k % 96 >= column);
    pixels
        .flat_map(|k| (0..3).map(move |c| (of_a * k + c, of_b * k + c)))
        .map(|(i, k)| a.samples[i].abs_diff(b.samples[k]))
        .max()
        .unwrap()
}

#[tokio::test]
async fn what_has_no_mask_is_refused_with_the_reason() {
    let server = Server::start(&[]).await;
    for (route, more) in [
        ("/points", json!({"points": [[3, 4]]})),
        ("/map", json!({})),
        ("/report", json!({})),
    ] {
        let mut body = bent();
        body["extent"] = json!([96, 72]);
        body.as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        let refused = server.post(route).json(&body).send().await.unwrap();
        let refused = problem(refused, 422, "not_supported").await;
        let detail = refused["detail"].as_str().unwrap();
        assert!(detail.contains("needs an image"), "{detail}");
        assert_eq!(refused["pointer"], "/metric");
    }
    let refused = async |image: &[u8], change: Value, code: &str| {
        let mut warp = bent();
        warp.as_object_mut()
            .unwrap()
            .extend(change.as_object().unwrap().clone());
        problem(server.upload("/warp", image, &warp).await, 422, code).await
    };
    let outside = refused(&legs(50), json!({}), "outside_mask").await;
    assert_eq!(
        (&outside["handle"], &outside["pointer"]),
        (&json!(2), &json!("/p/2"))
    );
    let empty = refused(&legs(72), json!({"mask": {"threshold": 1}}), "empty_mask").await;
    assert_eq!(empty["pointer"], "/mask");
    for threshold in [-0.1, 1.1, 1e300] {
        refused(
            &legs(72),
            json!({"mask": {"threshold": threshold}}),
            "bad_value",
        )
        .await;
    }
    refused(
        &legs(72),
        json!({"mask": {"treshold": 0.5}}),
        "unknown_field",
    )
    .await;
    refused(&legs(72), json!({"mask": 0.5}), "bad_value").await;
    refused(
        &legs(72),
        json!({"metric": "euclidean", "mask": {"threshold": 0.5}}),
        "bad_value",
    )
    .await;
    refused(
        &legs(72),
        json!({"method": "tps", "alpha": null}),
        "not_supported",
    )
    .await;
    refused(&legs(72), json!({"method": "auto"}), "not_supported").await;
    refused(&legs(72), json!({"grid": {"cell": 2.5}}), "bad_value").await;
}

/// A picture of noise, of stripes that nearly touch, or of a spiral of one pixel.
fn hostile(kind: &str, side: u32) -> Vec<u8> {
    let mut state = 7_u32;
    let mut samples = Vec::with_capacity(2 * (side * side) as usize);
    for y in 0..side {
        for x in 0..side {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Rings that one radius joins.
            let ring = x.min(y).min(side - 1 - x).min(side - 1 - y);
            let is_inside = match kind {
                "noise" => state >> 31 == 0,
                "checkerboard" => (x + y).is_multiple_of(2),
                "rim" => (x, y) == (0, 0),
                _ => ring.is_multiple_of(2) || (y == side / 2 && x < side / 2),
            };
            samples.extend([
                200,
                if is_inside {
                    255
                } else {
                    100 * u8::from(kind == "rim")
                },
            ]);
        }
    }
    picture::png(side, side, png::ColorType::GrayscaleAlpha, &samples)
}

#[tokio::test]
async fn hostile_masks_are_refused_or_bounded() {
    let server = Server::start(&[]).await;
    let many: Value = (0..3000).map(|k| json!([k % 60, 2 * (k / 60)])).collect();
    for kind in ["noise", "checkerboard", "rings", "rim"] {
        let image = hostile(kind, 400);
        // Handles within 3 px of a pixel inside.
        let few = json!([[1, 0.5], [0.5, 1]]);
        let warp = json!({"p": few, "q": [[2, 0.5], [0.5, 3]], "metric": "geodesic"});
        let answer = server.upload("/warp", &image, &warp).await;
        assert_eq!(
            answer.status(),
            200,
            "{kind}: {}",
            answer.text().await.unwrap()
        );
        let warp = json!({"p": many, "q": many, "metric": "geodesic"});
        let answer = server.upload("/warp", &image, &warp).await;
        if kind == "rim" {
            problem(answer, 422, "outside_mask").await;
        } else {
            let refused = problem(answer, 413, "too_large").await;
            assert!(
                ["work", "plan_bytes"].contains(&refused["limit_name"].as_str().unwrap()),
                "{refused}"
            );
        }
    }
    server.is_well().await;
}

#[tokio::test]
async fn a_stored_session_keeps_its_metric_when_the_process_is_killed() {
    let scratch = Scratch::new();
    let store = format!("file:{}", scratch.path("store"));
    let options = ["--store", store.as_str()];
    let (image, client) = (legs(72), reqwest::Client::new());
    let id = "5f8fad5b-d9cb-469f-a165-70867728950e";
    let url =
        |program: &Program, path: &str| format!("http://{}/sessions/{id}{path}", program.address);
    let warp = json!({"p": p(), "metric": "geodesic", "mask": {"threshold": 0.4}});
    let drawn = async |program: &Program| {
        let drag = client.post(url(program, "/warp")).json(&json!({"q": q()}));
        png(drag.send().await.unwrap()).await
    };
    // Dropping it kills the process.
    let program = Program::start(&options);
    let put = client
        .put(url(&program, ""))
        .multipart(form(&image, warp.to_string()));
    assert_eq!(put.send().await.unwrap().status(), 201);
    let before = drawn(&program).await;
    drop(program);
    let program = Program::start(&options);
    assert_eq!(drawn(&program).await, before);
    let session = client.get(url(&program, "")).send().await.unwrap();
    let session = json_of(session).await;
    assert_eq!(
        (&session["metric"], &session["mask"]),
        (&json!("geodesic"), &json!({"threshold": 0.4}))
    );
}
