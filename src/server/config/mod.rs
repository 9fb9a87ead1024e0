//! Flags and `MLSWARP_*` variables. A flag wins over its variable, a variable over the default. Every value travels as text until
//! [`Options::resolve`] reads all of them, so that all mistakes are told at once.

mod access;
mod memory;
mod store;
mod telemetry;
mod units;
mod work;

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use mlswarp::warp::{ImageLimits, Limits};

use crate::observe::LogFormat;

pub use access::{AccessConfig, KeysConfig};
pub use store::StoreConfig;
pub use telemetry::TelemetryConfig;
pub use work::{WorkConfig, WorkOptions};

/// The command line.
#[derive(Debug, Parser)]
#[command(
    name = "mlswarp",
    version,
    args_override_self = true,
    about = "Bends images as if they were real objects (moving least squares), over HTTP or offline."
)]
#[command(after_help = "Sizes: 32MiB, 512K, 1048576. Times: 500ms, 30s, 15m. Every option has the variable that its help names.")]
pub struct Cli {
    /// What to do; without it the server starts.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// The options, as text.
    #[command(flatten)]
    pub options: Options,
}

/// What the program does.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start the server (the default).
    Serve,
    /// Bend one picture offline: the same walk as POST /warp, into a file.
    Warp {
        /// The picture (PNG, JPEG, WebP); `-` reads standard input.
        image: PathBuf,
        /// The warp object (JSON); `-` reads standard input.
        warp: PathBuf,
        /// Where the picture goes; `-` writes standard output. Where the warp object names no format, .png, .jpg or .webp does.
        #[arg(short, long)]
        out: PathBuf,
    },
    /// Ask the server at the metrics' address, or else at the listen address, whether it can take work; exit code 0 or 1.
    Health,
}

/// Every option as text; [`Options::resolve`] reads them.
#[derive(Debug, Args)]
pub struct Options {
    /// Address and port to listen on.
    #[arg(long, env = "MLSWARP_LISTEN", value_name = "ADDR", default_value = "127.0.0.1:8080", global = true)]
    listen: String,
    #[command(flatten)]
    work: WorkOptions,
    /// Largest request body.
    #[arg(long, env = "MLSWARP_MAX_BODY_BYTES", value_name = "SIZE", default_value = "32MiB", global = true)]
    max_body_bytes: String,
    /// Largest warp object beside an image. (A drag has 64 KiB + 64 bytes a column.)
    #[arg(long, env = "MLSWARP_MAX_WARP_JSON_BYTES", value_name = "SIZE", default_value = "4MiB", global = true)]
    max_warp_json_bytes: String,
    /// Most pixels of a picture, in or out.
    #[arg(long, env = "MLSWARP_MAX_IMAGE_PIXELS", value_name = "N", default_value = "50M", global = true)]
    max_image_pixels: String,
    /// Most pixels along a side, in or out.
    #[arg(long, env = "MLSWARP_MAX_IMAGE_SIDE", value_name = "N", default_value = "16384", global = true)]
    max_image_side: String,
    /// Most columns of a plan: 1 a point, 2 a segment.
    #[arg(long, env = "MLSWARP_MAX_COLUMNS", value_name = "N", default_value = "10000", global = true)]
    max_columns: String,
    /// Largest table of coefficients; a larger one is evaluated without a table.
    #[arg(long, env = "MLSWARP_MAX_PLAN_BYTES", value_name = "SIZE", default_value = "512MiB", global = true)]
    max_plan_bytes: String,
    #[command(flatten)]
    store: store::StoreArgs,
    /// Most drag sockets; one more is answered 503.
    #[arg(long, env = "MLSWARP_MAX_SOCKETS", value_name = "N", default_value = "256", global = true)]
    max_sockets: String,
    /// How long a drag socket may be silent before it is pinged; silent for as long again, it is closed.
    #[arg(long, env = "MLSWARP_SOCKET_IDLE", value_name = "TIME", default_value = "20s", global = true)]
    socket_idle: String,
    /// Longest time for a drag socket's client to take what it is sent, and to acknowledge a frame.
    #[arg(long, env = "MLSWARP_SOCKET_TIMEOUT", value_name = "TIME", default_value = "30s", global = true)]
    socket_timeout: String,
    #[command(flatten)]
    access: access::AccessArgs,
    #[command(flatten)]
    telemetry: telemetry::TelemetryArgs,
    /// What is logged, such as `info`, `mlswarp=debug,warn` or `off`.
    #[arg(long, env = "MLSWARP_LOG", value_name = "FILTER", default_value = "info", global = true)]
    log: String,
    /// Log lines as `text` or `json`.
    #[arg(long, env = "MLSWARP_LOG_FORMAT", value_name = "FORMAT", default_value = "text", global = true)]
    log_format: String,
}

