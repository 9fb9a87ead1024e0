//! Who is let in, how many and how often, and how long clients may take.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::Args;

use super::{Mistakes, units, whole};
use crate::auth::cors::Origins;
use crate::auth::hosts::Hosts;
use crate::auth::keys::Keys;
use crate::auth::read_bounded;
use crate::auth::tls::TlsFiles;
use crate::limits::networks::Network;

/// Largest file of keys.
const KEYS_FILE: u64 = 1 << 20;

/// The options as text; [`AccessArgs::resolve`] reads them.
#[derive(Debug, Args)]
pub(crate) struct AccessArgs {
    /// File of keys, one `NAME KEY` a line; sessions belong to the name. Read again when it changes.
    #[arg(long, env = "MLSWARP_KEYS_FILE", value_name = "PATH", default_value = "", hide_default_value = true, global = true)]
    keys_file: String,
    /// Keys, `NAME KEY` pairs between commas or lines. Better the variable than the flag: everybody sees command lines.
    #[arg(
        long,
        env = "MLSWARP_KEYS",
        value_name = "PAIRS",
        default_value = "",
        hide_default_value = true,
        hide_env_values = true,
        global = true
    )]
    keys: Secret,
    /// Listen beyond the loopback without keys: everybody who reaches the address may use the service.
    #[arg(
        long,
        env = "MLSWARP_ALLOW_ANONYMOUS",
        value_name = "BOOL",
        default_value = "false",
        default_missing_value = "true",
        num_args = 0..=1,
        require_equals = true,
        global = true
    )]
    allow_anonymous: String,
    /// Answer GET /metrics without a key.
    #[arg(
        long,
        env = "MLSWARP_OPEN_METRICS",
        value_name = "BOOL",
        default_value = "false",
        default_missing_value = "true",
        num_args = 0..=1,
        require_equals = true,
        global = true
    )]
    open_metrics: String,
    /// Certificate (chain) for TLS, PEM. Read again when it changes.
    #[arg(long, env = "MLSWARP_TLS_CERT", value_name = "PATH", default_value = "", hide_default_value = true, global = true)]
    tls_cert: String,
    /// Private key of the certificate, PEM.
    #[arg(long, env = "MLSWARP_TLS_KEY", value_name = "PATH", default_value = "", hide_default_value = true, global = true)]
    tls_key: String,
    /// Origins of other sites whose pages may use the service, between commas; `*` is every site.
    #[arg(long, env = "MLSWARP_CORS_ORIGIN", value_name = "ORIGINS", default_value = "", hide_default_value = true, global = true)]
    cors_origin: String,
    /// Host names that requests may name beside localhost and IP addresses, between commas; any other is answered 421. Without a list, hosts are checked only by a server without keys on a loopback address.
    #[arg(long, env = "MLSWARP_ALLOWED_HOSTS", value_name = "HOSTS", default_value = "", hide_default_value = true, global = true)]
    allowed_hosts: String,
    /// Proxies in front, addresses or networks between commas: behind them X-Forwarded-For says who asks.
    #[arg(long, env = "MLSWARP_TRUSTED_PROXIES", value_name = "NETWORKS", default_value = "", hide_default_value = true, global = true)]
    trusted_proxies: String,
    /// Requests a second of one key's name, twice as many at once; more are answered 429.
    #[arg(long, env = "MLSWARP_RATE_PER_KEY", value_name = "N|off", default_value = "off", global = true)]
    rate_per_key: String,
    /// Requests a second of one address (one /64 of IPv6), twice as many at once; more are answered 429.
    #[arg(long, env = "MLSWARP_RATE_PER_ADDRESS", value_name = "N|off", default_value = "off", global = true)]
    rate_per_address: String,
    /// Most connections; one more is closed at once.
    #[arg(long, env = "MLSWARP_MAX_CONNECTIONS", value_name = "N", default_value = "2048", global = true)]
    max_connections: String,
    /// Most connections of one address (one /64 of IPv6) that is no trusted proxy.
    #[arg(long, env = "MLSWARP_MAX_CONNECTIONS_PER_ADDRESS", value_name = "N", default_value = "512", global = true)]
    max_connections_per_address: String,
    /// Most that one client may take of what cannot be taken back, in percent: of `--max-sessions`, `--store-bytes`, `--max-sockets` and
    /// the memory for uploads; above it 429. A client is the name of a key, or where there are no keys an address (one /64 of IPv6). 100
    /// = no limit.
    #[arg(long, env = "MLSWARP_MAX_CLIENT_SHARE", value_name = "PERCENT", default_value = "50", global = true)]
    max_client_share: String,
    /// Longest time from a request's head to its answer's head.
    #[arg(long, env = "MLSWARP_REQUEST_TIMEOUT", value_name = "TIME", default_value = "60s", global = true)]
    request_timeout: String,
    /// Longest time for a connection's first byte, for a TLS handshake, for a request's head, and between two requests.
    #[arg(long, env = "MLSWARP_HEADER_TIMEOUT", value_name = "TIME", default_value = "10s", global = true)]
    header_timeout: String,
    /// Longest time for a request's body.
    #[arg(long, env = "MLSWARP_BODY_TIMEOUT", value_name = "TIME", default_value = "30s", global = true)]
    body_timeout: String,
    /// Longest time in which a client takes nothing of what it is sent.
    #[arg(long, env = "MLSWARP_WRITE_TIMEOUT", value_name = "TIME", default_value = "30s", global = true)]
    write_timeout: String,
    /// After SIGTERM or Ctrl-C: how long newcomers are still served while /readyz says 503, for proxies to notice. A second signal ends this and the grace: a second later all is cut.
    #[arg(long, env = "MLSWARP_DRAIN_DELAY", value_name = "TIME", default_value = "0s", global = true)]
    drain_delay: String,
    /// How long requests may go on after that, unless a second signal hurries.
    #[arg(long, env = "MLSWARP_SHUTDOWN_GRACE", value_name = "TIME", default_value = "20s", global = true)]
    shutdown_grace: String,
}

