//! Numbers from NumPy's buffers, and arrays of NumPy. What comes is copied while Python's lock is
//! held: no thread of Python changes it meanwhile, and nothing here is unsafe.

use mlswarp::pixmap::{PixelFormat, Pixels, Samples};
use mlswarp::warp::LabelValues;
use mlswarp::{Image, LabelImage};
use mlswarp_contract::problem::{Code, Problem};
use numpy::ndarray::ArrayD;
use numpy::{Element, PyArray, PyArrayMethods, PyUntypedArray};
use pyo3::buffer::PyBuffer;
use pyo3::prelude::*;

use crate::error::{exception, internal};

#[derive(Debug)]
enum Numbers {
    Bytes(Vec<u8>),
    Words(Vec<u16>),
    Integers(Vec<u32>),
    Singles(Vec<f32>),
    Doubles(Vec<f64>),
}

/// An array that was computed, until it is one of NumPy's.
#[derive(Debug)]
pub(crate) struct Values {
    shape: Vec<usize>,
    numbers: Numbers,
}

/// NumPy's array keeps the memory in which the numbers were computed: nothing is copied.
impl<'py> IntoPyObject<'py> for Values {
    type Target = PyUntypedArray;
    type Output = Bound<'py, PyUntypedArray>;
    type Error = PyErr;

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Self::Output> {
        fn array<'py, T: Element>(
            py: Python<'py>,
            shape: Vec<usize>,
            numbers: Vec<T>,
        ) -> PyResult<Bound<'py, PyUntypedArray>> {
            let array = ArrayD::from_shape_vec(shape, numbers)
                .map_err(|error| internal(&error.to_string()))
                .map_err(|problem| exception(py, &problem))?;
            Ok(PyArray::from_owned_array(py, array).as_untyped().clone())
        }
        match self.numbers {
            Numbers::Bytes(numbers) => array(py, self.shape, numbers),
            Numbers::Words(numbers) => array(py, self.shape, numbers),
            Numbers::Integers(numbers) => array(py, self.shape, numbers),
            Numbers::Singles(numbers) => array(py, self.shape, numbers),
            Numbers::Doubles(numbers) => array(py, self.shape, numbers),
        }
    }
}

impl Values {
    const fn new(shape: Vec<usize>, numbers: Numbers) -> Self {
        Self { shape, numbers }
    }

    /// `[height][width][samples]`.
    pub(crate) fn of_pixels(pixels: Pixels) -> Self {
        let (extent, format) = (pixels.extent(), pixels.format());
        let sides = [extent.height() as usize, extent.width() as usize];
        let numbers = match pixels.into_samples() {
            Samples::Eight(samples) => Numbers::Bytes(samples),
            Samples::Sixteen(samples) => Numbers::Words(samples),
        };
        Self::new(vec![sides[0], sides[1], format.samples()], numbers)
    }

    /// `[height][width]`.
    pub(crate) fn of_labels([width, height]: [usize; 2], labels: LabelValues) -> Self {
        let numbers = match labels {
            LabelValues::Eight(labels) => Numbers::Bytes(labels),
            LabelValues::Sixteen(labels) => Numbers::Words(labels),
            LabelValues::ThirtyTwo(labels) => Numbers::Integers(labels),
        };
        Self::new(vec![height, width], numbers)
    }

    /// `[...][2]`.
    pub(crate) fn of_singles(shape: &[usize], pairs: &[[f32; 2]]) -> Self {
        let numbers = Numbers::Singles(pairs.as_flattened().to_vec());
        Self::new([shape, &[2]].concat(), numbers)
    }

    /// `[n][2]`.
    pub(crate) fn of_doubles(pairs: &[[f64; 2]]) -> Self {
        let numbers = Numbers::Doubles(pairs.as_flattened().to_vec());
        Self::new(vec![pairs.len(), 2], numbers)
    }
}

/// Height, width, and samples of a pixel.
type Shape = (u32, u32, usize);

/// The image in a buffer.
/// Errors: Samples of another type or number.
pub(crate) fn read_image(
    py: Python<'_>,
    buffer: &Bound<'_, PyAny>,
    (height, width, samples): Shape,
) -> PyResult<impl FnOnce() -> Result<Image, Problem> + Send + use<>> {
    let format = match samples {
        1 => Some(PixelFormat::Grey),
        2 => Some(PixelFormat::GreyAlpha),
        3 => Some(PixelFormat::Rgb),
        4 => Some(PixelFormat::Rgba),
        _ => None,
    };
    let numbers = match PyBuffer::<u8>::get(buffer) {
        Ok(bytes) => Samples::Eight(bytes.to_vec(py)?),
        Err(_) => Samples::Sixteen(PyBuffer::<u16>::get(buffer)?.to_vec(py)?),
    };
    Ok(move || {
        let format = format.ok_or_else(|| {
            Problem::new(
                Code::BadValue,
                "expected 1, 2, 3 or 4 samples for each pixel",
            )
        })?;
        let pixels = Pixels::new(width, height, format, numbers);
        let pixels =
            pixels.map_err(|error| Problem::from(mlswarp::warp::WarpError::from(error)))?;
        Ok(Image::from_pixels(pixels))
    })
}

/// A buffer with its shape.
pub(crate) type Buffer<'py> = (Bound<'py, PyAny>, Shape);

/// The image in a buffer, if there is one.
/// Errors: Samples of another type or number.
pub(crate) fn read_buffer(
    py: Python<'_>,
    buffer: Option<Buffer<'_>>,
) -> PyResult<impl FnOnce() -> Result<Option<Image>, Problem> + Send + use<>> {
    let image = match &buffer {
        Some((buffer, shape)) => Some(read_image(py, buffer, *shape)?),
        None => None,
    };
    Ok(move || image.map(|image| image()).transpose())
}

/// The labels in a buffer.
/// Errors: Labels of another type or number.
pub(crate) fn read_labels(
    py: Python<'_>,
    buffer: &Bound<'_, PyAny>,
    [width, height]: [u32; 2],
) -> PyResult<impl FnOnce() -> Result<LabelImage, Problem> + Send + use<>> {
    let numbers = if let Ok(bytes) = PyBuffer::<u8>::get(buffer) {
        Numbers::Bytes(bytes.to_vec(py)?)
    } else if let Ok(words) = PyBuffer::<u16>::get(buffer) {
        Numbers::Words(words.to_vec(py)?)
    } else {
        Numbers::Integers(PyBuffer::<u32>::get(buffer)?.to_vec(py)?)
    };
    Ok(move || {
        let labels = match &numbers {
            Numbers::Bytes(labels) => LabelImage::from_labels8(width, height, labels),
            Numbers::Words(labels) => LabelImage::from_labels16(width, height, labels),
            Numbers::Integers(labels) => LabelImage::from_labels32(width, height, labels),
            Numbers::Singles(_) | Numbers::Doubles(_) => return Err(not_read()),
        };
        Ok(labels?)
    })
}

fn not_read() -> Problem {
    Problem::new(Code::BadValue, "expected whole numbers")
}

/// The positions in a buffer of doubles, `[n][2]`.
/// Errors: Numbers of another type.
pub(crate) fn read_positions(py: Python<'_>, buffer: &Bound<'_, PyAny>) -> PyResult<Vec<[f64; 2]>> {
    let numbers = PyBuffer::<f64>::get(buffer)?.to_vec(py)?;
    Ok(numbers.as_chunks::<2>().0.to_vec())
}
