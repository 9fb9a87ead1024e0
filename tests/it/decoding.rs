//! Files of a few bytes that claim much work: each is answered promptly with the fault that it has,
//! and clients beside those who send them are served. What files cost is counted elsewhere
//! (`codec::tests::work`, `tests/counts`); here it is the program that answers.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::{Value, json};

use crate::support::bombs::{webp_alpha_transforms, webp_transforms};
use crate::support::program::Program;
use crate::support::server::{form, header, png, problem};
use crate::support::{Server, bombs, photo};

const WARP: &str = r#"{"p": [[2, 2]], "q": [[5, 3]]}"#;

/// Repeated transforms: their names, and the smallest bound on an answer that a loaded machine
/// never misses. Walked symbol by symbol the first took 0.4 s, the second 14 s, and what goes over
/// the limits four to five times as long.
fn attacks() -> [(&'static str, Vec<u8>, u16, &'static str); 5] {
    [
        (
            "30 transforms",
            webp_transforms(16_384, 3_000, 30),
            422,
            "bad_image",
        ),
        (
            "1000 transforms",
            webp_transforms(16_384, 3_000, 1_000),
            422,
            "bad_image",
        ),
        (
            "1000 transforms of 268 MP",
            webp_transforms(16_384, 16_384, 1_000),
            413,
            "too_large",
        ),
        (
            "alpha of 30 transforms",
            webp_alpha_transforms(16_383, 3_000, 30),
            422,
            "bad_image",
        ),
        (
            "alpha of 1000 transforms",
            webp_alpha_transforms(16_383, 3_000, 1_000),
            422,
            "bad_image",
        ),
    ]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn repeated_transforms_are_refused_at_once() {
    let server = Server::start(&[]).await;
    for (name, file, status, code) in attacks() {
        let began = Instant::now();
        let answer = server
            .post("/warp")
            .multipart(form(&file, WARP))
            .send()
            .await
            .unwrap();
        let took = began.elapsed();
        println!(
            "{name}, {} bytes: {:.1} ms",
            file.len(),
            took.as_secs_f64() * 1e3
        );
        let document = problem(answer, status, code).await;
        if status == 422 {
            assert!(
                document["detail"].as_str().unwrap().contains("twice"),
                "{document}"
            );
        }
        assert!(took < Duration::from_secs(5), "{name}: {took:?}");
    }
    server.is_well().await;
}

/// Uploads one after the other until `until`; how long each took.
async fn innocent(client: &Client, url: &str, until: Instant) -> Vec<Duration> {
    let mut waits = Vec::new();
    while Instant::now() < until {
        // Never the same file twice: it is decoded each time.
        let file = [photo(64, 48), waits.len().to_le_bytes().to_vec()].concat();
        let began = Instant::now();
        png(client
            .post(url)
            .multipart(form(&file, WARP))
            .send()
            .await
            .unwrap())
        .await;
        waits.push(began.elapsed());
    }
    waits.sort_unstable();
    waits
}

fn p99(waits: &[Duration]) -> f64 {
    waits[(waits.len() * 99).div_ceil(100) - 1].as_secs_f64() * 1e3
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_upload_beside_two_attackers_is_answered() {
    let program = Arc::new(Program::start(&["--workers", "2"]));
    let url = format!("http://{}/warp", program.address);
    let client = Client::new();
    let alone = innocent(&client, &url, Instant::now() + Duration::from_secs(1)).await;
    let (stop, sent) = (
        Arc::new(AtomicBool::new(false)),
        Arc::new(AtomicUsize::new(0)),
    );
    let busy = busy_time(&program);
    let attackers: Vec<_> = (0..2)
        .map(|n| {
            let (url, stop, sent) = (url.clone(), Arc::clone(&stop), Arc::clone(&sent));
            tokio::spawn(async move {
                // Gone after 0.3 s, whether or not there is an answer.
                let client = Client::builder()
                    .timeout(Duration::from_millis(300))
                    .build()
                    .unwrap();
                while !stop.load(Ordering::Relaxed) {
                    let file = if n == 0 {
                        webp_transforms(16_384, 3_000, 1_000)
                    } else {
                        webp_alpha_transforms(16_383, 3_000, 1_000)
                    };
                    // No file is that of another request: none waits for what another has begun.
                    let file = [
                        file,
                        sent.fetch_add(1, Ordering::Relaxed).to_le_bytes().to_vec(),
                    ]
                    .concat();
                    if let Ok(answer) = client.post(&url).multipart(form(&file, WARP)).send().await
                    {
                        assert_eq!(answer.status(), 422);
                    }
                    tokio::time::sleep(Duration::from_millis(20)).await;
                }
            })
        })
        .collect();
    let beside = innocent(&client, &url, Instant::now() + Duration::from_secs(3)).await;
    stop.store(true, Ordering::Relaxed);
    for attacker in attackers {
        attacker.await.unwrap();
    }
    let busy = busy_time(&program).saturating_sub(busy);
    println!(
        "an innocent upload: p99 {:.1} ms of {} answers alone, {:.1} ms of {} beside two \
            attackers (the bar: 100 ms), who sent {} files; \
         the program was busy for {busy} ms of 3 s",
        p99(&alone),
        alone.len(),
        p99(&beside),
        beside.len(),
        sent.load(Ordering::Relaxed),
    );
    assert!(beside.len() >= 3, "{beside:?}");
    assert!(
        beside
            .last()
            .is_some_and(|longest| *longest < Duration::from_secs(5)),
        "{beside:?}"
    );
}

/// Processor time of the program, ms.
fn busy_time(program: &Program) -> u64 {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", program.id())).unwrap();
    let fields: Vec<&str> = stat
        .rsplit(')')
        .next()
        .unwrap()
        .split_whitespace()
        .collect();
    // User and system time, in ticks of 10 ms.
    10 * (fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap())
}

/// A profile that cannot be read is dropped, and every picture that is drawn from its file says so.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_dropped_profile_is_a_warning_of_every_picture() {
    let server = Server::start(&[]).await;
    let mut file = photo(24, 16);
    let data = file.windows(4).position(|kind| kind == b"IDAT").unwrap() - 4;
    let profile = bombs::png(&[(b"iCCP", b"name\0\0not a profile".to_vec())]).split_off(8);
    file.splice(data..data, profile);
    let warp = json!({"p": [[2, 2], [9, 9]], "q": [[3, 2], [9, 9]]});
    let warned = |response: &reqwest::Response| {
        assert_eq!(header(response, "warp-warning"), "profile_dropped")
    };
    let answer = server.upload("/warp", &file, &warp).await;
    warned(&answer);
    png(answer).await;
    let session = server.session(&file, &warp).await;
    let drag = server
        .post(&format!("/sessions/{session}/warp"))
        .json(&json!({"q": [[4, 4], [9, 9]]}))
        .send()
        .await
        .unwrap();
    warned(&drag);
    png(drag).await;
    // A mesh has no colours.
    let mesh = server
        .post(&format!("/sessions/{session}/mesh"))
        .json(&json!({"q": [[4, 4], [9, 9]]}))
        .send()
        .await
        .unwrap();
    assert_eq!(
        (mesh.status().as_u16(), mesh.headers().get("warp-warning")),
        (200, None)
    );
    let plain: Value = warp;
    let answer = server.upload("/warp", &photo(24, 16), &plain).await;
    assert!(answer.headers().get("warp-warning").is_none());
}
