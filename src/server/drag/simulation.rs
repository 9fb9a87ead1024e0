//! Drags over simulated connections: a pointer at 125 Hz, a server, and a path with a rate, a
//! delay, jitter and outages. All times are simulated, so the results are the same every time.

#![allow(clippy::cast_possible_truncation, reason = "small numbers")]

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::frame_scheduler::{FrameRequest, FrameScheduler, QueuedPose, Step};
use super::picture_ladder::{Encoding, PictureLadder};
use super::preview_controller::PreviewController;
use super::send_window::{MAX_WINDOW, Window};

/// Steps per millisecond.
const STEPS_PER_MS: u64 = 4;
/// The pointer moves for this time, and the frames of the first second are not counted, ms.
const MOVING_MS: u64 = 30_000;
const WARM_UP: u64 = 1_000;
/// Time between poses, ms.
const POSE_PERIOD_MS: u64 = 8;
/// Width of the pictures, px.
const WIDTH: u32 = 512;

/// A path in both directions. Rates of the direction to the client in Mbit/s, times in ms.
#[derive(Clone, Copy)]
struct Link {
    name: &'static str,
    rate: f64,
    /// From the middle of the drag.
    later_rate: f64,
    delay: u64,
    /// The maximum additional delay.
    jitter: u64,
    /// Nothing passes between these times.
    outage: (u64, u64),
    /// Drawing time.
    draw: u64,
    /// The interval of the refreshes of the client's screen, at which it acknowledges, ms.
    refresh: u64,
}

const fn link(name: &'static str, rate: f64, delay: u64) -> Link {
    Link {
        name,
        rate,
        later_rate: rate,
        delay,
        jitter: 0,
        outage: (0, 0),
        draw: 2,
        refresh: 0,
    }
}

const LINKS: [Link; 13] = [
    link("loopback", 10_000.0, 0),
    Link {
        refresh: 16,
        ..link("loopback, screen of 60 Hz", 10_000.0, 0)
    },
    Link {
        draw: 20,
        ..link("loopback, drawing 20 ms", 10_000.0, 0)
    },
    link("100 Mbit/s, 5 ms", 100.0, 5),
    link("20 Mbit/s, 25 ms", 20.0, 25),
    link("5 Mbit/s, 50 ms", 5.0, 50),
    link("1 Mbit/s, 50 ms", 1.0, 50),
    link("100 Mbit/s, 75 ms", 100.0, 75),
    Link {
        jitter: 20,
        ..link("5 Mbit/s, 50 ms, jitter 20 ms", 5.0, 50)
    },
    Link {
        jitter: 40,
        refresh: 16,
        ..link("20 Mbit/s, 75 ms, jitter 40 ms, screen of 60 Hz", 20.0, 75)
    },
    Link {
        outage: (12_000, 13_000),
        ..link("5 Mbit/s, 50 ms, 1 s of loss", 5.0, 50)
    },
    Link {
        later_rate: 2.5,
        ..link("5, then 2.5 Mbit/s, 50 ms", 5.0, 50)
    },
    Link {
        later_rate: 20.0,
        ..link("5, then 20 Mbit/s, 50 ms", 5.0, 50)
    },
];

/// A frame on its way.
#[derive(Clone, Copy)]
struct Parcel {
    seq: u64,
    bytes: u64,
    sent: u64,
}

struct ShownFrame {
    seq: u64,
    /// Steps.
    at: u64,
}

/// What was observed.
struct Observed {
    shown: Vec<ShownFrame>,
    /// The longest time that a frame waited behind others, ms, without outages.
    queue: u64,
    /// The most frames on the way.
    under_way: usize,
    drawn: usize,
    /// Bytes of the frames of the moving pointer.
    sizes: Vec<u64>,
    last: Option<FrameRequest>,
}

impl Observed {
    fn moving(&self) -> impl Iterator<Item = &ShownFrame> {
        self.shown
            .iter()
            .filter(|shown| (WARM_UP * STEPS_PER_MS..MOVING_MS * STEPS_PER_MS).contains(&shown.at))
    }

