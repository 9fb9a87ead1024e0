//! Who is let in, and how long clients may take.

use std::time::Duration;

use clap::Args;

use super::{Mistakes, units};

/// The options as text; [`DoorsArgs::resolve`] reads them.
#[derive(Debug, Args)]
pub(super) struct DoorsArgs {
    /// Longest time from a request's head to its answer's head.
    #[arg(long, env = "MLSWARP_REQUEST_TIMEOUT", value_name = "TIME", default_value = "60s", global = true)]
    request_timeout: String,
    /// Longest time for a connection's first byte, for a request's head, and between two requests.
    #[arg(long, env = "MLSWARP_HEADER_TIMEOUT", value_name = "TIME", default_value = "10s", global = true)]
    header_timeout: String,
    /// Longest time for a request's body.
    #[arg(long, env = "MLSWARP_BODY_TIMEOUT", value_name = "TIME", default_value = "30s", global = true)]
    body_timeout: String,
    /// How long requests may go on after SIGTERM or Ctrl-C.
    #[arg(long, env = "MLSWARP_SHUTDOWN_GRACE", value_name = "TIME", default_value = "20s", global = true)]
    shutdown_grace: String,
}

/// Who is let in, and how long clients may take.
#[derive(Clone, Debug, PartialEq)]
pub struct DoorsConfig {
    /// Longest time from a request's head to its answer's head.
    pub request_timeout: Duration,
    /// Longest time for a connection's first byte, a request's head, and between two requests.
    pub header_timeout: Duration,
    /// Longest time for a request's body.
    pub body_timeout: Duration,
    /// How long requests may go on after a signal to stop.
    pub shutdown_grace: Duration,
}

impl DoorsArgs {
    pub(super) fn resolve(&self, m: &mut Mistakes) -> DoorsConfig {
        DoorsConfig {
            request_timeout: m.read("request-timeout", &self.request_timeout, units::span),
            header_timeout: m.read("header-timeout", &self.header_timeout, units::span),
            body_timeout: m.read("body-timeout", &self.body_timeout, units::span),
            shutdown_grace: m.read("shutdown-grace", &self.shutdown_grace, units::span),
        }
    }
}
