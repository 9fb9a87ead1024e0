//! Rates, places, addresses behind proxies, headers for browsers; and that nothing here
//! asks anybody else, but a collector of traces.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use reqwest::{Method, Response};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::module_dependencies::sources;
use crate::support::server::{header, problem};
use crate::support::{Server, eventually};

fn points() -> Value {
    json!({"extent": [9, 9], "p": [[1, 1]], "q": [[2, 1]], "points": [[3, 3]]})
}

async fn ask(server: &Server, forwarded: &str) -> Response {
    let request = server.post("/points").json(&points());
    let request = if forwarded.is_empty() {
        request
    } else {
        request.header("X-Forwarded-For", forwarded)
    };
    request.send().await.unwrap()
}

/// How many are answered before one is not.
async fn answered(server: &Server, forwarded: impl Fn(usize) -> String) -> usize {
    for n in 0..100 {
        let response = ask(server, &forwarded(n)).await;
        if response.status() != 200 {
            let seconds = header(&response, "retry-after").to_owned();
            let told = problem(response, 429, "rate_limited").await;
            assert_eq!((seconds.as_str(), &told["retry_after"]), ("1", &json!(1)));
            return n;
        }
    }
    100
}

#[tokio::test]
async fn one_address_may_ask_so_often_and_no_header_makes_it_another() {
    let server = Server::start(&["--rate-per-address", "3"]).await;
    let first = answered(&server, |n| format!("198.51.100.{n}")).await;
    assert!((6..20).contains(&first), "{first}");
    // What never costs anything is never refused.
    assert_eq!(server.get("/healthz").send().await.unwrap().status(), 200);
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(ask(&server, "").await.status(), 200);
}

#[tokio::test]
async fn behind_a_trusted_proxy_each_client_is_counted() {
    let server = Server::start(&[
        "--rate-per-address",
        "1",
        "--trusted-proxies",
        "127.0.0.0/8",
    ])
    .await;
    assert_eq!(answered(&server, |n| format!("198.51.100.{n}")).await, 100);
    // What the client wrote itself stands to the left and says nothing; of IPv6 the first half says
    // who it is.
    assert!(answered(&server, |n| format!("198.51.100.{n}, 203.0.113.7")).await < 20);
    assert!(answered(&server, |n| format!("2001:db8::{n:x}")).await < 20);
}

#[tokio::test]
async fn one_key_may_ask_so_often() {
    let server = Server::start(&[
        "--rate-per-key",
        "2",
        "--keys",
        "ann ann-s-key-0123456789,bob bob-s-key-0123456789",
    ])
    .await;
    let status = async |key: &str| {
        server
            .post("/points")
            .bearer_auth(key)
            .json(&points())
            .send()
            .await
            .unwrap()
            .status()
            .as_u16()
    };
    let mut refused = 0;
    for _ in 0..30 {
        refused += usize::from(status("ann-s-key-0123456789").await == 429);
    }
    assert!(refused > 10, "{refused}");
    assert_eq!(status("bob-s-key-0123456789").await, 200);
}

#[tokio::test]
async fn who_finds_no_place_is_told_at_once_and_places_come_back() {
    let server = Server::start(&[
        "--max-connections",
        "6",
        "--max-connections-per-address",
        "4",
    ])
    .await;
    let mut idle = Vec::new();
    for _ in 0..4 {
        idle.push(TcpStream::connect(server.address).await.unwrap());
    }
    eventually("four places are taken", || {
        server.app.access().connections().open() == 4
    })
    .await;
    let mut fifth = TcpStream::connect(server.address).await.unwrap();
    let _ = fifth
        .write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        .await;
    let mut answer = Vec::new();
    let closed = tokio::time::timeout(Duration::from_secs(5), fifth.read_to_end(&mut answer)).await;
    assert!(
        closed.is_ok() && answer.is_empty(),
        "it is closed without an answer, not kept waiting"
    );
    assert_eq!(server.app.access().connections().refused(), 1);
    drop(idle);
    eventually("the places come back", || {
        server.app.access().connections().open() == 0
    })
    .await;
    server.is_well().await;
}

