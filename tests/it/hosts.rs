//! The host that a request names: one, well-formed, and on the loopback without keys one that an
//! attacker's DNS cannot lead here.

use std::net::SocketAddr;

use reqwest::header::{
    CONNECTION, HOST, ORIGIN, SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_VERSION, UPGRADE,
};
use reqwest::{Method, Response};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use crate::support::http2::{DATA, END_HEADERS, END_STREAM, Frames, GET, HEADERS, block};
use crate::support::program::{Program, mlswarp};
use crate::support::server::{form, header, problem};
use crate::support::{Server, photo};

const KEY: &str = "ann-s-key-0123456789";

/// An upload as the page of a site sends it whose name leads to this server: `Host` and `Origin`
/// agree.
async fn upload(server: &Server, host: &str) -> Response {
    let form = form(&photo(16, 12), json!({"p": [[2, 2]]}).to_string());
    let request = server
        .post("/sessions")
        .header(HOST, host)
        .header(ORIGIN, format!("http://{host}"));
    request
        .bearer_auth(KEY)
        .multipart(form)
        .send()
        .await
        .unwrap()
}

#[tokio::test]
async fn names_that_dns_may_lead_here_are_misdirected() {
    let server = Server::start(&[]).await;
    let port = server.address.port();
    for host in [
        "localhost",
        &format!("localhost:{port}"),
        "LocalHost.",
        "127.0.0.1",
        &format!("127.0.0.1:{port}"),
        "[::1]:8080",
        "192.0.2.7",
    ] {
        assert_eq!(upload(&server, host).await.status(), 201, "{host}");
    }
    for host in [
        "evil.example",
        &format!("evil.example:{port}"),
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "warp.example",
    ] {
        let document = problem(upload(&server, host).await, 421, "misdirected").await;
        let name = host.split(':').next().unwrap();
        assert!(
            document["detail"]
                .as_str()
                .unwrap()
                .contains(&format!("`{name}`")),
            "{document}"
        );
    }
    // Every route, but for the two that health checks ask.
    for (path, status) in [
        ("/", 421),
        ("/openapi.json", 421),
        ("/metrics", 421),
        ("/nothing", 421),
        ("/healthz", 200),
        ("/readyz", 200),
    ] {
        let answer = server
            .get(path)
            .header(HOST, "evil.example")
            .send()
            .await
            .unwrap();
        assert_eq!(answer.status(), status, "{path}");
    }
    let preflight = server
        .client
        .request(Method::OPTIONS, server.url("/warp"))
        .header(HOST, "evil.example");
    let preflight = preflight
        .header(ORIGIN, "http://evil.example")
        .header("Access-Control-Request-Method", "POST");
    problem(preflight.send().await.unwrap(), 421, "misdirected").await;
}

#[tokio::test]
async fn sockets_are_misdirected_too() {
    let server = Server::start(&["--allowed-hosts", "warp.example"]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2]]}))
        .await;
    let open = |host: &str| {
        let request = server
            .get(&format!("/sessions/{id}/drag"))
            .header(HOST, host)
            .header(ORIGIN, format!("http://{host}"));
        let request = request
            .header(CONNECTION, "upgrade")
            .header(UPGRADE, "websocket")
            .header(SEC_WEBSOCKET_VERSION, "13");
        request
            .header(SEC_WEBSOCKET_KEY, "dGhlIHNhbXBsZSBub25jZQ==")
            .send()
    };
    problem(open("evil.example").await.unwrap(), 421, "misdirected").await;
    for host in ["localhost:1", "warp.example", "Warp.Example:8080"] {
        assert_eq!(open(host).await.unwrap().status(), 101, "{host}");
    }
}

#[tokio::test]
async fn keys_need_no_list_and_may_have_one() {
    let keys = ["--keys", &format!("ann {KEY}")];
    let server = Server::start(&keys).await;
    assert_eq!(upload(&server, "any.example").await.status(), 201);
    let server = Server::start(
        &[
            &keys[..],
            &["--allowed-hosts", "warp.example, other.example"],
        ]
        .concat(),
    )
    .await;
    for host in [
        "warp.example",
        "other.example:443",
        "WARP.example.",
        "localhost",
        "127.0.0.1",
    ] {
        assert_eq!(upload(&server, host).await.status(), 201, "{host}");
    }
    problem(upload(&server, "any.example").await, 421, "misdirected").await;
}

#[test]
fn a_list_that_is_none_is_a_mistake() {
    let ended = mlswarp(&["--allowed-hosts", "https://warp.example"])
        .output()
        .unwrap();
    let said = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(2), "{said}");
    assert!(
        said.contains(
            "--allowed-hosts (MLSWARP_ALLOWED_HOSTS): `https://warp.example` is not a host name"
        ),
        "{said}"
    );
}

