//! Sampling without hand-written kernels: nearest at any depth, bilinear at 16 bit (as defined in
//! `kernel::scalar`, with wider integers), and the plain copy of the identity. Coordinates are
//! scaled for the filter; output is straight samples, 16 bit big-endian.

#![expect(
    clippy::cast_possible_truncation,
    reason = "weighted means stay in the range of the samples"
)]

use std::ops::Range;

use super::bicubic;
use super::kernel::{Kernel, ROUND_SAMPLE, fixed};
use super::mirror::mirrored;
use super::source::Source;
use super::{Canvas, Filter, Outside};
use crate::pixmap::{Channels, Depth, Extent, Pixmap, Samples};

/// Samples a run of pixels; `out` has `channels` samples for each of `u`.
pub(super) fn sample(
    kernel: Kernel,
    source: &Source,
    filter: Filter,
    u: &[f32],
    v: &[f32],
    channels: Channels,
    out: &mut [u8],
) {
    match (filter, source.packed(), source.pixmap().samples()) {
        (Filter::Bilinear, Some(packed), _) => kernel.sample(packed, u, v, channels, out),
        (Filter::Bilinear, None, Samples::Sixteen(samples)) => {
            let picture = Texels::new(source.pixmap(), samples);
            each(
                u,
                v,
                channels,
                out,
                |u, v, pixel: &mut [u8]| put_wide(picture.bilinear(u, v), pixel),
                Depth::Sixteen,
            );
        }
        (Filter::Bicubic, Some(packed), _) => {
            each(
                u,
                v,
                channels,
                out,
                |u, v, pixel: &mut [u8]| put(bicubic::narrow(packed, u, v), pixel),
                Depth::Eight,
            );
        }
        (Filter::Bicubic, None, Samples::Sixteen(samples)) => {
            let picture = Texels::new(source.pixmap(), samples);
            let side = (picture.width, picture.height);
            let sample = |u, v| bicubic::wide(side, u, v, |x, y| picture.at(x, y));
            each(
                u,
                v,
                channels,
                out,
                |u, v, pixel: &mut [u8]| put_wide(sample(u, v), pixel),
                Depth::Sixteen,
            );
        }
        (_, _, Samples::Eight(samples)) => {
            let picture = Texels::new(source.pixmap(), samples);
            each(
                u,
                v,
                channels,
                out,
                |u, v, pixel: &mut [u8]| put(picture.nearest(u, v), pixel),
                Depth::Eight,
            );
        }
        (Filter::Nearest, _, Samples::Sixteen(samples)) => {
            let picture = Texels::new(source.pixmap(), samples);
            each(
                u,
                v,
                channels,
                out,
                |u, v, pixel: &mut [u8]| put_wide(picture.nearest(u, v), pixel),
                Depth::Sixteen,
            );
        }
    }
}

fn each(
    u: &[f32],
    v: &[f32],
    channels: Channels,
    out: &mut [u8],
    mut put: impl FnMut(f32, f32, &mut [u8]),
    depth: Depth,
) {
    for ((u, v), pixel) in u
        .iter()
        .zip(v)
        .zip(out.chunks_exact_mut(channels.count() * depth.bytes()))
    {
        put(*u, *v, pixel);
    }
}

fn put(value: [u8; 4], pixel: &mut [u8]) {
    pixel.copy_from_slice(&value[..pixel.len()]);
}

fn put_wide(value: [u16; 4], pixel: &mut [u8]) {
    for (bytes, sample) in pixel.as_chunks_mut::<2>().0.iter_mut().zip(value) {
        *bytes = sample.to_be_bytes();
    }
}

/// An image's samples as pixels.
struct Texels<'a, S> {
    samples: &'a [S],
    width: usize,
    height: usize,
    channels: Channels,
    opaque: bool,
}

impl<'a, S: Copy + Sample> Texels<'a, S> {
    fn new(pixmap: &Pixmap, samples: &'a [S]) -> Self {
        let extent = pixmap.extent();
        let (width, height) = (extent.width() as usize, extent.height() as usize);
        Self {
            samples,
            width,
            height,
            channels: pixmap.channels(),
            opaque: pixmap.is_opaque(),
        }
    }

