//! A long mixed day in short: random requests of every route, valid and not, with uploads and
//! answers that are dropped midway, sockets that come and go, sessions that are deleted, replaced
//! and forgotten. What is resident when it is quiet again must be what was resident after a shorter
//! time of the same: nothing is kept of requests that have ended.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use futures_util::{SinkExt as _, StreamExt as _};
use reqwest::{Client, Method, Response};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;

use crate::mutation::{Dice, damaged, damaged_picture, files};
use crate::support::photo;
use crate::support::program::Program;
use crate::support::server::form;

/// Clients at one time.
const CLIENTS: u64 = 4;
/// Sessions that are dragged; older ones are left to expire.
const SESSIONS: usize = 24;
/// What may stay more after a period of load, as a part of what stayed before, what the caches keep
/// left out.
const GROWTH: f64 = 0.05;
/// Periods of load, of which one must end within that. Holes between what is kept come and go by
/// some MiB; what leaks is more after every one.
const PERIODS: u64 = 5;
/// Seconds for which it must be still: longer than the program waits before it gives memory back,
/// and than sessions live.
const STILL: u32 = 6;
/// Longest wait for one answer.
const PATIENCE: Duration = Duration::from_secs(60);

const OPTIONS: [&str; 18] = [
    "--workers",
    "2",
    "--session-idle",
    "3s",
    "--max-sessions",
    "40",
    "--store-bytes",
    "8MiB",
    "--image-cache-bytes",
    "24MiB",
    "--plan-cache-bytes",
    "16MiB",
    "--max-sockets",
    "8",
    // All clients of this test have one address.
    "--max-client-share",
    "100",
    "--log",
    "off,mlswarp_server::http::connection=info",
];

/// What the clients share.
struct Day {
    program: Program,
    client: Client,
    sessions: Mutex<Vec<String>>,
    /// Files that are read, with their sides.
    pictures: Vec<(Vec<u8>, [f64; 2])>,
    zoo: Vec<(String, Vec<u8>)>,
    answers: Mutex<BTreeMap<(&'static str, u16), usize>>,
}

impl Day {
    fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.program.address)
    }

    fn resident(&self) -> u64 {
        let status =
            std::fs::read_to_string(format!("/proc/{}/status", self.program.id())).unwrap();
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:"))
            .unwrap();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
    }

    /// What is resident at rest, and what of it the caches keep.
    async fn stayed(&self) -> (u64, u64) {
        let resident = rest(self).await;
        let url = format!("http://{}/metrics", self.program.address);
        let text = self
            .client
            .get(url)
            .send()
            .await
            .unwrap()
            .text()
            .await
            .unwrap();
        let samples = text
            .lines()
            .filter(|line| line.starts_with("mlswarp_memory_reserved_bytes{"));
        let kept = samples
            .map(|line| line.rsplit_once(' ').unwrap().1.parse::<u64>().unwrap())
            .sum::<u64>();
        (resident, kept)
    }

    fn session(&self, dice: &mut Dice) -> String {
        let sessions = self.sessions.lock().unwrap();
        if sessions.is_empty() || dice.one_in(20) {
            return "11111111-2222-4333-8444-555555555555".to_owned();
        }
        dice.pick(&sessions).clone()
    }

    fn remember(&self, id: String) {
        let mut sessions = self.sessions.lock().unwrap();
        sessions.push(id);
        if sessions.len() > SESSIONS {
            sessions.remove(0);
        }
    }

    /// Notes an answer; whatever it is, the server is not at fault.
    async fn note(&self, what: &'static str, response: reqwest::Result<Response>) -> Option<Value> {
        let response = response.unwrap_or_else(|e| panic!("{what}: no answer: {e}"));
        let status = response.status().as_u16();
        *self
            .answers
            .lock()
            .unwrap()
            .entry((what, status))
            .or_insert(0) += 1;
        let is_problem = response
            .headers()
            .get("content-type")
            .is_some_and(|kind| kind == "application/problem+json");
        let body = response
            .bytes()
            .await
            .unwrap_or_else(|e| panic!("{what}: half an answer: {e}"));
        assert!(
            status < 500 || status == 503,
            "{what}: {status} {}",
            String::from_utf8_lossy(&body)
        );
        assert_eq!(status >= 400, is_problem, "{what}: {status}");
        serde_json::from_slice(&body).ok()
    }
}

fn handles(dice: &mut Dice, [width, height]: [f64; 2], count: usize) -> Value {
    let mut place = || {
        json!([
            dice.below(1000) as f64 / 1000.0 * width,
            dice.below(1000) as f64 / 1000.0 * height
        ])
    };
    (0..count)
        .map(|n| {
            if n == 3 {
                json!([place(), place(), place()])
            } else {
                place()
            }
        })
        .collect()
}

