//! The one place where an instruction set is chosen. The code of the fast strip is written once, in portable Rust (`fast::body`), and compiled with
//! more instructions: AVX2 doubles the width of the filters, BMI2 turns the shifts of the coding loop, whose counts are data, into single
//! operations. AVX-512 has a way of its own to look residuals up, to the same bits, so all levels give the same bytes.

use super::fast;
use super::rows::Rows;
use super::stored;
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

/// Appends the deflate blocks of one strip, ended on a byte; returns the Adler-32 of the filtered rows.
pub(super) fn encode_fast(level: Level, rows: Rows<'_>, last: bool, out: &mut Vec<u8>) -> u32 {
    let start = out.len();
    let filtered = rows.filtered_len();
    let most = filtered + usize::try_from(stored::overhead(filtered as u64)).expect("less than the rows themselves");
    out.reserve(filtered / 8 * 5 + 1024);
    fast(level, rows, last, start + most, out).unwrap_or_else(|| {
        out.truncate(start);
        stored::encode(rows, last, out)
    })
}
