//! One frame for everything in an answer: positions beside a picture are pixels of that picture,
//! however it is scaled, cropped or posed. The picture's colours are its own coordinates, so that
//! every pixel of a result says which position of the source it shows.

use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};

use mlswarp::geometry::Point;
use serde_json::{Value, json};

use crate::points::{Noise, coordinates, places, warp, with};
use crate::support::picture::decoded;
use crate::support::server::{form, header, problem};
use crate::support::{DragClient, Server, photo};

const SIDE: [f64; 2] = [160.0, 120.0];
/// The farthest that an annotation may lie from what it marks, px of the picture.
const BOUND: f64 = 0.3;

/// The requested picture of a case.
fn output(seed: u64) -> Value {
    match seed % 7 {
        0 => json!({}),
        1 => json!({"width": 80}),
        2 => json!({"canvas": {"x": 13, "y": 9, "width": 120, "height": 90}}),
        3 => json!({"canvas": "fit"}),
        4 => json!({"canvas": {"x": -30, "y": -17, "width": 211, "height": 150}, "width": 97}),
        5 => json!({"canvas": {"x": 40, "y": 30, "width": 60, "height": 50}, "width": 120}),
        _ => json!({"canvas": "fit", "width": 64}),
    }
}

/// The same handles in shares of the sides.
fn normalized(handles: &Value) -> Value {
    match handles.as_array().map(Vec::as_slice) {
        Some([Value::Number(x), Value::Number(y)]) => {
            json!([x.as_f64().unwrap() / SIDE[0], y.as_f64().unwrap() / SIDE[1]])
        }
        Some(list) => list.iter().map(normalized).collect(),
        None => panic!("{handles}"),
    }
}

/// Pixels of a picture with the positions of the source that they show, both in px.
fn shown(file: &[u8], seed: u64) -> Vec<(Point, Point)> {
    let picture = decoded(file);
    let channels = if picture.color == png::ColorType::Rgba {
        4
    } else {
        3
    };
    let mut noise = Noise(seed);
    let pixel = |_| {
        let (x, y) = (
            (noise.next() * picture.width as f64) as usize,
            (noise.next() * picture.height as f64) as usize,
        );
        let sample = |c: usize| {
            let at = 2 * (channels * (y * picture.width + x) + c);
            f64::from(u16::from_be_bytes([
                picture.samples[at],
                picture.samples[at + 1],
            ]))
        };
        let source = Point::new(sample(0) / 256.0, sample(1) / 256.0);
        let is_opaque = channels == 3 || sample(3) >= 65535.0;
        // The outer pixels of the source have one colour, also where several are averaged.
        let inside = |at: f64, side: f64| at > 3.0 && at < side - 3.0;
        let is_inside = is_opaque && inside(source.x, SIDE[0]) && inside(source.y, SIDE[1]);
        is_inside.then_some((Point::new(x as f64 + 0.5, y as f64 + 0.5), source))
    };
    (0..150).filter_map(pixel).take(40).collect()
}

fn files(archive: &[u8]) -> BTreeMap<String, Vec<u8>> {
    let mut archive = zip::ZipArchive::new(Cursor::new(archive)).unwrap();
    let count = archive.len();
    let file = |k| {
        let (mut entry, mut bytes) = (archive.by_index(k).unwrap(), Vec::new());
        entry.read_to_end(&mut bytes).unwrap();
        (entry.name().unwrap().into_owned(), bytes)
    };
    (0..count).map(file).collect()
}

/// A random warp with the picture that is asked for.
struct Case {
    seed: u64,
    warp: Value,
    strength: f64,
    output: Value,
    is_normalized: bool,
}

impl Case {
    fn new(seed: u64) -> Self {
        // Twice as large, a picture shows twice the error.
        let tolerance = if output(seed)["width"] == 120 {
            Some(0.05)
        } else {
            None
        };
        let mut warp = warp(seed, tolerance);
        let is_normalized = seed.is_multiple_of(2);
        if is_normalized {
            warp["units"] = json!("normalized");
            for name in ["p", "q"] {
                warp[name] = normalized(&warp[name]);
            }
        }
        Self {
            seed,
            warp,
            strength: [1.0, 0.5, 1.5, -0.5][(seed / 2 % 4) as usize],
            output: output(seed),
            is_normalized,
        }
    }

