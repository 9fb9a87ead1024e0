//! One pose, and everything that follows from it.

use std::time::Instant;

use bytes::Bytes;
use mlswarp::PosedWarp;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{CoordinateFrame, MapDirection, OutputSpec, Units, WarpError};
use mlswarp_contract::file::read_object;
use mlswarp_contract::problem::Problem;
use mlswarp_contract::wire::{Cursor, PointsObject, ReportAnswer, Reserved, WarningEntry};
use pyo3::prelude::*;

use crate::error::{exception, internal};
use crate::plan::handles_text;
use crate::pool::run;
use crate::values::{Buffer, Values, read_buffer, read_image, read_labels, read_positions};

/// The mesh of one pose.
#[pyclass(frozen, module = "mlswarp._engine")]
#[derive(Debug)]
pub(crate) struct Pose {
    posed: PosedWarp,
}

impl Pose {
    pub(crate) const fn new(posed: PosedWarp) -> Self {
        Self { posed }
    }

    fn extent(&self) -> Extent {
        self.posed.warper().extent()
    }
}

#[pymethods]
impl Pose {
    /// The posed handles, as JSON.
    #[getter]
    fn q(&self, py: Python<'_>) -> PyResult<String> {
        handles_text(self.posed.q()).map_err(|problem| exception(py, &problem))
    }

    /// The cells that fold.
    #[getter]
    fn folds(&self) -> u64 {
        self.posed.report().folds
    }

    /// The largest distance of a posed handle from where it is drawn, px.
    #[getter]
    fn residual(&self) -> Option<f64> {
        let residual = self.posed.report().residual;
        residual.is_finite().then_some(residual)
    }

