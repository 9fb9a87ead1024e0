//! `--public-path`: every path in a response is the one at which a proxy that removes the prefix
//! publishes the service.

use reqwest::Response;
use serde_json::{Value, json};

use crate::support::server::{form, header};
use crate::support::{DragClient, Server, photo};

const PREFIX: &str = "/tools/warp";
const ID: &str = "5d1f0f0e-9e0b-4c84-a4d5-0d6d3b8f4f11";

/// The path without the prefix, as the proxy forwards it.
fn forwarded(public: &str) -> &str {
    public
        .strip_prefix(PREFIX)
        .unwrap_or_else(|| panic!("{public} does not start with {PREFIX}"))
}

/// Follows the problem type of a document, which must be that of its code.
async fn follow(server: &Server, document: &Value) {
    let code = document["code"].as_str().unwrap();
    let link = document["type"].as_str().unwrap();
    assert_eq!(forwarded(link), format!("/problems/{code}"));
    let page = server.get(forwarded(link)).send().await.unwrap();
    assert_eq!(page.status(), 200, "{link}");
    let text = page.text().await.unwrap();
    assert!(
        text.contains(&format!("\"type\": \"{PREFIX}/problems/{code}\""))
            && !text.contains("\"/problems/"),
        "{text}"
    );
    let section: Value = server
        .get(forwarded(link))
        .header("accept", "application/json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(
        [&section["type"], &section["example"]["type"]],
        [link, link]
    );
}

#[tokio::test]
async fn locations_problem_types_and_servers_start_with_it() {
    // The server accepts a slash at the end.
    let server = Server::start(&["--public-path", "/tools/warp/"]).await;
    let (image, warp) = (photo(16, 12), json!({"p": [[2, 2]], "q": [[3, 2]]}));
    let put = server
        .client
        .put(server.url(&format!("/sessions/{ID}")))
        .multipart(form(&image, warp.to_string()));
    for created in [
        server.upload("/sessions", &image, &warp).await,
        server.upload("/warp?session=true", &image, &warp).await,
        put.send().await.unwrap(),
    ] {
        let location = header(&created, "location");
        let read: Response = server.get(forwarded(location)).send().await.unwrap();
        assert_eq!(read.status(), 200, "{location}");
        assert!(
            location.ends_with(read.json::<Value>().await.unwrap()["id"].as_str().unwrap()),
            "{location}"
        );
    }
    follow(
        &server,
        &server
            .get("/nothing")
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap(),
    )
    .await;
    let mut drag = DragClient::open(server.address, ID, "").await;
    drag.pose(1, &json!([[3, 2], [4, 4]])).await;
    follow(&server, &drag.text().await).await;
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(document["servers"], json!([{"url": PREFIX}]));
    for (path, expected) in [
        (
            "/v1/warp",
            "; did you mean POST /tools/warp/warp? See /tools/warp/docs",
        ),
        ("/nothing", "; see /tools/warp/docs"),
        (
            "/tools/warp/warp",
            "; the proxy must remove /tools/warp from the path before it forwards a request. See \
                /tools/warp/docs",
        ),
        ("/tools/warp", "; the proxy must remove /tools/warp from"),
        ("/tools/warped", "; see /tools/warp/docs"),
    ] {
        let document: Value = server.get(path).send().await.unwrap().json().await.unwrap();
        let detail = document["detail"].as_str().unwrap();
        assert!(detail.contains(expected), "{path}: {document}");
    }
    let first = server.get("/openapi.json").send().await.unwrap();
    let again = server
        .get("/openapi.json")
        .header("if-none-match", header(&first, "etag"))
        .send()
        .await
        .unwrap();
    assert_eq!(again.status(), 304);
}

#[tokio::test]
async fn without_it_paths_are_those_of_the_contract() {
    let server = Server::start(&[]).await;
    let created = server
        .upload("/sessions", &photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    assert!(header(&created, "location").starts_with("/sessions/"));
    let document: Value = server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(document["servers"], json!([{"url": "/"}]));
}
