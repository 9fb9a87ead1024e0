//! Landmark files are accepted wherever handles are: every route of the OpenAPI document whose JSON
//! has `q` also takes a form with landmark files, and answers as it does to the same handles in
//! JSON.

use std::collections::BTreeSet;

use mlswarp_server::limits::memory::MemoryClass;
use reqwest::multipart::Form;
use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::support::server::{form, problem};
use crate::support::{Server, eventually, photo};

const SIZE: [u32; 2] = [64, 48];
const BOTH: &str = "px,py,qx,qy\n10,10,14,6\n40,30,44,30\n20,40,20,36\n50,8,50,12\n30,20,32,20\n";
const REST: &str = "x,y\n10,10\n40,30\n20,40\n50,8\n30,20\n";
const POSED: &str = "x,y\n14,6\n44,30\n20,36\n50,12\n32,20\n";

fn rest() -> Value {
    json!([
        [10.0, 10.0],
        [40.0, 30.0],
        [20.0, 40.0],
        [50.0, 8.0],
        [30.0, 20.0]
    ])
}

fn posed() -> Value {
    json!([
        [14.0, 6.0],
        [44.0, 30.0],
        [20.0, 36.0],
        [50.0, 12.0],
        [32.0, 20.0]
    ])
}

/// The other fields of a request.
fn others(path: &str) -> Value {
    let extent = json!({"extent": SIZE});
    match path {
        "/fit" | "/report" => extent,
        "/map" => json!({"extent": SIZE, "direction": "forward"}),
        "/points" => json!({"extent": SIZE, "points": [[3, 4]], "align": "rigid"}),
        "/sessions/{id}/points" => json!({"points": [[3, 4]], "strength": 0.5}),
        "/sessions/{id}/batch" => json!({"steps": 3}),
        "/sessions/{id}/map" => json!({"width": 8}),
        "/sessions/{id}/warp" => json!({"output": {"format": "jpeg"}, "seq": 5}),
        "/sessions/{id}/mesh" | "/sessions/{id}/report" | "/sessions/{id}/fit" => json!({}),
        "/warp" | "/sessions" | "/sessions/{id}" | "/sessions/{id}/handles" => {
            json!({"method": "affine"})
        }
        other => panic!("{other} takes handles: it needs a row here, and landmark files"),
    }
}

/// Whether a schema of the document has a property, following references.
fn has_property(document: &Value, schema: &Value, name: &str) -> bool {
    if let Some(target) = schema["$ref"].as_str() {
        return has_property(
            document,
            document.pointer(target.trim_start_matches('#')).unwrap(),
            name,
        );
    }
    let parts = schema["allOf"].as_array().into_iter().flatten();
    schema["properties"][name].is_object()
        || parts
            .into_iter()
            .any(|part| has_property(document, part, name))
}

fn resolved<'a>(document: &'a Value, value: &'a Value) -> &'a Value {
    value["$ref"].as_str().map_or(value, |target| {
        document.pointer(target.trim_start_matches('#')).unwrap()
    })
}

/// The routes that take handles: method and path, and the media types of their bodies.
fn routes(document: &Value) -> Vec<(Method, String, BTreeSet<String>)> {
    let mut routes = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let body = resolved(document, &operation["requestBody"]);
            let Some(content) = body["content"].as_object() else {
                continue;
            };
            let takes = |body: &Value| {
                let warp = &resolved(document, &body["schema"])["properties"]["warp"];
                has_property(document, &body["schema"], "q") || has_property(document, warp, "q")
            };
            if content.values().any(takes) {
                routes.push((
                    method.to_uppercase().parse().unwrap(),
                    path.clone(),
                    content.keys().cloned().collect(),
                ));
            }
        }
    }
    routes
}

/// A body without what no two answers share.
async fn body(what: &str, response: Response) -> Vec<u8> {
    assert!(
        response.status().is_success(),
        "{what}: {} {:?}",
        response.status(),
        response.text().await
    );
    let bytes = response.bytes().await.unwrap();
    match serde_json::from_slice::<Value>(&bytes) {
        Ok(Value::Object(mut object)) => {
            for varying in ["id", "created", "expires", "seq"] {
                object.remove(varying);
            }
            serde_json::to_vec(&object).unwrap()
        }
        _ => bytes.to_vec(),
    }
}

fn with_files(form: Form, files: &[(&'static str, &'static str)]) -> Form {
    files
        .iter()
        .fold(form, |form, (name, text)| form.text(*name, *text))
}