    fn rate(&self) -> f64 {
        self.moving().count() as f64 * 1e3 / (MOVING_MS - WARM_UP) as f64
    }

    /// A quantile of the ages, ms: from sending a pose to showing its frame.
    fn age(&self, share: f64) -> f64 {
        let mut ages: Vec<u64> = self
            .moving()
            .map(|shown| shown.at - shown.seq * POSE_PERIOD_MS * STEPS_PER_MS)
            .collect();
        ages.sort_unstable();
        ages[((ages.len() - 1) as f64 * share).round() as usize] as f64 / STEPS_PER_MS as f64
    }
}

/// Numbers in 0 to 1 that look random.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1_u64 << 24) as f64
    }
}

/// One direction of a path after its rate: delays, in order.
struct Path<T> {
    link: Link,
    noise: Noise,
    items: VecDeque<(u64, T)>,
}

impl<T> Path<T> {
    const fn new(link: Link, seed: u64) -> Self {
        Self {
            link,
            noise: Noise(seed),
            items: VecDeque::new(),
        }
    }

    fn send(&mut self, step: u64, item: T) {
        let jitter = (self.noise.next() * (self.link.jitter * STEPS_PER_MS) as f64) as u64;
        let mut at = step + self.link.delay * STEPS_PER_MS + jitter;
        if self.link.is_out(step) {
            at += self.link.outage.1 * STEPS_PER_MS - step;
        }
        let last = self.items.back().map_or(0, |(at, _)| *at);
        self.items.push_back((at.max(last), item));
    }

    fn arrived(&mut self, step: u64) -> Option<T> {
        self.items
            .front()
            .is_some_and(|(at, _)| *at <= step)
            .then(|| self.items.pop_front().map(|(_, item)| item))?
    }
}

impl Link {
    fn is_out(&self, step: u64) -> bool {
        (self.outage.0 * STEPS_PER_MS..self.outage.1 * STEPS_PER_MS).contains(&step)
    }

    /// Bytes per step.
    fn bytes(&self, step: u64) -> f64 {
        let rate = if step < MOVING_MS * STEPS_PER_MS / 2 {
            self.rate
        } else {
            self.later_rate
        };
        if self.is_out(step) {
            0.0
        } else {
            rate * 1e6 / 8.0 / 1e3 / STEPS_PER_MS as f64
        }
    }
}

/// The content of frames.
#[derive(Clone, Copy)]
enum SimulatedFrame {
    /// This number of bytes.
    Fixed(u64),
    /// JPEG of one quality, of an adapted width.
    Previews,
    /// Pictures, chosen by the scheduler.
    Auto,
}

/// Bytes of a photograph.
fn picture_bytes(width: u32, encoding: Option<Encoding>, noise: &mut Noise) -> u64 {
    let pixels = f64::from(width) * f64::from(width);
    let bytes = match encoding {
        Some(Encoding::Jpeg(quality)) => {
            let quality = f64::from(quality);
            pixels
                * 0.075
                * (3.0 - quality / 50.0).max(1.1).recip()
                * 2.0
                * (512.0 / f64::from(width)).powf(0.6)
                * (quality / 50.0)
        }
        _ => pixels * 1.4,
    };
    (bytes * (0.9 + 0.2 * noise.next())) as u64
}

/// Sends what the link takes in a step. The result: the longest time that a frame waited before its
/// first byte was sent, ms; time in an outage at the end does not count.
fn transmit(
    link: Link,
    step: u64,
    wire: &mut VecDeque<(Parcel, f64)>,
    down: &mut Path<u64>,
) -> u64 {
    let mut queue = 0;
    let mut budget = link.bytes(step);
    while let Some((parcel, left)) = wire.front_mut() {
        if *left == parcel.bytes as f64
            && budget > 0.0
            && !(link.outage.1 > 0 && step > link.outage.0 * STEPS_PER_MS)
        {
            queue = queue.max((step - parcel.sent) / STEPS_PER_MS);
        }
        let part = left.min(budget);
        *left -= part;
        budget -= part;
        if *left > 0.0 {
            break;
        }
        down.send(step, parcel.seq);
        wire.pop_front();
    }
    queue
}

