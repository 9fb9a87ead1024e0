//! The one place where an instruction set is chosen. The code of the fast strip is written once, in portable Rust (`fast::body`); a level is
//! that code compiled with more instructions, so all levels give the same bytes. AVX2 doubles the width of the filters; BMI2 turns the shifts of
//! the coding loop, whose counts are data, into single operations.

use super::fast;
use super::rows::Rows;
use crate::level::Level;

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "calls a function compiled for instructions that were detected")]
mod x86;

/// `fast::body` at a level; a level that the machine lacks is scalar.
pub(super) fn fast(level: Level, rows: Rows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 | Level::Avx512 if level.is_here() => x86::fast(rows, last, most, out),
        _ => fast::body(rows, last, most, out),
    }
}
