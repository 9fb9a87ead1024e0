//! Batches beside requests that replace the layers they draw: a batch has the layers of one moment,
//! or 503. A living session is never answered 404. On every store, with caches that hold almost
//! nothing, so that files are read again and again.

use std::io::{Cursor, Read as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use serde_json::json;

use crate::support::picture::{decoded, png};
use crate::support::redis::Redis;
use crate::support::server::form;
use crate::support::{Scratch, Server, is_full};

const SIZE: (u32, u32) = (64, 48);

/// Numbers of versions of a layer.
const VERSIONS: u8 = 32;

/// A version of a layer: one grey value, apart from those of the others by more than is lost where
/// it is blended with itself.
fn grey(version: u8) -> Vec<u8> {
    png(
        SIZE.0,
        SIZE.1,
        ::png::ColorType::Rgb,
        &[version * 8].repeat(3 * (SIZE.0 * SIZE.1) as usize),
    )
}

/// The versions of the layers in the archive of one frame.
fn versions(archive: &[u8], layers: &[&str]) -> Vec<u8> {
    let mut archive = zip::ZipArchive::new(Cursor::new(archive)).unwrap();
    let mut version = |layer: &&str| {
        let mut bytes = Vec::new();
        archive
            .by_name(&format!("0000.{layer}.png"))
            .unwrap()
            .read_to_end(&mut bytes)
            .unwrap();
        (decoded(&bytes).samples[0] + 4) / 8
    };
    layers.iter().map(&mut version).collect()
}

async fn batches_beside_writers(store: &str) {
    let server = Arc::new(
        Server::start(&[
            "--store",
            store,
            "--image-cache-bytes",
            "1KiB",
            "--workers",
            "2",
        ])
        .await,
    );
    let opened = server
        .post("/sessions")
        .multipart(form(&grey(9), json!({"p": [[5, 5], [50, 40]]}).to_string()))
        .send()
        .await
        .unwrap();
    let id = opened.json::<serde_json::Value>().await.unwrap()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let put = async |server: &Server, id: &str, layer: &str, version: u8| {
        let request = server
            .client
            .put(server.url(&format!("/sessions/{id}/layers/{layer}")))
            .body(grey(version));
        request.send().await.unwrap().status().as_u16()
    };
    for layer in ["first", "second", "third", "region"] {
        assert_eq!(put(&server, &id, layer, VERSIONS - 1).await, 201);
    }
    let (over, written) = (
        Arc::new(AtomicBool::new(false)),
        Arc::new(AtomicU32::new(0)),
    );
    // One writes the first layer and then the second, so that the first is never behind; the other
    // writes the third and the mask.
    let write = |layers: [&'static str; 2]| {
        let (server, id, over, written) = (
            Arc::clone(&server),
            id.clone(),
            Arc::clone(&over),
            Arc::clone(&written),
        );
        tokio::spawn(async move {
            for version in (0..VERSIONS).cycle() {
                for layer in layers {
                    let status = put(&server, &id, layer, version).await;
                    assert!([200, 503].contains(&status), "{layer}: {status}");
                    // Refused: the next version would be ahead of the other layer.
                    while status == 503 && put(&server, &id, layer, version).await != 200 {}
                }
                written.fetch_add(1, Ordering::Relaxed);
                if over.load(Ordering::Relaxed) {
                    return;
                }
            }
        })
    };
    let writers = [write(["first", "second"]), write(["third", "region"])];
    let (began, span) = (
        Instant::now(),
        Duration::from_secs(if is_full() { 10 } else { 2 }),
    );
    let layers = ["first", "second", "third"];
    let (mut drawn, mut refused) = (0, 0);
    while began.elapsed() < span || drawn < 5 {
        assert!(
            began.elapsed() < 20 * span,
            "{store}: {drawn} batches, {refused} were refused"
        );
        let body = json!({"frames": [{"q": [[5, 5], [50, 40]]}], "layers": layers,
            "output": {"holes": "keep"}});
        let response = server
            .post(&format!("/sessions/{id}/batch"))
            .json(&body)
            .send()
            .await
            .unwrap();
        let status = response.status().as_u16();
        let bytes = response.bytes().await.unwrap();
        if status == 503 {
            refused += 1;
            continue;
        }
        assert_eq!(status, 200, "{store}: {}", String::from_utf8_lossy(&bytes));
        let [first, second, _] = versions(&bytes, &layers)[..] else {
            panic!("three layers")
        };
        assert!(
            [0, 1].contains(&((first + VERSIONS - second) % VERSIONS)),
            "{store}: {first} and {second} were never there together"
        );
        drawn += 1;
        // The files of layers are read in the same way.
        let file = server
            .get(&format!("/sessions/{id}/layers/third"))
            .send()
            .await
            .unwrap();
        assert!(
            [200, 503].contains(&file.status().as_u16()),
            "{store}: {}",
            file.status()
        );
        // And the mask, which decides on a canvas that shows everything.
        for path in ["points", "report"] {
            let mut body = json!({"q": [[5, 5], [50, 47]], "output": {"canvas": "fit"}});
            if path == "points" {
                body["points"] = json!([[20, 20]]);
            }
            let path = format!("/sessions/{id}/{path}");
            let answer = server.post(&path).json(&body).send().await.unwrap();
            let status = answer.status().as_u16();
            let text = answer.text().await.unwrap();
            assert!([200, 503].contains(&status), "{store}: {path}: {text}");
        }
    }
    over.store(true, Ordering::Relaxed);
    for writer in writers {
        writer.await.unwrap();
    }
    let written = written.load(Ordering::Relaxed);
    eprintln!(
        "{store}: {drawn} batches beside {written} pairs of new layers, {refused} were refused"
    );
    assert!(written >= 5, "{store}: {written}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_has_the_layers_of_one_moment() {
    let (scratch, redis) = (Scratch::new(), Redis::start(&[]));
    for store in [
        "memory".to_owned(),
        format!("file:{}", scratch.path("sessions.db")),
        redis.address(),
    ] {
        batches_beside_writers(&store).await;
    }
}
