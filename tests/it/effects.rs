//! Every field of every request has an effect: for each route and each field that the OpenAPI
//! document lists there, two values give two answers. A new field fails until it has a row here,
//! and a field that is accepted and then forgotten fails for ever.

use std::collections::BTreeSet;

use reqwest::Response;
use reqwest::multipart::Part;
use serde_json::{Map, Value, json};

use crate::support::picture::png_of;
use crate::support::server::form;
use crate::support::{Server, photo};

/// Fields that describe how a file was read, which the answer of `/landmarks` has: they are
/// accepted where this answer is sent.
const DESCRIPTIVE: [&str; 3] = ["names", "format", "unmatched"];
/// What the form of a picture is; routes that draw nothing accept a warp object that has it.
const OF_PICTURES: [&str; 8] = [
    "format",
    "quality",
    "subsampling",
    "compression",
    "filter",
    "outside",
    "holes",
    "layer",
];
/// Of files, which `landmarks::` and `missing::` send, and the order of a drag, of which
/// `revisions::` tells.
const ELSEWHERE: [&str; 3] = ["match", "item", "seq"];

/// How a route is asked.
#[derive(Clone, Copy, PartialEq)]
enum By {
    /// Parts `image` and `warp`; handles and all.
    Upload,
    /// JSON with handles at rest and posed.
    Whole,
    /// JSON with posed handles, for a session.
    Posed,
}

struct Route {
    method: &'static str,
    path: &'static str,
    /// The schema of its object.
    schema: &'static str,
    by: By,
    draws: bool,
    /// What its object needs beside handles.
    needs: &'static str,
}

const fn route(
    method: &'static str,
    path: &'static str,
    schema: &'static str,
    by: By,
    draws: bool,
) -> Route {
    Route {
        method,
        path,
        schema,
        by,
        draws,
        needs: "{}",
    }
}

const POINTS: &str = r#"{"points": [[30, 40], [100, 90]]}"#;

const ROUTES: [Route; 14] = [
    route("POST", "/warp", "WarpObject", By::Upload, true),
    route("POST", "/sessions", "WarpObject", By::Upload, true),
    route("PUT", "/sessions/{id}/handles", "Handles", By::Whole, true),
    route("POST", "/sessions/{id}/warp", "Drag", By::Posed, true),
    Route {
        needs: POINTS,
        ..route("POST", "/points", "Points", By::Whole, false)
    },
    Route {
        needs: POINTS,
        ..route(
            "POST",
            "/sessions/{id}/points",
            "PosedPoints",
            By::Posed,
            false,
        )
    },
    route("POST", "/report", "Report", By::Whole, false),
    route(
        "POST",
        "/sessions/{id}/report",
        "PosedReport",
        By::Posed,
        false,
    ),
    route("POST", "/map", "Map", By::Whole, false),
    route("POST", "/sessions/{id}/map", "PosedMap", By::Posed, false),
    route("POST", "/fit", "Fit", By::Whole, false),
    route("POST", "/sessions/{id}/fit", "PosedFit", By::Posed, false),
    route(
        "POST",
        "/sessions/{id}/mesh",
        "PosedHandlesOnly",
        By::Posed,
        false,
    ),
    Route {
        needs: r#"{"steps": 3}"#,
        ..route("POST", "/sessions/{id}/batch", "Batch", By::Posed, true)
    },
];

fn object(value: Value) -> Map<String, Value> {
    let Value::Object(object) = value else {
        panic!("{value} is no object")
    };
    object
}

/// Handles that move enough for every choice to matter, inside a picture of 160 x 120 px.
fn p() -> Value {
    json!([
        [20, 20],
        [140, 30],
        [130, 100],
        [25, 95],
        [80, 60],
        [60, 30]
    ])
}

fn q() -> Value {
    json!([
        [26, 28],
        [128, 26],
        [138, 92],
        [20, 104],
        [90, 52],
        [57, 39]
    ])
}

