//! Pixels, labels and positions, from bytes and back.

use mlswarp::pixmap::{Extent, Samples};
use mlswarp::warp::{LabelImage, LabelValues, Limits, OutputSpec};
use mlswarp::{PosedWarp, Rendering};
use mlswarp_contract::problem::{Code, Problem};

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

/// Width, height and room for samples.
fn head(extent: Extent) -> Vec<u8> {
    [extent.width().to_le_bytes(), extent.height().to_le_bytes()].concat()
}

/// Width, height and samples of an image or of its coverage.
pub(crate) fn drawn(rendering: Rendering<'_>, output: OutputSpec) -> Result<Vec<u8>, Problem> {
    let pixels = rendering.with(|own| *own = output).pixels()?;
    let mut bytes = head(pixels.extent());
    match pixels.into_samples() {
        Samples::Eight(samples) => bytes.extend(samples),
        Samples::Sixteen(samples) => bytes.extend(samples.into_iter().flat_map(u16::to_le_bytes)),
    }
    Ok(bytes)
}

/// Width, height and labels with the bits that they came with.
pub(crate) fn drawn_labels(
    pose: &PosedWarp,
    labels: &LabelImage,
    output: OutputSpec,
) -> Result<Vec<u8>, Problem> {
    let rendering = pose.render_labels(labels)?.with(|own| *own = output);
    let size = labels.extent();
    let target = output.target(size, pose.posed_mesh(), &Limits::default(), &|| false)?;
    let mut bytes = head(target.extent);
    match rendering.labels()? {
        LabelValues::Eight(labels) => bytes.extend(labels),
        LabelValues::Sixteen(labels) => bytes.extend(labels.into_iter().flat_map(u16::to_le_bytes)),
        LabelValues::ThirtyTwo(labels) => {
            bytes.extend(labels.into_iter().flat_map(u32::to_le_bytes));
        }
    }
    Ok(bytes)
}

/// Pairs of coordinates.
pub(crate) fn positions(bytes: &[u8]) -> Vec<[f64; 2]> {
    let numbers = bytes.as_chunks().0.iter();
    let numbers: Vec<f64> = numbers.map(|number| f64::from_le_bytes(*number)).collect();
    numbers.as_chunks().0.to_vec()
}
