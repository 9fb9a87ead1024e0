//! What every benchmark shares: contenders of one table are timed in turn (A B C A B C ...) so that a drifting clock meets them alike,
//! medians are printed with their ratio to a named contender, and the table is written to `tests/bench/results/`.

#![allow(dead_code, reason = "each benchmark uses a part of the harness")]

use std::fmt::Write as _;
use std::time::{Duration, Instant};

/// One thing to time.
pub struct Contender<'a> {
    pub name: String,
    pub work: Box<dyn FnMut() + 'a>,
}

pub fn contender<'a>(name: impl Into<String>, work: impl FnMut() + 'a) -> Contender<'a> {
    Contender { name: name.into(), work: Box::new(work) }
}

/// A sample lasts at least this long; shorter work is repeated inside it.
const SAMPLE: Duration = Duration::from_micros(300);

/// Median seconds of one call of each contender, `rounds` samples each, taken in turn.
pub fn medians(rounds: usize, contenders: &mut [Contender<'_>]) -> Vec<f64> {
    let repeats: Vec<u32> = contenders
        .iter_mut()
        .map(|c| {
            (c.work)();
            let start = Instant::now();
            (c.work)();
            let once = start.elapsed().max(Duration::from_nanos(50));
            u32::try_from(SAMPLE.as_nanos() / once.as_nanos()).unwrap_or(1).clamp(1, 5000)
        })
        .collect();
    let mut samples = vec![Vec::with_capacity(rounds); contenders.len()];
    for _ in 0..rounds {
        for ((c, &repeats), samples) in contenders.iter_mut().zip(&repeats).zip(&mut samples) {
            // One unmeasured call brings the contender's own data back into the caches that the others have taken.
            (c.work)();
            let start = Instant::now();
            for _ in 0..repeats {
                (c.work)();
            }
            samples.push(start.elapsed().as_secs_f64() / f64::from(repeats));
        }
    }
    samples
        .into_iter()
        .map(|mut s| {
            s.sort_unstable_by(f64::total_cmp);
            s[s.len() / 2]
        })
        .collect()
}

/// A report that is printed and kept.
pub struct Report {
    name: &'static str,
    text: String,
}

impl Report {
    pub fn new(name: &'static str, what: &str) -> Self {
        let mut report = Self { name, text: String::new() };
        report.line(&format!("# {name}: {what}\n"));
        report.line(&format!("Machine: {}; level {}.\n", machine(), mlswarp::level::Level::detect().name()));
        report
    }

    pub fn line(&mut self, line: &str) {
        println!("{line}");
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// Times the contenders and prints a table with the ratio of each to the first. Returns the medians, seconds.
    pub fn table(&mut self, title: &str, rounds: usize, contenders: &mut [Contender<'_>]) -> Vec<f64> {
        let medians = medians(rounds, contenders);
        let mut table = format!("## {title}\n\n| what | median | ratio to the first |\n|---|---:|---:|\n");
        for (c, m) in contenders.iter().zip(&medians) {
            writeln!(table, "| {} | {} | {:.2} |", c.name, time(*m), m / medians[0]).expect("a string takes what is written");
        }
        self.line(&table);
        medians
    }
}

impl Drop for Report {
    fn drop(&mut self) {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bench/results");
        let written = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(folder.join(format!("{}.md", self.name)), &self.text));
        if let Err(error) = written {
            eprintln!("the results were not written: {error}");
        }
    }
}

pub fn time(seconds: f64) -> String {
    if seconds < 1e-3 { format!("{:.1} us", seconds * 1e6) } else { format!("{:.3} ms", seconds * 1e3) }
}

fn machine() -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo")
        .ok()
        .and_then(|s| s.lines().find(|l| l.starts_with("model name")).and_then(|l| l.split(": ").nth(1)).map(str::to_owned))
        .unwrap_or_else(|| "unknown processor".to_owned());
    format!("{cpu}, {} threads", std::thread::available_parallelism().map_or(1, usize::from))
}

/// A pool of so many threads.
pub fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of a few threads")
}