/// Everything that can be set, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Address and port to listen on.
    pub listen: SocketAddr,
    /// Workers, queues and memory.
    pub work: WorkConfig,
    /// Largest request body.
    pub max_body_bytes: u64,
    /// Largest warp object beside an image.
    pub max_warp_json_bytes: u64,
    /// What one warp may ask for.
    pub limits: Limits,
    /// Where sessions live, and how many.
    pub store: StoreConfig,
    /// Most drag sockets.
    pub max_sockets: usize,
    /// How long a drag socket may be silent before it is pinged, and then before it is closed.
    pub socket_idle: Duration,
    /// Longest time for a drag socket's client to take what it is sent, and to acknowledge a frame.
    pub socket_timeout: Duration,
    /// Who is let in, and how long clients may take.
    pub access: AccessConfig,
    /// What is told of the service, and to whom.
    pub telemetry: TelemetryConfig,
    /// What is logged.
    pub log: String,
    /// How log lines look.
    pub log_format: LogFormat,
}

/// Every mistake in the options.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistakes(Vec<String>);

impl fmt::Display for Mistakes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for mistake in &self.0 {
            writeln!(f, "error: {mistake}")?;
        }
        write!(f, "mlswarp --help lists the options with their defaults")
    }
}

impl std::error::Error for Mistakes {}

impl Mistakes {
    /// The value, or its type's default and a note of the mistake.
    fn read<T: Default>(&mut self, flag: &str, text: &str, parse: impl FnOnce(&str) -> Result<T, String>) -> T {
        parse(text).unwrap_or_else(|mistake| {
            let variable = flag.to_ascii_uppercase().replace('-', "_");
            self.0.push(format!("--{flag} (MLSWARP_{variable}): {mistake}"));
            T::default()
        })
    }
}

impl Options {
    /// Reads every option.
    ///
    /// # Errors
    /// All mistakes at once.
    pub fn resolve(&self) -> Result<Config, Mistakes> {
        let mut m = Mistakes(Vec::new());
        let config = self.read(&mut m);
        if m.0.is_empty() { Ok(config) } else { Err(m) }
    }

    /// Reads every option, for a server.
    ///
    /// # Errors
    /// All mistakes at once; one of them is to let everybody in without having said so.
    pub fn resolve_to_serve(&self) -> Result<Config, Mistakes> {
        let mut m = Mistakes(Vec::new());
        let config = self.read(&mut m);
        self.access.check_open(&mut m, config.listen, &config.access);
        if m.0.is_empty() { Ok(config) } else { Err(m) }
    }

    fn read(&self, m: &mut Mistakes) -> Config {
        let listen = m.read("listen", &self.listen, address).unwrap_or_else(|| SocketAddr::from(([127, 0, 0, 1], 8080)));
        Config {
            listen,
            work: self.work.resolve(m),
            max_body_bytes: m.read("max-body-bytes", &self.max_body_bytes, size),
            max_warp_json_bytes: m.read("max-warp-json-bytes", &self.max_warp_json_bytes, size),
            limits: Limits {
                image: ImageLimits {
                    max_pixels: m.read("max-image-pixels", &self.max_image_pixels, |t| whole(t, 1, u64::from(u32::MAX))),
                    max_side: m.read("max-image-side", &self.max_image_side, |t| whole(t, 1, 1_000_000)),
                },
                columns: m.read("max-columns", &self.max_columns, |t| whole(t, 1, 1_000_000)),
                plan_bytes: m.read("max-plan-bytes", &self.max_plan_bytes, size),
            },
            store: self.store.resolve(m),
            max_sockets: m.read("max-sockets", &self.max_sockets, |t| whole(t, 0, 1_000_000)),
            socket_idle: m.read("socket-idle", &self.socket_idle, units::span),
            socket_timeout: m.read("socket-timeout", &self.socket_timeout, units::span),
            access: self.access.resolve(m),
            telemetry: self.telemetry.resolve(m, listen),
            log: m.read("log", &self.log, filter),
            log_format: m.read("log-format", &self.log_format, log_format).unwrap_or(LogFormat::Text),
        }
    }
}