#[tokio::test]
async fn every_route_with_handles_takes_landmark_files() {
    let server = Server::start(&[]).await;
    let image = photo(SIZE[0], SIZE[1]);
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let routes = routes(&document);
    assert!(routes.len() > 14, "{routes:?}");
    for (method, path, media_types) in routes {
        let what = format!("{method} {path}");
        assert!(
            media_types.contains("multipart/form-data"),
            "{what}: no form in the document"
        );
        let id = match path.as_str() {
            "/sessions/{id}" => uuid::Uuid::new_v4().to_string(),
            _ => server.session(&image, &json!({"p": rest()})).await,
        };
        let url = server.url(&path.replace("{id}", &id));
        let is_pose = path.starts_with("/sessions/{id}/") && !path.ends_with("/handles");
        let mut fields = others(&path);
        let options = fields.to_string();
        fields["q"] = posed();
        if !is_pose {
            fields["p"] = rest();
        }
        let has_json = media_types.contains("application/json");
        let request = || server.client.request(method.clone(), &url);
        let expected = if has_json {
            request().json(&fields)
        } else {
            request().multipart(form(&image, fields.to_string()))
        };
        let expected = body(&what, expected.send().await.unwrap()).await;
        let files: &[&[(&str, &str)]] = if is_pose {
            &[&[("landmarks_q", POSED)]]
        } else {
            &[
                &[("landmarks", BOTH)],
                &[("landmarks_p", REST), ("landmarks_q", POSED)],
                &[("landmarks_q", POSED), ("landmarks_p", REST)],
            ]
        };
        for files in files {
            let base = if has_json {
                Form::new().text("warp", options.clone())
            } else {
                form(&image, options.clone())
            };
            let found = body(
                &what,
                request()
                    .multipart(with_files(base, files))
                    .send()
                    .await
                    .unwrap(),
            )
            .await;
            assert!(
                found == expected,
                "{what} {files:?}: {} {}",
                String::from_utf8_lossy(&found),
                String::from_utf8_lossy(&expected)
            );
        }
    }
}

