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

use std::fmt::Display;
use std::process::ExitCode;

use mlswarp_server::cli::{health, warp};
use mlswarp_server::config::{ArgsError, Cli, Command, Config};
use mlswarp_server::http::connection;
use mlswarp_server::observe;

fn main() -> ExitCode {
    match Cli::read(std::env::args_os()) {
        Ok(cli) => run(cli.command.unwrap_or(Command::Serve), cli.config),
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

fn run(command: Command, config: Config) -> ExitCode {
    match command {
        Command::Serve => {
            observe::start(&config.telemetry.log, config.telemetry.log_format);
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