/// An option that may contain a key or a password; it is never shown.
#[derive(Clone, Default)]
pub(super) struct Secret(pub(super) String);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not shown")
    }
}

impl FromStr for Secret {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(Self(text.to_owned()))
    }
}

/// What one client may take of a total, in percent. A part that is as large as the total sets no limit: then the total's own limit answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClientShare(u64);

impl ClientShare {
    /// Its part of a total, rounded up: of what there is at all, every client may take one.
    #[must_use]
    pub const fn of(self, total: u64) -> u64 {
        let part = total / 100 * self.0 + (total % 100 * self.0).div_ceil(100);
        if part >= total { u64::MAX } else { part }
    }
}

fn client_share(text: &str) -> Result<ClientShare, String> {
    whole(text.trim_end_matches('%'), 1, 100).map(ClientShare)
}

/// Who is let in, how many and how often, and how long clients may take.
#[derive(Clone, Debug, PartialEq)]
pub struct AccessConfig {
    /// Keys; none lets everybody in.
    pub keys: Option<KeysConfig>,
    /// Everybody may be let in from beyond the loopback.
    pub allow_anonymous: bool,
    /// The numbers of the service need no key.
    pub open_metrics: bool,
    /// Certificate and key; none is plain HTTP.
    pub tls: Option<TlsFiles>,
    /// Origins of other sites whose pages may ask.
    pub cors_origin: Origins,
    /// Names of hosts that requests may name beside `localhost` and IP literals.
    pub allowed_hosts: Hosts,
    /// Whose `X-Forwarded-For` is believed.
    pub trusted_proxies: Vec<Network>,
    /// Requests a second of one key's name.
    pub rate_per_key: Option<u32>,
    /// Requests a second of one address.
    pub rate_per_address: Option<u32>,
    /// Most connections.
    pub max_connections: usize,
    /// Most connections of one address.
    pub max_connections_per_address: usize,
    /// What one client may take of what cannot be taken back.
    pub client_share: ClientShare,
    /// Longest time from a request's head to its answer's head.
    pub request_timeout: Duration,
    /// Longest time for a connection's first byte, a TLS handshake, a request's head, and between two requests.
    pub header_timeout: Duration,
    /// Longest time for a request's body.
    pub body_timeout: Duration,
    /// Longest time in which a client takes nothing of what it is sent.
    pub write_timeout: Duration,
    /// How long requests may go on after a signal to stop.
    pub shutdown_grace: Duration,
    /// How long newcomers are still served after the signal to stop.
    pub drain_delay: Duration,
}

