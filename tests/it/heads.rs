//! Heads that are none, or too large: hyper refuses them before there is a request, and the client is told all the same.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::support::Server;
use crate::tls::Folder;

const SERVED: &str = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";

/// Reads to the end.
async fn said(mut stream: impl AsyncRead + Unpin) -> String {
    let mut said = Vec::new();
    tokio::time::timeout(Duration::from_secs(30), stream.read_to_end(&mut said)).await.expect("the server does not close").unwrap();
    String::from_utf8(said).unwrap()
}

/// All that is said to a client that sends this.
async fn ask(address: SocketAddr, sent: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(sent).await.unwrap();
    said(stream).await
}

/// The last answer, which must be a whole problem document.
fn problem(said: &str, status: u16, code: &str) -> (Value, HashMap<String, String>) {
    let (head, document) = said.rsplit_once("\r\n\r\n").unwrap();
    let head = &head[head.rfind("HTTP/1.1 ").unwrap()..];
    assert!(head.starts_with(&format!("HTTP/1.1 {status} ")), "{said}");
    let headers: HashMap<_, _> = head.lines().filter_map(|line| line.split_once(": ")).map(|(n, v)| (n.to_owned(), v.to_owned())).collect();
    let document: Value = serde_json::from_str(document).unwrap();
    for (name, value) in [
        ("content-type", "application/problem+json"),
        ("connection", "close"),
        ("cache-control", "no-store"),
        ("x-content-type-options", "nosniff"),
        ("x-request-id", document["request_id"].as_str().unwrap()),
    ] {
        assert_eq!(headers.get(name).map(String::as_str), Some(value), "{name} in {said}");
    }
    assert!(headers["date"].ends_with(" GMT"), "{said}");
    assert_eq!((&document["code"], &document["status"]), (&code.into(), &status.into()), "{said}");
    (document, headers)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_head_that_is_refused_has_a_problem_with_a_code() {
    let server = Server::start(&[]).await;
    // hyper looks at the length between two reads: up to two of 64 KiB may pass.
    let long = "x".repeat(300_000);
    let fields: String = (0..101).map(|n| format!("X-{n}: 1\r\n")).collect();
    let heads = [
        ("\u{16}\u{3}\u{1}\u{2}\0\u{1}\0\u{1}\r\n\r\n".to_owned(), 400, "malformed_request", None),
        ("GET / HTTP/1.1\r\nno colon\r\n\r\n".to_owned(), 400, "malformed_request", None),
        ("GET / HTTP/7.0\r\n\r\n".to_owned(), 400, "malformed_request", None),
        ("GET \u{7f} HTTP/1.1\r\n\r\n".to_owned(), 400, "malformed_request", None),
        ("POST /warp HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n".to_owned(), 400, "malformed_request", None),
        (format!("GET / HTTP/1.1\r\nX: {long}\r\n\r\n"), 413, "too_large", Some(("head_bytes", 65_536))),
        (format!("GET / HTTP/1.1\r\n{fields}\r\n"), 413, "too_large", Some(("head_fields", 100))),
        (format!("GET /{long} HTTP/1.1\r\n\r\n"), 413, "too_large", Some(("head_bytes", 65_536))),
    ];
    for (head, status, code, limit) in &heads {
        for before in ["", SERVED] {
            let said = ask(server.address, format!("{before}{head}").as_bytes()).await;
            assert_eq!(said.matches("HTTP/1.1 200 OK").count(), usize::from(!before.is_empty()), "{said}");
            let (document, _) = problem(&said, *status, code);
            let (name, value) = limit.map_or((Value::Null, Value::Null), |(name, value)| (name.into(), value.into()));
            assert_eq!((&document["limit_name"], &document["limit"]), (&name, &value), "{said}");
        }
    }
    // Behind an answer that the client has had.
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(SERVED.as_bytes()).await.unwrap();
    let mut first = [0; 15];
    stream.read_exact(&mut first).await.unwrap();
    stream.write_all(b"\0\r\n\r\n").await.unwrap();
    problem(&said(stream).await, 400, "malformed_request");
    let metrics = server.get("/metrics").send().await.unwrap().text().await.unwrap();
    for sample in [
        r#"mlswarp_requests_total{route="-",method="other",status="400"} 11"#,
        r#"mlswarp_requests_total{route="-",method="other",status="413"} 6"#,
        r#"mlswarp_problems_total{code="malformed_request",limit=""} 11"#,
        r#"mlswarp_problems_total{code="too_large",limit="head_bytes"} 4"#,
        r#"mlswarp_problems_total{code="too_large",limit="head_fields"} 2"#,
    ] {
        assert!(metrics.contains(sample), "{sample} in {metrics}");
    }
    server.is_well().await;
}

/// However it comes: in pieces, and behind a request with which its first piece came.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_head_is_measured_as_a_whole() {
    let server = Server::start(&[]).await;
    for before in ["", SERVED] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.set_nodelay(true).unwrap();
        // What is read at first is as much.
        let first = format!("{:x<8192}", format!("{before}GET / HTTP/1.1\r\nX: "));
        stream.write_all(first.as_bytes()).await.unwrap();
        for _ in 0..58 {
            tokio::time::sleep(Duration::from_millis(5)).await;
            stream.write_all(&[b'x'; 1000]).await.unwrap();
        }
        let (document, _) = problem(&said(stream).await, 413, "too_large");
        assert_eq!(document["limit_name"], "head_bytes", "{document}");
    }
}

/// Unread bytes would reset the connection, and the answer with it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_sends_a_megabyte_of_head_and_reads_after_sees_the_answer() {
    let server = Server::start(&[]).await;
    for _ in 0..5 {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.write_all(b"GET / HTTP/1.1\r\nX: ").await.unwrap();
        for _ in 0..64 {
            stream.write_all(&[b'x'; 16 << 10]).await.unwrap();
            tokio::task::yield_now().await;
        }
        stream.write_all(b"\r\n\r\n").await.unwrap();
        tokio::time::sleep(Duration::from_millis(50)).await;
        problem(&said(stream).await, 413, "too_large");
    }
}

/// A client that was refused and neither reads nor leaves keeps nothing for long.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_was_refused_and_stays_is_closed() {
    let server = Server::start(&[]).await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(b"\0\r\n\r\n").await.unwrap();
    crate::support::eventually("its place is given back", || server.app.access().places().open() == 0).await;
    problem(&said(stream).await, 400, "malformed_request");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn through_tls_and_where_tls_is_missing() {
    let folder = Folder::new("heads");
    let server = folder.server(&[]).await;
    let mut stream = folder.connect(server.address, &[b"http/1.1"]).await.unwrap();
    stream.write_all(b"no head at all\r\n\r\n").await.unwrap();
    let (_, headers) = problem(&said(stream).await, 400, "malformed_request");
    assert!(headers["strict-transport-security"].starts_with("max-age="));
    // Plain HTTP is answered, and nothing is served by it.
    let (document, _) = problem(&ask(server.address, SERVED.as_bytes()).await, 400, "malformed_request");
    assert!(document["detail"].as_str().unwrap().contains("https://"), "{document}");
    problem(&ask(server.address, b"NO HEAD\r\n\r\n").await, 400, "malformed_request");
    // Also a client that sends all of its picture before it reads.
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(b"POST /warp HTTP/1.1\r\nHost: localhost\r\nContent-Length: 20000000\r\n\r\n").await.unwrap();
    stream.write_all(&vec![b'x'; 20_000_000]).await.unwrap();
    problem(&said(stream).await, 400, "malformed_request");
}
