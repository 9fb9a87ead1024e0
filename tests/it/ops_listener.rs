//! Numbers and health on a listener of their own: open to every client that reaches it, never
//! behind the crowd, and there until the end.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use reqwest::Client;

use crate::support::program::{Program, mlswarp};
use crate::support::server::{header, problem};
use crate::support::{Server, eventually};

/// An address that nobody listens at.
fn free() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn they_need_no_key_and_serve_nothing_else() {
    let watched = free();
    let server = Server::start(&[
        "--metrics-listen",
        &watched.to_string(),
        "--keys",
        "ann 0123456789abcdef",
    ])
    .await;
    let get = async |path: &str| {
        Client::new()
            .get(format!("http://{watched}{path}"))
            .send()
            .await
            .unwrap()
    };
    eventually("the listener is there", || {
        TcpStream::connect(watched).is_ok()
    })
    .await;
    for path in ["/healthz", "/readyz"] {
        assert_eq!(get(path).await.status(), 200, "{path}");
    }
    let metrics = get("/metrics").await;
    assert_eq!(
        header(&metrics, "content-type"),
        "application/openmetrics-text; version=1.0.0; charset=utf-8"
    );
    assert!(
        metrics
            .text()
            .await
            .unwrap()
            .contains("mlswarp_requests_total")
    );
    for path in ["/", "/docs", "/openapi.json", "/sessions/x"] {
        let document = problem(get(path).await, 404, "not_found").await;
        assert_eq!(
            document["detail"],
            format!(
                "nothing is served at `{path}`; this port serves /healthz, /readyz and /metrics"
            )
        );
    }
    problem(
        Client::new()
            .post(format!("http://{watched}/metrics"))
            .send()
            .await
            .unwrap(),
        405,
        "method_not_allowed",
    )
    .await;
    problem(
        server.get("/metrics").send().await.unwrap(),
        401,
        "unauthorized",
    )
    .await;
}

#[test]
fn a_crowd_keeps_no_watcher_out() {
    let watched = free().to_string();
    let program = Program::start(&["--metrics-listen", &watched, "--max-connections", "3"]);
    let listen = program.address.to_string();
    let is_well = |options: &[&str]| {
        mlswarp(&[&["health", "--listen", &listen], options].concat())
            .status()
            .unwrap()
            .success()
    };
    // Connections are taken in the order in which they came.
    let _crowd: Vec<TcpStream> = (0..3)
        .map(|_| TcpStream::connect(program.address).unwrap())
        .collect();
    assert!(!is_well(&[]), "the service itself is full");
    assert!(is_well(&["--metrics-listen", &watched]));
    // Its own places are bounded too, and given back.
    let watcher: SocketAddr = watched.parse().unwrap();
    let watchers: Vec<TcpStream> = (0..40)
        .map(|_| TcpStream::connect(watcher).unwrap())
        .collect();
    assert!(!is_well(&["--metrics-listen", &watched]));
    drop(watchers);
    let began = Instant::now();
    while !is_well(&["--metrics-listen", &watched]) {
        assert!(
            began.elapsed() < Duration::from_secs(30),
            "places are not given back"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn they_are_answered_while_the_service_stops() {
    let watched = free();
    // An upload that does not come to its end holds the service up for the grace.
    let program = Program::start(&[
        "--metrics-listen",
        &watched.to_string(),
        "--shutdown-grace",
        "3s",
    ]);
    let mut slow = TcpStream::connect(program.address).unwrap();
    let head = "POST /points HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
        application/json\r\nContent-Length: 100\r\nExpect: 100-continue\r\n\r\n";
    slow.write_all(head.as_bytes()).unwrap();
    let mut begun = [0; 12];
    slow.read_exact(&mut begun).unwrap();
    assert_eq!(&begun, b"HTTP/1.1 100");
    let get = async |path: &str| {
        Client::new()
            .get(format!("http://{watched}{path}"))
            .send()
            .await
    };
    program.terminate();
    eventually("the service itself is gone", || {
        TcpStream::connect(program.address).is_err()
    })
    .await;
    assert_eq!(get("/healthz").await.unwrap().status(), 200);
    problem(get("/readyz").await.unwrap(), 503, "overloaded").await;
    assert!(
        get("/metrics")
            .await
            .unwrap()
            .text()
            .await
            .unwrap()
            .contains("mlswarp_connections 1\n")
    );
    let (status, log) = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap();
    assert!(status.success(), "{log}");
    assert!(get("/healthz").await.is_err(), "and not after the end");
}

#[test]
fn an_address_that_is_taken_is_named() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap().local_addr();
    let held = TcpListener::bind("127.0.0.1:0").unwrap();
    let held = (held.local_addr().unwrap().to_string(), held);
    let output = mlswarp(&[
        "--listen",
        &taken.unwrap().to_string(),
        "--metrics-listen",
        &held.0,
    ])
    .output()
    .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains(&format!("cannot listen on {}", held.0))
    );
    let output = mlswarp(&[
        "--listen",
        "127.0.0.1:8080",
        "--metrics-listen",
        "127.0.0.1:8080",
    ])
    .output()
    .unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("--metrics-listen (MLSWARP_METRICS_LISTEN)")
    );
}
