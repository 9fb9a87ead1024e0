//! Warp objects, image files and landmark files: what the service does with them.

use std::ops::ControlFlow;

use bytes::Bytes;
use mlswarp::PosedWarp;
use mlswarp::Warper;
use mlswarp::geometry::Orientation;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Image, Limits, OutputSpec, PosedMesh, RasterSource, Region, RenderJob, Report, RestMask,
};
use mlswarp_contract::problem::{Code, Problem};
use mlswarp_contract::wire::landmarks::{Choice, LandmarkFiles};
use mlswarp_contract::wire::{DragObject, Reserved, WarningEntry, WarpObject, WarpPatch};
use serde_json::{Value, json};

/// The service's default of `--max-fit-handles`.
const MOST_FIT_HANDLES: u64 = 2000;

/// Memory is not shared with other clients.
fn free(_bytes: u64) -> Result<(), Problem> {
    Ok(())
}

fn object(warp: &[u8]) -> Result<WarpObject, Problem> {
    let (patch, ()) = Reserved::<WarpPatch, _>::parse(warp, free)?.into_parts();
    patch.into_object()
}

/// The output of a warp object, which is all that counts.
pub(crate) fn output(warp: &[u8]) -> Result<OutputSpec, Problem> {
    Ok(object(warp)?.output)
}

/// Handles at rest on an image of a size.
pub(crate) fn plan(warp: &[u8], size: [u32; 2]) -> Result<Warper, Problem> {
    let mut object = object(warp)?;
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
pub(crate) fn warp(file: &[u8], warp: &[u8], region: Option<&[u8]>) -> Result<Vec<u8>, Problem> {
    let limits = Limits::default();
    let mut object = object(warp)?;
    object.posed()?;
    let image = Image::decode(file, &limits.image, &|| false)?;
    let extent = image.extent();
    let region = match region {
        Some(region) => Some(Region::new(
            &mask(region, extent, &limits).map_err(in_region)?,
        )),
        None => None,
    };
    let subject = RasterSource::Image(&image);
    subject.check(&object.output)?;
    object.output.check(extent, &limits)?;
    if object.rest.needs_mask() {
        let threshold = object.rest.mask_threshold.unwrap_or(RestMask::THRESHOLD);
        object.rest.mask = RestMask::of_image(&image, region.as_ref(), threshold, &|| false);
    }
    let rest = object.resolve(None, extent, &limits, MOST_FIT_HANDLES, &|| false)?;
    let pose = rest.pose(object.posed()?)?;
    let posed = PosedMesh::new(&rest, &rest.plan(&|| false)?, &pose, object.folds, &|| {
        false
    })?;
    let posed = match region {
        Some(region) => posed.within(region),
        None => posed,
    };
    let job = RenderJob::new(subject, &posed, &object.output, &limits, &|| false)?;
    let mut written = Vec::new();
    let _ = job.write(0, &(), &mut |bytes| {
        written.push(bytes);
        ControlFlow::Continue(())
    });
    let target = job.target();
    let settled = posed.into_report_on(subject, (&target, &object.output), &|| false)?;
    let head = report(&settled).to_string().into_bytes();
    let length = u32::try_from(head.len()).unwrap_or(u32::MAX).to_le_bytes();
    Ok([&length[..], &head, &written.concat()].concat())
}

fn mask(file: &[u8], extent: Extent, limits: &Limits) -> Result<Image, Problem> {
    let mask = Image::decode(file, &limits.image, &|| false)?;
    let found = mask.extent();
    if found == extent {
        return Ok(mask);
    }
    // In the words of the service.
    let [found, expected] =
        [found, extent].map(|extent| format!("{}x{}", extent.width(), extent.height()));
    let detail = format!(
        "the file has {found} px after EXIF orientation; a layer or region must have the size of \
            the picture, {expected} px"
    );
    Err(Problem::new(Code::BadValue, detail).limit("layer_size", expected, found))
}

/// Adds the name of the part.
fn in_region(mut problem: Problem) -> Problem {
    problem.detail.insert_str(0, "the part `region`: ");
    problem
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