/// For a field: what both objects have, and the two values. `null` leaves the field out.
fn values(schema: &str, field: &str) -> (Value, Value, Value) {
    let lines =
        json!({"p": [[20, 20], [[60, 30], [120, 90]]], "q": [[26, 28], [[66, 20], [110, 97]]]});
    let (twin_p, twin_q) = (
        json!([[20, 20], [21, 20], [130, 100], [40, 90], [120, 30]]),
        json!([[26, 28], [20, 36], [138, 92], [50, 99], [99, 20]]),
    );
    let twins = json!({"p": twin_p, "q": twin_q});
    // Coordinates that are positions in both units.
    let (small_p, small_q) = (
        json!([[0.1, 0.2], [0.9, 0.2], [0.5, 0.8], [0.2, 0.7]]),
        json!([[0.2, 0.2], [0.8, 0.3], [0.5, 0.7], [0.3, 0.9]]),
    );
    let small = json!({"p": small_p, "q": small_q});
    let normalized = json!({"p": small_p, "q": small_q, "units": "normalized"});
    let crossed_p = json!([[40, 60], [120, 60], [80, 20], [80, 100]]);
    let crossed_q = json!([[120, 60], [40, 60], [80, 20], [80, 100]]);
    let no = json!({});
    match field {
        "p" => (
            no,
            p(),
            json!([
                [25, 20],
                [140, 30],
                [130, 100],
                [25, 90],
                [80, 60],
                [60, 35]
            ]),
        ),
        "q" => (
            no,
            q(),
            json!([
                [26, 28],
                [128, 26],
                [138, 92],
                [20, 104],
                [80, 60],
                [57, 39]
            ]),
        ),
        "align" => (no, json!("none"), json!("similarity")),
        "strength" => (no, json!(1), json!(0.5)),
        "weights" => (no, json!([1, 1, 1, 1, 1, 1]), json!([9, 1, 1, 1, 1, 1])),
        // The middle is dragged over the right half.
        "depth" => {
            let mut folded = json!({"q": [
                [20, 20],
                [140, 30],
                [130, 100],
                [25, 95],
                [150, 70],
                [60, 30]
            ]});
            if schema == "Points" {
                folded["inverse"] = json!(true);
                folded["points"] = json!([[120, 60], [130, 65], [140, 70], [125, 80]]);
            }
            (
                folded,
                json!([0, 0, 0, 0, 1, 0]),
                json!([0, 0, 0, 0, -1, 0]),
            )
        }
        "method" => (no, json!("rigid"), json!("affine")),
        "alpha" => (no, json!(1), json!(2)),
        "point_mass" => (lines, json!(1), json!(500)),
        "smoothing" => (json!({"method": "tps"}), json!(0), json!(10)),
        "beier_neely" => {
            let (p, q) = (
                json!([[[60, 30], [120, 90]], [[20, 100], [50, 20]]]),
                json!([[[66, 20], [110, 97]], [[30, 100], [50, 30]]]),
            );
            let lines = json!({"method": "beier_neely", "p": p, "q": q});
            (lines, json!({"a": 0, "b": 0.5}), json!({"a": 50, "p": 1}))
        }
        "metric" => (no, json!("euclidean"), json!("geodesic")),
        "mask" if ["Points", "Report", "Map"].contains(&schema) => {
            (no, Value::Null, json!({"threshold": 0.5}))
        }
        "mask" => (
            json!({"metric": "geodesic"}),
            json!({"threshold": 0.2}),
            json!({"threshold": 0.8}),
        ),
        // Without an image there is no mesh.
        "arap" if ["Points", "Report", "Map"].contains(&schema) => {
            (no, Value::Null, json!({"cell": 8}))
        }
        "arap" => (
            json!({"method": "arap"}),
            json!({"cell": 2}),
            json!({"cell": 32}),
        ),
        // Points that are one, and points that are two.
        "coincident" => (twins, json!({"within": 0}), json!({"within": 3})),
        "units" => (small, json!("px"), json!("normalized")),
        // Positions are mapped without a grid, but whether it folds is seen on one.
        "grid" if schema == "Points" => (
            json!({"p": crossed_p, "q": crossed_q, "folds": "reject"}),
            json!({"columns": 2, "rows": 2}),
            json!({"cell": 8}),
        ),
        "grid" => (
            no,
            json!({"columns": 3, "rows": 3}),
            json!({"tolerance": 0.1}),
        ),
        "folds" => (
            json!({"p": crossed_p, "q": crossed_q, "grid": {"cell": 8}}),
            json!("report"),
            json!("reject"),
        ),
        "extent" => (normalized, json!([160, 120]), json!([320, 120])),
        "seq" => (no, json!(1), json!(7)),
        "layer" => (no, Value::Null, json!("depth")),
        "layers" => (no, Value::Null, json!(["depth"])),
        "output" if schema == "Batch" => (no, json!({}), json!({"width": 80})),
        "output" => (no, json!({}), json!({"width": 80})),
        "output.width" => (no, Value::Null, json!(80)),
        "output.canvas" => (
            no,
            Value::Null,
            json!({"x": -10, "y": 5, "width": 100, "height": 90}),
        ),
        "output.format" => (no, json!("png"), json!("webp")),
        "output.quality" => (json!({"output": {"format": "jpeg"}}), json!(30), json!(90)),
        "output.subsampling" => (
            json!({"output": {"format": "jpeg"}}),
            json!("4:2:0"),
            json!("4:4:4"),
        ),
        "output.compression" => (no, json!("none"), json!("best")),
        "output.filter" => (no, json!("nearest"), json!("bicubic")),
        "output.outside" => (no, json!("edge"), json!("#ff0000")),
        "output.holes" => (no, json!("keep"), json!("transparent")),
        "canvas" => (
            no,
            Value::Null,
            json!({"x": -10, "y": 5, "width": 100, "height": 90}),
        ),
        "width" => (no, Value::Null, json!(80)),
        "direction" => (no, json!("inverse"), json!("forward")),
        "candidates" => (
            no,
            json!([{"method": "affine"}]),
            json!([{"method": "rigid"}]),
        ),
        "points" => (no, json!([[30, 40]]), json!([[31, 40]])),
        "polygons" => (no, Value::Null, json!([[[30, 40], [60, 40], [60, 90]]])),
        "boxes" => (no, Value::Null, json!([[30, 40, 60, 90]])),
        "geojson" => (
            no,
            Value::Null,
            json!({"type": "Point", "coordinates": [30, 40]}),
        ),
        "inverse" => (no, json!(false), json!(true)),
        "refine" if schema == "Batch" => (
            json!({"polygons": [[[5, 5], [155, 5], [155, 115]]]}),
            json!(false),
            json!(true),
        ),
        "refine" => (
            json!({"polygons": [[[5, 5], [155, 5], [155, 115]]]}),
            json!(false),
            json!(true),
        ),
        "frames" => (
            json!({"steps": null, "q": null}),
            json!([{"q": p()}]),
            json!([{"q": q()}]),
        ),
        "steps" => (no, json!(2), json!(3)),
        "easing" => (json!({"steps": 4}), json!("linear"), json!("ease-in-out")),
        "jitter" => (
            json!({"steps": null}),
            json!({"seed": 1, "count": 2, "sigma": 2}),
            json!({"seed": 2, "count": 2, "sigma": 2}),
        ),
        "delay" => (no, json!(40), json!(80)),
        "loop" => (no, json!(0), json!(3)),
        "and_back" => (no, json!(false), json!(true)),
        _ => panic!(
            "{schema} has the new field `{field}`: give it two values here that must give \
                different answers"
        ),
    }
}

