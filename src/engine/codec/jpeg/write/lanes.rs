//! The operations of an instruction set that a strip needs.

use super::coder::{BlockPlace, Blocks, CoefficientCodes, Predictors, QuantisedBlock, ScanWriter};

/// Most lanes of a level.
pub(super) const MOST_LANES: usize = 32;

/// 16-bit integers side by side: 16 of them or a multiple, signed unless stated otherwise. Sums and
/// differences wrap; `strip` states the ranges, within which they do not. Eight lanes are a row of
/// a block, or a column after `transpose`.
pub(super) trait I16Lanes: Copy {
    const COUNT: usize;

    fn all(value: i16) -> Self;
    /// The first lanes of a table.
    fn load(values: &[i16; MOST_LANES]) -> Self;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    /// `(a b + 2^14) / 2^15`, rounded down: the product in units of 2^-15, rounded to the nearest.
    fn times(self, other: Self) -> Self;
    /// `a b / 2^16` of unsigned integers, rounded down.
    fn times_high(self, other: Self) -> Self;
    /// `(a + b + 1) / 2` of unsigned integers, rounded down.
    fn mean(self, other: Self) -> Self;
    /// The lower 16 bits of the product.
    fn times_low(self, other: Self) -> Self;
    /// `a / 2^BITS`, rounded to the nearest, half up; `BITS` is at least 1.
    #[inline(always)]
    fn shift_rounded<const BITS: u32>(self) -> Self {
        self.times(Self::all(1 << (15 - BITS)))
    }
    fn shift_left<const BITS: u32>(self) -> Self;
    /// Of unsigned integers.
    fn shift_right<const BITS: u32>(self) -> Self;

    /// Samples of `COUNT` pixels of one byte.
    fn pixels_1(pixels: &[u8]) -> Self;
    /// The same of pixels of two bytes, by channel.
    fn pixels_2(pixels: &[u8]) -> [Self; 2];
    /// The same of pixels of three bytes, times 257.
    fn pixels_3(pixels: &[u8]) -> [Self; 3];
    /// The same of pixels of four bytes.
    fn pixels_4(pixels: &[u8]) -> [Self; 4];

    /// Sums of neighbours: those of `self` in the lower half of the lanes, those of `other` in the
    /// upper half.
    fn sums_of_pairs(self, other: Self) -> Self;
    /// Transposes the blocks, `rows[y]` at lane x to `[x]` at lane y.
    fn transpose(rows: [Self; 8]) -> [Self; 8];
    /// Stores `COUNT / 8` transposed blocks in zigzag order, and sets `nonzero` and `is_near`.
    fn store(columns: [Self; 8], blocks: &mut [QuantisedBlock]);
    /// [`ScanWriter::put_group`], compiled for the level.
    fn code(
        bits: &mut ScanWriter,
        blocks: &Blocks,
        order: &[BlockPlace],
        codes: &[CoefficientCodes; 2],
        last: &mut Predictors,
        out: &mut Vec<u8>,
    );
}
