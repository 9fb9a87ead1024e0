//! Every error is a whole problem document, whether a route, a layer or the framework rejects the
//! request. Only heads that the HTTP library rejects are answered by the library, without a body.

use std::cell::RefCell;
use std::collections::BTreeSet;

use reqwest::multipart::Form;
use reqwest::{Method, RequestBuilder};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::support::server::{form, header, png, problem};
use crate::support::{Server, photo};

#[tokio::test]
async fn unknown_routes_and_methods() {
    let server = Server::start(&[]).await;
    problem(
        server.get("/nothing").send().await.unwrap(),
        404,
        "not_found",
    )
    .await;
    problem(
        server.get("/sessions/x/y/z").send().await.unwrap(),
        404,
        "not_found",
    )
    .await;
    for (method, path, allow) in [
        (Method::GET, "/warp", "POST"),
        (Method::POST, "/healthz", "GET,HEAD"),
        (Method::PATCH, "/sessions/x", "GET,HEAD,PUT,DELETE"),
    ] {
        let response = server
            .client
            .request(method, server.url(path))
            .send()
            .await
            .unwrap();
        let mut named: Vec<_> = header(&response, "allow")
            .split(',')
            .map(str::trim)
            .collect();
        let mut expected: Vec<_> = allow.split(',').collect();
        named.sort_unstable();
        expected.sort_unstable();
        assert_eq!(named, expected, "{path}");
        problem(response, 405, "method_not_allowed").await;
    }
}

#[tokio::test]
async fn media_types() {
    let server = Server::start(&[]).await;
    for path in ["/warp", "/sessions", "/points"] {
        problem(
            server.post(path).body("hello").send().await.unwrap(),
            415,
            "unsupported_media_type",
        )
        .await;
        problem(
            server
                .post(path)
                .header("content-type", "text/plain")
                .body("hello")
                .send()
                .await
                .unwrap(),
            415,
            "unsupported_media_type",
        )
        .await;
    }
    problem(
        server
            .post("/sessions")
            .json(&json!({"p": []}))
            .send()
            .await
            .unwrap(),
        415,
        "unsupported_media_type",
    )
    .await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let text = server
        .post(&format!("/sessions/{id}/warp"))
        .body("{}")
        .send()
        .await
        .unwrap();
    problem(text, 415, "unsupported_media_type").await;
    let with_parameter = server
        .post(&format!("/sessions/{id}/warp"))
        .header("content-type", "Application/JSON; charset=utf-8");
    png(with_parameter
        .body(r#"{"q": [[3, 2]]}"#)
        .send()
        .await
        .unwrap())
    .await;
}

#[tokio::test]
async fn accept_is_negotiated() {
    let server = Server::start(&[]).await;
    let send = |accept: &'static str| {
        let warp = json!({"p": [[2, 2]], "q": [[3, 2]]}).to_string();
        server
            .post("/warp")
            .header("accept", accept)
            .multipart(form(&photo(16, 12), warp))
            .send()
    };
    for accept in [
        "image/png",
        "image/*",
        "*/*",
        "text/html, image/*;q=0.5",
        "",
        " , ",
        "image/png;q=3",
    ] {
        png(send(accept).await.unwrap()).await;
    }
    for accept in ["image/avif", "image/png;q=-1"] {
        problem(send(accept).await.unwrap(), 406, "not_acceptable").await;
    }
    server.is_well().await;
}

#[tokio::test]
async fn a_sane_request_id_comes_back() {
    let server = Server::start(&[]).await;
    let response = server
        .get("/healthz")
        .header("x-request-id", "trace-17")
        .send()
        .await
        .unwrap();
    assert_eq!(header(&response, "x-request-id"), "trace-17");
    let response = server
        .get("/nothing")
        .header("x-request-id", "no good")
        .send()
        .await
        .unwrap();
    assert_ne!(header(&response, "x-request-id"), "no good");
    problem(response, 404, "not_found").await;
}

