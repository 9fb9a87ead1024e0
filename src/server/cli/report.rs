//! `mlswarp report WARP.json --extent WIDTH,HEIGHT`: `POST /report` without a server.

use super::failure::Failure;
use super::input::{self, Body, require_one_stdin};
use super::options::of_report;
use super::output;
use super::service::{Service, summary};
use crate::app::report;
use crate::config::{Config, ReportArgs};

/// Measures a pose. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &ReportArgs) -> Result<Option<String>, Failure> {
    let ReportArgs {
        input,
        extent,
        pose,
        canvas,
        out,
    } = args;
    let files = || input.files().into_iter().chain([extent.image.as_ref()]);
    require_one_stdin(files())?;
    output::require_directory(out)?;
    output::require_other(out, files().flatten())?;
    let mut more = pose.sources();
    more.extend(of_report(canvas.as_ref())?);
    let Body { json, merged } = Body::read(config, input, extent, more)?;
    let service = Service::start(config)?;
    let measured = service.run(report::once(&service.app, service.client, json));
    let (report, method) = measured.map_err(|problem| input::located(&merged, problem))?;
    output::write_text(out, &report.body)?;
    Ok(summary(method, &report.report.warnings))
}
