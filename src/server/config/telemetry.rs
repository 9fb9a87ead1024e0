//! What the service tells of itself, and to whom: traces, and numbers on a listener of their own.

use std::net::SocketAddr;

use clap::Args;

use super::{Mistakes, address};
use crate::observe::collector::Collector;

/// The options as text; [`TelemetryArgs::resolve`] reads them.
#[derive(Debug, Args)]
pub(crate) struct TelemetryArgs {
    /// Another address and port where /metrics, /healthz and /readyz are answered, without a key and without TLS.
    #[arg(long, env = "MLSWARP_METRICS_LISTEN", value_name = "ADDR", default_value = "", hide_default_value = true, global = true)]
    metrics_listen: String,
    /// Collector of traces (OTLP over HTTP), such as http://127.0.0.1:4318 or https://collector.example; spans go to /v1/traces there.
    #[arg(long, env = "MLSWARP_OTLP_ENDPOINT", value_name = "URL", default_value = "", hide_default_value = true, global = true)]
    otlp_endpoint: String,
    /// Share of requests and frames that are traced, 0 to 1, where no caller has decided.
    #[arg(long, env = "MLSWARP_OTLP_SAMPLE", value_name = "RATIO", default_value = "1", global = true)]
    otlp_sample: String,
}

/// What the service tells of itself, and to whom.
#[derive(Clone, Debug, PartialEq)]
pub struct TelemetryConfig {
    /// Where numbers and health are answered beside the service's own address.
    pub metrics_listen: Option<SocketAddr>,
    /// Where traces go; none are made without it.
    pub otlp_endpoint: Option<Collector>,
    /// Share of requests and frames that are traced.
    pub otlp_sample: f64,
}

impl TelemetryArgs {
    pub(crate) fn resolve(&self, m: &mut Mistakes, listen: SocketAddr) -> TelemetryConfig {
        TelemetryConfig {
            metrics_listen: m.read("metrics-listen", &self.metrics_listen, |text| other_address(text, listen)),
            otlp_endpoint: m.read("otlp-endpoint", &self.otlp_endpoint, |text| {
                if text.is_empty() { Ok(None) } else { Collector::parse(text).map(Some) }
            }),
            otlp_sample: m.read("otlp-sample", &self.otlp_sample, ratio),
        }
    }
}

/// None, or an address that is not the service's own.
fn other_address(text: &str, listen: SocketAddr) -> Result<Option<SocketAddr>, String> {
    if text.is_empty() {
        return Ok(None);
    }
    let asked = address(text)?;
    let is_taken = |asked: SocketAddr| {
        let (theirs, ours) = (asked.ip().to_canonical(), listen.ip().to_canonical());
        // Port 0 is another one each time.
        asked.port() == listen.port() && asked.port() != 0 && (theirs == ours || theirs.is_unspecified() || ours.is_unspecified())
    };
    match asked.filter(|asked| is_taken(*asked)) {
        Some(taken) => Err(format!("{taken} is where the service itself listens (--listen): take another port")),
        None => Ok(asked),
    }
}

fn ratio(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|ratio| (0.0..=1.0).contains(ratio)).ok_or_else(|| format!("`{text}` is not a number from 0 to 1"))
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::config::{Cli, Config};

    fn resolve(args: &[&str]) -> Result<Config, String> {
        Cli::try_parse_from([&["mlswarp"], args].concat()).expect("known flags").options.resolve().map_err(|m| m.to_string())
    }

    #[test]
    fn nothing_is_told_to_anybody_unless_asked() {
        let nothing = TelemetryConfig { metrics_listen: None, otlp_endpoint: None, otlp_sample: 1.0 };
        assert_eq!(resolve(&[]).unwrap().telemetry, nothing);
        assert_eq!(resolve(&["--metrics-listen", "", "--otlp-endpoint", ""]).unwrap().telemetry, nothing);
    }

    #[test]
    fn a_collector_is_a_plain_address() {
        for (text, url) in [
            ("http://127.0.0.1:4318", "http://127.0.0.1:4318/v1/traces"),
            ("http://collector:4318/", "http://collector:4318/v1/traces"),
            ("http://[::1]:4318/otlp/", "http://[::1]:4318/otlp/v1/traces"),
            ("http://collector.example", "http://collector.example:80/v1/traces"),
            ("http://[::1]", "http://[::1]:80/v1/traces"),
            ("https://collector.example", "https://collector.example:443/v1/traces"),
            ("https://[::1]:4318/otlp", "https://[::1]:4318/otlp/v1/traces"),
        ] {
            let config = resolve(&["--otlp-endpoint", text]).unwrap().telemetry;
            assert_eq!(config.otlp_endpoint.unwrap().to_string(), url);
        }
        for bad in
            ["ftp://collector:4318", "collector:4318", "http://", "http://:4318", "http://a:b", "http://u:p@host:1", "http://host:1/a b"]
        {
            let refused = resolve(&["--otlp-endpoint", bad]).unwrap_err();
            assert!(refused.contains("--otlp-endpoint (MLSWARP_OTLP_ENDPOINT)"), "{bad}: {refused}");
        }
    }

    #[test]
    fn numbers_have_a_listener_of_their_own_or_none() {
        for (listen, metrics) in [
            ("127.0.0.1:80", "127.0.0.1:80"),
            ("0.0.0.0:80", "127.0.0.1:80"),
            ("127.0.0.1:80", "[::]:80"),
            ("127.0.0.1:80", "localhost:80"),
        ] {
            let refused = resolve(&["--listen", listen, "--metrics-listen", metrics]).unwrap_err();
            assert!(refused.contains("--metrics-listen (MLSWARP_METRICS_LISTEN)") && refused.contains("--listen)"), "{refused}");
        }
        for (listen, metrics) in [("127.0.0.1:80", "127.0.0.1:81"), ("127.0.0.1:80", "127.0.0.2:80"), ("127.0.0.1:0", "127.0.0.1:0")] {
            let config = resolve(&["--listen", listen, "--metrics-listen", metrics]).unwrap();
            assert_eq!(config.telemetry.metrics_listen, Some(metrics.parse().unwrap()));
        }
        assert!(resolve(&["--metrics-listen", "9000"]).is_err());
    }

    #[test]
    fn a_share_lies_between_nothing_and_all() {
        assert_eq!(resolve(&["--otlp-sample=0.05"]).unwrap().telemetry.otlp_sample.to_string(), "0.05");
        for bad in ["2", "-0.1", "NaN", "all", ""] {
            assert!(resolve(&[&format!("--otlp-sample={bad}")]).is_err(), "{bad}");
        }
    }
}
