//! AVX2: the scalar loops compiled again for wide registers, and the bilinear sampler by hand, with the integers of `scalar`. The functions that
//! are seen outside take a [`Kernel`], which is proof that the machine has the level.

use std::arch::x86_64::*;
use std::ops::Range;

use super::scalar::{self, CellRow, Spans};
use super::{Kernel, Level};
use crate::pixmap::Channels;
use crate::render::lattice::Lattice;
use crate::render::source::Packed;

/// Compiles a function of `scalar` for AVX2 under the same name.
macro_rules! widened {
    ($($name:ident($($argument:ident: $kind:ty),*);)*) => {
        $(pub(super) fn $name(kernel: Kernel, $($argument: $kind),*) {
            #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
            fn wide($($argument: $kind),*) {
                scalar::$name($($argument),*);
            }
            debug_assert_eq!(kernel.0, Level::Avx2);
            // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it.
            unsafe { wide($($argument),*) }
        })*
    };
}

widened! {
    snap(rest_x: &[f64], rest_y: f64, displacement: &[[f32; 2]], scale: [f64; 2], x: &mut [i32], y: &mut [i32]);
    sound(cells: &CellRow<'_>, above: &[f32], below: &[f32], sound: &mut [bool]);
    bends(above: &CellRow<'_>, below: &CellRow<'_>, bends: &mut [f32]);
    crossings(lattice: &Lattice, rows: Range<u32>, x: &mut [f32], v: &mut [f32]);
    spans(spans: &mut Spans<'_>, u: &mut [f32], v: &mut [f32]);
}

/// Pixels of a group.
const LANES: usize = 8;
/// Rows of the source that are fetched ahead.
const AHEAD: usize = 4;

/// Bilinear samples, eight pixels a time; [`scalar::sample`] where 32-bit indices do not reach.
pub(super) fn sample(kernel: Kernel, packed: &Packed, u: &[f32], v: &[f32], channels: Channels, out: &mut [u8]) {
    debug_assert_eq!(kernel.0, Level::Avx2);
    assert!(u.len() == v.len() && out.len() == u.len() * channels.count(), "one place for each pixel");
    assert_eq!(packed.texels.len(), (packed.width + 1) * (packed.height + 1), "texels are padded on two sides");
    // Beyond, 128 times a place is not exact in f32, and an index may not fit 31 bits.
    if packed.width > 1 << 15 || packed.height > 1 << 15 {
        return scalar::sample(packed, u, v, channels, out);
    }
    // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it; the sizes are asserted above.
    unsafe {
        match (channels, packed.opaque) {
            (Channels::Rgb, true) => row::<3, true>(packed, u, v, out),
            (Channels::Rgb, false) => row::<3, false>(packed, u, v, out),
            (Channels::Rgba, true) => row::<4, true>(packed, u, v, out),
            (Channels::Rgba, false) => row::<4, false>(packed, u, v, out),
        }
    }
}

/// # Safety
/// The sizes are those that [`sample`] asserts.
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
unsafe fn row<const CHANNELS: usize, const OPAQUE: bool>(packed: &Packed, u: &[f32], v: &[f32], out: &mut [u8]) {
    let (us, u_rest) = u.as_chunks::<LANES>();
    let (vs, v_rest) = v.as_chunks::<LANES>();
    let whole = us.len() * LANES * CHANNELS;
    let (body, tail) = out.split_at_mut(whole);
    for ((u, v), out) in us.iter().zip(vs).zip(body.chunks_exact_mut(LANES * CHANNELS)) {
        // SAFETY: `packed` is passed on as it is; `out` has room for a group.
        unsafe { store::<CHANNELS>(group::<OPAQUE>(packed, u, v), out.as_mut_ptr()) };
    }
    if !tail.is_empty() {
        let (mut u, mut v, mut last) = ([0.0; LANES], [0.0; LANES], [0; LANES * 4]);
        u[..u_rest.len()].copy_from_slice(u_rest);
        v[..v_rest.len()].copy_from_slice(v_rest);
        // SAFETY: as above.
        unsafe { store::<CHANNELS>(group::<OPAQUE>(packed, &u, &v), last.as_mut_ptr()) };
        tail.copy_from_slice(&last[..tail.len()]);
    }
}

/// Writes eight RGBA pixels, without alpha when there are three channels.
///
/// # Safety
/// `out` has room for `8 * CHANNELS` bytes.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
unsafe fn store<const CHANNELS: usize>(pixels: __m256i, out: *mut u8) {
    // SAFETY: 32 bytes for four channels; 16 and 8 for three.
    unsafe {
        if CHANNELS == 4 {
            _mm256_storeu_si256(out.cast(), pixels);
        } else {
            // 12 bytes in each half, then these together.
            let drop = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1));
            let packed = _mm256_permutevar8x32_epi32(_mm256_shuffle_epi8(pixels, drop), _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 7, 7));
            _mm_storeu_si128(out.cast(), _mm256_castsi256_si128(packed));
            _mm_storel_epi64(out.add(16).cast(), _mm256_extracti128_si256::<1>(packed));
        }
    }
}

