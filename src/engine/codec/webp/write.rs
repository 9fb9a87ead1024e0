//! WebP: whole pictures, lossless, through the `image` crate.

use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder as _};

use crate::pixmap::{Channels, Extent};

/// Appends the file. The sides are those of a lossless WebP.
pub(in crate::codec) fn write(extent: Extent, channels: Channels, samples: &[u8], icc: Option<&[u8]>, out: &mut Vec<u8>) {
    let colour = match channels {
        Channels::Rgb => ExtendedColorType::Rgb8,
        Channels::Rgba => ExtendedColorType::Rgba8,
    };
    let mut encoder = WebPEncoder::new_lossless(out);
    if let Some(icc) = icc {
        encoder.set_icc_profile(icc.to_vec()).expect("WebP carries profiles");
    }
    encoder.write_image(samples, extent.width(), extent.height(), colour).expect("writing to memory does not fail");
}
