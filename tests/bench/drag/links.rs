//! The drag socket over links: three seconds of the recorded drag behind a relay with a rate and a
//! delay, for each choice of frames. Tells what the client sees: how often, how late, and how close
//! to the lossless frame of full size.
//!
//! A filter that begins with [`TITLE`] selects rows: `links` is all of them, twelve minutes at
//! most, and is saved in `results/links.md`; `links 5 Mbit/s, 50 ms` is the rows of one link,
//! `links 1 Mbit/s, 25 ms, 512 x 512, auto` is one row.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use mlswarp::pixmap::{Channels, Pixmap, Samples};

use crate::client::Client;
use crate::harness::pictures::{FULL_HD, bytes, extent, photograph, size, tiles};
use crate::harness::{Goal, Report, Times, filter, time};
use crate::relay::{Link, Relay};
use crate::service::Service;
use crate::socket::{Run, ShownFrame, Socket};
use crate::{SQUARE, Scene};

/// How filters for this table begin, and where it is saved.
pub const TITLE: &str = "links";

/// Megabits per second and milliseconds, both in each direction.
const LINKS: [(u64, u64); 13] = [
    (1, 5),
    (1, 25),
    (1, 75),
    (5, 5),
    (5, 25),
    (5, 50),
    (5, 75),
    (20, 5),
    (20, 25),
    (20, 75),
    (100, 5),
    (100, 25),
    (100, 75),
];
/// The name of each choice, and its query.
const FRAMES: [(&str, &str); 5] = [
    ("png", "frames=png"),
    ("jpeg", "frames=jpeg"),
    ("mesh", "frames=mesh"),
    ("compact mesh", "frames=mesh&mesh=compact"),
    ("auto", "frames=auto"),
];
/// Poses of a drag: three seconds.
const POSES: usize = 375;
/// How long the last pose is waited for.
const PATIENCE: Duration = Duration::from_secs(2);
/// Pictures of a row that are compared with the lossless ones.
const COMPARED: usize = 6;

/// What a client saw.
struct Row {
    /// Frames per second, all frames of the same pose counted once.
    rate: f64,
    /// `None`: it saw nothing.
    ages: Option<Times>,
    /// Median, bytes.
    bytes: usize,
    /// How long after the last pose its first frame came, if it came.
    last: Option<Duration>,
    /// Of pictures: the median width, and the PSNR.
    picture: Option<(u32, f64)>,
}

impl Row {
    fn new(Run { sent, shown }: Run, q: &Scene, session: &str, service: &Service) -> Self {
        let mut first = shown;
        first.dedup_by_key(|frame| frame.seq);
        let end = first.last().map(|frame| (frame.seq, frame.at));
        let last = end
            .filter(|(seq, _)| *seq as usize == sent.len() - 1)
            .map(|(_, at)| at - sent[sent.len() - 1]);
        // A drag that was cut off has lasted until then.
        let until = last.map_or(sent[sent.len() - 1] + PATIENCE, |last| {
            sent[sent.len() - 1] + last
        });
        let age = |frame: &ShownFrame| (frame.at - sent[frame.seq as usize]).as_secs_f64();
        let ages: Vec<f64> = first.iter().map(age).collect();
        let mut sizes: Vec<usize> = first.iter().map(|frame| frame.bytes).collect();
        sizes.sort_unstable();
        Self {
            rate: first.len() as f64 / (until - sent[0]).as_secs_f64(),
            ages: (!ages.is_empty()).then(|| Times::new(ages)),
            bytes: sizes.get(sizes.len() / 2).copied().unwrap_or_default(),
            last,
            picture: compared(&first, q, session, service),
        }
    }

    fn quantile(&self, part: f64) -> f64 {
        self.ages
            .as_ref()
            .map_or(f64::INFINITY, |ages| ages.quantile(part))
    }

    fn line(&self) -> String {
        let age = |part| {
            if self.ages.is_some() {
                time(self.quantile(part))
            } else {
                "none".to_owned()
            }
        };
        let last = self.last.map_or_else(
            || format!("> {} s", PATIENCE.as_secs()),
            |last| time(last.as_secs_f64()),
        );
        let (width, psnr) = match self.picture {
            Some((width, psnr)) if psnr.is_finite() => (width.to_string(), format!("{psnr:.1} dB")),
            Some((width, _)) => (width.to_string(), "lossless".to_owned()),
            None => (String::new(), String::new()),
        };
        let kib = self.bytes as f64 / 1024.0;
        format!(
            "{:.1} | {} | {} | {last} | {kib:.1} | {width} | {psnr}",
            self.rate,
            age(0.5),
            age(0.99)
        )
    }
}

/// The median width and the PSNR of some of the frames, evenly spread; `None` if they are no
/// pictures.
fn compared(
    frames: &[ShownFrame],
    scene: &Scene,
    session: &str,
    service: &Service,
) -> Option<(u32, f64)> {
    let mut client = Client::connect(service.address);
    let (mut widths, mut error, mut samples) = (Vec::new(), 0.0, 0);
    for frame in frames
        .iter()
        .step_by(frames.len().div_ceil(COMPARED).max(1))
    {
        let shown = image::load_from_memory(&frame.message[8..]).ok()?;
        let body = format!(
            r#"{{"q":{},"output":{{"format":"png","compression":"none"}}}}"#,
            scene.q[frame.seq as usize]
        );
        let mut file = Vec::new();
        let request = service.post(
            &format!("{session}/warp"),
            "application/json",
            body.as_bytes(),
        );
        client.send(&request, |bytes| file.extend_from_slice(bytes));
        let lossless = image::load_from_memory(&file).expect("a PNG");
        widths.push(shown.width());
        let scaled = shown.resize_exact(
            lossless.width(),
            lossless.height(),
            image::imageops::FilterType::Triangle,
        );
        let (a, b) = (on_white(&scaled), on_white(&lossless));
        error += a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        samples += a.len();
    }
    widths.sort_unstable();
    let width = *widths.get(widths.len() / 2)?;
    Some((
        width,
        10.0 * (255.0_f64.powi(2) * samples as f64 / error).log10(),
    ))
}

