//! Options of access: keys, TLS, and which origins, hosts and proxies are accepted.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::{ArgAction, Args};

use super::option::{Checked, Maybe, has_mistake, report, unless};
use crate::auth::cors::Origins;
use crate::auth::hosts::Hosts;
use crate::auth::keys::Keys;
use crate::auth::read_bounded;
use crate::auth::tls::TlsFiles;
use crate::auth::tokens::Secrets;
use crate::limits::networks::Network;
use crate::store::StoreUrl;

const MAX_KEYS_FILE_BYTES: u64 = 1 << 20;

type Networks = Vec<Network>;

/// Who may use the service, and how clients are authenticated.
#[derive(Args, Clone, Debug, PartialEq)]
#[command(next_help_heading = "Access and TLS")]
pub struct AuthConfig {
    /// File of API keys, one `NAME KEY` per line. Sessions belong to the name. The file is read
    /// again when it changes.
    #[arg(long, value_name = "PATH", default_value = "", hide_default_value = true,
        value_parser = Checked(unless("", path)))]
    keys_file: Maybe<PathBuf>,
    /// API keys: `NAME KEY` pairs separated by commas or line breaks. Prefer the variable: other
    /// users of the machine can see command lines.
    #[arg(long = "keys", value_name = "PAIRS", default_value = "", hide_default_value = true,
        value_parser = Checked(given_keys))]
    #[arg(hide_env_values = true)]
    fixed_keys: Keys,
    /// File of secrets that sign session tokens, one `KID SECRET` per line; at least 32 random
    /// bytes as text each (`openssl rand -hex 32`). The first signs, all verify. The file is read
    /// again when it changes. Needed for tokens with `--store redis://...`; otherwise, without a
    /// file, tokens are valid until the server stops.
    #[arg(long, value_name = "PATH", default_value = "", hide_default_value = true,
        value_parser = Checked(unless("", path)))]
    token_secrets_file: Maybe<PathBuf>,
    /// Allow a listen address that other machines can reach without keys. Anyone who can reach it
    /// can use the service.
    #[arg(long, value_name = "BOOL", default_value = "false", value_parser = Checked(boolean))]
    #[arg(default_missing_value = "true", num_args = 0..=1, require_equals = true,
        action = ArgAction::Set)]
    pub allow_anonymous: bool,
    /// Answer GET /metrics without a key.
    #[arg(long, value_name = "BOOL", default_value = "false", value_parser = Checked(boolean))]
    #[arg(default_missing_value = "true", num_args = 0..=1, require_equals = true,
        action = ArgAction::Set)]
    pub open_metrics: bool,
    /// TLS certificate chain, PEM. The file is read again when it changes.
    #[arg(long, value_name = "PATH", default_value = "", hide_default_value = true,
        value_parser = Checked(unless("", path)))]
    tls_cert: Maybe<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, value_name = "PATH", default_value = "", hide_default_value = true,
        value_parser = Checked(unless("", path)))]
    tls_key: Maybe<PathBuf>,
    /// Origins whose pages may use the service (CORS), separated by commas; `*` allows every
    /// origin.
    #[arg(long, value_name = "ORIGINS", default_value = "", hide_default_value = true,
        value_parser = Checked(Origins::parse))]
    pub(crate) cors_origin: Origins,
    /// Origins whose pages may show this server's page in a frame, and hand it a session token,
    /// separated by commas; `*` allows every origin.
    #[arg(long, value_name = "ORIGINS", default_value = "", hide_default_value = true,
        value_parser = Checked(Origins::parse))]
    pub(crate) frame_ancestors: Origins,
    /// Host names that requests may use besides localhost and IP addresses, separated by commas;
    /// others are answered 421. Without a list, hosts are checked only by a server without keys on
    /// a loopback address.
    #[arg(long, value_name = "HOSTS", default_value = "", hide_default_value = true,
        value_parser = Checked(Hosts::parse))]
    pub(crate) allowed_hosts: Hosts,
    /// Trusted reverse proxies: addresses or networks, separated by commas. Their X-Forwarded-For
    /// header names the client.
    #[arg(long, value_name = "NETWORKS", default_value = "", hide_default_value = true,
        value_parser = Checked(networks))]
    pub(crate) trusted_proxies: Networks,
    /// The keys; `None`: no key is needed.
    #[arg(skip)]
    pub(crate) keys: Option<KeysConfig>,
    /// The secrets of tokens, if they are in a file.
    #[arg(skip)]
    pub(crate) secrets: Option<SecretsConfig>,
    /// Certificate and key; `None`: plain HTTP.
    #[arg(skip)]
    pub tls: Option<TlsFiles>,
}

