//! The operations of an instruction set that a strip needs.

use super::coder::{BlockPlace, Blocks, CoefficientCodes, Predictors, QuantisedBlock, ScanWriter};
use super::tables::{BLOCK, SIDE};

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
    /// Blocks of samples to quantised coefficients, by `strip`. Its caller is compiled for each
    /// number of channels.
    fn coefficients(rows: &[Self; 8], quantiser: &Quantiser, blocks: &mut [QuantisedBlock]);
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

/// Divides coefficients by their steps: for each column of a block, two factors of
/// [`I16Lanes::times`] in units of 2^-15. The reciprocal of a large step alone would have too few
/// bits, so it is a factor of 1/2 to 1 and a power of two.
#[derive(Debug)]
pub(super) struct Quantiser([[[i16; MOST_LANES]; 2]; SIDE]);

impl Quantiser {
    /// `steps` in rows; blocks are transposed when they are quantised.
    pub(super) fn new(steps: &[u8; BLOCK]) -> Self {
        Self(std::array::from_fn(|x| {
            let factors = |lane: usize| {
                // Coefficients have the unit 1/32. The first factor is 1/2 to 1.
                let step = 32 * u32::from(steps[lane % SIDE * SIDE + x]);
                let bits = step.ilog2() - u32::from(step.is_power_of_two());
                let first = ((1 << (15 + bits)) + step / 2) / step;
                [first, 1 << (15 - bits)].map(|factor| i16::try_from(factor).expect("less than 1"))
            };
            [0, 1].map(|k| std::array::from_fn(|lane| factors(lane)[k]))
        }))
    }

    #[inline(always)]
    pub(super) fn divide<T: I16Lanes>(&self, rows: &mut [T; SIDE]) {
        for (row, [first, second]) in rows.iter_mut().zip(&self.0) {
            *row = row.times(T::load(first)).times(T::load(second));
        }
    }
}
