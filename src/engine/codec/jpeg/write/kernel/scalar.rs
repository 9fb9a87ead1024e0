//! The reference: loops over 16 lanes, which a compiler turns into what registers there are.

use crate::codec::jpeg::write::coder::{
    BlockPlace, Blocks, CoefficientCodes, NEAR_VALUES, Predictors, QuantisedBlock, ScanWriter,
};
use crate::codec::jpeg::write::lanes::{I16Lanes, MOST_LANES, Quantiser};
use crate::codec::jpeg::write::strip;
use crate::codec::jpeg::write::tables::{BLOCK, SIDE, ZIGZAG};

const COUNT: usize = 16;

/// 16 lanes.
#[derive(Clone, Copy)]
pub(in crate::codec::jpeg::write) struct Scalar([i16; COUNT]);

impl Scalar {
    #[inline(always)]
    fn each(self, other: Self, operation: impl Fn(i16, i16) -> i16) -> Self {
        let mut lanes = self.0;
        for (lane, other) in lanes.iter_mut().zip(other.0) {
            *lane = operation(*lane, other);
        }
        Self(lanes)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "lanes of 16 bits wrap")]
impl I16Lanes for Scalar {
    const COUNT: usize = COUNT;

    #[inline(always)]
    fn all(value: i16) -> Self {
        Self([value; COUNT])
    }

    #[inline(always)]
    fn load(values: &[i16; MOST_LANES]) -> Self {
        let mut lanes = [0; COUNT];
        lanes.copy_from_slice(&values[..COUNT]);
        Self(lanes)
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.each(other, i16::wrapping_add)
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.each(other, i16::wrapping_sub)
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self.each(other, |a, b| {
            ((i32::from(a) * i32::from(b) + (1 << 14)) >> 15) as i16
        })
    }

    #[inline(always)]
    fn times_high(self, other: Self) -> Self {
        self.each(other, |a, b| {
            (((u32::from(a.cast_unsigned()) * u32::from(b.cast_unsigned())) >> 16) as u16)
                .cast_signed()
        })
    }

    #[inline(always)]
    fn mean(self, other: Self) -> Self {
        self.each(other, |a, b| {
            ((u32::from(a.cast_unsigned()) + u32::from(b.cast_unsigned())).div_ceil(2) as u16)
                .cast_signed()
        })
    }

    #[inline(always)]
    fn times_low(self, other: Self) -> Self {
        self.each(other, i16::wrapping_mul)
    }

    #[inline(always)]
    fn shift_rounded<const BITS: u32>(self) -> Self {
        self.each(self, |lane, _| (lane >> BITS) + (lane >> (BITS - 1) & 1))
    }

    #[inline(always)]
    fn shift_left<const BITS: u32>(self) -> Self {
        self.each(self, |lane, _| lane << BITS)
    }

    #[inline(always)]
    fn shift_right<const BITS: u32>(self) -> Self {
        self.each(self, |lane, _| (lane.cast_unsigned() >> BITS).cast_signed())
    }

    #[inline(always)]
    fn pixels_1(pixels: &[u8]) -> Self {
        let [grey] = channels(pixels);
        grey
    }

    #[inline(always)]
    fn pixels_2(pixels: &[u8]) -> [Self; 2] {
        channels(pixels)
    }

    #[inline(always)]
    fn pixels_3(pixels: &[u8]) -> [Self; 3] {
        channels::<3>(pixels).map(|channel| channel.times_low(Self::all(257)))
    }

    #[inline(always)]
    fn pixels_4(pixels: &[u8]) -> [Self; 4] {
        channels(pixels)
    }

    #[inline(always)]
    fn sums_of_pairs(self, other: Self) -> Self {
        let mut lanes = [0; COUNT];
        for k in 0..COUNT / 2 {
            lanes[k] = self.0[2 * k].wrapping_add(self.0[2 * k + 1]);
            lanes[COUNT / 2 + k] = other.0[2 * k].wrapping_add(other.0[2 * k + 1]);
        }
        Self(lanes)
    }

    #[inline(always)]
    fn transpose(rows: [Self; 8]) -> [Self; 8] {
        let mut columns = [Self([0; COUNT]); 8];
        for (x, column) in columns.iter_mut().enumerate() {
            for (y, row) in rows.iter().enumerate() {
                for block in (0..COUNT).step_by(SIDE) {
                    column.0[block + y] = row.0[block + x];
                }
            }
        }
        columns
    }

    /// Without registers of 16 lanes it is long: programs for the web have it once.
    #[inline(never)]
    fn coefficients(rows: &[Self; 8], quantiser: &Quantiser, blocks: &mut [QuantisedBlock]) {
        strip::coefficients(*rows, quantiser, blocks);
    }

    #[inline(never)]
    fn code(
        bits: &mut ScanWriter,
        blocks: &Blocks,
        order: &[BlockPlace],
        codes: &[CoefficientCodes; 2],
        last: &mut Predictors,
        out: &mut Vec<u8>,
    ) {
        bits.put_group(blocks, order, codes, last, out);
    }

    #[inline(always)]
    fn store(columns: [Self; 8], blocks: &mut [QuantisedBlock]) {
        for (block, lanes) in blocks[..COUNT / SIDE].iter_mut().zip((0..).step_by(SIDE)) {
            let mut transposed = [0; BLOCK];
            for (column, Self(values)) in transposed
                .as_chunks_mut::<SIDE>()
                .0
                .iter_mut()
                .zip(&columns)
            {
                column.copy_from_slice(&values[lanes..lanes + SIDE]);
            }
            // A place is less than 64: the second remainder removes the bounds check.
            for (eight, places) in block
                .coefficients
                .as_chunks_mut::<SIDE>()
                .0
                .iter_mut()
                .zip(ZIGZAG.as_chunks::<SIDE>().0)
            {
                *eight = places.map(|place| {
                    transposed[usize::from(place) % SIDE * SIDE + usize::from(place) / SIDE % SIDE]
                });
            }
            // No early exit, so that the comparisons are vectorised.
            let far = block.coefficients[1..].iter().fold(false, |far, value| {
                far | !(-NEAR_VALUES..NEAR_VALUES).contains(&i32::from(*value))
            });
            block.is_near = !far;
            block.nonzero = 0;
            for (eight, at) in block
                .coefficients
                .as_chunks::<SIDE>()
                .0
                .iter()
                .zip((0..).step_by(SIDE))
            {
                let mut bits = 0_u16;
                for (k, coefficient) in eight.iter().enumerate() {
                    bits |= if *coefficient == 0 { 0 } else { 1 << k };
                }
                block.nonzero |= u64::from(bits) << at;
            }
        }
    }
}

#[inline(always)]
fn channels<const N: usize>(pixels: &[u8]) -> [Scalar; N] {
    let mut channels = [Scalar([0; COUNT]); N];
    for (k, pixel) in pixels.as_chunks::<N>().0[..COUNT].iter().enumerate() {
        for (channel, sample) in channels.iter_mut().zip(pixel) {
            channel.0[k] = i16::from(*sample);
        }
    }
    channels
}
