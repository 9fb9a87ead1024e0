//! AVX-512: the cells of `avx2_cells` with masks instead of blends: unpainted pixels are not
//! stored, and nothing is loaded where cells overwrite others. Everything else is `avx2`: wider
//! registers gain little or nothing (`notes.md`).

use std::arch::x86_64::*;

use super::Kernel;
use super::avx2_cells::{near, root};
use super::cells::{CellMap, LANES, Piece, Raster, UNCOVERED, column, line, reach};
use crate::level::SimdLevel;
use crate::render::snapped_grid::PX_PER_STEP;
use crate::render::snapped_grid::STEPS_PER_PX;

pub(super) use super::avx2::{
    bends, classify, classify_parts, crossings, edges, footprints, positions, sample, shapes,
    shrinks, snap, soundness, spans, steepness, unmark, y_ranges,
};

/// [`super::cells::fill`].
pub(super) fn fill(kernel: Kernel, piece: &Piece, rows: u32, raster: &mut Raster<'_>) {
    debug_assert!(kernel.0 >= SimdLevel::Avx512);
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

/// # Safety
/// Rows up to the last one of `rows` have room for `pitch` coordinates, and `pitch` for a block
/// behind the width.
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma,bmi1,bmi2")]
unsafe fn blocks<const OVER: bool>(piece: &Piece, rows: u32, raster: &mut Raster<'_>) {
    let (from, to) = reach(piece, raster.width);
    let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    let top = rows.trailing_zeros();
    let y0 = line(raster.first + top).wrapping_sub(piece.y);
    // Loops, not `map`, whose closures are not compiled for this level.
    let mut down = [_mm256_setzero_si256(); 4];
    for (down, [_, gy, _]) in down.iter_mut().zip(piece.edges) {
        *down = _mm256_set1_epi32(gy.wrapping_mul(STEPS_PER_PX));
    }
    let [u0, us, ut] = [
        _mm256_set1_ps(piece.u[0]),
        _mm256_set1_ps(piece.u[1]),
        _mm256_set1_ps(piece.u[2]),
    ];
    let [v0, vs, vt] = [
        _mm256_set1_ps(piece.v[0]),
        _mm256_set1_ps(piece.v[1]),
        _mm256_set1_ps(piece.v[2]),
    ];
    let coordinate = |at: __m256, s: __m256, t: __m256, per_s: __m256, per_t: __m256| {
        _mm256_add_ps(
            _mm256_add_ps(at, _mm256_mul_ps(s, per_s)),
            _mm256_mul_ps(t, per_t),
        )
    };
    for at in (from..to).step_by(LANES) {
        let x = column(at).wrapping_sub(piece.x);
        let mut inside = [_mm256_setzero_si256(); 4];
        for (inside, [gx, gy, g]) in inside.iter_mut().zip(piece.edges) {
            let first = gx
                .wrapping_mul(x)
                .wrapping_add(gy.wrapping_mul(y0))
                .wrapping_add(g);
            *inside = _mm256_add_epi32(
                _mm256_set1_epi32(first),
                _mm256_mullo_epi32(_mm256_set1_epi32(gx.wrapping_mul(STEPS_PER_PX)), lanes),
            );
        }
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
            if wanted {
                let outside = _mm256_or_si256(
                    _mm256_ternarylogic_epi32::<0xfe>(inside[0], inside[1], inside[2]),
                    inside[3],
                );
                let start = row * raster.pitch + at;
                // SAFETY: `at < width`, and there is room for a block behind the width.
                let (u, v) = unsafe {
                    (
                        raster.u.as_mut_ptr().add(start),
                        raster.v.as_mut_ptr().add(start),
                    )
                };
                let mut painted = !_mm256_movepi32_mask(outside);
                if !OVER {
                    // SAFETY: as above.
                    painted &= _mm256_cmp_ps_mask::<_CMP_EQ_OQ>(
                        unsafe { _mm256_loadu_ps(u) },
                        _mm256_set1_ps(UNCOVERED),
                    );
                }
                #[expect(clippy::cast_precision_loss, reason = "sides have at most 15 bits")]
                let y = y as f32 * PX_PER_STEP;
                let (s, t) = match &piece.map {
                    CellMap::Near(map) => near(map, px, y),
                    CellMap::Root(map) => root(map, px, y),
                };
                // SAFETY: as above.
                unsafe {
                    _mm256_mask_storeu_ps(u, painted, coordinate(u0, s, t, us, ut));
                    _mm256_mask_storeu_ps(v, painted, coordinate(v0, s, t, vs, vt));
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
