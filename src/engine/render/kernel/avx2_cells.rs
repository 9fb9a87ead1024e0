//! AVX2: `cells::fill` for eight pixels of a row at a time, by blocks of columns and then by rows.
//! The same operations in the same order.

use std::arch::x86_64::*;

use super::Kernel;
use super::cells::{CellMap, LANES, Near, Piece, Raster, Root, UNCOVERED, column, line, reach};
use crate::level::SimdLevel;
use crate::render::snapped_grid::PX_PER_STEP;
use crate::render::snapped_grid::STEPS_PER_PX;

/// [`super::cells::fill`].
pub(super) fn fill(kernel: Kernel, piece: &Piece, rows: u32, raster: &mut Raster<'_>) {
    debug_assert!(kernel.0 >= SimdLevel::Avx2);
    let (from, to) = reach(piece, raster.width);
    if rows == 0 || from >= to {
        return;
    }
    // A block may begin at the last pixel.
    let end = (u32::BITS - rows.leading_zeros()) as usize * raster.pitch;
    assert!(
        raster.width + LANES <= raster.pitch && end <= raster.u.len() && end <= raster.v.len(),
        "a block may end behind the row"
    );
    // SAFETY: a `Kernel` of this level is only made where the machine was seen to have it; the room
    // is asserted above.
    unsafe {
        if raster.over {
            blocks::<true>(piece, rows, raster)
        } else {
            blocks::<false>(piece, rows, raster)
        }
    }
}

/// s and t at px (x, y) from the origin.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn near(map: &Near, x: __m256, y: f32) -> (__m256, __m256) {
    let affine = |of: &[f32; 3]| {
        _mm256_add_ps(
            _mm256_set1_ps(of[1] * y + of[2]),
            _mm256_mul_ps(_mm256_set1_ps(of[0]), x),
        )
    };
    let (s0, t0) = (affine(&map.s), affine(&map.t));
    let off = |lanes: __m256, both: __m256, twist: f32| {
        _mm256_sub_ps(lanes, _mm256_mul_ps(both, _mm256_set1_ps(twist)))
    };
    let once = _mm256_mul_ps(s0, t0);
    let twice = _mm256_mul_ps(off(s0, once, map.twist[0]), off(t0, once, map.twist[1]));
    (off(s0, twice, map.twist[0]), off(t0, twice, map.twist[1]))
}

/// s and t at px (x, y) from the origin.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn root(map: &Root, x: __m256, y: f32) -> (__m256, __m256) {
    let all = |value: f32| _mm256_set1_ps(value);
    let times = |value: f32, lanes: __m256| _mm256_mul_ps(all(value), lanes);
    let ([ex, ey], [fx, fy], [dx, dy]) = (map.e, map.f, map.d);
    let b = _mm256_add_ps(all(map.area - y * dx), times(dy, x));
    let c = _mm256_sub_ps(times(ey, x), all(y * ex));
    let under = _mm256_sub_ps(_mm256_mul_ps(b, b), times(4.0 * map.bend, c));
    let m = times(
        map.sign,
        _mm256_sqrt_ps(_mm256_max_ps(under, _mm256_setzero_ps())),
    );
    let same = _mm256_cmp_ps::<_CMP_GE_OQ>(_mm256_mul_ps(b, m), _mm256_setzero_ps());
    let over = _mm256_blendv_ps(_mm256_sub_ps(m, b), times(-2.0, c), same);
    let t = within(_mm256_div_ps(
        over,
        _mm256_blendv_ps(all(2.0 * map.bend), _mm256_add_ps(b, m), same),
    ));
    let (along_x, along_y) = (
        _mm256_add_ps(all(ex), times(dx, t)),
        _mm256_add_ps(all(ey), times(dy, t)),
    );
    let (rest_x, rest_y) = (
        _mm256_sub_ps(x, times(fx, t)),
        _mm256_sub_ps(all(y), times(fy, t)),
    );
    let positive = |lanes: __m256| _mm256_andnot_ps(all(-0.0), lanes);
    let wide = _mm256_cmp_ps::<_CMP_GT_OQ>(positive(along_x), positive(along_y));
    let s = _mm256_div_ps(
        _mm256_blendv_ps(rest_y, rest_x, wide),
        _mm256_blendv_ps(along_y, along_x, wide),
    );
    (within(s), t)
}

