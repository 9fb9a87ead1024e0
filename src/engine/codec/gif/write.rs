//! Writes GIF (89a): files of one frame, which become the frames of one animation. Each frame has a
//! palette of its own. A pixel is transparent or opaque: an alpha of a half decides.

use weezl::encode::Encoder;
use weezl::{BitOrder, LzwStatus};

use super::palette::{GifPalette, MOST_COLOURS, Rgb, WORK_BYTES};
use crate::codec::CodecError;
use crate::pixmap::{Channels, Extent};

/// The signature and the size.
const HEADER_BYTES: usize = 13;
/// The graphic control of a frame; its delay begins at byte 4.
const CONTROL_BYTES: usize = 8;
const TRAILER: u8 = 0x3B;
/// Bytes of a sub-block.
const SUB_BLOCK_BYTES: usize = 255;
/// The least opaque alpha.
const MIN_OPAQUE_ALPHA: u8 = 128;
/// Pixels, and blocks, between two calls of `wanted`.
const PIXELS_PER_CHECK: usize = 1 << 16;
const BLOCKS_PER_CHECK: usize = 1 << 8;

/// Memory for writing beside the file and the samples, bytes.
pub(in crate::codec) fn work_bytes(extent: Extent) -> u64 {
    // Their indices.
    WORK_BYTES + extent.pixels()
}

/// Appends a file of one frame. `wanted` is called from time to time; the output is incomplete when
/// it returns false.
pub(in crate::codec) fn write(
    extent: Extent,
    channels: Channels,
    samples: &[u8],
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) {
    let count = channels.count();
    let has_alpha = channels == Channels::Rgba;
    let colour = |pixel: &[u8]| -> Option<Rgb> {
        let is_opaque = !has_alpha || pixel[3] >= MIN_OPAQUE_ALPHA;
        is_opaque.then(|| [pixel[0], pixel[1], pixel[2]])
    };
    let pixels = samples.chunks_exact(count).map(colour);
    let palette = GifPalette::of(
        pixels.clone().flatten(),
        MOST_COLOURS - usize::from(has_alpha),
        wanted,
    );
    let transparent = u8::try_from(palette.colours().len()).unwrap_or_default();
    // A table of 2 to 256 colours.
    let bits = (palette.colours().len() + usize::from(has_alpha))
        .next_power_of_two()
        .trailing_zeros()
        .clamp(1, 8);
    let [width, height] = [extent.width(), extent.height()]
        .map(|side| u16::try_from(side).unwrap_or(u16::MAX).to_le_bytes());
    out.extend_from_slice(b"GIF89a");
    // No table of colours for all frames.
    out.extend_from_slice(&[width[0], width[1], height[0], height[1], 0x70, 0, 0]);
    // What is transparent shows nothing of the frame before, which is removed.
    let (disposal, flag) = if has_alpha { (2 << 2, 1) } else { (1 << 2, 0) };
    out.extend_from_slice(&[
        0x21,
        0xF9,
        4,
        disposal | flag,
        0,
        0,
        if has_alpha { transparent } else { 0 },
        0,
    ]);
    out.extend_from_slice(&[
        0x2C,
        0,
        0,
        0,
        0,
        width[0],
        width[1],
        height[0],
        height[1],
        0x80 | u8::try_from(bits - 1).unwrap_or_default(),
    ]);
    out.extend(palette.colours().iter().flatten());
    out.resize(out.len() + 3 * ((1 << bits) - palette.colours().len()), 0);
    let mut indexer = palette.indexer();
    let row = (extent.width() as usize).max(1);
    let mut indices = Vec::with_capacity(samples.len() / count);
    for (k, colour) in pixels.enumerate() {
        if k % PIXELS_PER_CHECK == 0 && !wanted() {
            return;
        }
        indices.push(colour.map_or(transparent, |colour| {
            indexer.index(colour, k % row, k / row)
        }));
    }
    compress(
        &indices,
        u8::try_from(bits.max(2)).unwrap_or(8),
        out,
        wanted,
    );
    out.push(TRAILER);
}

