//! Writes JPEG: whole pictures through `jpeg-encoder`. Colour has full resolution from quality 90 on, half below.

use jpeg_encoder::{ColorType, Encoder, EncodingError, JfifWrite};

use crate::codec::png::write::PngShape;
use crate::pixmap::Channels;

/// Bytes of output between two calls of `wanted`.
const CHECK_BYTES: usize = 64 << 10;

/// Collects the file and stops when it is no longer wanted.
pub(in crate::codec) struct WhileWanted<'a> {
    out: &'a mut Vec<u8>,
    wanted: &'a dyn Fn() -> bool,
    next_check: usize,
}

impl<'a> WhileWanted<'a> {
    /// Appends to `out` until `wanted` returns false.
    pub(in crate::codec) fn new(out: &'a mut Vec<u8>, wanted: &'a dyn Fn() -> bool) -> Self {
        let next_check = out.len() + CHECK_BYTES;
        Self { out, wanted, next_check }
    }
}

impl JfifWrite for WhileWanted<'_> {
    fn write_all(&mut self, bytes: &[u8]) -> Result<(), EncodingError> {
        self.out.extend_from_slice(bytes);
        if self.out.len() >= self.next_check {
            self.next_check = self.out.len() + CHECK_BYTES;
            if !(self.wanted)() {
                return Err(EncodingError::Write(String::new()));
            }
        }
        Ok(())
    }
}

/// Appends the file, or its beginning if it is no longer wanted. Transparent pixels are blended with `ground`: `(c a + g (255 - a)) /
/// 255`, rounded. The sides must be valid for JPEG.
pub(in crate::codec) fn write(shape: PngShape, samples: &[u8], quality: u8, ground: [u8; 3], icc: Option<&[u8]>, out: WhileWanted<'_>) {
    let side = |length: u32| u16::try_from(length).expect("the target was held against the format's longest side");
    let (width, height) = (side(shape.extent.width()), side(shape.extent.height()));
    let mut encoder = Encoder::new(out, quality);
    if let Some(icc) = icc {
        encoder.add_icc_profile(icc).expect("a profile is smaller than 255 segments hold");
    }
    let colour = if shape.grey { ColorType::Luma } else { ColorType::Rgb };
    let flat = match shape.channels {
        Channels::Rgb => None,
        Channels::Rgba => Some(flatten(samples, &ground[..shape.samples() - 1])),
    };
    match encoder.encode(flat.as_deref().unwrap_or(samples), width, height, colour) {
        Ok(()) | Err(EncodingError::Write(_)) => {}
        Err(error) => panic!("writing to memory does not fail: {error:?}"),
    }
}

fn flatten(samples: &[u8], ground: &[u8]) -> Vec<u8> {
    let colours = ground.len();
    let mut flat = Vec::with_capacity(samples.len() / (colours + 1) * colours);
    for pixel in samples.chunks_exact(colours + 1) {
        let alpha = u32::from(pixel[colours]);
        #[expect(clippy::cast_possible_truncation, reason = "a mean of two bytes")]
        flat.extend((0..colours).map(|c| ((u32::from(pixel[c]) * alpha + u32::from(ground[c]) * (255 - alpha) + 127) / 255) as u8));
    }
    flat
}
