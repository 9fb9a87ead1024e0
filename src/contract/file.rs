//! An image file as `POST /warp` draws it, without a service. The packages for Python and
//! JavaScript share it.

use std::ops::ControlFlow;

use mlswarp::Cancel;
use mlswarp::format::Format;
use mlswarp::pixmap::Extent;
use mlswarp::render::Canvas;
use mlswarp::warp::{
    Image, Limits, PosedMesh, RasterSource, Region, RenderJob, Report, Stage, WarpError,
    WriteObserver,
};

use crate::layer::check_extent;
use crate::problem::Problem;
use crate::wire::{Reserved, WarpObject, WarpPatch};

/// The most handles on which methods are compared, unless a service is configured otherwise: the
/// time grows with its cube.
pub const MOST_FIT_HANDLES: u64 = 2000;

/// Reads a warp object in memory that is not shared with other clients.
/// Errors: A field that the contract does not have, or with another value.
pub fn read_object(json: &[u8]) -> Result<WarpObject, Problem> {
    let patch = Reserved::<WarpPatch, ()>::parse(json, |_| Ok(()))?;
    patch.into_parts().0.into_object()
}

/// The parts of a request for `POST /warp`.
#[derive(Clone, Copy, Debug)]
pub struct WarpFiles<'a> {
    /// The image file.
    pub image: &'a [u8],
    /// The warp object.
    pub warp: &'a [u8],
    /// The file of a mask: only what is white in it moves.
    pub region: Option<&'a [u8]>,
    /// The format of the result, if it is a frame of an animation.
    pub format: Option<Format>,
}

/// What the service sends.
#[derive(Clone, Debug)]
pub struct DrawnFile {
    /// The file.
    pub bytes: Vec<u8>,
    /// What it says in headers.
    pub report: Report,
    /// The part of the posed plane that it shows, if that is not the box of the source.
    pub canvas: Option<Canvas>,
}

impl WarpFiles<'_> {
    /// What the service sends. `helpers`: threads beside the calling one. Errors: Those of the
    /// service; cancelled.
    pub fn draw(
        &self,
        limits: &Limits,
        helpers: usize,
        cancel: &Cancel,
    ) -> Result<DrawnFile, Problem> {
        let is_cancelled = || cancel.is_cancelled();
        let mut object = read_object(self.warp)?;
        object.posed()?;
        object.output.format = self.format.unwrap_or(object.output.format);
        let image = Image::decode(self.image, &limits.image, &is_cancelled)?;
        let extent = image.extent();
        let region = self
            .region
            .map(|file| read_region(file, extent, limits, cancel))
            .transpose()?;
        let subject = RasterSource::Image(&image);
        subject.check(&object.output)?;
        object.output.check(extent, limits)?;
        object
            .rest
            .make_mask(&image, region.as_ref(), &is_cancelled)?;
        let setup = object.resolve(None, extent, limits, MOST_FIT_HANDLES, &is_cancelled)?;
        let pose = setup.pose(object.posed()?)?;
        let plan = setup.plan(&is_cancelled)?;
        let posed = PosedMesh::new(&setup, &plan, &pose, object.folds, &is_cancelled)?;
        let posed = region.into_iter().fold(posed, PosedMesh::within);
        let job = RenderJob::new(subject, &posed, &object.output, limits, &is_cancelled)?;
        let mut bytes = Vec::new();
        let written = job.write(helpers, &Watch(cancel), &mut |more| {
            bytes.extend(more);
            ControlFlow::Continue(())
        });
        if written.is_break() {
            return Err(WarpError::Cancelled.into());
        }
        let target = job.target();
        let report = posed.into_report_on(subject, (&target, &object.output), &is_cancelled)?;
        Ok(DrawnFile {
            bytes,
            report,
            canvas: target.canvas,
        })
    }
}

/// Ends a drawing.
struct Watch<'a>(&'a Cancel);

impl WriteObserver for Watch<'_> {
    fn around(&self, _stage: Stage, work: &mut dyn FnMut()) {
        work();
    }

    fn is_wanted(&self) -> bool {
        !self.0.is_cancelled()
    }
}

/// Errors: No image, or one of another size.
fn read_region(
    file: &[u8],
    expected: Extent,
    limits: &Limits,
    cancel: &Cancel,
) -> Result<Region, Problem> {
    let mask = Image::decode(file, &limits.image, &|| cancel.is_cancelled());
    let mask = mask.map_err(|error| in_part_region(error.into()))?;
    region_of(&mask, expected)
}

/// The region of a mask.
/// Errors: A mask of another size.
pub fn region_of(mask: &Image, expected: Extent) -> Result<Region, Problem> {
    check_extent(mask.extent(), expected).map_err(in_part_region)?;
    Ok(Region::new(mask))
}

/// Adds the name of the part.
pub fn in_part_region(mut problem: Problem) -> Problem {
    problem.detail.insert_str(0, "the part `region`: ");
    problem
}
