//! Maps that mirror or scale the whole picture: a mirror image has no folds, and a method that
//! cannot follow the handles says so.

use serde_json::{Value, json};

use crate::support::picture::decoded;
use crate::support::server::{self, form, problem};
use crate::support::{Server, photo};

const SIZE: (u32, u32) = (96, 72);
/// Scattered, and none on a line with all others.
const P: [[f64; 2]; 9] = [
    [8.0, 9.0],
    [88.0, 12.0],
    [50.0, 8.0],
    [12.0, 60.0],
    [84.0, 64.0],
    [47.0, 66.0],
    [30.0, 33.0],
    [66.0, 40.0],
    [40.0, 50.0],
];
const METHODS: [&str; 6] = [
    "rigid",
    "similarity",
    "affine",
    "tps",
    "global_affine",
    "auto",
];

/// A flip, also with a turn by 90 degrees: the map of the handles, and where the pixel of the
/// picture at x, y comes from.
type Flip = (
    &'static str,
    fn([f64; 2]) -> [f64; 2],
    fn(usize, usize) -> (usize, usize),
);

const FLIPS: [Flip; 3] = [
    ("left and right", |[x, y]| [96.0 - x, y], |x, y| (95 - x, y)),
    ("top and bottom", |[x, y]| [x, 72.0 - y], |x, y| (x, 71 - y)),
    ("turned by 90 degrees", |[x, y]| [y, x], |x, y| (y, x)),
];

fn posed(map: impl Fn([f64; 2]) -> [f64; 2], noise: f64) -> Vec<[f64; 2]> {
    // Some directions that do not repeat.
    let off = |k: usize| (2.4 * k as f64).sin_cos();
    P.iter()
        .enumerate()
        .map(|(k, p)| (map(*p), off(k)))
        .map(|([x, y], (dx, dy))| [x + noise * dx, y + noise * dy])
        .collect()
}

fn codes(response: &reqwest::Response) -> Vec<String> {
    let header = response
        .headers()
        .get("warp-warning")
        .map_or("", |codes| codes.to_str().unwrap());
    header
        .split(", ")
        .filter(|code| !code.is_empty())
        .map(str::to_owned)
        .collect()
}

fn folds(response: &reqwest::Response) -> u64 {
    response.headers()["warp-folds"]
        .to_str()
        .unwrap()
        .parse()
        .unwrap()
}

async fn report(server: &Server, warp: &Value) -> (Vec<String>, Value) {
    let mut body = warp.as_object().unwrap().clone();
    body.insert("extent".to_owned(), json!([SIZE.0, SIZE.1]));
    let response = server.post("/report").json(&body).send().await.unwrap();
    let codes = codes(&response);
    (codes, response.json().await.unwrap())
}

#[tokio::test]
async fn a_mirror_image_has_no_folds_by_any_method_that_can_mirror() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let source = decoded(&image);
    for (name, map, from) in FLIPS {
        let (width, height) = if name.starts_with("turned") {
            (SIZE.1, SIZE.0)
        } else {
            SIZE
        };
        for method in &METHODS[2..] {
            for noise in [0.0, 2.0] {
                let canvas = json!({"x": 0, "y": 0, "width": width, "height": height});
                let warp = json!({"p": P, "q": posed(map, noise), "method": method,
                    "folds": "reject", "output": {"canvas": canvas}});
                let response = server
                    .post("/warp")
                    .multipart(form(&image, warp.to_string()))
                    .send()
                    .await
                    .unwrap();
                assert_eq!(
                    (response.status().as_u16(), folds(&response)),
                    (200, 0),
                    "{name}, {method}, {noise}"
                );
                assert!(codes(&response).contains(&"mirrored".to_owned()));
                let drawn = decoded(&server::png(response).await);
                if noise == 0.0 {
                    let channels = drawn.samples.len() / (drawn.width * drawn.height);
                    for (k, pixel) in drawn.samples.chunks_exact(channels).enumerate() {
                        let (x, y) = from(k % drawn.width, k / drawn.width);
                        assert_eq!(
                            pixel[..3],
                            source.samples[3 * (y * source.width + x)..][..3],
                            "{name}, {method}: {x}, {y}"
                        );
                    }
                }
                let (codes, report) = report(&server, &warp).await;
                assert_eq!(
                    (&report["mirrored"], &report["folds"]["cells"]),
                    (&json!(true), &json!(0)),
                    "{name}, {method}"
                );
                assert!(
                    codes.contains(&"mirrored".to_owned())
                        && !codes.contains(&"mirrored_use_affine".to_owned()),
                    "{codes:?}"
                );
                let trip = &report["round_trip"];
                assert_eq!(
                    (&trip["in_folds"], &trip["missing"]),
                    (&json!(0), &json!(0)),
                    "{name}, {method}: {trip}"
                );
                assert!(
                    trip["positions"].as_u64().unwrap() == 1024
                        && trip["max"].as_f64().unwrap() < 1e-6,
                    "{trip}"
                );
                let shear = report["shear"]["median"].as_f64().unwrap();
                assert!(
                    if noise == 0.0 {
                        shear < 1e-3
                    } else {
                        shear < 20.0
                    },
                    "{name}, {method}: {shear}"
                );
            }
        }
    }
}

