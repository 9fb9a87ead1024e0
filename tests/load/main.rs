//! Four times the load that this machine can hold, for a minute: uploads and drags, more of both
//! than there is room for. Nobody is left without an answer, memory stays within its account, and
//! when the crowd has gone everything is as it was. What is measured is printed; of speed nothing
//! is asserted but that bounds hold ten times over.

#![expect(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
#![expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "figures for people"
)]

#[expect(dead_code, reason = "shared with the integration tests")]
#[path = "../it/support/program.rs"]
mod program;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use program::Program;
use reqwest::multipart::{Form, Part};
use reqwest::{Client, Response};
use serde_json::{Value, json};

const SESSIONS: usize = 24;
/// The program's account, bytes, and what it takes beside.
const ACCOUNT: u64 = 256 << 20;
const BESIDE_BYTES: u64 = 96 << 20;
/// What a client may wait for a frame that is made; asserted ten times over.
const DRAG_P99: Duration = Duration::from_millis(300);
/// How soon all is well again; asserted ten times over.
const RECOVERY: Duration = Duration::from_secs(2);

fn long() -> bool {
    std::env::var_os("MLSWARP_TESTS_FULL").is_some_and(|value| value == "1")
}

/// Answers of one kind.
#[derive(Default)]
struct Answers {
    by_status: Mutex<BTreeMap<u16, u64>>,
    /// Of those that were served.
    times: Mutex<Vec<Duration>>,
    unanswered: AtomicU64,
    wrong: AtomicU64,
}