#[tokio::test]
async fn a_query_that_is_not_known_is_refused() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[2, 2]], "q": [[3, 2]]});
    problem(
        server
            .upload("/warp?session=maybe", &photo(16, 12), &warp)
            .await,
        422,
        "bad_value",
    )
    .await;
    problem(
        server
            .upload("/warp?sesion=true", &photo(16, 12), &warp)
            .await,
        422,
        "unknown_field",
    )
    .await;
}

/// The page that the `type` of a problem leads to, in the form that is asked for.
#[tokio::test]
async fn the_type_of_a_problem_is_a_page() {
    let server = Server::start(&["--keys", "ann 0123456789abcdef"]).await;
    let ask = async |path: &str, accept: &str| {
        server
            .get(path)
            .header("accept", accept)
            .send()
            .await
            .unwrap()
    };
    let codes = PAGE.lines().filter_map(|line| line.strip_prefix("## "));
    let mut seen = 0;
    for code in codes {
        let document = shown(code);
        let path = document["type"].as_str().unwrap();
        for accept in ["*/*", "text/html,application/xhtml+xml,*/*;q=0.8"] {
            let page = ask(path, accept).await;
            assert_eq!(
                (page.status().as_u16(), header(&page, "content-type")),
                (200, "text/html; charset=utf-8"),
                "{path}"
            );
            assert!(header(&page, "content-security-policy").starts_with("default-src 'none'"));
            assert!(
                page.headers().contains_key("etag") && header(&page, "vary").contains("accept")
            );
            let text = page.text().await.unwrap();
            assert!(
                text.contains(&format!("<h1>{}</h1>", document["title"].as_str().unwrap())),
                "{text}"
            );
        }
        for accept in ["application/json", "application/problem+json"] {
            let section = ask(path, accept).await;
            assert_eq!(
                (section.status().as_u16(), header(&section, "content-type")),
                (200, accept),
                "{path}"
            );
            let section: Value = section.json().await.unwrap();
            assert_eq!(section["example"], document, "{section}");
            for field in ["type", "title", "status", "code"] {
                assert_eq!(section[field], document[field], "{section}");
            }
        }
        seen += 1;
    }
    assert!(seen > 20, "{seen}");
    problem(ask("/problems/no_such_code", "*/*").await, 404, "not_found").await;
    problem(
        ask("/problems/timeout", "image/png").await,
        406,
        "not_acceptable",
    )
    .await;
}

/// 408 is for a client that is slow; a server that is slow says so, and when to come again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_that_takes_too_long_says_whose_fault_it_is() {
    let server = Server::start(&["--request-timeout", "1s", "--body-timeout", "20s"]).await;
    // Hundreds of thousands of places, each weighed against thousands of handles.
    let p: Vec<[u32; 2]> = (0..9000).map(|n| [n % 450, n / 450 * 15]).collect();
    let q: Vec<[u32; 2]> = p.iter().map(|[x, y]| [x + y % 7, y + x % 5]).collect();
    let response = server
        .upload(
            "/warp",
            &photo(450, 300),
            &json!({"p": p, "q": q, "grid": "pixel"}),
        )
        .await;
    assert_eq!(header(&response, "retry-after"), "1");
    let document = problem(response, 503, "overloaded").await;
    assert!(
        document["detail"]
            .as_str()
            .unwrap()
            .contains("the server did not finish within 1 s"),
        "{document}"
    );
    // The same time, while the client still sends.
    let slowly = futures_util::stream::unfold(0, |n| async move {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        (n < 500).then_some((Ok::<_, std::io::Error>(" "), n + 1))
    });
    let request = server
        .post("/points")
        .header("content-type", "application/json");
    let response = request
        .body(reqwest::Body::wrap_stream(slowly))
        .send()
        .await
        .unwrap();
    assert!(response.headers().get("retry-after").is_none());
    let document = problem(response, 408, "timeout").await;
    assert!(
        document["detail"]
            .as_str()
            .unwrap()
            .contains("the body was not complete after 1 s"),
        "{document}"
    );
}