    /// A position in the units of the request; `size`: that of its image.
    fn units(&self, place: Point, size: [f64; 2]) -> Value {
        if self.is_normalized {
            json!([place.x / size[0], place.y / size[1]])
        } else {
            json!([place.x, place.y])
        }
    }

    /// Positions of an answer in px of their image.
    fn px(&self, answer: &Value, size: [f64; 2]) -> Vec<Point> {
        let unit = if self.is_normalized { size } else { [1.0; 2] };
        places(answer)
            .into_iter()
            .map(|place| place.unwrap())
            .map(|place| Point::new(place.x * unit[0], place.y * unit[1]))
            .collect()
    }

    /// A session. Some have the output, others are sent it with every request.
    async fn session(&self, server: &Server) -> (String, Value) {
        let mut rest = self.warp.as_object().unwrap().clone();
        rest.remove("q");
        let is_stored = self.seed.is_multiple_of(3);
        if is_stored {
            rest.insert("output".to_owned(), self.output.clone());
        }
        let id = server.session(&coordinates(), &rest.into()).await;
        (
            id,
            if is_stored {
                json!({})
            } else {
                json!({"output": self.output})
            },
        )
    }

    fn posed(&self) -> Value {
        json!({"q": self.warp["q"], "strength": self.strength})
    }
}

async fn answer(server: &Server, path: &str, body: &Value) -> (Option<String>, Value) {
    let response = server.post(path).json(body).send().await.unwrap();
    let canvas = response
        .headers()
        .get("warp-canvas")
        .map(|text| text.to_str().unwrap().to_owned());
    let (status, text) = (response.status(), response.text().await.unwrap());
    assert_eq!(status, 200, "{path}: {text}");
    (canvas, serde_json::from_str(&text).unwrap())
}

async fn batch(server: &Server, id: &str, body: &Value) -> (BTreeMap<String, Vec<u8>>, Value) {
    let response = server
        .post(&format!("/sessions/{id}/batch"))
        .json(body)
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), 200);
    let files = files(&response.bytes().await.unwrap());
    let index: Value = serde_json::from_slice(&files["frames.json"]).unwrap();
    let frame = index["frames"][0].clone();
    (files, frame)
}

