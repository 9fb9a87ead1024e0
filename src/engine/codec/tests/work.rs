//! The number of steps depends on a file's bytes and on the pixels that it claims within the
//! limits, whatever else it claims. Steps are those of this crate's parsers and the library
//! decoders' requests for input; `tests/counts/run` counts the instructions of the decoders. The
//! corpus: every kind of file, damaged files, bombs, the seeds of the fuzz target and its findings.

use std::cell::Cell;

use super::super::probe::Parsed;
use super::bombs;
use super::*;

fn folder(name: &str) -> Vec<(String, Vec<u8>)> {
    let folder = format!("{}/test_files/{name}", env!("CARGO_MANIFEST_DIR"));
    let files = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    files
        .map(|path| (path.display().to_string(), std::fs::read(path).unwrap()))
        .collect()
}

fn corpus() -> Vec<(String, Vec<u8>)> {
    let mut files = folder("seeds");
    files.extend(folder("found"));
    assert!(files.len() > 50);
    let tables = files
        .iter()
        .find(|(name, _)| name.ends_with("webp-code-tables"))
        .unwrap()
        .1
        .clone();
    files.extend(
        bombs::all(&tables)
            .into_iter()
            .map(|(name, bytes, _)| (name.to_owned(), bytes)),
    );
    files.extend(
        hostile::claims()
            .into_iter()
            .map(|(name, bytes)| (name.to_owned(), bytes)),
    );
    files.extend(
        metadata::hostile()
            .into_iter()
            .map(|(name, bytes)| (name.to_owned(), bytes)),
    );
    files.extend(
        zoo()
            .into_iter()
            .map(|(name, bytes)| (name.to_owned(), bytes)),
    );
    files
}

/// Bytes of a file's header: all except the data of its pixels. Each chunk counts its own head and
/// eight bytes of its data.
fn header_bytes(bytes: &[u8]) -> u64 {
    let head = match bytes {
        [0x89, ..] => 8,
        [0xFF, ..] => 2,
        // Directories are searched for each tag; sub-blocks may have one byte.
        [b'I' | b'M', ..] => return 2 * bytes.len() as u64,
        [b'G' | b'B', ..] => return bytes.len() as u64,
        _ => 12,
    };
    let (mut at, mut header) = (head, head as u64);
    while at < bytes.len() {
        let rest = &bytes[at.min(bytes.len())..];
        let length = match (bytes, rest) {
            ([0x89, ..], [a, b, c, d, ..]) => u32::from_be_bytes([*a, *b, *c, *d]) as usize + 12,
            ([b'R', ..], [_, _, _, _, a, b, c, d, ..]) => {
                (u32::from_le_bytes([*a, *b, *c, *d]) as usize).next_multiple_of(2) + 8
            }
            ([0xFF, ..], [0xFF, 0xDA, ..]) => break,
            // A segment or a fill byte; anything else ends the header.
            ([0xFF, ..], _) => 1,
            _ => break,
        };
        // The only frame of an animation has chunks of its own.
        let inner = if rest.starts_with(b"ANMF") { length } else { 0 };
        header += inner.max(length.min(16)) as u64;
        at = at.saturating_add(length);
    }
    header
}

/// The steps of reading the header, of opening and of decoding.
fn steps(bytes: &[u8]) -> [u64; 3] {
    let counted = |read: &dyn Fn(&StepCounter<'_>)| {
        let work = StepCounter::new(&|| false);
        read(&work);
        work.steps()
    };
    [
        counted(&|work| drop(Parsed::new(bytes, work))),
        counted(&|work| drop(open(bytes, &ImageLimits::default(), work))),
        counted(&|work| {
            drop(open(bytes, &ImageLimits::default(), work).and_then(|opened| opened.decode()))
        }),
    ]
}

/// Pixels that a file claims, if they are within the limits.
fn claimed(bytes: &[u8]) -> u64 {
    probe(bytes).map_or(0, |header| {
        ImageLimits::default()
            .check(header.extent)
            .map_or(0, |()| header.extent.pixels())
    })
}

#[test]
fn steps_follow_the_bytes_and_the_pixels_of_every_file() {
    let mut worst = [
        (0.0, String::new()),
        (0.0, String::new()),
        (0.0, String::new()),
    ];
    for (name, bytes) in corpus() {
        let (length, pixels) = (bytes.len() as u64, claimed(&bytes));
        let bounds = [
            8 + header_bytes(&bytes),
            256 + 64 * length,
            4_096 + 66 * length + 2 * pixels,
        ];
        for (k, (steps, bound)) in steps(&bytes).into_iter().zip(bounds).enumerate() {
            assert!(
                steps <= bound,
                "{name} ({length} bytes, {pixels} pixels): {steps} steps of at most {bound} ({k})"
            );
            let part = steps as f64 / bound as f64;
            if part > worst[k].0 {
                worst[k] = (part, format!("{:.0} % of {bound}: {name}", 100.0 * part));
            }
        }
    }
    println!(
        "most steps of the header: {}\nof opening: {}\nof decoding: {}",
        worst[0].1, worst[1].1, worst[2].1
    );
}

/// Each file is decoded and cancelled at the first, second, third ... check: it ends there with
/// `Cancelled`.
#[test]
fn decoding_ends_at_the_first_question_that_is_answered_with_no() {
    let mut asked = 0;
    for (name, bytes) in corpus() {
        let mut stop = 0;
        loop {
            let questions = Cell::new(0);
            let cancelled = || {
                questions.set(questions.get() + 1);
                questions.get() > stop
            };
            let result = super::super::decode(&bytes, &ImageLimits::default(), &cancelled);
            asked += 1;
            if questions.get() <= stop {
                break;
            }
            assert!(
                matches!(result, Err(CodecError::Cancelled)),
                "{name}, stopped at question {stop}: {result:?}"
            );
            // A decoder may check a few times more, for example to skip the rest of a file.
            assert!(
                questions.get() <= stop + 8,
                "{name}: {} questions after the answer",
                questions.get() - stop
            );
            stop += 1 + stop * 2;
        }
    }
    assert!(asked > 300, "{asked}");
}
