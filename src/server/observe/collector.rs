//! The address of a collector of traces.

use std::fmt;

/// Where a collector accepts spans.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Collector {
    /// Host and port.
    pub authority: String,
    /// It is reached over TLS.
    pub is_tls: bool,
    path: String,
}

impl Collector {
    /// Reads `http[s]://host[:port][/path]`.
    /// Errors: `text` has another form.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mistake = |why: &str| Err(format!("`{text}` {why}"));
        let (plain, encrypted) = (text.strip_prefix("http://"), text.strip_prefix("https://"));
        let is_tls = encrypted.is_some();
        let Some(rest) = plain.or(encrypted) else { return mistake("is not an address such as http://127.0.0.1:4318") };
        let (authority, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
        let is_plain = |text: &str, more: &[u8]| text.bytes().all(|b| b.is_ascii_alphanumeric() || more.contains(&b));
        if !is_plain(authority, b".-_:[]") || !is_plain(path, b"/.-_~%") {
            return mistake("has more than a host, a port and a path; set headers in OTEL_EXPORTER_OTLP_HEADERS");
        }
        let (host, port) = match authority.rfind(':') {
            Some(colon) if !authority.ends_with(']') => (&authority[..colon], &authority[colon + 1..]),
            _ => (authority, if is_tls { "443" } else { "80" }),
        };
        if host.is_empty() || port.parse::<u16>().is_err() {
            return mistake("has no host, or an invalid port");
        }
        Ok(Self { authority: format!("{host}:{port}"), is_tls, path: format!("{}/v1/traces", path.trim_end_matches('/')) })
    }

    /// The host name or the address without brackets, as certificates have it.
    pub fn host(&self) -> &str {
        let host = self.authority.rsplit_once(':').map_or(&*self.authority, |(host, _)| host);
        host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host)
    }
}

impl fmt::Display for Collector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}://{}{}", if self.is_tls { "https" } else { "http" }, self.authority, self.path)
    }
}
