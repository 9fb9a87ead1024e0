//! The thread of the asynchronous runtime moves bytes and computes nothing that grows with what a
//! client sends or keeps: a request of one client would delay those of all others. Every operation
//! of the OpenAPI document is sent with the largest session there may be.

use std::time::{Duration, Instant};

use crate::support::clocked::ClockedServer;
use crate::support::is_full;
use crate::support::largest::{Material, Request, Sizes};
use crate::support::redis::Redis;

/// The most processor time of a poll of a task.
const MAX_POLL_TIME: Duration = Duration::from_micros(200);
/// What the dev profile needs in place of that, beside other tests: the service is not optimised.
/// What computes needs far more.
const DEBUG: u32 = if cfg!(debug_assertions) { 25 } else { 1 };
/// Times that each request is sent, of which the median counts, and in the dev profile the least:
/// other tests that run at the same time only add to it. Fewer if that takes long and is within the
/// limit.
const TIMES: usize = 20;
const LONG_TIME: Duration = Duration::from_millis(500);
const FEWEST: usize = 3;
/// Bodies that are much larger than what one poll may move.
const SIZES: Sizes = Sizes {
    handles: 10_000,
    json: 1 << 20,
    body: 1 << 20,
};

/// The longest polls of the runtime's thread, one for each time that the request is sent, in order.
fn longest_polls(server: &ClockedServer, material: &Material, request: &Request) -> Vec<Duration> {
    let began = Instant::now();
    let mut longest = Vec::new();
    while longest.len() < TIMES
        && (is_full()
            || longest.len() < FEWEST
            || began.elapsed() < LONG_TIME
            || began.elapsed() < 6 * LONG_TIME
                && longest.iter().all(|&poll| poll > DEBUG * MAX_POLL_TIME))
    {
        let own = request
            .needs_session()
            .then(|| request.of(&material.session(server.address)));
        let request = own.as_ref().unwrap_or(request);
        let (poll, (status, read)) = server.longest(|| request.exchange(server.address));
        assert_eq!(
            status,
            request.status,
            "{}: {}",
            request.what,
            String::from_utf8_lossy(&read[..read.len().min(2000)])
        );
        longest.push(poll);
    }
    longest.sort_unstable();
    longest
}

/// The test itself: a task that computes is seen.
#[test]
fn a_poll_that_computes_is_measured() {
    let server = ClockedServer::start(&[]);
    let (longest, ()) = server.longest(|| server.compute(20 * MAX_POLL_TIME));
    assert!(longest >= 20 * MAX_POLL_TIME, "{longest:?}");
    let (longest, ()) = server.longest(|| ());
    assert!(longest < 20 * MAX_POLL_TIME, "{longest:?}");
}

#[test]
fn every_operation_has_its_largest_requests() {
    let requests = Material::unopened(SIZES).requests();
    assert!(requests.len() > 60, "{}", requests.len());
}

/// The requests whose polls take too long, of those that `is_sent` names.
fn slow(
    server: &ClockedServer,
    material: &Material,
    is_sent: impl Fn(&Request) -> bool,
) -> Vec<String> {
    let mut slow = Vec::new();
    for request in material.requests().into_iter().filter(is_sent) {
        let began = Instant::now();
        let longest = longest_polls(server, material, &request);
        let (median, last) = (longest[longest.len() / 2], longest[longest.len() - 1]);
        let counted = if cfg!(debug_assertions) {
            longest[0]
        } else {
            median
        };
        eprintln!(
            "{median:>9.1?}, at least {:>9.1?}, at most {last:>9.1?} of {} in {:.1?}: {}",
            longest[0],
            longest.len(),
            began.elapsed(),
            request.what
        );
        if counted > DEBUG * MAX_POLL_TIME {
            slow.push(format!("{}: {counted:?}", request.what));
        }
    }
    slow
}

fn assert_none(slow: &[String]) {
    assert!(
        slow.is_empty(),
        "the runtime's thread computes for longer than {:?}: {slow:#?}",
        DEBUG * MAX_POLL_TIME
    );
}

#[test]
fn no_poll_takes_longer_than_moving_a_few_pieces_whatever_is_sent() {
    let server = ClockedServer::start(&["--max-warp-json-bytes", "1MiB"]);
    let material = Material::prepare(server.address, SIZES);
    assert_none(&slow(&server, &material, |_| true));
}

/// Records that another process keeps are written, digested and read on other threads as well: by
/// the server that has stored them, and by one that sees them for the first time.
#[test]
fn records_in_redis_are_read_and_written_on_other_threads() {
    let redis = Redis::start(&[]);
    let address = redis.address();
    let options = ["--max-warp-json-bytes", "1MiB", "--store", &address];
    let server = ClockedServer::start(&options);
    let material = Material::prepare(server.address, SIZES);
    let is_of = |names: &'static [&str]| {
        move |request: &Request| names.iter().any(|name| request.what.starts_with(name))
    };
    let written = is_of(&["putHandles", "putLayer labels", "deleteLayer"]);
    assert_none(&slow(&server, &material, written));
    let other = ClockedServer::start(&options);
    let read =
        |request: &Request| is_of(&["getSession"])(request) && request.what.ends_with("(HEAD)");
    assert_none(&slow(&other, &material, read));
}