/// Keys as they were when the program started, and where they come from.
#[derive(Clone, Debug, PartialEq)]
pub struct KeysConfig {
    /// Those of the variable: they stay.
    pub fixed: Keys,
    /// The file of the others.
    pub file: Option<PathBuf>,
    /// All of them.
    pub all: Keys,
}

impl KeysConfig {
    fn new(fixed: Keys, file: Option<PathBuf>) -> Result<Self, String> {
        let mut keys = Self { all: fixed.clone(), fixed, file };
        keys.all = keys.read()?;
        if keys.all.is_empty() {
            return Err("there is no key in it".to_owned());
        }
        Ok(keys)
    }

    /// Reads the file anew; all keys.
    ///
    /// # Errors
    /// The file and why.
    pub fn read(&self) -> Result<Keys, String> {
        let Some(path) = &self.file else { return Ok(self.fixed.clone()) };
        let told = |why: String| format!("{}: {why}", path.display());
        let text = String::from_utf8(read_bounded(path, KEYS_FILE).map_err(told)?).map_err(|_| told("not UTF-8".to_owned()))?;
        let keys = Keys::parse(&text).map_err(told)?;
        if keys.is_empty() && self.fixed.is_empty() {
            return Err(told("there is no key in it".to_owned()));
        }
        Ok(self.fixed.clone().and(&keys))
    }
}

impl AccessConfig {
    /// The hosts that a listener without keys serves; none: all. On a loopback address, no other program of this machine or page of another
    /// site may reach it under a name of its own (DNS rebinding).
    #[must_use]
    pub fn hosts_without_keys(&self, listen: SocketAddr) -> Option<&Hosts> {
        Some(&self.allowed_hosts).filter(|_| listen.ip().to_canonical().is_loopback())
    }

    /// Whether keys travel unencrypted to a listener that other machines reach.
    #[must_use]
    pub fn has_keys_in_plain(&self, listen: SocketAddr) -> bool {
        self.keys.is_some() && self.tls.is_none() && !listen.ip().to_canonical().is_loopback()
    }

    /// The hosts that the service itself serves; none: all.
    #[must_use]
    pub fn hosts(&self, listen: SocketAddr) -> Option<&Hosts> {
        let listed = Some(&self.allowed_hosts).filter(|hosts| !hosts.is_empty());
        listed.or_else(|| self.hosts_without_keys(listen).filter(|_| self.keys.is_none()))
    }
}

impl AccessArgs {
    pub(crate) fn resolve(&self, m: &mut Mistakes) -> AccessConfig {
        AccessConfig {
            keys: self.keys(m),
            allow_anonymous: m.read("allow-anonymous", &self.allow_anonymous, boolean),
            open_metrics: m.read("open-metrics", &self.open_metrics, boolean),
            tls: self.tls(m),
            cors_origin: m.read("cors-origin", &self.cors_origin, Origins::parse),
            allowed_hosts: m.read("allowed-hosts", &self.allowed_hosts, Hosts::parse),
            trusted_proxies: m.read("trusted-proxies", &self.trusted_proxies, networks),
            rate_per_key: m.read("rate-per-key", &self.rate_per_key, rate),
            rate_per_address: m.read("rate-per-address", &self.rate_per_address, rate),
            max_connections: m.read("max-connections", &self.max_connections, |t| whole(t, 1, 1_000_000)),
            max_connections_per_address: m
                .read("max-connections-per-address", &self.max_connections_per_address, |t| whole(t, 1, 1_000_000)),
            client_share: m.read("max-client-share", &self.max_client_share, client_share),
            request_timeout: m.read("request-timeout", &self.request_timeout, units::span),
            header_timeout: m.read("header-timeout", &self.header_timeout, units::span),
            body_timeout: m.read("body-timeout", &self.body_timeout, units::span),
            write_timeout: m.read("write-timeout", &self.write_timeout, units::span),
            drain_delay: m.read("drain-delay", &self.drain_delay, units::pause),
            shutdown_grace: m.read("shutdown-grace", &self.shutdown_grace, units::span),
        }
    }

    fn keys(&self, m: &mut Mistakes) -> Option<KeysConfig> {
        if self.keys.0.trim().is_empty() && self.keys_file.is_empty() {
            return None;
        }
        let fixed = m.read("keys", &self.keys.0, Keys::parse);
        let file = (!self.keys_file.is_empty()).then(|| PathBuf::from(&self.keys_file));
        let flag = if file.is_some() { "keys-file" } else { "keys" };
        m.read(flag, "", |_| KeysConfig::new(fixed, file).map(Some))
    }

