//! More requests than places: refused at once, with a time to come back; health is told the truth and is never refused.

use std::sync::mpsc;
use std::time::Duration;

use serde_json::json;

use crate::support::server::{header, png, problem};
use crate::support::{Server, eventually, photo};

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_full_queue_refuses_at_once_and_recovers() {
    let server = Server::start(&["--workers", "1", "--queue", "1"]).await;
    let id = server.session(&photo(16, 12), &json!({"p": [[2, 2]]})).await;
    let path = format!("/sessions/{id}/warp");
    eventually("nothing runs", || server.app.pool().running() == 0).await;
    let busy = server.app.pool().admit().await.unwrap();
    let send = |seq: u64| server.post(&path).json(&json!({"q": [[3, 2]], "seq": seq})).send();
    let waiting = tokio::spawn(send(1));
    eventually("the queue is full", || server.app.pool().is_full()).await;
    for path in ["/warp", "/sessions", "/points", path.as_str()] {
        let refused = server.post(path).json(&json!({})).send().await.unwrap();
        assert!(header(&refused, "retry-after").parse::<u32>().unwrap() >= 1);
        problem(refused, 503, "overloaded").await;
    }
    problem(server.get("/readyz").send().await.unwrap(), 503, "overloaded").await;
    assert_eq!(server.get("/healthz").send().await.unwrap().status(), 200);
    assert_eq!(server.get("/openapi.json").send().await.unwrap().status(), 200);
    assert_eq!(server.get(&format!("/sessions/{id}")).send().await.unwrap().status(), 200);
    drop(busy);
    png(waiting.await.unwrap().unwrap()).await;
    server.is_well().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_request_that_waits_is_superseded_without_its_turn() {
    let server = Server::start(&["--workers", "1", "--queue", "8"]).await;
    let id = server.session(&photo(16, 12), &json!({"p": [[2, 2]]})).await;
    let send = |seq: u64| tokio::spawn(server.post(&format!("/sessions/{id}/warp")).json(&json!({"q": [[3, 2]], "seq": seq})).send());
    let ticket = server.app.pool().admit().await.unwrap();
    let old = send(1);
    let seen = |seq: u64| {
        let (server, path) = (&server, format!("/sessions/{id}"));
        async move {
            while server.get(&path).send().await.unwrap().json::<serde_json::Value>().await.unwrap()["seq"] != seq {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        }
    };
    seen(1).await;
    let new = send(2);
    problem(old.await.unwrap().unwrap(), 409, "superseded").await;
    assert_eq!(server.app.counters().pictures_begun, 0);
    drop(ticket);
    png(new.await.unwrap().unwrap()).await;
    assert_eq!(server.app.counters().pictures_begun, 1);
}

#[tokio::test]
async fn a_stopping_server_is_not_ready() {
    let server = Server::start(&[]).await;
    server.app.drain();
    problem(server.get("/readyz").send().await.unwrap(), 503, "overloaded").await;
    assert_eq!(server.get("/healthz").send().await.unwrap().status(), 200);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_computation_that_panics_takes_nothing_with_it() {
    let server = Server::start(&["--workers", "1"]).await;
    let ticket = server.app.pool().admit().await.unwrap();
    let (sender, receiver) = mpsc::channel::<()>();
    server.app.pool().start(&ticket, move || {
        let _held = sender;
        panic!("on purpose");
    });
    drop(ticket);
    let ended = tokio::task::spawn_blocking(move || receiver.recv().is_err()).await.unwrap();
    assert!(ended, "what the computation held is dropped");
    server.is_well().await;
}
