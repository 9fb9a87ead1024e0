//! A drag, from q to the bytes of a PNG, and of a JPEG: in process, and over loopback from the
//! service in a process of its own. Rigid, alpha 1, 100 x 100 vertices, RGBA, transparent outside,
//! PNG `fast`; nothing is timed that is made once (the picture, the plan).
//!
//! `cargo bench --bench request [-- FILTER]`; a filter is a part of a title (`in process`,
//! `loopback`, `3840 x 2160`, ...). `request --paired DIR` writes the picture and the handles there
//! and then times `1 thread`, `2 threads` and `deform` of 500 x 500 when it is asked to (see
//! `harness/paired.rs`).

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    reason = "a program that prints a table"
)]

#[path = "request/client.rs"]
mod client;
#[path = "request/drag.rs"]
mod drag;
#[path = "harness/mod.rs"]
mod harness;
#[path = "request/in_process.rs"]
mod in_process;
#[path = "request/landmarks.rs"]
mod landmarks;
#[path = "request/loopback.rs"]
mod loopback;
#[path = "request/service.rs"]
mod service;

use std::path::Path;

fn main() {
    if std::env::args().any(|arg| arg == in_process::ANSWER) {
        return in_process::answer(None);
    }
    if let Some(folder) = harness::option("--paired") {
        return in_process::answer(Some(Path::new(&folder)));
    }
    let mut report = harness::Report::new(
        "request",
        "q to the bytes of a PNG, in process and over loopback",
    );
    in_process::tables(&mut report);
    loopback::tables(&mut report);
}