impl Answers {
    /// Waits for the whole answer.
    async fn note(&self, began: Instant, sent: Result<Response, reqwest::Error>) {
        let Ok(response) = sent else {
            self.unanswered.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let status = response.status().as_u16();
        let retry = response.headers().contains_key("retry-after");
        let is_png = response
            .headers()
            .get("content-type")
            .is_some_and(|value| value == "image/png");
        let Ok(body) = response.bytes().await else {
            self.unanswered.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let right = match status {
            200 => is_png && body.starts_with(b"\x89PNG") && body.ends_with(b"IEND\xaeB`\x82"),
            503 => retry && body.starts_with(b"{"),
            _ => false,
        };
        self.wrong.fetch_add(u64::from(!right), Ordering::Relaxed);
        if status == 200 {
            self.times.lock().unwrap().push(began.elapsed());
        }
        *self.by_status.lock().unwrap().entry(status).or_default() += 1;
    }

    fn served(&self) -> u64 {
        self.by_status
            .lock()
            .unwrap()
            .get(&200)
            .copied()
            .unwrap_or_default()
    }

    fn p(&self, percent: usize) -> Duration {
        let mut times = self.times.lock().unwrap();
        times.sort_unstable();
        times
            .get(times.len().saturating_sub(1) * percent / 100)
            .copied()
            .unwrap_or_default()
    }
}

/// The clients, all in this process.
#[derive(Clone)]
struct Crowd {
    client: Client,
    url: Arc<str>,
    file: Arc<[u8]>,
    sessions: Arc<Vec<String>>,
}

fn handles(shift: f64) -> Value {
    json!([
        [168.0 + shift, 112],
        [316.0 + shift, 136],
        [262, 240.0 - shift],
        [[0, 300], [451, 300]]
    ])
}

impl Crowd {
    /// A new file every time: what follows a picture's end is not read, but makes it another file.
    fn upload(&self, n: u64) -> Form {
        let file = [&self.file, &n.to_le_bytes()[..]].concat();
        Form::new().part("image", Part::bytes(file).file_name("picture"))
    }

    async fn warp(self, n: u64, answers: Arc<Answers>) {
        let warp = json!({"p": handles(0.0), "q": handles((n % 40) as f64)}).to_string();
        let began = Instant::now();
        let sent = self
            .client
            .post(format!("{}/warp", self.url))
            .multipart(self.upload(n).text("warp", warp))
            .send()
            .await;
        answers.note(began, sent).await;
    }

    async fn drag(self, n: u64, answers: Arc<Answers>) {
        let id = &self.sessions[n as usize % SESSIONS];
        let began = Instant::now();
        let q = json!({"q": handles((n % 97) as f64 / 3.0)});
        let sent = self
            .client
            .post(format!("{}/sessions/{id}/warp", self.url))
            .json(&q)
            .send()
            .await;
        answers.note(began, sent).await;
    }

    async fn new_session(&self, n: u64) -> String {
        let form = self
            .upload(n)
            .text("warp", json!({"p": handles(0.0)}).to_string());
        let response = self
            .client
            .post(format!("{}/sessions", self.url))
            .multipart(form)
            .send()
            .await
            .unwrap();
        assert_eq!(response.status(), 201);
        response.json::<Value>().await.unwrap()["id"]
            .as_str()
            .unwrap()
            .to_owned()
    }

    /// Answers per second if clients ask again as soon as they are answered: of drags, of uploads.
    async fn capacity(&self) -> (f64, f64) {
        let (drags, uploads, over) = (
            Arc::new(Answers::default()),
            Arc::new(Answers::default()),
            Arc::new(AtomicBool::new(false)),
        );
        let spell = Duration::from_secs(4);
        let clients = (0..4_u64).map(|k| {
            let (crowd, drags, uploads, over) = (
                self.clone(),
                Arc::clone(&drags),
                Arc::clone(&uploads),
                Arc::clone(&over),
            );
            tokio::spawn(async move {
                for n in (k * 1_000_000).. {
                    if over.load(Ordering::Relaxed) {
                        return;
                    }
                    if k < 2 {
                        crowd.clone().drag(n, Arc::clone(&drags)).await
                    } else {
                        crowd.clone().warp(n, Arc::clone(&uploads)).await
                    }
                }
            })
        });
        let clients: Vec<_> = clients.collect();
        tokio::time::sleep(spell).await;
        over.store(true, Ordering::Relaxed);
        for client in clients {
            client.await.unwrap();
        }
        let rate = |answers: &Answers| answers.served() as f64 / spell.as_secs_f64();
        (rate(&drags), rate(&uploads))
    }
}

/// Starts `work` `rate` times a second without waiting for what was started; at the end, waits for
/// all.
async fn storm<F: Future<Output = ()> + Send + 'static>(
    rate: f64,
    spell: Duration,
    mut work: impl FnMut(u64) -> F,
) -> u64 {
    let (began, mut begun, mut tasks) = (Instant::now(), 0, tokio::task::JoinSet::new());
    while began.elapsed() < spell {
        while (begun as f64) < began.elapsed().as_secs_f64() * rate {
            tasks.spawn(work(begun));
            begun += 1;
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
        while tasks.try_join_next().is_some() {}
    }
    while let Some(ended) = tasks.join_next().await {
        ended.unwrap();
    }
    begun
}

/// A line of `/proc/PID/status`, bytes.
fn memory(pid: u32, name: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with(name)).unwrap();
    line.split_whitespace()
        .nth(1)
        .unwrap()
        .parse::<u64>()
        .unwrap()
        << 10
}

/// Processor time of this process.
fn processor_time() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat
        .rsplit_once(')')
        .unwrap()
        .1
        .split_whitespace()
        .collect();
    // A tick is a hundredth of a second on every Linux that Rust knows.
    Duration::from_millis(
        10 * (fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()),
    )
}