/// Batches, points with and without a session, and the inverse: in px of the picture, in shares of
/// its sides.
#[tokio::test]
async fn annotations_lie_on_what_they_mark_in_every_picture() {
    let server = Server::start(&[]).await;
    let (mut compared, mut cases) = (0, 0);
    for case in (0..84).map(Case::new) {
        let (id, more) = case.session(&server).await;
        let frames = with(&json!({"frames": [case.posed()]}), more.clone());
        let (pictures, frame) = batch(&server, &id, &frames).await;
        if frame["folds"] != 0 || frame["exceeded"].is_u64() {
            continue;
        }
        cases += 1;
        let shown = shown(&pictures["0000.png"], case.seed);
        let size = [
            frame["width"].as_f64().unwrap(),
            frame["height"].as_f64().unwrap(),
        ];
        let sources: Vec<Value> = shown
            .iter()
            .map(|(_, source)| case.units(*source, SIDE))
            .collect();
        let (files, _) = batch(&server, &id, &with(&frames, json!({"points": sources}))).await;
        let of_batch: Value = serde_json::from_slice(&files["0000.json"]).unwrap();
        let posed = with(&with(&case.posed(), more), json!({"points": sources}));
        let (canvas, of_session) = answer(&server, &format!("/sessions/{id}/points"), &posed).await;
        let whole = json!({"extent": SIDE, "output": case.output, "strength": case.strength});
        let whole = with(&case.warp, whole);
        let (canvas_once, once) = answer(
            &server,
            "/points",
            &with(&whole, json!({"points": sources})),
        )
        .await;
        assert_eq!(
            (&of_batch, &of_batch),
            (&of_session, &once),
            "{}",
            case.seed
        );
        // The canvas and the scale say the same.
        let told =
            ["x", "y", "width", "height"].map(|name| frame["canvas"][name].as_f64().unwrap());
        let text = told.map(|number| number.to_string()).join(",");
        let is_same = case.output.get("canvas").is_none();
        assert_eq!(
            (canvas.clone(), canvas),
            (canvas_once, (!is_same).then_some(text)),
            "{}",
            case.seed
        );
        let scale = [0, 1].map(|axis| frame["scale"][axis].as_f64().unwrap());
        assert!(
            (0..2).all(|axis| (told[2 + axis] * scale[axis] - size[axis]).abs() < 1e-9),
            "{frame}"
        );
        assert_eq!(frame["strength"], case.strength);
        let plane = with(&whole, json!({"points": sources, "output": {}}));
        let plane = case.px(&answer(&server, "/points", &plane).await.1["points"], SIDE);
        for (((pixel, _), mapped), plane) in shown
            .iter()
            .zip(case.px(&of_batch["points"], size))
            .zip(plane)
        {
            let distance = mapped.distance(*pixel);
            assert!(
                distance <= BOUND,
                "{}: {mapped:?} is shown at {pixel:?}, {}",
                case.seed,
                case.output
            );
            let scaled = Point::new(
                (plane.x - told[0]) * scale[0],
                (plane.y - told[1]) * scale[1],
            );
            assert!(
                scaled.distance(mapped) < 1e-9,
                "{}: {scaled:?} {mapped:?}",
                case.seed
            );
            compared += 1;
        }
        // Back, from the pixels of the picture.
        let pixels: Vec<Value> = shown
            .iter()
            .map(|(pixel, _)| case.units(*pixel, size))
            .collect();
        let back = json!({"points": pixels, "inverse": true});
        let (_, once) = answer(&server, "/points", &with(&whole, back.clone())).await;
        let (_, of_session) = answer(
            &server,
            &format!("/sessions/{id}/points"),
            &with(&posed, back),
        )
        .await;
        assert_eq!(once, of_session, "{}", case.seed);
        for ((pixel, source), back) in shown.iter().zip(case.px(&once["points"], SIDE)) {
            // Handles move a little, so lengths change by less than a factor of two.
            let bound = 2.0 * BOUND / scale[0].min(1.0);
            assert!(
                back.distance(*source) <= bound,
                "{}: {pixel:?} shows {source:?}, not {back:?}",
                case.seed
            );
        }
    }
    assert!(compared > 1500 && cases > 60, "{compared} {cases}");
}

/// The report of a frame says where its picture lies in the plane.
#[tokio::test]
async fn the_report_of_a_dragged_frame_says_its_canvas_scale_and_strength() {
    let server = Server::start(&[]).await;
    for case in (0..14).map(Case::new) {
        let (id, _) = case.session(&server).await;
        let mut drag =
            DragClient::open(server.address, &id, "?frames=png&report=true&width=50").await;
        let message = with(&case.posed(), json!({"seq": 1}));
        drag.say(&message).await;
        let report = drag.text().await;
        let picture = drag.frame().await.1;
        assert_eq!(report["strength"], case.strength);
        let number = |value: &Value| value.as_f64().unwrap();
        let (canvas, scale) = (
            &report["canvas"],
            [0, 1].map(|axis| number(&report["scale"][axis])),
        );
        assert!(
            (number(&canvas["width"]) * scale[0] - number(&report["width"])).abs() < 1e-9,
            "{report}"
        );
        assert!(
            (number(&canvas["height"]) * scale[1] - number(&report["height"])).abs() < 1e-9,
            "{report}"
        );
        if report["folds"] != 0 {
            continue;
        }
        let shown = shown(&picture, case.seed);
        let sources: Vec<Value> = shown
            .iter()
            .map(|(_, source)| case.units(*source, SIDE))
            .collect();
        let plane = with(
            &case.posed(),
            json!({"points": sources, "output": {"canvas": "same", "width": 160}}),
        );
        let plane = answer(&server, &format!("/sessions/{id}/points"), &plane)
            .await
            .1;
        for ((pixel, _), plane) in shown.iter().zip(case.px(&plane["points"], SIDE)) {
            let place = Point::new(
                (plane.x - number(&canvas["x"])) * scale[0],
                (plane.y - number(&canvas["y"])) * scale[1],
            );
            // A preview is drawn on the grid as it is.
            assert!(
                place.distance(*pixel) <= 0.5 * scale[0].max(1.0),
                "{}: {place:?} is shown at {pixel:?}",
                case.seed
            );
        }
    }
    let id = server
        .session(
            &photo(64, 48),
            &json!({"p": [[20, 20]], "output": {"canvas": "fit", "width": 9}}),
        )
        .await;
    let mut drag = DragClient::open(server.address, &id, "?frames=mesh&report=true").await;
    drag.say(&json!({"seq": 1, "q": [[22, 20]], "strength": 0.25}))
        .await;
    let report = drag.text().await;
    let same = json!({"x": 0, "y": 0, "width": 64, "height": 48});
    assert_eq!(
        (&report["canvas"], &report["scale"], &report["strength"]),
        (&same, &json!([1.0, 1.0]), &json!(0.25)),
        "a mesh is in px of the source"
    );
}

