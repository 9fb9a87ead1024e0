//! `depth` on the routes: in sessions, sockets, batches and files, and what refuses it.

use std::io::{Cursor, Read as _};

use serde_json::{Value, json};

use crate::support::drag_client::Received;
use crate::support::server::{header, png, problem};
use crate::support::{DragClient, Server, photo};

/// The middle is dragged over the right half.
fn folded() -> Value {
    json!({
        "p": [[20, 20], [140, 30], [130, 100], [25, 95], [80, 60]],
        "q": [[20, 20], [140, 30], [130, 100], [25, 95], [150, 70]]
    })
}

fn with(mut warp: Value, field: &str, value: Value) -> Value {
    warp[field] = value;
    warp
}

const FRONT: [f64; 5] = [0.0, 0.0, 0.0, 0.0, 1.0];

#[tokio::test]
async fn depth_is_the_same_on_every_way_to_a_picture() {
    let server = Server::start(&[]).await;
    let image = photo(160, 120);
    let front = with(folded(), "depth", json!(FRONT));
    let expected = png(server.upload("/warp", &image, &front).await).await;
    let without = png(server.upload("/warp", &image, &folded()).await).await;
    assert_ne!(expected, without);
    // Equal depths are none, to the byte and in the ETag.
    let plain = server.upload("/warp", &image, &folded()).await;
    let equal = with(folded(), "depth", json!([3, 3, 3, 3, 3]));
    let equal = server.upload("/warp", &image, &equal).await;
    assert_eq!(header(&plain, "etag"), header(&equal, "etag"));
    assert_eq!(png(equal).await, without);

    let id = server.session(&image, &front).await;
    assert_eq!(png(server.drag(&id, &json!({})).await).await, expected);
    let url = server.url(&format!("/sessions/{id}"));
    let read = async || {
        server
            .client
            .get(&url)
            .send()
            .await
            .unwrap()
            .json::<Value>()
            .await
            .unwrap()
    };
    let told = read().await;
    assert_eq!(told["depth"], json!(FRONT));
    // A batch, and a socket.
    let batch = server.post(&format!("/sessions/{id}/batch"));
    let batch = batch.json(&json!({"frames": [{"q": folded()["q"]}]}));
    let archive = batch.send().await.unwrap().bytes().await.unwrap();
    let mut archive = zip::ZipArchive::new(Cursor::new(archive)).unwrap();
    let mut frame = Vec::new();
    archive
        .by_index(0)
        .unwrap()
        .read_to_end(&mut frame)
        .unwrap();
    assert_eq!(frame, expected);
    let mut socket = DragClient::open(server.address, &id, "?frames=png").await;
    socket.pose(1, &folded()["q"]).await;
    // A preview may come first.
    while !matches!(socket.next().await, Received::Frame(1, frame) if frame == expected) {}

    // Other depths keep the handles and their coefficients; none are the default.
    let put = async |body: Value| {
        let url = server.url(&format!("/sessions/{id}/handles"));
        let response = server.client.put(url).json(&body).send().await.unwrap();
        assert!(response.status().is_success(), "{body}");
        response.json::<Value>().await.unwrap()
    };
    let behind = put(json!({"depth": [0, 0, 0, 0, -1]})).await;
    assert_eq!(behind["rest_revision"], told["rest_revision"]);
    let drawn = png(server.drag(&id, &json!({})).await).await;
    let stateless = with(folded(), "depth", json!([0.0, 0.0, 0.0, 0.0, -1.0]));
    assert_eq!(
        drawn,
        png(server.upload("/warp", &image, &stateless).await).await
    );
    assert_ne!(drawn, expected);
    assert_eq!(
        put(json!({"method": "affine"})).await["depth"],
        json!([0.0, 0.0, 0.0, 0.0, -1.0])
    );
    assert_eq!(
        put(json!({"depth": [0, 0, 0, 0, 0]})).await["depth"],
        Value::Null
    );
    put(json!({"depth": FRONT, "method": "rigid"})).await;
    assert_eq!(put(json!({"p": folded()["p"]})).await["depth"], Value::Null);
}

#[tokio::test]
async fn depth_that_is_wrong_is_refused_where_it_stands() {
    let server = Server::start(&[]).await;
    let image = photo(160, 120);
    for (depth, code, pointer) in [
        (json!([0, 1]), "shape_mismatch", "/depth"),
        (json!([0, 0]), "shape_mismatch", "/depth"),
        (json!([0, 0, 0, 0, 0, 0]), "shape_mismatch", "/depth"),
        (json!([]), "shape_mismatch", "/depth"),
        (json!([0, 1e300, 0, 0, 0]), "bad_value", "/depth/1"),
        (json!([0, -1000.5, 0, 0, 0]), "bad_value", "/depth/1"),
        (json!([0, "1", 0, 0, 0]), "bad_value", "/depth/1"),
        (json!([0, null, 0, 0, 0]), "bad_value", "/depth/1"),
        (json!(1), "bad_value", "/depth"),
    ] {
        let warp = with(folded(), "depth", depth.clone());
        let said = problem(server.upload("/warp", &image, &warp).await, 422, code).await;
        assert_eq!(said["pointer"], pointer, "{depth}");
    }
}