/// Everything that a client learns of folds in other ways: the mesh, the drag's report, batches,
/// maps, coverage.
#[tokio::test]
async fn every_answer_agrees_that_a_mirror_image_has_no_folds() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE.0, SIZE.1);
    let rest = json!({"p": P, "method": "affine", "folds": "reject"});
    let id = server.session(&image, &rest).await;
    let q = posed(FLIPS[0].1, 0.0);
    for (path, body) in [
        ("warp", json!({"q": q})),
        ("mesh", json!({"q": q})),
        ("map", json!({"q": q})),
        ("report", json!({"q": q})),
    ] {
        let response = server
            .post(&format!("/sessions/{id}/{path}"))
            .json(&body)
            .send()
            .await
            .unwrap();
        assert_eq!(
            (
                response.status().as_u16(),
                folds(&response),
                codes(&response)
            ),
            (200, 0, vec!["mirrored".to_owned()]),
            "{path}"
        );
    }
    let coverage = server
        .post(&format!("/sessions/{id}/warp"))
        .json(&json!({"q": q, "layer": "@coverage"}))
        .send()
        .await
        .unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(coverage.bytes().await.unwrap()))
        .read_info()
        .unwrap();
    let mut shares = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut shares).unwrap();
    assert!(shares.iter().all(|share| *share == 255), "it covers all");
    let mut socket =
        crate::support::drag_client::DragClient::open(server.address, &id, "?report=true").await;
    socket.pose(1, &json!(q)).await;
    let report = socket.text().await;
    assert_eq!(
        (&report["folds"], &report["warnings"]),
        (&json!(0), &json!(["mirrored"])),
        "{report}"
    );
    // A mirror image that folds at a handle is refused like one that is upright.
    let mut torn = q.clone();
    torn[6] = [5.0, 66.0];
    let response = server
        .post(&format!("/sessions/{id}/warp"))
        .json(&json!({"q": torn}))
        .send()
        .await
        .unwrap();
    let mirrored = problem(response, 422, "folded").await["actual"]
        .as_u64()
        .unwrap();
    let upright: Vec<[f64; 2]> = torn.iter().map(|[x, y]| [96.0 - x, *y]).collect();
    let response = server
        .post(&format!("/sessions/{id}/warp"))
        .json(&json!({"q": upright}))
        .send()
        .await
        .unwrap();
    let cells = problem(response, 422, "folded").await["actual"]
        .as_u64()
        .unwrap();
    // Rounding decides on a cell that is nearly flat.
    assert!(
        cells.abs_diff(mirrored) <= 2 && cells > 2,
        "the same cells fold: {cells}, {mirrored}"
    );
}

#[tokio::test]
async fn a_method_that_cannot_mirror_says_so() {
    let server = Server::start(&[]).await;
    for (name, map, _) in FLIPS {
        for noise in [0.0, 2.0] {
            for method in METHODS {
                let warp = json!({"p": P, "q": posed(map, noise), "method": method});
                let (codes, report) = report(&server, &warp).await;
                let cannot = ["rigid", "similarity"].contains(&method);
                assert_eq!(
                    codes.contains(&"mirrored_use_affine".to_owned()),
                    cannot,
                    "{name}, {method}: {codes:?}"
                );
                let entry = report["warnings"]
                    .as_array()
                    .unwrap()
                    .iter()
                    .find(|entry| entry["code"] == "mirrored_use_affine");
                assert!(
                    entry.is_none_or(
                        |entry| (entry["determinant"].as_f64().unwrap() + 1.0).abs() < 0.1
                    ),
                    "{entry:?}"
                );
                assert!(!codes.contains(&"scaled_use_similarity".to_owned()));
            }
        }
    }
}

#[tokio::test]
async fn a_method_that_keeps_the_size_says_so() {
    let server = Server::start(&[]).await;
    for scale in [0.1, 0.3, 0.45, 0.6, 1.0, 1.8, 2.3, 5.0, 10.0] {
        for method in METHODS {
            let turned = |[x, y]: [f64; 2]| {
                [
                    40.0 + scale * (0.8 * x - 0.6 * y),
                    20.0 + scale * (0.6 * x + 0.8 * y),
                ]
            };
            let warp = json!({"p": P, "q": posed(turned, 0.02 * scale), "method": method});
            let (codes, report) = report(&server, &warp).await;
            let cannot = method == "rigid" && !(0.5..=2.0).contains(&scale);
            assert_eq!(
                codes.contains(&"scaled_use_similarity".to_owned()),
                cannot,
                "{method} at {scale}: {codes:?}"
            );
            let entry = report["warnings"]
                .as_array()
                .unwrap()
                .iter()
                .find(|entry| entry["code"] == "scaled_use_similarity");
            assert!(
                entry.is_none_or(
                    |entry| (entry["scale"].as_f64().unwrap() / scale - 1.0).abs() < 0.01
                ),
                "{entry:?}"
            );
            assert!(
                !codes.contains(&"mirrored_use_affine".to_owned()) && report["mirrored"] == false
            );
        }
    }
}

/// The layouts of handles that the documents show are edits as people make them.
#[tokio::test]
async fn the_examples_ask_for_nothing() {
    let server = Server::start(&[]).await;
    for name in [
        "fold",
        "giraffe",
        "leaning-rocket",
        "stretched-cat",
        "thinner-face",
    ] {
        let path = format!(
            "{}/../../api/examples/{name}.json",
            env!("CARGO_MANIFEST_DIR")
        );
        let example: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        for method in ["rigid", "similarity"] {
            let warp = json!({"p": example["p"], "q": example["q"], "method": method});
            let (codes, _) = report(&server, &warp).await;
            assert!(
                codes
                    .iter()
                    .all(|code| !code.contains("_use_affine") && !code.contains("_use_sim")),
                "{name}: {codes:?}"
            );
        }
    }
}