#[tokio::test]
async fn pages_of_listed_sites_may_ask_and_no_others() {
    let server = Server::start(&[
        "--cors-origin",
        "https://warp.example,http://127.0.0.1:3000",
        "--keys",
        "ann ann-s-key-0123456789",
    ])
    .await;
    let preflight = |origin: &'static str| {
        let request = server.client.request(
            Method::OPTIONS,
            server.url("/sessions/8f3b1c1e-6f0a-4c8e-9d53-0f1a2b3c4d5e/warp"),
        );
        let request = request
            .header("Origin", origin)
            .header("Access-Control-Request-Method", "POST");
        request
            .header(
                "Access-Control-Request-Headers",
                "authorization,content-type",
            )
            .send()
    };
    let may = preflight("https://warp.example").await.unwrap();
    assert_eq!(may.status(), 204);
    assert_eq!(
        header(&may, "access-control-allow-origin"),
        "https://warp.example"
    );
    for (name, words) in [
        ("methods", &["POST", "PUT", "DELETE"][..]),
        ("headers", &["authorization", "content-type"]),
    ] {
        let allowed = header(&may, &format!("access-control-allow-{name}"));
        assert!(words.iter().all(|word| allowed.contains(word)), "{allowed}");
    }
    assert!(
        may.headers().contains_key("x-request-id")
            && may
                .headers()
                .get("access-control-allow-credentials")
                .is_none()
    );
    let not = preflight("https://evil.example").await.unwrap();
    assert!(
        not.headers().get("access-control-allow-origin").is_none()
            && header(&not, "vary").contains("origin")
    );
    // A refusal can be read by the page that asked, with its id.
    let refused = server
        .get("/sessions/x")
        .header("Origin", "http://127.0.0.1:3000")
        .send()
        .await
        .unwrap();
    assert_eq!(
        header(&refused, "access-control-allow-origin"),
        "http://127.0.0.1:3000"
    );
    for exposed in [
        "x-request-id",
        "server-timing",
        "warp-folds",
        "retry-after",
        "location",
        "etag",
    ] {
        assert!(
            header(&refused, "access-control-expose-headers").contains(exposed),
            "{exposed}"
        );
    }
    assert_eq!(
        header(&refused, "cross-origin-resource-policy"),
        "cross-origin"
    );
    problem(refused, 401, "unauthorized").await;

    // Pages of other sites embed nothing, although one site is listed.
    let policy = async |server: &Server, origin: Option<&str>| {
        let mut request = server.get("/healthz");
        request = if let Some(origin) = origin {
            request.header("Origin", origin)
        } else {
            request
        };
        header(
            &request.send().await.unwrap(),
            "cross-origin-resource-policy",
        )
        .to_owned()
    };
    let one = Server::start(&["--cors-origin", "https://warp.example"]).await;
    for (origin, expected) in [
        (None, "same-origin"),
        (Some("https://evil.example"), "same-origin"),
        (Some("https://warp.example.evil"), "same-origin"),
        (Some("null"), "same-origin"),
        (Some("https://warp.example"), "cross-origin"),
    ] {
        assert_eq!(policy(&one, origin).await, expected, "{origin:?}");
    }
    let any = Server::start(&["--cors-origin", "*"]).await;
    assert_eq!(policy(&any, None).await, "cross-origin");
    let answer = any
        .post("/points")
        .header("Origin", "https://any.example")
        .json(&points())
        .send()
        .await
        .unwrap();
    assert_eq!(
        (
            answer.status().as_u16(),
            header(&answer, "access-control-allow-origin")
        ),
        (200, "*")
    );
}

