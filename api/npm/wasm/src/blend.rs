//! Blends of images, as those of `POST /blend`.

use mlswarp::Cancel;
use mlswarp::pixmap::Samples;
use mlswarp::warp::Limits;
use mlswarp_contract::blend::{Blend, BlendFrame};
use mlswarp_contract::problem::{Code, Problem};
use mlswarp_contract::wire::AsJson;
use serde_json::json;

use crate::objects;

/// Reads a blend of images that JavaScript holds.
pub(crate) fn of(images: &[u8], blend: &[u8]) -> Result<Blend, Problem> {
    let numbers = images.as_chunks().0.iter();
    let images = numbers.map(|number| objects::image(u32::from_le_bytes(*number)));
    Blend::new(images.collect::<Result<_, _>>()?, blend, Limits::default())
}

/// The sizes, the report and the pixels of a frame.
pub(crate) fn frame(blend: &Blend, index: usize) -> Result<Vec<u8>, Problem> {
    let BlendFrame {
        image,
        landmarks,
        report,
    } = blend.frame(index, &Cancel::default())?;
    let said = json!({
        "landmarks": AsJson(&landmarks[..]),
        "clamped": report.clamped,
        "folds": report.folds,
    });
    let said = said.to_string().into_bytes();
    let length = u32::try_from(said.len()).unwrap_or(u32::MAX);
    let extent = image.extent();
    let numbers = [extent.width(), extent.height(), length];
    let mut bytes: Vec<u8> = numbers.into_iter().flat_map(u32::to_le_bytes).collect();
    bytes.extend(said);
    match image.to_pixels().into_samples() {
        Samples::Eight(samples) => bytes.extend(samples),
        Samples::Sixteen(_) => {
            return Err(Problem::new(Code::Internal, "images here have 8 bits"));
        }
    }
    Ok(bytes)
}
