//! Where sessions live, and how many.

use clap::Args;

use super::access::Secret;
use super::{Mistakes, units, whole};
use crate::store::{Bounds, StoreUrl};

/// Options of the store, as text.
#[derive(Debug, Args)]
pub(crate) struct StoreArgs {
    /// Where sessions live: `memory`, `file:PATH`, or `redis://[user:password@]host[:port][/database]` (Redis or Valkey).
    #[arg(long, env = "MLSWARP_STORE", value_name = "STORE", default_value = "memory", hide_env_values = true, global = true)]
    store: Secret,
    /// How long a session lives without being used.
    #[arg(long, env = "MLSWARP_SESSION_IDLE", value_name = "TIME", default_value = "15m", global = true)]
    session_idle: String,
    /// Most sessions; one more is answered 503. (Redis: no bound but its own memory.)
    #[arg(long, env = "MLSWARP_MAX_SESSIONS", value_name = "N", default_value = "10000", global = true)]
    max_sessions: String,
    /// Bytes of the sessions' records and picture files; one more is answered 503. (Redis: memory for records that this process remembers; what it
    /// may hold itself is its `maxmemory`.)
    #[arg(long, env = "MLSWARP_STORE_BYTES", value_name = "SIZE", default_value = "1GiB", global = true)]
    store_bytes: String,
}

/// Where sessions live, and how many.
#[derive(Clone, Debug, PartialEq)]
pub struct StoreConfig {
    /// Where.
    pub place: StoreUrl,
    /// How many, and for how long.
    pub bounds: Bounds,
}

impl StoreArgs {
    pub(crate) fn resolve(&self, m: &mut Mistakes) -> StoreConfig {
        StoreConfig {
            place: m.read("store", &self.store.0, str::parse),
            bounds: Bounds {
                idle: m.read("session-idle", &self.session_idle, units::span),
                sessions: m.read("max-sessions", &self.max_sessions, |t| whole(t, 0, 100_000_000)),
                bytes: m.read("store-bytes", &self.store_bytes, units::bytes),
            },
        }
    }
}
