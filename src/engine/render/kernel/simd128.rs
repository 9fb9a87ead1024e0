//! WebAssembly: a hand-written bilinear sampler with the integers of `bilinear`, four pixels at a
//! time.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "sides are at most 2^15"
)]

use std::arch::wasm32::*;

use super::bilinear;
use crate::pixmap::Channels;
use crate::render::source::Packed;

/// Pixels of a group.
const LANES: usize = 4;

/// Bilinear samples; [`bilinear::sample`] where 32-bit indices are too small.
#[inline]
pub(super) fn sample(packed: &Packed, u: &[f32], v: &[f32], channels: Channels, out: &mut [u8]) {
    assert!(
        packed.texels.len() == (packed.width + 1) * (packed.height + 1),
        "texels are padded on two sides"
    );
    // Beyond this, 128 times a coordinate is inexact in f32.
    if packed.width > 1 << 15 || packed.height > 1 << 15 {
        return bilinear::sample(packed, u, v, channels, out);
    }
    match channels {
        Channels::Rgb => {
            let drop = |pixels| {
                i8x16_shuffle::<0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 0, 0, 0, 0>(pixels, pixels)
            };
            row::<12>(packed, u, v, out, drop);
        }
        Channels::Rgba => row::<16>(packed, u, v, out, |pixels| pixels),
    }
}

#[inline]
fn row<const BYTES: usize>(
    packed: &Packed,
    u: &[f32],
    v: &[f32],
    out: &mut [u8],
    kept: impl Fn(v128) -> v128,
) {
    let (us, u_rest) = u.as_chunks::<LANES>();
    let (vs, v_rest) = v.as_chunks::<LANES>();
    let (outs, out_rest) = out.as_chunks_mut::<BYTES>();
    let put = |pixels: v128, out: &mut [u8]| {
        let mut bytes = [0; 16];
        // SAFETY: 16 bytes are stored into 16 bytes.
        unsafe { v128_store(bytes.as_mut_ptr().cast(), kept(pixels)) };
        out.copy_from_slice(&bytes[..out.len()]);
    };
    for ((u, v), out) in us.iter().zip(vs).zip(outs) {
        put(group(packed, u, v), out);
    }
    if !u_rest.is_empty() {
        let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
        u[..u_rest.len()].copy_from_slice(u_rest);
        v[..v_rest.len()].copy_from_slice(v_rest);
        put(group(packed, &u, &v), out_rest);
    }
}

/// Four pixels, RGBA.
#[inline]
fn group(packed: &Packed, u: &[f32; LANES], v: &[f32; LANES]) -> v128 {
    let stride = packed.stride();
    let inside = |[a, b, c, d]: [f32; LANES], last: usize| {
        // `pmax` and `pmin` keep their first operand where the second is NaN.
        let kept = f32x4_pmax(f32x4_splat(0.0), f32x4(a, b, c, d));
        i32x4_trunc_sat_f32x4(f32x4_pmin(f32x4_splat((last * 128) as f32), kept))
    };
    let (across, down) = (inside(*u, packed.width - 1), inside(*v, packed.height - 1));
    let index = i32x4_add(
        i32x4_mul(i32x4_shr(down, 7), i32x4_splat(stride as i32)),
        i32x4_shr(across, 7),
    );
    let (fx, fy) = (
        v128_and(across, i32x4_splat(127)),
        v128_and(down, i32x4_splat(127)),
    );
    let texels = packed.texels.as_ptr();
    // The left and right texel of the upper and of the lower row.
    let quad = |at: i32| {
        // SAFETY: U <= 128 (width - 1) and V <= 128 (height - 1), so the texels begin before the
        // last column and row, which are padding.
        unsafe {
            let above = texels.add(at as usize);
            v128_load64_lane::<1>(v128_load64_zero(above.cast()), above.add(stride).cast())
        }
    };
    let quads = [
        quad(i32x4_extract_lane::<0>(index)),
        quad(i32x4_extract_lane::<1>(index)),
        quad(i32x4_extract_lane::<2>(index)),
        quad(i32x4_extract_lane::<3>(index)),
    ];
    if !packed.opaque {
        // Alpha 255 is stored as 127, the maximum: the minimum of all is 127 only if each is.
        let least = i8x16_min(i8x16_min(quads[0], quads[1]), i8x16_min(quads[2], quads[3]));
        if !i32x4_all_true(i32x4_gt(least, i32x4_splat(0x7eff_ffff))) {
            return translucent(packed, index, fx, fy);
        }
    }
    // Per pixel: 128 - fx and fx in 16 bits each, and 256 fy twice.
    let wx = i32x4_add(i32x4_sub(i32x4_shl(fx, 16), fx), i32x4_splat(128));
    let wy = v128_or(i32x4_shl(fy, 8), i32x4_shl(fy, 24));
    // Across: the sum of w (t - 128), absolute value at most 2^14.
    let rows = |quad: v128, wx: v128| {
        let beside =
            i8x16_shuffle::<0, 4, 1, 5, 2, 6, 3, 7, 8, 12, 9, 13, 10, 14, 11, 15>(quad, quad);
        (
            i32x4_dot_i16x8(i16x8_extend_low_i8x16(beside), wx),
            i32x4_dot_i16x8(i16x8_extend_high_i8x16(beside), wx),
        )
    };
    // Down: above + (below - above) f / 128, rounded to nearest by 2^6; then 2^14 for the 128
    // subtracted from each texel, and 2^6 to round.
    let mean = |(above_a, below_a): (v128, v128), (above_b, below_b): (v128, v128), wy: v128| {
        let above = i16x8_narrow_i32x4(above_a, above_b);
        let below = i16x8_narrow_i32x4(below_a, below_b);
        let step = i16x8_q15mulr_sat(i16x8_sub(below, above), wy);
        let bias = i16x8_splat((1 << 14) + (1 << 6));
        i16x8_shr(i16x8_add(i16x8_add(above, step), bias), 7)
    };
    let first = mean(
        rows(quads[0], i32x4_shuffle::<0, 0, 0, 0>(wx, wx)),
        rows(quads[1], i32x4_shuffle::<1, 1, 1, 1>(wx, wx)),
        i32x4_shuffle::<0, 0, 1, 1>(wy, wy),
    );
    let second = mean(
        rows(quads[2], i32x4_shuffle::<2, 2, 2, 2>(wx, wx)),
        rows(quads[3], i32x4_shuffle::<3, 3, 3, 3>(wx, wx)),
        i32x4_shuffle::<2, 2, 3, 3>(wy, wy),
    );
    u8x16_narrow_i16x8(first, second)
}

/// Four pixels, of which at least one has a texel that is not opaque.
#[cold]
fn translucent(packed: &Packed, index: v128, fx: v128, fy: v128) -> v128 {
    let lanes = |v: v128| {
        let mut lanes = [0_u32; LANES];
        // SAFETY: 16 bytes are stored into 16 bytes.
        unsafe { v128_store(lanes.as_mut_ptr().cast(), v) };
        lanes
    };
    let (index, fx, fy) = (lanes(index), lanes(fx), lanes(fy));
    let mut pixels = [0_u32; LANES];
    for k in 0..LANES {
        let pixel = bilinear::blend(
            packed,
            index[k] as usize,
            u64::from(fx[k]),
            u64::from(fy[k]),
        );
        pixels[k] = u32::from_le_bytes(pixel);
    }
    let [a, b, c, d] = pixels;
    u32x4(a, b, c, d)
}
