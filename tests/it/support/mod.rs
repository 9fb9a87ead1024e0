//! What the topics share: pictures made on the spot, a server on a real socket of the loopback, and the program itself.

pub(crate) mod bombs;
pub(crate) mod hand;
pub(crate) mod picture;
pub(crate) mod program;
pub(crate) mod server;

pub(crate) use hand::Hand;
pub(crate) use picture::photo;
pub(crate) use server::Server;

use std::time::{Duration, Instant};

/// Waits until something that must come about has come about.
pub(crate) async fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < Duration::from_secs(30), "{what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}
