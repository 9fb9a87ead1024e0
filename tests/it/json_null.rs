//! `null` as the value of a field is the same as no field, in every JSON body that the OpenAPI
//! document lists and on the drag socket: clients with types send `"weights": null`.

use reqwest::{Method, RequestBuilder};
use serde_json::{Map, Value, json};

use crate::support::drag_client::Received;
use crate::support::server::form;
use crate::support::{DragClient, Server, photo};

const ID: &str = "0f8fad5b-d9cb-469f-a165-70867728950e";
/// A session of points alone, on which methods are compared.
const OF_POINTS: &str = "1c9a4a31-6f0b-4c9e-9d2f-0a3f5c1be7d1";

/// A value for every field that a body may have.
fn sample(name: &str) -> Value {
    match name {
        "p" => json!([[2, 2], [[4, 3], [12, 9]]]),
        "q" => json!([[3, 2], [[4, 4], [12, 8]]]),
        "weights" => json!([1, 2]),
        "depth" => json!([0, 1]),
        "method" => json!("similarity"),
        "alpha" => json!(1.5),
        "point_mass" => json!(7),
        "smoothing" => json!(0.5),
        "coincident" => json!({"policy": "reject", "within": 0.5}),
        "policy" => json!("mean"),
        "within" => json!(0.5),
        "units" => json!("px"),
        "align" => json!("similarity"),
        "grid" => json!({"columns": 9, "rows": 7}),
        "cell" => json!(4),
        "columns" => json!(9),
        "rows" => json!(7),
        "folds" => json!("report"),
        "output" => {
            json!({
                "format": "png", "quality": 80, "compression": "best", "width": 20,
                    "filter": "nearest", "outside": "edge", "canvas": "fit"
            })
        }
        "images" => json!([{"session": ID, "shape": 0.5}, {"session": ID, "shape": 0.5}]),
        "reference" => json!("mean"),
        "space" => json!("linear"),
        "seq" => json!(3),
        "layer" => json!("@coverage"),
        "strength" => json!(0.5),
        "extent" => json!([16, 12]),
        "points" => json!([[1, 1], [5, 6.5]]),
        "polygons" => json!([[[1, 1], [9, 1], [5, 6.5]]]),
        "boxes" => json!([[1, 1, 5, 6.5]]),
        "geojson" => json!({"type": "FeatureCollection", "features": []}),
        "inverse" => json!(false),
        "refine" => json!(false),
        "direction" => json!("forward"),
        "canvas" => json!("fit"),
        "width" => json!(20),
        "frames" => json!([{"q": sample("q"), "strength": 0.5}, {"q": sample("q")}]),
        "layers" => json!(["@coverage"]),
        "steps" => json!(2),
        "easing" => json!("ease-in-out"),
        "jitter" => json!({"seed": 7, "count": 2, "sigma": 0.5}),
        "delay" => json!(20),
        "loop" => json!(2),
        "and_back" => json!(true),
        "ops" => json!(["warp", "layers"]),
        "ttl" => json!(60),
        "max_bytes" => json!(4096),
        "candidates" => json!([{"method": "tps"}, {"method": "rigid", "alpha": 2}]),
        "names" => sample("p")
            .as_array()
            .unwrap()
            .iter()
            .map(|_| "a")
            .collect(),
        "format" => json!("pts+csv"),
        "unmatched" => json!({"p": ["c"], "q": []}),
        // Its fields belong to one method.
        "beier_neely" | "arap" | "mask" => json!({}),
        "metric" => json!("euclidean"),
        // They belong to landmark files.
        "match" | "item" => Value::Null,
        other => panic!("`{other}` is new: say here what it may hold"),
    }
}

fn four_points() -> Value {
    json!([[2, 2], [12, 3], [4, 9], [13, 10]])
}

fn resolve<'a>(document: &'a Value, schema: &'a Value) -> &'a Value {
    match schema["$ref"]
        .as_str()
        .or_else(|| schema["allOf"][0]["$ref"].as_str())
    {
        Some(target) => resolve(document, document.pointer(&target[1..]).unwrap()),
        None => schema,
    }
}

/// The object that a request sends as JSON.
struct Body {
    method: Method,
    path: String,
    is_upload: bool,
    fields: Vec<String>,
    required: Vec<String>,
}

