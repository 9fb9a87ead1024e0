//! The drag socket under a recorded drag: 600 poses at 125 Hz in real time, the service in a
//! process of its own, clients and service on the same cores. A frame's age is the time between
//! sending its pose and having all of it. Best of three.
//!
//! `cargo bench --bench drag [-- FILTER]`; a filter is a part of a title (`1 client`, `8 clients`)
//! or of a row's name (`3840 x 2160`, `mesh`). A filter that begins with `links` runs the table of
//! links instead (`drag/links.rs`).

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    reason = "a program that prints a table"
)]

#[path = "request/client.rs"]
#[allow(dead_code, reason = "shared with `request`, which measures with it")]
mod client;
#[path = "harness/mod.rs"]
mod harness;
#[path = "drag/links.rs"]
mod links;
#[path = "drag/recording.rs"]
mod recording;
#[path = "../link/relay.rs"]
mod relay;
#[path = "request/service.rs"]
mod service;
#[path = "drag/socket.rs"]
mod socket;

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use client::Client;
use harness::pictures::{FULL_HD, UHD, bytes, encode, extent, handles, photograph, size};
use harness::{Goal, Report, Times, time};
use mlswarp::pixmap::{Channels, Pixmap};
use service::{Service, places};
use socket::{HEAD, PATIENCE, Run, ShownFrame, Socket, text};

const SQUARE: (u32, u32) = (512, 512);
const HANDLES: usize = 12;
const RUNS: usize = 3;
/// Before the first pose, so that every socket is open.
const BEFORE: Duration = Duration::from_millis(300);

