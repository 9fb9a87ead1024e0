//! One program for every target: libFuzzer gives the bytes, `MLSWARP_FUZZ` names the target.

#![no_main]

#[path = "../mutation.rs"]
#[expect(
    dead_code,
    clippy::cast_possible_truncation,
    reason = "only the mending of pictures is wanted here"
)]
mod mutation;
#[path = "../targets/mod.rs"]
mod targets;

use std::sync::LazyLock;

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};

static TARGET: LazyLock<targets::Target> = LazyLock::new(|| {
    // A decoder's panic is caught and is a damaged file; libfuzzer-sys would end the process where
    // it begins. What gets out of a target still does.
    drop(std::panic::take_hook());
    let name = std::env::var("MLSWARP_FUZZ").unwrap_or_default();
    targets::TARGETS
        .into_iter()
        .find(|(known, _)| *known == name)
        .expect("MLSWARP_FUZZ names a target")
});

fuzz_target!(|bytes: &[u8]| (TARGET.1)(bytes));

// Half of the pictures have sound checksums and lengths: others end there.
fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let size = fuzzer_mutate(data, size, max_size);
    if TARGET.0 == "image" && seed.is_multiple_of(2) {
        mutation::mend(&mut data[..size]);
    }
    size
});
