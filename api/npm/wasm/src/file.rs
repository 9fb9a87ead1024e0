//! Warp objects, image files and landmark files: what the service does with them.

use std::sync::Arc;

use bytes::Bytes;
use mlswarp::format::Format;
use mlswarp::geometry::Orientation;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Image, Limits, OutputSpec, Report};
use mlswarp::{Cancel, PosedWarp, Warper};
use mlswarp_contract::file::{MOST_FIT_HANDLES, WarpFiles, read_object, region_of};
use mlswarp_contract::problem::{Code, Problem};
use mlswarp_contract::wire::landmarks::{Choice, LandmarkFiles};
use mlswarp_contract::wire::{DragObject, Reserved, WarningEntry, canvas_text};
use serde_json::{Value, json};

use crate::objects::{self, Outline, bytes};

/// Memory is not shared with other clients.
fn free(_bytes: u64) -> Result<(), Problem> {
    Ok(())
}

/// The output of a warp object, which is all that counts.
pub(crate) fn output(warp: &[u8]) -> Result<OutputSpec, Problem> {
    Ok(read_object(warp)?.output)
}

/// An image that is held, or that of a file, which is let go of.
pub(crate) fn image(number: u32) -> Result<Arc<Image>, Problem> {
    if let Ok(image) = objects::image(number) {
        return Ok(image);
    }
    let image = Image::decode(&bytes(number)?, &Limits::default().image, &|| false)?;
    Ok(Arc::new(image))
}

/// Errors: A mask of another size.
pub(crate) fn outline(image: Arc<Image>, mask: Option<&Image>) -> Result<Outline, Problem> {
    let region = mask.map(|mask| region_of(mask, image.extent()));
    let region = region.transpose()?;
    Ok(Outline { image, region })
}

/// Handles at rest on an image of a size.
pub(crate) fn plan(
    warp: &[u8],
    size: [u32; 2],
    outline: Option<&Outline>,
) -> Result<Warper, Problem> {
    let mut object = read_object(warp)?;
    if let Some(Outline { image, region }) = outline {
        let own = [image.extent().width(), image.extent().height()];
        if own != size {
            let [[w, h], [width, height]] = [own, size];
            let detail = format!("the outline is of {w}x{h} px, and `size` is {width}x{height}");
            return Err(Problem::new(Code::BadValue, detail));
        }
        object.rest.make_mask(image, region.as_ref(), &|| false)?;
    }
    if object.is_auto
        && let Some(extent) = Extent::new(size[0], size[1])
    {
        object.resolve(None, extent, &Limits::default(), MOST_FIT_HANDLES, &|| {
            false
        })?;
    }
    let plan = Warper::builder::<[f64; 2]>(&[])
        .with(|rest| *rest = object.rest)
        .folds(object.folds)
        .build(size)?;
    Ok(plan)
}

/// A pose of `{"q", "strength"?}`.
pub(crate) fn pose(plan: &Warper, json: &[u8]) -> Result<PosedWarp, Problem> {
    let step = Reserved::<DragObject, _>::parse_posed(json, usize::MAX, free)?;
    let pose = step.into_parts().0.pose.onto(None)?;
    Ok(plan.pose_at(&pose.q, pose.strength)?)
}

/// What a pose is like, in the names of `POST /report`.
pub(crate) fn report(report: &Report) -> Value {
    let warnings: Vec<WarningEntry> = report.warnings.iter().map(WarningEntry::from).collect();
    json!({
        "folds": report.folds,
        "mirrored": report.orientation == Orientation::Mirrored,
        "residual": report.residual,
        "exceeded": report.exceeded,
        "warnings": warnings,
    })
}

/// The length of the report, the report, and the file.
pub(crate) fn warp(
    image: &[u8],
    warp: &[u8],
    region: Option<&[u8]>,
    is_gif: bool,
) -> Result<Vec<u8>, Problem> {
    let files = WarpFiles {
        image,
        warp,
        region,
        format: is_gif.then_some(Format::Gif),
    };
    let drawn = files.draw(&Limits::default(), 0, &Cancel::new())?;
    let mut head = report(&drawn.report);
    if let (Some(canvas), Value::Object(members)) = (drawn.canvas, &mut head) {
        members.insert("canvas".to_owned(), Value::String(canvas_text(canvas)));
    }
    let head = head.to_string().into_bytes();
    let length = u32::try_from(head.len()).unwrap_or(u32::MAX).to_le_bytes();
    Ok([&length[..], &head, &drawn.bytes].concat())
}

/// The fields `p`, `q`, `names`, `units`, `format` and `unmatched` of landmark files.
pub(crate) fn landmarks(
    options: &[u8],
    p: Vec<u8>,
    q: Option<Vec<u8>>,
) -> Result<Vec<u8>, Problem> {
    let choice = Choice::of_warp(options)?;
    let files = match q {
        Some(q) => LandmarkFiles {
            p: Some(Bytes::from(p)),
            q: Some(Bytes::from(q)),
            choice,
            ..LandmarkFiles::default()
        },
        None => LandmarkFiles {
            both: Some(Bytes::from(p)),
            choice,
            ..LandmarkFiles::default()
        },
    };
    let columns = Limits::default().columns;
    let (landmarks, ()) = Reserved::of_files(&files, columns, &|| false, free)?.into_parts();
    let placed = landmarks.scale(None)?;
    serde_json::to_vec(&placed)
        .map_err(|error| Problem::new(Code::Internal, format!("no JSON: {error}")))
}