/// Red, green and blue of each pixel on a white page, as JPEG has it.
fn on_white(picture: &image::DynamicImage) -> Vec<f64> {
    let flat = |pixel: &image::Rgba<u8>| {
        let [r, g, b, a] = pixel.0.map(f64::from);
        [r, g, b].map(|sample| (sample * a + 255.0 * (255.0 - a)) / 255.0)
    };
    picture.to_rgba8().pixels().flat_map(flat).collect()
}

/// The photograph, or as many of it side by side as fit: as much detail in each pixel.
fn picture(sides: (u32, u32)) -> Pixmap {
    if sides == SQUARE {
        return photograph(extent(sides), Channels::Rgb);
    }
    let samples = bytes(&tiles(extent(sides)))
        .chunks_exact(4)
        .flat_map(|pixel| &pixel[..3])
        .copied()
        .collect();
    Pixmap::new(extent(sides), Channels::Rgb, Samples::Eight(samples))
}

/// One row; `Err` is the status of a socket that was refused.
fn row(scene: &Scene, service: &Service, relay: &Relay, query: &str) -> Result<Row, String> {
    let session = service.session(
        &mut Client::connect(service.address),
        &scene.file,
        &scene.warp,
    );
    let run = Socket::open(relay.address, &format!("{session}/drag?{query}")).map(|socket| {
        socket.drag(
            Instant::now(),
            &scene.times[..POSES],
            &scene.poses[..POSES],
            PATIENCE,
            usize::MAX,
        )
    });
    let row = run.map(|run| Row::new(run, scene, &session, service));
    let end = format!(
        "DELETE {session} HTTP/1.1\r\nHost: {}\r\n\r\n",
        service.address
    );
    Client::connect(service.address).send(end.as_bytes(), |_| {});
    row
}

/// The rows that the filter selects.
pub fn run() {
    let filter = filter();
    let wanted = filter[TITLE.len()..].trim_start();
    let mut report = Report::chosen(
        TITLE,
        "three seconds of a recorded drag at 125 Hz over links, 12 handles; each choice of frames",
        !wanted.is_empty(),
    );
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .expect("a runtime");
    let service = Service::start();
    for sides in [SQUARE, FULL_HD] {
        let mut scene = None;
        for (megabits, milliseconds) in LINKS {
            let title = format!(
                "{megabits} Mbit/s, {milliseconds} ms each way, {}",
                size(extent(sides))
            );
            let frames: Vec<_> = FRAMES
                .into_iter()
                .filter(|(name, _)| format!("{title}, {name}").contains(wanted))
                .collect();
            if frames.is_empty() {
                continue;
            }
            let scene = scene.get_or_insert_with(|| Scene::of(&picture(sides)));
            let link = Link::new(megabits, milliseconds);
            let relay = runtime
                .block_on(async { Relay::start(service.address, link, link) })
                .expect("a relay");
            let mut text = format!(
                "## {title}\n\n| frames | frames/s | age p50 | age p99 | last pose | KiB a frame \
                    | width | PSNR |\n\
                 |---|---:|---:|---:|---:|---:|---:|---:|\n"
            );
            let rows: Vec<_> = frames
                .iter()
                .map(|(name, query)| (*name, row(scene, &service, &relay, query)))
                .collect();
            for (name, row) in &rows {
                let line = row.as_ref().map_or_else(
                    |status| {
                        format!(
                            "refused: {}||||||",
                            status.trim_start_matches("HTTP/1.1 ").trim()
                        )
                    },
                    Row::line,
                );
                let _ = writeln!(text, "| {name} | {line} |");
            }
            report.line(&text);
            goals(&mut report, &title, (megabits, milliseconds), sides, &rows);
        }
    }
}

fn goals(
    report: &mut Report,
    title: &str,
    (megabits, milliseconds): (u64, u64),
    sides: (u32, u32),
    rows: &[(&str, Result<Row, String>)],
) {
    let of = |name| {
        rows.iter()
            .find(|row| row.0 == name)
            .and_then(|row| row.1.as_ref().ok())
    };
    if let (true, Some(mesh)) = (sides == SQUARE, of("compact mesh")) {
        report.goal(
            &format!("{title}, compact mesh: bytes"),
            mesh.bytes as f64,
            Goal::AtMost(20_000.0),
        );
    }
    let Some(auto) = of("auto") else { return };
    if sides == SQUARE && megabits == 1 {
        report.goal(
            &format!("{title}, auto: frames/s"),
            auto.rate,
            Goal::AtLeast(12.0),
        );
    }
    if (sides, megabits, milliseconds) == (SQUARE, 5, 50) {
        report.goal(
            &format!("{title}, auto: frames/s"),
            auto.rate,
            Goal::AtLeast(30.0),
        );
        report.goal(
            &format!("{title}, auto: age p50, ms"),
            1e3 * auto.quantile(0.5),
            Goal::AtMost(2.0 * 50.0 + 80.0),
        );
    }
    let fixed = ["png", "jpeg"]
        .into_iter()
        .filter_map(of)
        .map(|row| row.quantile(0.5))
        .reduce(f64::min);
    if let Some(fixed) = fixed {
        report.goal(
            &format!("{title}, auto: age p50 / that of the better of png and jpeg"),
            auto.quantile(0.5) / fixed,
            Goal::AtMost(1.1),
        );
    }
}
