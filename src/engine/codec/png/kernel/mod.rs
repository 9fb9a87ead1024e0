//! The one place where an instruction set is chosen. The code of the fast strip is written once, in portable Rust (`fast::body`), and compiled with
//! more instructions: AVX2 doubles the width of the filters, BMI2 turns the shifts of the coding loop, whose counts are data, into single
//! operations. AVX-512 has a way of its own to look residuals up, to the same bits, so all levels give the same bytes.

use super::fast;
use super::rows::Rows;
use crate::level::Level;

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "calls a function compiled for instructions that were detected")]
mod avx2;
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "AVX-512 intrinsics behind run-time detection")]
mod avx512;

/// `fast::body` at a level; a level that the machine lacks is scalar.
pub(super) fn fast(level: Level, rows: Rows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 if level.is_here() => avx2::fast(rows, last, most, out),
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 if level.is_here() => avx512::fast(rows, last, most, out),
        _ => fast::body::<fast::Portable>(rows, last, most, out),
    }
}
