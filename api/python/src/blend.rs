//! Blends of arrays, as those of `POST /blend`.

use std::sync::Arc;

use mlswarp_contract::blend::Blend as Job;
use mlswarp_contract::problem::Problem;
use pyo3::prelude::*;

use crate::error::internal;
use crate::plan::{handles_text, limits};
use crate::pool::run;
use crate::values::{Buffer, Values, read_image};

/// Images with landmarks, and how they are added: the frames of a blend.
#[pyclass(frozen, module = "mlswarp._engine")]
#[derive(Debug)]
pub(crate) struct Blend {
    job: Arc<Job>,
}

#[pymethods]
impl Blend {
    /// `images`: buffers with their height, width and samples; `blend`: the object of
    /// `POST /blend`, in which every image has its number and its handles.
    #[new]
    fn new(py: Python<'_>, images: Vec<Buffer<'_>>, blend: &[u8]) -> PyResult<Self> {
        let images = images
            .iter()
            .map(|(buffer, shape)| read_image(py, buffer, *shape));
        let images = images.collect::<PyResult<Vec<_>>>()?;
        let blend = blend.to_vec();
        let job = run(py, move |_| {
            let images = images.into_iter().map(|image| image().map(Arc::new));
            Job::new(images.collect::<Result<_, Problem>>()?, &blend, limits())
        })?;
        Ok(Self { job: Arc::new(job) })
    }

    /// How many results there are.
    #[getter]
    fn frames(&self) -> usize {
        self.job.frames()
    }

    /// One result: its pixels, the landmarks and the figures as JSON.
    fn frame(&self, py: Python<'_>, frame: usize) -> PyResult<(Values, String, String)> {
        let job = Arc::clone(&self.job);
        run(py, move |cancel| {
            let made = job.frame(frame, cancel)?;
            let report = serde_json::to_string(&made.report);
            Ok((
                Values::of_pixels(made.image.to_pixels()),
                handles_text(&made.landmarks)?,
                report.map_err(|error| internal(&error.to_string()))?,
            ))
        })
    }
}
