//! `mlswarp map WARP.json --extent WIDTH,HEIGHT -o OUT.npy`: `POST /map` without a server.

use mlswarp::warp::MapFormat;
use serde_json::json;

use super::failure::Failure;
use super::input::{self, Body, require_one_stdin};
use super::options::source;
use super::output;
use super::service::{Service, summary};
use crate::app::map;
use crate::config::{Config, MapArgs};

/// Writes a coordinate map. The result: what a server sends in response headers, if there is any of
/// it. Errors: See [`Failure`].
pub fn run(config: &Config, args: &MapArgs) -> Result<Option<String>, Failure> {
    let MapArgs {
        input,
        extent,
        direction,
        pose,
        frame,
        out,
    } = args;
    let files = || input.files().into_iter().chain([extent.image.as_ref()]);
    require_one_stdin(files())?;
    let known = [
        ("npy", MapFormat::Npy),
        ("tif", MapFormat::Tiff),
        ("tiff", MapFormat::Tiff),
    ];
    let format = output::by_extension(out, &known, "")?.unwrap_or_default();
    output::require_directory(out)?;
    output::require_other(out, files().flatten())?;
    let mut more = pose.sources();
    more.extend(frame.of_map()?);
    more.extend(source(
        "--direction",
        "direction",
        direction.as_ref().map(|direction| json!(direction)),
    ));
    let Body { json, merged } = Body::read(config, input, extent, more)?;
    let service = Service::start(config)?;
    let made = service.run(map::once(&service.app, service.client, json, format));
    let (mut map, method) = made.map_err(|problem| input::located(&merged, problem))?;
    output::write(out, |sink| {
        sink.put(&map.first)?;
        while let Some(bytes) = service.next(map.rest.next())? {
            sink.put(&bytes)?;
        }
        Ok(())
    })?;
    Ok(summary(method, &map.report.warnings))
}
