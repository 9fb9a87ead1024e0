//! The program: `mlswarp` serves, `mlswarp warp` warps one picture offline, `mlswarp health` asks a running server.
//! Exit codes: 0 success, 1 failure, 2 mistakes in the command line or the environment.

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[expect(unsafe_code, reason = "malloc_trim of the C library")]
mod malloc_trim;
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
mod malloc_trim {
    /// Other allocators return memory by themselves.
    pub(crate) const fn start() {}
}

use std::fmt::Display;
use std::process::ExitCode;

use clap::Parser as _;
use mlswarp_server::cli::{health, warp};
use mlswarp_server::config::{Cli, Command, Config};
use mlswarp_server::http::connection;
use mlswarp_server::observe;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Also help and the version.
            let _ = error.print();
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    let command = cli.command.unwrap_or(Command::Serve);
    let resolved = if matches!(command, Command::Serve) { cli.options.resolve_to_serve() } else { cli.options.resolve() };
    let config = match resolved {
        Ok(config) => config,
        Err(mistakes) => {
            eprintln!("{mistakes}");
            return ExitCode::from(2);
        }
    };
    run(command, config)
}

fn run(command: Command, config: Config) -> ExitCode {
    match command {
        Command::Serve => {
            observe::start(&config.log, config.log_format);
            malloc_trim::start();
            exit(connection::run(config).map_err(|e| format!("error: {e}")))
        }
        Command::Health => exit(health::ask(&config).map_err(|e| format!("error: {e}"))),
        Command::Warp { image, warp, out } => exit(match warp::run(&config, &image, &warp, &out) {
            Ok(summary) => {
                eprintln!("{summary}");
                Ok(())
            }
            Err(problem) => Err(warp::error_message(&problem)),
        }),
    }
}

fn exit(done: Result<(), impl Display>) -> ExitCode {
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
