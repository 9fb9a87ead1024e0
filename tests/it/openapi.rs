//! The OpenAPI document lists what is served, no more and no less.

use std::collections::BTreeSet;

use mlswarp_server::http::{Access, paths};
use reqwest::Method;
use serde_json::Value;

use crate::support::Server;

#[tokio::test]
async fn the_document_and_the_router_have_the_same_routes_and_methods() {
    let server = Server::start(&[]).await;
    let response = server.get("/openapi.json").send().await.unwrap();
    assert_eq!(response.headers()["content-type"], "application/json");
    let document: Value = response.json().await.unwrap();
    let described = document["paths"].as_object().unwrap();
    let served = paths(&server.app);
    assert_eq!(
        described
            .keys()
            .map(String::as_str)
            .collect::<BTreeSet<_>>(),
        served.iter().map(|(path, _)| *path).collect()
    );
    for (path, item) in described {
        let methods: BTreeSet<String> = item
            .as_object()
            .unwrap()
            .keys()
            .filter(|k| ["get", "post", "put", "delete"].contains(&k.as_str()))
            .map(|k| k.to_uppercase())
            .collect();
        let probe = path
            .replace("{id}", "00000000-0000-4000-8000-000000000000")
            .replace("{name}", "depth");
        let refused = server
            .client
            .request(Method::PATCH, server.url(&probe))
            .send()
            .await
            .unwrap();
        assert_eq!(refused.status(), 405, "{path}");
        let allowed: BTreeSet<String> = refused.headers()["allow"]
            .to_str()
            .unwrap()
            .split(',')
            .map(|m| m.trim().to_owned())
            .filter(|m| m != "HEAD")
            .collect();
        assert_eq!(allowed, methods, "{path}");
    }
}

#[tokio::test]
async fn the_document_says_which_routes_want_a_key() {
    let server = Server::start(&[]).await;
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(
        document["security"],
        serde_json::json!([{"key": []}, {}]),
        "by default: a key; nothing on a server without keys"
    );
    for (path, access) in paths(&server.app) {
        for (method, operation) in document["paths"][path]
            .as_object()
            .unwrap()
            .iter()
            .filter(|(_, item)| item["responses"].is_object())
        {
            let is_open = operation["security"].as_array().is_some_and(Vec::is_empty);
            assert_eq!(is_open, access == Access::Open, "{method} {path}");
            for status in ["401", "403", "429"] {
                assert_eq!(
                    operation["responses"][status].is_object(),
                    access == Access::Keyed,
                    "{method} {path} {status}"
                );
            }
        }
    }
}
