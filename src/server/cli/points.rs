//! `mlswarp points WARP.json [ANNOTATIONS.json] --extent WIDTH,HEIGHT`: `POST /points` without a server.

use super::failure::Failure;
use super::input;
use super::output;
use super::service::{Service, summary};
use crate::config::{Config, PointsArgs};

/// Maps annotations. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &PointsArgs) -> Result<Option<String>, Failure> {
    let PointsArgs { input, annotations, extent, out } = args;
    input.require_one_stdin(&[annotations.as_ref(), extent.image.as_ref()])?;
    output::require_directory(out)?;
    let annotations = annotations.as_deref().map(|path| input::read("annotations", path, config.max_warp_json_bytes)).transpose()?;
    let body = input::body(config, input, extent, annotations.as_deref())?;
    let service = Service::start(config)?;
    let ((json, warnings), method) = service.wait(service.app.points_once(service.client, body))?;
    output::write_text(out, &json)?;
    Ok(summary(method, &warnings))
}