const PAGE: &str = include_str!("../../api/problems.md");
const CONTRACT: &str = include_str!("../../api/openapi.json");

/// The document that `api/problems.md` shows under a code.
fn shown(code: &str) -> Value {
    let section = PAGE
        .split("\n## ")
        .find(|section| section.lines().next() == Some(code))
        .expect(code);
    let example = section
        .split("```json")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .expect(code);
    serde_json::from_str(example).unwrap()
}

/// Codes that take a fault or the passing of time to see.
const LEFT_OUT: [&str; 6] = [
    "internal",
    "overloaded",
    "session_expired",
    "stored_by_another_version",
    "timeout",
    "unavailable",
];

/// What the service says is what the page shows, word for word.
#[tokio::test]
async fn the_page_shows_what_is_said() {
    async fn said(request: RequestBuilder) -> Value {
        let mut document: Value = request.send().await.unwrap().json().await.unwrap();
        document.as_object_mut().unwrap().remove("request_id");
        document
    }
    let compared = RefCell::new(BTreeSet::from(LEFT_OUT));
    let same = async |code: &'static str, request: RequestBuilder| {
        compared.borrow_mut().insert(code);
        let (mut said, shown) = (said(request).await, shown(code));
        // 9.0 is 9.
        if let (Some(a), Some(b)) = (said["actual"].as_f64(), shown["actual"].as_f64())
            && a.total_cmp(&b).is_eq()
        {
            said["actual"] = shown["actual"].clone();
        }
        assert_eq!(said, shown, "{code}");
    };
    let server = Server::start(&[]).await;
    let image = photo(16, 12);
    same(
        "malformed_request",
        server
            .post("/points")
            .header("content-type", "application/json")
            .body(r#"{"p": [NaN]}"#),
    )
    .await;
    same("not_found", server.get("/wrap")).await;
    let without_image = json!({"extent": [16, 12], "p": [[1, 1]], "q": [[2, 1]], "points": [[3, 3]],
        "method": "arap"});
    same("not_supported", server.post("/points").json(&without_image)).await;
    same(
        "no_such_session",
        server.get("/sessions/0f8fad5b-d9cb-469f-a165-70867728950e"),
    )
    .await;
    same("method_not_allowed", server.get("/warp")).await;
    same(
        "not_acceptable",
        server
            .post("/warp")
            .header("accept", "image/avif")
            .multipart(form(&image, "{}")),
    )
    .await;
    same(
        "unsupported_media_type",
        server
            .post("/warp")
            .json(&json!({"p": [[1, 1]], "q": [[1, 1]]})),
    )
    .await;
    same(
        "unsupported_format",
        server
            .post("/warp")
            .multipart(form(b"\0\0\0\x18ftypheic\0\0\0\0", "{}")),
    )
    .await;
    same(
        "bad_image",
        server
            .post("/warp")
            .multipart(form(&image[..image.len() / 2], "{}")),
    )
    .await;
    let files = Form::new()
        .text("landmarks_p", "x,y\n1,2\n168,112\n")
        .text("landmarks_q", "x,y\n1,2\n150,1O4\n");
    same("bad_landmarks", server.post("/landmarks").multipart(files)).await;

    let points = |n: usize| -> Vec<Value> { (0..n).map(|k| json!([10 * k, 5 * k * k])).collect() };
    let with = |handles: &[Value], k: usize, handle: Value| -> Vec<Value> {
        handles
            .iter()
            .enumerate()
            .map(|(i, old)| if i == k { handle.clone() } else { old.clone() })
            .collect()
    };
    let (six, line) = (points(6), json!([[120, 80], [150, 90]]));
    let meeting = with(&with(&six, 2, json!([120, 80])), 5, json!([120, 80]));
    let apart = with(&with(&six, 2, json!([130, 60])), 5, json!([144, 60]));
    let cases = [
        ("too_large", json!({"output": {"width": 20_000}})),
        ("unknown_field", json!({"grid": {"cells": 5}})),
        ("bad_value", json!({"p": with(&six, 3, json!([1]))})),
        (
            "shape_mismatch",
            json!({"p": with(&six, 1, line), "q": six}),
        ),
        (
            "contradictory_handles",
            json!({"p": meeting, "q": apart, "coincident": {"policy": "reject"}}),
        ),
        (
            "degenerate_line",
            json!({"p": with(&six, 4, json!([[1, 2], [1, 2]])), "q": six}),
        ),
        (
            "alpha_out_of_range",
            json!({"p": six, "q": six, "alpha": 9}),
        ),
        (
            "unreachable",
            json!({"p": [[[1, 1], [15, 1]], [[1, 9], [15, 9]]],
                "q": [[[1, 1], [15, 9]], [[1, 9], [15, 1]]], "folds": "remove"}),
        ),
        (
            "nothing_visible",
            json!({"p": [[2, 6], [14, 6]], "q": [[5, 5], [5, 5]], "method": "similarity",
                "output": {"canvas": "fit"}}),
        ),
    ];
    for (code, warp) in cases {
        same(
            code,
            server
                .post("/warp")
                .multipart(form(&image, warp.to_string())),
        )
        .await;
    }
    let beyond =
        r#"{"p": [[1, 1], [2, 2], [3, 3], [4, 4]], "q": [[1, 1], [2, 2], [3, 3], [1e999, 4]]}"#;
    same(
        "not_finite",
        server.post("/warp").multipart(form(&image, beyond)),
    )
    .await;
    let folds =
        json!({"p": [[4, 6], [8, 6], [12, 6]], "q": [[4, 6], [12, 6], [8, 6]], "folds": "reject"});
    let mut folded = said(
        server
            .post("/warp")
            .multipart(form(&image, folds.to_string())),
    )
    .await;
    let cells = std::mem::replace(&mut folded["actual"], json!(12));
    folded["detail"] = folded["detail"]
        .as_str()
        .unwrap()
        .replace(&cells.to_string(), "12")
        .into();
    assert_eq!(folded, shown("folded"));
    compared.borrow_mut().insert("folded");

    let id = server.session(&image, &json!({"p": [[2, 2]]})).await;
    same(
        "no_such_layer",
        server.get(&format!("/sessions/{id}/layers/depth")),
    )
    .await;
    let pose = |seq: u32| {
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": [[3, 2]], "seq": seq}))
    };
    png(pose(42).send().await.unwrap()).await;
    same("superseded", pose(41)).await;
    let spline: Vec<[f64; 2]> = (0..65)
        .map(|k| [f64::from(k % 9), f64::from(k / 9)])
        .collect();
    let spline = server
        .session(&image, &json!({"p": spline, "method": "tps"}))
        .await;
    // What is visible ends 6 px before the third handle.
    let half: Vec<u8> = (0..16 * 12)
        .flat_map(|k| [90, if k % 16 < 8 { 255 } else { 0 }])
        .collect();
    let half = crate::support::picture::png(16, 12, png::ColorType::GrayscaleAlpha, &half);
    let inside = |image: &[u8], mask: Value| {
        let warp = json!({"p": [[2, 2], [3, 8], [14, 5]], "q": [[2, 2], [3, 8], [14, 5]],
            "metric": "geodesic", "mask": mask});
        server
            .post("/warp")
            .multipart(form(image, warp.to_string()))
    };
    same("outside_mask", inside(&half, json!({}))).await;
    same("empty_mask", inside(&half, json!({"threshold": 1}))).await;
    let fine = json!({"p": [[100, 100]], "q": [[120, 100]], "method": "arap", "arap": {"cell": 2}});
    let fine = form(&photo(520, 520), fine.to_string());
    same("too_many_vertices", server.post("/warp").multipart(fine)).await;
    same("no_table", server.get(&format!("/sessions/{spline}/plan"))).await;
    same(
        "misdirected",
        server.get("/sessions/x").header("host", "evil.example"),
    )
    .await;
    same(
        "upgrade_required",
        server.get(&format!("/sessions/{id}/drag")),
    )
    .await;

    let server = Server::start(&["--keys", "ann 0123456789abcdef"]).await;
    same("unauthorized", server.post("/points")).await;
    same(
        "forbidden",
        server
            .post("/points")
            .header("authorization", "Bearer fedcba9876543210"),
    )
    .await;
    let keyed = "0123456789abcdef";
    let tokens = format!("/sessions/{}/tokens", uuid::Uuid::new_v4());
    let minted = server.post(&tokens).bearer_auth(keyed);
    let minted = minted.json(&json!({"ops": ["upload"]})).send().await;
    let minted: Value = minted.unwrap().json().await.unwrap();
    let hour = std::time::Duration::from_secs(3600);
    server.app.access().clock().advance(hour);
    let expired = minted["token"].as_str().unwrap();
    same("token_expired", server.post("/points").bearer_auth(expired)).await;
    let server = Server::start(&["--rate-per-address", "1"]).await;
    for _ in 0..100 {
        let said = said(server.get("/sessions/x")).await;
        if said["code"] == "rate_limited" {
            assert_eq!(said, shown("rate_limited"));
            compared.borrow_mut().insert("rate_limited");
            let codes: BTreeSet<&str> = PAGE
                .lines()
                .filter_map(|line| line.strip_prefix("## "))
                .collect();
            assert_eq!(
                compared.into_inner(),
                codes,
                "every code is compared or left out for a reason"
            );
            return;
        }
    }
    panic!("nobody is told to go on more slowly");
}

