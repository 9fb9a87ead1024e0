//! Files as they are: an image and a warp object to the image file that the service would send,
//! landmark files, and the comparison of methods.

use std::ops::ControlFlow;

use bytes::Bytes;
use mlswarp::Cancel;
use mlswarp::warp::{
    Image, ImageLimits, PosedMesh, RasterSource, Region, RenderJob, RestMask, Stage, WarpError,
    WriteObserver, check_comparison,
};
use mlswarp_contract::problem::{Code, Problem};
use mlswarp_contract::wire::landmarks::{Choice, LandmarkFiles, Landmarks};
use mlswarp_contract::wire::{FitAnswer, FitObject, Reserved, predictions};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::error::internal;
use crate::plan::{extent_of, limits, read_object};
use crate::pool::run;

/// The most handles on which methods are compared: the time grows with its cube.
const MOST_FIT_HANDLES: u64 = 2000;

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

/// The bytes of `POST /warp`. `region`: the file of a mask.
fn draw(
    file: &[u8],
    warp: &[u8],
    region: Option<&[u8]>,
    cancel: &Cancel,
) -> Result<Vec<u8>, Problem> {
    let (limits, is_cancelled) = (limits(), || cancel.is_cancelled());
    let mut object = read_object(warp)?;
    let _ = object.posed()?;
    let image = Image::decode(file, &limits.image, &is_cancelled)?;
    let extent = image.extent();
    let region = match region {
        Some(file) => Some(read_region(file, &image, &limits.image, cancel)?),
        None => None,
    };
    let subject = RasterSource::Image(&image);
    subject.check(&object.output)?;
    object.output.check(extent, &limits)?;
    if object.rest.needs_mask() {
        let threshold = object.rest.mask_threshold.unwrap_or(RestMask::THRESHOLD);
        let mask = RestMask::of_image(&image, region.as_ref(), threshold, &is_cancelled);
        object.rest.mask = mask;
    }
    let setup = object.resolve(None, extent, &limits, MOST_FIT_HANDLES, &is_cancelled)?;
    let pose = setup.pose(object.posed()?)?;
    let plan = setup.plan(&is_cancelled)?;
    let posed = PosedMesh::new(&setup, &plan, &pose, object.folds, &is_cancelled)?;
    let posed = region.into_iter().fold(posed, PosedMesh::within);
    let job = RenderJob::new(subject, &posed, &object.output, &limits, &is_cancelled)?;
    let mut out = Vec::new();
    let helpers = rayon::current_num_threads() - 1;
    let written = job.write(helpers, &Watch(cancel), &mut |bytes| {
        out.extend(bytes);
        ControlFlow::Continue(())
    });
    match written {
        ControlFlow::Continue(()) => Ok(out),
        ControlFlow::Break(()) => Err(WarpError::Cancelled.into()),
    }
}

fn read_region(
    file: &[u8],
    image: &Image,
    limits: &ImageLimits,
    cancel: &Cancel,
) -> Result<Region, Problem> {
    let in_region = |mut problem: Problem| {
        problem.detail.insert_str(0, "`region`: ");
        problem
    };
    let mask = Image::decode(file, limits, &|| cancel.is_cancelled());
    let mask = mask.map_err(|error| in_region(error.into()))?;
    let (expected, actual) = (image.extent(), mask.extent());
    if expected == actual {
        return Ok(Region::new(&mask));
    }
    Err(in_region(WarpError::OtherSize { expected, actual }.into()))
}

/// Draws an image file as `POST /warp` does.
#[pyfunction]
#[pyo3(signature = (image, warp, region=None))]
pub(crate) fn warp_file<'py>(
    py: Python<'py>,
    image: &[u8],
    warp: &[u8],
    region: Option<&[u8]>,
) -> PyResult<Bound<'py, PyBytes>> {
    let (image, warp, region) = (image.to_vec(), warp.to_vec(), region.map(<[u8]>::to_vec));
    let file = run(py, move |cancel| {
        draw(&image, &warp, region.as_deref(), cancel)
    })?;
    Ok(PyBytes::new(py, &file))
}

/// Reads landmark files: one of both sides or of one, or one for each side. `size`: of the image.
/// The result: JSON as that of `POST /landmarks`.
#[pyfunction]
#[pyo3(signature = (p, q, size, sizes, matching, item))]
pub(crate) fn read_landmarks(
    py: Python<'_>,
    p: &[u8],
    q: Option<&[u8]>,
    size: Option<[u32; 2]>,
    sizes: [Option<[u32; 2]>; 2],
    matching: Option<&str>,
    item: Option<&str>,
) -> PyResult<String> {
    let file = |bytes: &[u8]| Some(Bytes::copy_from_slice(bytes));
    let mut files = match q {
        Some(q) => LandmarkFiles {
            p: file(p),
            q: file(q),
            ..LandmarkFiles::default()
        },
        None => LandmarkFiles {
            both: file(p),
            ..LandmarkFiles::default()
        },
    };
    let chosen = [("match", matching), ("item", item)]
        .map(|(name, text)| text.map(|text| (name, text.to_owned())));
    run(py, move |cancel| {
        let mut choice = Choice::default();
        for (name, text) in chosen.iter().flatten() {
            choice.add_text(name, text)?;
        }
        files.choice = choice;
        [files.extent_p, files.extent_q] = [
            sizes[0].map(extent_of).transpose()?,
            sizes[1].map(extent_of).transpose()?,
        ];
        let is_cancelled = || cancel.is_cancelled();
        let most = limits().columns;
        let read = Reserved::<Landmarks, ()>::of_files(&files, most, &is_cancelled, |_| Ok(()))?;
        let placed = read
            .into_parts()
            .0
            .scale(size.map(extent_of).transpose()?)?;
        serde_json::to_string(&placed).map_err(|error| internal(&error.to_string()))
    })
}

/// Compares methods as `POST /fit` does: its request and response.
#[pyfunction]
pub(crate) fn compare_methods(py: Python<'_>, request: &[u8]) -> PyResult<String> {
    let request = request.to_vec();
    run(py, move |cancel| {
        let object = Reserved::<FitObject, ()>::parse(&request, |_| Ok(()))?;
        let FitObject {
            rest,
            pose,
            candidates,
        } = object.into_parts().0;
        let no_points = || Problem::new(Code::Internal, "a fit without points");
        let (rest, extent) = rest.ok_or_else(no_points)?;
        let (q, _) = rest.posed(pose.onto(None)?.q, 1.0, extent);
        check_comparison(rest.p.len(), &candidates, &limits())?;
        let is_cancelled = || cancel.is_cancelled();
        let found = predictions(
            &rest,
            &q,
            extent,
            &candidates,
            MOST_FIT_HANDLES,
            &is_cancelled,
        )?;
        serde_json::to_string(&FitAnswer(&found)).map_err(|error| internal(&error.to_string()))
    })
}