/// A session with a region: `fit` contains what stays, for the picture, its positions and its
/// report.
#[tokio::test]
async fn a_region_has_its_part_in_the_canvas_of_every_answer() {
    let server = Server::start(&[]).await;
    let mask: Vec<u8> = (0..160 * 120)
        .map(|k: u32| if k % 160 > 90 && k / 160 > 60 { 255 } else { 0 })
        .collect();
    let id = server
        .session(
            &coordinates(),
            &json!({"p": [[120, 90]], "output": {"canvas": "fit"}}),
        )
        .await;
    let body = crate::support::picture::png(160, 120, png::ColorType::Grayscale, &mask);
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/layers/region")))
        .body(body)
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 201);
    let q = json!({"q": [[150, 110]]});
    let drawn = server.drag(&id, &q).await;
    let canvas = header(&drawn, "warp-canvas").to_owned();
    assert!(canvas.starts_with("0,0,19"), "the source stays: {canvas}");
    let (of_points, points) = answer(
        &server,
        &format!("/sessions/{id}/points"),
        &with(&q, json!({"points": [[120, 90]]})),
    )
    .await;
    assert_eq!(
        (of_points, points),
        (Some(canvas.clone()), json!({"points": [[150.0, 110.0]]}))
    );
    let (_, report) = answer(&server, &format!("/sessions/{id}/report"), &q).await;
    let told = ["x", "y", "width", "height"]
        .map(|name| report["canvas"][name].to_string())
        .join(",");
    assert_eq!(told, canvas);
}

/// The boxes of folds are in the picture that the report is about.
#[tokio::test]
async fn the_boxes_of_a_report_are_in_its_picture() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[8, 8], [120, 80], [80, 8]], "q": [[88, 8], [120, 72], [20, 9]],
        "extent": [160, 120]});
    let report = async |output: Value| {
        answer(&server, "/report", &with(&warp, json!({"output": output})))
            .await
            .1
    };
    let plain = report(json!({})).await;
    assert!(
        plain["folds"]["boxes"]
            .as_array()
            .is_some_and(|boxes| !boxes.is_empty()),
        "{plain}"
    );
    let canvas = json!({"x": -20, "y": 10, "width": 200, "height": 100});
    let other = report(json!({"canvas": canvas, "width": 100})).await;
    assert_eq!(
        (&other["canvas"], &other["width"], &other["height"]),
        (&canvas, &json!(100), &json!(50))
    );
    assert_eq!(
        (&plain["scale"], &other["scale"]),
        (&json!([1.0, 1.0]), &json!([0.5, 0.5]))
    );
    let sides = |report: &Value| -> Vec<f64> {
        let boxes = report["folds"]["boxes"].as_array().unwrap().iter();
        boxes
            .flat_map(|sides| {
                sides
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|side| side.as_f64().unwrap())
            })
            .collect()
    };
    for (k, (plain, other)) in sides(&plain).into_iter().zip(sides(&other)).enumerate() {
        let origin = if k % 2 == 0 { -20.0 } else { 10.0 };
        assert!(((plain - origin) * 0.5 - other).abs() < 1e-9);
    }
    assert_eq!(
        plain["residuals"], other["residuals"],
        "lengths are px of the source"
    );
    let large = with(&warp, json!({"output": {"width": 20000}}));
    let refused = server.post("/report").json(&large).send().await.unwrap();
    assert_eq!(
        problem(refused, 413, "too_large").await["pointer"],
        "/output/width"
    );
}