    fn at(&self, x: usize, y: usize) -> [S; 4] {
        let index = y.min(self.height - 1) * self.width + x.min(self.width - 1);
        match self.channels {
            Channels::Rgb => {
                let p = &self.samples[3 * index..3 * index + 3];
                [p[0], p[1], p[2], S::OPAQUE]
            }
            Channels::Rgba => {
                let p = &self.samples[4 * index..4 * index + 4];
                [p[0], p[1], p[2], p[3]]
            }
        }
    }

    /// The pixel that contains the position.
    fn nearest(&self, u: f32, v: f32) -> [S; 4] {
        self.at(
            fixed(u, (self.width - 1) as f32),
            fixed(v, (self.height - 1) as f32),
        )
    }
}

impl Texels<'_, u16> {
    fn bilinear(&self, u: f32, v: f32) -> [u16; 4] {
        let (u, v) = (
            fixed(u, ((self.width - 1) * 128) as f32),
            fixed(v, ((self.height - 1) * 128) as f32),
        );
        let (x, y, fx, fy) = (u >> 7, v >> 7, (u & 127) as u64, (v & 127) as u64);
        if fx == 0 && fy == 0 {
            return self.at(x, y);
        }
        let texels = [
            self.at(x, y),
            self.at(x + 1, y),
            self.at(x, y + 1),
            self.at(x + 1, y + 1),
        ];
        let weights = [
            (128 - fx) * (128 - fy),
            fx * (128 - fy),
            (128 - fx) * fy,
            fx * fy,
        ];
        let mut sums = [0_u64; 4];
        for (weight, texel) in weights.into_iter().zip(texels) {
            // At most 2^14 * 65535^2 < 2^46 in total.
            let alpha = weight * if self.opaque { 1 } else { u64::from(texel[3]) };
            for (sum, colour) in sums.iter_mut().zip(&texel[..3]) {
                *sum += alpha * u64::from(*colour);
            }
            sums[3] += alpha;
        }
        let alpha = sums[3];
        let [r, g, b] = [sums[0], sums[1], sums[2]]
            .map(|sum| (sum + alpha / 2).checked_div(alpha).unwrap_or(0) as u16);
        [
            r,
            g,
            b,
            if self.opaque {
                u16::MAX
            } else {
                ((alpha + ROUND_SAMPLE) >> 14) as u16
            },
        ]
    }
}

trait Sample {
    const OPAQUE: Self;
}

impl Sample for u8 {
    const OPAQUE: Self = Self::MAX;
}

impl Sample for u16 {
    const OPAQUE: Self = Self::MAX;
}

/// The bytes of a pixel outside the posed image if it has one colour; as many as a target pixel
/// has.
pub(super) fn outside_pixel(outside: Outside, depth: Depth) -> Option<[u8; 8]> {
    let colour = match outside {
        Outside::Transparent => [0; 4],
        Outside::Colour(colour) => colour,
        Outside::Value(value) => return Some(value_pixel(value, depth)),
        Outside::Edge | Outside::Reflect => return None,
    };
    let mut bytes = [0; 8];
    match depth {
        Depth::Eight => bytes[..4].copy_from_slice(&colour),
        // 257 c is c as 16 bit, and both its bytes are c.
        Depth::Sixteen => {
            bytes = [
                colour[0], colour[0], colour[1], colour[1], colour[2], colour[2], colour[3],
                colour[3],
            ]
        }
    }
    Some(bytes)
}

/// The bytes of an opaque pixel.
fn value_pixel([r, g, b]: [u16; 3], depth: Depth) -> [u8; 8] {
    match depth {
        Depth::Eight => {
            let [r, g, b] = [r, g, b].map(|sample| u8::try_from(sample).unwrap_or(u8::MAX));
            [r, g, b, u8::MAX, 0, 0, 0, 0]
        }
        Depth::Sixteen => {
            let [[r0, r1], [g0, g1], [b0, b1]] = [r, g, b].map(u16::to_be_bytes);
            [r0, r1, g0, g1, b0, b1, u8::MAX, u8::MAX]
        }
    }
}