/// The pose of every session: as many handles as `sessions` have, mostly.
fn posed(dice: &mut Dice) -> Value {
    let count = if dice.one_in(12) { dice.below(6) } else { 5 };
    handles(dice, [300.0, 200.0], count)
}

/// JSON, now and then damaged.
fn text(value: &Value, dice: &mut Dice) -> Vec<u8> {
    let text = value.to_string().into_bytes();
    if dice.one_in(8) {
        damaged(dice, &text, br#"[[1e999, null], {"p": -0.0}]"#)
    } else {
        text
    }
}

fn warp(dice: &mut Dice, sides: [f64; 2]) -> Value {
    let method = *dice.pick(&["rigid", "similarity", "affine"]);
    let (p, q) = (handles(dice, sides, 5), handles(dice, sides, 5));
    let mut warp = json!({"p": p, "q": q, "method": method});
    match dice.below(6) {
        0 => warp["grid"] = json!({"cell": 1 + dice.below(40)}),
        1 => warp["grid"] = json!("pixel"),
        2 => {
            warp["output"] = json!({"format": *dice.pick(&["jpeg", "webp", "png"]), "width": 1
                + dice.below(600)})
        }
        3 => warp["folds"] = json!("reject"),
        4 => warp["output"] = json!({"compression": "best"}),
        _ => {}
    }
    warp
}

async fn step(day: &Day, dice: &mut Dice) {
    let (picture, sides) = dice.pick(&day.pictures).clone();
    let id = day.session(dice);
    let request =
        |method: Method, path: &str| day.client.request(method, day.url(path)).timeout(PATIENCE);
    let json_post = |path: &str, body: Vec<u8>| {
        request(Method::POST, path)
            .header("content-type", "application/json")
            .body(body)
            .send()
    };
    match dice.below(20) {
        0 | 1 => {
            let body = String::from_utf8_lossy(&text(&warp(dice, sides), dice)).into_owned();
            drop(
                day.note(
                    "POST /warp",
                    request(Method::POST, "/warp")
                        .multipart(form(&picture, body))
                        .send()
                        .await,
                )
                .await,
            );
        }
        2 => {
            let (_, seed) = dice.pick(&day.zoo);
            let (_, other) = dice.pick(&day.zoo);
            let file = damaged_picture(dice, seed, other);
            drop(
                day.note(
                    "POST /warp, damaged",
                    request(Method::POST, "/warp")
                        .multipart(form(&file, r#"{"p": []}"#))
                        .send()
                        .await,
                )
                .await,
            );
        }
        3 | 4 => {
            let mut warp = warp(dice, sides);
            warp["p"] = handles(dice, sides, 5);
            let answer = request(Method::POST, "/sessions")
                .multipart(form(&picture, warp.to_string()))
                .send()
                .await;
            if let Some(session) = day
                .note("POST /sessions", answer)
                .await
                .and_then(|s| s["id"].as_str().map(str::to_owned))
            {
                day.remember(session);
            }
        }
        5 => {
            let id = format!("{:08x}-0000-4000-8000-000000000000", dice.below(30));
            let answer = request(Method::PUT, &format!("/sessions/{id}"))
                .multipart(form(&picture, warp(dice, sides).to_string()))
                .send();
            if day.note("PUT /sessions/{id}", answer.await).await.is_some() {
                day.remember(id);
            }
        }
        6..=9 => {
            let mut drag = json!({"q": posed(dice)});
            if dice.one_in(2) {
                drag["seq"] = json!(dice.below(50));
            }
            let body = text(&drag, dice);
            drop(
                day.note(
                    "POST /sessions/{id}/warp",
                    json_post(&format!("/sessions/{id}/warp"), body).await,
                )
                .await,
            );
        }
        10..=11 => {
            let body = text(&json!({"q": posed(dice)}), dice);
            drop(
                day.note(
                    "POST /sessions/{id}/mesh",
                    json_post(&format!("/sessions/{id}/mesh"), body).await,
                )
                .await,
            );
        }
        12 => {
            let body = text(
                &json!({"q": posed(dice), "points": handles(dice, sides, 3)}),
                dice,
            );
            drop(
                day.note(
                    "POST /sessions/{id}/points",
                    json_post(&format!("/sessions/{id}/points"), body).await,
                )
                .await,
            );
            let (p, q) = (handles(dice, sides, 5), handles(dice, sides, 5));
            let body = text(
                &json!({"extent": [300, 200], "p": p, "q": q, "points": handles(dice, sides, 3)}),
                dice,
            );
            drop(
                day.note("POST /points", json_post("/points", body).await)
                    .await,
            );
        }
        13 => {
            let body = text(&json!({"p": handles(dice, sides, 5)}), dice);
            let put = request(Method::PUT, &format!("/sessions/{id}/handles"))
                .header("content-type", "application/json");
            drop(
                day.note("PUT /sessions/{id}/handles", put.body(body).send().await)
                    .await,
            );
        }
        14 => {
            drop(
                day.note(
                    "DELETE /sessions/{id}",
                    request(Method::DELETE, &format!("/sessions/{id}"))
                        .send()
                        .await,
                )
                .await,
            );
        }
        15 => {
            let path = *dice.pick(&[
                "/",
                "/openapi.json",
                "/healthz",
                "/readyz",
                "/docs",
                "/nowhere",
                "/sessions/x",
                "/warp",
            ]);
            drop(
                day.note("GET", request(Method::GET, path).send().await)
                    .await,
            );
            drop(
                day.note(
                    "GET /sessions/{id}",
                    request(Method::GET, &format!("/sessions/{id}"))
                        .send()
                        .await,
                )
                .await,
            );
        }
        16 => half_upload(day, dice, &picture).await,
        17 => half_answer(day, dice, &picture).await,
        _ => socket(day, dice, &id).await,
    }
}

/// An upload that ends somewhere, mostly without a word.
async fn half_upload(day: &Day, dice: &mut Dice, picture: &[u8]) {
    let body = [
        b"--b\r\nContent-Disposition: form-data; \
            name=\"warp\"\r\n\r\n{\"p\": []}\r\n--b\r\nContent-Disposition: form-data; \
            name=\"image\"\r\n\r\n",
        picture,
        b"\r\n--b--\r\n",
    ]
    .concat();
    let path = *dice.pick(&["/warp", "/sessions"]);
    let head = format!(
        "POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; \
            boundary=b\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    let whole = [head.as_bytes(), &body].concat();
    let mut stream = TcpStream::connect(day.program.address).await.unwrap();
    // The server may have closed already.
    let _ = stream.write_all(&whole[..dice.below(whole.len())]).await;
    if dice.one_in(2) {
        tokio::time::sleep(Duration::from_millis(dice.below(30) as u64)).await;
    }
    *day.answers
        .lock()
        .unwrap()
        .entry(("half an upload", 0))
        .or_insert(0) += 1;
}

/// An answer that is not read to its end.
async fn half_answer(day: &Day, dice: &mut Dice, picture: &[u8]) {
    let body = form(
        picture,
        r#"{"p": [[5, 5]], "q": [[9, 7]], "output": {"width": 2000}}"#,
    );
    let mut response = day
        .client
        .post(day.url("/warp"))
        .timeout(PATIENCE)
        .multipart(body)
        .send()
        .await
        .unwrap();
    for _ in 0..dice.below(3) {
        let _ = response.chunk().await;
    }
    *day.answers
        .lock()
        .unwrap()
        .entry(("half an answer", response.status().as_u16()))
        .or_insert(0) += 1;
}

/// A socket that says a few things, right or wrong, acknowledges some of what comes, and goes with
/// or without a word.
async fn socket(day: &Day, dice: &mut Dice, id: &str) {
    let query = *dice.pick(&[
        "",
        "?frames=mesh",
        "?frames=jpeg&width=auto",
        "?frames=webp&width=64",
        "?frames=gif",
    ]);
    let stream = TcpStream::connect(day.program.address).await.unwrap();
    let url = format!("ws://{}/sessions/{id}/drag{query}", day.program.address);
    let Ok(opened) = tokio::time::timeout(PATIENCE, client_async(url, stream)).await else {
        panic!("a handshake has no answer")
    };
    let status = opened
        .as_ref()
        .map_or(0, |(_, response)| response.status().as_u16());
    *day.answers
        .lock()
        .unwrap()
        .entry(("GET /sessions/{id}/drag", status))
        .or_insert(0) += 1;
    let Ok((mut socket, _)) = opened else { return };
    for seq in 0..dice.below(12) {
        let message = match dice.below(6) {
            0 => Message::text(
                String::from_utf8_lossy(&text(&json!({"ack": seq}), dice)).into_owned(),
            ),
            1 => Message::binary(vec![7; dice.below(2000)]),
            _ => Message::text(
                String::from_utf8_lossy(&text(&json!({"seq": seq, "q": posed(dice)}), dice))
                    .into_owned(),
            ),
        };
        if socket.send(message).await.is_err() {
            return;
        }
        if let Ok(Some(Ok(Message::Binary(frame)))) =
            tokio::time::timeout(Duration::from_millis(20), socket.next()).await
        {
            let seq = u64::from_le_bytes(frame[..8].try_into().unwrap());
            let _ = socket
                .send(Message::text(json!({"ack": seq}).to_string()))
                .await;
        }
    }
    if dice.one_in(2) {
        let _ = socket.close(None).await;
    }
}

/// Load for a time. The curve: resident bytes, second by second.
async fn load(day: &Arc<Day>, seed: u64, time: Duration) -> Vec<u64> {
    let end = Instant::now() + time;
    let clients: Vec<_> = (0..CLIENTS)
        .map(|client| {
            let day = Arc::clone(day);
            tokio::spawn(async move {
                let mut dice = Dice::new(seed * CLIENTS + client);
                while Instant::now() < end {
                    step(&day, &mut dice).await;
                    // Other tests want the machine too.
                    tokio::time::sleep(Duration::from_millis(dice.below(10) as u64)).await;
                }
            })
        })
        .collect();
    let mut curve = Vec::new();
    while Instant::now() < end {
        tokio::time::sleep(Duration::from_secs(1)).await;
        curve.push(day.resident());
    }
    for client in clients {
        client.await.unwrap();
    }
    curve
}

/// What is resident when every session has expired, nothing is asked and what was begun has ended:
/// the same for some seconds.
async fn rest(day: &Day) -> u64 {
    let mut same = 0;
    let mut resident = day.resident();
    for _ in 0..60 {
        tokio::time::sleep(Duration::from_secs(1)).await;
        let now = day.resident();
        same = if now.abs_diff(resident) < resident / 100 {
            same + 1
        } else {
            0
        };
        resident = now;
        if same == STILL {
            break;
        }
    }
    // The caches may hold what they held; a request shows that the server goes on.
    let mut stream = TcpStream::connect(day.program.address).await.unwrap();
    stream
        .write_all(b"GET /readyz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        .await
        .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    day.resident()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_resident_after_a_long_time_was_resident_after_a_short_one() {
    let full = std::env::var_os("MLSWARP_TESTS_FULL").is_some();
    let (warming, time) = if full { (120, 480) } else { (10, 16) };
    let sizes = [(64, 48), (200, 150), (300, 200), (640, 480), (900, 700)];
    let day = Arc::new(Day {
        program: Program::start(&OPTIONS),
        client: Client::new(),
        sessions: Mutex::default(),
        pictures: sizes
            .into_iter()
            .map(|(w, h)| (photo(w, h), [f64::from(w), f64::from(h)]))
            .collect(),
        zoo: files("seeds/image"),
        answers: Mutex::default(),
    });
    let begun = day.resident();
    let first = load(&day, 1, Duration::from_secs(warming)).await;
    let mib = |bytes: &u64| bytes >> 20;
    println!(
        "resident, MiB: begun {}, warming {:?}",
        mib(&begun),
        first.iter().map(mib).collect::<Vec<_>>()
    );
    let mut before = day.stayed().await;
    let mut has_grown = true;
    for period in 0..PERIODS {
        let curve = load(&day, 2 + period, Duration::from_secs(time)).await;
        let after = day.stayed().await;
        println!("then {:?}", curve.iter().map(mib).collect::<Vec<_>>());
        println!(
            "at rest, KiB, and what caches keep of it: {} ({}) -> {} ({})",
            before.0 >> 10,
            before.1 >> 10,
            after.0 >> 10,
            after.1 >> 10
        );
        has_grown = (after.0 - after.1) as f64 > (before.0 - before.1) as f64 * (1.0 + GROWTH);
        if !has_grown {
            break;
        }
        before = after;
    }
    println!("answers: {:?}", day.answers.lock().unwrap());
    let (answers, served) = (
        day.answers.lock().unwrap().clone(),
        |what: &str, status: u16| {
            day.answers
                .lock()
                .unwrap()
                .iter()
                .any(|((w, s), _)| *w == what && *s == status)
        },
    );
    for (what, status) in [
        ("POST /warp", 200),
        ("POST /sessions", 201),
        ("POST /sessions/{id}/warp", 200),
        ("GET /sessions/{id}/drag", 101),
    ] {
        assert!(served(what, status), "{what} {status}: {answers:?}");
    }
    assert!(
        !has_grown,
        "more is resident after each of {PERIODS} periods"
    );
}
