//! Work that no client waits for any more, and the sets of handles that cost the most: the program
//! is sent both, and an innocent client drags meanwhile. Its p99 and the time for which a worker
//! stays busy after its client has left are printed beside the bar (`--nocapture`). Asserted is
//! only that the work ends long before it would be done.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use reqwest::{Client, RequestBuilder, Response};
use serde_json::{Value, json};

use crate::support::counters::Counted as _;
use crate::support::healthy::Healthy;
use crate::support::program::Program;
use crate::support::server::{blend_form, form, header, problem};
use crate::support::{Server, bombs, photo};

/// Work ends within this after its last client has left or at its deadline: what the service
/// promises, on an idle machine.
const BAR: Duration = Duration::from_millis(50);
/// What a busy machine and a program without optimisation may make of that.
const COARSE: Duration = Duration::from_secs(2);
/// The work takes several times `COARSE` when it is not stopped.
const SIDES: (u32, u32) = (640, 400);

struct Victim {
    program: Program,
    client: Client,
}

impl Victim {
    fn start(options: &[&str]) -> Self {
        Self {
            program: Program::start(
                &[
                    &[
                        "--workers",
                        "2",
                        "--log",
                        "off,mlswarp_server::http::connection=info",
                    ],
                    options,
                ]
                .concat(),
            ),
            client: Client::new(),
        }
    }

    fn address(&self) -> SocketAddr {
        self.program.address
    }

    fn post(&self, path: &str) -> RequestBuilder {
        self.client.post(format!("http://{}{path}", self.address()))
    }

    /// Requests that decode, fill tables or weigh rows now.
    async fn busy(&self) -> u64 {
        let text = self
            .client
            .get(format!("http://{}/metrics", self.address()))
            .send()
            .await
            .unwrap()
            .text()
            .await
            .unwrap();
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix("mlswarp_workers_busy{work=\"upload\"} "))
            .unwrap();
        line.parse().unwrap()
    }

    /// Waits until as many requests are worked on; how long that took.
    async fn until_busy(&self, workers: u64, what: &str) -> Duration {
        let began = Instant::now();
        while self.busy().await != workers {
            assert!(
                began.elapsed() < Duration::from_secs(60),
                "{what}: never {workers} busy"
            );
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        began.elapsed()
    }

    /// Sends a request, leaves while it is worked on, and waits until no worker is busy.
    async fn leaves(&self, what: &str, request: RequestBuilder) {
        let well = Healthy::begin(self.address()).await;
        let sending = tokio::spawn(request.send());
        self.until_busy(1, what).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert!(
            !sending.is_finished() && self.busy().await == 1,
            "{what}: too little work to leave it: {:?}",
            sending.await
        );
        sending.abort();
        let busy = self.until_busy(0, what).await;
        eprintln!(
            "{what}: busy for {:.1} ms after its client left, bar {BAR:?}",
            busy.as_secs_f64() * 1e3
        );
        assert!(busy < COARSE, "{what}: {busy:?}");
        well.end(what).await;
    }

    async fn session(&self, warp: &Value) -> String {
        let response = self
            .post("/sessions")
            .multipart(form(&photo(SIDES.0, SIDES.1), warp.to_string()))
            .send()
            .await
            .unwrap();
        assert_eq!(response.status(), 201);
        response.json::<Value>().await.unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned()
    }
}

/// An alpha near 1.5, at which moments of segments have no closed form.
const SLOW_ALPHA: f64 = 1.4997;

/// Segments that are weighed by quadrature at [`SLOW_ALPHA`]: a tenth of a millisecond a vertex and
/// more.
fn slow_lines(count: u32) -> Vec<[[f64; 2]; 2]> {
    let line = |k: u32| {
        let (x, y) = (
            f64::from(k % 20) * 30.0 + 10.25,
            f64::from(k / 20) * 35.0 + 8.75,
        );
        [[x, y], [x + 21.0, y + f64::from(k % 7) * 3.0]]
    };
    (0..count).map(line).collect()
}

