//! Handles at rest.

use mlswarp::Warper;
use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Folds, Jitter, Limits, Region, RestSpec, WarpError};
use mlswarp_contract::file::read_object;
use mlswarp_contract::problem::{Code, Problem};
use mlswarp_contract::wire::{AsJson, DragObject, PosePatch, Reserved};
use pyo3::prelude::*;

use crate::pool::run;
use crate::pose::Pose;
use crate::values::{Buffer, read_buffer};

/// What computing here may take: there are no other clients. The limits for handles and tables stay
/// those of the service.
pub(crate) fn limits() -> Limits {
    let mut limits = Limits {
        work: 1 << 50,
        ..Limits::default()
    };
    limits.image.max_pixels = 1 << 30;
    limits.image.max_side = 1 << 17;
    limits
}

/// The size of an image.
pub(crate) fn extent_of([width, height]: [u32; 2]) -> Result<Extent, Problem> {
    Extent::try_from([width, height]).map_err(|error| WarpError::from(error).into())
}

/// Handles as a client would write them.
pub(crate) fn handles_text(handles: &[Handle]) -> Result<String, Problem> {
    serde_json::to_string(&AsJson(handles))
        .map_err(|error| crate::error::internal(&error.to_string()))
}

fn no_outline() -> Problem {
    let detail = "the metric `geodesic` and the method `arap` follow the outline of what an image \
        shows: give the plan a mask, or an image with alpha (`like`)";
    Problem::new(Code::NotSupported, detail).pointer("/mask")
}

/// Handles at rest on an image of one size.
#[pyclass(frozen, module = "mlswarp._engine")]
#[derive(Debug)]
pub(crate) struct Plan {
    warper: Warper,
    rest: RestSpec,
}

#[pymethods]
impl Plan {
    /// `warp`: a warp object without a pose, as JSON. `size`: width and height. `image`: of that
    /// size, whose alpha says where it shows something; `mask`: what belongs to its subject.
    #[new]
    #[pyo3(signature = (warp, size, image=None, mask=None))]
    fn new(
        py: Python<'_>,
        warp: &[u8],
        size: [u32; 2],
        image: Option<Buffer<'_>>,
        mask: Option<Buffer<'_>>,
    ) -> PyResult<Self> {
        let (warp, image, mask) = (
            warp.to_vec(),
            read_buffer(py, image)?,
            read_buffer(py, mask)?,
        );
        run(py, move |cancel| {
            let object = read_object(&warp)?;
            if object.is_auto {
                let detail = "the method `auto` needs the pose: compare methods with Plan.fit, and \
                    choose one";
                return Err(Problem::new(Code::BadValue, detail).pointer("/method"));
            }
            let (mut rest, image, mask) = (object.rest, image()?, mask()?);
            if mask.is_some() && !rest.needs_mask() {
                return Err(WarpError::UnusedMask.into());
            }
            // A mask is opaque, as the image is that it belongs to.
            match image.as_ref().or(mask.as_ref()) {
                Some(shown) => {
                    let region = mask.as_ref().map(Region::new);
                    rest.make_mask(shown, region.as_ref(), &|| cancel.is_cancelled())?;
                }
                None if rest.needs_mask() => return Err(no_outline()),
                None => {}
            }
            let of_builder = rest.clone();
            let warper = Warper::builder::<Handle>(&[])
                .with(|rest| *rest = of_builder)
                .limits(limits())
                .cancelled_by(cancel)
                .build(extent_of(size)?)?;
            Ok(Self { warper, rest })
        })
    }

    /// The effective fall-off; `None` of methods that have none.
    #[getter]
    fn alpha(&self) -> Option<f64> {
        self.warper.resolved().alpha()
    }

    /// The handles, as JSON.
    #[getter]
    fn p(&self, py: Python<'_>) -> PyResult<String> {
        let text = handles_text(&self.rest.p);
        text.map_err(|problem| crate::error::exception(py, &problem))
    }

    /// `pose`: `q` and `strength`, as JSON. `folds`: what becomes of them.
    fn pose(&self, py: Python<'_>, pose: &[u8], folds: &str) -> PyResult<Pose> {
        let folds = folds_of(folds);
        let (warper, at_rest, json) = (self.warper.clone(), self.rest.p.len(), pose.to_vec());
        run(py, move |cancel| {
            let (q, strength) = read_pose(&json, at_rest)?.ok_or_else(|| missing(at_rest))?;
            let warper = warper.with_folds(folds)?.cancelled_by(cancel);
            Ok(Pose::new(warper.pose_at(&q, strength)?))
        })
    }

    /// The pose of handles that were aligned and moved to their strength before: `Pose.q`.
    fn settled(&self, py: Python<'_>, pose: &[u8], folds: &str) -> PyResult<Pose> {
        let (warper, at_rest, json) = (self.warper.clone(), self.rest.p.len(), pose.to_vec());
        let folds = folds_of(folds);
        run(py, move |cancel| {
            let (q, _) = read_pose(&json, at_rest)?.ok_or_else(|| missing(at_rest))?;
            let warper = warper.with_folds(folds)?.cancelled_by(cancel);
            Ok(Pose::new(warper.pose_settled(q)?))
        })
    }

    /// A frame of the jitter of a batch. Without `q`, the handles at rest are displaced.
    fn jitter(
        &self,
        py: Python<'_>,
        pose: &[u8],
        seed: u64,
        sigma: f64,
        frame: u32,
    ) -> PyResult<Pose> {
        let (warper, rest, json) = (self.warper.clone(), self.rest.p.clone(), pose.to_vec());
        run(py, move |cancel| {
            let (q, strength) = read_pose(&json, rest.len())?.unwrap_or((rest, 1.0));
            let warper = warper.cancelled_by(cancel);
            let jitter = Jitter { seed, sigma };
            Ok(Pose::new(
                warper.pose_jittered(&q, strength, jitter, frame)?,
            ))
        })
    }
}

fn folds_of(name: &str) -> Folds {
    match name {
        "reject" => Folds::Reject,
        "remove" => Folds::Remove,
        _ => Folds::Report,
    }
}

/// The posed handles and the strength; `None` if there are no handles in the object.
fn read_pose(json: &[u8], at_rest: usize) -> Result<Option<(Vec<Handle>, f64)>, Problem> {
    let object = Reserved::<DragObject, ()>::parse_posed(json, at_rest, |_| Ok(()))?;
    let PosePatch { q, strength } = object.into_parts().0.pose;
    Ok(q.map(|q| (q, strength.unwrap_or(1.0))))
}

fn missing(at_rest: usize) -> Problem {
    let detail = format!("`q` is missing: where do the {at_rest} handles go?");
    Problem::new(Code::BadValue, detail).pointer("/q")
}
