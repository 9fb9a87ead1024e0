//! `mlswarp map WARP.json --extent WIDTH,HEIGHT -o OUT.npy`: `POST /map` without a server.

use mlswarp::warp::MapFormat;
use serde_json::json;

use super::failure::Failure;
use super::input;
use super::output;
use super::service::{Service, summary};
use crate::config::{Config, MapArgs};

/// Writes a coordinate map. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &MapArgs) -> Result<Option<String>, Failure> {
    let MapArgs { input, extent, direction, out } = args;
    input.require_one_stdin(&[extent.image.as_ref()])?;
    let known = [("npy", MapFormat::Npy), ("tif", MapFormat::Tiff), ("tiff", MapFormat::Tiff)];
    let format = output::by_extension(out, &known, "")?.unwrap_or_default();
    output::require_directory(out)?;
    let direction = direction.as_ref().map(|direction| json!({"direction": direction}).to_string().into_bytes());
    let body = input::body(config, input, extent, direction.as_deref())?;
    let service = Service::start(config)?;
    let (mut map, method) = service.wait(service.app.map_once(service.client, body, format))?;
    output::write(out, |sink| {
        sink.put(&map.first)?;
        while let Some(bytes) = service.next(map.rest.next())? {
            sink.put(&bytes)?;
        }
        Ok(())
    })?;
    Ok(summary(method, &map.report.warnings))
}
