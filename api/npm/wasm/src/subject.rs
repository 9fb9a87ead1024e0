//! Pixels, labels and positions, from bytes and back.

use mlswarp::pixmap::{Extent, Samples};
use mlswarp::warp::{LabelImage, LabelValues, Limits, OutputSpec};
use mlswarp::{PosedWarp, Rendering};
use mlswarp_contract::problem::{Code, Problem};

use crate::objects::{Object, give};

/// Labels of as many bits.
pub(crate) fn labels(
    values: &[u8],
    [width, height]: [u32; 2],
    bits: u32,
) -> Result<LabelImage, Problem> {
    let labels = match bits {
        8 => LabelImage::from_labels8(width, height, values),
        16 => {
            let pairs = values.as_chunks().0.iter();
            let values: Vec<u16> = pairs.map(|pair| u16::from_le_bytes(*pair)).collect();
            LabelImage::from_labels16(width, height, &values)
        }
        32 => {
            let quads = values.as_chunks().0.iter();
            let values: Vec<u32> = quads.map(|quad| u32::from_le_bytes(*quad)).collect();
            LabelImage::from_labels32(width, height, &values)
        }
        _ => {
            let detail = format!("labels have 8, 16 or 32 bits; found {bits}");
            return Err(Problem::new(Code::BadValue, detail));
        }
    };
    labels.map_err(Problem::from)
}

/// What a drawing gives: width, height, and the number of a buffer with its samples.
fn with_size(extent: Extent, samples: Vec<u8>) -> Vec<u8> {
    // A buffer of their own: eight megabytes are not moved for the sake of two numbers.
    let samples = give(Object::Buffer(samples));
    let numbers = [extent.width(), extent.height(), samples];
    numbers.map(u32::to_le_bytes).concat()
}

/// Draws an image or its coverage.
pub(crate) fn drawn(rendering: Rendering<'_>, output: OutputSpec) -> Result<Vec<u8>, Problem> {
    let pixels = rendering.with(|own| *own = output).pixels()?;
    let extent = pixels.extent();
    let samples = match pixels.into_samples() {
        Samples::Eight(samples) => samples,
        Samples::Sixteen(samples) => samples.into_iter().flat_map(u16::to_le_bytes).collect(),
    };
    Ok(with_size(extent, samples))
}

/// Draws labels, with the bits that they came with.
pub(crate) fn drawn_labels(
    pose: &PosedWarp,
    labels: &LabelImage,
    output: OutputSpec,
) -> Result<Vec<u8>, Problem> {
    let rendering = pose.render_labels(labels)?.with(|own| *own = output);
    let size = labels.extent();
    let target = output.target(size, pose.posed_mesh(), &Limits::default(), &|| false)?;
    let labels = match rendering.labels()? {
        LabelValues::Eight(labels) => labels,
        LabelValues::Sixteen(labels) => labels.into_iter().flat_map(u16::to_le_bytes).collect(),
        LabelValues::ThirtyTwo(labels) => labels.into_iter().flat_map(u32::to_le_bytes).collect(),
    };
    Ok(with_size(target.extent, labels))
}

/// Pairs of coordinates.
pub(crate) fn positions(bytes: &[u8]) -> Vec<[f64; 2]> {
    let numbers = bytes.as_chunks().0.iter();
    let numbers: Vec<f64> = numbers.map(|number| f64::from_le_bytes(*number)).collect();
    numbers.as_chunks().0.to_vec()
}
