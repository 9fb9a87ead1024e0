//! The command line: flags and `MLSWARP_*` variables. A flag takes precedence over its variable, a
//! variable over the default.

mod auth;
pub(crate) mod available_memory;
mod clients;
mod command;
mod help;
mod option;
mod store;
mod telemetry;
mod unknown;
mod work;

use std::ffi::OsString;
use std::net::SocketAddr;

use clap::error::ErrorKind;
use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser};
use mlswarp::warp::{ImageLimits, Limits};

use option::{Checked, clear_mistakes, keep_final, size, take_mistakes, whole};

pub use auth::AuthConfig;
pub(crate) use auth::{KeysConfig, SecretsConfig};
pub use clients::{ClientLimits, ClientShare, Timeouts};
pub use command::{
    BatchArgs, BlendArgs, Command, ExtentInput, FileOptions, FitArgs, FrameOptions, FramesOptions,
    LandmarkInput, MapArgs, PointsArgs, PoseOptions, ReportArgs, WarpArgs, WarpInput, WarpKind,
};
pub use help::command;
pub use store::StoreConfig;
pub use telemetry::TelemetryConfig;
use unknown::suggest_effective;
pub use unknown::unknown_variables;
pub use work::WorkConfig;

/// The command line.
#[derive(Debug, Parser)]
#[command(name = "mlswarp", version, args_override_self = true)]
#[command(
    about = "Warps images with control points, lines and polylines (moving least squares): as an \
        HTTP service, or offline."
)]
pub struct Cli {
    /// The command; without one the server starts.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// The options.
    #[command(flatten)]
    pub config: Config,
}

/// All options.
#[derive(Args, Clone, Debug, PartialEq)]
#[command(next_help_heading = "Limits of one request")]
pub struct Config {
    /// Address and port of the service.
    #[arg(long, help_heading = None, value_name = "ADDR", default_value = "127.0.0.1:8080",
        value_parser = Checked(address))]
    pub listen: SocketAddr,
    /// Path at which a reverse proxy publishes the service, such as /tools/warp. The proxy removes
    /// it from requests; the server puts it before the paths in responses: Location, the type of
    /// problems, and the servers of /openapi.json.
    #[arg(long, help_heading = None, value_name = "PATH", default_value = "",
        hide_default_value = true)]
    #[arg(value_parser = Checked(public_path))]
    pub public_path: String,
    /// Maximum size of a request body.
    #[arg(long, value_name = "SIZE", default_value = "32MiB", value_parser = Checked(size))]
    pub max_body_bytes: u64,
    /// Maximum size of a warp object. (The JSON of a drag: 64 KiB and 64 bytes per column.)
    #[arg(long, value_name = "SIZE", default_value = "4MiB", value_parser = Checked(size))]
    pub max_warp_json_bytes: u64,
    /// Maximum number of pixels of a source or target.
    #[arg(long, value_name = "N", default_value = "50M",
        value_parser = Checked(whole::<u64>(1, u64::from(u32::MAX))))]
    max_image_pixels: u64,
    /// Maximum width and height of a source or target, px.
    #[arg(long, value_name = "N", default_value = "16384",
        value_parser = Checked(whole::<u32>(1, 1_000_000)))]
    max_image_side: u32,
    /// Maximum size of a set of handles: a point counts 1, a segment 2.
    #[arg(long, value_name = "N", default_value = "10000",
        value_parser = Checked(whole::<usize>(1, 1_000_000)))]
    max_columns: usize,
    /// Maximum number of handles on which methods are compared, by POST /fit and by the method
    /// auto; the time grows with its cube.
    #[arg(long, value_name = "N", default_value = "2000",
        value_parser = Checked(whole::<usize>(4, 2000)))]
    pub max_fit_handles: usize,
    /// Maximum size of a plan's table of coefficients; a larger warp is evaluated without a table.
    #[arg(long, value_name = "SIZE", default_value = "512MiB", value_parser = Checked(size))]
    max_plan_bytes: u64,
    /// Maximum work of one task, in operations of some nanoseconds that are counted before it
    /// begins: handles times grid vertices or positions, the system of a spline, methods that are
    /// compared. A larger task is answered 413.
    #[arg(long, value_name = "N", default_value = "12G",
        value_parser = Checked(whole::<u64>(1, u64::MAX)))]
    max_work: u64,
    /// Workers, queues and memory.
    #[command(flatten)]
    pub work: WorkConfig,
    /// The session store.
    #[command(flatten)]
    pub store: StoreConfig,
    /// Access.
    #[command(flatten)]
    pub auth: AuthConfig,
    /// What one client may use.
    #[command(flatten)]
    pub clients: ClientLimits,
    /// How long clients may take.
    #[command(flatten)]
    pub timeouts: Timeouts,
    /// Logs, traces and metrics.
    #[command(flatten)]
    pub telemetry: TelemetryConfig,
}

