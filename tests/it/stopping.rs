//! A program that gets the signal to stop: first it is not ready but serves, then it finishes what
//! it has begun.

use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::support::program::Program;
use crate::support::server::form;
use crate::support::{DragClient, photo};
use crate::tls::Folder;

/// What may have come of a connection's first request when the program stops: the beginning of a
/// method, of a head, of HTTP/2's preface, and of a head on HTTP/2.
const PARTS: [&[u8]; 4] = [
    b"G",
    b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n",
    b"PRI * HTTP/2.0\r\n",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0\0\0\x01\x01\0\0\0\0\x01\x82",
];
const HALF: &[u8] = b"POST /points HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
        application/json\r\nContent-Length: 66\r\n\r\n{\"extent\": [451, 300], ";
const OTHER_HALF: &[u8] = b"\"p\": [[9, 9]], \"q\": [[9, 9]], \"points\": []}";

/// A connection on which so much was sent.
async fn sent(program: &Program, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(program.address).await.unwrap();
    stream.write_all(bytes).await.unwrap();
    stream
}

/// Waits until all connections so far are accepted: they are when a later one is answered.
async fn accepted(program: &Program) {
    assert!(
        answer(sent(program, b"GET /healthz HTTP/1.0\r\n\r\n").await)
            .await
            .contains("200 OK")
    );
}

/// All that comes until the connection ends.
async fn answer(mut stream: TcpStream) -> String {
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer).await;
    String::from_utf8_lossy(&answer).into_owned()
}

/// It ends by itself, and with 0.
async fn ends(program: Program) -> String {
    let (status, log) = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap();
    assert_eq!(status.code(), Some(0), "{log}");
    log
}

