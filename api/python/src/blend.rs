//! Blends of arrays, as those of `POST /blend`.

use std::sync::{Arc, Mutex, PoisonError};

use mlswarp::render::Canvas;
use mlswarp::warp::blend::ImageSum;
use mlswarp::warp::{RasterSource, Target, WarpError};
use mlswarp::{Cancel, Image, Warper};
use mlswarp_contract::problem::{Code, Problem};
use mlswarp_contract::wire::blend::{
    AlignedShapes, BlendObject, BlendReport, BlendSource, NamedShape,
};
use mlswarp_contract::wire::{AsJson, Reserved};
use pyo3::prelude::*;

use crate::error::internal;
use crate::plan::limits;
use crate::pool::run;
use crate::values::{Values, read_image};

/// Images with landmarks, and how they are added: the frames of a blend.
#[pyclass(frozen, module = "mlswarp._engine")]
#[derive(Debug)]
pub(crate) struct Blend {
    job: Arc<Job>,
}

#[derive(Debug)]
struct Job {
    object: BlendObject,
    /// In the order in which they are added.
    images: Vec<Arc<Image>>,
    aligned: AlignedShapes,
    canvas: Canvas,
    target: Target,
    /// Of each image, once a frame has needed it.
    warpers: Mutex<Vec<Option<Warper>>>,
}

#[pymethods]
impl Blend {
    /// `images`: buffers with their height, width and samples; `blend`: the object of
    /// `POST /blend`, in which every image has its number and its handles.
    #[new]
    fn new(
        py: Python<'_>,
        images: Vec<(Bound<'_, PyAny>, (u32, u32, usize))>,
        blend: &[u8],
    ) -> PyResult<Self> {
        let images = images
            .iter()
            .map(|(buffer, shape)| read_image(py, buffer, *shape));
        let images = images.collect::<PyResult<Vec<_>>>()?;
        let blend = blend.to_vec();
        let job = run(py, move |_| {
            let read: Result<Vec<_>, Problem> = images.into_iter().map(|image| image()).collect();
            Job::new(read?, &blend)
        })?;
        Ok(Self { job: Arc::new(job) })
    }

    /// How many results there are.
    #[getter]
    fn frames(&self) -> usize {
        self.job.object.frames
    }

    /// One result: its pixels, the landmarks and the figures as JSON.
    fn frame(&self, py: Python<'_>, frame: usize) -> PyResult<(Values, String, String)> {
        let job = Arc::clone(&self.job);
        run(py, move |cancel| job.frame(frame, cancel))
    }
}

impl Job {
    fn new(files: Vec<Image>, blend: &[u8]) -> Result<Self, Problem> {
        let object = Reserved::<BlendObject, ()>::parse(blend, |_| Ok(()))?
            .into_parts()
            .0;
        let files: Vec<Arc<Image>> = files.into_iter().map(Arc::new).collect();
        let (mut images, mut shapes) = (Vec::new(), Vec::new());
        for (index, entry) in object.images.iter().enumerate() {
            let image = match entry.source {
                BlendSource::Part(number) => files.get(number),
                BlendSource::Session(_) => None,
            };
            let (Some(image), Some(p)) = (image, &entry.p) else {
                let detail = format!(
                    "expected the number of one of {} images, and its handles",
                    files.len()
                );
                let pointer = format!("/images/{index}");
                return Err(Problem::new(Code::BadValue, detail).pointer(pointer));
            };
            images.push(Arc::clone(image));
            shapes.push(NamedShape {
                p: p.clone(),
                names: entry.names.clone(),
            });
        }
        let first = images[0].extent();
        let aligned = AlignedShapes::new(&object, shapes, first.width())?;
        let (canvas, target) = object.target(first, &limits())?;
        for image in &images {
            RasterSource::Image(image).check(&object.output)?;
        }
        let warpers = Mutex::new(vec![None; images.len()]);
        Ok(Self {
            object,
            images,
            aligned,
            canvas,
            target,
            warpers,
        })
    }

    /// The coefficients of an image, made once.
    fn warper(&self, index: usize, cancel: &Cancel) -> Result<Warper, Problem> {
        let known = || self.warpers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(warper) = &known()[index] {
            return Ok(warper.clone().cancelled_by(cancel));
        }
        let (rest, p) = (self.object.rest.clone(), self.aligned.p[index].clone());
        let warper = Warper::builder::<mlswarp::deform::Handle>(&[])
            .with(|spec| *spec = mlswarp::warp::RestSpec { p, ..rest })
            .limits(limits())
            .cancelled_by(cancel)
            .build(self.images[index].extent())?;
        if self.object.frames > 1 {
            known()[index] = Some(warper.clone());
        }
        Ok(warper)
    }

    fn frame(&self, frame: usize, cancel: &Cancel) -> Result<(Values, String, String), Problem> {
        if frame >= self.object.frames {
            return Err(internal("there is no such frame"));
        }
        let is_cancelled = || cancel.is_cancelled();
        let (shape, colour) = (
            self.object.shape_weights(frame),
            self.object.colour_weights(frame),
        );
        let target = self.aligned.blended.target(&shape);
        let (extent, space) = (self.target.extent, self.object.space);
        let mut sum = ImageSum::new(self.canvas, extent, space, &colour);
        let width = self.images[0].extent().width();
        let mut folds = vec![0; self.images.len()];
        for (index, image) in self.images.iter().enumerate() {
            // An image that adds no colour is needed only for the kind of the result.
            if colour[index] == 0.0 && index > 0 {
                continue;
            }
            let pairs = self.aligned.pairs[index].as_ref();
            let drawn = match pairs {
                Some(pairs) => &pairs.mirrored(&target, f64::from(width)),
                None => &target,
            };
            let q = self.aligned.blended.posed(index, drawn);
            let warper = self.warper(index, cancel).map_err(|p| in_image(index, p))?;
            let posed = warper.pose_settled(q);
            let posed = posed.map_err(|error| in_image(index, error.into()))?;
            let how = (colour[index], pairs.map(|_| width));
            let output = &self.object.output;
            sum.add(image, posed.posed_mesh(), how, output, &is_cancelled)?;
            folds[index] = posed.report().folds;
        }
        let blended = sum.finish(&is_cancelled)?.ok_or(WarpError::Cancelled)?;
        let report = BlendReport {
            picture: String::new(),
            shape,
            colour,
            clamped: blended.clamped,
            folds,
            width: extent.width(),
            height: extent.height(),
            canvas: AsJson(self.canvas),
            landmarks: self.aligned.blended.kept().to_vec(),
        };
        let text = |json: serde_json::Result<String>| json.map_err(|e| internal(&e.to_string()));
        Ok((
            Values::of_pixels(blended.image.to_pixels()),
            text(serde_json::to_string(&AsJson(&target[..])))?,
            text(serde_json::to_string(&report))?,
        ))
    }
}

/// Names the image in a problem of its handles.
fn in_image(index: usize, mut problem: Problem) -> Problem {
    problem.detail = format!("image {index}: {}", problem.detail);
    problem.pointer = Some(format!("/images/{index}"));
    problem
}