    /// The codes of warnings.
    #[getter]
    fn warnings(&self) -> Vec<&'static str> {
        let warnings = self.posed.report().warnings.iter();
        warnings.map(|warning| warning.code()).collect()
    }

    /// Draws an image. `shape`: height, width, samples. `output`: a warp object with that alone.
    /// `region`: a mask of the same height and width with its number of samples. Second: the
    /// seconds of the work in the engine; what Python adds is the rest.
    #[pyo3(signature = (image, shape, output, region=None))]
    fn warp(
        &self,
        py: Python<'_>,
        image: &Bound<'_, PyAny>,
        shape: (u32, u32, usize),
        output: &[u8],
        region: Option<Buffer<'_>>,
    ) -> PyResult<(Values, f64)> {
        let (image, region) = (read_image(py, image, shape)?, read_buffer(py, region)?);
        let (posed, output) = (self.posed.clone(), output.to_vec());
        run(py, move |cancel| {
            let begun = Instant::now();
            let output = read_output(&output)?;
            let image = image()?;
            let mut posed = posed.cancelled_by(cancel);
            if let Some(region) = region()? {
                posed = posed.within(&region)?;
            }
            let rendering = posed.render(&image)?.with(|spec| *spec = output);
            let values = Values::of_pixels(rendering.pixels()?);
            Ok((values, begun.elapsed().as_secs_f64()))
        })
    }

    /// Moves labels of 8, 16 or 32 bits. `output`: as of [`Pose::warp`].
    fn labels(
        &self,
        py: Python<'_>,
        labels: &Bound<'_, PyAny>,
        shape: (u32, u32),
        output: &[u8],
    ) -> PyResult<Values> {
        let labels = read_labels(py, labels, [shape.1, shape.0])?;
        let (posed, output) = (self.posed.clone(), output.to_vec());
        run(py, move |cancel| {
            let output = read_output(&output)?;
            let labels = labels()?;
            let posed = posed.cancelled_by(cancel);
            let rendering = posed.render_labels(&labels)?.with(|spec| *spec = output);
            let size = rendering.extent()?;
            let sides = [size.width() as usize, size.height() as usize];
            Ok(Values::of_labels(sides, rendering.labels()?))
        })
    }

    /// How much of each pixel is covered. `output`: as of [`Pose::warp`].
    fn coverage(&self, py: Python<'_>, output: &[u8]) -> PyResult<Values> {
        let (posed, output) = (self.posed.clone(), output.to_vec());
        run(py, move |cancel| {
            let output = read_output(&output)?;
            let posed = posed.cancelled_by(cancel);
            let rendering = posed.render_coverage().with(|spec| *spec = output);
            Ok(Values::of_pixels(rendering.pixels()?))
        })
    }

    /// Maps positions, `[n][2]` of doubles; NaN stays NaN, and is the result where nothing maps.
    fn points(&self, py: Python<'_>, xy: &Bound<'_, PyAny>, inverse: bool) -> PyResult<Values> {
        let (posed, xy) = (self.posed.clone(), read_positions(py, xy)?);
        run(py, move |cancel| {
            let posed = posed.cancelled_by(cancel);
            let is_there = |[x, y]: &[f64; 2]| !(x.is_nan() || y.is_nan());
            let there: Vec<[f64; 2]> = xy.iter().copied().filter(is_there).collect();
            let located = |error| located(error, &xy, is_there);
            let mapped: Vec<Option<[f64; 2]>> = if inverse {
                posed.unmap_points(&there).map_err(located)?
            } else {
                let mapped = posed.map_points(&there).map_err(located)?;
                mapped.into_iter().map(Some).collect()
            };
            let mut mapped = mapped.into_iter();
            let all: Vec<[f64; 2]> = xy
                .iter()
                .map(|place| is_there(place).then(|| mapped.next().flatten()).flatten())
                .map(|place| place.unwrap_or([f64::NAN; 2]))
                .collect();
            Ok(Values::of_doubles(&all))
        })
    }

    /// Maps the annotations of a request for points: a JSON object with `polygons`, `boxes`,
    /// `geojson`, `inverse`, `refine`. The result has the same fields.
    fn annotations<'py>(
        &self,
        py: Python<'py>,
        request: &[u8],
    ) -> PyResult<Bound<'py, pyo3::types::PyBytes>> {
        let (posed, request) = (self.posed.clone(), Bytes::copy_from_slice(request));
        let mapped = run(py, move |cancel| {
            let setup = posed.warper().resolved();
            let (extent, units) = (setup.source(), setup.units());
            let output = OutputSpec::default();
            let object = Reserved::<PointsObject, ()>::parse_posed(
                &request,
                u64::MAX,
                (extent, units),
                &output,
                &|| cancel.is_cancelled(),
                |_| Ok(()),
            )?;
            let annotations = object.into_parts().0.annotations;
            let posed = posed.cancelled_by(cancel);
            let transform = if annotations.is_inverse {
                posed.inverse()?
            } else {
                posed.transform()
            };
            let (mut cursor, mut out) = (Cursor::default(), Vec::new());
            let is_cancelled = || cancel.is_cancelled();
            while annotations.map_part(
                &mut cursor,
                &transform,
                &is_cancelled,
                &mut |_| Ok(()),
                &mut out,
            )? {}
            Ok(out)
        })?;
        Ok(pyo3::types::PyBytes::new(py, &mapped))
    }

    /// A position for each pixel, px, `[height][width][2]`.
    fn map(&self, py: Python<'_>, forward: bool) -> PyResult<Values> {
        let (posed, extent) = (self.posed.clone(), self.extent());
        run(py, move |cancel| {
            let direction = if forward {
                MapDirection::Forward
            } else {
                MapDirection::Inverse
            };
            let map = posed.cancelled_by(cancel).map(direction)?;
            let shape = [extent.height() as usize, extent.width() as usize];
            Ok(Values::of_singles(&shape, &map))
        })
    }

    /// The posed vertices of the grid, px, `[rows][columns][2]`.
    fn mesh(&self) -> Values {
        let mesh = self.posed.mesh();
        let (columns, rows) = (mesh.grid().columns(), mesh.grid().rows());
        let vertices = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
        let moved = vertices.zip(mesh.displacement());
        let vertices: Vec<[f32; 2]> = moved
            .map(|((column, row), [dx, dy])| {
                let rest = mesh.grid().vertex(column, row);
                [rest.x + f64::from(*dx), rest.y + f64::from(*dy)].map(to_single)
            })
            .collect();
        Values::of_singles(&[rows as usize, columns as usize], &vertices)
    }

    /// The figures of `/report`, as JSON.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        let posed = self.posed.clone();
        run(py, move |cancel| {
            let posed = posed.cancelled_by(cancel);
            let quality = posed.quality()?;
            let mesh = posed.posed_mesh().clone();
            let report = mesh.into_report(quality.canvas, &|| cancel.is_cancelled())?;
            let warnings: Vec<WarningEntry> =
                report.warnings.iter().map(WarningEntry::from).collect();
            let output = OutputSpec::default();
            let on = |canvas| CoordinateFrame::on_canvas(canvas, &output, Units::Px);
            let answer = ReportAnswer {
                quality: &quality,
                alignment: posed.alignment(),
                warnings: &warnings,
                picture: quality.canvas.map(on),
            };
            serde_json::to_string(&answer).map_err(|error| internal(&error.to_string()))
        })
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a position of a mesh is drawn in f32"
)]
const fn to_single(value: f64) -> f32 {
    value as f32
}

fn read_output(json: &[u8]) -> Result<OutputSpec, Problem> {
    read_object(json).map(|object| object.output)
}

/// An error of the positions that are there, at its place among all.
fn located(error: WarpError, xy: &[[f64; 2]], is_there: impl Fn(&[f64; 2]) -> bool) -> Problem {
    let WarpError::BadPlace {
        index,
        value,
        limit,
    } = error
    else {
        return error.into();
    };
    let among_all = xy.iter().enumerate().filter(|(_, place)| is_there(place));
    let index = among_all.map(|(k, _)| k).nth(index).unwrap_or(index);
    WarpError::BadPlace {
        index,
        value,
        limit,
    }
    .into()
}
