//! A program that is told to stop: first it is not ready but serves, then it finishes what it has begun.

use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::{Value, json};

use crate::support::program::Program;
use crate::support::server::form;
use crate::support::{Hand, photo};

#[tokio::test]
async fn while_it_leaves_it_serves_and_says_that_it_is_not_ready() {
    let program = Program::start(&["--drain-delay", "4s", "--log-format", "json"]);
    let at = |path: &str| format!("http://{}{path}", program.address);
    let client = Client::new();
    let upload = client.post(at("/sessions")).multipart(form(&photo(128, 96), json!({"p": [[30, 40]]}).to_string()));
    let session: Value = upload.send().await.unwrap().json().await.unwrap();
    let id = session["id"].as_str().unwrap().to_owned();
    let ready = client.get(at("/readyz")).send().await.unwrap();
    assert!(ready.status() == 200 && !ready.headers().contains_key("connection"));
    let mut hand = Hand::open(program.address, &id, "").await;

    program.terminate();
    let told = Instant::now();
    let leaving = loop {
        let answer = client.get(at("/readyz")).send().await.unwrap();
        if answer.status() == 503 {
            break answer;
        }
        assert!(told.elapsed() < Duration::from_secs(2), "it still says that it is ready");
    };
    assert_eq!((&leaving.headers()["retry-after"], &leaving.headers()["connection"]), (&"1".parse().unwrap(), &"close".parse().unwrap()));
    assert_eq!(leaving.json::<Value>().await.unwrap()["code"], "overloaded");
    // Newcomers and those who are there are served, on connections that are not kept.
    let answer = client.post(at(&format!("/sessions/{id}/warp"))).json(&json!({"q": [[44, 44]]})).send().await.unwrap();
    assert!(answer.status() == 200 && answer.headers()["connection"] == "close");
    assert_eq!(client.get(at("/healthz")).send().await.unwrap().status(), 200);
    let mut late = Hand::open(program.address, &id, "").await;
    for hand in [&mut hand, &mut late] {
        hand.pose(1, &json!([[44, 44]])).await;
        assert_eq!(hand.frame().await.0, 1);
    }
    assert!(told.elapsed() < Duration::from_secs(4), "this machine is too slow to see anything");

    assert_eq!((hand.closed().await, late.closed().await), (1012, 1012));
    assert!(told.elapsed() >= Duration::from_millis(3500), "not before its time");
    let (status, log) = tokio::task::spawn_blocking(move || program.wait()).await.unwrap();
    assert_eq!(status.code(), Some(0), "{log}");
    let place = |words: &str| log.find(words).unwrap_or_else(|| panic!("{words} in {log}"));
    assert!(place("leaving") < place("\"stopping\"") && place("\"stopping\"") < place("\"stopped\""));
}

#[tokio::test]
async fn what_has_begun_is_finished_and_nobody_else_comes() {
    let program = Program::start(&[]);
    let address = program.address;
    let url = format!("http://{address}/warp");
    let spec = json!({"p": [[100, 100]], "q": [[140, 130]], "output": {"compression": "best"}});
    let begun = Client::new().post(&url).multipart(form(&photo(2400, 1600), spec.to_string())).send().await.unwrap();
    assert_eq!(begun.status(), 200);
    program.terminate();
    // Its head has come; the rest of the picture comes while the program stops.
    while tokio::net::TcpStream::connect(address).await.is_ok() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let picture = begun.bytes().await.unwrap();
    assert_eq!(image::load_from_memory(&picture).unwrap().width(), 2400);
    let (status, log) = tokio::task::spawn_blocking(move || program.wait()).await.unwrap();
    assert_eq!(status.code(), Some(0), "{log}");
}

#[tokio::test]
async fn who_has_said_nothing_is_not_waited_for() {
    let program = Program::start(&["--header-timeout", "10m", "--shutdown-grace", "20m"]);
    let silent = tokio::net::TcpStream::connect(program.address).await.unwrap();
    // It was accepted when one that came later is answered.
    assert_eq!(Client::new().get(format!("http://{}/healthz", program.address)).send().await.unwrap().status(), 200);
    program.terminate();
    let (status, log) = tokio::task::spawn_blocking(move || program.wait()).await.unwrap();
    assert_eq!(status.code(), Some(0), "{log}");
    drop(silent);
}