/// Clamps to [0, 1]; NaN becomes 0, as the first operand.
#[inline]
#[target_feature(enable = "avx2")]
fn within(share: __m256) -> __m256 {
    _mm256_min_ps(
        _mm256_max_ps(share, _mm256_setzero_ps()),
        _mm256_set1_ps(1.0),
    )
}

/// # Safety
/// Rows up to the last one of `rows` have room for `pitch` coordinates, and `pitch` for a block
/// behind the width.
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
unsafe fn blocks<const OVER: bool>(piece: &Piece, rows: u32, raster: &mut Raster<'_>) {
    let (from, to) = reach(piece, raster.width);
    let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    let top = rows.trailing_zeros();
    let y0 = line(raster.first + top).wrapping_sub(piece.y);
    let down = piece
        .edges
        .map(|[_, gy, _]| _mm256_set1_epi32(gy.wrapping_mul(STEPS_PER_PX)));
    let [[u0, us, ut], [v0, vs, vt]] =
        [piece.u, piece.v].map(|axis| axis.map(|value| _mm256_set1_ps(value)));
    let coordinate = |at: __m256, s: __m256, t: __m256, per_s: __m256, per_t: __m256| {
        _mm256_add_ps(
            _mm256_add_ps(at, _mm256_mul_ps(s, per_s)),
            _mm256_mul_ps(t, per_t),
        )
    };
    for at in (from..to).step_by(LANES) {
        let x = column(at).wrapping_sub(piece.x);
        let mut inside = piece.edges.map(|[gx, gy, g]| {
            let first = gx
                .wrapping_mul(x)
                .wrapping_add(gy.wrapping_mul(y0))
                .wrapping_add(g);
            _mm256_add_epi32(
                _mm256_set1_epi32(first),
                _mm256_mullo_epi32(_mm256_set1_epi32(gx.wrapping_mul(STEPS_PER_PX)), lanes),
            )
        });
        #[expect(clippy::cast_precision_loss, reason = "sides have at most 15 bits")]
        let px = _mm256_add_ps(
            _mm256_set1_ps(x as f32 * PX_PER_STEP),
            _mm256_cvtepi32_ps(lanes),
        );
        let (mut left, mut y, mut row) = (rows >> top, y0, top as usize);
        while left != 0 {
            // Skips painted blocks, because many cells may overlap.
            let wanted = left & 1 == 1
                && (OVER
                    || at < raster.uncovered[row].end && at + LANES > raster.uncovered[row].start);
            let outside = _mm256_or_si256(
                _mm256_or_si256(inside[0], inside[1]),
                _mm256_or_si256(inside[2], inside[3]),
            );
            let start = row * raster.pitch + at;
            // SAFETY: `at < width`, and there is room for a block behind the width.
            let (u, v) = unsafe {
                (
                    raster.u.as_mut_ptr().add(start),
                    raster.v.as_mut_ptr().add(start),
                )
            };
            // SAFETY: as above.
            let (u_old, v_old) = unsafe { (_mm256_loadu_ps(u), _mm256_loadu_ps(v)) };
            let mut kept = _mm256_castsi256_ps(_mm256_srai_epi32::<31>(outside));
            if !OVER {
                kept = _mm256_or_ps(
                    kept,
                    _mm256_cmp_ps::<_CMP_NEQ_UQ>(u_old, _mm256_set1_ps(UNCOVERED)),
                );
            }
            if wanted {
                #[expect(clippy::cast_precision_loss, reason = "sides have at most 15 bits")]
                let y = y as f32 * PX_PER_STEP;
                let (s, t) = match &piece.map {
                    CellMap::Near(map) => near(map, px, y),
                    CellMap::Root(map) => root(map, px, y),
                };
                let u_new = coordinate(u0, s, t, us, ut);
                let v_new = coordinate(v0, s, t, vs, vt);
                // SAFETY: as above.
                unsafe {
                    _mm256_storeu_ps(u, _mm256_blendv_ps(u_new, u_old, kept));
                    _mm256_storeu_ps(v, _mm256_blendv_ps(v_new, v_old, kept));
                }
            }
            for (inside, down) in inside.iter_mut().zip(down) {
                *inside = _mm256_add_epi32(*inside, down);
            }
            left >>= 1;
            y = y.wrapping_add(STEPS_PER_PX);
            row += 1;
        }
    }
}
