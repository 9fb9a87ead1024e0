//! The reference of a bilinear sample, in integers: with U = floor(128 (u - 1/2) + 1/2),
//! x0 = U >> 7 and fx = U & 127 (likewise for v), the value is `(sum of w t + 8256) >> 14` over the
//! four texels t and their weights w = (128 - fx)(128 - fy), ... (8256 = 128 * 64 + 64 rounds in
//! two steps of 7 bits, which 16-bit lanes can do). With alpha it is
//! `round(sum of w a t / sum of w a)`, so colours under alpha 0 never show.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "values are clamped to their range before they are narrowed"
)]
#![expect(
    clippy::inline_always,
    reason = "instruction sets are chosen by the caller into which these are inlined"
)]

use crate::pixmap::Channels;
use crate::render::source::{Packed, STORED_ZERO};

/// Rounding term of a weighted sum of samples before 14 bits are dropped.
pub(in crate::render) const ROUND_SAMPLE: u64 = 128 * 64 + 64;

/// U of a coordinate: clamped to the image, then truncated. NaN becomes 0.
#[inline(always)]
pub(in crate::render) fn fixed(coordinate: f32, last: f32) -> usize {
    let coordinate = if coordinate > 0.0 { coordinate } else { 0.0 };
    (if coordinate < last { coordinate } else { last }) as usize
}

#[inline(always)]
pub(super) fn sample(packed: &Packed, u: &[f32], v: &[f32], channels: Channels, out: &mut [u8]) {
    match channels {
        Channels::Rgb => {
            for ((u, v), out) in u.iter().zip(v).zip(out.as_chunks_mut::<3>().0) {
                let [r, g, b, _] = pixel(packed, *u, *v);
                *out = [r, g, b];
            }
        }
        Channels::Rgba => {
            for ((u, v), out) in u.iter().zip(v).zip(out.as_chunks_mut::<4>().0) {
                *out = pixel(packed, *u, *v);
            }
        }
    }
}

/// One bilinear sample, straight RGBA.
#[inline(always)]
pub(super) fn pixel(packed: &Packed, u: f32, v: f32) -> [u8; 4] {
    let (last_x, last_y) = (packed.width - 1, packed.height - 1);
    let (u, v) = (
        fixed(u, (last_x * 128) as f32),
        fixed(v, (last_y * 128) as f32),
    );
    let (fx, fy) = ((u & 127) as u64, (v & 127) as u64);
    let at = (v >> 7).min(last_y) * packed.stride() + (u >> 7).min(last_x);
    blend(packed, at, fx, fy)
}

/// The blend of the four texels from index `at` on.
#[inline(always)]
pub(super) fn blend(packed: &Packed, at: usize, fx: u64, fy: u64) -> [u8; 4] {
    let below = at + packed.stride();
    let texels = [
        packed.texels[at] ^ STORED_ZERO,
        packed.texels[at + 1] ^ STORED_ZERO,
        packed.texels[below] ^ STORED_ZERO,
        packed.texels[below + 1] ^ STORED_ZERO,
    ];
    if packed.opaque || texels[0] & texels[1] & texels[2] & texels[3] >= 0xff00_0000 {
        opaque(texels, fx, fy)
    } else {
        translucent(texels, fx, fy)
    }
}

/// Spreads four 8-bit samples to 16 bits each.
#[inline(always)]
fn spread(texel: u32) -> u64 {
    let pairs = (u64::from(texel) | (u64::from(texel) << 16)) & 0x0000_ffff_0000_ffff;
    (pairs | (pairs << 8)) & 0x00ff_00ff_00ff_00ff
}

#[inline(always)]
fn opaque(texels: [u32; 4], fx: u64, fy: u64) -> [u8; 4] {
    // Across: up to 128 * 255, fits 16 bits. Down: up to 128^2 * 255, two samples at a time, spaced
    // by 32 bits.
    let across = |left: u32, right: u32| spread(left) * (128 - fx) + spread(right) * fx;
    let (above, below) = (across(texels[0], texels[1]), across(texels[2], texels[3]));
    let down = |shift: u32| {
        let part = |row: u64| (row >> shift) & 0x0000_ffff_0000_ffff;
        part(above) * (128 - fy) + part(below) * fy + (ROUND_SAMPLE | (ROUND_SAMPLE << 32))
    };
    let (even, odd) = (down(0) >> 14, down(16) >> 14);
    [even as u8, odd as u8, (even >> 32) as u8, (odd >> 32) as u8]
}

#[cold]
fn translucent(texels: [u32; 4], fx: u64, fy: u64) -> [u8; 4] {
    if fx == 0 && fy == 0 {
        return texels[0].to_le_bytes();
    }
    let (fx, fy) = (fx as u32, fy as u32);
    let weights = [
        (128 - fx) * (128 - fy),
        fx * (128 - fy),
        (128 - fx) * fy,
        fx * fy,
    ];
    let texels = texels.map(u32::to_le_bytes);
    let mut sums = [0_u32; 4];
    for (weight, texel) in weights.into_iter().zip(texels) {
        // At most 2^14 * 255^2 < 2^30 in total.
        let alpha = weight * u32::from(texel[3]);
        for (sum, colour) in sums.iter_mut().zip(&texel[..3]) {
            *sum += alpha * u32::from(*colour);
        }
        sums[3] += alpha;
    }
    let alpha = sums[3];
    let [r, g, b] = [sums[0], sums[1], sums[2]]
        .map(|sum| (sum + alpha / 2).checked_div(alpha).unwrap_or(0) as u8);
    [r, g, b, ((alpha + ROUND_SAMPLE as u32) >> 14) as u8]
}
