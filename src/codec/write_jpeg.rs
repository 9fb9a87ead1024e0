//! JPEG: whole pictures through `jpeg-encoder`. Colour is kept at full resolution from quality 90 on, halved both ways below.

use jpeg_encoder::{ColorType, Encoder};

use crate::pixmap::{Channels, Extent};

/// Appends the file. What is transparent stands on `ground`: `(c a + g (255 - a)) / 255`, rounded. The sides are those of a JPEG.
pub(super) fn write(
    extent: Extent,
    channels: Channels,
    samples: &[u8],
    quality: u8,
    ground: [u8; 3],
    icc: Option<&[u8]>,
    out: &mut Vec<u8>,
) {
    let side = |length: u32| u16::try_from(length).expect("the target was held against the format's longest side");
    let (width, height) = (side(extent.width()), side(extent.height()));
    let mut encoder = Encoder::new(out, quality);
    if let Some(icc) = icc {
        encoder.add_icc_profile(icc).expect("a profile is smaller than 255 segments hold");
    }
    let flat = match channels {
        Channels::Rgb => None,
        Channels::Rgba => Some(flatten(samples, ground)),
    };
    encoder.encode(flat.as_deref().unwrap_or(samples), width, height, ColorType::Rgb).expect("writing to memory does not fail");
}

fn flatten(samples: &[u8], ground: [u8; 3]) -> Vec<u8> {
    let mut flat = Vec::with_capacity(samples.len() / 4 * 3);
    for pixel in samples.chunks_exact(4) {
        let alpha = u32::from(pixel[3]);
        #[expect(clippy::cast_possible_truncation, reason = "a mean of two bytes")]
        flat.extend((0..3).map(|c| ((u32::from(pixel[c]) * alpha + u32::from(ground[c]) * (255 - alpha) + 127) / 255) as u8));
    }
    flat
}