/// Drags for [`MOVING_MS`], then rests for a while.
fn drag(link: Link, window: Window, content: SimulatedFrame) -> Observed {
    let pictures =
        matches!(content, SimulatedFrame::Auto).then(|| PictureLadder::new((WIDTH, WIDTH), None));
    let previews = match content {
        SimulatedFrame::Previews => PreviewController::adaptive((WIDTH, WIDTH)),
        _ => PreviewController::fixed(WIDTH),
    };
    let mut scheduler = FrameScheduler::new(previews, pictures, WIDTH, window);
    let mut noise = Noise(5);
    let start = Instant::now();
    let (mut up, mut down, mut acks) = (Path::new(link, 1), Path::new(link, 2), Path::new(link, 3));
    let mut drawing: Option<(FrameRequest, u64)> = None;
    let mut wire: VecDeque<(Parcel, f64)> = VecDeque::new();
    let mut to_show: VecDeque<u64> = VecDeque::new();
    let mut seen = Observed {
        shown: Vec::new(),
        queue: 0,
        under_way: 0,
        drawn: 0,
        sizes: Vec::new(),
        last: None,
    };
    let mut under_way = 0;
    for step in 0..(MOVING_MS + 5_000) * STEPS_PER_MS {
        let now = start + Duration::from_micros(step * 1000 / STEPS_PER_MS);
        if step < MOVING_MS * STEPS_PER_MS && step % (POSE_PERIOD_MS * STEPS_PER_MS) == 0 {
            up.send(step, step / (POSE_PERIOD_MS * STEPS_PER_MS));
        }
        while let Some(seq) = up.arrived(step) {
            scheduler.pose(QueuedPose {
                seq,
                q: Arc::default(),
                at: now,
            });
        }
        while let Some(seq) = acks.arrived(step) {
            scheduler.ack(seq, now).unwrap();
            under_way -= 1;
        }
        if let Some((request, _)) = drawing.take_if(|(_, at)| *at <= step) {
            let bytes = match content {
                SimulatedFrame::Fixed(bytes) => bytes,
                SimulatedFrame::Previews => picture_bytes(
                    request.width.unwrap_or(WIDTH),
                    Some(Encoding::Jpeg(85)),
                    &mut noise,
                ),
                SimulatedFrame::Auto => {
                    picture_bytes(request.width.unwrap_or(WIDTH), request.encoding, &mut noise)
                }
            };
            let seq = request.pose.seq;
            scheduler.drawn((request, bytes), bytes, now);
            seen.drawn += usize::from(seq < MOVING_MS / POSE_PERIOD_MS);
        }
        loop {
            match scheduler.next(now) {
                Step::Draw(request) => drawing = Some((request, step + link.draw * STEPS_PER_MS)),
                Step::Cancel => drawing = None,
                Step::Send((request, bytes)) => {
                    if step < MOVING_MS * STEPS_PER_MS {
                        seen.sizes.push(bytes);
                    }
                    seen.last = Some(request.clone());
                    let seq = request.pose.seq;
                    under_way += 1;
                    seen.under_way = seen.under_way.max(under_way);
                    wire.push_back((
                        Parcel {
                            seq,
                            bytes,
                            sent: step,
                        },
                        bytes as f64,
                    ));
                }
                Step::Wait(_) => break,
            }
        }
        seen.queue = seen.queue.max(transmit(link, step, &mut wire, &mut down));
        to_show.extend(std::iter::from_fn(|| down.arrived(step)));
        if link.refresh == 0 || step % (link.refresh * STEPS_PER_MS) == 0 {
            for seq in to_show.drain(..) {
                seen.shown.push(ShownFrame { seq, at: step });
                acks.send(step, seq);
            }
        }
    }
    seen
}