/// Status and document of the answer to these bytes.
async fn answered(address: SocketAddr, sent: &str) -> (u16, Value) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(sent.as_bytes()).await.unwrap();
    let mut said = String::new();
    stream.read_to_string(&mut said).await.unwrap();
    let (head, document) = said.split_once("\r\n\r\n").unwrap();
    (
        head[9..12].parse().unwrap(),
        serde_json::from_str(document).unwrap_or_default(),
    )
}

#[tokio::test]
async fn a_request_of_http_1_names_one_well_formed_host() {
    let server = Server::start(&["--keys", &format!("ann {KEY}")]).await;
    let ask = async |version: &str, target: &str, fields: &str| {
        answered(
            server.address,
            &format!("GET {target} HTTP/{version}\r\n{fields}Connection: close\r\n\r\n"),
        )
        .await
    };
    for fields in [
        "",
        "Host:\r\n",
        "Host: localhost\r\nHost: localhost\r\n",
        "Host: a.example\r\nhost: b.example\r\n",
        "Host: a b\r\n",
        "Host: user@a.example\r\n",
        "Host: a.example/path\r\n",
        "Host: a.example:http\r\n",
        "Host: [::1\r\n",
    ] {
        let (status, document) = ask("1.1", "/healthz", fields).await;
        assert_eq!(
            (status, &document["code"]),
            (400, &json!("malformed_request")),
            "{fields:?}: {document}"
        );
        assert!(
            document["detail"].as_str().unwrap().contains("Host header"),
            "{document}"
        );
    }
    // Before there was the header there was none, and a target that has a host needs no other.
    assert_eq!(ask("1.0", "/healthz", "").await.0, 200);
    assert_eq!(
        ask("1.1", "http://a.example/healthz", "Host: b.example\r\n")
            .await
            .0,
        200
    );
    assert_eq!(
        ask(
            "1.1",
            "http://user@a.example/healthz",
            "Host: a.example\r\n"
        )
        .await
        .0,
        400
    );
    // The target counts before the header.
    let server = Server::start(&[]).await;
    let ask = |target: &str, host: &str| {
        format!("GET {target} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")
    };
    let (status, document) = answered(
        server.address,
        &ask("http://evil.example/openapi.json", "localhost"),
    )
    .await;
    assert_eq!((status, &document["code"]), (421, &json!("misdirected")));
    assert_eq!(
        answered(
            server.address,
            &ask("http://localhost/openapi.json", "evil.example")
        )
        .await
        .0,
        200
    );
}

#[tokio::test]
async fn a_request_of_http_2_names_one_host() {
    let server = Server::start(&[]).await;
    let mut frames = Frames::open(server.address, 65535).await;
    let cases = [
        ("localhost", &[][..], 404),
        ("localhost:8080", &[("host", "LOCALHOST.:8080")], 404),
        ("", &[("host", "localhost")], 404),
        ("evil.example", &[], 421),
        ("localhost", &[("host", "evil.example")], 400),
        (
            "localhost",
            &[("host", "localhost"), ("host", "localhost")],
            400,
        ),
        ("", &[], 400),
    ];
    for (stream, (authority, fields, status)) in (1..).step_by(2).zip(cases) {
        frames
            .say(
                HEADERS,
                END_HEADERS | END_STREAM,
                stream,
                &block(GET, "/nothing", authority, fields),
            )
            .await;
        let document = loop {
            let frame = frames.next().await.expect("an answer");
            if frame.kind == DATA && frame.stream == stream {
                break serde_json::from_slice::<Value>(&frame.payload).unwrap();
            }
        };
        assert_eq!(
            document["status"], status,
            "{authority} {fields:?}: {document}"
        );
    }
}

/// The listener for metrics has no keys, whatever the other one has.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn metrics_on_the_loopback_are_for_the_loopback() {
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let program = Program::start(&[
        "--keys",
        &format!("ann {KEY}"),
        "--metrics-listen",
        &free.to_string(),
    ]);
    let client = reqwest::Client::new();
    let ask = async |address: SocketAddr, path: &str, host: &str| {
        client
            .get(format!("http://{address}{path}"))
            .header(HOST, host)
            .send()
            .await
            .unwrap()
    };
    problem(
        ask(free, "/metrics", "evil.example").await,
        421,
        "misdirected",
    )
    .await;
    assert_eq!(ask(free, "/metrics", "localhost").await.status(), 200);
    assert_eq!(ask(free, "/readyz", "evil.example").await.status(), 200);
    let unkeyed = ask(program.address, "/metrics", "evil.example").await;
    assert_eq!(header(&unkeyed, "www-authenticate"), "Bearer");
}