    fn tls(&self, m: &mut Mistakes) -> Option<TlsFiles> {
        let files = TlsFiles { cert: PathBuf::from(&self.tls_cert), key: PathBuf::from(&self.tls_key) };
        match (self.tls_cert.is_empty(), self.tls_key.is_empty()) {
            (true, true) => None,
            (false, false) => m.read("tls-cert", "", |_| files.load().map(|_| Some(files))),
            (true, false) => m.read("tls-cert", "", |_| Err("missing: --tls-key has no use without it".to_owned())),
            (false, true) => m.read("tls-key", "", |_| Err("missing: --tls-cert has no use without it".to_owned())),
        }
    }

    /// A server that everybody reaches and anybody may use is one that somebody wanted.
    pub(crate) fn check_open(&self, m: &mut Mistakes, listen: SocketAddr, access: &AccessConfig) {
        // Keys that were meant, and have a mistake of their own, are told once.
        let meant = !self.keys.0.trim().is_empty() || !self.keys_file.is_empty();
        if !listen.ip().to_canonical().is_loopback() && !meant && !access.allow_anonymous {
            m.read("listen", "", |_| {
                Err::<(), _>(format!(
                    "{listen} is not a loopback address and there are no keys; give --keys-file (MLSWARP_KEYS_FILE) or MLSWARP_KEYS='NAME KEY', \
                     or let everybody in by --allow-anonymous (MLSWARP_ALLOW_ANONYMOUS=true)"
                ))
            });
        }
    }
}

fn boolean(text: &str) -> Result<bool, String> {
    text.parse().map_err(|_| format!("`{text}` is neither true nor false"))
}

fn rate(text: &str) -> Result<Option<u32>, String> {
    if text == "off" { Ok(None) } else { whole(text, 1, 1_000_000).map(Some) }
}

