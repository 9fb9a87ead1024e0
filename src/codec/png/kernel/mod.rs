//! The one place where an instruction set is chosen. The code of the fast strip is written once, in portable Rust (`fast::body`); a level is
//! that code compiled with more instructions, so all levels give the same bytes. AVX2 doubles the width of the filters; BMI2 turns the shifts of
//! the coding loop, whose counts are data, into single operations.

use super::fast;
use super::rows::Rows;

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "calls a function compiled for instructions that were detected")]
mod x86;

/// Instruction sets that strips are encoded with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Level {
    /// What the target always has.
    Scalar,
    /// x86-64 with AVX2, BMI1, BMI2 and LZCNT.
    Avx2,
}

impl Level {
    /// The best that this machine has.
    #[must_use]
    pub fn detect() -> Self {
        if Self::Avx2.is_available() { Self::Avx2 } else { Self::Scalar }
    }

    /// Whether this machine has it.
    #[must_use]
    pub fn is_available(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::is_available(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 => false,
        }
    }

    /// All that this machine has, scalar first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        [Self::Scalar, Self::Avx2].into_iter().filter(|level| level.is_available()).collect()
    }
}

/// `fast::body` at a level; a level that the machine lacks is scalar.
pub(super) fn fast(level: Level, rows: Rows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    match level {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => x86::fast(rows, last, most, out),
        _ => fast::body(rows, last, most, out),
    }
}
