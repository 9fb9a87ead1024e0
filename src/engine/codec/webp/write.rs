//! Writes WebP files (RFC 9649, section 2): whole images, lossless.

use super::encode::encode;
use crate::codec::{Carried, Profile};
use crate::pixmap::{Channels, Extent};

/// Appends the file. The sides are those of a lossless WebP. Stops early when `wanted` returns
/// false; the output is then incomplete.
pub(in crate::codec) fn write(
    (extent, channels): (Extent, Channels),
    samples: &[u8],
    metadata: Option<&Carried>,
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) {
    let (profile, exif, xmp) = match metadata {
        Some(metadata) => (
            metadata.profile(false).map_or(&[][..], Profile::icc),
            metadata.exif_block(false).unwrap_or_default(),
            metadata.xmp().unwrap_or_default(),
        ),
        None => (&[][..], Vec::new(), &[][..]),
    };
    let start = out.len();
    out.extend_from_slice(b"RIFF\0\0\0\0WEBP");
    // A file with metadata says so first; one without has the image alone.
    let found = [(profile, 1 << 5), (&exif[..], 1 << 3), (xmp, 1 << 2)];
    if found.iter().any(|(bytes, _)| !bytes.is_empty()) {
        let mut flags = u32::from(channels == Channels::Rgba) << 4;
        for (bytes, flag) in found {
            flags |= if bytes.is_empty() { 0 } else { flag };
        }
        let side = |pixels: u32| (pixels - 1).to_le_bytes();
        let (width, height) = (side(extent.width()), side(extent.height()));
        chunk(b"VP8X", out, |out| {
            out.extend_from_slice(&flags.to_le_bytes());
            out.extend_from_slice(&width[..3]);
            out.extend_from_slice(&height[..3]);
        });
    }
    let bytes_of = |kind: &[u8; 4], bytes: &[u8], out: &mut Vec<u8>| {
        if !bytes.is_empty() {
            chunk(kind, out, |out| out.extend_from_slice(bytes));
        }
    };
    bytes_of(b"ICCP", profile, out);
    chunk(b"VP8L", out, |out| {
        encode(extent, channels, samples, out, wanted)
    });
    bytes_of(b"EXIF", &exif, out);
    bytes_of(b"XMP ", xmp, out);
    set_length(out, start);
}

/// Appends a chunk; the content of an odd number of bytes is followed by a zero.
fn chunk(kind: &[u8; 4], out: &mut Vec<u8>, content: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend_from_slice(kind);
    out.extend_from_slice(&[0; 4]);
    content(out);
    set_length(out, start);
    if (out.len() - start) % 2 == 1 {
        out.push(0);
    }
}

/// Writes the number of bytes behind the head of the chunk that starts here.
fn set_length(out: &mut [u8], start: usize) {
    let length = u32::try_from(out.len() - start - 8).expect("a lossless WebP has less than 2 GiB");
    out[start + 4..start + 8].copy_from_slice(&length.to_le_bytes());
}