/// The keys and the file that they are read from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct KeysConfig {
    /// The keys of `--keys`, which do not change.
    fixed: Keys,
    pub(crate) file: Option<PathBuf>,
    /// All keys at the start of the program.
    pub(crate) all: Keys,
}

/// The secrets of tokens and the file that they are read from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SecretsConfig {
    pub(crate) file: PathBuf,
    /// The secrets at the start of the program.
    all: Secrets,
}

impl SecretsConfig {
    /// Reads the file.
    pub(crate) fn read(&self) -> Result<Secrets, String> {
        read_secrets(&self.file)
    }
}

fn read_secrets(path: &Path) -> Result<Secrets, String> {
    Secrets::parse(&text_of(path)?).map_err(|why| format!("{}: {why}", path.display()))
}

/// The text of a small file.
fn text_of(path: &Path) -> Result<String, String> {
    let in_file = |why: String| format!("{}: {why}", path.display());
    let bytes = read_bounded(path, MAX_KEYS_FILE_BYTES).map_err(in_file)?;
    String::from_utf8(bytes).map_err(|_| in_file("not UTF-8".to_owned()))
}

impl KeysConfig {
    /// Reads the file and returns all keys.
    pub(crate) fn read(&self) -> Result<Keys, String> {
        let Some(path) = &self.file else {
            return Ok(self.fixed.clone());
        };
        let in_file = |why: String| format!("{}: {why}", path.display());
        let keys = Keys::parse(&text_of(path)?).map_err(in_file)?;
        if keys.is_empty() && self.fixed.is_empty() {
            return Err(in_file("there is no key in it".to_owned()));
        }
        Ok(self.fixed.clone().and(&keys))
    }
}

impl AuthConfig {
    /// The hosts that a listener without keys serves; `None`: all. On a loopback address this
    /// prevents DNS rebinding.
    pub(crate) fn hosts_without_keys(&self, listen: SocketAddr) -> Option<&Hosts> {
        Some(&self.allowed_hosts).filter(|_| is_loopback(listen))
    }

    /// The hosts that the service serves; `None`: all.
    pub(crate) fn hosts(&self, listen: SocketAddr) -> Option<&Hosts> {
        let listed = Some(&self.allowed_hosts).filter(|hosts| !hosts.is_empty());
        listed.or_else(|| {
            self.hosts_without_keys(listen)
                .filter(|_| self.keys.is_none())
        })
    }

    /// The secrets of session tokens. Without a file a process has one of its own, unless replicas
    /// share the store: they would not accept each other's tokens.
    pub(crate) fn token_secrets(&self, store: &StoreUrl) -> Option<Secrets> {
        self.keys.as_ref()?;
        match &self.secrets {
            Some(secrets) => Some(secrets.all.clone()),
            None if store.is_shared() => None,
            None => Some(Secrets::random()),
        }
    }

    /// Whether keys travel unencrypted to a listener that other machines can reach.
    pub(crate) fn has_keys_in_plain(&self, listen: SocketAddr) -> bool {
        self.keys.is_some() && self.tls.is_none() && !is_loopback(listen)
    }

    /// Reads the files of keys and TLS.
    pub(super) fn load(&mut self) {
        if self.keys_file.is_some() || !self.fixed_keys.is_empty() {
            let flag = if self.keys_file.is_some() {
                "keys-file"
            } else {
                "keys"
            };
            let keys = KeysConfig {
                fixed: self.fixed_keys.clone(),
                file: self.keys_file.clone(),
                all: Keys::default(),
            };
            self.keys = report(flag, keys.read()).map(|all| KeysConfig { all, ..keys });
        }
        if let Some(file) = self.token_secrets_file.clone() {
            self.secrets = report("token-secrets-file", read_secrets(&file))
                .map(|all| SecretsConfig { file, all });
        }
        match (self.tls_cert.clone(), self.tls_key.clone()) {
            (None, None) => {}
            (Some(cert), Some(key)) => {
                let files = TlsFiles { cert, key };
                self.tls = report("tls-cert", files.load().map(|_| files));
            }
            (None, Some(_)) => drop(report::<()>(
                "tls-cert",
                Err("missing: --tls-key needs it".to_owned()),
            )),
            (Some(_), None) => drop(report::<()>(
                "tls-key",
                Err("missing: --tls-cert needs it".to_owned()),
            )),
        }
    }