/// Eight pixels, RGBA.
///
/// # Safety
/// `packed.texels` holds `(width + 1) (height + 1)` texels, both sides at most 2^15.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
unsafe fn group<const OPAQUE: bool>(packed: &Packed, u: &[f32; LANES], v: &[f32; LANES]) -> __m256i {
    let stride = packed.stride();
    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "sides are at most 2^15")]
    let (last_x, last_y, step) = ((packed.width as i32 - 1) * 128, (packed.height as i32 - 1) * 128, stride as i32);
    let inside = |places: &[f32; LANES], last: i32| {
        // SAFETY: eight floats are loaded from eight floats.
        let places = unsafe { _mm256_loadu_ps(places.as_ptr()) };
        // The second operand is the result where the first is NaN.
        let places = _mm256_max_ps(places, _mm256_setzero_ps());
        _mm256_cvttps_epi32(_mm256_min_ps(places, _mm256_cvtepi32_ps(_mm256_set1_epi32(last))))
    };
    let (across, down) = (inside(u, last_x), inside(v, last_y));
    let at = _mm256_mullo_epi32(_mm256_srli_epi32::<7>(down), _mm256_set1_epi32(step));
    let at = _mm256_add_epi32(at, _mm256_srli_epi32::<7>(across));
    let mut index = [0_u32; LANES];
    // SAFETY: eight integers are stored into eight integers.
    unsafe { _mm256_storeu_si256(index.as_mut_ptr().cast(), at) };

    // A pair of texels left and right for each pixel: pixels 0, 1 | 4, 5 and 2, 3 | 6, 7 of the row above and the row below.
    let texels = packed.texels.as_ptr();
    let pair = |row: *const u32, a: usize, b: usize| {
        // SAFETY: U <= 128 (width - 1) and V <= 128 (height - 1), so a pixel's pair begins before the last column and row, which are padding.
        unsafe {
            let low = _mm_loadl_epi64(row.add(index[a] as usize).cast());
            _mm_castpd_si128(_mm_loadh_pd(_mm_castsi128_pd(low), row.add(index[b] as usize).cast()))
        }
    };
    let quad = |row: *const u32, first: usize| _mm256_set_m128i(pair(row, first + 4, first + 5), pair(row, first, first + 1));
    // SAFETY: the row below a pixel's exists, as above.
    let next = unsafe { texels.add(stride) };
    let rows = [quad(texels, 0), quad(texels, 2), quad(next, 0), quad(next, 2)];
    for k in [0, 4] {
        _mm_prefetch::<_MM_HINT_T0>(texels.wrapping_add(index[k] as usize + AHEAD * stride).cast());
    }

    if !OPAQUE {
        let common = _mm256_and_si256(_mm256_and_si256(rows[0], rows[1]), _mm256_and_si256(rows[2], rows[3]));
        // Alpha 255 is stored as 0x7f: its sign is clear and 0x7f000000 is reached.
        let full = _mm256_cmpgt_epi32(common, _mm256_set1_epi32(0x7eff_ffff));
        if _mm256_movemask_epi8(full) != -1 {
            let mut pixels = [[0_u8; 4]; LANES];
            for (pixel, (u, v)) in pixels.iter_mut().zip(u.iter().zip(v)) {
                *pixel = scalar::pixel(packed, *u, *v);
            }
            // SAFETY: 32 bytes are loaded from 32 bytes.
            return unsafe { _mm256_loadu_si256(pixels.as_ptr().cast()) };
        }
    }

    let fraction = _mm256_set1_epi32(127);
    let (fx, fy) = (_mm256_and_si256(across, fraction), _mm256_and_si256(down, fraction));
    let whole = _mm256_set1_epi32(128);
    // Pairs of weights (128 - f, f): bytes across, 16 bits down.
    let wx = _mm256_add_epi32(_mm256_sub_epi32(_mm256_slli_epi32::<8>(fx), fx), whole);
    let wy = _mm256_add_epi32(_mm256_sub_epi32(_mm256_slli_epi32::<16>(fy), fy), whole);
    let spread = |a: i8, b: i8| {
        let both = _mm_setr_epi8(a, a + 1, a, a + 1, a, a + 1, a, a + 1, b, b + 1, b, b + 1, b, b + 1, b, b + 1);
        _mm256_shuffle_epi8(wx, _mm256_broadcastsi128_si256(both))
    };
    let (wx_a, wx_b) = (spread(0, 4), spread(8, 12));
    let beside = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 4, 1, 5, 2, 6, 3, 7, 8, 12, 9, 13, 10, 14, 11, 15));
    // Across: the sum of w (t - 128), at most 2^14 either way.
    let blend = |pairs: __m256i, weights: __m256i| _mm256_maddubs_epi16(weights, _mm256_shuffle_epi8(pairs, beside));
    let (above_a, above_b) = (blend(rows[0], wx_a), blend(rows[1], wx_b));
    let (below_a, below_b) = (blend(rows[2], wx_a), blend(rows[3], wx_b));
    // Down: 128 * 128 * 128 gives back what was taken off each texel, 2^13 rounds.
    let bias = _mm256_set1_epi32((1 << 21) + (1 << 13));
    let mean = |pairs: __m256i, weights: __m256i| _mm256_srai_epi32::<14>(_mm256_add_epi32(_mm256_madd_epi16(pairs, weights), bias));
    let a = _mm256_packs_epi32(
        mean(_mm256_unpacklo_epi16(above_a, below_a), _mm256_shuffle_epi32::<0x00>(wy)),
        mean(_mm256_unpackhi_epi16(above_a, below_a), _mm256_shuffle_epi32::<0x55>(wy)),
    );
    let b = _mm256_packs_epi32(
        mean(_mm256_unpacklo_epi16(above_b, below_b), _mm256_shuffle_epi32::<0xaa>(wy)),
        mean(_mm256_unpackhi_epi16(above_b, below_b), _mm256_shuffle_epi32::<0xff>(wy)),
    );
    _mm256_packus_epi16(a, b)
}
