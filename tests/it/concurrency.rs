//! Many clients at once.

use futures_util::future::join_all;
use serde_json::{Value, json};

use crate::support::counters::Counted as _;
use crate::support::server::png;
use crate::support::{Server, photo};

fn warp(client: u32) -> Value {
    let c = f64::from(client);
    json!({"p": [[20, 20], [100, 70]], "q": [[20.0 + c / 4.0, 20], [100, 70.0 - c / 5.0]],
        "method": (["rigid", "similarity", "affine"][client as usize % 3])})
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn thirty_two_clients_get_the_right_picture_each() {
    let server = Server::start(&[]).await;
    let pictures: Vec<Vec<u8>> = (0..4).map(|n| photo(120 + n, 90)).collect();
    let picture = |client: u32| pictures[client as usize % 4].as_slice();
    let mut alone = Vec::new();
    for client in 0..32 {
        alone.push(png(server.upload("/warp", picture(client), &warp(client)).await).await);
    }
    server.app.clear_caches();
    let together = join_all((0..32).map(|client| {
        let server = &server;
        let image = picture(client);
        async move { png(server.upload("/warp", image, &warp(client)).await).await }
    }))
    .await;
    for (client, bytes) in together.iter().enumerate() {
        assert_eq!(*bytes, alone[client], "client {client}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn thirty_two_clients_drag_one_session() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(120, 90), &json!({"p": [[20, 20], [100, 70]]}))
        .await;
    server.app.clear_caches();
    let decoded = server.app.counters();
    let pose = |client: u32| json!({"q": [[20 + client, 20], [100, 70]]});
    let together = join_all((0..32).map(|client| {
        let (server, id, pose) = (&server, &id, pose(client));
        async move { png(server.drag(id, &pose).await).await }
    }))
    .await;
    let now = server.app.counters();
    assert_eq!(
        now.plans_built - decoded.plans_built,
        1,
        "one build for many waiting requests"
    );
    assert_eq!(now.images_decoded - decoded.images_decoded, 1);
    for (client, bytes) in (0..).zip(&together) {
        assert_eq!(
            png(server.drag(&id, &pose(client)).await).await,
            *bytes,
            "client {client}"
        );
    }
}
