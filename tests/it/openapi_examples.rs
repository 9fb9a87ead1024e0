//! Every example of the OpenAPI document is sent to the server, and the response is the documented
//! one. An example that nothing replays fails. (Examples of problems are compared in `problems.rs`,
//! by way of `api/problems.md`.)

use std::collections::BTreeSet;

use reqwest::multipart::Form;
use reqwest::{RequestBuilder, Response};
use serde_json::{Value, json};

use crate::support::Server;
use crate::support::server::{blend_form, form};

/// The image of all examples.
const PICTURE: &[u8] = include_bytes!("../images/rocket.jpg");
/// Members that no two responses share; the document shows their form.
const VARYING: [&str; 4] = ["id", "created", "expires", "token"];

/// A value of the document and its JSON pointer. References are followed.
#[derive(Clone)]
struct Node<'a> {
    document: &'a Value,
    pointer: String,
    value: &'a Value,
}

impl<'a> Node<'a> {
    fn at(document: &'a Value, pointer: String) -> Option<Self> {
        let value = document.pointer(&pointer)?;
        match value["$ref"].as_str() {
            Some(target) => Self::at(document, target.trim_start_matches('#').to_owned()),
            None => Some(Self {
                document,
                pointer,
                value,
            }),
        }
    }

    fn get(&self, name: &str) -> Option<Self> {
        Self::at(
            self.document,
            format!(
                "{}/{}",
                self.pointer,
                name.replace('~', "~0").replace('/', "~1")
            ),
        )
    }

    /// A chain of members.
    fn find(&self, names: &[&str]) -> Option<Self> {
        names
            .iter()
            .try_fold(self.clone(), |node, name| node.get(name))
    }

    /// The members of an object or the items of an array; empty for what is absent.
    fn members(node: Option<Self>) -> Vec<(String, Self)> {
        let Some(node) = node else { return Vec::new() };
        let names: Vec<String> = match node.value {
            Value::Object(members) => members.keys().cloned().collect(),
            Value::Array(items) => (0..items.len()).map(|n| n.to_string()).collect(),
            _ => Vec::new(),
        };
        names
            .into_iter()
            .map(|name| (name.clone(), node.get(&name).unwrap()))
            .collect()
    }

    fn validates(&self, instance: &Value) -> bool {
        let schema = json!({"$ref": format!("#{}", self.pointer),
            "components": self.document["components"], "paths": self.document["paths"]});
        jsonschema::options()
            .with_draft(jsonschema::Draft::Draft202012)
            .build(&schema)
            .unwrap()
            .is_valid(instance)
    }
}

/// The pointers of all examples, problems left out.
fn examples(value: &Value, pointer: &str, found: &mut BTreeSet<String>) {
    let Value::Object(members) = value else {
        if let Value::Array(items) = value {
            items
                .iter()
                .enumerate()
                .for_each(|(n, item)| examples(item, &format!("{pointer}/{n}"), found));
        }
        return;
    };
    for (name, member) in members {
        let at = format!("{pointer}/{}", name.replace('/', "~1"));
        match (name.as_str(), member) {
            // Members of a schema may have these names.
            _ if pointer.ends_with("/properties") => examples(member, &at, found),
            ("application/problem+json", _) => {}
            ("example", _) => drop(found.insert(at)),
            ("examples", Value::Array(items)) => {
                found.extend((0..items.len()).map(|n| format!("{at}/{n}")))
            }
            ("examples", Value::Object(items)) => {
                found.extend(
                    items
                        .iter()
                        .filter(|(_, item)| item["$ref"].is_null())
                        .map(|(name, _)| format!("{at}/{name}")),
                );
            }
            _ => examples(member, &at, found),
        }
    }
}

