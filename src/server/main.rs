//! The program: `mlswarp` serves, `mlswarp warp` bends one picture offline, `mlswarp health` asks a running server.
//! Exit codes: 0 done, 1 failed, 2 the command line or the environment has mistakes.

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[expect(unsafe_code, reason = "the C library is asked to give memory back")]
mod malloc_trim;
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
mod malloc_trim {
    /// Other allocators give memory back by themselves.
    pub(crate) const fn start() {}
}

use std::process::ExitCode;

use mlswarp_server::cli::{health, warp};
use mlswarp_server::config::{ArgsError, Cli, Command, Config};
use mlswarp_server::http::connection;
use mlswarp_server::observe;

fn main() -> ExitCode {
    match Cli::read(std::env::args_os()) {
        Ok(cli) => match run(cli.command.unwrap_or(Command::Serve), cli.config) {
            Ok(()) => ExitCode::SUCCESS,
            Err(message) => {
                eprintln!("{message}");
                ExitCode::FAILURE
            }
        },
        Err(ArgsError::Usage(text)) => {
            // `--help` and `--version` are printed the same way. A failure to print cannot be reported.
            let _ = text.print();
            ExitCode::from(u8::try_from(text.exit_code()).unwrap_or(2))
        }
        Err(mistakes) => {
            eprintln!("{mistakes}");
            ExitCode::from(2)
        }
    }
}

fn run(command: Command, config: Config) -> Result<(), String> {
    match command {
        Command::Serve => {
            observe::start(&config.telemetry.log, config.telemetry.log_format);
            malloc_trim::start();
            connection::run(config).map_err(|error| format!("error: {error}"))
        }
        Command::Health => health::ask(&config).map_err(|error| format!("error: {error}")),
        Command::Warp { image, warp, out } => {
            let summary = warp::run(&config, &image, &warp, &out).map_err(|problem| warp::error_message(&problem))?;
            eprintln!("{summary}");
            Ok(())
        }
    }
}