    /// Reports a listener that other machines can reach without keys, unless it was asked for.
    pub(super) fn check_anonymous(&self, listen: SocketAddr) {
        // Keys that are given with a mistake were meant.
        let has_keys = self.keys.is_some() || has_mistake("keys") || has_mistake("keys-file");
        if !is_loopback(listen) && !has_keys && !self.allow_anonymous {
            let ways = "give --keys-file (MLSWARP_KEYS_FILE) or MLSWARP_KEYS='NAME KEY', \
                        or allow everybody with --allow-anonymous (MLSWARP_ALLOW_ANONYMOUS=true)";
            report::<()>(
                "listen",
                Err(format!(
                    "{listen} is not a loopback address and there are no keys; {ways}"
                )),
            );
        }
    }
}

/// Keys; a text without any is a mistake.
fn given_keys(text: &str) -> Result<Keys, String> {
    let keys = Keys::parse(text)?;
    if keys.is_empty() && !text.trim().is_empty() {
        Err("there is no key in it".to_owned())
    } else {
        Ok(keys)
    }
}

fn is_loopback(listen: SocketAddr) -> bool {
    listen.ip().to_canonical().is_loopback()
}

fn boolean(text: &str) -> Result<bool, String> {
    text.parse()
        .map_err(|_| format!("`{text}` is neither true nor false"))
}

fn path(text: &str) -> Result<PathBuf, String> {
    text.parse().map_err(|never: Infallible| match never {})
}

