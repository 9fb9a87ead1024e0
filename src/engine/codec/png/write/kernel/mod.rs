//! Chooses the instruction set of the fast strip. Its code is portable Rust (`fast::body`),
//! compiled again with more instructions: AVX2 doubles the width of the filters, and BMI2 makes the
//! shifts of the coding loop, whose counts are data, single instructions. AVX-512 looks residuals
//! up in its own way. All levels give the same bytes.

use super::fast;
use super::rows::StripRows;
use super::stored;
use crate::level::SimdLevel;

#[cfg(target_arch = "x86_64")]
#[expect(
    unsafe_code,
    reason = "calls a function compiled for instructions that were detected"
)]
mod avx2;
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "AVX-512 intrinsics behind run-time detection")]
mod avx512;

/// Appends the deflate blocks of one strip, ended on a byte; returns the Adler-32 of the filtered
/// rows. A level that the machine lacks is scalar.
pub(super) fn encode_fast(
    level: SimdLevel,
    rows: StripRows<'_>,
    last: bool,
    out: &mut Vec<u8>,
) -> u32 {
    let start = out.len();
    let filtered = rows.filtered_len();
    let most = start
        + filtered
        + usize::try_from(stored::overhead(filtered as u64))
            .expect("less than the rows themselves");
    out.reserve(filtered / 8 * 5 + 1024);
    let coded = match level {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 if level.is_supported() => avx2::fast(rows, last, most, out),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 if level.is_supported() => avx512::fast(rows, last, most, out),
        _ => fast::body::<fast::Portable>(rows, last, most, out),
    };
    coded.unwrap_or_else(|| {
        out.truncate(start);
        stored::encode(rows, last, out)
    })
}
