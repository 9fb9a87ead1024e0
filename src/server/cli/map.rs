//! `mlswarp map WARP.json --extent WIDTH,HEIGHT -o OUT.npy`: `POST /map` without a server.

use std::path::Path;

use mlswarp::warp::MapFormat;
use serde_json::json;

use super::failure::Failure;
use super::input::Body;
use super::output;
use super::service::{Service, summary};
use crate::config::{Config, MapArgs};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};

/// Writes a coordinate map. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &MapArgs) -> Result<Option<String>, Failure> {
    let MapArgs { input, extent, direction, out } = args;
    input.require_one_stdin(&[extent.image.as_ref()])?;
    let format = format_of(out)?;
    output::require_directory(out)?;
    let direction = direction.as_ref().map(|direction| json!({"direction": direction}).to_string().into_bytes());
    let body = Body::read(config, input, extent, direction.as_deref())?;
    let service = Service::start(config)?;
    let (mut map, method) = service.wait(service.app.coordinate_map_once(service.client, body.json.clone(), format))?;
    output::write(out, |sink| {
        sink.put(&map.first)?;
        while let Some(bytes) = service.next(map.rest.next())? {
            sink.put(&bytes)?;
        }
        Ok(())
    })?;
    Ok(summary(method, &map.report.warnings, body.has_unmatched))
}

fn format_of(out: &Path) -> Result<MapFormat, Problem> {
    let Some(extension) = out.extension() else { return Ok(MapFormat::default()) };
    match extension.to_string_lossy().to_ascii_lowercase().as_str() {
        "npy" => Ok(MapFormat::Npy),
        "tif" | "tiff" => Ok(MapFormat::Tiff),
        other => {
            let extension = quote(&format!(".{other}"));
            let detail = format!("cannot write {out:?}: {extension} is not supported; supported: .npy, .tif, .tiff");
            Err(Problem::new(Code::UnsupportedFormat, detail))
        }
    }
}