/// Puts a field, `output.width` style, into an object; `null` removes it.
fn put(object: &mut Map<String, Value>, field: &str, value: Value) {
    match field.split_once('.') {
        Some((outer, inner)) => {
            let nested = object
                .entry(outer)
                .or_insert_with(|| json!({}))
                .as_object_mut()
                .unwrap();
            put(nested, inner, value);
        }
        None if value.is_null() => _ = object.remove(field),
        None => _ = object.insert(field.to_owned(), value),
    }
}

/// All that may differ between two answers: the status, the headers of the warp, and the body
/// without what is different in every answer.
async fn answer(response: Response) -> (u16, Vec<(String, String)>, Vec<u8>) {
    let status = response.status().as_u16();
    let is_of_warp =
        |name: &str| (name.starts_with("warp-") && name != "warp-plan") || name == "content-type";
    let headers = response
        .headers()
        .iter()
        .filter(|(name, _)| is_of_warp(name.as_str()));
    let headers = headers
        .map(|(name, value)| (name.to_string(), value.to_str().unwrap().to_owned()))
        .collect();
    let body = response.bytes().await.unwrap();
    let Ok(Value::Object(mut object)) = serde_json::from_slice(&body) else {
        return (status, headers, body.to_vec());
    };
    for unique in [
        "id",
        "created",
        "expires",
        "request_id",
        "instance",
        "rest_revision",
    ] {
        object.remove(unique);
    }
    (status, headers, serde_json::to_vec(&object).unwrap())
}