/// Whether a response has what the document shows, numbers to the digits that it shows.
fn same(shown: &Value, served: &Value) -> bool {
    match (shown, served) {
        (Value::Object(a), Value::Object(b)) => {
            let is_same = |name: &String| match (&a[name], b.get(name)) {
                (Value::String(a), Some(Value::String(b))) if VARYING.contains(&name.as_str()) => {
                    a.len() == b.len()
                }
                (a, Some(b)) => same(a, b),
                (_, None) => false,
            };
            a.len() == b.len() && a.keys().all(is_same)
        }
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b))
        }
        (Value::Number(a), Value::Number(b)) => {
            let text = a.to_string();
            let digits = text.split_once('.').map_or("", |(_, digits)| digits);
            let tolerance = if digits.is_empty() {
                0.0
            } else {
                digits.chars().fold(0.51, |unit, _| unit / 10.0)
            };
            (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() <= tolerance
        }
        _ => shown == served,
    }
}

#[test]
fn numbers_are_compared_to_the_digits_shown() {
    assert!(same(&json!([26.96, 4]), &json!([26.9649, 4.0])));
    for (shown, served) in [
        (json!(26.96), json!(26.97)),
        (json!(4), json!(4.1)),
        (json!({"a": 1}), json!({"a": 1, "b": 2})),
        (json!([1]), json!([])),
    ] {
        assert!(!same(&shown, &served), "{shown} {served}");
    }
}

/// A request with an example as its body.
fn with_body(request: RequestBuilder, media_type: &str, body: &Value) -> RequestBuilder {
    match media_type {
        "multipart/form-data" => {
            if let Some(blend) = body.get("blend") {
                let files = body["landmarks"].as_array().unwrap().iter();
                return request.multipart(
                    files.fold(blend_form(&[PICTURE, PICTURE], blend), |form, file| {
                        form.text("landmarks", file.as_str().unwrap().to_owned())
                    }),
                );
            }
            let is_upload = body.get("image").is_some();
            let json = |form: Form, warp: &Value| {
                if warp.is_null() {
                    form
                } else {
                    form.text("warp", warp.to_string())
                }
            };
            let base = if is_upload {
                form(PICTURE, body["warp"].to_string())
            } else {
                json(Form::new(), &body["warp"])
            };
            let texts = body
                .as_object()
                .unwrap()
                .iter()
                .filter(|(name, _)| !["image", "warp"].contains(&name.as_str()));
            request.multipart(texts.fold(base, |form, (name, text)| {
                form.text(name.clone(), text.as_str().unwrap().to_owned())
            }))
        }
        "application/json" => request.json(body),
        "application/octet-stream" => request.body(PICTURE),
        _ => panic!("no body of the type {media_type} can be made"),
    }
}

/// Marks the header examples whose headers the response has, which must be valid.
fn headers(documented: &Node<'_>, response: &Response, done: &mut BTreeSet<String>) {
    for (name, header) in Node::members(documented.get("headers")) {
        let (Some(served), Some(schema)) = (response.headers().get(&name), header.get("schema"))
        else {
            continue;
        };
        let served = served.to_str().unwrap();
        let typed = if schema.value["type"] == "string" {
            json!(served)
        } else {
            serde_json::from_str(served).unwrap_or_else(|_| json!(served))
        };
        assert!(schema.validates(&typed), "{name}: {served}");
        done.insert(format!("{}/example", header.pointer));
    }
}

