//! WebP: whole pictures, lossless, through the `image-webp` crate.

use image_webp::{ColorType, WebPEncoder};

use crate::codec::{Carried, Profile};
use crate::pixmap::{Channels, Extent};

/// Appends the file. The sides are those of a lossless WebP.
pub(in crate::codec) fn write(
    extent: Extent,
    channels: Channels,
    samples: &[u8],
    metadata: Option<&Carried>,
    out: &mut Vec<u8>,
) {
    let colour = match channels {
        Channels::Rgb => ColorType::Rgb8,
        Channels::Rgba => ColorType::Rgba8,
    };
    let mut encoder = WebPEncoder::new(out);
    if let Some(metadata) = metadata {
        let (icc, exif, xmp) = (
            metadata.profile(false).map(Profile::icc),
            metadata.exif_block(false),
            metadata.xmp(),
        );
        encoder.set_icc_profile(icc.unwrap_or_default().to_vec());
        encoder.set_exif_metadata(exif.unwrap_or_default());
        encoder.set_xmp_metadata(xmp.unwrap_or_default().to_vec());
    }
    encoder
        .encode(samples, extent.width(), extent.height(), colour)
        .expect("writing to memory does not fail");
}
