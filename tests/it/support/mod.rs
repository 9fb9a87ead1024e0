//! What the topics share: pictures made on the spot, a server on a real socket of the loopback, and
//! the program itself.

pub(crate) mod bombs;
pub(crate) mod clocked;
pub(crate) mod collector;
pub(crate) mod counters;
pub(crate) mod drag_client;
pub(crate) mod healthy;
pub(crate) mod http2;
pub(crate) mod largest;
pub(crate) mod picture;
pub(crate) mod program;
#[allow(dead_code, reason = "the store's unit tests use the rest of it")]
pub(crate) mod redis;
pub(crate) mod relay;
pub(crate) mod server;

pub(crate) use drag_client::DragClient;
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

/// A directory that goes with the test.
pub(crate) struct Scratch(std::path::PathBuf);

impl Scratch {
    pub(crate) fn new() -> Self {
        let directory = std::env::temp_dir().join(format!("mlswarp-test-{}", uuid::Uuid::new_v4()));
        std::fs::create_dir(&directory).unwrap();
        Self(directory)
    }

    /// A place in it.
    pub(crate) fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Whether tests take their longer forms.
pub(crate) fn is_full() -> bool {
    std::env::var_os("MLSWARP_TESTS_FULL").is_some()
}