struct Asker {
    server: Server,
    image: Vec<u8>,
}

impl Asker {
    fn image_for(&self, field: &str) -> Vec<u8> {
        if field == "mask" {
            divided()
        } else {
            self.image.clone()
        }
    }

    /// A session with handles, a layer, and a region if the field is about regions.
    async fn session(&self, field: &str) -> String {
        let id = self
            .server
            .session(&self.image_for(field), &json!({"p": p()}))
            .await;
        let layers = [("depth", true), ("region", field == "output.holes")];
        for (layer, _) in layers.into_iter().filter(|(_, is_needed)| *is_needed) {
            let url = self.server.url(&format!("/sessions/{id}/layers/{layer}"));
            let response = self
                .server
                .client
                .put(url)
                .body(mask())
                .send()
                .await
                .unwrap();
            assert!(
                response.status().is_success(),
                "{}",
                response.text().await.unwrap()
            );
        }
        id
    }

    /// Asks a route; for those that make or change a session, draws its pose.
    async fn ask(
        &self,
        route: &Route,
        object: &Map<String, Value>,
        field: &str,
    ) -> (u16, Vec<(String, String)>, Vec<u8>) {
        let url = |id: &str| self.server.url(&route.path.replace("{id}", id));
        match route.by {
            By::Upload => {
                let mut parts = form(
                    &self.image_for(field),
                    Value::Object(object.clone()).to_string(),
                );
                if field == "output.holes" {
                    parts = parts.part("region", Part::bytes(mask()).file_name("mask"));
                }
                let response = self
                    .server
                    .post(route.path)
                    .multipart(parts)
                    .send()
                    .await
                    .unwrap();
                if route.path != "/sessions" || !response.status().is_success() {
                    return answer(response).await;
                }
                let id = response.json::<Value>().await.unwrap()["id"]
                    .as_str()
                    .unwrap()
                    .to_owned();
                answer(self.server.drag(&id, &json!({})).await).await
            }
            By::Whole if route.method == "PUT" => {
                let id = self.session(field).await;
                let response = self
                    .server
                    .client
                    .put(url(&id))
                    .json(object)
                    .send()
                    .await
                    .unwrap();
                if !response.status().is_success() {
                    return answer(response).await;
                }
                answer(self.server.drag(&id, &json!({})).await).await
            }
            By::Whole => {
                answer(
                    self.server
                        .post(route.path)
                        .json(object)
                        .send()
                        .await
                        .unwrap(),
                )
                .await
            }
            By::Posed => {
                let id = self.session(field).await;
                let mut request = self.server.client.post(url(&id)).json(object);
                if ["delay", "loop"].contains(&field) {
                    request = request.header("accept", "image/apng");
                }
                answer(request.send().await.unwrap()).await
            }
        }
    }
}

/// A picture with a wall that shows half.
fn divided() -> Vec<u8> {
    let samples: Vec<u8> = (0..120)
        .flat_map(|y| {
            (0..160).flat_map(move |x| {
                let alpha = if (100..110).contains(&x) && y > 20 {
                    128
                } else {
                    255
                };
                [x, y, 90, alpha]
            })
        })
        .collect();
    png_of(
        160,
        120,
        png::ColorType::Rgba,
        png::BitDepth::Eight,
        &samples,
    )
}

/// A picture whose left half is white.
fn mask() -> Vec<u8> {
    let samples: Vec<u8> = (0..120)
        .flat_map(|_| (0..160).map(|x| if x < 80 { 255 } else { 0 }))
        .collect();
    png_of(
        160,
        120,
        png::ColorType::Grayscale,
        png::BitDepth::Eight,
        &samples,
    )
}

/// A report counts the folds for which the other routes refuse, whatever is in front.
fn is_counted(route: &Route, field: &str) -> bool {
    ["folds", "depth"].contains(&field) && route.path == "/report"
}

