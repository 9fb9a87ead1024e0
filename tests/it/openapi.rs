//! The OpenAPI document lists what is served, no more and no less.

use std::collections::BTreeSet;

use mlswarp::service::http::paths;
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
    assert_eq!(described.keys().map(String::as_str).collect::<BTreeSet<_>>(), served.iter().copied().collect());
    for (path, item) in described {
        let methods: BTreeSet<String> = item
            .as_object()
            .unwrap()
            .keys()
            .filter(|k| ["get", "post", "put", "delete"].contains(&k.as_str()))
            .map(|k| k.to_uppercase())
            .collect();
        let probe = path.replace("{id}", "00000000-0000-4000-8000-000000000000");
        let refused = server.client.request(Method::PATCH, server.url(&probe)).send().await.unwrap();
        assert_eq!(refused.status(), 405, "{path}");
        let allowed: BTreeSet<String> =
            refused.headers()["allow"].to_str().unwrap().split(',').map(|m| m.trim().to_owned()).filter(|m| m != "HEAD").collect();
        assert_eq!(allowed, methods, "{path}");
    }
}