/// `folds: reject` refuses positions as it refuses the picture that they belong to.
#[tokio::test]
async fn positions_of_a_picture_that_is_refused_are_refused() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[8, 8], [120, 80], [80, 8]], "q": [[88, 8], [120, 72], [20, 9]],
        "folds": "reject"});
    let whole = with(&warp, json!({"extent": [160, 120], "points": [[1, 1]]}));
    problem(
        server.post("/points").json(&whole).send().await.unwrap(),
        422,
        "folded",
    )
    .await;
    let response = server
        .post("/warp")
        .multipart(form(&coordinates(), warp.to_string()))
        .send()
        .await
        .unwrap();
    problem(response, 422, "folded").await;
    let nothing = with(
        &whole,
        json!({"folds": "report", "q": [[9, 9], [9, 9], [9, 9]], "method": "affine",
            "output": {"canvas": "fit"}}),
    );
    problem(
        server.post("/points").json(&nothing).send().await.unwrap(),
        422,
        "nothing_visible",
    )
    .await;
    let wide = with(
        &whole,
        json!({"folds": "report", "output": {"width": 20000}}),
    );
    assert_eq!(
        problem(
            server.post("/points").json(&wide).send().await.unwrap(),
            413,
            "too_large"
        )
        .await["pointer"],
        "/output/width"
    );
}

async fn warnings(server: &Server, path: &str, body: &Value) -> String {
    let response = server.post(path).json(body).send().await.unwrap();
    assert_eq!(response.status(), 200, "{path} {body}");
    response
        .headers()
        .get("warp-warning")
        .map_or("", |text| text.to_str().unwrap())
        .to_owned()
}

/// A detail in the frame of a large overview: the handles lie on the canvas.
#[tokio::test]
async fn handles_on_the_requested_canvas_are_meant() {
    let server = Server::start(&[]).await;
    let p = json!([[5, 5], [75, 6], [40, 55], [10, 50]]);
    let q = json!([[650, 550], [1350, 560], [1000, 1050], [700, 1000]]);
    let session = |units: &str| json!({"p": p, "units": units, "method": "affine"});
    let id = server.session(&photo(80, 60), &session("px")).await;
    let shares = |handles: &Value| -> Value {
        let share =
            |h: &Value| json!([h[0].as_f64().unwrap() / 80.0, h[1].as_f64().unwrap() / 60.0]);
        handles.as_array().unwrap().iter().map(share).collect()
    };
    let in_shares = json!({"p": shares(&p), "units": "normalized", "method": "affine"});
    let shared = server.session(&photo(80, 60), &in_shares).await;
    let overview = json!({"x": 0, "y": 0, "width": 2000, "height": 1500});
    let far = json!({"x": 5000, "y": 0, "width": 2000, "height": 1500});
    for (canvas, is_warned) in [
        (overview, false),
        (json!("fit"), false),
        (json!("same"), true),
        (far, true),
    ] {
        for (id, q, code) in [
            (&id, q.clone(), "handles_outside_picture"),
            (&shared, shares(&q), "looks_normalized"),
        ] {
            let body = json!({"q": q, "output": {"canvas": canvas, "width": 100}});
            for path in ["warp", "report", "points"] {
                let told = warnings(&server, &format!("/sessions/{id}/{path}"), &body).await;
                assert_eq!(told.contains(code), is_warned, "{path} {canvas}: {told}");
            }
            let frames = json!({"frames": [{"q": q}], "output": {"canvas": canvas, "width": 100}});
            let told = batch(&server, id, &frames).await.1["warnings"].to_string();
            assert_eq!(told.contains(code), is_warned, "batch {canvas}: {told}");
        }
    }
}