impl Body {
    /// Of every operation that takes one.
    fn all(document: &Value) -> Vec<Self> {
        let mut all = Vec::new();
        for (path, item) in document["paths"].as_object().unwrap() {
            for (method, operation) in item.as_object().unwrap() {
                let content = &resolve(document, &operation["requestBody"])["content"];
                if !content.is_object() {
                    continue;
                }
                let is_form = content["application/json"].is_null();
                let upload = if is_form {
                    &content["multipart/form-data"]["schema"]
                } else {
                    &Value::Null
                };
                let schema = if upload.is_object() {
                    &resolve(document, upload)["properties"]["warp"]
                } else {
                    &content["application/json"]["schema"]
                };
                let schema = resolve(document, schema);
                if !schema.is_object() {
                    // A form without JSON.
                    continue;
                }
                let names = |of: &Value| {
                    of.as_array()
                        .into_iter()
                        .flatten()
                        .map(|name| name.as_str().unwrap().to_owned())
                        .collect()
                };
                all.push(Self {
                    method: method.to_uppercase().parse().unwrap(),
                    path: path.replace(
                        "{id}",
                        if path.ends_with("/fit") {
                            OF_POINTS
                        } else {
                            ID
                        },
                    ),
                    is_upload: upload.is_object(),
                    fields: schema["properties"]
                        .as_object()
                        .unwrap()
                        .keys()
                        .cloned()
                        .collect(),
                    required: names(&schema["required"]),
                });
            }
        }
        all
    }

    /// Whether its poses have one of several forms.
    fn is_batch(&self) -> bool {
        self.fields.iter().any(|name| name == "frames")
    }

    fn request(&self, server: &Server, object: &Value) -> RequestBuilder {
        let request = server
            .client
            .request(self.method.clone(), server.url(&self.path));
        if self.is_upload {
            request.multipart(form(&photo(16, 12), object.to_string()))
        } else {
            request.json(object)
        }
    }

    /// The status and the content of the answer, without what differs from one answer to the next.
    async fn answer(&self, server: &Server, object: &Value) -> (u16, Vec<u8>) {
        let response = self.request(server, object).send().await.unwrap();
        let (status, bytes) = (
            response.status().as_u16(),
            response.bytes().await.unwrap().to_vec(),
        );
        let Ok(mut told) = serde_json::from_slice::<Map<String, Value>>(&bytes) else {
            return (status, bytes);
        };
        told.retain(|name, _| {
            !["id", "created", "expires", "request_id", "token"].contains(&name.as_str())
        });
        (status, Value::from(told).to_string().into_bytes())
    }

    /// An object with these fields.
    fn of(&self, is_chosen: impl Fn(&str) -> bool) -> Value {
        let value = |name: &str| match name {
            "p" | "q" if self.path.ends_with("/fit") => four_points(),
            "weights" if self.path.ends_with("/fit") => json!([1, 2, 1, 2]),
            "names" if self.path.ends_with("/fit") => json!(["a", "b", "c", "d"]),
            // `fit` depends on one posed image.
            "output" if self.path == "/blend" => json!({"width": 20, "filter": "nearest"}),
            _ => sample(name),
        };
        self.fields
            .iter()
            .filter(|name| is_chosen(name))
            .map(|name| (name.clone(), value(name)))
            .collect()
    }

    /// Compares the answers for each of these fields as `null` and left out, and gives the last of
    /// them.
    async fn same(
        &self,
        server: &Server,
        names: &[&str],
        at: &str,
        object: &Value,
    ) -> (u16, Vec<u8>) {
        let (mut nulls, mut none) = (object.clone(), object.clone());
        for name in names {
            nulls.pointer_mut(at).unwrap()[*name] = Value::Null;
            none.pointer_mut(at)
                .unwrap()
                .as_object_mut()
                .unwrap()
                .remove(*name);
        }
        let (with_nulls, without) = (
            self.answer(server, &nulls).await,
            self.answer(server, &none).await,
        );
        assert!(
            with_nulls == without,
            "{} {}: {nulls}: {with_nulls:?}, {without:?}",
            self.method,
            self.path
        );
        without
    }
}

