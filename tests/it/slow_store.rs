//! A Redis that is slow and not dead: what waits for it holds no worker, and what needs no store is
//! answered as if it were not there.

use std::time::{Duration, Instant};

use mlswarp_server::pool::WorkClass;
use reqwest::Response;
use serde_json::json;
use tokio::task::JoinHandle;

use crate::support::counters::Counted as _;
use crate::support::redis::Redis;
use crate::support::relay::Relay;
use crate::support::server::{form, header, png, problem};
use crate::support::{Server, eventually, photo};

/// A service of two workers for which nobody waits long, over a Redis behind a relay.
async fn start(relay: &Relay, workers: &str) -> Server {
    Server::start(&[
        "--store",
        &relay.address(),
        "--workers",
        workers,
        "--upload-wait",
        "500ms",
    ])
    .await
}

fn drag(server: &Server, id: &str) -> JoinHandle<reqwest::Result<Response>> {
    tokio::spawn(
        server
            .post(&format!("/sessions/{id}/warp"))
            .json(&json!({"q": [[3, 2]]}))
            .send(),
    )
}

/// Sends `count` requests that need no session; the time below which 99 of 100 were answered.
async fn p99_of(server: &Server, count: usize) -> Duration {
    let (file, warp) = (photo(64, 48), json!({"p": [[2, 2]], "q": [[3, 2]]}));
    let mut times = Vec::new();
    for _ in 0..count {
        let began = Instant::now();
        let response = server
            .post("/warp")
            .multipart(form(&file, warp.to_string()))
            .send()
            .await
            .unwrap();
        png(response).await;
        times.push(began.elapsed());
    }
    times.sort_unstable();
    times[(times.len() * 99).div_ceil(100) - 1]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn cold_drags_that_wait_for_their_files_keep_nobody_else_waiting() {
    let redis = Redis::start(&[]);
    let relay = Relay::start(&redis).await;
    let server = start(&relay, "2").await;
    let (one, other) = (
        server
            .session(&photo(20, 14), &json!({"p": [[2, 2]]}))
            .await,
        server
            .session(&photo(24, 18), &json!({"p": [[2, 2]]}))
            .await,
    );
    let warm = server
        .session(&photo(28, 22), &json!({"p": [[2, 2]]}))
        .await;
    let before = p99_of(&server, 30).await;

    server.app.clear_caches();
    png(drag(&server, &warm).await.unwrap().unwrap()).await;
    relay.hold(Some("GET"));
    let cold = [drag(&server, &one), drag(&server, &other)];
    // The second file is asked for while the first is on its way.
    eventually("both files are asked for", || relay.held() == 2).await;
    let meanwhile = p99_of(&server, 30).await;
    eventually("what waits for the store holds no worker", || {
        server.app.pool().load(WorkClass::Upload).running == 0
    })
    .await;
    // Records come and go, and so does a drag whose picture is there.
    assert_eq!(
        server
            .get(&format!("/sessions/{one}"))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    png(drag(&server, &warm).await.unwrap().unwrap()).await;
    assert!(
        cold.iter().all(|drag| !drag.is_finished()),
        "the store has answered nothing yet"
    );
    println!(
        "p99 of 30 pictures that need no store: {before:.1?} before, {meanwhile:.1?} while two \
            cold drags wait; bar {:.1?}",
        2 * before
    );

    relay.hold(None);
    for drag in cold {
        png(drag.await.unwrap().unwrap()).await;
    }
    assert_eq!(relay.held(), 2);
    server.is_well().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn cold_drags_of_one_session_share_its_file() {
    let redis = Redis::start(&[]);
    let relay = Relay::start(&redis).await;
    let server = start(&relay, "2").await;
    let id = server
        .session(&photo(20, 14), &json!({"p": [[2, 2]]}))
        .await;
    server.app.clear_caches();
    relay.hold(Some("GET"));
    let cold: Vec<_> = (0..6).map(|_| drag(&server, &id)).collect();
    eventually("the file is asked for", || relay.held() > 0).await;
    assert_eq!(
        server
            .get(&format!("/sessions/{id}"))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    relay.hold(None);
    for drag in cold {
        png(drag.await.unwrap().unwrap()).await;
    }
    assert_eq!((relay.held(), server.app.counters().images_decoded), (1, 2));
}

/// Memory for a file is taken before the file is asked for, and given back with it.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_file_is_in_the_account_while_it_is_fetched() {
    use mlswarp_server::limits::memory::MemoryClass;
    let redis = Redis::start(&[]);
    let relay = Relay::start(&redis).await;
    let server = start(&relay, "2").await;
    let file = photo(200, 150);
    let id = server.session(&file, &json!({"p": [[2, 2]]})).await;
    server.app.clear_caches();
    let budget = server.app.budget();
    eventually("no picture is held", || {
        budget.taken_for(MemoryClass::Image) == 0
    })
    .await;
    relay.hold(Some("GET"));
    let cold = drag(&server, &id);
    eventually("the file is asked for", || relay.held() == 1).await;
    assert!(budget.taken_for(MemoryClass::Image) >= file.len() as u64);
    relay.hold(None);
    png(cold.await.unwrap().unwrap()).await;
    server.app.clear_caches();
    eventually("nothing is left of it", || {
        budget.taken_for(MemoryClass::Image) == 0
    })
    .await;
    // Where there is no room for it, it is not asked for.
    let rest = budget
        .take(
            MemoryClass::Frame,
            budget.total() / 8 * 7 - budget.taken() - file.len() as u64,
        )
        .unwrap();
    relay.hold(Some("GET"));
    problem(
        drag(&server, &id).await.unwrap().unwrap(),
        503,
        "overloaded",
    )
    .await;
    assert_eq!(relay.held(), 1);
    drop(rest);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn new_handles_that_wait_for_the_store_keep_nobody_else_waiting() {
    let redis = Redis::start(&[]);
    let relay = Relay::start(&redis).await;
    let server = start(&relay, "1").await;
    let id = server
        .session(&photo(20, 14), &json!({"p": [[2, 2]]}))
        .await;
    relay.hold(Some("EVALSHA"));
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&json!({"p": [[4, 4]]}));
    let put = tokio::spawn(put.send());
    // The store is asked for the session and, when that has taken too long, for the new handles.
    eventually("the new handles are sent", || relay.held() == 2).await;
    p99_of(&server, 1).await;
    assert!(!put.is_finished(), "the store has answered nothing yet");
    let refused = put.await.unwrap().unwrap();
    assert!(header(&refused, "retry-after").parse::<u32>().unwrap() >= 1);
    problem(refused, 503, "overloaded").await;
    relay.hold(None);
}
