//! The program: `mlswarp` serves, `mlswarp health` asks a running server, and the other subcommands
//! do the work of a route offline. Exit codes: 0 success, 1 failure, 2 a wrong command line or
//! environment.

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[expect(unsafe_code, reason = "calls of the C library")]
mod malloc_trim;

use std::process::ExitCode;

use mlswarp_server::cli::{batch, blend, fit, health, map, points, report, warp};
use mlswarp_server::config::{Cli, Command, unknown_variables};
use mlswarp_server::http::connection;
use mlswarp_server::observe;

fn main() -> ExitCode {
    let Cli { command, config } = match Cli::read(std::env::args_os()) {
        Ok(cli) => cli,
        Err(error) => {
            // Also the texts of `--help` and `--version`. A failure to print cannot be reported.
            let _ = error.print();
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    let (command, unknown) = (command.unwrap_or(Command::Serve), unknown_variables());
    if !matches!(command, Command::Serve | Command::Health) {
        unknown
            .iter()
            .for_each(|sentence| eprintln!("warning: {sentence}"));
    }
    let done = match command {
        Command::Serve => {
            observe::start(&config.telemetry.log, config.telemetry.log_format);
            unknown
                .iter()
                .for_each(|sentence| tracing::warn!("{sentence}"));
            #[cfg(all(target_os = "linux", target_env = "gnu"))]
            malloc_trim::start();
            connection::run(config).map_err(|e| format!("error: {e}"))
        }
        Command::Health => health::ask(&config).map_err(|e| format!("error: {e}")),
        Command::Warp(args) => warp::run(&config, &args)
            .map(Some)
            .map_err(|e| e.to_string())
            .map(print),
        Command::Batch(args) => batch::run(&config, &args)
            .map_err(|e| e.to_string())
            .map(print),
        Command::Blend(args) => blend::run(&config, &args)
            .map_err(|e| e.to_string())
            .map(print),
        Command::Map(args) => map::run(&config, &args)
            .map_err(|e| e.to_string())
            .map(print),
        Command::Report(args) => report::run(&config, &args)
            .map_err(|e| e.to_string())
            .map(print),
        Command::Fit(args) => fit::run(&config, &args)
            .map_err(|e| e.to_string())
            .map(print),
        Command::Points(args) => points::run(&config, &args)
            .map_err(|e| e.to_string())
            .map(print),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// Prints what a server would send in response headers.
fn print(summary: Option<String>) {
    if let Some(summary) = summary {
        eprintln!("{summary}");
    }
}