/// Bounds of the automatic window, by the order of [`LINKS`]: bytes of a frame, frames per second
/// at least, ages p50 and p99 at most.
const BOUNDS: [[(u64, f64, f64, f64); 2]; LINKS.len()] = [
    [(10_000, 118.0, 3.0, 3.0), (20_000, 118.0, 3.0, 3.0)],
    [(10_000, 58.0, 26.0, 26.0), (20_000, 58.0, 26.0, 26.0)],
    [(10_000, 47.0, 26.0, 26.0), (20_000, 47.0, 26.0, 26.0)],
    [(10_000, 88.0, 19.0, 23.0), (20_000, 82.0, 20.0, 24.0)],
    [(10_000, 53.0, 64.0, 68.0), (20_000, 65.0, 68.0, 73.0)],
    [(10_000, 57.0, 130.0, 134.0), (20_000, 28.0, 147.0, 253.0)],
    [(10_000, 10.0, 198.0, 344.0), (20_000, 5.0, 344.0, 517.0)],
    [(10_000, 49.0, 167.0, 170.0), (20_000, 49.0, 168.0, 171.0)],
    [(10_000, 52.0, 153.0, 172.0), (20_000, 28.0, 180.0, 277.0)],
    [(10_000, 29.0, 221.0, 255.0), (20_000, 33.0, 229.0, 263.0)],
    [(10_000, 53.0, 130.0, 134.0), (20_000, 22.0, 147.0, 278.0)],
    [(10_000, 37.0, 131.0, 182.0), (20_000, 18.0, 149.0, 278.0)],
    [(10_000, 59.0, 120.0, 134.0), (20_000, 41.0, 123.0, 185.0)],
];

#[test]
fn the_automatic_window_keeps_links_busy_without_a_queue() {
    for (link, bounds) in LINKS.iter().zip(BOUNDS) {
        for (bytes, rate, p50, p99) in bounds {
            let seen = drag(*link, Window::Auto, SimulatedFrame::Fixed(bytes));
            let (found, name) = ((seen.rate(), seen.age(0.5), seen.age(0.99)), link.name);
            assert!(
                found.0 >= rate && found.1 <= p50 && found.2 <= p99,
                "{name}, {bytes}: {found:?}"
            );
            assert!(seen.queue < 300, "{name}, {bytes}: {}", seen.queue);
            assert!(
                seen.shown.is_sorted_by(|a, b| a.seq <= b.seq),
                "{name}: nothing old after something new"
            );
            assert_eq!(
                seen.shown.last().map(|shown| shown.seq),
                Some(MOVING_MS / POSE_PERIOD_MS - 1),
                "{name}: the last pose arrives"
            );
            assert!(
                seen.drawn <= 2 * seen.shown.len(),
                "{name}: {} frames drawn",
                seen.drawn
            );
        }
    }
    if is_full() {
        print_windows();
    }
}

fn is_full() -> bool {
    std::env::var_os("MLSWARP_TESTS_FULL").is_some()
}

#[test]
fn on_loopback_one_frame_is_under_way() {
    for link in &LINKS[..3] {
        let [auto, one] = [Window::Auto, Window::Fixed(1)]
            .map(|window| drag(*link, window, SimulatedFrame::Fixed(250_000)));
        assert_eq!((auto.under_way, one.under_way), (1, 1), "{}", link.name);
        assert_eq!(
            (auto.rate(), auto.age(0.5), auto.age(0.99)),
            (one.rate(), one.age(0.5), one.age(0.99)),
            "{}",
            link.name
        );
    }
}

#[test]
fn a_fixed_window_is_never_exceeded() {
    for frames in 1..=MAX_WINDOW {
        assert_eq!(
            drag(
                LINKS[5],
                Window::Fixed(frames),
                SimulatedFrame::Fixed(20_000)
            )
            .under_way,
            frames
        );
    }
}

/// Prints the first table of the notes.
fn print_windows() {
    for link in LINKS {
        for bytes in [10_000, 20_000, 60_000, 250_000] {
            let mut line = format!("| {} | {} kB ", link.name, bytes / 1000);
            for window in [
                Window::Fixed(1),
                Window::Fixed(4),
                Window::Fixed(8),
                Window::Auto,
            ] {
                let seen = drag(link, window, SimulatedFrame::Fixed(bytes));
                line += &format!(
                    "| {:.0}, {:.0} / {:.0}, {} ",
                    seen.rate(),
                    seen.age(0.5),
                    seen.age(0.99),
                    seen.queue
                );
            }
            println!("{line}|");
        }
    }
}

