//! AVX2: the scalar loops compiled again for wide registers, and a hand-written bilinear sampler
//! with the integers of `scalar`. Public functions take a [`Kernel`] as proof that the machine has
//! the level.

use std::arch::x86_64::*;
use std::ops::Range;

use super::Kernel;
use super::cell_block::CellBlock;
use super::cells::Raster;
use super::footprints::{Alike, FootprintBatch, FootprintGrid};
use super::scalar::{self, CellRow, Edges, NOTES, Neighbours, Spans};
use crate::level::SimdLevel;
use crate::pixmap::Channels;
use crate::render::snapped_grid::{BLOCK_COLUMNS, Corner, PX_PER_STEP, SnappedGrid, YRange};
use crate::render::source::Packed;

/// Compiles a function of `scalar` for AVX2 under the same name.
macro_rules! widened {
    ($($name:ident($($argument:ident: $kind:ty),*);)*) => {
        $(pub(super) fn $name(kernel: Kernel, $($argument: $kind),*) {
            #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
            fn wide($($argument: $kind),*) {
                scalar::$name($($argument),*);
            }
            debug_assert!(kernel.0 >= SimdLevel::Avx2);
            // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it.
            unsafe { wide($($argument),*) }
        })*
    };
}

widened! {
    snap(rest_x: &[f64], rest_y: f64, displacement: &[[f32; 2]], scale: [f64; 2], x: &mut [i32],
        y: &mut [i32]);
    y_ranges(y: &[i32], y_ranges: &mut [YRange]);
    edges(from: (&[i32], &[i32]), to: (&[i32], &[i32]), scale: f32, edges: &mut Edges);
    soundness(cells: &Neighbours<'_>, soundness: &mut [u8]);
    steepness(cells: &CellRow<'_>, above: &[f32], below: &[f32], soundness: &mut [u8]);
    bends(above: &CellRow<'_>, below: &CellRow<'_>, bends: &mut [f32]);
    shrinks(lines: (&[[f32; 2]], &[[f32; 2]]), per: [f32; 2], least: f32, shrinking: &mut [u8]);
    footprints(grid: &FootprintGrid, places: (&[f32], &[f32]), len: usize, first: usize,
        batch: &mut FootprintBatch);
    shapes(grid: &FootprintGrid, batch: &mut FootprintBatch);
    unmark(lines: (&[[f32; 4]], &[[f32; 4]]), limit: f32, marked: &mut [u8]);
    positions(alike: &Alike, log: u32, u: &mut [f32], v: &mut [f32]);
    classify(lattice: &SnappedGrid, j: usize, b: usize, raster: &Raster<'_>, seen: &mut CellBlock);
    classify_parts(parts: &[[Corner; 4]; BLOCK_COLUMNS], lattice: &SnappedGrid,
        raster: &Raster<'_>, seen: &mut CellBlock);
}

/// Pixels of a group, and columns of a block.
const LANES: usize = 8;
const _: () = assert!(
    LANES == BLOCK_COLUMNS,
    "a block of columns fills a register"
);

/// Crossings of columns with rows: [`scalar::crossings`], with a block of columns in registers for
/// all rows that it reaches.
pub(super) fn crossings(
    kernel: Kernel,
    lattice: &SnappedGrid,
    rows: Range<u32>,
    x: &mut [f32],
    v: &mut [f32],
) {
    debug_assert!(kernel.0 >= SimdLevel::Avx2);
    // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it.
    unsafe { wide_crossings(lattice, &rows, x, v) }
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
fn wide_crossings(lattice: &SnappedGrid, rows: &Range<u32>, x: &mut [f32], v: &mut [f32]) {
    let blocks = lattice.pitch / BLOCK_COLUMNS;
    let stride = lattice.pitch + BLOCK_COLUMNS;
    for j in (0..lattice.rows - 1).filter(|&j| lattice.row_ranges[j].meets(rows)) {
        let (top, fall) = (
            _mm256_set1_ps(lattice.v[j]),
            _mm256_set1_ps(lattice.v[j + 1] - lattice.v[j]),
        );
        let above = j * lattice.pitch..(j + 1) * lattice.pitch;
        let below = above.end..above.end + lattice.pitch;
        let lines = lattice.x[above.clone()]
            .as_chunks()
            .0
            .iter()
            .zip(lattice.y[above].as_chunks().0);
        let lines = lines.zip(
            lattice.x[below.clone()]
                .as_chunks()
                .0
                .iter()
                .zip(lattice.y[below].as_chunks().0),
        );
        for ((b, range), ((xa, ya), (xb, yb))) in lattice.block_ranges[j * blocks..(j + 1) * blocks]
            .iter()
            .enumerate()
            .zip(lines)
        {
            let touched = range.rows(rows);
            if touched.is_empty() {
                continue;
            }
            let (x0, y0, x1, y1) = (px(xa), px(ya), px(xb), px(yb));
            let per_px = _mm256_div_ps(_mm256_set1_ps(1.0), _mm256_sub_ps(y1, y0));
            let slope_x = _mm256_mul_ps(_mm256_sub_ps(x1, x0), per_px);
            let slope_v = _mm256_mul_ps(fall, per_px);
            for row in touched {
                let at = (row - rows.start) as usize * stride + b * BLOCK_COLUMNS;
                let centre = _mm256_set1_ps(scalar::centre(row));
                let below = _mm256_sub_ps(centre, y0);
                let starts = _mm256_cmp_ps::<_CMP_GE_OQ>(below, _mm256_setzero_ps());
                let crosses = _mm256_and_ps(starts, _mm256_cmp_ps::<_CMP_LT_OQ>(centre, y1));
                let (x, v) = (first_of(&mut x[at..]), first_of(&mut v[at..]));
                let x_new = _mm256_add_ps(x0, _mm256_mul_ps(below, slope_x));
                let v_new = _mm256_add_ps(top, _mm256_mul_ps(below, slope_v));
                // Adds to zeros: a blend would be compiled to a masked store, which takes ten times
                // as long on some machines.
                put(x, _mm256_or_ps(get(x), _mm256_and_ps(x_new, crosses)));
                put(v, _mm256_or_ps(get(v), _mm256_and_ps(v_new, crosses)));
            }
        }
    }
}

fn first_of<T>(values: &mut [T]) -> &mut [T; LANES] {
    values.first_chunk_mut().expect("a row has all blocks")
}

fn block_of<T>(values: &[T]) -> &[T; LANES] {
    values.first_chunk().expect("a row has all blocks")
}

#[inline]
#[target_feature(enable = "avx2")]
fn get(values: &[f32; LANES]) -> __m256 {
    // SAFETY: eight floats are loaded from eight floats.
    unsafe { _mm256_loadu_ps(values.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn put(values: &mut [f32; LANES], lanes: __m256) {
    // SAFETY: eight floats are stored into eight floats.
    unsafe { _mm256_storeu_ps(values.as_mut_ptr(), lanes) }
}

/// Lattice steps to px.
#[inline]
#[target_feature(enable = "avx2")]
fn px(places: &[i32; LANES]) -> __m256 {
    // SAFETY: eight integers are loaded from eight integers.
    let places = unsafe { _mm256_loadu_si256(places.as_ptr().cast()) };
    _mm256_mul_ps(_mm256_cvtepi32_ps(places), _mm256_set1_ps(PX_PER_STEP))
}

/// [`scalar::note`].
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
fn note(spans: &mut Spans<'_>) {
    #[expect(
        clippy::cast_precision_loss,
        reason = "rows are shorter than 2^22 pixels where columns are used"
    )]
    let width = _mm256_set1_ps(spans.width as f32);
    let (one, half, round) = (
        _mm256_set1_ps(1.0),
        _mm256_set1_ps(0.5),
        _mm256_set1_ps(scalar::ROUND_F32),
    );
    let notes = spans
        .notes
        .as_chunks_mut::<NOTES>()
        .0
        .iter_mut()
        .zip(spans.first.as_chunks_mut::<BLOCK_COLUMNS>().0);
    for (b, ([nu, ndu, nv, ndv], first)) in notes
        .enumerate()
        .take(spans.columns.div_ceil(BLOCK_COLUMNS))
    {
        let at = b * BLOCK_COLUMNS;
        let pair = |values: &[f32]| {
            (
                get(block_of(&values[at..])),
                get(block_of(&values[at + 1..])),
            )
        };
        let ((x0, x1), (v0, v1), (u0, u1)) = (pair(spans.x), pair(spans.v), pair(spans.u));
        // NaN becomes 0, as the second operand.
        let kept = _mm256_min_ps(_mm256_max_ps(x0, _mm256_setzero_ps()), width);
        let rounded = _mm256_add_ps(kept, round);
        let pixel = _mm256_and_si256(_mm256_castps_si256(rounded), _mm256_set1_epi32(0x007f_ffff));
        let per_px = _mm256_div_ps(one, _mm256_sub_ps(x1, x0));
        let (du, dv) = (
            _mm256_mul_ps(_mm256_sub_ps(u1, u0), per_px),
            _mm256_mul_ps(_mm256_sub_ps(v1, v0), per_px),
        );
        let inside = _mm256_sub_ps(_mm256_add_ps(_mm256_sub_ps(rounded, round), half), x0);
        put(nu, _mm256_add_ps(u0, _mm256_mul_ps(inside, du)));
        put(nv, _mm256_add_ps(v0, _mm256_mul_ps(inside, dv)));
        put(ndu, du);
        put(ndv, dv);
        // SAFETY: eight integers are stored into eight integers.
        unsafe { _mm256_storeu_si256(first.as_mut_ptr().cast(), pixel) };
    }
    scalar::pin_ends(spans);
}

/// Coordinates along a row: [`note`], then eight pixels at a time. A span always writes its first
/// group: values beyond its end belong to a later span, which overwrites them, or lie outside the
/// covered run.
pub(super) fn spans(kernel: Kernel, spans: &mut Spans<'_>, u: &mut [f32], v: &mut [f32]) {
    #[target_feature(enable = "avx2,fma,bmi1,bmi2")]
    unsafe fn wide(spans: &mut Spans<'_>, u: &mut [f32], v: &mut [f32]) {
        note(spans);
        let lanes = _mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0);
        let (u, v) = (u.as_mut_ptr(), v.as_mut_ptr());
        let blocks = spans.notes.as_chunks::<NOTES>().0.iter().zip(
            spans
                .first
                .windows(BLOCK_COLUMNS + 1)
                .step_by(BLOCK_COLUMNS),
        );
        let mut cells = spans.columns - 1;
        for ([nu, ndu, nv, ndv], first) in blocks.take(cells.div_ceil(BLOCK_COLUMNS)) {
            for c in 0..cells.min(BLOCK_COLUMNS) {
                let (mut at, end) = (first[c] as usize, first[c + 1] as usize);
                let (nu, ndu, nv, ndv) = (
                    _mm256_set1_ps(nu[c]),
                    _mm256_set1_ps(ndu[c]),
                    _mm256_set1_ps(nv[c]),
                    _mm256_set1_ps(ndv[c]),
                );
                let mut k = lanes;
                loop {
                    // SAFETY: `note` keeps `first` at or below the width, as the asserted range at
                    // the ends is; so `at < end <= width` after the first group, and there is room
                    // for a group behind the row.
                    unsafe {
                        _mm256_storeu_ps(u.add(at), _mm256_add_ps(nu, _mm256_mul_ps(k, ndu)));
                        _mm256_storeu_ps(v.add(at), _mm256_add_ps(nv, _mm256_mul_ps(k, ndv)));
                    }
                    at += LANES;
                    if at >= end {
                        break;
                    }
                    k = _mm256_add_ps(k, _mm256_set1_ps(8.0));
                }
            }
            cells -= cells.min(BLOCK_COLUMNS);
        }
    }
    debug_assert!(kernel.0 >= SimdLevel::Avx2);
    assert!(spans.width <= 1 << 22, "pixels are exact in f32");
    assert!(
        spans.covered.start <= spans.width && spans.covered.end <= spans.width,
        "what is covered lies in the row"
    );
    assert!(
        u.len() >= spans.width + LANES && v.len() >= spans.width + LANES,
        "a group may end behind the row"
    );
    // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it; the room
    // is asserted above.
    unsafe { wide(spans, u, v) }
}

pub(super) use super::avx2_cells::fill;

/// Rows of the source that are prefetched.
const PREFETCHED_ROWS: usize = 4;

/// Bilinear samples, eight pixels at a time; [`scalar::sample`] where 32-bit indices are too small.
pub(super) fn sample(
    kernel: Kernel,
    packed: &Packed,
    u: &[f32],
    v: &[f32],
    channels: Channels,
    out: &mut [u8],
) {
    debug_assert!(kernel.0 >= SimdLevel::Avx2);
    assert!(
        u.len() == v.len() && out.len() == u.len() * channels.count(),
        "one place for each pixel"
    );
    assert_eq!(
        packed.texels.len(),
        (packed.width + 1) * (packed.height + 1),
        "texels are padded on two sides"
    );
    // Beyond this, 128 times a coordinate is inexact in f32, and an index may not fit 31 bits.
    if packed.width > 1 << 15 || packed.height > 1 << 15 {
        return scalar::sample(packed, u, v, channels, out);
    }
    // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it; the
    // sizes are asserted above.
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
unsafe fn row<const CHANNELS: usize, const OPAQUE: bool>(
    packed: &Packed,
    u: &[f32],
    v: &[f32],
    out: &mut [u8],
) {
    // Computes the positions of a chunk first and fetches texels afterwards, so that fetches only
    // wait for each other.
    let mut places = [Places {
        index: [0; LANES],
        fractions: [0; LANES],
    }; CHUNK_GROUPS];
    let (us, u_rest) = u.as_chunks::<LANES>();
    let (vs, v_rest) = v.as_chunks::<LANES>();
    let (body, tail) = out.split_at_mut(us.len() * LANES * CHANNELS);
    for ((us, vs), out) in us
        .chunks(CHUNK_GROUPS)
        .zip(vs.chunks(CHUNK_GROUPS))
        .zip(body.chunks_mut(CHUNK_GROUPS * LANES * CHANNELS))
    {
        for ((places, u), v) in places.iter_mut().zip(us).zip(vs) {
            locate(packed, u, v, places);
        }
        for (places, out) in places.iter().zip(out.chunks_exact_mut(LANES * CHANNELS)) {
            // SAFETY: the places are in the image, as `locate` makes them; `out` has room for a
            // group.
            unsafe { store::<CHANNELS>(group::<OPAQUE>(packed, places), out.as_mut_ptr()) };
        }
    }
    if !tail.is_empty() {
        let (mut u, mut v, mut last) = ([0.0; LANES], [0.0; LANES], [0; LANES * 4]);
        u[..u_rest.len()].copy_from_slice(u_rest);
        v[..v_rest.len()].copy_from_slice(v_rest);
        locate(packed, &u, &v, &mut places[0]);
        // SAFETY: as above.
        unsafe { store::<CHANNELS>(group::<OPAQUE>(packed, &places[0]), last.as_mut_ptr()) };
        tail.copy_from_slice(&last[..tail.len()]);
    }
}

/// Groups that are located before they are fetched.
const CHUNK_GROUPS: usize = 8;

/// Sampling positions of eight pixels: the upper left texel, and fx and fy in 16 bits each.
#[derive(Clone, Copy)]
struct Places {
    index: [u32; LANES],
    fractions: [u32; LANES],
}

/// Sampling positions of eight pixels, clamped to the image.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
fn locate(packed: &Packed, u: &[f32; LANES], v: &[f32; LANES], places: &mut Places) {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "sides are at most 2^15"
    )]
    let (last_x, last_y, stride) = (
        (packed.width as i32 - 1) * 128,
        (packed.height as i32 - 1) * 128,
        packed.stride() as i32,
    );
    let inside = |places: &[f32; LANES], last: i32| {
        // The second operand is the result where the first is NaN.
        let kept = _mm256_max_ps(get(places), _mm256_setzero_ps());
        _mm256_cvttps_epi32(_mm256_min_ps(
            kept,
            _mm256_cvtepi32_ps(_mm256_set1_epi32(last)),
        ))
    };
    let (across, down) = (inside(u, last_x), inside(v, last_y));
    let index = _mm256_mullo_epi32(_mm256_srli_epi32::<7>(down), _mm256_set1_epi32(stride));
    let index = _mm256_add_epi32(index, _mm256_srli_epi32::<7>(across));
    // The low half of each lane comes from `across`, the high half from `down`; integer parts are
    // dropped.
    let fractions = _mm256_blend_epi16::<0b1010_1010>(across, _mm256_slli_epi32::<16>(down));
    let fractions = _mm256_and_si256(fractions, _mm256_set1_epi16(127));
    // SAFETY: eight integers are stored into eight integers, twice.
    unsafe {
        _mm256_storeu_si256(places.index.as_mut_ptr().cast(), index);
        _mm256_storeu_si256(places.fractions.as_mut_ptr().cast(), fractions);
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
            // 12 bytes in each half, then joined.
            let drop = _mm256_broadcastsi128_si256(_mm_setr_epi8(
                0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1,
            ));
            let packed = _mm256_permutevar8x32_epi32(
                _mm256_shuffle_epi8(pixels, drop),
                _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 7, 7),
            );
            _mm_storeu_si128(out.cast(), _mm256_castsi256_si128(packed));
            _mm_storel_epi64(out.add(16).cast(), _mm256_extracti128_si256::<1>(packed));
        }
    }
}

/// The two bytes from `a` on and those from `b` on of each half, four times each: the weights of
/// two pixels beside each of their four samples.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
fn spread(weights: __m256i, a: i8, b: i8) -> __m256i {
    let (a1, b1) = (a + 1, b + 1);
    let both = _mm_setr_epi8(a, a1, a, a1, a, a1, a, a1, b, b1, b, b1, b, b1, b, b1);
    _mm256_shuffle_epi8(weights, _mm256_broadcastsi128_si256(both))
}

/// Eight pixels, RGBA.
///
/// # Safety
/// `packed.texels` holds `(width + 1) (height + 1)` texels, and `places` is what [`locate`] made
/// for it.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
unsafe fn group<const OPAQUE: bool>(packed: &Packed, places: &Places) -> __m256i {
    let (stride, index) = (packed.stride(), &places.index);
    // A left and right texel for each pixel: pixels 0, 1 | 4, 5 and 2, 3 | 6, 7 of the upper and
    // the lower row.
    let texels = packed.texels.as_ptr();
    let pair = |row: *const u32, a: usize, b: usize| {
        // SAFETY: U <= 128 (width - 1) and V <= 128 (height - 1), so a pixel's pair begins before
        // the last column and row, which are padding.
        unsafe {
            let low = _mm_loadl_epi64(row.add(index[a] as usize).cast());
            _mm_castpd_si128(_mm_loadh_pd(
                _mm_castsi128_pd(low),
                row.add(index[b] as usize).cast(),
            ))
        }
    };
    let quad = |row: *const u32, first: usize| {
        _mm256_set_m128i(pair(row, first + 4, first + 5), pair(row, first, first + 1))
    };
    // SAFETY: the row below a pixel's exists, as above.
    let next = unsafe { texels.add(stride) };
    let rows = [
        quad(texels, 0),
        quad(texels, 2),
        quad(next, 0),
        quad(next, 2),
    ];
    for k in [0, 4] {
        _mm_prefetch::<_MM_HINT_T0>(
            texels
                .wrapping_add(index[k] as usize + PREFETCHED_ROWS * stride)
                .cast(),
        );
    }

    if !OPAQUE {
        // Alpha 255 is stored as 127, the maximum: the minimum of all is 127 only if each is.
        let least = _mm256_min_epi8(
            _mm256_min_epi8(rows[0], rows[1]),
            _mm256_min_epi8(rows[2], rows[3]),
        );
        let full = _mm256_cmpgt_epi32(least, _mm256_set1_epi32(0x7eff_ffff));
        if _mm256_movemask_epi8(full) != -1 {
            let mut pixels = [[0_u8; 4]; LANES];
            for ((pixel, index), fractions) in pixels.iter_mut().zip(index).zip(places.fractions) {
                *pixel = scalar::blend(
                    packed,
                    *index as usize,
                    u64::from(fractions & 127),
                    u64::from(fractions >> 16),
                );
            }
            // SAFETY: 32 bytes are loaded from 32 bytes.
            return unsafe { _mm256_loadu_si256(pixels.as_ptr().cast()) };
        }
    }

    // SAFETY: eight integers are loaded from eight integers.
    let fractions = unsafe { _mm256_loadu_si256(places.fractions.as_ptr().cast()) };
    // Per pixel: bytes 128 - fx and fx, from 255 fx + 128, and 256 fy in 16 bits.
    let weights = _mm256_mullo_epi16(fractions, _mm256_set1_epi32(256 << 16 | 255));
    let weights = _mm256_add_epi16(weights, _mm256_set1_epi32(128));
    let (wx_a, wx_b) = (spread(weights, 0, 4), spread(weights, 8, 12));
    let (wy_a, wy_b) = (spread(weights, 2, 6), spread(weights, 10, 14));
    let beside = _mm256_broadcastsi128_si256(_mm_setr_epi8(
        0, 4, 1, 5, 2, 6, 3, 7, 8, 12, 9, 13, 10, 14, 11, 15,
    ));
    // Across: the sum of w (t - 128), absolute value at most 2^14.
    let blend = |pairs: __m256i, weights: __m256i| {
        _mm256_maddubs_epi16(weights, _mm256_shuffle_epi8(pairs, beside))
    };
    let (above_a, above_b) = (blend(rows[0], wx_a), blend(rows[1], wx_b));
    let (below_a, below_b) = (blend(rows[2], wx_a), blend(rows[3], wx_b));
    // Down: above + (below - above) f / 128, rounded to nearest by 2^6; then 2^14 for the 128
    // subtracted from each texel, and 2^6 to round.
    let bias = _mm256_set1_epi16((1 << 14) + (1 << 6));
    let mean = |above: __m256i, below: __m256i, weights: __m256i| {
        let step = _mm256_mulhrs_epi16(_mm256_sub_epi16(below, above), weights);
        _mm256_srai_epi16::<7>(_mm256_add_epi16(_mm256_add_epi16(above, step), bias))
    };
    _mm256_packus_epi16(mean(above_a, below_a, wy_a), mean(above_b, below_b, wy_b))
}