#[test]
fn the_contract_shows_the_documents_of_the_page() {
    fn look(value: &Value, seen: &mut usize) {
        if let Some(code) = value["code"].as_str().filter(|_| {
            value["type"]
                .as_str()
                .is_some_and(|of| of.starts_with("/problems/"))
        }) {
            assert_eq!(*value, shown(code));
            *seen += 1;
        }
        match value {
            Value::Object(fields) => fields.values().for_each(|value| look(value, seen)),
            Value::Array(items) => items.iter().for_each(|value| look(value, seen)),
            _ => {}
        }
    }
    let mut seen = 0;
    look(&serde_json::from_str(CONTRACT).unwrap(), &mut seen);
    assert!(seen > 20, "{seen}");
}

/// The limits of a head: 64 KiB and 100 fields.
#[tokio::test]
async fn heads_that_the_http_library_rejects_have_no_problem() {
    let server = Server::start(&[]).await;
    let fields = |count: usize| {
        (0..count)
            .map(|n| format!("X-{n}: 1\r\n"))
            .collect::<String>()
    };
    let get = |fields: &str| {
        format!("GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{fields}\r\n")
    };
    for (head, status) in [
        (get(&fields(97)), 200),
        (get(&fields(99)), 431),
        (get(&format!("X: {}\r\n", "x".repeat(60_000))), 200),
        (get(&format!("X: {}\r\n", "x".repeat(300_000))), 431),
        ("no head at all\r\n\r\n".to_owned(), 400),
    ] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        // The server may close the connection before it has read everything, which may lose its
        // answer.
        let sent = stream.write_all(head.as_bytes()).await;
        let mut answer = Vec::new();
        let read = stream.read_to_end(&mut answer).await;
        let answer = String::from_utf8(answer).unwrap();
        let is_lost = answer.is_empty() && head.len() > 200_000 && (sent.is_err() || read.is_err());
        assert!(
            is_lost || answer.starts_with(&format!("HTTP/1.1 {status} ")),
            "{answer}"
        );
        assert!(
            status == 200 || is_lost || answer.ends_with("\r\n\r\n"),
            "{answer}"
        );
    }
    server.is_well().await;
}
