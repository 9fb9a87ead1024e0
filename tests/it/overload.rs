//! More requests than places: refused at once, with a time to come back; health requests
//! get the true state and are never refused.

use std::sync::mpsc;
use std::time::Duration;

use mlswarp_server::client::Client;
use mlswarp_server::limits::memory::MemoryClass;
use mlswarp_server::pool::{QueueKey, Ticket, WorkClass};
use reqwest::Response;
use serde_json::json;

use crate::support::counters::Counted as _;
use crate::support::server::{form, header, png, problem, this_client};
use crate::support::{Server, eventually, photo};

/// A turn of the gate's only worker, held by the client that also sends the test's requests: it
/// gets no other.
async fn busy(server: &Server, work: WorkClass) -> Ticket {
    eventually("nothing runs", || server.app.pool().load(work).running == 0).await;
    server
        .app
        .pool()
        .admit(work, QueueKey::client(this_client()))
        .await
        .unwrap()
}

async fn refused(response: Response) {
    assert!(header(&response, "retry-after").parse::<u32>().unwrap() >= 1);
    problem(response, 503, "overloaded").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_full_queue_refuses_at_once_and_recovers() {
    let server = Server::start(&["--workers", "1", "--queue", "1"]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let other = server
        .session(&photo(16, 12), &json!({"p": [[3, 3]]}))
        .await;
    let path = format!("/sessions/{id}/warp");
    let drags = busy(&server, WorkClass::Drag).await;
    let waiting = tokio::spawn(
        server
            .post(&path)
            .json(&json!({"q": [[3, 2]], "seq": 1}))
            .send(),
    );
    eventually("the drags' queue is full", || {
        server.app.pool().load(WorkClass::Drag).waiting == 1
    })
    .await;
    refused(
        server
            .post(&format!("/sessions/{other}/warp"))
            .json(&json!({"q": [[3, 2]]}))
            .send()
            .await
            .unwrap(),
    )
    .await;
    refused(
        server
            .post(&format!("/sessions/{other}/mesh"))
            .json(&json!({"q": [[3, 2]]}))
            .send()
            .await
            .unwrap(),
    )
    .await;
    // Drags alone are held up.
    server.session(&photo(8, 8), &json!({"p": [[2, 2]]})).await;

    let uploads = busy(&server, WorkClass::Upload).await;
    // Another client would still get the spare turn.
    assert_eq!(server.get("/readyz").send().await.unwrap().status(), 200);
    let spare = QueueKey::client(Client {
        address: [192, 0, 2, 1].into(),
        ..Client::default()
    });
    let spare = server
        .app
        .pool()
        .admit(WorkClass::Drag, spare)
        .await
        .unwrap();
    let upload = |width: u32| {
        server
            .post("/warp")
            .multipart(form(
                &photo(width, 12),
                json!({"p": [[2, 2]], "q": [[3, 2]]}).to_string(),
            ))
            .send()
    };
    let uploading = tokio::spawn(upload(20));
    eventually("the uploads' queue is full", || {
        server.app.pool().load(WorkClass::Upload).waiting == 1
    })
    .await;
    refused(upload(21).await.unwrap()).await;
    for path in ["/sessions", "/points"] {
        refused(server.post(path).json(&json!({})).send().await.unwrap()).await;
    }
    problem(
        server.get("/readyz").send().await.unwrap(),
        503,
        "overloaded",
    )
    .await;
    assert_eq!(server.get("/healthz").send().await.unwrap().status(), 200);
    assert_eq!(
        server.get("/openapi.json").send().await.unwrap().status(),
        200
    );
    assert_eq!(
        server
            .get(&format!("/sessions/{id}"))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    drop((drags, uploads, spare));
    png(waiting.await.unwrap().unwrap()).await;
    png(uploading.await.unwrap().unwrap()).await;
    server.is_well().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_request_that_waits_is_superseded_without_its_turn() {
    let server = Server::start(&["--workers", "1", "--queue", "8"]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let send = |seq: u64| {
        tokio::spawn(
            server
                .post(&format!("/sessions/{id}/warp"))
                .json(&json!({"q": [[3, 2]], "seq": seq}))
                .send(),
        )
    };
    let ticket = busy(&server, WorkClass::Drag).await;
    let old = send(1);
    let seen = |seq: u64| {
        let (server, path) = (&server, format!("/sessions/{id}"));
        async move {
            while server
                .get(&path)
                .send()
                .await
                .unwrap()
                .json::<serde_json::Value>()
                .await
                .unwrap()["seq"]
                != seq
            {
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

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_request_that_waits_too_long_is_answered() {
    let server = Server::start(&[
        "--workers",
        "1",
        "--drag-wait",
        "50ms",
        "--upload-wait",
        "60ms",
    ])
    .await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let held = (
        busy(&server, WorkClass::Drag).await,
        busy(&server, WorkClass::Upload).await,
    );
    refused(
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": [[3, 2]]}))
            .send()
            .await
            .unwrap(),
    )
    .await;
    refused(
        server
            .upload("/sessions", &photo(16, 12), &json!({"p": [[2, 2]]}))
            .await,
    )
    .await;
    // A drag whose picture has been dropped waits with the uploads.
    server.app.clear_caches();
    refused(
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": [[3, 2]]}))
            .send()
            .await
            .unwrap(),
    )
    .await;
    let late = |work| server.app.pool().load(work).late;
    assert_eq!((late(WorkClass::Drag), late(WorkClass::Upload)), (1, 2));
    drop(held);
    server.is_well().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_session_with_many_requests_does_not_keep_others_out() {
    let server = Server::start(&["--workers", "1", "--queue", "4"]).await;
    let greedy = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let modest = server
        .session(&photo(16, 12), &json!({"p": [[3, 3]]}))
        .await;
    let drag = |id: &str| {
        tokio::spawn(
            server
                .post(&format!("/sessions/{id}/warp"))
                .json(&json!({"q": [[3, 2]]}))
                .send(),
        )
    };
    let held = busy(&server, WorkClass::Drag).await;
    let many: Vec<_> = (0..12).map(|_| drag(&greedy)).collect();
    eventually("all have come", || {
        server.app.pool().load(WorkClass::Drag).full == 8
    })
    .await;
    let one = drag(&modest);
    eventually("it is let in", || {
        server.app.pool().load(WorkClass::Drag).full == 9
    })
    .await;
    drop(held);
    png(one.await.unwrap().unwrap()).await;
    let mut drawn = 0;
    for request in many {
        let response = request.await.unwrap().unwrap();
        drawn += usize::from(response.status() == 200);
        assert!(response.status() == 200 || response.status() == 503);
    }
    assert_eq!(drawn, 3);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn memory_is_refused_before_it_is_taken_and_what_is_idle_gives_way() {
    let server = Server::start(&["--memory-bytes", "64MiB", "--image-cache-bytes", "60MiB"]).await;
    let warp = json!({"p": [[2, 2]], "q": [[3, 2]]});
    // 9 bytes a pixel, and the profile's allowance: more than seven eighths of the account.
    let file = photo(4000, 1600);
    let refused = problem(server.upload("/warp", &file, &warp).await, 413, "too_large").await;
    assert_eq!(
        (&refused["limit_name"], &refused["limit"]),
        (&"memory_bytes".into(), &(56_u64 << 20).into())
    );
    assert!(refused["actual"].as_u64().unwrap() > 56 << 20);
    // Eight pictures of 12 MB each: the cache gives way to the newest.
    let budget = server.app.budget();
    for width in 1500..1508 {
        png(server.upload("/warp", &photo(width, 800), &warp).await).await;
        assert!(budget.taken() <= budget.total());
    }
    assert!(budget.taken_for(MemoryClass::Image) > 12 << 20);
    // All that is left is taken by others; what is idle still gives way, and then nothing does.
    let all = budget
        .take(MemoryClass::Frame, budget.total() - budget.taken())
        .unwrap();
    png(server.upload("/warp", &photo(800, 600), &warp).await).await;
    server.app.clear_caches();
    let rest = budget
        .take(MemoryClass::Frame, budget.total() - budget.taken())
        .unwrap();
    self::refused(server.upload("/warp", &photo(800, 600), &warp).await).await;
    problem(
        server.get("/readyz").send().await.unwrap(),
        503,
        "overloaded",
    )
    .await;
    drop((all, rest));
    server.is_well().await;
    eventually("answers have left", || {
        budget.taken_for(MemoryClass::Frame) + budget.taken_for(MemoryClass::Upload) == 0
    })
    .await;
}

#[tokio::test]
async fn a_stopping_server_is_not_ready() {
    let server = Server::start(&[]).await;
    server.app.lifecycle.leave();
    problem(
        server.get("/readyz").send().await.unwrap(),
        503,
        "overloaded",
    )
    .await;
    assert_eq!(server.get("/healthz").send().await.unwrap().status(), 200);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_computation_that_panics_takes_nothing_with_it() {
    let server = Server::start(&["--workers", "1"]).await;
    let ticket = busy(&server, WorkClass::Drag).await;
    let (sender, receiver) = mpsc::channel::<()>();
    ticket.start(move || {
        let _held = sender;
        panic!("on purpose");
    });
    drop(ticket);
    let ended = tokio::task::spawn_blocking(move || receiver.recv().is_err())
        .await
        .unwrap();
    assert!(ended, "what the computation held is dropped");
    server.is_well().await;
}
