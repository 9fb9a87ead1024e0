//! Options of the session store.

use clap::Args;

use super::option::{Checked, bytes, span, whole};
use crate::store::{StoreLimits, StoreUrl};

/// Where sessions are stored, and how many.
#[derive(Args, Clone, Debug, PartialEq)]
#[command(next_help_heading = "Sessions")]
pub struct StoreConfig {
    /// Session store: `memory`, `file:PATH`, or `redis://[user:password@]host[:port][/database]`
    /// (Redis or Valkey).
    #[arg(
        long = "store",
        value_name = "STORE",
        default_value = "memory",
        hide_env_values = true
    )]
    #[arg(value_parser = Checked(str::parse::<StoreUrl>))]
    pub url: StoreUrl,
    /// Time after which an unused session expires.
    #[arg(long, value_name = "TIME", default_value = "15m", value_parser = Checked(span))]
    pub session_idle: std::time::Duration,
    /// Maximum number of sessions; a request to open another one is answered 503. (Redis: limited
    /// by its own memory only.)
    #[arg(long, value_name = "N", default_value = "10000",
        value_parser = Checked(whole::<usize>(0, 100_000_000)))]
    max_sessions: usize,
    /// Maximum size of the sessions' records and image files; a session that does not fit is
    /// answered 503. (Redis: memory for this process's copies of records; Redis itself is limited
    /// by its `maxmemory`.)
    #[arg(long, value_name = "SIZE", default_value = "1GiB", value_parser = Checked(bytes))]
    store_bytes: u64,
}

impl StoreConfig {
    /// The limits of the store.
    pub const fn bounds(&self) -> StoreLimits {
        StoreLimits {
            idle: self.session_idle,
            sessions: self.max_sessions,
            bytes: self.store_bytes,
        }
    }
}