#[tokio::test(flavor = "current_thread")]
async fn four_times_what_the_machine_holds() {
    let program = Program::start(&[
        "--memory-bytes",
        "256MiB",
        "--max-client-share",
        "100",
        "--log",
        "warn,mlswarp_server::http::connection=info",
    ]);
    let file = std::fs::read(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../tests/images/chelsea.png"
    ))
    .unwrap();
    let client = Client::builder()
        .timeout(Duration::from_secs(100))
        .build()
        .unwrap();
    let url: Arc<str> = format!("http://{}", program.address).into();
    let mut crowd = Crowd {
        client,
        url,
        file: file.into(),
        sessions: Arc::default(),
    };
    let mut sessions = Vec::new();
    for n in 0..SESSIONS as u64 {
        sessions.push(crowd.new_session(u64::MAX - n).await);
    }
    crowd.sessions = Arc::new(sessions);

    let (drag_rate, upload_rate) = crowd.capacity().await;
    println!(
        "held: {drag_rate:.0} drags/s and {upload_rate:.0} uploads/s at once; four times that \
            follows"
    );
    let before = memory(program.id(), "VmRSS");

    let spell = Duration::from_secs(if long() { 600 } else { 60 });
    let (drags, uploads) = (Arc::new(Answers::default()), Arc::new(Answers::default()));
    let (over, pid) = (Arc::new(AtomicBool::new(false)), program.id());
    let watch = std::thread::spawn({
        let over = Arc::clone(&over);
        move || {
            let mut curve = Vec::new();
            while !over.load(Ordering::Relaxed) {
                curve.push(memory(pid, "VmRSS"));
                std::thread::sleep(Duration::from_millis(250));
            }
            curve
        }
    });
    let (began, spent) = (Instant::now(), processor_time());
    let dragging = storm(4.0 * drag_rate, spell, |n| {
        crowd.clone().drag(n, Arc::clone(&drags))
    });
    let uploading = storm(4.0 * upload_rate, spell, |n| {
        crowd.clone().warp(n, Arc::clone(&uploads))
    });
    let health = async {
        let mut slowest = Duration::ZERO;
        while began.elapsed() < spell {
            let asked = Instant::now();
            assert_eq!(
                crowd
                    .client
                    .get(format!("{}/healthz", crowd.url))
                    .send()
                    .await
                    .unwrap()
                    .status(),
                200
            );
            slowest = slowest.max(asked.elapsed());
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        slowest
    };
    let (drags_begun, uploads_begun, slowest_health) = tokio::join!(dragging, uploading, health);
    let client_share = (processor_time() - spent).as_secs_f64() / began.elapsed().as_secs_f64();

    // Everybody has gone: every session is served at once.
    let recovered = Instant::now();
    for n in 0..SESSIONS as u64 {
        loop {
            let after = Arc::new(Answers::default());
            crowd.clone().drag(n, Arc::clone(&after)).await;
            assert_eq!(
                after.unanswered.load(Ordering::Relaxed) + after.wrong.load(Ordering::Relaxed),
                0
            );
            if after.served() == 1 {
                break;
            }
            assert!(recovered.elapsed() < 10 * RECOVERY, "not well again");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
    assert_eq!(
        crowd
            .client
            .get(format!("{}/readyz", crowd.url))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
    let recovered = recovered.elapsed();
    over.store(true, Ordering::Relaxed);
    let curve = watch.join().unwrap();
    let most = curve.iter().copied().max().unwrap();
    let after = memory(program.id(), "VmRSS");

    for (name, answers, begun) in [
        ("drags", &drags, drags_begun),
        ("uploads", &uploads, uploads_begun),
    ] {
        let statuses = answers.by_status.lock().unwrap().clone();
        println!(
            "{name}: {begun} sent, answers {statuses:?}, served in p50 {:.0} ms, p99 {:.0} ms",
            answers.p(50).as_secs_f64() * 1e3,
            answers.p(99).as_secs_f64() * 1e3
        );
        assert_eq!(
            answers.unanswered.load(Ordering::Relaxed),
            0,
            "{name} without an answer"
        );
        assert_eq!(
            answers.wrong.load(Ordering::Relaxed),
            0,
            "{name} with an answer that no server gives"
        );
        assert_eq!(statuses.values().sum::<u64>(), begun);
        assert!(answers.served() > 0);
    }
    let mib = |bytes: u64| bytes >> 20;
    println!(
        "resident: {} MiB before, at most {} during, {} after (account {}); slowest health check \
            {:.0} ms; clients took {client_share:.2} of a processor; \
         well again after {:.0} ms",
        mib(before),
        mib(most),
        mib(after),
        mib(ACCOUNT),
        slowest_health.as_secs_f64() * 1e3,
        recovered.as_secs_f64() * 1e3
    );
    assert!(drags.p(99) < 10 * DRAG_P99);
    assert!(most < ACCOUNT + BESIDE_BYTES, "{most} bytes are resident");
}