/// Compares a response with the documented one. `example` names the example that was sent.
async fn compare(
    route: &str,
    operation: &Node<'_>,
    response: Response,
    example: Option<&str>,
    done: &mut BTreeSet<String>,
) -> String {
    let status = response.status().as_u16().to_string();
    let Some(documented) = operation
        .find(&["responses", &status])
        .filter(|_| status == "101" || status.starts_with('2'))
    else {
        panic!("{route} {example:?}: {status} {:?}", response.text().await);
    };
    headers(&documented, &response, done);
    let Some(content) = documented.get("content") else {
        return status;
    };
    let media_type = response.headers()["content-type"]
        .to_str()
        .unwrap()
        .split(';')
        .next()
        .unwrap()
        .to_owned();
    let body = response.bytes().await.unwrap();
    let documented = content
        .get(&media_type)
        .unwrap_or_else(|| panic!("{route}: {media_type} is not documented"));
    if media_type.starts_with("image/") {
        image::load_from_memory(&body).unwrap();
    }
    if media_type != "application/json" {
        return status;
    }
    let served: Value = serde_json::from_slice(&body).unwrap();
    assert!(
        documented.get("schema").unwrap().validates(&served),
        "{route}: {served}"
    );
    for (name, shown) in Node::members(documented.get("examples")) {
        // The response to the request of the same name, or to the only one.
        if example.is_none_or(|example| example == name) {
            assert!(
                same(&shown.value["value"], &served),
                "{route}, {name}: the document shows {}, the server answers {served}",
                shown.value["value"]
            );
            done.insert(shown.pointer);
        }
    }
    status
}

/// The requests of an operation, each sent twice to a server of its own, which has the session of
/// the examples.
async fn replay(path: &str, item: &Node<'_>, method: &str, done: &mut BTreeSet<String>) {
    let (operation, route) = (
        item.get(method).unwrap(),
        format!("{} {path}", method.to_uppercase()),
    );
    let mut filled = path.to_owned();
    for (_, parameter) in [
        Node::members(item.get("parameters")),
        Node::members(operation.get("parameters")),
    ]
    .concat()
    {
        if let Some(example) = parameter.get("example") {
            assert_eq!(
                parameter.value["in"], "path",
                "{route}: examples of other parameters are not replayed"
            );
            filled = filled.replace(
                &format!("{{{}}}", parameter.value["name"].as_str().unwrap()),
                example.value.as_str().unwrap(),
            );
            done.insert(example.pointer);
        }
    }
    assert!(
        !filled.contains('{'),
        "{route}: a parameter of the path has no example"
    );
    let mut requests = Vec::new();
    for (media_type, body) in Node::members(operation.find(&["requestBody", "content"])) {
        for (name, example) in Node::members(body.get("examples")) {
            done.insert(example.pointer);
            requests.push(Some((
                name,
                media_type.clone(),
                example.value["value"].clone(),
            )));
        }
    }
    if operation.get("requestBody").is_none() {
        requests.push(None);
    }
    assert!(!requests.is_empty(), "{route}: the body has no example");
    let mut statuses = BTreeSet::new();
    for example in requests {
        let server = if path.ends_with("/tokens") {
            Server::with_key().await
        } else {
            Server::start(&[]).await
        };
        if path.starts_with("/sessions/{id}") && (method, path) != ("put", "/sessions/{id}") {
            let id = filled.split('/').nth(2).unwrap();
            // Methods are compared on points.
            let name = if path.ends_with("/fit") {
                "landmarks"
            } else {
                "session"
            };
            let upload = format!(
                "/components/requestBodies/Upload/content/multipart~1form-data/examples/{name}/value"
            );
            let upload = Node::at(operation.document, upload);
            let request = server.client.put(server.url(&format!("/sessions/{id}")));
            let opened = with_body(request, "multipart/form-data", upload.unwrap().value)
                .send()
                .await
                .unwrap();
            assert_eq!(opened.status(), 201, "{:?}", opened.text().await);
        }
        for _ in 0..2 {
            if path.ends_with("/layers/{name}") && method != "put" {
                let stored = server
                    .client
                    .put(server.url(&filled))
                    .body(PICTURE)
                    .send()
                    .await
                    .unwrap();
                assert!(stored.status().is_success(), "{:?}", stored.text().await);
            }
            let mut request = server
                .client
                .request(method.to_uppercase().parse().unwrap(), server.url(&filled));
            if operation.find(&["responses", "101"]).is_some() {
                let upgrade = [
                    ("connection", "upgrade"),
                    ("upgrade", "websocket"),
                    ("sec-websocket-version", "13"),
                ];
                request = upgrade.iter().fold(
                    request.header("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="),
                    |r, (name, value)| r.header(*name, *value),
                );
            }
            if let Some((_, media_type, body)) = &example {
                request = with_body(request, media_type, body);
            }
            let response = request.send().await.unwrap();
            statuses.insert(
                compare(
                    &route,
                    &operation,
                    response,
                    example.as_ref().map(|(name, _, _)| name.as_str()),
                    done,
                )
                .await,
            );
        }
    }
    let documented = Node::members(operation.get("responses"))
        .into_iter()
        .map(|(status, _)| status);
    assert_eq!(
        statuses,
        documented
            .filter(|status| status == "101" || status.starts_with('2'))
            .collect(),
        "{route}"
    );
}

