//! What every benchmark shares: contenders of one table are timed in turn (A B C A B C ...) so that
//! a drifting clock meets them alike, medians are printed with their ratio to a named rival, and
//! the report is written to `tests/bench/results/`.

#![allow(dead_code, reason = "each benchmark uses a part of the harness")]

pub mod dense;
pub mod paired;
pub mod pictures;

use std::fmt::Write as _;
use std::time::{Duration, Instant};

/// One thing to time.
pub struct Contender<'a> {
    pub name: String,
    work: Work<'a>,
    bytes: Option<usize>,
}

enum Work<'a> {
    Here(Box<dyn FnMut() + 'a>),
    /// On a thread of this pool: what is handed to the others counts, not how the work came there.
    Inside(&'a rayon::ThreadPool, Box<dyn FnMut() + Send + 'a>),
    /// Runs elsewhere, once unmeasured and then measured; says the seconds of a call.
    There(Box<dyn FnMut() -> f64 + 'a>),
}

pub fn contender<'a>(name: impl Into<String>, work: impl FnMut() + 'a) -> Contender<'a> {
    Contender {
        name: name.into(),
        work: Work::Here(Box::new(work)),
        bytes: None,
    }
}

/// A contender that runs on a thread of a pool.
pub fn inside<'a>(
    pool: &'a rayon::ThreadPool,
    name: impl Into<String>,
    work: impl FnMut() + Send + 'a,
) -> Contender<'a> {
    Contender {
        name: name.into(),
        work: Work::Inside(pool, Box::new(work)),
        bytes: None,
    }
}

/// A contender in another process, which is asked for the seconds of a call.
pub fn remote<'a>(name: impl Into<String>, seconds: impl FnMut() -> f64 + 'a) -> Contender<'a> {
    Contender {
        name: name.into(),
        work: Work::There(Box::new(seconds)),
        bytes: None,
    }
}

impl Contender<'_> {
    /// The size of what it makes stands in the table.
    pub fn sized(mut self, bytes: usize) -> Self {
        self.bytes = Some(bytes);
        self
    }

    pub fn bytes(&self) -> Option<usize> {
        self.bytes
    }

    /// Seconds of a call.
    fn sample(&mut self, repeats: u32) -> f64 {
        match &mut self.work {
            Work::Here(work) => timed(work, repeats),
            Work::Inside(pool, work) => pool.install(|| timed(work, repeats)),
            Work::There(seconds) => seconds(),
        }
    }

    /// How many calls make a sample.
    fn repeats(&mut self) -> u32 {
        let once = self.sample(1).max(50e-9);
        match self.work {
            Work::There(_) => 1,
            _ => ((SAMPLE.as_secs_f64() / once) as u32).clamp(1, 5000),
        }
    }
}

fn timed(work: &mut dyn FnMut(), repeats: u32) -> f64 {
    // One unmeasured call brings the contender's own data back into the caches that the others have
    // taken.
    work();
    let start = Instant::now();
    for _ in 0..repeats {
        work();
    }
    start.elapsed().as_secs_f64() / f64::from(repeats)
}

/// A sample lasts at least this long; shorter work is repeated inside it.
const SAMPLE: Duration = Duration::from_micros(300);
/// A contender that has taken so long rests while the others go on, ...
const ENOUGH: Duration = Duration::from_millis(1200);
/// ... once it has this number of samples.
const MIN_SAMPLES: usize = 5;

/// Samples of one contender, seconds of a call, rising.
pub struct Times(Vec<f64>);

impl Times {
    pub fn new(mut samples: Vec<f64>) -> Self {
        samples.sort_unstable_by(f64::total_cmp);
        Self(samples)
    }

    pub fn quantile(&self, part: f64) -> f64 {
        self.0[((self.0.len() as f64 * part) as usize).min(self.0.len() - 1)]
    }

    pub fn median(&self) -> f64 {
        self.quantile(0.5)
    }

    /// The twentieth part of the samples was at least so fast: what the work takes when nobody
    /// disturbs it.
    pub fn low(&self) -> f64 {
        self.quantile(0.05)
    }

    pub fn samples(&self) -> &[f64] {
        &self.0
    }
}

