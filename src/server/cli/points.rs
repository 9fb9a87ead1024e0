//! `mlswarp points WARP.json [ANNOTATIONS.json] --extent WIDTH,HEIGHT`: `POST /points` without a server.

use super::failure::Failure;
use super::input;
use super::output;
use super::service::{Service, summary};
use crate::app::points::MappedFile;
use crate::config::{Config, PointsArgs};
use crate::wire::{Cursor, is_geojson, merged};

/// Maps annotations. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &PointsArgs) -> Result<Option<String>, Failure> {
    let PointsArgs { input, annotations, inverse, extent, out } = args;
    input.require_one_stdin(&[annotations.as_ref(), extent.image.as_ref()])?;
    output::require_directory(out)?;
    let read = |path| input::read("annotations", path, config.max_body_bytes);
    let annotations = annotations.as_deref().map(read).transpose()?.unwrap_or_else(|| b"{}".to_vec());
    // A GeoJSON file is mapped into a GeoJSON file.
    let (annotations, cursor) = if is_geojson(&annotations) {
        ([b"{\"geojson\":", &annotations[..], b"}"].concat(), Cursor::bare())
    } else {
        (annotations, Cursor::default())
    };
    let more = if *inverse { merged(&[&annotations, b"{\"inverse\":true}"])? } else { annotations };
    let body = input::body(config, input, extent, Some(&more))?;
    drop(more);
    let service = Service::start(config)?;
    let mapped = service.wait(service.app.points_once(service.client, body, cursor))?;
    let MappedFile { warnings, method, first, mut rest, .. } = mapped;
    output::write(out, |sink| {
        sink.put(&first)?;
        while let Some(rest) = &mut rest {
            let Some(bytes) = service.next(rest.next())? else { break };
            sink.put(&bytes)?;
        }
        sink.end_line()
    })?;
    Ok(summary(method, &warnings))
}
