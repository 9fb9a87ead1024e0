//! Hostile pictures through the running program: damaged files of every kind that is read, and
//! bombs. Whatever is sent, the answer is a picture or a problem document of the client's fault,
//! memory stays within what the options allow, and the server goes on.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use reqwest::Client;
use serde_json::Value;

use crate::mutation::{Dice, damaged_picture, files};
use crate::support::program::Program;
use crate::support::server::{form, png};
use crate::support::{bombs, photo};

/// Requests under way at one time.
const CLIENTS: usize = 4;
/// Codes that a picture's file may be answered with.
const CODES: [&str; 3] = ["bad_image", "too_large", "unsupported_format"];
/// What the options below let pictures take: two caches, and in each of two workers a picture of 2
/// MP with all that decoding it takes (16 bytes a pixel and the tables of prefix codes).
const MAX_BYTES: u64 = (32 + 8 + 2 * (32 + 128)) << 20;
const OPTIONS: [&str; 10] = [
    "--workers",
    "2",
    "--image-cache-bytes",
    "32MiB",
    "--plan-cache-bytes",
    "8MiB",
    "--max-image-pixels",
    "2M",
    "--log-format",
    "json",
];

/// Sends a file; says with which status it was answered.
async fn sent(client: &Client, program: &Program, dice: &mut Dice, file: &[u8], what: &str) -> u16 {
    let path = if dice.one_in(10) { "sessions" } else { "warp" };
    let warp = *dice.pick(&[
        r#"{"p": [], "q": []}"#,
        r#"{"p": [[2, 2], [20, 9]], "q": [[5, 3], [20, 9]]}"#,
        r#"{"p": [[2, 2]], "q": [[5, 3]], "output": {"format": "webp"}}"#,
        r#"{"p": [[2, 2]], "q": [[5, 3]], "output": {"format": "jpeg", "width": 100}}"#,
    ]);
    let url = format!("http://{}/{path}", program.address);
    let response = client
        .post(url)
        .multipart(form(file, warp))
        .send()
        .await
        .unwrap_or_else(|e| panic!("{what}: no answer: {e}"));
    let status = response.status().as_u16();
    let media_type = response.headers()["content-type"]
        .to_str()
        .unwrap()
        .to_owned();
    let body = response
        .bytes()
        .await
        .unwrap_or_else(|e| panic!("{what}: half an answer: {e}"));
    match status {
        200 => assert!(
            media_type.starts_with("image/") && !body.is_empty(),
            "{what}"
        ),
        201 => {
            let session: Value = serde_json::from_slice(&body).unwrap();
            let url = format!(
                "http://{}/sessions/{}",
                program.address,
                session["id"].as_str().unwrap()
            );
            assert_eq!(client.delete(url).send().await.unwrap().status(), 204);
        }
        400..500 => {
            assert_eq!(media_type, "application/problem+json", "{what}");
            let problem: Value = serde_json::from_slice(&body).unwrap();
            assert!(
                CODES.contains(&problem["code"].as_str().unwrap()),
                "{what}: {problem}"
            );
        }
        _ => panic!("{what}: {status} {}", String::from_utf8_lossy(&body)),
    }
    status
}

/// A line of /proc/PID/status in KiB, as bytes.
fn memory(program: &Program, line: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.id())).unwrap();
    let kib = status
        .lines()
        .find_map(|l| l.strip_prefix(line))
        .unwrap()
        .trim_start_matches(':')
        .trim()
        .trim_end_matches(" kB");
    kib.parse::<u64>().unwrap() << 10
}