/// Hands, the picture, the query, and the least frames a second.
type Case = (usize, (u32, u32), &'static str, Option<f64>);

const CASES: [Case; 12] = [
    (1, SQUARE, "frames=png", Some(100.0)),
    (1, SQUARE, "frames=jpeg", None),
    (1, SQUARE, "frames=mesh", Some(110.0)),
    (1, FULL_HD, "frames=png", None),
    (1, FULL_HD, "frames=png&width=1024", None),
    (1, UHD, "frames=png", Some(55.0)),
    (1, UHD, "frames=jpeg", None),
    (1, UHD, "frames=png&width=1024", None),
    (8, SQUARE, "frames=png", None),
    (8, SQUARE, "frames=mesh", None),
    (8, FULL_HD, "frames=png", None),
    (8, UHD, "frames=png", None),
];

/// A place in which the handles rest, and how a client drags them.
struct Scene {
    file: Vec<u8>,
    warp: String,
    /// As JSON, and as messages.
    q: Vec<String>,
    poses: Vec<Vec<u8>>,
    times: Vec<Duration>,
}

impl Scene {
    fn new(sides: (u32, u32)) -> Self {
        Self::of(&photograph(extent(sides), Channels::Rgb))
    }

    fn of(photo: &Pixmap) -> Self {
        let extent = photo.extent();
        let mut file = Vec::new();
        encode(
            extent,
            Channels::Rgb,
            bytes(photo),
            (png::Compression::Fastest, None),
            &mut file,
        );
        let (rest, target) = handles(HANDLES, extent, 1.0);
        let q: Vec<_> = recording::poses(&rest, &target, f64::from(extent.height()))
            .iter()
            .map(|q| places(q))
            .collect();
        let poses = (0..)
            .zip(&q)
            .map(|(seq, q): (u64, _)| text(&format!(r#"{{"seq":{seq},"q":{q}}}"#)))
            .collect();
        Self {
            file,
            warp: format!(r#"{{"p": {}}}"#, places(&rest)),
            q,
            poses,
            times: recording::times(),
        }
    }

    /// Runs `clients` clients at once, each on a session of its own.
    fn run(&self, service: &Service, clients: usize, query: &str) -> Vec<Run> {
        let mut client = Client::connect(service.address);
        let paths: Vec<String> = (0..clients)
            .map(|_| {
                format!(
                    "{}/drag?{query}",
                    service.session(&mut client, &self.file, &self.warp)
                )
            })
            .collect();
        let start = Instant::now() + BEFORE;
        let runs = std::thread::scope(|scope| {
            let clients: Vec<_> = paths
                .iter()
                .map(|path| scope.spawn(move || self.client(service, path, start)))
                .collect();
            clients
                .into_iter()
                .map(|client| client.join().expect("the last pose is shown"))
                .collect()
        });
        for path in paths {
            let session = path.split("/drag").next().unwrap_or_default();
            client.send(
                format!(
                    "DELETE {session} HTTP/1.1\r\nHost: {}\r\n\r\n",
                    service.address
                )
                .as_bytes(),
                |_| {},
            );
        }
        runs
    }

    fn client(&self, service: &Service, path: &str, start: Instant) -> Run {
        let run = Socket::open(service.address, path).expect("a drag").drag(
            start,
            &self.times,
            &self.poses,
            PATIENCE,
            HEAD,
        );
        assert_eq!(
            run.shown.last().map_or(0, |frame| frame.seq),
            recording::POSES - 1,
            "the last pose is shown"
        );
        run
    }
}

/// What is told of some runs side by side.
struct DragFigures {
    /// Frames a second of each client, all frames of the same pose counted once.
    rates: Vec<f64>,
    frames: Vec<usize>,
    ages: Times,
    width: u32,
    bytes: usize,
}

impl DragFigures {
    fn new(runs: &[Run]) -> Self {
        let (mut rates, mut frames, mut ages, mut widths, mut sizes) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for Run { sent, shown } in runs {
            let mut first = shown.clone();
            first.dedup_by_key(|frame| frame.seq);
            let last = first.last().expect("the last pose is shown");
            rates.push(first.len() as f64 / (last.at - sent[0]).as_secs_f64());
            frames.push(first.len());
            ages.extend(
                first
                    .iter()
                    .map(|frame| (frame.at - sent[frame.seq as usize]).as_secs_f64()),
            );
            widths.extend(first.iter().map(ShownFrame::width));
            sizes.extend(first.iter().map(|frame| frame.bytes));
        }
        widths.sort_unstable();
        sizes.sort_unstable();
        Self {
            rates,
            frames,
            ages: Times::new(ages),
            width: widths[widths.len() / 2],
            bytes: sizes[sizes.len() / 2],
        }
    }

    fn p99(&self) -> f64 {
        self.ages.quantile(0.99)
    }

    fn rate(&self) -> f64 {
        self.rates.iter().sum::<f64>() / self.rates.len() as f64
    }

    fn fairness(&self) -> f64 {
        let of = |n: Option<&usize>| *n.expect("a client") as f64;
        of(self.frames.iter().min()) / of(self.frames.iter().max())
    }
}

fn main() {
    if harness::filter().starts_with(links::TITLE) {
        links::run();
        return;
    }
    let mut report = Report::new(
        "drag",
        "the socket under a recorded drag, 600 poses at 125 Hz, 12 handles",
    );
    for clients in [1, 8] {
        let title = if clients == 1 {
            "1 client".to_owned()
        } else {
            format!("{clients} clients, each on a session of its own")
        };
        let name = |sides, query| format!("{}, `{query}`", size(extent(sides)));
        let cases: Vec<_> = CASES
            .iter()
            .filter(|case| case.0 == clients)
            .map(|case| (case, name(case.1, case.2)))
            .collect();
        let cases: Vec<_> = cases
            .into_iter()
            .filter(|(_, name)| harness::wanted(&format!("{title} {name}")))
            .collect();
        if cases.is_empty() {
            continue;
        }
        let mut text = format!(
            "## {title}\n\n| what | frames/s | age p50 | age p99 | superseded | fewest / most | \
                width | KiB a frame |\n|---|---:|---:|---:|---:|---:|---:|---:|\n"
        );
        for ((_, sides, query, least), name) in cases {
            let scene = Scene::new(*sides);
            let service = Service::start();
            let runs = (0..RUNS).map(|_| DragFigures::new(&scene.run(&service, clients, query)));
            let best = runs
                .min_by(|a, b| a.p99().total_cmp(&b.p99()))
                .expect("three runs");
            let width = if query.contains("png") {
                best.width.to_string()
            } else {
                String::new()
            };
            let shown = best.frames.iter().sum::<usize>() / clients;
            let _ = writeln!(
                text,
                "| {name} | {:.1} | {} | {} | {} | {:.2} | {width} | {} |",
                best.rate(),
                time(best.ages.median()),
                time(best.p99()),
                recording::POSES as usize - shown,
                best.fairness(),
                best.bytes >> 10
            );
            if let Some(least) = least {
                report.goal(
                    &format!("{clients} client, {name}: frames/s"),
                    best.rate(),
                    Goal::AtLeast(*least),
                );
            }
            if (clients, *sides, *query) == (1, SQUARE, "frames=png") {
                report.goal(
                    &format!("{clients} client, {name}: age p99, ms"),
                    best.p99() * 1e3,
                    Goal::AtMost(25.0),
                );
            }
            if clients > 1 {
                report.goal(
                    &format!("{clients} clients, {name}: fewest / most frames"),
                    best.fairness(),
                    Goal::AtLeast(0.6),
                );
            }
        }
        report.line(&text);
    }
}