#[tokio::test]
async fn annotations_far_outside_or_in_another_unit_are_warned_of() {
    const OUTSIDE: &str = "annotations_outside_picture";
    const UNIT: &str = "looks_normalized, annotations_outside_picture";
    let server = Server::start(&[]).await;
    let feature = |x: f64, y: f64| {
        json!([
            {"type": "Feature", "nucleusGeometry": {"type": "Point", "coordinates": [x, y]}}])
    };
    let px = json!({"p": [[40, 60], [120, 60]], "q": [[42, 60], [120, 62]]});
    let shares = json!({"p": [[0.25, 0.5], [0.75, 0.5]], "q": [[0.26, 0.5], [0.75, 0.51]],
        "units": "normalized"});
    for (warp, annotations, expected) in [
        (&px, json!({"points": [[80, 60], [-20, 130]]}), ""),
        (&px, json!({"points": [[80, 60], [400, 60]]}), OUTSIDE),
        (&px, json!({"geojson": feature(9000.0, 9000.0)}), OUTSIDE),
        (&px, json!({"boxes": [null, [0.1, 0.2, 0.4, 0.5]]}), UNIT),
        (
            &px,
            json!({"points": [[80, 60]], "polygons": [[[0.1, 0.2], [0.4, 0.2], [0.4, 0.5]]]}),
            UNIT,
        ),
        (&px, json!({"points": [[0.5, 0.5], [1.5, 0.5]]}), ""),
        (&px, json!({"points": [[0.31, 0.5]]}), UNIT),
        (&px, json!({"points": [], "boxes": [null]}), ""),
        (&shares, json!({"boxes": [[0.1, 0.2, 0.4, 0.5]]}), ""),
        (&shares, json!({"boxes": [[40, 30, 80, 60]]}), UNIT),
        (&shares, json!({"geojson": feature(80.0, 60.0)}), UNIT),
        (&shares, json!({"points": [[2.5, 0.5]]}), OUTSIDE),
    ] {
        let clean = |told: String| told.replace("translation_only, ", "");
        let extent = json!({"extent": [160, 120]});
        let told = clean(
            warnings(
                &server,
                "/points",
                &with(&with(warp, annotations.clone()), extent.clone()),
            )
            .await,
        );
        assert_eq!(told, expected, "{annotations}");
        let mut rest = warp.as_object().unwrap().clone();
        let q = rest.remove("q").unwrap();
        let id = server.session(&coordinates(), &rest.into()).await;
        let posed = with(&json!({"q": q}), annotations.clone());
        assert_eq!(
            clean(warnings(&server, &format!("/sessions/{id}/points"), &posed).await),
            expected,
            "{annotations}"
        );
        let frames = with(&json!({"frames": [{"q": q}]}), annotations.clone());
        assert_eq!(
            warnings(&server, &format!("/sessions/{id}/batch"), &frames).await,
            expected,
            "{annotations}"
        );
        let (_, frame) = batch(&server, &id, &frames).await;
        let codes: Vec<&str> = frame["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .map(|code| code.as_str().unwrap())
            .collect();
        assert_eq!(codes.join(", "), expected, "{annotations}");
    }
    // The image of positions that are mapped back is the picture.
    let overview = json!({"canvas": {"x": 0, "y": 0, "width": 4000, "height": 3000}});
    let back = json!({"inverse": true, "points": [[3000, 2000]], "extent": [160, 120]});
    assert_eq!(
        warnings(
            &server,
            "/points",
            &with(&with(&px, back.clone()), json!({"output": overview}))
        )
        .await,
        ""
    );
    assert_eq!(
        warnings(&server, "/points", &with(&px, back)).await,
        OUTSIDE
    );
    // In the same wrong unit as the handles: that is said once.
    let both = json!({"p": [[0.2, 0.3], [0.4, 0.9]], "q": [[0.2, 0.35], [0.4, 0.9]],
        "points": [[0.31, 0.2]], "extent": [160, 120]});
    assert_eq!(
        warnings(&server, "/points", &both).await,
        "looks_normalized"
    );
    // One pixel is all of a small picture.
    let small = json!({"p": [[0.5, 0.5], [1.25, 0.5]], "q": [[0.6, 0.5], [1.25, 0.5]],
        "points": [[0.3, 0.2]], "extent": [2, 2]});
    assert_eq!(warnings(&server, "/points", &small).await, "");
}