async fn well(client: &Client, program: &Program) {
    let warp = r#"{"p": [[2, 2]], "q": [[5, 3]]}"#;
    png(client
        .post(format!("http://{}/warp", program.address))
        .multipart(form(&photo(16, 12), warp))
        .send()
        .await
        .unwrap())
    .await;
    assert_eq!(
        client
            .get(format!("http://{}/readyz", program.address))
            .send()
            .await
            .unwrap()
            .status(),
        200
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn damaged_pictures_are_answered_and_leave_the_server_well() {
    let count = if std::env::var_os("MLSWARP_TESTS_FULL").is_some() {
        60_000
    } else {
        8_000
    };
    let program = Arc::new(Program::start(&OPTIONS));
    let client = Client::new();
    well(&client, &program).await;
    let before = memory(&program, "VmHWM");
    let mut zoo = files("seeds/image");
    zoo.extend(files("found/image"));
    let (zoo, next) = (Arc::new(zoo), Arc::new(AtomicUsize::new(0)));
    let clients = (0..CLIENTS).map(|_| {
        let (client, program, zoo, next) = (
            client.clone(),
            Arc::clone(&program),
            Arc::clone(&zoo),
            Arc::clone(&next),
        );
        tokio::spawn(async move {
            let mut answers = BTreeMap::new();
            loop {
                let n = next.fetch_add(1, Ordering::Relaxed);
                if n >= count {
                    return answers;
                }
                // The n-th file is the same in every run and on every thread.
                let mut dice = Dice::new(n as u64);
                let (name, seed) = &zoo[n % zoo.len()];
                let (_, other) = dice.pick(&zoo);
                let file = damaged_picture(&mut dice, seed, other);
                let kind = name.split('-').next().unwrap_or_default().to_owned();
                let status = sent(
                    &client,
                    &program,
                    &mut dice,
                    &file,
                    &format!("{name}, damaged by {n}"),
                )
                .await;
                *answers.entry((kind, status)).or_insert(0_usize) += 1;
            }
        })
    });
    let mut answers = BTreeMap::new();
    for client in clients.collect::<Vec<_>>() {
        for (key, n) in client.await.unwrap() {
            *answers.entry(key).or_insert(0) += n;
        }
    }
    well(&client, &program).await;
    let peak = memory(&program, "VmHWM");
    println!(
        "{count} damaged pictures: {answers:?}; VmHWM {} MiB, {} MiB before",
        peak >> 20,
        before >> 20
    );
    assert!(peak < before + MAX_BYTES, "{peak} bytes, {before} before");
    for kind in ["png", "jpeg", "webp"] {
        let of = |statuses: &[u16]| {
            answers
                .iter()
                .filter(|((k, s), _)| k == kind && statuses.contains(s))
                .map(|(_, n)| n)
                .sum::<usize>()
        };
        assert!(
            of(&[200, 201]) > count / 100,
            "{kind}: damage that is read reaches the pixels: {answers:?}"
        );
        assert!(
            of(&[422]) > count / 20,
            "{kind}: damage is noticed: {answers:?}"
        );
    }
    let program = Arc::into_inner(program).expect("every client has ended");
    program.terminate();
    let (status, log) = program.wait();
    assert_eq!(status.code(), Some(0), "{log}");
    println!(
        "{} panics of decoders were caught",
        log.matches("panicked at").count()
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bombs_take_no_more_than_their_size_allows() {
    let tables = files("found/image")
        .into_iter()
        .find(|(name, _)| name == "webp-code-tables")
        .unwrap()
        .1;
    let client = Client::new();
    let mut dice = Dice::new(0);
    // The default limits: 50 MP.
    let program = Program::start(&["--workers", "2"]);
    well(&client, &program).await;
    let before = memory(&program, "VmHWM");
    for (name, file, statuses) in bombs::all(&tables) {
        let status = sent(&client, &program, &mut dice, &file, name).await;
        let statuses: Vec<u16> = statuses
            .iter()
            .flat_map(|&s| if s == 200 { vec![200, 201] } else { vec![s] })
            .collect();
        assert!(statuses.contains(&status), "{name}: {status}");
    }
    let peak = memory(&program, "VmHWM");
    println!(
        "bombs: VmHWM {} MiB, {} MiB before",
        peak >> 20,
        before >> 20
    );
    // Nothing of these is a large picture: what is held is the file itself, a few times.
    assert!(peak < before + (64 << 20), "{peak} bytes, {before} before");
    well(&client, &program).await;
}