/// Prints the second table of the notes.
fn print_pictures() {
    for link in LINKS {
        let mut line = format!("| {} ", link.name);
        for content in [PNG, JPEG, SimulatedFrame::Previews, SimulatedFrame::Auto] {
            let mut seen = drag(link, Window::Auto, content);
            seen.sizes.sort_unstable();
            let bytes = seen.sizes[seen.sizes.len() / 2] / 1000;
            line += &format!(
                "| {:.0}, {:.0} / {:.0}, {}, {bytes} ",
                seen.rate(),
                seen.age(0.5),
                seen.age(0.99),
                seen.queue
            );
        }
        println!("{line}|");
    }
}

/// What `auto` is compared with: 512 x 512 as PNG, and as JPEG of quality 85.
const PNG: SimulatedFrame = SimulatedFrame::Fixed(370_000);
const JPEG: SimulatedFrame = SimulatedFrame::Fixed(51_000);
/// Frames per second of `auto` at least, by the order of [`LINKS`].
const AUTO_RATES: [f64; LINKS.len()] = [
    120.0, 60.0, 48.0, 65.0, 40.0, 30.0, 12.0, 45.0, 24.0, 28.0, 27.0, 24.0, 35.0,
];

#[test]
fn automatic_pictures_suit_the_link() {
    for (link, rate) in LINKS.iter().zip(AUTO_RATES) {
        let [png, jpeg, narrow, auto] = [PNG, JPEG, SimulatedFrame::Previews, SimulatedFrame::Auto]
            .map(|content| drag(*link, Window::Auto, content));
        let (name, age, fixed) = (
            link.name,
            auto.age(0.5),
            [png, jpeg, narrow].map(|seen| seen.age(0.5)),
        );
        assert!(auto.rate() >= rate, "{name}: {}", auto.rate());
        assert!(
            fixed.iter().all(|fixed| age <= 1.1 * fixed + 1.0),
            "{name}: {age}, fixed pictures {fixed:?}"
        );
        assert!(
            age <= (2 * (link.delay + link.jitter + link.draw + link.refresh) + 100) as f64,
            "{name}: {age}"
        );
        assert!(auto.queue < 300, "{name}: {}", auto.queue);
        let large = auto.sizes.iter().filter(|bytes| **bytes > 40_000).count();
        assert!(
            link.rate < 100.0 || 2 * large > auto.sizes.len(),
            "{name}: {large} large pictures"
        );
        assert!(
            auto.shown.is_sorted_by(|a, b| a.seq <= b.seq),
            "{name}: nothing old after something new"
        );
        // The last frame is full.
        let last = auto.last.expect("frames were sent");
        let is_lossless = last.encoding == Some(Encoding::Png);
        assert_eq!(
            (last.pose.seq, last.width.is_none_or(|width| width == WIDTH)),
            (MOVING_MS / POSE_PERIOD_MS - 1, true),
            "{name}"
        );
        assert_eq!(
            is_lossless,
            link.later_rate * 1e6 / 8.0 >= 370_000.0,
            "{name}: lossless if the link carries that in a second"
        );
        assert_eq!(
            auto.shown.last().map(|shown| shown.seq),
            Some(last.pose.seq),
            "{name}: the last pose arrives"
        );
    }
    if is_full() {
        print_pictures();
    }
}

#[test]
fn twelve_frames_a_second_pass_a_slow_link_from_the_start() {
    for delay in [5, 25, 50, 75] {
        let seen = drag(
            link("1 Mbit/s", 1.0, delay),
            Window::Auto,
            SimulatedFrame::Auto,
        );
        let frames = seen
            .shown
            .iter()
            .filter(|shown| shown.at < 3_000 * STEPS_PER_MS)
            .count();
        assert!(frames >= 36, "{delay} ms: {frames} frames in three seconds");
    }
}