/// A warp object that contains an example of a schema.
fn warp_with(schema: &str, example: &Value) -> Value {
    match schema {
        "Place" | "Line" | "Handle" => json!({"p": [example], "q": [example]}),
        "Depth" => json!({"depth": example, "p": [[20, 30], [60, 60], [90, 40]],
            "q": [[20, 30], [60, 60], [30, 40]]}),
        "Grid" => json!({"p": [[120, 80]], "q": [[130, 60]], "grid": example}),
        "Outside" => json!({"output": {"outside": example}}),
        "BeierNeely" => json!({"method": "beier_neely", "beier_neely": example,
            "p": [[[40, 30], [90, 40]]], "q": [[[44, 36], [88, 30]]]}),
        "Mask" => json!({"metric": "geodesic", "mask": example, "p": [[40, 30]], "q": [[44, 36]]}),
        "Arap" => json!({"method": "arap", "arap": example,
            "p": [[40, 30], [90, 40]], "q": [[44, 36], [88, 30]]}),
        "Canvas" => json!({"output": {"canvas": example}}),
        "Output" => json!({"output": example}),
        "WarpObject" => example.clone(),
        _ => panic!("nothing replays the examples of the schema {schema}"),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_example_is_what_the_server_does() {
    let server = Server::start(&[]).await;
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let root = Node::at(&document, String::new()).unwrap();
    let mut done = BTreeSet::new();
    for (path, item) in Node::members(root.get("paths")) {
        for (method, _) in Node::members(Some(item.clone()))
            .into_iter()
            .filter(|(_, operation)| !operation.value["responses"].is_null())
        {
            replay(&path, &item, &method, &mut done).await;
        }
    }
    for (name, schema) in Node::members(root.find(&["components", "schemas"])) {
        for (_, example) in Node::members(schema.get("examples")) {
            let response = server
                .upload("/warp", PICTURE, &warp_with(&name, example.value))
                .await;
            assert_eq!(
                response.status(),
                200,
                "{}: {:?}",
                example.pointer,
                response.text().await
            );
            done.insert(example.pointer);
        }
    }
    // Headers that no example has asked for.
    let warped = root
        .find(&["paths", "/warp", "post", "responses", "200"])
        .unwrap();
    let close = json!({"p": [[120, 80], [120.000_1, 80]], "q": [[130, 60], [130, 60]]});
    headers(
        &warped,
        &server.upload("/warp?session=true", PICTURE, &close).await,
        &mut done,
    );
    let hasty = Server::start(&["--rate-per-address", "1"]).await;
    let mut answers = Vec::new();
    for _ in 0..100 {
        answers.push(hasty.post("/points").send().await.unwrap());
    }
    let refused = answers
        .iter()
        .find(|answer| answer.status() == 429)
        .expect("a rate of 1 per second is exceeded");
    headers(
        &root
            .find(&["paths", "/points", "post", "responses", "429"])
            .unwrap(),
        refused,
        &mut done,
    );

    let mut all = BTreeSet::new();
    examples(&document, "", &mut all);
    assert!(all.len() > 30, "{all:?}");
    assert_eq!(
        all.difference(&done).collect::<Vec<_>>(),
        Vec::<&String>::new(),
        "nothing replays these examples"
    );
}
