//! A thousand poses at 512 x 512: one batch against as many single requests on one connection, in
//! turns, from the service in a process of its own with two workers. Then the memory of the
//! service, and the time from the client's leaving after a hundred frames until the service
//! computes nothing any more. Printed, not kept.
//!
//! `cargo bench --bench batch`

#![allow(
    missing_docs,
    unreachable_pub,
    dead_code,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    reason = "a program that prints a table"
)]

#[path = "request/client.rs"]
mod client;
#[path = "harness/mod.rs"]
mod harness;
#[path = "request/service.rs"]
mod service;

use std::time::Instant;

use client::Client;
use harness::pictures::{bytes, encode, extent, handles, photograph};
use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::pixmap::Channels;
use service::{Service, places};

const SIDES: (u32, u32) = (512, 512);
const FRAMES: usize = 1000;
const ROUNDS: usize = 3;

/// The sum of a metric's samples whose names begin so.
fn metric(client: &mut Client, service: &Service, name: &str) -> f64 {
    let (mut text, address) = (Vec::new(), service.address);
    client.send(
        format!("GET /metrics HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes(),
        |bytes| text.extend_from_slice(bytes),
    );
    let text = String::from_utf8(text).expect("text");
    let samples = text.lines().filter_map(|line| {
        line.strip_prefix(name)?
            .rsplit(' ')
            .next()?
            .parse::<f64>()
            .ok()
    });
    samples.sum()
}

fn main() {
    let service = Service::start();
    let extent = extent(SIDES);
    let mut file = Vec::new();
    encode(
        extent,
        Channels::Rgb,
        bytes(&photograph(extent, Channels::Rgb)),
        (png::Compression::Fastest, None),
        &mut file,
    );
    let (rest, target) = handles(12, extent, 1.0);
    let pose = |k: usize| -> String {
        let t = (k as f64 / 50.0).sin();
        let between =
            |(p, q): (&Point, &Point)| Point::new(p.x + t * (q.x - p.x), p.y + t * (q.y - p.y));
        let handle = |(p, q): (&Handle, &Handle)| between((&p.places()[0], &q.places()[0]));
        places(
            &rest
                .iter()
                .zip(&target)
                .map(handle)
                .map(Handle::Point)
                .collect::<Vec<_>>(),
        )
    };
    let mut client = Client::connect(service.address);
    let session = service.session(
        &mut client,
        &file,
        &format!(r#"{{"p": {}}}"#, places(&rest)),
    );
    let json = "application/json";
    let singles: Vec<Vec<u8>> = (0..FRAMES)
        .map(|k| {
            service.post(
                &format!("{session}/warp"),
                json,
                format!(r#"{{"q": {}}}"#, pose(k)).as_bytes(),
            )
        })
        .collect();
    let frames: Vec<String> = (0..FRAMES)
        .map(|k| format!(r#"{{"q": {}}}"#, pose(k)))
        .collect();
    let batch = service.post(
        &format!("{session}/batch"),
        json,
        format!(r#"{{"frames": [{}]}}"#, frames.join(",")).as_bytes(),
    );

    let (mut ratios, mut size) = (Vec::new(), 0);
    for round in 0..=ROUNDS {
        let began = Instant::now();
        singles
            .iter()
            .for_each(|single| client.send(single, |_| {}));
        let one_by_one = began.elapsed();
        let before = metric(&mut client, &service, "mlswarp_memory_resident_bytes");
        let began = Instant::now();
        size = 0;
        client.send(&batch, |bytes| size += bytes.len());
        let together = began.elapsed();
        let after = metric(&mut client, &service, "mlswarp_memory_resident_bytes");
        // The first round fills caches.
        if round > 0 {
            let rate = |time: std::time::Duration| FRAMES as f64 / time.as_secs_f64();
            let ratio = one_by_one.as_secs_f64() / together.as_secs_f64();
            let grown = (after - before) / f64::from(1 << 20);
            println!(
                "{:.0} single requests a second, {:.0} frames of a batch a second: {ratio:.2} \
                    times as many (goal 1.3); {:.0} MiB resident, {grown:+.1} MiB by a batch of \
                    {} MB",
                rate(one_by_one),
                rate(together),
                after / f64::from(1 << 20),
                size / 1_000_000,
            );
            ratios.push(ratio);
        }
    }
    ratios.sort_unstable_by(f64::total_cmp);
    println!("median {:.2}", ratios[ROUNDS / 2]);

    for _ in 0..5 {
        use std::io::{Read as _, Write as _};
        let mut stream =
            std::net::TcpStream::connect(service.address).expect("the service listens");
        stream.write_all(&batch).expect("the service reads");
        let (mut piece, mut taken) = (vec![0; 64 << 10], 0);
        while taken < size / 10 {
            taken += stream.read(&mut piece).expect("the service answers");
        }
        let began = Instant::now();
        drop(stream);
        while metric(&mut client, &service, "mlswarp_workers_busy") > 0.0 {}
        let stopped = began.elapsed();
        let started = metric(
            &mut client,
            &service,
            "mlswarp_pictures_total{state=\"started\"}",
        );
        std::thread::sleep(std::time::Duration::from_millis(50));
        let later = metric(
            &mut client,
            &service,
            "mlswarp_pictures_total{state=\"started\"}",
        );
        println!(
            "left after {} frames: no work after {:.1} ms (goal 50), {} more later",
            FRAMES / 10,
            stopped.as_secs_f64() * 1e3,
            later - started
        );
    }
}