fn networks(text: &str) -> Result<Networks, String> {
    text.split(',')
        .map(str::trim)
        .filter(|network| !network.is_empty())
        .map(Network::parse)
        .collect()
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    fn serve(args: &[&str]) -> Result<Config, String> {
        Config::read([&["mlswarp", "serve"], args].concat()).map_err(|m| m.to_string())
    }

    #[test]
    fn everybody_is_let_in_only_on_purpose() {
        let refused = serve(&["--listen", "0.0.0.0:80"]).unwrap_err();
        assert!(
            refused.contains("--listen (MLSWARP_LISTEN)") && refused.contains("--allow-anonymous"),
            "{refused}"
        );
        assert!(serve(&["--listen", "[::]:80"]).is_err());
        assert!(serve(&["--listen", "0.0.0.0:80", "--allow-anonymous=false"]).is_err());
        assert!(serve(&["--listen", "192.0.2.1:80", "--allow-anonymous"]).is_ok());
        assert!(serve(&["--listen", "0.0.0.0:80", "--allow-anonymous=true"]).is_ok());
        assert!(serve(&["--listen", "0.0.0.0:80", "--keys", "ann 0123456789abcdef"]).is_ok());
        for loopback in [
            "127.0.0.1:80",
            "127.8.8.8:80",
            "[::1]:80",
            "[::ffff:127.0.0.1]:80",
            "localhost:80",
        ] {
            assert!(serve(&["--listen", loopback]).is_ok(), "{loopback}");
        }
        // Keys with a mistake admit no client, and only the mistake is reported.
        let refused = serve(&["--listen", "0.0.0.0:80", "--keys", "ann short"]).unwrap_err();
        assert!(
            refused.contains("--keys (MLSWARP_KEYS): line 1") && !refused.contains("--listen"),
            "{refused}"
        );
    }

    #[test]
    fn mistakes_name_the_file_and_never_the_key() {
        let refused = serve(&[
            "--keys-file",
            "/nonexistent/keys",
            "--tls-cert",
            "/nonexistent/cert",
            "--cors-origin",
            "x",
        ])
        .unwrap_err();
        for told in [
            "--keys-file (MLSWARP_KEYS_FILE): /nonexistent/keys: No such file",
            "--tls-key (MLSWARP_TLS_KEY): missing",
        ] {
            assert!(refused.contains(told), "{refused}");
        }
        let refused = serve(&[
            "--tls-cert",
            "/nonexistent/cert",
            "--tls-key",
            "/nonexistent/key",
        ])
        .unwrap_err();
        assert!(
            refused.contains("--tls-cert (MLSWARP_TLS_CERT): /nonexistent/cert: No such file"),
            "{refused}"
        );
        for nothing in [",", "# ann 0123456789abcdef"] {
            assert!(
                serve(&["--keys", nothing])
                    .unwrap_err()
                    .contains("--keys (MLSWARP_KEYS): there is no key in it")
            );
        }
        let refused = serve(&["--keys", "ann 0123456789abcdef$"]).unwrap_err();
        assert!(!refused.contains("0123456789"), "{refused}");
        let config = Config::read(["mlswarp", "--keys", "ann 0123456789abcdef"]).unwrap();
        assert!(!format!("{config:?}").contains("0123456789"));
    }

    #[test]
    fn a_client_has_its_percentage_of_a_total() {
        let share = |percent: &str| {
            serve(&["--max-client-share", percent]).map(|config| config.clients.client_share)
        };
        assert_eq!(
            Config::default().clients.client_share,
            share("50%").unwrap()
        );
        assert_eq!(
            [0, 1, 2, 3, 10_001, 1 << 40].map(|total| share("50").unwrap().of(total)),
            [u64::MAX, u64::MAX, 1, 2, 5001, 1 << 39]
        );
        assert_eq!(
            (
                share("1").unwrap().of(7),
                share("99").unwrap().of(u64::MAX) < u64::MAX,
                share("100").unwrap().of(7)
            ),
            (1, true, u64::MAX)
        );
        for wrong in ["0", "101", "half", ""] {
            assert!(
                share(wrong)
                    .unwrap_err()
                    .contains("--max-client-share (MLSWARP_MAX_CLIENT_SHARE)")
            );
        }
    }

    #[test]
    fn hosts_are_checked_on_the_loopback_without_keys_and_where_they_are_listed() {
        const LIST: [&str; 2] = ["--allowed-hosts", "warp.example"];
        const KEYS: [&str; 2] = ["--keys", "ann 0123456789abcdef"];
        let are_checked = |args: &[&[&str]]| {
            let config = serve(&args.concat()).unwrap();
            config.auth.hosts(config.listen).is_some()
        };
        for loopback in [
            "127.0.0.1:80",
            "127.8.8.8:80",
            "[::1]:80",
            "[::ffff:127.0.0.1]:80",
        ] {
            let listen = ["--listen", loopback];
            assert!(
                are_checked(&[&listen])
                    && are_checked(&[&listen, &["--allow-anonymous"]])
                    && are_checked(&[&listen, &LIST]),
                "{loopback}"
            );
            assert!(
                !are_checked(&[&listen, &KEYS]) && are_checked(&[&listen, &KEYS, &LIST]),
                "{loopback}"
            );
        }
        let open = ["--listen", "0.0.0.0:80", "--allow-anonymous"];
        assert!(!are_checked(&[&open]) && are_checked(&[&open, &LIST]));
        assert!(!are_checked(&[&open, &KEYS]) && are_checked(&[&open, &KEYS, &LIST]));
        assert!(
            serve(&["--allowed-hosts", "a b"])
                .unwrap_err()
                .contains("--allowed-hosts (MLSWARP_ALLOWED_HOSTS)")
        );
    }

    #[test]
    fn keys_in_plain_are_those_of_a_listener_that_others_reach_without_tls() {
        const KEYS: &[&str] = &["--keys", "ann 0123456789abcdef"];
        let in_plain = |listen: &str, has_keys: bool| {
            let config = serve(
                &[
                    &["--listen", listen, "--allow-anonymous"][..],
                    if has_keys { KEYS } else { &[] },
                ]
                .concat(),
            )
            .unwrap();
            config.auth.has_keys_in_plain(config.listen)
        };
        assert!(
            in_plain("0.0.0.0:80", true)
                && in_plain("192.0.2.1:80", true)
                && in_plain("[::]:80", true)
        );
        assert!(
            !in_plain("0.0.0.0:80", false)
                && !in_plain("127.0.0.1:80", true)
                && !in_plain("[::1]:80", true)
        );
    }

    #[test]
    fn rates_and_proxies_are_off_unless_given() {
        let config = Config::default();
        assert_eq!(
            (
                config.clients.rate_per_key,
                config.clients.rate_per_address,
                config.auth.trusted_proxies.len()
            ),
            (None, None, 0)
        );
        let config = serve(&[
            "--rate-per-key",
            "20",
            "--rate-per-address",
            "50",
            "--trusted-proxies",
            "10.0.0.0/8, ::1",
        ])
        .unwrap();
        assert_eq!(
            (
                config.clients.rate_per_key,
                config.clients.rate_per_address,
                config.auth.trusted_proxies.len()
            ),
            (Some(20), Some(50), 2)
        );
        assert!(serve(&["--rate-per-key", "0"]).is_err());
    }
}