fn networks(text: &str) -> Result<Vec<Network>, String> {
    text.split(',').map(str::trim).filter(|network| !network.is_empty()).map(Network::parse).collect()
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use crate::config::{Cli, Config};

    fn serve(args: &[&str]) -> Result<Config, String> {
        let cli = Cli::try_parse_from([&["mlswarp", "serve"], args].concat()).expect("known flags");
        cli.options.resolve_to_serve().map_err(|m| m.to_string())
    }

    #[test]
    fn everybody_is_let_in_only_on_purpose() {
        let refused = serve(&["--listen", "0.0.0.0:80"]).unwrap_err();
        assert!(refused.contains("--listen (MLSWARP_LISTEN)") && refused.contains("--allow-anonymous"), "{refused}");
        assert!(serve(&["--listen", "[::]:80"]).is_err());
        assert!(serve(&["--listen", "0.0.0.0:80", "--allow-anonymous=false"]).is_err());
        assert!(serve(&["--listen", "192.0.2.1:80", "--allow-anonymous"]).is_ok());
        assert!(serve(&["--listen", "0.0.0.0:80", "--allow-anonymous=true"]).is_ok());
        assert!(serve(&["--listen", "0.0.0.0:80", "--keys", "ann 0123456789abcdef"]).is_ok());
        for loopback in ["127.0.0.1:80", "127.8.8.8:80", "[::1]:80", "[::ffff:127.0.0.1]:80", "localhost:80"] {
            assert!(serve(&["--listen", loopback]).is_ok(), "{loopback}");
        }
        // Keys with a mistake let nobody in, and only the mistake is told.
        let refused = serve(&["--listen", "0.0.0.0:80", "--keys", "ann short"]).unwrap_err();
        assert!(refused.contains("--keys (MLSWARP_KEYS): line 1") && !refused.contains("--listen"), "{refused}");
    }

    #[test]
    fn mistakes_name_the_file_and_never_the_key() {
        let refused = serve(&["--keys-file", "/nonexistent/keys", "--tls-cert", "/nonexistent/cert", "--cors-origin", "x"]).unwrap_err();
        for told in ["--keys-file (MLSWARP_KEYS_FILE): /nonexistent/keys: No such file", "--tls-key (MLSWARP_TLS_KEY): missing"] {
            assert!(refused.contains(told), "{refused}");
        }
        let refused = serve(&["--tls-cert", "/nonexistent/cert", "--tls-key", "/nonexistent/key"]).unwrap_err();
        assert!(refused.contains("--tls-cert (MLSWARP_TLS_CERT): /nonexistent/cert: No such file"), "{refused}");
        let refused = serve(&["--keys", "ann 0123456789abcdef$"]).unwrap_err();
        assert!(!refused.contains("0123456789"), "{refused}");
        let cli = Cli::try_parse_from(["mlswarp", "--keys", "ann 0123456789abcdef"]).unwrap();
        assert!(!format!("{cli:?} {:?}", cli.options.resolve()).contains("0123456789"));
    }

    #[test]
    fn a_client_has_its_percentage_of_a_total() {
        let share = |percent: &str| serve(&["--max-client-share", percent]).map(|config| config.access.client_share);
        assert_eq!(Config::default().access.client_share, share("50%").unwrap());
        assert_eq!([0, 1, 2, 3, 10_001, 1 << 40].map(|total| share("50").unwrap().of(total)), [u64::MAX, u64::MAX, 1, 2, 5001, 1 << 39]);
        assert_eq!(
            (share("1").unwrap().of(7), share("99").unwrap().of(u64::MAX) < u64::MAX, share("100").unwrap().of(7)),
            (1, true, u64::MAX)
        );
        for wrong in ["0", "101", "half", ""] {
            assert!(share(wrong).unwrap_err().contains("--max-client-share (MLSWARP_MAX_CLIENT_SHARE)"));
        }
    }

    #[test]
    fn hosts_are_checked_on_the_loopback_without_keys_and_where_they_are_listed() {
        const LIST: [&str; 2] = ["--allowed-hosts", "bend.example"];
        const KEYS: [&str; 2] = ["--keys", "ann 0123456789abcdef"];
        let are_checked = |args: &[&[&str]]| {
            let config = serve(&args.concat()).unwrap();
            config.access.hosts(config.listen).is_some()
        };
        for loopback in ["127.0.0.1:80", "127.8.8.8:80", "[::1]:80", "[::ffff:127.0.0.1]:80"] {
            let listen = ["--listen", loopback];
            assert!(
                are_checked(&[&listen]) && are_checked(&[&listen, &["--allow-anonymous"]]) && are_checked(&[&listen, &LIST]),
                "{loopback}"
            );
            assert!(!are_checked(&[&listen, &KEYS]) && are_checked(&[&listen, &KEYS, &LIST]), "{loopback}");
        }
        let open = ["--listen", "0.0.0.0:80", "--allow-anonymous"];
        assert!(!are_checked(&[&open]) && are_checked(&[&open, &LIST]));
        assert!(!are_checked(&[&open, &KEYS]) && are_checked(&[&open, &KEYS, &LIST]));
        assert!(serve(&["--allowed-hosts", "a b"]).unwrap_err().contains("--allowed-hosts (MLSWARP_ALLOWED_HOSTS)"));
    }

    #[test]
    fn keys_in_plain_are_those_of_a_listener_that_others_reach_without_tls() {
        const KEYS: &[&str] = &["--keys", "ann 0123456789abcdef"];
        let in_plain = |listen: &str, has_keys: bool| {
            let config = serve(&[&["--listen", listen, "--allow-anonymous"][..], if has_keys { KEYS } else { &[] }].concat()).unwrap();
            config.access.has_keys_in_plain(config.listen)
        };
        assert!(in_plain("0.0.0.0:80", true) && in_plain("192.0.2.1:80", true) && in_plain("[::]:80", true));
        assert!(!in_plain("0.0.0.0:80", false) && !in_plain("127.0.0.1:80", true) && !in_plain("[::1]:80", true));
    }

    #[test]
    fn rates_and_proxies_are_off_unless_given() {
        let access = Config::default().access;
        assert_eq!((access.rate_per_key, access.rate_per_address, access.trusted_proxies.len()), (None, None, 0));
        let access = serve(&["--rate-per-key", "20", "--rate-per-address", "50", "--trusted-proxies", "10.0.0.0/8, ::1"]).unwrap().access;
        assert_eq!((access.rate_per_key, access.rate_per_address, access.trusted_proxies.len()), (Some(20), Some(50), 2));
        assert!(serve(&["--rate-per-key", "0"]).is_err());
    }
}