/// A browser sends a form of any page to any server, and only hides the answer.
#[tokio::test]
async fn pages_of_other_sites_open_nothing_unseen() {
    let server = Server::start(&["--cors-origin", "https://warp.example"]).await;
    let ask = |site: &'static str, origin: &'static str| {
        server
            .post("/points")
            .json(&points())
            .header("Sec-Fetch-Site", site)
            .header("Origin", origin)
            .send()
    };
    for site in ["cross-site", "same-site"] {
        problem(
            ask(site, "https://evil.example").await.unwrap(),
            403,
            "forbidden",
        )
        .await;
        problem(ask(site, "null").await.unwrap(), 403, "forbidden").await;
        assert_eq!(
            ask(site, "https://warp.example").await.unwrap().status(),
            200
        );
    }
    assert_eq!(
        ask("same-origin", "http://127.0.0.1")
            .await
            .unwrap()
            .status(),
        200
    );
    // To a server that it reaches without TLS beyond the loopback, a browser says the page's origin
    // and no more.
    let ask = |origin: String| {
        server
            .post("/points")
            .json(&points())
            .header("Origin", origin)
            .send()
    };
    for origin in ["http://evil.example", "null"] {
        problem(ask(origin.to_owned()).await.unwrap(), 403, "forbidden").await;
    }
    assert_eq!(ask(server.url("")).await.unwrap().status(), 200);
    assert_eq!(
        ask("https://warp.example".to_owned())
            .await
            .unwrap()
            .status(),
        200
    );
    // Following a link is no harm.
    assert_eq!(
        server
            .get("/")
            .header("Sec-Fetch-Site", "cross-site")
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
}

#[tokio::test]
async fn every_answer_says_how_it_may_be_read() {
    let server = Server::start(&[]).await;
    for path in [
        "/",
        "/page/main.js",
        "/healthz",
        "/openapi.json",
        "/nothing",
        "/sessions/x",
        "/points",
    ] {
        let answer = server
            .get(path)
            .header("Origin", "https://other.example")
            .send()
            .await
            .unwrap();
        assert_eq!(
            header(&answer, "x-content-type-options"),
            "nosniff",
            "{path}"
        );
        assert_eq!(header(&answer, "referrer-policy"), "no-referrer", "{path}");
        assert_eq!(
            header(&answer, "cross-origin-resource-policy"),
            "same-origin",
            "{path}"
        );
        for absent in [
            "server",
            "strict-transport-security",
            "access-control-allow-origin",
            "x-powered-by",
        ] {
            assert!(answer.headers().get(absent).is_none(), "{absent} at {path}");
        }
    }
}

/// Pictures are uploaded, nothing is ever fetched: the program could not. It has no HTTP client but
/// hyper's bare connection, which one file names, and which goes to the collector of traces that
/// the program was started with.
#[test]
fn the_program_has_no_http_client_but_that_of_traces() {
    let tree = |format: &str| {
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args([
            "tree",
            "--offline",
            "--locked",
            "--edges",
            "normal",
            "--prefix",
            "none",
            "--format",
            format,
        ]);
        let output = cargo
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8(output.stdout).unwrap()
    };
    let crates = tree("{p} [{f}]");
    assert!(
        crates.lines().count() > 50 && crates.contains("hyper v"),
        "{crates}"
    );
    for line in crates.lines() {
        let name = line.split(' ').next().unwrap_or_default();
        let clients = [
            "reqwest",
            "ureq",
            "isahc",
            "curl",
            "surf",
            "attohttpc",
            "minreq",
            "awc",
            "hyper-rustls",
            "hyper-tls",
            "webpki-roots",
        ];
        assert!(!clients.contains(&name), "{line}");
        let features = line.split('[').nth(1).unwrap_or_default();
        let is_client = name.starts_with("hyper-")
            && features
                .split([',', ']'])
                .any(|feature| feature.starts_with("client"));
        assert!(!is_client, "{line}");
    }
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../src");
    let mut files = Vec::new();
    sources(&src, &mut files);
    files.retain(|file| {
        std::fs::read_to_string(file)
            .unwrap()
            .contains("hyper::client")
    });
    assert_eq!(files, [src.join("server/observe/otlp_client.rs")]);
}
