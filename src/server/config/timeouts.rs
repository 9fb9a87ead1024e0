//! Options that limit how long clients may take, and how the service stops.

use std::time::Duration;

use clap::Args;

use super::option::checked;
use super::units::{pause, span};

/// How long clients may take, and how the service stops.
#[derive(Args, Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeouts {
    /// Maximum time from the head of a request to the head of its response.
    #[arg(long = "request-timeout", value_name = "TIME", default_value = "60s", value_parser = checked(span))]
    pub request: Duration,
    /// Maximum time for the first byte of a connection, for a TLS handshake, for the head of a request, and between two requests.
    #[arg(long = "header-timeout", value_name = "TIME", default_value = "10s", value_parser = checked(span))]
    pub header: Duration,
    /// Maximum time for the body of a request.
    #[arg(long = "body-timeout", value_name = "TIME", default_value = "30s", value_parser = checked(span))]
    pub body: Duration,
    /// Maximum time in which a client reads nothing of its response.
    #[arg(long = "write-timeout", value_name = "TIME", default_value = "30s", value_parser = checked(span))]
    pub write: Duration,
    /// Time after which a silent drag socket is pinged; without an answer it is closed after the same time again.
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = checked(span))]
    pub socket_idle: Duration,
    /// Maximum time in which the client of a drag socket reads a message, and acknowledges a frame.
    #[arg(long = "socket-timeout", value_name = "TIME", default_value = "30s", value_parser = checked(span))]
    pub socket: Duration,
    /// Time after SIGTERM or Ctrl-C during which new requests are still served while /readyz answers 503, so that proxies notice. A second
    /// signal ends it and the grace period: all connections are closed one second later.
    #[arg(long, value_name = "TIME", default_value = "0s", value_parser = checked(pause))]
    pub drain_delay: Duration,
    /// Time after the drain delay that running requests have to finish.
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = checked(span))]
    pub shutdown_grace: Duration,
}