/// Appends the indices in sub-blocks.
fn compress(indices: &[u8], bits: u8, out: &mut Vec<u8>, wanted: &dyn Fn() -> bool) {
    out.push(bits);
    let mut encoder = Encoder::new(BitOrder::Lsb, bits);
    let (mut block, mut filled, mut rest, mut blocks) = ([0; SUB_BLOCK_BYTES], 0, indices, 0_usize);
    encoder.finish();
    loop {
        if blocks % BLOCKS_PER_CHECK == 0 && !wanted() {
            return;
        }
        // The end of the data is coded as soon as there are no more.
        let coded = encoder.encode_bytes(rest, &mut block[filled..]);
        (rest, filled) = (&rest[coded.consumed_in..], filled + coded.consumed_out);
        let is_done = matches!(
            coded
                .status
                .expect("indices are below the size of the table"),
            LzwStatus::Done
        );
        if filled == SUB_BLOCK_BYTES || is_done && filled > 0 {
            out.push(u8::try_from(filled).unwrap_or_default());
            out.extend_from_slice(&block[..filled]);
            (filled, blocks) = (0, blocks + 1);
        }
        if is_done {
            break;
        }
    }
    out.push(0);
}

/// An animation that is being written.
#[derive(Debug)]
pub struct GifAnimation {
    delay: u16,
    plays: u16,
    /// The number of frames so far.
    frames: u64,
    /// The head of all frames.
    head: Vec<u8>,
}

impl GifAnimation {
    /// An animation of frames that are each shown for `delay` ms. `plays`: how often viewers play
    /// it; 0 is without end.
    #[must_use]
    pub const fn new(delay: u16, plays: u16) -> Self {
        Self {
            delay,
            plays,
            frames: 0,
            head: Vec::new(),
        }
    }

    /// Appends the next frame, which is a file of this writer.
    ///
    /// # Errors
    /// It is another file, or its size differs from that of the first frame.
    pub fn push(&mut self, file: &[u8], out: &mut Vec<u8>) -> Result<(), CodecError> {
        let bad = |detail: &str| CodecError::Bad {
            format: "GIF",
            detail: detail.to_owned(),
        };
        let (head, frame) = file
            .split_at_checked(HEADER_BYTES)
            .ok_or_else(|| bad("a frame is incomplete"))?;
        let Some((control, picture)) = frame
            .strip_suffix(&[TRAILER])
            .and_then(|frame| frame.split_at_checked(CONTROL_BYTES))
        else {
            return Err(bad("a frame is incomplete"));
        };
        if self.frames == 0 {
            self.head = head.to_vec();
            out.extend_from_slice(head);
            self.repeat(out);
        }
        if self.head != head {
            return Err(bad("the frames differ in size"));
        }
        out.extend_from_slice(&control[..4]);
        out.extend_from_slice(&self.hundredths().to_le_bytes());
        out.extend_from_slice(&control[6..]);
        out.extend_from_slice(picture);
        self.frames += 1;
        Ok(())
    }

    /// The bytes after the last frame.
    #[must_use]
    pub fn tail() -> Vec<u8> {
        vec![TRAILER]
    }

    /// How long the next frame is shown: the rounded end of its display less that of the frame
    /// before, so that the animation takes its time. Viewers show frames of less than two
    /// hundredths much longer.
    fn hundredths(&self) -> u16 {
        let end = |frame: u64| (frame * u64::from(self.delay) + 5) / 10;
        u16::try_from(end(self.frames + 1) - end(self.frames))
            .unwrap_or(u16::MAX)
            .max(2)
    }