/// `rounds` samples of each contender, taken in turn.
pub fn times(rounds: usize, contenders: &mut [Contender<'_>]) -> Vec<Times> {
    let repeats: Vec<u32> = contenders.iter_mut().map(Contender::repeats).collect();
    let mut samples = vec![Vec::with_capacity(rounds); contenders.len()];
    let mut spent = vec![Duration::ZERO; contenders.len()];
    for round in 0..rounds {
        for (((c, &repeats), samples), spent) in contenders
            .iter_mut()
            .zip(&repeats)
            .zip(&mut samples)
            .zip(&mut spent)
        {
            if round < MIN_SAMPLES || *spent < ENOUGH {
                let start = Instant::now();
                samples.push(c.sample(repeats));
                *spent += start.elapsed();
            }
        }
    }
    samples.into_iter().map(Times::new).collect()
}

/// Median seconds of one call of each contender.
pub fn medians(rounds: usize, contenders: &mut [Contender<'_>]) -> Vec<f64> {
    times(rounds, contenders)
        .iter()
        .map(Times::median)
        .collect()
}

/// The exponent with which time grows while something grows from `a` to `b`: 1 is linear.
pub fn slope([a, b]: [f64; 2], [time_a, time_b]: [f64; 2]) -> f64 {
    (time_b / time_a).ln() / (b / a).ln()
}

/// A report that is printed and kept.
pub struct Report {
    name: &'static str,
    text: String,
    goals: String,
    /// Of the last table.
    times: Vec<Times>,
    /// Whether only a part of it was asked for.
    is_part: bool,
}

impl Report {
    pub fn new(name: &'static str, what: &str) -> Self {
        Self::chosen(name, what, !filter().is_empty())
    }

    /// A report that the argument selects, all of it or a part.
    pub fn chosen(name: &'static str, what: &str, is_part: bool) -> Self {
        let mut report = Self {
            name,
            text: String::new(),
            goals: String::new(),
            times: Vec::new(),
            is_part,
        };
        report.line(&format!("# {name}: {what}\n"));
        report.line(&format!(
            "Machine: {}; level {}.\n",
            machine(),
            mlswarp::level::SimdLevel::detect().name()
        ));
        report
    }

    pub fn line(&mut self, line: &str) {
        println!("{line}");
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// Times the contenders and prints a table with the ratio of each to the first. Returns the
    /// medians, seconds.
    pub fn table(
        &mut self,
        title: &str,
        rounds: usize,
        contenders: &mut [Contender<'_>],
    ) -> Vec<f64> {
        self.against(title, 0, rounds, contenders)
    }

    /// The same with the ratio to contender number `rival`.
    pub fn against(
        &mut self,
        title: &str,
        rival: usize,
        rounds: usize,
        contenders: &mut [Contender<'_>],
    ) -> Vec<f64> {
        let times = times(rounds, contenders);
        let sizes = contenders.iter().any(|c| c.bytes.is_some());
        let to = if rival == 0 {
            "the first".to_owned()
        } else {
            contenders[rival].name.clone()
        };
        let mut table =
            format!("## {title}\n\n| what | median | ratio to {to} | fastest 5 % | its ratio |");
        table += if sizes {
            " bytes | ratio |\n|---|---:|---:|---:|---:|---:|---:|\n"
        } else {
            "\n|---|---:|---:|---:|---:|\n"
        };
        let (base, base_low, base_bytes) = (
            times[rival].median(),
            times[rival].low(),
            contenders[rival].bytes,
        );
        for (c, t) in contenders.iter().zip(&times) {
            let (median, low) = (t.median(), t.low());
            let row = format!(
                "| {} | {} | {:.2} | {} | {:.2} |",
                c.name,
                time(median),
                median / base,
                time(low),
                low / base_low
            );
            table += &row;
            match (c.bytes, base_bytes) {
                (Some(bytes), Some(base)) => {
                    writeln!(table, " {bytes} | {:.3} |", bytes as f64 / base as f64)
                }
                (Some(bytes), None) => writeln!(table, " {bytes} | |"),
                (None, _) => writeln!(table, "{}", if sizes { " | |" } else { "" }),
            }
            .expect("a string takes what is written");
        }
        self.line(&table);
        self.times = times;
        self.times.iter().map(Times::median).collect()
    }

    /// Contender `a` to contender `b` of the last table.
    pub fn ratio(&self, a: usize, b: usize) -> Figure {
        let (a, b) = (&self.times[a], &self.times[b]);
        Figure {
            median: a.median() / b.median(),
            low: Some(a.low() / b.low()),
        }
    }

    /// A figure beside the goal that it is held against; the goals stand together at the report's
    /// end.
    pub fn goal(&mut self, what: &str, figure: impl Into<Figure>, goal: Goal) {
        let Figure {
            median: figure,
            low,
        } = figure.into();
        let (words, met) = match goal {
            Goal::AtMost(limit) => (format!("at most {limit:.3}"), figure <= limit),
            Goal::AtLeast(limit) => (format!("at least {limit:.3}"), figure >= limit),
            Goal::Between(low, high) => {
                (format!("{low} to {high}"), (low..=high).contains(&figure))
            }
        };
        let low = low.map_or_else(String::new, |low| format!("{low:.3}"));
        let row = format!(
            "| {what} | {figure:.3} | {words} | {} | {low} |\n",
            if met { "yes" } else { "no" }
        );
        self.goals.push_str(&row);
    }
}

/// What is held against a goal.
#[derive(Clone, Copy)]
pub struct Figure {
    pub median: f64,
    /// The same of the fastest 5 %.
    pub low: Option<f64>,
}

impl From<f64> for Figure {
    fn from(median: f64) -> Self {
        Self { median, low: None }
    }
}

/// What a figure should be.
#[derive(Clone, Copy)]
pub enum Goal {
    AtMost(f64),
    AtLeast(f64),
    Between(f64, f64),
}

impl Drop for Report {
    fn drop(&mut self) {
        if !self.goals.is_empty() {
            let goals = format!(
                "## Goals\n\n| what | figure | goal | met | of the fastest 5 % \
                    |\n|---|---:|---|---|---:|\n{}",
                self.goals
            );
            self.line(&goals);
        }
        // A part of a report does not replace a whole one.
        if std::thread::panicking() || self.is_part {
            return;
        }
        let folder =
            std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/bench/results");
        let text = self.text.trim_end().to_owned() + "\n";
        let written = std::fs::create_dir_all(&folder)
            .and_then(|()| std::fs::write(folder.join(format!("{}.md", self.name)), text));
        if let Err(error) = written {
            eprintln!("the results were not written: {error}");
        }
    }
}

/// The argument: tables whose title contains it are run. Empty runs everything.
pub fn filter() -> String {
    std::env::args()
        .skip(1)
        .find(|arg| !arg.starts_with('-'))
        .unwrap_or_default()
}

/// Whether the argument lets `title` run.
pub fn wanted(title: &str) -> bool {
    title.contains(&filter())
}

/// What follows a flag: `--paired DIR`.
pub fn option(flag: &str) -> Option<String> {
    std::env::args().skip_while(|arg| arg != flag).nth(1)
}

pub fn time(seconds: f64) -> String {
    if seconds < 1e-3 {
        format!("{:.1} us", seconds * 1e6)
    } else {
        format!("{:.3} ms", seconds * 1e3)
    }
}

fn machine() -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo")
        .ok()
        .and_then(|s| {
            s.lines()
                .find(|l| l.starts_with("model name"))
                .and_then(|l| l.split(": ").nth(1))
                .map(str::to_owned)
        })
        .unwrap_or_else(|| "unknown processor".to_owned());
    // Others at work on the same cores spoil two threads first.
    let load = std::fs::read_to_string("/proc/loadavg").ok().and_then(|s| {
        s.split(' ')
            .next()
            .map(|load| format!(", load {load} before"))
    });
    format!(
        "{cpu}, {} threads{}",
        std::thread::available_parallelism().map_or(1, usize::from),
        load.unwrap_or_default()
    )
}

/// A pool of this many threads. On Linux, two or more are pinned to logical processors 0, 1, ...:
/// otherwise the scheduler may leave two of them on one for longer than a sample lasts.
pub fn pool(threads: usize) -> rayon::ThreadPool {
    let pinned = move |thread| {
        #[cfg(target_os = "linux")]
        if threads > 1 {
            let mut cores = rustix::thread::CpuSet::new();
            cores.set(thread);
            // Not permitted in a restricted set of processors; then the thread is not pinned.
            let _ = rustix::thread::sched_setaffinity(None, &cores);
        }
    };
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .start_handler(pinned)
        .build()
        .expect("a pool of a few threads")
}