fn moved(lines: &[[[f64; 2]; 2]]) -> Vec<[[f64; 2]; 2]> {
    lines
        .iter()
        .map(|line| line.map(|[x, y]| [x + 2.0, y - 3.0]))
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn work_ends_when_its_client_leaves() {
    // 25,000 vertices of 200 columns: a table of 60 MB, as large as may be.
    let victim = Victim::start(&["--max-plan-bytes", "64MiB"]);
    let lines = slow_lines(100);
    let warp = |cell: f64| {
        json!({"p": lines, "q": moved(&lines), "alpha": SLOW_ALPHA,
        "grid": {"cell": cell}})
    };
    let picture = photo(SIDES.0, SIDES.1);
    victim
        .leaves(
            "a plan at the byte limit",
            victim
                .post("/warp")
                .multipart(form(&picture, warp(3.2).to_string())),
        )
        .await;
    victim
        .leaves(
            "a grid without a table",
            victim
                .post("/warp")
                .multipart(form(&picture, warp(1.0).to_string())),
        )
        .await;
    // A session is made without posing anything; its table would not fit.
    let id = victim
        .session(&json!({"p": lines, "alpha": SLOW_ALPHA, "grid": "pixel"}))
        .await;
    let q = json!({"q": moved(&lines)});
    victim
        .leaves(
            "a drag without a table",
            victim.post(&format!("/sessions/{id}/warp")).json(&q),
        )
        .await;
    let mesh = victim
        .post(&format!("/sessions/{id}/mesh"))
        .header("accept", "application/octet-stream");
    victim.leaves("a mesh without a table", mesh.json(&q)).await;
    let places: Vec<[f64; 2]> = (0..40_000_u32)
        .map(|k| [f64::from(k % 200) * 3.2, f64::from(k / 200) * 2.0])
        .collect();
    let points = json!({"p": lines, "q": moved(&lines), "alpha": SLOW_ALPHA, "points": places,
        "extent": [SIDES.0, SIDES.1]});
    victim
        .leaves("many places", victim.post("/points").json(&points))
        .await;
    let points = json!({"q": moved(&lines), "points": places});
    // 11 MB of empty blocks before the data: they are read and yield nothing.
    let slow = bombs::png_behind_blocks(2000, bombs::EmptyBlock::Dynamic, 900_000);
    victim
        .leaves(
            "a decode",
            victim
                .post("/warp")
                .multipart(form(&slow, r#"{"p": [[1, 1]], "q": [[2, 2]]}"#)),
        )
        .await;
    victim
        .leaves(
            "many places of a session",
            victim.post(&format!("/sessions/{id}/points")).json(&points),
        )
        .await;
}

/// A blend takes its images one after another: a client that leaves after ten of them stops it.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_blend_ends_when_its_client_leaves() {
    let victim = Victim::start(&["--max-body-bytes", "256MiB"]);
    let decoded = async || {
        let text = victim
            .client
            .get(format!("http://{}/metrics", victim.address()))
            .send();
        let text = text.await.unwrap().text().await.unwrap();
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix("mlswarp_cache_builds_total{cache=\"images\"} "));
        line.unwrap().parse::<u64>().unwrap()
    };
    let files: Vec<Vec<u8>> = (0..80).map(|k| photo(600 + k, 400)).collect();
    let places = |k: u32| {
        json!([
            [50, 50],
            [550 - k, 60],
            [300, 200 + k],
            [80, 350],
            [520, 340]
        ])
    };
    let entry = |k: u32| json!({"image": k, "p": places(k)});
    let entries: Vec<Value> = (0..80).map(entry).collect();
    let parts: Vec<&[u8]> = files.iter().map(|file| &**file).collect();
    let request = victim
        .post("/blend")
        .multipart(blend_form(&parts, &json!({"images": entries})));
    let sending = tokio::spawn(request.send());
    while decoded().await < 10 {
        assert!(!sending.is_finished(), "{:?}", sending.await);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    sending.abort();
    let (left, mut last) = (Instant::now(), Duration::ZERO);
    // Between two images no worker is busy.
    while left.elapsed() < last + Duration::from_millis(500) {
        if victim.busy().await > 0 {
            last = left.elapsed();
        }
    }
    eprintln!(
        "a blend: busy for {:.1} ms after its client left, bar {BAR:?}",
        last.as_secs_f64() * 1e3
    );
    assert!(last < COARSE && decoded().await < 60, "{last:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_shared_plan_is_finished_for_the_client_that_stays() {
    let victim = Victim::start(&["--max-plan-bytes", "512MiB"]);
    // A second of work and more, of which the first client sees a tenth.
    let lines = slow_lines(100);
    let (picture, warp) = (
        photo(SIDES.0, SIDES.1),
        json!({"p": lines, "q": moved(&lines), "alpha": SLOW_ALPHA, "grid": {"cell": 2}})
            .to_string(),
    );
    // Each with a connection of its own.
    let send = || {
        tokio::spawn(
            Client::new()
                .post(format!("http://{}/warp", victim.address()))
                .multipart(form(&picture, warp.clone()))
                .send(),
        )
    };
    let first = send();
    victim.until_busy(1, "the first").await;
    let (second, third) = (send(), send());
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert!(!first.is_finished(), "too little work to leave it");
    first.abort();
    third.abort();
    let answer = second.await.unwrap().unwrap();
    assert_eq!(answer.status(), 200, "{:?}", answer.text().await);
    victim.until_busy(0, "nobody").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn work_ends_at_its_deadline() {
    let victim = Victim::start(&["--max-plan-bytes", "64MiB", "--request-timeout", "300ms"]);
    let lines = slow_lines(100);
    let warp = json!({"p": lines, "q": moved(&lines), "alpha": SLOW_ALPHA, "grid": {"cell": 1.0}});
    let request = victim
        .post("/warp")
        .multipart(form(&photo(SIDES.0, SIDES.1), warp.to_string()));
    let answer = request.send().await.unwrap();
    let busy = victim.until_busy(0, "the deadline").await;
    assert_eq!(header(&answer, "retry-after"), "1");
    problem(answer, 503, "overloaded").await;
    eprintln!(
        "busy for {:.1} ms after the deadline, bar {BAR:?}",
        busy.as_secs_f64() * 1e3
    );
    assert!(busy < COARSE, "{busy:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn newer_drags_do_not_stop_the_plan_that_all_of_them_need() {
    let server = Server::start(&["--workers", "1"]).await;
    let lines = slow_lines(60);
    let id = server
        .session(
            &photo(SIDES.0, SIDES.1),
            &json!({"p": lines, "alpha": SLOW_ALPHA, "grid": {"cell": 8}}),
        )
        .await;
    server.app.clear_caches();
    let built = || server.app.counters().plans_built;
    let before = built();
    let drag = |seq: u64| {
        tokio::spawn(
            server
                .post(&format!("/sessions/{id}/warp"))
                .json(&json!({"seq": seq, "q": moved(&lines)}))
                .send(),
        )
    };
    let mut drags = vec![drag(1)];
    // One after the other while the plan is built: the only worker stays with the build, and the
    // newest drag gets the picture.
    for seq in 2..20 {
        tokio::time::sleep(Duration::from_millis(20)).await;
        drags.push(drag(seq));
    }
    let mut statuses = Vec::new();
    for drag in drags {
        statuses.push(drag.await.unwrap().unwrap().status().as_u16());
    }
    assert_eq!(statuses.pop(), Some(200), "{statuses:?}");
    assert!(
        statuses.iter().all(|status| [200, 409].contains(status)),
        "{statuses:?}"
    );
    assert_eq!(built() - before, 1);
}

/// A problem or not: how a request was answered, and how long that took.
async fn answered(what: &str, request: RequestBuilder) -> Response {
    let began = Instant::now();
    let answer = request.send().await.unwrap();
    eprintln!(
        "{what}: {} after {:.1} ms",
        answer.status(),
        began.elapsed().as_secs_f64() * 1e3
    );
    answer
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn handles_that_crowd_keep_nobody_waiting() {
    let victim = Victim::start(&[]);
    let share = |k: u32| f64::from(k.wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
    let lines = |line: &dyn Fn(f64) -> [[f64; 2]; 2]| {
        (0..5000)
            .map(|k| json!(line(f64::from(k))))
            .collect::<Vec<_>>()
    };
    let sets: [(&str, Vec<Value>, u16); 6] = [
        (
            "10,000 points within 1 px",
            (0..10_000)
                .map(|k| json!([100.0 + 0.7 * share(k), 100.0 + 0.7 * share(k ^ 0x5bd1)]))
                .collect(),
            200,
        ),
        (
            "10,000 points at one place",
            (0..10_000).map(|_| json!([3, 4])).collect(),
            200,
        ),
        (
            "10,000 points of one x",
            (0..10_000).map(|k| json!([7, 400.0 * share(k)])).collect(),
            200,
        ),
        (
            "5,000 parallel lines",
            lines(&|k| [[0.0, 0.01 * k], [400.0, 80.0 + 0.01 * k]]),
            200,
        ),
        (
            "5,000 rays",
            lines(&|k| {
                [
                    [300.0 + 9.0 * k.cos(), 300.0 + 9.0 * k.sin()],
                    [300.0 + 200.0 * k.cos(), 300.0 + 200.0 * k.sin()],
                ]
            }),
            200,
        ),
        (
            "5,000 lines that all cross",
            lines(&|k| [[0.0, 0.08 * k], [400.0, 400.0 - 0.08 * k]]),
            413,
        ),
    ];
    let well = Healthy::begin(victim.address()).await;
    for (name, p, status) in sets {
        let body = json!({"p": p, "q": p, "points": [[50, 50]], "extent": [640, 400]});
        let answer = answered(name, victim.post("/points").json(&body)).await;
        assert_eq!(
            answer.status().as_u16(),
            status,
            "{name}: {}",
            answer.text().await.unwrap()
        );
    }
    well.end("handles that crowd").await;
}

/// Handles at both ends of each column of a grid, and one target for both: no cell covers anything,
/// and the border jumps to and fro across the picture.
fn chaotic(columns: u32) -> Value {
    let (width, height) = (f64::from(SIDES.0), f64::from(SIDES.1));
    let share = |k: u32| f64::from(k.wrapping_mul(2_654_435_761)) / f64::from(u32::MAX);
    let ends = |k: u32| [0.0, height].map(|y| [width * f64::from(k) / f64::from(columns - 1), y]);
    let p: Vec<[f64; 2]> = (0..columns).flat_map(ends).collect();
    let q: Vec<[f64; 2]> = (0..columns)
        .flat_map(|k| [[width * share(k), height * share(k ^ 0x5bd1)]; 2])
        .collect();
    json!({"p": p, "q": q, "alpha": 2, "grid": {"columns": columns, "rows": 2}})
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_chaotic_border_is_painted_and_is_given_up_when_its_client_leaves() {
    let victim = Victim::start(&[]);
    let request = |columns: u32, output: Value| {
        let mut warp = chaotic(columns);
        warp["output"] = output;
        victim
            .post("/warp")
            .multipart(form(&photo(SIDES.0, SIDES.1), warp.to_string()))
    };
    let well = Healthy::begin(victim.address()).await;
    for columns in [200, 2000] {
        for outside in ["transparent", "edge"] {
            let name = format!("a border that jumps to and fro {columns} times, {outside} outside");
            let answer = answered(
                &name,
                request(columns, json!({"outside": outside, "compression": "none"})),
            )
            .await;
            assert_eq!(answer.status(), 200, "{}", answer.text().await.unwrap());
            assert!(!answer.bytes().await.unwrap().is_empty());
        }
    }
    well.end("chaotic borders").await;
    // A format that is not sent in strips: the head of the response follows the whole picture.
    let large = request(
        2000,
        json!({"outside": "edge", "format": "webp", "width": 4000}),
    );
    victim
        .leaves("a large picture with a chaotic border", large)
        .await;
}
