//! Whoever refuses (a route, a layer, the framework), the answer is a whole problem document. Only what is not HTTP at all (a head that
//! cannot be parsed or is too long) is answered by the HTTP library, without a body.

use reqwest::Method;
use serde_json::json;

use crate::support::server::{form, header, png, problem};
use crate::support::{Server, photo};

#[tokio::test]
async fn unknown_routes_and_methods() {
    let server = Server::start(&[]).await;
    problem(server.get("/nothing").send().await.unwrap(), 404, "not_found").await;
    problem(server.get("/sessions/x/y/z").send().await.unwrap(), 404, "not_found").await;
    for (method, path, allow) in
        [(Method::GET, "/warp", "POST"), (Method::POST, "/healthz", "GET,HEAD"), (Method::PATCH, "/sessions/x", "GET,HEAD,PUT,DELETE")]
    {
        let response = server.client.request(method, server.url(path)).send().await.unwrap();
        let mut named: Vec<_> = header(&response, "allow").split(',').map(str::trim).collect();
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
        problem(server.post(path).body("hello").send().await.unwrap(), 415, "unsupported_media_type").await;
        problem(server.post(path).header("content-type", "text/plain").body("hello").send().await.unwrap(), 415, "unsupported_media_type")
            .await;
    }
    problem(server.post("/sessions").json(&json!({"p": []})).send().await.unwrap(), 415, "unsupported_media_type").await;
    let id = server.session(&photo(16, 12), &json!({"p": [[2, 2]]})).await;
    let text = server.post(&format!("/sessions/{id}/warp")).body("{}").send().await.unwrap();
    problem(text, 415, "unsupported_media_type").await;
    let with_parameter = server.post("/warp").header("content-type", "Application/JSON; charset=utf-8");
    let body = json!({"session": id, "q": [[3, 2]]}).to_string();
    png(with_parameter.body(body).send().await.unwrap()).await;
}

#[tokio::test]
async fn accept_is_negotiated() {
    let server = Server::start(&[]).await;
    let send = |accept: &'static str| {
        let warp = json!({"p": [[2, 2]], "q": [[3, 2]]}).to_string();
        server.post("/warp").header("accept", accept).multipart(form(&photo(16, 12), warp)).send()
    };
    for accept in ["image/png", "image/*", "*/*", "text/html, image/*;q=0.5"] {
        png(send(accept).await.unwrap()).await;
    }
    problem(send("image/avif").await.unwrap(), 406, "not_acceptable").await;
    server.is_well().await;
}

#[tokio::test]
async fn a_sane_request_id_comes_back() {
    let server = Server::start(&[]).await;
    let response = server.get("/healthz").header("x-request-id", "trace-17").send().await.unwrap();
    assert_eq!(header(&response, "x-request-id"), "trace-17");
    let response = server.get("/nothing").header("x-request-id", "no good").send().await.unwrap();
    assert_ne!(header(&response, "x-request-id"), "no good");
    problem(response, 404, "not_found").await;
}

#[tokio::test]
async fn a_query_that_is_not_known_is_refused() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[2, 2]], "q": [[3, 2]]});
    problem(server.upload("/warp?session=maybe", &photo(16, 12), &warp).await, 422, "bad_value").await;
    problem(server.upload("/warp?sesion=true", &photo(16, 12), &warp).await, 422, "unknown_field").await;
}

#[tokio::test]
async fn a_request_that_takes_too_long_is_told_so() {
    let server = Server::start(&["--request-timeout", "1ms", "--workers", "1"]).await;
    let response = server.upload("/sessions", &photo(900, 900), &json!({"p": [[2, 2]], "grid": "pixel"})).await;
    problem(response, 408, "timeout").await;
}
