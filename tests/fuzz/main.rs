//! Fuzzing in short: every target over its seeds, over what was found before, and over damage by
//! chance, the same on every run. Without coverage to guide it, on the program as the other tests
//! build it: what takes minutes to build and hours to run is in `long/`.

#![expect(
    clippy::cast_possible_truncation,
    reason = "random numbers are cut to bytes"
)]
#![expect(clippy::print_stdout, reason = "what was tried is what is read")]

mod mutation;
mod targets;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use mutation::{Dice, damaged, damaged_picture, files};
use targets::TARGETS;

/// Inputs made of the seeds, for each target.
fn count(name: &str) -> usize {
    let short = match name {
        "image" => 4_000,
        "multipart" => 1_500,
        "socket" => 300,
        _ => 20_000,
    };
    if std::env::var_os("MLSWARP_TESTS_FULL").is_some() {
        20 * short
    } else {
        short
    }
}

fn fuzz(name: &str) {
    let (_, target) = TARGETS
        .into_iter()
        .find(|(known, _)| *known == name)
        .expect("a target");
    let mut corpus = files(&format!("seeds/{name}"));
    corpus.extend(files(&format!("found/{name}")));
    assert!(!corpus.is_empty(), "{name} has seeds");
    let began = Instant::now();
    let run = |what: &str, input: &[u8]| {
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| target(input))) {
            let kept = format!(
                "{}/../../tests/artefacts/fuzz-{name}",
                env!("CARGO_MANIFEST_DIR")
            );
            // Whether or not it can be kept, the test fails.
            let _ = std::fs::create_dir_all(format!(
                "{}/../../tests/artefacts",
                env!("CARGO_MANIFEST_DIR")
            ));
            let _ = std::fs::write(&kept, input);
            println!("{name}: {what} breaks a law; the input is kept as {kept}");
            std::panic::resume_unwind(panic);
        }
    };
    for (file, input) in &corpus {
        run(file, input);
    }
    for n in 0..count(name) {
        let mut dice = Dice::new(n as u64);
        let (file, seed) = &corpus[n % corpus.len()];
        let other = &corpus[dice.below(corpus.len())].1;
        let input = if name == "image" {
            damaged_picture(&mut dice, seed, other)
        } else {
            damaged(&mut dice, seed, other)
        };
        run(&format!("{file}, damaged by {n},"), &input);
    }
    println!(
        "{name}: {} kept inputs and {} new ones in {:.1} s",
        corpus.len(),
        count(name),
        began.elapsed().as_secs_f64()
    );
}

#[test]
fn image_files_decode_as_their_header_says_or_not_at_all() {
    fuzz("image");
}

#[test]
fn warp_json_is_warped_or_refused() {
    fuzz("warp");
}

#[test]
fn multipart_bodies_are_answered() {
    fuzz("multipart");
}

#[test]
fn socket_messages_are_answered_and_never_end_the_drag() {
    fuzz("socket");
}

#[test]
fn records_are_read_as_they_were_written_or_not_at_all() {
    for (name, seed) in files("seeds/record") {
        let text = String::from_utf8_lossy(&seed[1..]);
        let kept = if seed[0] == b'1' {
            format!("{:08x}\n{text}", crc32fast::hash(text.as_bytes()))
        } else {
            text.into_owned()
        };
        assert!(
            mlswarp_server::store::record::read(kept.as_bytes()).is_ok(),
            "the seed {name} is a record"
        );
    }
    fuzz("record");
}

#[test]
fn landmark_files_are_read_or_refused_with_a_place() {
    fuzz("landmarks");
}

#[test]
fn tokens_are_checked_and_none_is_let_in_by_chance() {
    fuzz("token");
}

#[test]
fn law_finite_and_as_exact_as_promised_for_any_handles() {
    fuzz("law");
}