impl Default for Config {
    /// What `mlswarp` without options has.
    fn default() -> Self {
        let defaults = Cli::parse_from_defaults();
        defaults.options.resolve().expect("the defaults are read by the same parser, and a test reads them")
    }
}

impl Cli {
    /// The defaults alone: neither flags nor the environment.
    fn parse_from_defaults() -> Self {
        use clap::{CommandFactory as _, FromArgMatches as _};
        let command = Self::command().mut_args(|arg| arg.env(None::<&str>));
        let matches = command.try_get_matches_from(["mlswarp"]).expect("every option has a default");
        Self::from_arg_matches(&matches).expect("the matches are of this command")
    }
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

fn address(text: &str) -> Result<Option<SocketAddr>, String> {
    text.replace("localhost:", "127.0.0.1:")
        .parse()
        .map(Some)
        .map_err(|_| format!("`{text}` is not an address and port such as 127.0.0.1:8080, 0.0.0.0:80 or [::]:8080"))
}

fn whole<T: TryFrom<u64>>(text: &str, least: u64, most: u64) -> Result<T, String> {
    let n = units::count(text)?;
    let outside = || format!("`{text}` is not between {least} and {most}");
    if !(least..=most).contains(&n) {
        return Err(outside());
    }
    T::try_from(n).map_err(|_| outside())
}

/// At least one byte: a limit of none would refuse everything.
fn size(text: &str) -> Result<u64, String> {
    units::bytes(text).and_then(|n| if n == 0 { Err("0 would refuse everything".to_owned()) } else { Ok(n) })
}

fn filter(text: &str) -> Result<String, String> {
    tracing_subscriber::EnvFilter::from_str(text)
        .map(|_| text.to_owned())
        .map_err(|e| format!("`{text}` is not a filter such as info or mlswarp=debug,warn: {e}"))
}

fn log_format(text: &str) -> Result<Option<LogFormat>, String> {
    match text {
        "text" => Ok(Some(LogFormat::Text)),
        "json" => Ok(Some(LogFormat::Json)),
        _ => Err(format!("`{text}` is neither text nor json")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(args: &[&str]) -> Result<Config, Mistakes> {
        Cli::try_parse_from([&["mlswarp"], args].concat()).expect("known flags").options.resolve()
    }

    #[test]
    fn defaults_are_those_of_the_contract() {
        let config = Config::default();
        assert_eq!(config.listen, SocketAddr::from(([127, 0, 0, 1], 8080)));
        assert_eq!(config.max_body_bytes, 32 << 20);
        assert_eq!(config.max_warp_json_bytes, 4 << 20);
        assert_eq!(config.limits.image, ImageLimits::default());
        assert_eq!((config.limits.columns, config.limits.plan_bytes), (10_000, 512 << 20));
        assert_eq!(config.work.queue, (4 * config.work.workers).max(work::LEAST_QUEUE));
        assert_eq!((config.work.drag_wait, config.work.upload_wait), (Duration::from_millis(200), Duration::from_secs(5)));
        assert_eq!(config.store.bounds.idle, Duration::from_secs(900));
    }

    #[test]
    fn mistakes_are_told_all_at_once() {
        let mistakes =
            resolve(&["--listen", "here", "--workers", "none", "--max-body-bytes", "0", "--body-timeout", "30", "--log-format", "xml"])
                .expect_err("five mistakes");
        assert_eq!(mistakes.0.len(), 5, "{mistakes}");
        for flag in ["--listen (MLSWARP_LISTEN)", "--workers", "--max-body-bytes", "--body-timeout", "--log-format"] {
            assert!(mistakes.0.iter().any(|m| m.starts_with(flag)), "{flag} in {mistakes}");
        }
    }

    #[test]
    fn options_may_stand_before_and_after_the_subcommand() {
        assert_eq!(resolve(&["--workers", "30", "serve"]).expect("valid").work.queue, 120);
        assert_eq!(resolve(&["serve", "--workers", "30"]).expect("valid").work.queue, 120);
    }

    #[test]
    fn every_flag_has_the_variable_of_its_name() {
        use clap::CommandFactory as _;
        let command = Cli::command();
        let options: Vec<_> = command.get_arguments().filter(|a| !["help", "version"].contains(&a.get_id().as_str())).collect();
        assert!(options.len() > 15);
        for option in options {
            let flag = option.get_long().expect("a long flag");
            let expected = format!("MLSWARP_{}", flag.to_uppercase().replace('-', "_"));
            assert_eq!(option.get_env().and_then(|e| e.to_str()), Some(expected.as_str()));
        }
    }
}
