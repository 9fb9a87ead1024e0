//! The fast strip compiled for AVX2 and BMI2. No intrinsics: the compiler makes vectors of the filters and `shlx`, `shrx` of the shifts.
//! The check of the machine costs a few loads a strip.

use super::super::fast;
use super::super::rows::Rows;

/// The features of `fast_avx2`.
pub(super) fn is_available() -> bool {
    is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
}

pub(super) fn fast(rows: Rows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    if is_available() {
        // SAFETY: the machine has every feature that `fast_avx2` is compiled for; the function is safe otherwise.
        unsafe { fast_avx2(rows, last, most, out) }
    } else {
        fast::body(rows, last, most, out)
    }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
fn fast_avx2(rows: Rows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    fast::body(rows, last, most, out)
}