impl Cli {
    /// Reads a command line and the environment. Errors: All mistakes at once, one per line.
    /// Without `--allow-anonymous`, a server that others can reach without keys is one.
    pub fn read<I: IntoIterator<Item: Into<OsString> + Clone>>(
        args: I,
    ) -> Result<Self, clap::Error> {
        let args: Vec<OsString> = args.into_iter().map(Into::into).collect();
        match help::limits_help(&args) {
            Some(limits) => Err(limits),
            None => Self::read_with(command(), args),
        }
    }

    fn read_with(command: clap::Command, args: Vec<OsString>) -> Result<Self, clap::Error> {
        clear_mistakes();
        let matches = command.clone().try_get_matches_from(&args);
        let matches =
            matches.map_err(|error| suggest_effective(error, &help::effective_flags(&args)))?;
        let mut cli = Self::from_arg_matches(&matches)?;
        keep_final(&matches, &command);
        help::report_without_effect(&matches, &command);
        cli.config.auth.load();
        cli.config.telemetry.check_listen(cli.config.listen);
        if matches!(cli.command, None | Some(Command::Serve)) {
            cli.config.auth.check_anonymous(cli.config.listen);
        }
        let mistakes = take_mistakes();
        if mistakes.is_empty() {
            return Ok(cli);
        }
        let text = format!(
            "{}\nmlswarp serve --help lists the options with their defaults\n",
            mistakes.join("\nerror: ")
        );
        Err(clap::Error::raw(ErrorKind::ValueValidation, text))
    }
}

impl Config {
    /// Reads the options of a command line.
    /// Errors: As [`Cli::read`].
    pub fn read<I: IntoIterator<Item: Into<OsString> + Clone>>(
        args: I,
    ) -> Result<Self, clap::Error> {
        Cli::read(args).map(|cli| cli.config)
    }

    /// The options that have an effect without a server, and the defaults of all others.
    pub fn offline(&self) -> Self {
        let Self {
            max_body_bytes,
            max_warp_json_bytes,
            max_image_pixels,
            max_image_side,
            max_columns,
            max_fit_handles,
            ..
        } = *self;
        let Self {
            max_plan_bytes,
            work,
            ..
        } = *self;
        let mut offline = Self::default();
        // No client waits for a response.
        offline.timeouts.request = std::time::Duration::from_secs(u64::from(u32::MAX));
        offline.clients.client_share = ClientShare::ALL;
        Self {
            max_body_bytes,
            max_warp_json_bytes,
            max_image_pixels,
            max_image_side,
            max_columns,
            max_fit_handles,
            max_plan_bytes,
            // The user waits as long as it takes.
            max_work: u64::MAX,
            work,
            ..offline
        }
    }

    /// What one warp may use.
    pub const fn limits(&self) -> Limits {
        let image = ImageLimits {
            max_pixels: self.max_image_pixels,
            max_side: self.max_image_side,
        };
        Limits {
            image,
            columns: self.max_columns,
            plan_bytes: self.max_plan_bytes,
            work: self.max_work,
        }
    }
}

impl Default for Config {
    /// The defaults of all options, without the environment.
    fn default() -> Self {
        Cli::read_with(Cli::command(), vec!["mlswarp".into()])
            .expect("a test reads the defaults")
            .config
    }
}

fn address(text: &str) -> Result<SocketAddr, String> {
    text.replace("localhost:", "127.0.0.1:")
        .parse()
        .map_err(|_| {
            format!(
                "`{text}` is not an address and port such as 127.0.0.1:8080, \
            0.0.0.0:80 or [::]:8080"
            )
        })
}

