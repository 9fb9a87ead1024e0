//! What the stores take for one operation, one after the other, and what a start with a thousand
//! sessions takes. Redis is Debian's `redis-server` on the loopback, keeping nothing. Printed, not
//! kept: a disk's time says little about another disk.

#![allow(
    missing_docs,
    unreachable_pub,
    dead_code,
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a program that prints a table"
)]

#[path = "../it/support/redis.rs"]
mod redis;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Digest, Folds, OutputSpec, RestSpec};
use mlswarp_server::client::Owner;
use mlswarp_server::session::{Revision, SessionId};
use mlswarp_server::store::{NamedFile, Record, Store, StoreLimits, StoreUrl, open};

const SESSIONS: usize = 1000;
const FILE: usize = 300 << 10;
const BOUNDS: StoreLimits = StoreLimits {
    idle: Duration::from_secs(900),
    sessions: 10_000,
    bytes: 8 << 30,
};

fn made(k: usize) -> (Arc<Record>, Bytes) {
    let file: Bytes = (0..FILE)
        .map(|byte| u8::try_from((byte ^ k ^ (byte >> 8)) & 255).unwrap())
        .chain(k.to_le_bytes())
        .collect();
    let p = (0..12)
        .map(|n| Handle::Point(Point::new(f64::from(n) * 10.3, 20.7)))
        .collect();
    let record = Record {
        id: SessionId::random(Owner::ANYBODY),
        revision: Revision::random(),
        image: Digest::of(&file),
        layers: BTreeMap::new(),
        made_with_region: None,
        extent: Extent::new(500, 500).unwrap(),
        rest: RestSpec {
            p,
            ..RestSpec::default()
        }
        .into(),
        pose: None,
        folds: Folds::default(),
        output: OutputSpec::default(),
        created: SystemTime::now(),
    };
    (Arc::new(record), file)
}

/// Median and 99th percentile.
fn tell(store: &str, what: &str, mut times: Vec<Duration>) {
    times.sort_unstable();
    println!(
        "{store:8} {what:28} {:>10.1?} {:>10.1?}",
        times[times.len() / 2],
        times[times.len() * 99 / 100]
    );
}

async fn measure(name: &str, store: &dyn Store, all: &[(Arc<Record>, Bytes)]) {
    let mut times = [(); 5].map(|()| Vec::new());
    let timed = |times: &mut Vec<Duration>, began: Instant| times.push(began.elapsed());
    for (record, file) in all {
        let began = Instant::now();
        store
            .put(
                Arc::clone(record),
                vec![NamedFile {
                    digest: record.image,
                    bytes: file.clone(),
                }],
            )
            .await
            .unwrap();
        timed(&mut times[0], began);
    }
    for (seq, (record, _)) in (0..).zip(all) {
        let began = Instant::now();
        store.touch(record.id, Some(seq)).await.unwrap();
        timed(&mut times[1], began);
        let began = Instant::now();
        store.peek(record.id).await.unwrap();
        timed(&mut times[2], began);
        let began = Instant::now();
        store.file(record.id, record.image).await.unwrap();
        timed(&mut times[3], began);
        let began = Instant::now();
        let next = Arc::new(Record {
            revision: Revision::random(),
            ..(**record).clone()
        });
        store
            .revise(record.revision, next, None)
            .await
            .unwrap()
            .unwrap();
        timed(&mut times[4], began);
    }
    let what = [
        "put, a file of 300 KiB",
        "touch, a step of a drag",
        "peek",
        "image, 300 KiB",
        "revise, 12 handles",
    ];
    for (what, times) in what.into_iter().zip(times) {
        tell(name, what, times);
    }
}

fn main() {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    let all: Vec<_> = (0..SESSIONS).map(made).collect();
    let path = std::env::current_dir()
        .unwrap()
        .join(format!("target/bench-store-{}.db", std::process::id()));
    let server = redis::Redis::start(&[]);
    println!(
        "{SESSIONS} sessions, one at a time{:14} {:>10} {:>10}",
        "", "median", "99 %"
    );
    for (name, place) in [
        ("memory", "memory".to_owned()),
        ("file", format!("file:{}", path.display())),
        ("Redis", server.address()),
    ] {
        let place: StoreUrl = place.parse().unwrap();
        runtime
            .block_on(async { measure(name, open(&place, BOUNDS).unwrap().as_ref(), &all).await });
    }
    // The store is closed on a thread that may still be at it.
    std::thread::sleep(Duration::from_secs(1));
    let size = std::fs::metadata(&path).unwrap().len();
    let held = SESSIONS * (FILE + 8);
    println!(
        "file     {size} bytes for {held} bytes of pictures: {:.2}",
        size as f64 / held as f64
    );
    let began = Instant::now();
    let store = open(&StoreUrl::File(path.clone()), BOUNDS).unwrap();
    println!(
        "file     start with {} sessions, every picture checked: {:.1?}",
        store.figures().sessions,
        began.elapsed()
    );
    drop(store);
    std::fs::remove_file(&path).unwrap();
}