/// Fills pixels with one colour.
pub(super) fn fill(out: &mut [u8], pixel: &[u8]) {
    match (pixel.iter().all(|byte| byte == &pixel[0]), pixel) {
        (true, _) => out.fill(pixel[0]),
        (false, &[r, g, b, a]) => out.as_chunks_mut().0.fill([r, g, b, a]),
        (false, _) => out
            .chunks_exact_mut(pixel.len())
            .for_each(|out| out.copy_from_slice(pixel)),
    }
}

/// Copies rows of the source as they are.
pub(super) fn copy(pixmap: &Pixmap, rows: Range<u32>, out: &mut [u8]) {
    let row = pixmap.extent().width() as usize * pixmap.channels().count();
    put_samples(
        pixmap,
        rows.start as usize * row..rows.end as usize * row,
        out,
    );
}

/// Writes samples of the source as they are.
fn put_samples(pixmap: &Pixmap, samples: Range<usize>, out: &mut [u8]) {
    match pixmap.samples() {
        Samples::Eight(source) => out.copy_from_slice(&source[samples]),
        Samples::Sixteen(source) => {
            for (bytes, sample) in out.as_chunks_mut::<2>().0.iter_mut().zip(&source[samples]) {
                *bytes = sample.to_be_bytes();
            }
        }
    }
}

/// Whether a canvas lies in an image of this size.
pub(super) fn covers(picture: Extent, canvas: Canvas) -> bool {
    let within = |at: i32, length: u32, side: u32| {
        at >= 0 && i64::from(at) + i64::from(length) <= i64::from(side)
    };
    within(canvas.x, canvas.extent.width(), picture.width())
        && within(canvas.y, canvas.extent.height(), picture.height())
}

/// Copies a row of the source's plane that begins at `(x, y)`, of which a part may lie outside the
/// source.
pub(super) fn copy_row(
    pixmap: &Pixmap,
    (x, y): (i64, i64),
    outside: Outside,
    channels: Channels,
    out: &mut [u8],
) {
    let (width, height) = (
        i64::from(pixmap.extent().width()),
        i64::from(pixmap.extent().height()),
    );
    let (count, bytes) = (channels.count(), pixmap.depth().bytes());
    let pixel = count * bytes;
    let pixels = out.len() / pixel;
    let colour = outside_pixel(outside, pixmap.depth());
    if let Some(colour) = &colour
        && !(0..height).contains(&y)
    {
        return fill(out, &colour[..pixel]);
    }
    // The pixels of the row before which the source begins and ends.
    let before = |x: i64| usize::try_from(x).unwrap_or(0).min(pixels);
    let (first, end) = (before(-x), before(width - x));
    let is_mirrored = outside == Outside::Reflect;
    let line = if is_mirrored {
        mirrored(y, height)
    } else {
        y.clamp(0, height - 1)
    };
    let source = line as usize * width as usize;
    let put = |from: usize, out: &mut [u8]| {
        let stored = pixmap.channels().count();
        for (k, out) in out.chunks_exact_mut(pixel).enumerate() {
            let (samples, opaque) = out.split_at_mut(stored.min(count) * bytes);
            put_samples(
                pixmap,
                (from + k) * stored..(from + k) * stored + stored.min(count),
                samples,
            );
            opaque.fill(u8::MAX);
        }
    };
    if first < end {
        put(
            source + usize::try_from(x).unwrap_or(0),
            &mut out[first * pixel..end * pixel],
        );
    }
    for (range, nearest) in [(0..first, 0), (end.max(first)..pixels, width as usize - 1)] {
        let out = &mut out[range.start * pixel..range.end * pixel];
        match &colour {
            Some(colour) => fill(out, &colour[..pixel]),
            None if is_mirrored => {
                for (at, out) in (x..).skip(range.start).zip(out.chunks_exact_mut(pixel)) {
                    put(source + mirrored(at, width) as usize, out);
                }
            }
            None => out
                .chunks_exact_mut(pixel)
                .for_each(|out| put(source + nearest, out)),
        }
    }
}
