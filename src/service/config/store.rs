//! Where sessions live, and how many.

use clap::Args;

use super::{Mistakes, units, whole};
use crate::service::store::Bounds;

/// Options of the store, as text.
#[derive(Debug, Args)]
pub(super) struct StoreArgs {
    /// How long a session lives without being used.
    #[arg(long, env = "MLSWARP_SESSION_IDLE", value_name = "TIME", default_value = "15m", global = true)]
    session_idle: String,
    /// Most sessions; one more is answered 503.
    #[arg(long, env = "MLSWARP_MAX_SESSIONS", value_name = "N", default_value = "10000", global = true)]
    max_sessions: String,
    /// Memory for the sessions' picture files; one more is answered 503.
    #[arg(long, env = "MLSWARP_STORE_BYTES", value_name = "SIZE", default_value = "1GiB", global = true)]
    store_bytes: String,
}

/// Where sessions live, and how many.
#[derive(Clone, Debug, PartialEq)]
pub struct StoreConfig {
    /// How many, and for how long.
    pub bounds: Bounds,
}

impl StoreArgs {
    pub(super) fn resolve(&self, m: &mut Mistakes) -> StoreConfig {
        StoreConfig {
            bounds: Bounds {
                idle: m.read("session-idle", &self.session_idle, units::span),
                sessions: m.read("max-sessions", &self.max_sessions, |t| whole(t, 0, 100_000_000)),
                bytes: m.read("store-bytes", &self.store_bytes, units::bytes),
            },
        }
    }
}
