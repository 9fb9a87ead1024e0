//! `mlswarp points WARP.json [ANNOTATIONS.json] --extent WIDTH,HEIGHT`: `POST /points` without a
//! server.

use std::path::Path;

use serde_json::json;

use super::failure::Failure;
use super::input::{self, Body, Limit};
use super::options;
use super::output;
use super::service::{Service, summary};
use crate::app::points::{self, MappedFile};
use crate::config::{Config, PointsArgs};
use crate::wire::{Cursor, NamedObject, is_geojson};

/// Maps annotations. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &PointsArgs) -> Result<Option<String>, Failure> {
    let PointsArgs {
        inverse,
        extent,
        pose,
        frame,
        out,
        ..
    } = args;
    let (mut input, mut annotations) = (args.input.clone(), args.annotations.clone());
    // With landmarks the warp object may be left out: then the first file is that of the
    // annotations.
    if annotations.is_none()
        && input.landmarks.landmarks.is_some()
        && input
            .warp
            .as_deref()
            .is_some_and(|path| is_of_annotations(config, path))
    {
        annotations = input.warp.take();
    }
    let files = || {
        input
            .files()
            .into_iter()
            .chain([annotations.as_ref(), extent.image.as_ref()])
    };
    input::require_one_stdin(files())?;
    output::require_directory(out)?;
    output::require_other(out, files().flatten())?;
    let annotations = annotations
        .as_deref()
        .map(|path| input::source("annotations", path, Limit::body(config)))
        .transpose()?;
    // A GeoJSON file is mapped into a GeoJSON file.
    let is_geojson = annotations
        .as_ref()
        .is_some_and(|source| is_geojson(&source.json));
    let cursor = if is_geojson {
        Cursor::bare()
    } else {
        Cursor::default()
    };
    let annotations = annotations.map(|source| match is_geojson {
        true => NamedObject {
            json: [b"{\"geojson\":", &source.json[..], b"}"].concat(),
            ..source
        },
        false => source,
    });
    let mut more: Vec<NamedObject> = annotations.into_iter().chain(pose.sources()).collect();
    more.extend(frame.sources()?);
    more.extend(options::source(
        "--inverse",
        "inverse",
        inverse.then_some(json!(true)),
    ));
    let Body { json, merged } = Body::read(config, &input, extent, more)?;
    let service = Service::start(config)?;
    let mapped = service.run(points::once(&service.app, service.client, json, cursor));
    let MappedFile {
        warnings,
        method,
        first,
        mut rest,
        ..
    } = mapped.map_err(|problem| input::located(&merged, problem))?;
    output::write(out, |sink| {
        sink.put(&first)?;
        while let Some(rest) = &mut rest {
            let Some(bytes) = service.next(rest.next())? else {
                break;
            };
            sink.put(&bytes)?;
        }
        sink.end_line()
    })?;
    Ok(summary(method, &warnings))
}

/// Whether the first file is that of the annotations: GeoJSON, or standard input, whose fields
/// count wherever they come from.
fn is_of_annotations(config: &Config, path: &Path) -> bool {
    let source = || input::source("annotations", path, Limit::body(config));
    input::is_stdio(path) || source().is_ok_and(|source| is_geojson(&source.json))
}