/// A path without its last slash; the root is empty.
fn public_path(text: &str) -> Result<String, String> {
    let path = text.strip_suffix('/').unwrap_or(text);
    let is_segment = |segment: &str| {
        let is_plain = segment
            .bytes()
            .all(|b| b.is_ascii_alphanumeric() || b"-._~".contains(&b));
        is_plain && !["", ".", ".."].contains(&segment)
    };
    let is_path = path
        .strip_prefix('/')
        .is_some_and(|segments| segments.split('/').all(is_segment));
    let wrong =
        || format!("`{text}` is not a path such as /tools/warp, of letters, digits and -._~");
    if path.is_empty() || is_path {
        Ok(path.to_owned())
    } else {
        Err(wrong())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(args: &[&str]) -> Result<Config, clap::Error> {
        Config::read([&["mlswarp"], args].concat())
    }

    #[test]
    fn defaults_are_those_of_the_contract() {
        let config = Config::default();
        assert_eq!(config.listen, SocketAddr::from(([127, 0, 0, 1], 8080)));
        assert_eq!(config.max_body_bytes, 32 << 20);
        assert_eq!(config.max_warp_json_bytes, 4 << 20);
        assert_eq!(config.limits().image, ImageLimits::default());
        assert_eq!(
            (config.limits().columns, config.limits().plan_bytes),
            (10_000, 512 << 20)
        );
        assert_eq!(
            config.work.queue(),
            (4 * config.work.workers).max(work::MIN_QUEUE)
        );
        assert_eq!(
            (config.work.drag_wait, config.work.upload_wait),
            (
                std::time::Duration::from_millis(200),
                std::time::Duration::from_secs(5)
            )
        );
        assert_eq!(
            config.store.session_idle,
            std::time::Duration::from_secs(900)
        );
    }

    #[test]
    fn a_public_path_is_plain_and_has_no_slash_at_its_end() {
        for (given, path) in [
            ("", ""),
            ("/", ""),
            ("/warp", "/warp"),
            ("/tools/warp/", "/tools/warp"),
            ("/~a/b.c-d_e", "/~a/b.c-d_e"),
        ] {
            assert_eq!(
                resolve(&["--public-path", given]).unwrap().public_path,
                path,
                "{given}"
            );
        }
        for wrong in [
            "warp",
            "//",
            "//host/warp",
            "/a//b",
            "/a/../b",
            "/.",
            "/a b",
            "/a%2fb",
            "/a?b",
            "/a\nb",
            "https://host/warp",
            "/\u{e4}",
        ] {
            let told = resolve(&["--public-path", wrong]).unwrap_err().to_string();
            assert!(
                told.contains("--public-path (MLSWARP_PUBLIC_PATH)"),
                "{wrong:?}: {told}"
            );
        }
    }

    #[test]
    fn mistakes_are_told_all_at_once() {
        let mistakes = resolve(&[
            "--listen",
            "here",
            "--workers",
            "none",
            "--max-body-bytes",
            "0",
            "--body-timeout",
            "30",
            "--log-format",
            "xml",
        ])
        .expect_err("five mistakes");
        let text = mistakes.to_string();
        let mistakes: Vec<_> = text
            .lines()
            .filter_map(|line| line.strip_prefix("error: "))
            .collect();
        assert_eq!(mistakes.len(), 5, "{mistakes:?}");
        for flag in [
            "--listen (MLSWARP_LISTEN)",
            "--workers",
            "--max-body-bytes",
            "--body-timeout",
            "--log-format",
        ] {
            assert!(
                mistakes.iter().any(|m| m.starts_with(flag)),
                "{flag} in {mistakes:?}"
            );
        }
    }

    #[test]
    fn options_may_stand_before_and_after_the_subcommand() {
        assert_eq!(
            resolve(&["--workers", "30", "serve"])
                .expect("valid")
                .work
                .queue(),
            120
        );
        assert_eq!(
            resolve(&["serve", "--workers", "30"])
                .expect("valid")
                .work
                .queue(),
            120
        );
    }

    #[test]
    fn only_the_value_that_counts_can_be_wrong() {
        assert_eq!(
            resolve(&["--workers", "none", "--workers", "2"])
                .expect("the last one counts")
                .work
                .workers,
            2
        );
        let text = resolve(&["--listen", "0.0.0.0:80", "--workers", "none", "serve"])
            .expect_err("two mistakes")
            .to_string();
        assert!(
            text.contains("--listen") && text.matches("--workers").count() == 1,
            "{text}"
        );
    }

    #[test]
    fn every_flag_has_the_variable_of_its_name() {
        let command = command();
        let options: Vec<_> = command
            .get_arguments()
            .filter(|a| !["help", "version"].contains(&a.get_id().as_str()))
            .collect();
        assert!(options.len() > 15);
        for option in options {
            let flag = option.get_long().expect("a long flag");
            let expected = format!("MLSWARP_{}", flag.to_uppercase().replace('-', "_"));
            assert_eq!(
                option.get_env().and_then(|e| e.to_str()),
                Some(expected.as_str())
            );
        }
    }
}
