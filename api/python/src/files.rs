//! Files as they are: an image and a warp object to the image file that the service would send,
//! landmark files, and the comparison of methods.

use bytes::Bytes;
use mlswarp::warp::check_comparison;
use mlswarp_contract::file::{MOST_FIT_HANDLES, WarpFiles};
use mlswarp_contract::problem::{Code, Problem};
use mlswarp_contract::wire::landmarks::{Choice, LandmarkFiles, Landmarks};
use mlswarp_contract::wire::{FitAnswer, FitObject, Reserved, predictions};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::error::internal;
use crate::plan::{extent_of, limits};
use crate::pool::run;

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
        let files = WarpFiles {
            image: &image,
            warp: &warp,
            region: region.as_deref(),
            format: None,
        };
        let helpers = rayon::current_num_threads() - 1;
        Ok(files.draw(&limits(), helpers, cancel)?.bytes)
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