    /// Appends how often the animation is repeated after it was played once; nothing if it is not.
    fn repeat(&self, out: &mut Vec<u8>) {
        if self.plays != 1 {
            out.extend_from_slice(b"\x21\xFF\x0BNETSCAPE2.0\x03\x01");
            out.extend_from_slice(&self.plays.saturating_sub(1).to_le_bytes());
            out.push(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use image::codecs::gif::GifDecoder;
    use image::{AnimationDecoder as _, RgbaImage};

    use super::*;

    fn file(extent: Extent, channels: Channels, samples: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        write(extent, channels, samples, &mut out, &|| true);
        out
    }

    /// The frames of a file, as another program reads them, and how long each is shown, ms.
    fn frames(file: &[u8]) -> Vec<(RgbaImage, u32)> {
        let decoder = GifDecoder::new(std::io::Cursor::new(file)).unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        frames
            .into_iter()
            .map(|frame| (frame.buffer().clone(), frame.delay().numer_denom_ms().0))
            .collect()
    }

    #[test]
    fn few_colours_and_transparent_pixels_are_read_back() {
        for (width, height, colours) in [
            (1, 1, 1),
            (3, 2, 2),
            (7, 5, 6),
            (40, 30, 255),
            (300, 200, 200),
        ] {
            let extent = Extent::new(width, height).unwrap();
            let byte = |k: u32| u8::try_from(k).unwrap();
            let pixel = |k: u32| {
                [
                    byte(k % colours % 16 * 3),
                    byte(k % colours / 16 * 5),
                    9,
                    255,
                ]
            };
            let opaque: Vec<[u8; 4]> = (0..width * height).map(pixel).collect();
            let rgb: Vec<u8> = opaque
                .iter()
                .flat_map(|[r, g, b, _]| [*r, *g, *b])
                .collect();
            let read = frames(&file(extent, Channels::Rgb, &rgb));
            assert!(read.len() == 1 && read[0].0.as_raw() == opaque.as_flattened());
            let clear = |(k, pixel): (usize, &[u8; 4])| {
                if k % 3 == 1 {
                    [pixel[0], 1, 2, 127]
                } else {
                    [pixel[0], pixel[1], 9, 128]
                }
            };
            let mixed: Vec<[u8; 4]> = opaque.iter().enumerate().map(clear).collect();
            let shown: Vec<u8> = mixed
                .iter()
                .flat_map(|p| {
                    if p[3] < 128 {
                        [0; 4]
                    } else {
                        [p[0], p[1], 9, 255]
                    }
                })
                .collect();
            let read = frames(&file(extent, Channels::Rgba, mixed.as_flattened()));
            let found: Vec<u8> = read[0]
                .0
                .pixels()
                .flat_map(|p| if p.0[3] == 0 { [0; 4] } else { p.0 })
                .collect();
            assert!(found == shown, "{width} x {height}");
        }
    }

    #[test]
    fn frames_follow_one_another_and_each_replaces_the_one_before() {
        let extent = Extent::new(20, 10).unwrap();
        let clear = |k: u8| {
            (0..200)
                .flat_map(|at| {
                    if at / 50 == k {
                        [200, 10 * k, 0, 255]
                    } else {
                        [0; 4]
                    }
                })
                .collect::<Vec<u8>>()
        };
        let (mut animation, mut out) = (GifAnimation::new(33, 0), Vec::new());
        (0..4).for_each(|k| {
            animation
                .push(&file(extent, Channels::Rgba, &clear(k)), &mut out)
                .unwrap()
        });
        out.extend(GifAnimation::tail());
        let read = frames(&out);
        assert_eq!(
            read.iter().map(|(_, delay)| *delay).collect::<Vec<_>>(),
            [30, 40, 30, 30],
            "130 ms of 132"
        );
        for ((frame, _), k) in read.iter().zip(0_u8..) {
            let visible = |at: u8| frame.get_pixel(u32::from(at) % 20, u32::from(at) / 20).0;
            assert!(
                (0..200).all(|at| (visible(at)[3] > 0) == (at / 50 == k)),
                "frame {k}"
            );
            assert_eq!(visible(50 * k), [200, 10 * k, 0, 255]);
        }
    }

    #[test]
    fn the_number_of_plays_is_that_of_repeats_and_one() {
        let one = file(Extent::new(3, 2).unwrap(), Channels::Rgb, &[7; 18]);
        let repeats = |plays| {
            let mut out = Vec::new();
            GifAnimation::new(5, plays).push(&one, &mut out).unwrap();
            let at = out.windows(11).position(|bytes| bytes == b"NETSCAPE2.0")?;
            Some(u16::from_le_bytes([out[at + 13], out[at + 14]]))
        };
        assert_eq!([0, 1, 2, 9].map(repeats), [Some(0), None, Some(1), Some(8)]);
        assert_eq!(
            GifAnimation::new(5, 0).hundredths(),
            2,
            "browsers slow down what is shorter"
        );
    }

    #[test]
    fn frames_of_another_size_and_other_bytes_are_refused() {
        let one = file(Extent::new(9, 5).unwrap(), Channels::Rgb, &[7; 135]);
        let mut animation = GifAnimation::new(40, 0);
        animation.push(&one, &mut Vec::new()).unwrap();
        for bad in [
            &file(Extent::new(9, 6).unwrap(), Channels::Rgb, &[7; 162])[..],
            &one[..one.len() - 1],
            &one[1..],
            &[],
            &one[..20],
        ] {
            assert!(animation.push(bad, &mut Vec::new()).is_err());
        }
        animation.push(&one, &mut Vec::new()).unwrap();
    }
}
