//! The fast strip compiled for AVX2 and BMI2. No intrinsics: the compiler makes vectors of the
//! filters and `shlx`, `shrx` of the shifts.

use super::super::coder::{CodeBuffer, Lookup, Tables, code_piece};
use super::super::fast;
use super::super::rows::StripRows;
use crate::codec::bits::BitWriter;

/// Must be called where [`crate::level::SimdLevel::Avx2`] is supported.
pub(super) fn fast(rows: StripRows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    // SAFETY: the one caller asks `SimdLevel::is_supported` first, which covers every feature of
    // `fast_avx2`.
    unsafe { fast_avx2(rows, last, most, out) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn fast_avx2(rows: StripRows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    fast::body::<Avx2>(rows, last, most, out)
}

/// Made by `fast_avx2` only.
struct Avx2;

impl fast::FastKernel for Avx2 {
    #[inline(always)]
    fn piece<L: Lookup>(
        piece: &[u8],
        tables: Tables<'_, L>,
        stage: &mut CodeBuffer,
        bits: &mut BitWriter,
        out: &mut Vec<u8>,
    ) {
        // SAFETY: only `fast_avx2` names this type.
        unsafe { piece_avx2(piece, tables, stage, bits, out) }
    }
}

#[inline(never)]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn piece_avx2<L: Lookup>(
    piece: &[u8],
    tables: Tables<'_, L>,
    stage: &mut CodeBuffer,
    bits: &mut BitWriter,
    out: &mut Vec<u8>,
) {
    code_piece(piece, tables, stage, bits, out);
}
