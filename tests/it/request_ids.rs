//! One id from the request to everything that reports it: log lines, problems, the messages of a
//! socket.

use serde_json::{Value, json};

use crate::support::drag_client::Received;
use crate::support::program::Program;
use crate::support::redis::Redis;
use crate::support::server::{form, problem};
use crate::support::{DragClient, Server, photo};

/// Every log line of the program, which is ended.
async fn log(program: Program) -> Vec<Value> {
    program.terminate();
    let (status, log) = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap();
    assert!(status.success(), "{log}");
    let lines: Vec<Value> = log
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    for line in &lines {
        assert!(
            line.as_object()
                .unwrap()
                .values()
                .all(|value| !value.is_object() && !value.is_array()),
            "flat: {line}"
        );
    }
    lines
}

fn lines<'a>(log: &'a [Value], message: &str) -> Vec<&'a Value> {
    log.iter()
        .filter(|line| {
            line["message"]
                .as_str()
                .is_some_and(|told| told.contains(message))
        })
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_goes_wrong_for_a_request_is_logged_with_its_id() {
    let redis = Redis::start(&[]);
    let program = Program::start(&[
        "--log-format",
        "json",
        "--log",
        "debug,h2=off,hyper=off",
        "--store",
        &redis.address(),
    ]);
    let http = reqwest::Client::new();
    let url = |path: &str| format!("http://{}{path}", program.address);
    let warp = json!({"p": [[20, 20], [100, 24]]}).to_string();
    let made = http
        .post(url("/sessions"))
        .header("x-request-id", "made")
        .multipart(form(&photo(128, 96), warp.as_str()));
    let session: Value = made.send().await.unwrap().json().await.unwrap();
    let id = session["id"].as_str().unwrap().to_owned();
    drop(redis);
    let refused = http
        .post(url("/sessions"))
        .header("x-request-id", "refused")
        .multipart(form(&photo(128, 96), warp.as_str()));
    assert_eq!(
        problem(refused.send().await.unwrap(), 503, "overloaded").await["request_id"],
        "refused"
    );
    // What a client writes cannot begin a line of its own, and names nothing that it should not.
    let strange = http
        .get(url("/no/such/path"))
        .header("x-request-id", "a\" forged=\"1");
    problem(strange.send().await.unwrap(), 404, "not_found").await;
    let log = log(program).await;
    assert_eq!(
        lines(&log, "answered")
            .iter()
            .map(|line| line["id"].as_str().unwrap().len())
            .collect::<Vec<_>>(),
        [4, 7, 36]
    );
    assert_eq!(lines(&log, "a plan was built")[0]["id"], "made");
    assert_eq!(lines(&log, "the session store is away")[0]["id"], "refused");
    assert!(
        lines(&log, "stopped")[0]["id"].is_null(),
        "outside of requests there is none"
    );
    for line in &log {
        let line = line.to_string();
        assert!(
            !line.contains(&id) && !line.contains("forged") && !line.contains("/no/such"),
            "{line}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_socket_goes_on_under_the_id_of_its_handshake() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(128, 96), &json!({"p": [[20, 20], [100, 24]]}))
        .await;
    let mut drag = DragClient::open(server.address, &id, "").await;
    drag.say(&json!({"seq": 1, "q": "nowhere"})).await;
    let first = drag.problem("bad_value").await["request_id"]
        .as_str()
        .unwrap()
        .to_owned();
    assert_eq!(first.len(), 36);
    server
        .client
        .delete(server.url(&format!("/sessions/{id}")))
        .send()
        .await
        .unwrap();
    drag.pose(2, &json!([[21, 20], [100, 24]])).await;
    assert_eq!(
        drag.problem("no_such_session").await["request_id"],
        first,
        "of a frame as of a message"
    );
    assert!(matches!(drag.next().await, Received::Closed(1000)));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_end_of_a_socket_is_logged_with_the_id_of_its_handshake() {
    let program = Program::start(&["--log-format", "json"]);
    let made = reqwest::Client::new()
        .post(format!("http://{}/sessions", program.address))
        .multipart(form(&photo(128, 96), json!({"p": [[20, 20]]}).to_string()));
    let session: Value = made.send().await.unwrap().json().await.unwrap();
    let drag = DragClient::open(program.address, session["id"].as_str().unwrap(), "").await;
    drop(drag);
    let log = log(program).await;
    let shaken = log.iter().find(|line| line["status"] == 101).unwrap();
    assert_eq!(lines(&log, "drag ended")[0]["id"], shaken["id"]);
}
