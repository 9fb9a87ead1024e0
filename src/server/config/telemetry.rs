//! Options of logs, traces and metrics.

use std::net::SocketAddr;
use std::str::FromStr as _;

use clap::Args;

use super::address;
use super::option::{Checked, Maybe, report, unless};
use crate::observe::LogFormat;
use crate::observe::otlp_client::{CollectorUrl, parse_collector};

/// Logs, traces and metrics.
#[derive(Args, Clone, Debug, PartialEq)]
#[command(next_help_heading = "Metrics, traces and logs")]
pub struct TelemetryConfig {
    /// Additional address and port for /metrics, /healthz and /readyz, without keys and without
    /// TLS.
    #[arg(long, value_name = "ADDR", default_value = "", hide_default_value = true,
        value_parser = Checked(unless("", address)))]
    pub metrics_listen: Maybe<SocketAddr>,
    /// Collector of traces (OTLP over HTTP), such as http://127.0.0.1:4318 or
    /// https://collector.example; spans are sent to its /v1/traces.
    #[arg(long, value_name = "URL", default_value = "", hide_default_value = true,
        value_parser = Checked(unless("", parse_collector)))]
    pub(crate) otlp_endpoint: Maybe<CollectorUrl>,
    /// Ratio of requests and frames that are traced, 0 to 1, unless the caller has decided.
    #[arg(long, value_name = "RATIO", default_value = "1", value_parser = Checked(ratio))]
    pub otlp_sample: f64,
    /// Log filter, such as `info`, `mlswarp=debug,warn` or `off`.
    #[arg(long, value_name = "FILTER", default_value = "info", value_parser = Checked(filter))]
    pub log: String,
    /// Format of log lines: `text` or `json`.
    #[arg(long, value_name = "FORMAT", default_value = "text", value_parser = Checked(log_format))]
    pub log_format: LogFormat,
}

impl TelemetryConfig {
    /// Reports an additional address that is the service's own.
    pub(super) fn check_listen(&self, listen: SocketAddr) {
        let is_taken = |other: &SocketAddr| {
            let (theirs, ours) = (other.ip().to_canonical(), listen.ip().to_canonical());
            // Port 0 is a different one each time.
            other.port() == listen.port()
                && other.port() != 0
                && (theirs == ours || theirs.is_unspecified() || ours.is_unspecified())
        };
        if let Some(taken) = self.metrics_listen.filter(is_taken) {
            report::<()>(
                "metrics-listen",
                Err(format!(
                    "{taken} is the address of the service (--listen); choose another port"
                )),
            );
        }
    }
}

fn ratio(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|ratio| (0.0..=1.0).contains(ratio))
        .ok_or_else(|| format!("`{text}` is not a number from 0 to 1"))
}

fn filter(text: &str) -> Result<String, String> {
    tracing_subscriber::EnvFilter::from_str(text)
        .map(|_| text.to_owned())
        .map_err(|e| format!("`{text}` is not a filter such as info or mlswarp=debug,warn: {e}"))
}

fn log_format(text: &str) -> Result<LogFormat, String> {
    match text {
        "text" => Ok(LogFormat::Text),
        "json" => Ok(LogFormat::Json),
        _ => Err(format!("`{text}` is neither text nor json")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn resolve(args: &[&str]) -> Result<Config, String> {
        Config::read([&["mlswarp"], args].concat()).map_err(|m| m.to_string())
    }

    #[test]
    fn nothing_is_told_to_anybody_unless_asked() {
        let nothing = (None, None, 1.0);
        let telemetry = |args: &[&str]| {
            let TelemetryConfig {
                metrics_listen,
                otlp_endpoint,
                otlp_sample,
                ..
            } = resolve(args).unwrap().telemetry;
            (metrics_listen, otlp_endpoint, otlp_sample)
        };
        assert_eq!(telemetry(&[]), nothing);
        assert_eq!(
            telemetry(&["--metrics-listen", "", "--otlp-endpoint", ""]),
            nothing
        );
    }

    #[test]
    fn a_collector_is_a_plain_address() {
        for (text, url) in [
            ("http://127.0.0.1:4318", "http://127.0.0.1:4318/v1/traces"),
            ("http://collector:4318/", "http://collector:4318/v1/traces"),
            (
                "http://[::1]:4318/otlp/",
                "http://[::1]:4318/otlp/v1/traces",
            ),
            (
                "http://collector.example",
                "http://collector.example:80/v1/traces",
            ),
            ("http://[::1]", "http://[::1]:80/v1/traces"),
            (
                "https://collector.example",
                "https://collector.example:443/v1/traces",
            ),
            (
                "https://[::1]:4318/otlp",
                "https://[::1]:4318/otlp/v1/traces",
            ),
        ] {
            let config = resolve(&["--otlp-endpoint", text]).unwrap().telemetry;
            assert_eq!(config.otlp_endpoint.unwrap().to_string(), url);
        }
        for bad in [
            "ftp://collector:4318",
            "collector:4318",
            "http://",
            "http://:4318",
            "http://a:b",
            "http://u:p@host:1",
            "http://host:1/a b",
        ] {
            let refused = resolve(&["--otlp-endpoint", bad]).unwrap_err();
            assert!(
                refused.contains("--otlp-endpoint (MLSWARP_OTLP_ENDPOINT)"),
                "{bad}: {refused}"
            );
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
            assert!(
                refused.contains("--metrics-listen (MLSWARP_METRICS_LISTEN)")
                    && refused.contains("--listen)"),
                "{refused}"
            );
        }
        for (listen, metrics) in [
            ("127.0.0.1:80", "127.0.0.1:81"),
            ("127.0.0.1:80", "127.0.0.2:80"),
            ("127.0.0.1:0", "127.0.0.1:0"),
        ] {
            let config = resolve(&["--listen", listen, "--metrics-listen", metrics]).unwrap();
            assert_eq!(
                config.telemetry.metrics_listen,
                Some(metrics.parse().unwrap())
            );
        }
        assert!(resolve(&["--metrics-listen", "9000"]).is_err());
    }

    #[test]
    fn a_share_lies_between_nothing_and_all() {
        assert_eq!(
            resolve(&["--otlp-sample=0.05"])
                .unwrap()
                .telemetry
                .otlp_sample
                .to_string(),
            "0.05"
        );
        for bad in ["2", "-0.1", "NaN", "all", ""] {
            assert!(
                resolve(&[&format!("--otlp-sample={bad}")]).is_err(),
                "{bad}"
            );
        }
    }
}