/// Until nobody is accepted any more.
async fn closed(program: &Program) {
    while TcpStream::connect(program.address).await.is_ok() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn while_it_leaves_it_serves_and_says_that_it_is_not_ready() {
    let program = Program::start(&["--drain-delay", "4s", "--log-format", "json"]);
    let at = |path: &str| format!("http://{}{path}", program.address);
    let client = Client::new();
    let upload = client
        .post(at("/sessions"))
        .multipart(form(&photo(128, 96), json!({"p": [[30, 40]]}).to_string()));
    let session: Value = upload.send().await.unwrap().json().await.unwrap();
    let id = session["id"].as_str().unwrap().to_owned();
    let ready = client.get(at("/readyz")).send().await.unwrap();
    assert!(ready.status() == 200 && !ready.headers().contains_key("connection"));
    let mut drag = DragClient::open(program.address, &id, "").await;

    program.terminate();
    let told = Instant::now();
    let leaving = loop {
        let answer = client.get(at("/readyz")).send().await.unwrap();
        if answer.status() == 503 {
            break answer;
        }
        assert!(
            told.elapsed() < Duration::from_secs(2),
            "it still says that it is ready"
        );
    };
    assert_eq!(
        (
            &leaving.headers()["retry-after"],
            &leaving.headers()["connection"]
        ),
        (&"1".parse().unwrap(), &"close".parse().unwrap())
    );
    assert_eq!(leaving.json::<Value>().await.unwrap()["code"], "overloaded");
    // Newcomers and those who are there are served, on connections that are not kept.
    let answer = client
        .post(at(&format!("/sessions/{id}/warp")))
        .json(&json!({"q": [[44, 44]]}))
        .send()
        .await
        .unwrap();
    assert!(answer.status() == 200 && answer.headers()["connection"] == "close");
    assert_eq!(
        client.get(at("/healthz")).send().await.unwrap().status(),
        200
    );
    let mut late = DragClient::open(program.address, &id, "").await;
    for drag in [&mut drag, &mut late] {
        drag.pose(1, &json!([[44, 44]])).await;
        assert_eq!(drag.frame().await.0, 1);
    }
    assert!(
        told.elapsed() < Duration::from_secs(4),
        "this machine is too slow to see anything"
    );

    assert_eq!((drag.closed().await, late.closed().await), (1012, 1012));
    assert!(
        told.elapsed() >= Duration::from_millis(3500),
        "not before its time"
    );
    let log = ends(program).await;
    let place = |words: &str| {
        log.find(words)
            .unwrap_or_else(|| panic!("{words} in {log}"))
    };
    assert!(
        place("leaving") < place("\"stopping\"") && place("\"stopping\"") < place("\"stopped\"")
    );
}

#[tokio::test]
async fn what_has_begun_is_finished_and_nobody_else_comes() {
    let program = Program::start(&[]);
    let url = format!("http://{}/warp", program.address);
    let spec = json!({"p": [[100, 100]], "q": [[140, 130]], "output": {"compression": "best"}});
    let begun = Client::new()
        .post(&url)
        .multipart(form(&photo(2400, 1600), spec.to_string()))
        .send()
        .await
        .unwrap();
    assert_eq!(begun.status(), 200);
    program.terminate();
    // Its head has come; the rest of the picture comes while the program stops.
    closed(&program).await;
    let picture = begun.bytes().await.unwrap();
    assert_eq!(image::load_from_memory(&picture).unwrap().width(), 2400);
    ends(program).await;
}

#[tokio::test]
async fn who_has_said_nothing_is_not_waited_for() {
    let program = Program::start(&["--header-timeout", "10m", "--shutdown-grace", "20m"]);
    let silent = sent(&program, b"").await;
    accepted(&program).await;
    program.terminate();
    ends(program).await;
    drop(silent);
}

#[tokio::test]
async fn who_has_sent_a_part_of_a_head_is_not_waited_for() {
    let folder = Folder::new("parts");
    let certified = folder.options();
    for tls in [false, true] {
        let mut options = vec!["--header-timeout", "10m", "--shutdown-grace", "20m"];
        options.extend(certified.iter().map(String::as_str).filter(|_| tls));
        let program = Program::start(&options);
        let mut parts = Vec::new();
        // The beginning of a handshake, or of a request, also where TLS is spoken.
        for part in if tls {
            &[b"\x16\x03\x01", PARTS[1]]
        } else {
            &PARTS[..]
        } {
            parts.push(sent(&program, part).await);
        }
        if !tls {
            // One that had a request before.
            let mut stream = sent(
                &program,
                b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
            )
            .await;
            assert!(stream.read(&mut [0; 4096]).await.unwrap() > 0);
            stream.write_all(PARTS[1]).await.unwrap();
            parts.push(stream);
            accepted(&program).await;
        } else {
            assert!(
                answer(sent(&program, b"GET / HTTP/1.0\r\n\r\n").await)
                    .await
                    .contains("https://")
            );
        }
        program.terminate();
        ends(program).await;
        drop(parts);
    }
}

#[tokio::test]
async fn who_has_sent_a_whole_head_is_waited_for() {
    let program = Program::start(&["--shutdown-grace", "20m"]);
    let mut stream = sent(&program, HALF).await;
    accepted(&program).await;
    program.terminate();
    closed(&program).await;
    // Longer than a head would be.
    tokio::time::sleep(Duration::from_secs(2)).await;
    stream.write_all(OTHER_HALF).await.unwrap();
    let answer = answer(stream).await;
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    ends(program).await;
}

#[tokio::test]
async fn a_second_signal_waits_for_neither_delay_nor_grace_and_a_third_changes_nothing() {
    let program = Program::start(&[
        "--drain-delay",
        "10m",
        "--shutdown-grace",
        "10m",
        "--body-timeout",
        "10m",
    ]);
    let at = |path: &str| format!("http://{}{path}", program.address);
    let client = Client::new();
    let upload = client
        .post(at("/sessions"))
        .multipart(form(&photo(128, 96), json!({"p": [[30, 40]]}).to_string()));
    let session: Value = upload.send().await.unwrap().json().await.unwrap();
    let mut drag = DragClient::open(program.address, session["id"].as_str().unwrap(), "").await;
    let begun = sent(&program, HALF).await;
    program.terminate();
    while client.get(at("/readyz")).send().await.unwrap().status() != 503 {}
    let told = Instant::now();
    program.terminate();
    assert_eq!(drag.closed().await, 1012);
    program.terminate();
    let log = ends(program).await;
    assert!(log.contains("second signal"), "{log}");
    assert!(
        told.elapsed() < Duration::from_secs(10),
        "{:?}",
        told.elapsed()
    );
    assert_eq!(answer(begun).await, "", "its time was over");
}