#[tokio::test]
async fn a_field_that_is_null_is_absent_in_every_body_of_the_document() {
    let server = Server::with_key().await;
    let put = server
        .client
        .put(server.url(&format!("/sessions/{ID}")))
        .multipart(form(&photo(16, 12), json!({"p": sample("p")}).to_string()));
    assert_eq!(put.send().await.unwrap().status(), 201);
    let points = server
        .client
        .put(server.url(&format!("/sessions/{OF_POINTS}")));
    let points = points.multipart(form(
        &photo(16, 12),
        json!({"p": four_points()}).to_string(),
    ));
    assert_eq!(points.send().await.unwrap().status(), 201);
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let bodies = Body::all(&document);
    assert!(bodies.len() >= 8, "{}", bodies.len());
    for body in &bodies {
        // Its method takes neither lines nor alpha; the poses of a batch have one form, and an
        // archive shows no frame for a time.
        let whole =
            body.of(|name| !["smoothing", "frames", "jitter", "delay", "loop"].contains(&name));
        let needed = body.of(|name| {
            ["p", "q", "steps"].contains(&name)
                || body.required.iter().any(|required| required == name)
        });
        let place = format!("{} {}", body.method, body.path);
        assert!(body.answer(&server, &whole).await.0 < 300, "{place}");
        for name in &body.fields {
            let (status, answer) = body.same(&server, &[name], "", &whole).await;
            if body.required.contains(name) {
                let problem: Value = serde_json::from_slice(&answer).unwrap();
                assert_eq!(
                    (status, &problem["code"], &problem["pointer"]),
                    (422, &json!("bad_value"), &json!(format!("/{name}"))),
                    "{place}"
                );
                assert!(
                    problem["detail"]
                        .as_str()
                        .unwrap()
                        .starts_with(&format!("`{name}` is missing")),
                    "{place}: {problem}"
                );
            }
        }
        let optional: Vec<&str> = body
            .fields
            .iter()
            .map(String::as_str)
            .filter(|name| needed.get(name).is_none())
            .collect();
        let (status, _) = body.same(&server, &optional, "", &needed).await;
        assert!(status < 300, "{place}: {status}");
        // Objects inside the object.
        for (outer, value) in whole
            .as_object()
            .unwrap()
            .iter()
            .filter(|(_, value)| value.is_object())
        {
            for inner in value.as_object().unwrap().keys() {
                body.same(&server, &[inner], &format!("/{outer}"), &whole)
                    .await;
            }
        }
        if body.fields.iter().any(|name| name == "grid") {
            let mut cells = whole.clone();
            cells["grid"] = json!({"cell": sample("cell")});
            assert!(
                body.same(&server, &["columns", "rows", "tolerance"], "/grid", &cells)
                    .await
                    .0
                    < 300,
                "{place}"
            );
            cells["grid"] = json!({"tolerance": 1});
            assert!(
                body.same(&server, &["cell", "columns", "rows"], "/grid", &cells)
                    .await
                    .0
                    < 300,
                "{place}"
            );
        }
    }
}

#[tokio::test]
async fn a_null_in_an_array_is_a_wrong_value_except_for_a_missing_annotation() {
    let server = Server::with_key().await;
    for id in [ID, OF_POINTS] {
        server
            .client
            .put(server.url(&format!("/sessions/{id}")))
            .multipart(form(&photo(16, 12), "{}"))
            .send()
            .await
            .unwrap();
    }
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let mut tried = 0;
    for body in Body::all(&document) {
        // A handle that is `null` is missing.
        let is_list =
            |name: &&String| sample(name).is_array() && !["p", "q"].contains(&name.as_str());
        for name in body.fields.iter().filter(is_list) {
            let mut object = body.of(|field| match (body.is_batch(), name.as_str()) {
                (false, _) => true,
                (true, "frames") => field == "frames",
                (true, _) => [name, "q", "steps"].contains(&field),
            });
            object[name][0] = Value::Null;
            if ["points", "polygons", "boxes"].contains(&name.as_str()) {
                let mut lone =
                    body.of(|field| ["p", "q", "extent", "steps", name].contains(&field));
                if !body.fields.iter().any(|field| field == "p") {
                    lone["q"] = json!([]);
                }
                let missing = with_null(lone, name);
                assert!(
                    body.answer(&server, &missing).await.0 < 300,
                    "{} {name}",
                    body.path
                );
                continue;
            }
            let (status, answer) = body.answer(&server, &object).await;
            let problem: Value = serde_json::from_slice(&answer).unwrap();
            let expected = (422, json!("bad_value"), json!(format!("/{name}/0")));
            assert_eq!(
                (status, problem["code"].clone(), problem["pointer"].clone()),
                expected,
                "{} {}",
                body.method,
                body.path
            );
            tried += 1;
        }
    }
    assert!(tried > 15, "{tried}");
}

fn with_null(mut object: Value, name: &str) -> Value {
    object[name][0] = Value::Null;
    object
}

#[tokio::test]
async fn a_field_that_is_null_is_absent_in_a_message_of_the_socket() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(64, 48), &json!({"p": [[20, 20]]}))
        .await;
    let mut drag = DragClient::open(server.address, &id, "?frames=mesh").await;
    drag.say(&json!({"seq": 4, "q": [[22, 20]], "ack": null}))
        .await;
    assert_eq!(drag.frame().await.0, 4);
    drag.say(&json!({"seq": null, "q": null, "ack": 4})).await;
    drag.say(&json!({"seq": 5, "q": [[23, 20]]})).await;
    assert_eq!(drag.frame().await.0, 5, "the acknowledgement has arrived");
    for (message, field) in [
        (json!({"seq": 6, "q": null}), "q"),
        (json!({"seq": null, "q": [[1, 1]]}), "seq"),
    ] {
        drag.say(&message).await;
        let Received::Text(problem) = drag.next().await else {
            panic!("a problem was expected")
        };
        assert!(
            problem["detail"]
                .as_str()
                .unwrap()
                .starts_with(&format!("`{field}` is missing")),
            "{problem}"
        );
    }
}
