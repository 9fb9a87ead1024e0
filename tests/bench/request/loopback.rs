//! `POST /sessions/{id}/warp` over loopback: the service in a process of its own, the clients in
//! this one, on the same cores. In between the same drags are made in process, so that both come
//! from the same minutes.

use std::net::SocketAddr;
use std::time::Duration;

use mlswarp::pixmap::Channels;

use crate::client::{Client, Load};
use crate::drag::{Drag, GRID, file};
use crate::harness::pictures::{FULL_HD, SMALL, UHD, VERTICES, extent, photograph, size};
use crate::harness::{self, Goal, Report, Times, inside, pool, time};
use crate::service::{Service, places};

const HANDLES: usize = 12;
/// Rounds of: in process, then each number of connections.
const ROUNDS: usize = 6;

pub fn tables(report: &mut Report) {
    for (sides, connections, in_process, seconds) in [
        (SMALL, &[1, 2, 32][..], 31, 0.8),
        (FULL_HD, &[1], 11, 1.0),
        (UHD, &[1], 5, 1.6),
    ] {
        let title = format!("loopback, {}, {HANDLES} handles", size(extent(sides)));
        if harness::wanted(&title) {
            table(
                report,
                &title,
                sides,
                connections,
                in_process,
                Duration::from_secs_f64(seconds),
            );
        }
    }
}

fn table(
    report: &mut Report,
    title: &str,
    sides: (u32, u32),
    connections: &[usize],
    samples: usize,
    seconds: Duration,
) {
    let service = Service::start();
    let file = file(&photograph(extent(sides), Channels::Rgba));
    let mut drags = [
        Drag::of_file(&file, HANDLES, GRID),
        Drag::of_file(&file, HANDLES, GRID),
    ];
    // Each connection has its session, as if each were a user; they share the picture and the plan.
    let most = connections.iter().copied().max().unwrap_or(1);
    let mut clients: Vec<_> = (0..most)
        .map(|_| open(&service, &file, &drags[0]))
        .collect();
    check(&mut clients, &mut drags[0]);

    let (one, two) = (pool(1), pool(2));
    let [a, b] = &mut drags;
    let mut in_process = [
        inside(&one, "1 thread", || a.picture(0)),
        inside(&two, "2 threads", || b.picture(1)),
    ];
    let (mut ones, mut twos) = (Vec::new(), Vec::new());
    let mut loads: Vec<Load> = connections.iter().map(|_| Load::default()).collect();
    let mut floor = Load::default();
    for _ in 0..ROUNDS {
        let times = harness::times(samples, &mut in_process);
        ones.extend(times[0].samples());
        twos.extend(times[1].samples());
        floor.add(Load::run(
            &mut [(
                Client::connect(service.address),
                vec![ready(service.address)],
            )],
            Duration::from_millis(100),
        ));
        for (&connections, load) in connections.iter().zip(&mut loads) {
            load.add(Load::run(&mut clients[..connections], seconds));
        }
    }

    let (one, two) = (Times::new(ones), Times::new(twos));
    let mut text = format!("## {title}\n\n| what | p50 | p99 | a second |\n|---|---:|---:|---:|\n");
    let mut row = |what: &str, times: &Times, rate: f64| {
        text += &format!(
            "| {what} | {} | {} | {rate:.0} |\n",
            time(times.median()),
            time(times.quantile(0.99))
        );
    };
    row("in process, 1 thread", &one, 1.0 / one.median());
    row("in process, 2 threads", &two, 1.0 / two.median());
    let rate = floor.latencies.len() as f64 / floor.elapsed;
    row(
        "`GET /readyz`, 1 connection",
        &Times::new(floor.latencies),
        rate,
    );
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as f64;
    for (&connections, load) in connections.iter().zip(loads) {
        let rate = load.latencies.len() as f64 / load.elapsed;
        let times = Times::new(load.latencies);
        row(
            &format!("`POST /sessions/{{id}}/warp`, {connections} connection(s)"),
            &times,
            rate,
        );
        let what = format!(
            "loopback, {}, {connections} connection(s)",
            size(extent(sides))
        );
        match (connections, sides) {
            (1, SMALL) => report.goal(
                &format!("{what}: p50 / 2 threads in process"),
                times.median() / two.median(),
                Goal::AtMost(1.9),
            ),
            (1, _) => report.goal(
                &format!("{what}: p50 / 2 threads in process"),
                times.median() / two.median(),
                Goal::AtMost(1.5),
            ),
            (2, _) => {
                report.goal(
                    &format!("{what}: a second x 1 thread in process / cores"),
                    rate * one.median() / cores,
                    Goal::AtLeast(0.7),
                );
            }
            (n, _) => {
                report.goal(
                    &format!("{what}: p99 x throughput / connections"),
                    times.quantile(0.99) * rate / n as f64,
                    Goal::AtMost(2.0),
                );
            }
        }
    }
    report.line(&text);
}

/// The service draws what is drawn in process, byte for byte.
fn check(clients: &mut [(Client, Vec<Vec<u8>>)], drag: &mut Drag) {
    for (client, requests) in clients {
        let mut answer = Vec::new();
        client.send(&requests[0], |bytes| answer.extend_from_slice(bytes));
        assert!(
            answer == drag.file_of(0),
            "the same q gives the same file over loopback"
        );
    }
}

fn ready(address: SocketAddr) -> Vec<u8> {
    format!("GET /readyz HTTP/1.1\r\nHost: {address}\r\n\r\n").into_bytes()
}

/// A connection, and the drags of a session of its own.
fn open(service: &Service, file: &[u8], drag: &Drag) -> (Client, Vec<Vec<u8>>) {
    let warp = format!(
        r#"{{"p": {}, "grid": {{"columns": {VERTICES}, "rows": {VERTICES}}}}}"#,
        places(&drag.rest)
    );
    let mut client = Client::connect(service.address);
    let path = format!("{}/warp", service.session(&mut client, file, &warp));
    let drags = drag.poses.iter().map(|q| {
        service.post(
            &path,
            "application/json",
            format!(r#"{{"q":{}}}"#, places(q)).as_bytes(),
        )
    });
    (client, drags.collect())
}