/// The fields of a route's object, those of `output` by their path.
fn fields(document: &Value, route: &Route) -> Vec<String> {
    let schema = |name: &str| document["components"]["schemas"][name].clone();
    let of = if schema(route.schema).is_null() {
        schema("WarpObject")
    } else {
        schema(route.schema)
    };
    let names = of["properties"].as_object().unwrap().keys();
    let output = schema("Output");
    let inner = |name: &String| {
        let inner: Vec<String> = output["properties"]
            .as_object()
            .unwrap()
            .keys()
            .map(|inner| format!("output.{inner}"))
            .collect();
        if name == "output" {
            inner
        } else {
            vec![name.clone()]
        }
    };
    names.flat_map(inner).collect()
}

#[tokio::test]
async fn every_field_of_every_route_has_an_effect() {
    let server = Server::start(&[]).await;
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let asker = Asker {
        server,
        image: photo(160, 120),
    };
    let mut silent = Vec::new();
    for route in &ROUTES {
        for field in fields(&document, route) {
            let last = field.rsplit('.').next().unwrap();
            let is_elsewhere =
                ELSEWHERE.contains(&last) || (!field.contains('.') && DESCRIPTIVE.contains(&last));
            if is_elsewhere
                || is_counted(route, &field)
                || (!route.draws && field.starts_with("output.") && OF_PICTURES.contains(&last))
            {
                continue;
            }
            let (base, a, b) = values(route.schema, &field);
            let mut common = object(serde_json::from_str(route.needs).unwrap());
            if route.by != By::Posed {
                common.insert("p".to_owned(), p());
            }
            common.insert("q".to_owned(), q());
            if fields(&document, route).contains(&"extent".to_owned()) {
                common.insert("extent".to_owned(), json!([160, 120]));
            }
            for (name, value) in object(base) {
                put(&mut common, &name, value);
            }
            let mut answers = Vec::new();
            for value in [a, b] {
                let mut object = common.clone();
                put(&mut object, &field, value);
                answers.push(asker.ask(route, &object, &field).await);
            }
            let text = |k: usize| {
                std::str::from_utf8(&answers[k].2)
                    .map_or("bytes", |text| &text[..text.len().min(200)])
            };
            // Without an image nothing has a mask.
            let has_no_mask = route.by == By::Whole && route.method == "POST";
            let is_refused = field == "folds"
                || (route.schema, field.as_str()) == ("Points", "grid")
                || (has_no_mask && ["metric", "mask", "arap"].contains(&field.as_str()));
            let expected: &[u16] = if is_refused { &[200, 422] } else { &[200, 200] };
            let statuses = [answers[0].0, answers[1].0];
            if answers[0] == answers[1] || statuses != expected {
                silent.push(format!(
                    "{} {} {field}: {statuses:?} {} {}",
                    route.method,
                    route.path,
                    text(0),
                    text(1)
                ));
            }
        }
    }
    assert!(
        silent.is_empty(),
        "without effect, or refused:\n{}",
        silent.join("\n")
    );
}

#[tokio::test]
async fn every_route_with_a_json_object_is_tried() {
    let server = Server::start(&[]).await;
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let mut with_object = BTreeSet::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let content = &operation["requestBody"]["content"];
            let has_warp =
                content["multipart/form-data"]["schema"]["properties"]["warp"].is_object();
            if content["application/json"].is_object() || has_warp {
                with_object.insert(format!("{} {path}", method.to_uppercase()));
            }
        }
    }
    let tried: BTreeSet<String> = ROUTES
        .iter()
        .map(|route| format!("{} {}", route.method, route.path))
        .collect();
    // The same object as that of `POST`; the fields of a token are tried in `tokens.rs`, those of a
    // blend in `blend.rs`.
    let elsewhere = [
        "PUT /sessions/{id}",
        "POST /sessions/{id}/tokens",
        "POST /blend",
    ];
    let untried: Vec<&String> = with_object
        .difference(&tried)
        .filter(|route| !elsewhere.contains(&route.as_str()))
        .collect();
    assert!(
        untried.is_empty(),
        "{untried:?} have objects of fields and are not in ROUTES"
    );
}
