//! `mlswarp report WARP.json --extent WIDTH,HEIGHT`: `POST /report` without a server.

use super::failure::Failure;
use super::input;
use super::output;
use super::service::{Service, summary};
use crate::config::{Config, ReportArgs};

/// Measures a pose. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &ReportArgs) -> Result<Option<String>, Failure> {
    let ReportArgs { input, extent, out } = args;
    input.require_one_stdin(&[extent.image.as_ref()])?;
    output::require_directory(out)?;
    let body = input::body(config, input, extent, None)?;
    let service = Service::start(config)?;
    let (report, method) = service.wait(service.app.report_once(service.client, body))?;
    output::write_text(out, &report.body)?;
    Ok(summary(method, &report.report.warnings))
}
