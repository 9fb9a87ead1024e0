//! Chooses the instruction set of a strip. The strip is written once (`strip::encode`), over
//! [`I16Lanes`](super::lanes::I16Lanes) of 16-bit integers; every level has the same operations on
//! more or fewer lanes, so all of them give the same bytes.

use super::strip::{self, Job};
use crate::level::SimdLevel;

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "AVX2 intrinsics behind run-time detection")]
#[expect(
    clippy::undocumented_unsafe_blocks,
    reason = "one comment stands for all methods of `Lanes`"
)]
mod avx2;
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "AVX-512 intrinsics behind run-time detection")]
#[expect(
    clippy::undocumented_unsafe_blocks,
    reason = "one comment stands for all methods of `Lanes`"
)]
mod avx512;
mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(super) use scalar::Scalar;

/// Appends the entropy-coded data of a strip, ended on a byte. `wanted` is called between rows of
/// blocks; when it returns false, the work ends. A level that the machine lacks is scalar.
pub(super) fn encode(
    level: SimdLevel,
    job: &Job<'_>,
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) {
    match level {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 if level.is_supported() => avx2::encode(job, out, wanted),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 if level.is_supported() => avx512::encode(job, out, wanted),
        _ => strip::encode::<Scalar>(job, out, wanted),
    }
}