#[tokio::test]
async fn files_are_scaled_to_the_image_of_the_request() {
    let server = Server::start(&[]).await;
    let read = async |path: &str, parts: &[(&'static str, &'static str)]| -> Value {
        let response = server
            .post(path)
            .multipart(with_files(Form::new(), parts))
            .send()
            .await
            .unwrap();
        assert_eq!(
            response.status(),
            200,
            "{parts:?}: {:?}",
            response.text().await
        );
        response.json().await.unwrap()
    };
    let expected = read(
        "/points",
        &[
            ("warp", r#"{"extent": [64, 48], "points": [[3, 4]]}"#),
            ("landmarks", "8,6,16,12\n32,24,40,24\n"),
        ],
    )
    .await;
    let warp = ("warp", r#"{"extent": [64, 48], "points": [[3, 4]]}"#);
    // Normalised; of a copy of a quarter; y up from the lower edge.
    for parts in [
        vec![
            warp,
            (
                "landmarks_p",
                r#"[{"x": 0.125, "y": 0.125}, {"x": 0.5, "y": 0.5}]"#,
            ),
            (
                "landmarks_q",
                r#"[{"x": 0.25, "y": 0.25}, {"x": 0.625, "y": 0.5}]"#,
            ),
        ],
        vec![
            warp,
            ("landmarks", "2,1.5,4,3\n8,6,10,6\n"),
            ("extent_p", "16,12"),
            ("extent_q", "16,12"),
        ],
        vec![
            warp,
            ("landmarks_p", "LM=2\n8 42\n32 24\nID=a\n"),
            ("landmarks_q", "LM=2\n16 36\n40 24\nID=a\n"),
        ],
        vec![
            (
                "warp",
                r#"{"extent": [64, 48], "points": [[3, 4]], "item": "b"}"#,
            ),
            (
                "landmarks_p",
                "LM=2\n1 1\n2 2\nID=a\nLM=2\n8 42\n32 24\nID=b\n",
            ),
            ("landmarks_q", "LM=2\n16 36\n40 24\nID=b\n"),
        ],
    ] {
        assert_eq!(read("/points", &parts).await, expected, "{parts:?}");
    }
    // A pose is in the units of its session.
    let image = photo(SIZE[0], SIZE[1]);
    let id = server
        .session(
            &image,
            &json!({"p": [[0.125, 0.125], [0.5, 0.5]], "units": "normalized"}),
        )
        .await;
    let by_json = server
        .post(&format!("/sessions/{id}/report"))
        .json(&json!({"q": [[0.25, 0.25], [0.625, 0.5]]}))
        .send()
        .await
        .unwrap();
    let by_json: Value = by_json.json().await.unwrap();
    for parts in [
        vec![("landmarks_q", "16,12\n40,24\n")],
        vec![("landmarks_q", "4,3\n10,6\n"), ("extent_q", "16,12")],
    ] {
        assert_eq!(
            read(&format!("/sessions/{id}/report"), &parts).await,
            by_json,
            "{parts:?}"
        );
    }
}

#[tokio::test]
async fn forms_that_say_too_much_or_too_little_are_refused() {
    let server = Server::start(&["--max-columns", "3"]).await;
    let id = server
        .session(&photo(SIZE[0], SIZE[1]), &json!({"p": [[1, 2]]}))
        .await;
    let (once, pose) = ("/fit".to_owned(), format!("/sessions/{id}/warp"));
    const WARP: (&str, &str) = ("warp", r#"{"extent": [64, 48]}"#);
    for (path, parts, status, code, words) in [
        (
            &once,
            vec![
                ("warp", r#"{"extent": [9, 9], "p": []}"#),
                ("landmarks", BOTH),
            ],
            413,
            "too_large",
            &["3 columns"][..],
        ),
        (
            &once,
            vec![
                ("warp", r#"{"extent": [9, 9], "p": []}"#),
                ("landmarks", "1,2,3,4\n"),
            ],
            422,
            "bad_value",
            &["both `p` and landmark files"],
        ),
        (
            &once,
            vec![("warp", r#"{"units": "px"}"#), ("landmarks", "1,2,3,4\n")],
            422,
            "bad_value",
            &["both `units` and"],
        ),
        (
            &once,
            vec![WARP, ("landmarks", "1,2\n")],
            422,
            "bad_value",
            &["no posed positions", "landmarks_q"],
        ),
        (
            &once,
            vec![("landmarks", "1,2,3,4\n")],
            422,
            "bad_value",
            &["`extent` is missing"],
        ),
        (
            &once,
            vec![WARP, ("match", "order")],
            422,
            "bad_value",
            &["`match` belongs to landmark files"],
        ),
        (
            &once,
            vec![("warp", "{"), ("landmarks", "1,2,3,4\n")],
            400,
            "malformed_request",
            &["not JSON"],
        ),
        (
            &once,
            vec![WARP, ("landmark", "1,2\n")],
            400,
            "malformed_request",
            &["did you mean `landmarks`?"],
        ),
        (
            &once,
            vec![WARP, ("image", "1,2\n")],
            400,
            "malformed_request",
            &["the parts are `warp`"],
        ),
        (
            &pose,
            vec![("landmarks", "1,2\n")],
            400,
            "malformed_request",
            &["The session has its handles at rest", "`landmarks_q`"],
        ),
        (
            &pose,
            vec![("landmarks_q", "1,2,3,4\n")],
            422,
            "bad_landmarks",
            &["landmarks_q, line 1", "found both sides"],
        ),
        (
            &pose,
            vec![("landmarks_q", "1,2\n"), ("warp", r#"{"q": []}"#)],
            422,
            "bad_value",
            &["both `q` and landmark files"],
        ),
        (
            &pose,
            vec![("landmarks_q", "1,2\n"), ("warp", r#"{"match": "order"}"#)],
            422,
            "bad_value",
            &["`match` belongs to two files"],
        ),
        (
            &pose,
            vec![("warp", "{}"), ("extent_q", "3,4")],
            422,
            "bad_value",
            &["`extent_q` belongs to landmark files"],
        ),
        (
            &pose,
            vec![("landmarks_q", "1,2\n3,4\n")],
            422,
            "shape_mismatch",
            &["1"],
        ),
        (
            &pose,
            vec![("landmarks_q", "pose.csv")],
            422,
            "bad_landmarks",
            &["-F landmarks_q=@path"],
        ),
    ] {
        let response = server
            .post(path)
            .multipart(with_files(Form::new(), &parts))
            .send()
            .await
            .unwrap();
        let document = problem(response, status, code).await;
        for word in words {
            assert!(
                document["detail"].as_str().unwrap().contains(word),
                "{parts:?}: {document}"
            );
        }
    }
    let response = server
        .post("/fit")
        .header("content-type", "text/csv")
        .body(BOTH)
        .send()
        .await
        .unwrap();
    let document = problem(response, 415, "unsupported_media_type").await;
    assert!(
        document["detail"]
            .as_str()
            .unwrap()
            .contains("landmark files"),
        "{document}"
    );
    server.is_well().await;
    assert_eq!(
        server
            .client
            .delete(server.url(&format!("/sessions/{id}")))
            .send()
            .await
            .unwrap()
            .status(),
        204
    );
    eventually("nothing is kept", || {
        server.app.budget().taken_for(MemoryClass::Upload) == 0
    })
    .await;
}
