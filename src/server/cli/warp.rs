//! `mlswarp warp IMAGE WARP.json -o OUT`, `mlswarp warp IMAGE --landmarks FILE -o OUT`: `POST /warp` without a server, with the same parser
//! and the same bytes.

use std::ops::ControlFlow;
use std::path::Path;

use mlswarp::codec::Format;
use mlswarp::warp::{Image, LabelImage, Posed, Region, Report, Subject, Warp};

use super::failure::Failure;
use super::{input, output};
use crate::app::drawable::check_extent;
use crate::config::{Config, WarpArgs, WarpKind};
use crate::problem::Problem;
use crate::wire::landmarks::Landmarks;
use crate::wire::{WarpObject, WarpPatch};
use crate::wire::{canvas_from_text, canvas_text, method_text};

/// Warps one image. The result: what a server sends in response headers.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &WarpArgs) -> Result<String, Failure> {
    let WarpArgs { image, input: handles, region, kind, canvas, out } = args;
    handles.require_one_stdin(&[Some(image), region.as_ref()])?;
    let canvas = canvas.as_deref().map(canvas_from_text).transpose();
    let canvas = canvas.map_err(|expected| Failure::Local(format!("--canvas: {expected}")))?;
    let json = handles.json(config)?;
    let mut patch = WarpPatch::parse(&json)?;
    // The file name takes the place of `Accept`.
    let format = patch.output.format.map_or_else(|| format_of(out), Ok)?;
    output::require_directory(out)?;
    let landmarks = handles.landmarks(config, &json)?;
    if landmarks.is_some() {
        patch.require_no_handles()?;
    }
    let file = input::read("image", image, config.max_body_bytes)?;
    let mut object = patch.into_object()?;
    object.output.format = format;
    object.output.canvas = canvas.unwrap_or(object.output.canvas);
    let mask = region.as_deref().map(|path| input::read("region", path, config.max_body_bytes)).transpose()?;
    input::threads(config)?.install(|| {
        let image_limits = &config.limits().image;
        let region = mask.map(|mask| Image::decode(&mask, image_limits).map(|mask| Region::new(&mask))).transpose()?;
        let (picture, labels);
        let subject = match (kind, &region) {
            (WarpKind::Image, _) => {
                picture = Image::decode(&file, image_limits)?;
                Subject::Image(&picture)
            }
            (WarpKind::Labels, _) => {
                labels = LabelImage::decode(&file, &config.limits())?;
                Subject::Labels(&labels)
            }
            (WarpKind::Coverage, _) => Subject::Coverage(input::extent_of(config, &file)?),
            (WarpKind::Holes, Some(region)) => Subject::Holes(region),
            (WarpKind::Holes, None) => return Err(Failure::Local("--kind holes needs a --region".to_owned())),
        };
        if let Some(region) = &region {
            check_extent(region.extent(), input::extent_of(config, &file)?)?;
        }
        render(config, subject, region.as_ref(), object, landmarks, out)
    })
}

fn render(
    config: &Config,
    subject: Subject<'_>,
    region: Option<&Region>,
    mut object: WarpObject,
    landmarks: Option<Landmarks>,
    out: &Path,
) -> Result<String, Failure> {
    let setup = input::resolve(config, &mut object, landmarks, subject.extent())?;
    let pose = setup.pose(object.posed()?)?;
    subject.check(&object.output)?;
    object.output.check(subject.extent(), &config.limits())?;
    let posed = Posed::new(&setup, &setup.plan(), &pose, object.folds, &|| false)?;
    let posed = match region {
        Some(region) => posed.within(region.clone()),
        None => posed,
    };
    let warp = Warp::new(subject, &posed, &object.output, &config.limits())?;
    output::write(out, |sink| {
        let mut written = Ok(());
        let _ = warp.write(config.work.workers.saturating_sub(1), &(), &mut |bytes| {
            written = sink.put(&bytes);
            if written.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        });
        written
    })?;
    let target = warp.target();
    let Report { warnings, folds, residual, exceeded, .. } = posed.into_report_on(subject, (&target, &object.output), &|| false)?;
    let (width, height) = (target.extent.width(), target.extent.height());
    let canvas = target.canvas.map_or_else(String::new, |canvas| format!(", canvas {}", canvas_text(canvas)));
    let method = if object.is_auto { format!(", method {}", method_text(&object.rest)) } else { String::new() };
    let summary = format!("{width} x {height} px{canvas}{method}, {folds} folded cells, residual {residual:.4} px");
    let summary = if exceeded > 0 { format!("{summary}, {exceeded} cells over the tolerance") } else { summary };
    let warnings = warnings.iter().map(|warning| warning.code());
    Ok(warnings.fold(summary, |summary, warning| format!("{summary}, {warning}")))
}

fn format_of(out: &Path) -> Result<Format, Problem> {
    let (jpeg, tiff) = (Format::Jpeg, Format::Tiff);
    let known = [("png", Format::Png), ("jpg", jpeg), ("jpeg", jpeg), ("webp", Format::WebP), ("tif", tiff), ("tiff", tiff)];
    Ok(output::by_extension(out, &known, "")?.unwrap_or_default())
}
