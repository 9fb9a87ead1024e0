//! Traces as a collector gets them, and what becomes of the service when it does not.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use mlswarp_server::pool::{QueueKey, WorkClass};
use opentelemetry_proto::tonic::trace::v1::Span;
use reqwest::Client;
use serde_json::{Value, json};

use crate::support::collector::{Collector, attributes};
use crate::support::program::{Program, mlswarp};
use crate::support::server::{form, png, problem};
use crate::support::{DragClient, Scratch, Server, eventually, photo};
use crate::tls::Folder;

const KEY: &str = "a-key-of-the-tests-0123456789";
const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const PARENT: &str = "00f067aa0ba902b7";

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The children of a span, by name.
fn stages(collector: &Collector, whole: &Span) -> BTreeMap<String, Span> {
    let children = collector
        .spans()
        .into_iter()
        .filter(|span| span.parent_span_id == whole.span_id);
    children.map(|span| (span.name.clone(), span)).collect()
}

/// Every child lies within its parent, and belongs to its trace.
fn nests(whole: &Span, stages: &BTreeMap<String, Span>) {
    for (name, stage) in stages {
        assert!(
            whole.start_time_unix_nano <= stage.start_time_unix_nano,
            "{name}"
        );
        assert!(
            stage.start_time_unix_nano <= stage.end_time_unix_nano,
            "{name}"
        );
        assert!(
            stage.end_time_unix_nano <= whole.end_time_unix_nano,
            "{name}"
        );
        assert_eq!(stage.trace_id, whole.trace_id);
        assert!(stage.attributes.is_empty() && stage.span_id != whole.span_id);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_is_a_span_with_a_child_for_each_stage() {
    let collector = Collector::start().await;
    let keys = format!("ann {KEY}");
    let server = Server::start(&[
        "--otlp-endpoint",
        &collector.url(),
        "--keys",
        &keys,
        "--workers",
        "2",
    ])
    .await;
    // Large enough to leave strip by strip: drawing goes on after the answer's head.
    let warp = json!({"p": [[20, 20], [700, 500]], "q": [[40, 30], [700, 500]]}).to_string();
    let asked = server
        .post("/warp?session=true")
        .bearer_auth(KEY)
        .header("traceparent", format!("00-{TRACE}-{PARENT}-01"))
        .header("tracestate", "vendor=secret-state")
        .header("x-request-id", "ticket-7")
        .multipart(form(&photo(900, 600), warp));
    let response = asked.send().await.unwrap();
    let id = response.headers()["warp-session"]
        .to_str()
        .unwrap()
        .to_owned();
    png(response).await;
    eventually("the span comes", || collector.named("POST /warp").is_some()).await;
    let whole = collector.named("POST /warp").unwrap();
    assert_eq!(
        (
            hex(&whole.trace_id).as_str(),
            hex(&whole.parent_span_id).as_str(),
            whole.kind
        ),
        (TRACE, PARENT, 2)
    );
    let told = attributes(&whole.attributes);
    let expected = [
        ("http.request.method", "POST"),
        ("http.response.status_code", "200"),
        ("http.route", "/warp"),
        ("mlswarp.request_id", "ticket-7"),
        ("url.scheme", "http"),
    ];
    assert_eq!(
        told,
        expected
            .into_iter()
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect()
    );
    let children = stages(&collector, &whole);
    assert_eq!(
        children.keys().map(String::as_str).collect::<Vec<_>>(),
        [
            "decode", "deform", "encode", "plan", "queue", "reduce", "render", "store"
        ]
    );
    nests(&whole, &children);
    let begins = |name: &str| children[name].start_time_unix_nano;
    assert!(begins("queue") <= begins("decode") && begins("decode") <= begins("plan"));
    assert!(begins("plan") <= begins("deform") && begins("deform") <= begins("render"));
    assert!(
        children["decode"].end_time_unix_nano > begins("decode")
            && children["render"].end_time_unix_nano > begins("render")
    );
    assert!(
        collector.bytes().windows(6).any(|bytes| bytes == b"ticket"),
        "what is looked for would be found"
    );
    // A drag, a refusal, a path without a route; and what monitors ask.
    let drag = server
        .post(&format!("/sessions/{id}/warp"))
        .bearer_auth(KEY)
        .json(&json!({"q": [[41, 30], [700, 500]]}));
    png(drag.send().await.unwrap()).await;
    problem(
        server
            .post("/points")
            .bearer_auth(KEY)
            .json(&json!({}))
            .send()
            .await
            .unwrap(),
        422,
        "bad_value",
    )
    .await;
    problem(
        server.get("/no/such/path").send().await.unwrap(),
        404,
        "not_found",
    )
    .await;
    assert_eq!(server.get("/healthz").send().await.unwrap().status(), 200);
    eventually("the spans come", || collector.named("GET").is_some()).await;
    let drag = collector.named("POST /sessions/{id}/warp").unwrap();
    let children = stages(&collector, &drag);
    nests(&drag, &children);
    assert_eq!(children.len(), 7, "{children:?}");
    assert!(drag.parent_span_id.is_empty() && drag.trace_id != whole.trace_id);
    let refused = collector.named("POST /points").unwrap();
    assert_eq!(attributes(&refused.attributes)["error.type"], "bad_value");
    assert!(
        refused.status.is_none_or(|status| status.code != 2),
        "what the client did wrong is no error of the service's"
    );
    assert!(!attributes(&collector.named("GET").unwrap().attributes).contains_key("http.route"));
    let names: Vec<String> = collector
        .spans()
        .into_iter()
        .map(|span| span.name)
        .collect();
    assert!(
        !names.iter().any(|name| name.contains("healthz")),
        "{names:?}"
    );
    let resource = collector.resource();
    assert_eq!(
        (
            resource["service.name"].as_str(),
            resource["service.version"].as_str()
        ),
        ("mlswarp", env!("CARGO_PKG_VERSION"))
    );
    assert_eq!(resource["service.instance.id"].len(), 36);
    let bytes = collector.bytes();
    for secret in [
        &id,
        KEY,
        "ann",
        "secret-state",
        "/no/such/path",
        "127.0.0.1",
    ] {
        assert!(
            !bytes
                .windows(secret.len())
                .any(|window| window == secret.as_bytes()),
            "{secret}"
        );
    }
    let stats = server.app.tracer().unwrap().stats();
    // The exporter counts them when the collector has answered.
    eventually("all spans are counted", || {
        (stats.exported.get(), stats.dropped.get()) == (collector.spans().len() as u64, 0)
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_callers_choice_is_followed() {
    let collector = Collector::start().await;
    let server = Server::start(&["--otlp-endpoint", &collector.url(), "--otlp-sample", "0"]).await;
    let ask = async |parent: &str, id: &str| {
        let asked = server
            .post("/points")
            .header("traceparent", parent)
            .header("x-request-id", id)
            .json(&json!({}));
        problem(asked.send().await.unwrap(), 422, "bad_value").await;
    };
    ask(&format!("00-{TRACE}-{PARENT}-00"), "not-sampled").await;
    for nonsense in [
        "",
        "00",
        &format!("00-{TRACE}-{PARENT}"),
        &format!("00-{}-{PARENT}-01", "0".repeat(32)),
        &format!("ff-{TRACE}-{PARENT}-01"),
    ] {
        ask(nonsense, "nonsense").await;
    }
    ask(&format!("00-{TRACE}-{PARENT}-01"), "sampled").await;
    eventually("the span comes", || {
        collector.named("POST /points").is_some()
    })
    .await;
    let ids = collector
        .spans()
        .iter()
        .filter_map(|span| attributes(&span.attributes).remove("mlswarp.request_id"))
        .collect::<Vec<_>>();
    assert_eq!(ids, ["sampled"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_leaves_before_the_answer_has_a_span_of_its_name() {
    let collector = Collector::start().await;
    let server = Server::start(&["--otlp-endpoint", &collector.url(), "--workers", "1"]).await;
    let pool = server.app.pool();
    let busy = pool
        .admit(
            WorkClass::Upload,
            QueueKey::client(crate::support::server::this_client()),
        )
        .await
        .unwrap();
    let waits = tokio::spawn(
        server
            .post("/points")
            .json(&json!({"extent": [9, 9], "points": []}))
            .send(),
    );
    eventually("it waits", || pool.load(WorkClass::Upload).waiting == 1).await;
    waits.abort();
    eventually("its span comes", || !collector.spans().is_empty()).await;
    let span = collector.named("POST /points").unwrap();
    let told = attributes(&span.attributes);
    assert_eq!(
        told.keys().map(String::as_str).collect::<Vec<_>>(),
        [
            "http.request.method",
            "http.route",
            "mlswarp.request_id",
            "url.scheme"
        ]
    );
    nests(&span, &stages(&collector, &span));
    drop(busy);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_is_a_trace_that_links_to_its_handshake() {
    let collector = Collector::start().await;
    let server = Server::start(&["--otlp-endpoint", &collector.url(), "--workers", "2"]).await;
    let id = server
        .session(&photo(128, 96), &json!({"p": [[20, 20], [100, 24]]}))
        .await;
    let mut dragging = DragClient::open(server.address, &id, "").await;
    for seq in 1..=2 {
        dragging
            .pose(seq, &json!([[20 + seq, 20], [100, 24]]))
            .await;
        dragging.ack_of_next_frame(seq).await;
    }
    let frames = || {
        collector
            .spans()
            .into_iter()
            .filter(|span| span.name == "drag frame")
            .collect::<Vec<_>>()
    };
    eventually("both come while the socket is open", || frames().len() == 2).await;
    let handshake = collector.named("GET /sessions/{id}/drag").unwrap();
    assert_eq!(
        attributes(&handshake.attributes)["http.response.status_code"],
        "101"
    );
    let mut reduced = 0;
    for frame in frames() {
        assert!(frame.parent_span_id.is_empty() && frame.trace_id != handshake.trace_id);
        assert_eq!(
            (&frame.links[0].trace_id, &frame.links[0].span_id),
            (&handshake.trace_id, &handshake.span_id)
        );
        assert_eq!(
            attributes(&frame.attributes),
            attributes(&handshake.attributes)
                .into_iter()
                .filter(|(k, _)| k == "mlswarp.request_id")
                .collect()
        );
        let mut children = stages(&collector, &frame);
        nests(&frame, &children);
        reduced += usize::from(children.remove("reduce").is_some());
        assert_eq!(
            children.keys().map(String::as_str).collect::<Vec<_>>(),
            [
                "decode", "deform", "encode", "plan", "queue", "render", "store"
            ]
        );
    }
    assert_eq!(reduced, 1, "the copies of an image are made once");
    server
        .client
        .delete(server.url(&format!("/sessions/{id}")))
        .send()
        .await
        .unwrap();
    dragging.pose(3, &json!([[25, 20], [100, 24]])).await;
    dragging.problem("no_such_session").await;
    eventually("a frame that came to nothing", || frames().len() == 3).await;
    assert!(frames().iter().any(|frame| {
        attributes(&frame.attributes)
            .get("error.type")
            .is_some_and(|code| code == "no_such_session")
    }));
}

async fn warp(program: &Program) {
    let warp = json!({"p": [[2, 2]], "q": [[3, 2]]}).to_string();
    png(Client::new()
        .post(format!("http://{}/warp", program.address))
        .multipart(form(&photo(32, 24), warp))
        .send()
        .await
        .unwrap())
    .await;
}

/// Ends the program; says what it logged. Whatever a collector does, it ends soon: ten times the
/// longest wait for it.
async fn ends(program: Program) -> Vec<Value> {
    program.terminate();
    let began = Instant::now();
    let (status, log) = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap();
    assert!(
        status.success() && began.elapsed() < Duration::from_secs(30),
        "{log}"
    );
    log.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_left_is_exported_before_the_end() {
    let collector = Collector::start().await;
    let mut command = mlswarp(&[
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--otlp-endpoint",
        &collector.url(),
        "--log-format",
        "json",
    ]);
    command.env("OTEL_SERVICE_NAME", "bender").env(
        "OTEL_RESOURCE_ATTRIBUTES",
        "deployment.environment.name=tests",
    );
    command.env("OTEL_EXPORTER_OTLP_HEADERS", "x-tenant=seven");
    let program = Program::spawn(command);
    warp(&program).await;
    let log = ends(program).await;
    let whole = collector
        .named("POST /warp")
        .expect("its span was sent at the latest when the program ended");
    let answered = log
        .iter()
        .find(|line| line["message"] == "answered")
        .unwrap();
    assert_eq!(
        answered["trace_id"],
        hex(&whole.trace_id),
        "log lines name the trace"
    );
    assert_eq!(
        answered["id"],
        attributes(&whole.attributes)["mlswarp.request_id"]
    );
    let resource = collector.resource();
    assert_eq!(
        (
            resource["service.name"].as_str(),
            resource["deployment.environment.name"].as_str()
        ),
        ("bender", "tests")
    );
    assert_eq!(
        (
            collector.headers()["x-tenant"].to_str().unwrap(),
            log.iter().any(|line| line["level"] == "WARN")
        ),
        ("seven", false)
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_collector_that_is_away_or_silent_is_nobodys_trouble() {
    // It accepts connections, in its backlog, and never says anything.
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let away = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    for (address, what) in [
        (silent.local_addr().unwrap(), "are lost"),
        (away, "are not exported"),
    ] {
        let program = Program::start(&[
            "--otlp-endpoint",
            &format!("http://{address}"),
            "--log-format",
            "json",
        ]);
        for _ in 0..5 {
            warp(&program).await;
        }
        let log = ends(program).await;
        let told = log
            .iter()
            .filter(|line| line["level"] == "WARN")
            .collect::<Vec<_>>();
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(
            told[0]["message"].as_str().unwrap().contains(what),
            "{told:?}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn spans_that_nobody_takes_are_counted() {
    let away = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let server = Server::start(&["--otlp-endpoint", &format!("http://{away}")]).await;
    server.is_well().await;
    eventually("they are dropped", || {
        server.app.tracer().unwrap().stats().dropped.get() >= 7
    })
    .await;
    let metrics = server
        .get("/metrics")
        .send()
        .await
        .unwrap()
        .text()
        .await
        .unwrap();
    assert!(
        metrics.contains("mlswarp_spans_exported_total 0\n"),
        "{metrics}"
    );
    let dropped = metrics
        .lines()
        .find_map(|line| line.strip_prefix("mlswarp_spans_dropped_total "))
        .unwrap();
    assert!(dropped.parse::<u64>().unwrap() >= 7);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn spans_that_a_collector_rejects_are_not_exported() {
    let collector = Collector::start().await;
    collector.reject(3);
    let server = Server::start(&["--otlp-endpoint", &collector.url()]).await;
    server.is_well().await;
    let tally = || {
        let stats = server.app.tracer().unwrap().stats();
        (stats.exported.get(), stats.dropped.get())
    };
    eventually("the batch is counted", || tally() != (0, 0)).await;
    let (exported, dropped) = tally();
    assert_eq!(
        (exported + dropped, dropped % 3),
        (collector.spans().len() as u64, 0),
        "three of each batch: {exported}, {dropped}"
    );
    assert!(exported > 0 && dropped > 0);
    // A collector that rejects more spans than were sent has rejected all.
    collector.reject(i64::MAX);
    server.is_well().await;
    eventually("the next is counted", || tally().1 > dropped).await;
    assert_eq!(tally().0 + tally().1, collector.spans().len() as u64);
    collector.reject(-1);
    let before = tally();
    server.is_well().await;
    eventually("and the next", || tally() != before).await;
    assert!(tally().0 > before.0 && tally().1 == before.1);
}

/// A hosted collector: its certificate must lead to a root that is trusted here, and be for its
/// name.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn spans_go_by_tls_to_whom_is_trusted_and_to_nobody_else() {
    let (folder, other) = (Folder::new("collector"), Folder::new("collector-other"));
    let collector = Collector::start_tls(&folder.files(), "127.0.0.1").await;
    let elsewhere = Collector::start_tls(&folder.files(), "127.0.0.2").await;
    let port = collector.address().port();
    let run = async |address: String, roots: &Folder| {
        let mut command = mlswarp(&[
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--otlp-endpoint",
            &format!("https://{address}"),
            "--log-format",
            "json",
        ]);
        command
            .env("SSL_CERT_FILE", roots.files().cert)
            .env_remove("SSL_CERT_DIR");
        let program = Program::spawn(command);
        warp(&program).await;
        // Until a batch has been taken or refused, whichever it is.
        let began = Instant::now();
        let is_told = |metrics: String| {
            let counts = |line: &str| {
                line.strip_prefix("mlswarp_spans_exported_total ")
                    .or_else(|| line.strip_prefix("mlswarp_spans_dropped_total "))
                    != Some("0")
            };
            metrics
                .lines()
                .filter(|line| line.starts_with("mlswarp_spans_") && line.contains("_total "))
                .any(counts)
        };
        while !is_told(
            Client::new()
                .get(format!("http://{}/metrics", program.address))
                .send()
                .await
                .unwrap()
                .text()
                .await
                .unwrap(),
        ) {
            assert!(began.elapsed() < Duration::from_secs(60), "no batch leaves");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let log = ends(program).await;
        log.iter().filter(|line| line["level"] == "WARN").count()
    };
    // Not trusted; trusted, and of another name.
    assert_eq!(
        (
            run(collector.address().to_string(), &other).await,
            collector.spans().len()
        ),
        (1, 0)
    );
    assert_eq!(
        (
            run(elsewhere.address().to_string(), &folder).await,
            elsewhere.spans().len()
        ),
        (1, 0)
    );
    for host in ["127.0.0.1", "localhost"] {
        let before = collector.spans().len();
        assert_eq!(run(format!("{host}:{port}"), &folder).await, 0, "{host}");
        assert!(
            collector.spans().len() > before && collector.named("POST /warp").is_some(),
            "{host}"
        );
    }
    // Without a root nothing could ever be sent: that is said at the start.
    let none = Scratch::new().path("none.pem");
    let mut command = mlswarp(&[
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--otlp-endpoint",
        &format!("https://127.0.0.1:{port}"),
    ]);
    let ended = command
        .env("SSL_CERT_FILE", none)
        .env_remove("SSL_CERT_DIR")
        .output()
        .unwrap();
    let said = String::from_utf8(ended.stderr).unwrap();
    assert!(
        !ended.status.success() && said.contains("SSL_CERT_FILE"),
        "{said}"
    );
}
