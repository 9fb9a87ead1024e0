//! The largest requests of every operation of the OpenAPI document, many at a time, whose answers
//! nobody reads. Everything that they take is reserved before, so that the memory of the process
//! stays near its budget.

use std::net::Ipv4Addr;
use std::sync::Barrier;
use std::time::{Duration, Instant};

use crate::support::largest::{Material, Request, Sizes};
use crate::support::program::Program;

/// The budget, MiB, and what the process takes at most beside it, as deploy/README.md says.
const BUDGET: u64 = 128;
const BESIDE_MIB: u64 = 96;
/// Requests at a time.
const COUNT: usize = 16;
/// Time for which answers are left unread, once each has begun.
const UNREAD: Duration = Duration::from_millis(50);
/// The limits, in proportion to the budget as by default.
const SIZES: Sizes = Sizes {
    handles: 2500,
    json: 512 << 10,
    body: 2 << 20,
};

/// Sends a request a number of times at once, from several addresses; the statuses of the answers,
/// in order.
fn send(program: &Program, request: &Request, addresses: usize) -> Vec<u16> {
    let begun = Barrier::new(COUNT);
    let one = |k: usize| {
        let from = Ipv4Addr::new(127, 0, 0, u8::try_from(2 + k % addresses).unwrap());
        let stream = request.send(from, program.address);
        let answered = stream.and_then(|mut stream| Ok((request.status(&mut stream)?.0, stream)));
        begun.wait();
        std::thread::sleep(UNREAD);
        answered.map_or(0, |(status, _unread)| status)
    };
    let mut statuses: Vec<u16> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..COUNT).map(|k| scope.spawn(move || one(k))).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    statuses.sort_unstable();
    statuses
}

fn stays_near_the_budget(addresses: usize) {
    let program = Program::start(&[
        "--memory-bytes",
        &format!("{BUDGET}MiB"),
        "--max-warp-json-bytes",
        &SIZES.json.to_string(),
        "--max-columns",
        &SIZES.handles.to_string(),
        "--max-body-bytes",
        &SIZES.body.to_string(),
        "--workers",
        "2",
    ]);
    let material = Material::prepare(program.address, SIZES);
    let mut above = Vec::new();
    for request in material.requests() {
        let own = request
            .needs_session()
            .then(|| request.of(&material.session(program.address)));
        let request = own.as_ref().unwrap_or(&request);
        program.forget_peak();
        let began = Instant::now();
        let statuses = send(&program, request, addresses);
        let peak = program.peak();
        eprintln!(
            "{peak:>6} MiB in {:>7.1?}: {}, answered {statuses:?}",
            began.elapsed(),
            request.what
        );
        // Otherwise it is not known what the request takes.
        assert!(
            statuses.contains(&request.status),
            "{}: {statuses:?}",
            request.what
        );
        if peak > BUDGET + BESIDE_MIB {
            above.push(format!("{}: {peak} MiB", request.what));
        }
    }
    assert!(
        above.is_empty(),
        "more than {} MiB: {above:#?}",
        BUDGET + BESIDE_MIB
    );
}

#[test]
#[ignore = "sends the largest requests, many at a time: a step of its own in tests/run, so that \
    the other tests keep their pace"]
fn of_one_address_stay_near_the_budget() {
    stays_near_the_budget(1);
}

#[test]
#[ignore = "sends the largest requests, many at a time: a step of its own in tests/run, so that \
    the other tests keep their pace"]
fn of_eight_addresses_stay_near_the_budget() {
    stays_near_the_budget(8);
}
