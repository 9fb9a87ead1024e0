//! Options that limit what clients may use, and for how long.

use std::time::Duration;

use clap::Args;

use super::option::{Checked, Maybe, pause, span, unless, whole};

/// What clients may use: requests per second, connections, sockets and shares of the totals.
#[derive(Args, Clone, Debug, PartialEq)]
#[command(next_help_heading = "Limits of clients")]
pub struct ClientLimits {
    /// Requests per second of one API key name, with bursts of twice as many; further requests are
    /// answered 429.
    #[arg(long, value_name = "N|off", default_value = "off",
        value_parser = Checked(unless("off", whole::<u32>(1, 1_000_000))))]
    pub rate_per_key: Maybe<u32>,
    /// Requests per second of one visitor: of all tokens for one session, with bursts of twice as
    /// many; further requests are answered 429. They also count for the key.
    #[arg(long, value_name = "N|off", default_value = "off",
        value_parser = Checked(unless("off", whole::<u32>(1, 1_000_000))))]
    pub rate_per_visitor: Maybe<u32>,
    /// Requests per second of one address (IPv6: one /64), with bursts of twice as many; further
    /// requests are answered 429.
    #[arg(long, value_name = "N|off", default_value = "off",
        value_parser = Checked(unless("off", whole::<u32>(1, 1_000_000))))]
    pub rate_per_address: Maybe<u32>,
    /// Maximum number of connections; further ones are closed immediately.
    #[arg(long, value_name = "N", default_value = "2048",
        value_parser = Checked(whole::<usize>(1, 1_000_000)))]
    pub max_connections: usize,
    /// Maximum number of connections from one address (IPv6: one /64), trusted proxies excepted.
    #[arg(long, value_name = "N", default_value = "512",
        value_parser = Checked(whole::<usize>(1, 1_000_000)))]
    pub max_connections_per_address: usize,
    /// Maximum number of drag sockets; further ones are answered 503.
    #[arg(long, value_name = "N", default_value = "256",
        value_parser = Checked(whole::<usize>(0, 1_000_000)))]
    pub max_sockets: usize,
    /// Largest share of one client, in percent, of `--max-sessions`, `--store-bytes`,
    /// `--max-sockets` and the memory for uploads; requests above it are answered 429. A client is
    /// the name of a key or, without keys, an address (IPv6: one /64). 100 = no limit; while all
    /// keys belong to one name, there is none either.
    #[arg(long = "max-client-share", value_name = "PERCENT", default_value = "50",
        value_parser = Checked(client_share))]
    pub client_share: ClientShare,
    /// Largest share of one visitor, which is all tokens for one session, in percent, of
    /// `--store-bytes`, `--max-sockets`, the memory for uploads and for unread responses, and the
    /// frames of one key that may wait for a worker; requests above it are answered 429, frames
    /// wait. It also counts for the key. 100 = no limit.
    #[arg(long = "max-visitor-share", value_name = "PERCENT", default_value = "25",
        value_parser = Checked(client_share))]
    pub visitor_share: ClientShare,
}

/// The share of a total that one client may use, in percent. A share of 100 sets no limit: then the
/// limit of the total applies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClientShare(u64);

impl ClientShare {
    /// No limit.
    pub(super) const ALL: Self = Self(100);

    /// The client's part of a total, rounded up, so that each client may use at least one.
    pub const fn of(self, total: u64) -> u64 {
        let part = total / 100 * self.0 + (total % 100 * self.0).div_ceil(100);
        if part >= total { u64::MAX } else { part }
    }
}

fn client_share(text: &str) -> Result<ClientShare, String> {
    whole(1, 100)(text.trim_end_matches('%')).map(ClientShare)
}

/// How long clients may take, and how the service stops.
#[derive(Args, Clone, Copy, Debug, PartialEq, Eq)]
#[command(next_help_heading = "Timeouts and shutdown")]
pub struct Timeouts {
    /// Maximum time from the head of a request to the head of its response.
    #[arg(long = "request-timeout", value_name = "TIME", default_value = "60s",
        value_parser = Checked(span))]
    pub request: Duration,
    /// Maximum time for the first byte of a connection, for a TLS handshake, for the head of a
    /// request, and between two requests.
    #[arg(long = "header-timeout", value_name = "TIME", default_value = "10s",
        value_parser = Checked(span))]
    pub header: Duration,
    /// Maximum time for the body of a request.
    #[arg(long = "body-timeout", value_name = "TIME", default_value = "30s",
        value_parser = Checked(span))]
    pub body: Duration,
    /// Maximum time that a client may read nothing of its response.
    #[arg(long = "write-timeout", value_name = "TIME", default_value = "30s",
        value_parser = Checked(span))]
    pub write: Duration,
    /// Time after which a silent drag socket is pinged; without an answer it is closed after the
    /// same time again.
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = Checked(span))]
    pub socket_idle: Duration,
    /// Maximum time that the client of a drag socket may take to read a message, and to acknowledge
    /// a frame.
    #[arg(long = "socket-timeout", value_name = "TIME", default_value = "30s",
        value_parser = Checked(span))]
    pub socket: Duration,
    /// Time after SIGTERM or Ctrl-C during which new requests are still served while /readyz
    /// answers 503, so that proxies notice. A second signal ends it and the grace period: all
    /// connections are closed one second later.
    #[arg(long, value_name = "TIME", default_value = "0s", value_parser = Checked(pause))]
    pub drain_delay: Duration,
    /// Time after the drain delay that running requests have to finish.
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = Checked(span))]
    pub shutdown_grace: Duration,
}
