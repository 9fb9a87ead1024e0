//! The syntax of a host and its port (RFC 9110, section 4.2; RFC 3986, section 3.2.2), and the
//! hosts that a request may name.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Host {
    Address(IpAddr),
    /// In lower case, without a trailing dot.
    Name(String),
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Authority {
    pub(crate) host: Host,
    pub(crate) port: Option<u16>,
}

impl Authority {
    /// Reads `host` or `host:port`.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (host, port) = match text.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((address, port)) => (
                Host::Address(address.parse::<Ipv6Addr>().ok()?.into()),
                port,
            ),
            None => {
                let (name, port) = text.split_at(text.find(':').unwrap_or(text.len()));
                (parse_name(name)?, port)
            }
        };
        let port = match port.strip_prefix(':') {
            // RFC 3986 allows a colon without a port.
            Some("") => None,
            Some(digits) if digits.bytes().all(|b| b.is_ascii_digit()) => {
                Some(digits.parse().ok()?)
            }
            None if port.is_empty() => None,
            _ => return None,
        };
        Some(Self { host, port })
    }
}

/// Reads a registered name or an IPv4 address.
fn parse_name(text: &str) -> Option<Host> {
    let is_plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~!$&'()*+,;=%".contains(&b);
    let escapes = text.split('%').skip(1).all(|rest| {
        rest.as_bytes()
            .get(..2)
            .is_some_and(|hex| hex.iter().all(u8::is_ascii_hexdigit))
    });
    let name = text.strip_suffix('.').unwrap_or(text);
    if name.is_empty() || !text.bytes().all(is_plain) || !escapes {
        return None;
    }
    Some(name.parse().map_or_else(
        |_| Host::Name(name.to_ascii_lowercase()),
        |v4: Ipv4Addr| Host::Address(v4.into()),
    ))
}

/// The hosts that a request may name. `localhost` and IP literals are always allowed: they are not
/// resolved by DNS.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Hosts(Vec<Host>);

impl Hosts {
    /// Reads a comma-separated list of host names.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let host = |entry: &str| match Authority::parse(entry) {
            Some(Authority { host, port: None }) if !entry.contains(['*', ':']) => Ok(host),
            _ => Err(format!(
                "`{entry}` is not a host name such as warp.example (no scheme, no port, no \
                    wildcard)"
            )),
        };
        text.split(',')
            .map(str::trim)
            .filter(|entry| !entry.is_empty())
            .map(host)
            .collect::<Result<_, _>>()
            .map(Self)
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn allow(&self, host: &Host) -> bool {
        let is_local = matches!(host, Host::Name(name) if name == "localhost");
        is_local || matches!(host, Host::Address(_)) || self.0.contains(host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_are_compared_without_case_port_and_root_dot() {
        let hosts = Hosts::parse("Warp.example., other.example").unwrap();
        let allowed = |text: &str| {
            hosts.allow(
                &Authority::parse(text)
                    .unwrap_or_else(|| panic!("{text} is well-formed"))
                    .host,
            )
        };
        for host in [
            "localhost",
            "LOCALHOST:8080",
            "localhost.",
            "127.0.0.1",
            "192.0.2.7:80",
            "127.0.0.1.",
            "[::1]",
            "[::1]:8080",
            "[::1]:",
        ] {
            assert!(allowed(host), "{host}");
        }
        for host in [
            "warp.example",
            "WARP.example:443",
            "warp.example.",
            "warp.example.:8080",
            "other.example:1",
        ] {
            assert!(allowed(host), "{host}");
        }
        for host in [
            "evil.example",
            "localhost.evil.example",
            "a.localhost",
            "x",
            "127.0.0.1.evil.example",
            "2130706433",
            "127.1",
            "0x7f.0.0.1",
        ] {
            assert!(!allowed(host), "{host}");
        }
    }

    #[test]
    fn malformed_hosts_are_refused() {
        for text in [
            "",
            ".",
            ":80",
            "a b",
            "a/b",
            "user@localhost",
            "localhost:http",
            "localhost:65536",
            "localhost:80:80",
            "localhost:-1",
            "::1",
            "[::1",
            "[::1]80",
            "[127.0.0.1]",
            "[localhost]",
            "[fe80::1%25eth0]",
            "a%2",
            "a%zz",
            "http://localhost",
            "ex\u{e4}mple",
            "a\\b",
            "a?b",
            "a#b",
        ] {
            assert_eq!(Authority::parse(text), None, "{text}");
        }
    }

    #[test]
    fn a_list_has_names_alone() {
        assert!(Hosts::parse(" , ").unwrap().is_empty());
        assert!(!Hosts::parse("warp.example").unwrap().is_empty());
        for wrong in [
            "https://warp.example",
            "warp.example:443",
            "*.example",
            "*",
            "a b",
            "warp.example/",
        ] {
            assert!(
                Hosts::parse(&format!("ok.example, {wrong}"))
                    .unwrap_err()
                    .contains(&format!("`{wrong}`")),
                "{wrong}"
            );
        }
    }
}
