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
    let bytes = LANES * channels.count();
    let (us, u_rest) = u.as_chunks::<LANES>();
    let (vs, v_rest) = v.as_chunks::<LANES>();
    let (outs, out_rest) = out.split_at_mut(us.len() * bytes);
    groups(packed, us, vs, channels, outs);
    if !u_rest.is_empty() {
        let (mut u, mut v, mut out) = ([0.0; LANES], [0.0; LANES], [0; 4 * LANES]);
        u[..u_rest.len()].copy_from_slice(u_rest);
        v[..v_rest.len()].copy_from_slice(v_rest);
        groups(packed, &[u], &[v], channels, &mut out[..bytes]);
        out_rest.copy_from_slice(&out[..out_rest.len()]);
    }
}

/// Whole groups. One function for both kinds of pixels, with its loop: what compiles WebAssembly
/// keeps constants in registers only within a function.
#[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
fn groups(
    packed: &Packed,
    u: &[[f32; LANES]],
    v: &[[f32; LANES]],
    channels: Channels,
    out: &mut [u8],
) {
    let positions = u.iter().zip(v);
    match channels {
        Channels::Rgba => {
            for ((u, v), out) in positions.zip(out.as_chunks_mut::<16>().0) {
                // SAFETY: 16 bytes are stored into 16 bytes.
                unsafe { v128_store(out.as_mut_ptr().cast(), group(packed, u, v)) };
            }
        }
        Channels::Rgb => {
            for ((u, v), out) in positions.zip(out.as_chunks_mut::<12>().0) {
                let pixels = group(packed, u, v);
                let colours = i8x16_shuffle::<0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 0, 0, 0, 0>(
                    pixels, pixels,
                );
                let out = out.as_mut_ptr();
                // SAFETY: 8 and 4 bytes are stored into 12 bytes.
                unsafe {
                    v128_store64_lane::<0>(colours, out.cast());
                    v128_store32_lane::<2>(colours, out.add(8).cast());
                }
            }
        }
    }
}

/// Four pixels, RGBA.
#[inline(always)]
fn group(packed: &Packed, u: &[f32; LANES], v: &[f32; LANES]) -> v128 {
    let stride = packed.stride();
    let inside = |[a, b, c, d]: [f32; LANES], last: usize| {
        // `pmax` and `pmin` keep their first operand where the second is NaN.
        let kept = f32x4_pmax(f32x4_splat(0.0), f32x4(a, b, c, d));
        let kept = f32x4_pmin(f32x4_splat((last * 128) as f32), kept);
        // At most 2^22, so the sum with 2^23 has its whole part as fraction. Three instructions; a
        // conversion that saturates takes more than that for what does not occur here.
        let sum = f32x4_add(f32x4_floor(kept), f32x4_splat((1 << 23) as f32));
        v128_and(sum, i32x4_splat((1 << 23) - 1))
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
    // Two texels of the upper row, and two of the lower, minus 128.
    let quad = |at: i32| {
        // SAFETY: U <= 128 (width - 1) and V <= 128 (height - 1), so the texels begin before the
        // last column and row, which are padding.
        unsafe {
            let above = texels.add(at as usize);
            [above, above.add(stride)].map(|row| i16x8_load_extend_i8x8(row.cast()))
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
        let least = quads.map(|[above, below]| i16x8_min(above, below));
        let least = i16x8_min(i16x8_min(least[0], least[1]), i16x8_min(least[2], least[3]));
        if i16x8_bitmask(i16x8_eq(least, i16x8_splat(127))) & 0x88 != 0x88 {
            return translucent(packed, index, fx, fy);
        }
    }
    // Weights of the left and of the right texel, in 16 bits, and 256 fy, each twice.
    let (right, wy) = (v128_or(fx, i32x4_shl(fx, 16)), i32x4_shl(fy, 8));
    let left = i32x4_sub(i32x4_splat((128 << 16) | 128), right);
    let wy = v128_or(wy, i32x4_shl(wy, 16));
    let (first, second) = (
        i32x4_shuffle::<0, 4, 1, 5>(left, right),
        i32x4_shuffle::<2, 6, 3, 7>(left, right),
    );
    // Across, of two pixels: the sum of w (t - 128), absolute value at most 2^14.
    let across = |a: v128, b: v128, wa: v128, wb: v128| {
        let (a, b) = (i16x8_mul(a, wa), i16x8_mul(b, wb));
        i16x8_add(i64x2_shuffle::<0, 2>(a, b), i64x2_shuffle::<1, 3>(a, b))
    };
    // Down: above + (below - above) f / 128, rounded to nearest by 2^6; then 2^14 for the 128
    // subtracted from each texel, and 2^6 to round.
    let mean = |[above_a, below_a]: [v128; 2], [above_b, below_b]: [v128; 2], wx: v128, wy| {
        let (wa, wb) = (
            i32x4_shuffle::<0, 0, 1, 1>(wx, wx),
            i32x4_shuffle::<2, 2, 3, 3>(wx, wx),
        );
        let (above, below) = (
            across(above_a, above_b, wa, wb),
            across(below_a, below_b, wa, wb),
        );
        let step = i16x8_q15mulr_sat(i16x8_sub(below, above), wy);
        let bias = i16x8_splat((1 << 14) + (1 << 6));
        i16x8_shr(i16x8_add(i16x8_add(above, step), bias), 7)
    };
    u8x16_narrow_i16x8(
        mean(
            quads[0],
            quads[1],
            first,
            i32x4_shuffle::<0, 0, 1, 1>(wy, wy),
        ),
        mean(
            quads[2],
            quads[3],
            second,
            i32x4_shuffle::<2, 2, 3, 3>(wy, wy),
        ),
    )
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
