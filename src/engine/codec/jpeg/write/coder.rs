//! Huffman coding of quantised blocks: bits are joined in a word and stored eight bytes at a time;
//! a zero follows each byte 255 when a piece is complete.

use super::tables::{AC, BLOCK, DC};

/// Most bits of a coefficient: a code of 16 and a value of 10.
const COEFFICIENT_BITS: usize = 26;
/// Most bytes of a block.
pub(super) const BLOCK_BYTES: usize = BLOCK * COEFFICIENT_BITS / 8;
/// Most blocks of a group.
pub(super) const MAX_GROUP_BLOCKS: usize = 12;
/// Bits of a length in an entry of a table.
const LENGTH_BITS: u32 = 6;
/// Values from `-NEAR_VALUES` to `NEAR_VALUES - 1` have an entry of their own for each run of
/// zeros. Kernels find them in bytes: when 64 is added, the sign bit of all others is 1.
pub(super) const NEAR_VALUES: i32 = 64;
const VALUES: usize = 2 * NEAR_VALUES as usize;

/// Rows of a table: one for each run of 0 to 15 zeros, then one ([`DC_ROW`]) for the differences of
/// first coefficients.
const RUNS: usize = DC_ROW + 1;
const DC_ROW: usize = 16;

/// A quantised block in zigzag order, and which of its coefficients are not zero, the first in the
/// lowest bit.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct QuantisedBlock {
    pub(super) coefficients: [i16; BLOCK],
    pub(super) nonzero: u64,
    /// All coefficients but the first are from `-NEAR_VALUES` to `NEAR_VALUES - 1`.
    pub(super) is_near: bool,
}

impl Default for QuantisedBlock {
    fn default() -> Self {
        Self {
            coefficients: [0; BLOCK],
            nonzero: 0,
            is_near: true,
        }
    }
}

#[cfg(target_arch = "x86_64")]
impl QuantisedBlock {
    /// Coefficients `8 k` to `8 k + 7`, a vector of the AVX2 kernel.
    #[inline(always)]
    pub(super) fn eight(&mut self, k: usize) -> &mut [i16; 8] {
        &mut self.coefficients.as_chunks_mut().0[k]
    }
}

/// The blocks of a group of pixels.
pub(super) type Blocks = [QuantisedBlock; BLOCKS];
/// At least [`MAX_GROUP_BLOCKS`], a power of two.
const BLOCKS: usize = 16;
/// The first coefficient of each component's previous block.
pub(super) type Predictors = [i16; COMPONENTS];
/// At least 3, a power of two.
const COMPONENTS: usize = 4;

/// A block of a group and the number of its component.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockPlace {
    pub(super) block: usize,
    pub(super) component: usize,
}

/// The codes of luminance or chrominance: `bits << 6 | length`.
pub(super) struct CoefficientCodes {
    /// By run of zeros and size of the value.
    sized: [[u32; 16]; RUNS],
    /// By run of zeros and the lowest bits of the value: the code and the bits of the value.
    near: [[u32; VALUES]; RUNS],
}

impl std::fmt::Debug for CoefficientCodes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Codes").finish_non_exhaustive()
    }
}

/// Joins a code and the bits of a value (T.81, F.1.2.1): those of `value`, or of `value - 1` if it
/// is negative.
#[inline(always)]
fn with_value(code: u32, value: i32, size: u32) -> u32 {
    #[expect(clippy::cast_sign_loss, reason = "the lower bits")]
    let bits = (value + (value >> 31)) as u32 & ((1 << size) - 1);
    ((code >> LENGTH_BITS) << size | bits) << LENGTH_BITS | (code % (1 << LENGTH_BITS) + size)
}

/// Bits of a value: 0 for 0, and 1 + the logarithm of its amount.
#[inline(always)]
const fn size(value: i32) -> u32 {
    32 - value.unsigned_abs().leading_zeros()
}

impl CoefficientCodes {
    /// Of luminance and chrominance.
    pub(super) fn of_both() -> [Self; 2] {
        [0, 1].map(|k| {
            let code =
                |(code, length): (u16, u8)| u32::from(code) << LENGTH_BITS | u32::from(length);
            let (dc, ac) = (DC[k].codes().map(code), AC[k].codes().map(code));
            let mut codes = Self {
                sized: [[0; 16]; RUNS],
                near: [[0; VALUES]; RUNS],
            };
            for run in 0..RUNS {
                codes.sized[run] = std::array::from_fn(|size| {
                    if run == DC_ROW {
                        dc[size]
                    } else {
                        ac[run << 4 | size]
                    }
                });
                for value in -NEAR_VALUES..NEAR_VALUES {
                    codes.near[run][low_bits(value)] = codes.far(run, value);
                }
            }
            codes
        })
    }

    /// The code of `run` zeros and a value that follows them; of a difference if `run` is
    /// [`DC_ROW`]. `NEAR_ALL`: the value has an entry.
    #[inline(always)]
    fn of<const NEAR_ALL: bool>(&self, run: usize, value: i32) -> u32 {
        if NEAR_ALL || (-NEAR_VALUES..NEAR_VALUES).contains(&value) {
            self.near[run % RUNS][low_bits(value)]
        } else {
            self.far(run, value)
        }
    }

    /// The same of any value.
    #[cold]
    #[inline(never)]
    fn far(&self, run: usize, value: i32) -> u32 {
        let size = size(value);
        with_value(self.sized[run][size as usize % 16], value, size)
    }
}

/// Where a value has its entry.
#[inline(always)]
#[expect(clippy::cast_sign_loss, reason = "the lowest bits")]
const fn low_bits(value: i32) -> usize {
    value as usize % VALUES
}

/// Bits that are joined, and whole bytes that wait for their zeros.
pub(super) struct ScanWriter {
    bytes: Box<[u8; BUFFER_BYTES]>,
    bits: ScanBits,
}

const BUFFER_BYTES: usize = 16 << 10;
/// Above, the bytes must be taken before the next group.
const FULL_BYTES: usize = BUFFER_BYTES - MAX_GROUP_BLOCKS * BLOCK_BYTES - 16;

/// The state of a [`ScanWriter`] without its bytes, so that it stays in registers while a block is
/// coded.
#[derive(Clone, Copy)]
struct ScanBits {
    /// Length of the bytes.
    at: usize,
    word: u64,
    /// Bits of the word that are not stored, at most 7 and the end of a block.
    waiting: u32,
}

impl ScanBits {
    #[inline(always)]
    fn put(&mut self, code: u32) {
        // The shift takes the length, the lowest 6 bits, alone.
        self.word = self.word.wrapping_shl(code) | u64::from(code >> LENGTH_BITS);
        self.waiting += code % (1 << LENGTH_BITS);
    }

    /// Codes a block. `difference`: of its first coefficient and that of the component's previous
    /// block; `NEAR_ALL`: all values have entries.
    #[inline(always)]
    fn block<const NEAR_ALL: bool>(
        &mut self,
        block: &QuantisedBlock,
        codes: &CoefficientCodes,
        bytes: &mut [u8; BUFFER_BYTES],
    ) {
        self.store(bytes);
        let mut rest = Uncoded {
            left: block.nonzero & !1,
            next: 1,
        };
        // Two coefficients between two stores.
        while rest.left != 0 {
            self.coefficient::<NEAR_ALL>(block, codes, &mut rest, bytes);
            if rest.left != 0 {
                self.coefficient::<NEAR_ALL>(block, codes, &mut rest, bytes);
            }
            self.store(bytes);
        }
        if rest.next < 64 {
            self.put(codes.sized[0][0]);
        }
    }

    /// Puts the next coefficient that is not zero, and the zeros before it.
    #[inline(always)]
    fn coefficient<const NEAR_ALL: bool>(
        &mut self,
        block: &QuantisedBlock,
        codes: &CoefficientCodes,
        rest: &mut Uncoded,
        bytes: &mut [u8; BUFFER_BYTES],
    ) {
        let at = rest.left.trailing_zeros();
        rest.left &= rest.left - 1;
        let mut run = at - rest.next;
        rest.next = at + 1;
        while run > 15 {
            // Afterwards, so that the word has room for this coefficient and the next one.
            self.put(codes.sized[15][0]);
            self.store(bytes);
            run -= 16;
        }
        self.put(codes.of::<NEAR_ALL>(
            run as usize,
            i32::from(block.coefficients[at as usize % BLOCK]),
        ));
    }

    /// [`ScanBits::block`] of any values.
    #[cold]
    #[inline(never)]
    fn far_block(
        mut self,
        block: &QuantisedBlock,
        codes: &CoefficientCodes,
        bytes: &mut [u8; BUFFER_BYTES],
    ) -> Self {
        self.block::<false>(block, codes, bytes);
        self
    }

    /// Stores all whole bytes.
    #[inline(always)]
    fn store(&mut self, bytes: &mut [u8; BUFFER_BYTES]) {
        // If no bit waits, the bytes have no meaning and are overwritten.
        let bits = self.word.wrapping_shl(self.waiting.wrapping_neg());
        if let Some(bytes) = bytes.get_mut(self.at..).and_then(<[u8]>::first_chunk_mut) {
            *bytes = bits.to_be_bytes();
        }
        self.at += (self.waiting >> 3) as usize;
        self.waiting &= 7;
    }
}

/// The coefficients of a block that are not coded yet.
struct Uncoded {
    /// Those that are not zero.
    left: u64,
    /// The first one that is not coded.
    next: u32,
}

impl ScanWriter {
    pub(super) fn new() -> Self {
        Self {
            bytes: Box::new([0; BUFFER_BYTES]),
            bits: ScanBits {
                at: 0,
                word: 0,
                waiting: 0,
            },
        }
    }

    /// Codes the blocks of a group in an order; `last`: T.81's predictors of DC, the first
    /// coefficient of each component's previous block.
    #[cfg_attr(not(optimized_for_size), inline(always))]
    #[cfg_attr(optimized_for_size, inline(never))]
    pub(super) fn put_group(
        &mut self,
        blocks: &Blocks,
        order: &[BlockPlace],
        codes: &[CoefficientCodes; 2],
        last: &mut Predictors,
        out: &mut Vec<u8>,
    ) {
        if self.bits.at > FULL_BYTES {
            self.take(out);
        }
        let (mut bits, bytes) = (self.bits, &mut *self.bytes);
        for &BlockPlace { block, component } in order {
            let (block, codes, last) = (
                &blocks[block % BLOCKS],
                &codes[component.min(1)],
                &mut last[component % COMPONENTS],
            );
            let [first, ..] = block.coefficients;
            let difference = i32::from(first) - i32::from(*last);
            *last = first;
            bits.put(codes.of::<false>(DC_ROW, difference));
            if block.is_near {
                bits.block::<true>(block, codes, bytes);
            } else {
                bits = bits.far_block(block, codes, bytes);
            }
        }
        self.bits = bits;
    }

    /// Moves the bytes to `out`, a zero after each byte 255 (T.81, F.1.2.3).
    fn take(&mut self, out: &mut Vec<u8>) {
        const HIGH: u64 = 0x8080_8080_8080_8080;
        out.reserve(2 * self.bits.at);
        let mut bytes = &self.bytes[..self.bits.at];
        while let Some((eight, rest)) = bytes.split_first_chunk::<8>() {
            let word = u64::from_ne_bytes(*eight);
            // A byte overflows when one is added to it, and only if it is 255.
            if word & HIGH & (word & !HIGH).wrapping_add(HIGH / 128) == 0 {
                out.extend_from_slice(eight);
            } else {
                stuff(eight, out);
            }
            bytes = rest;
        }
        stuff(bytes, out);
        self.bits.at = 0;
    }

    /// Fills the last byte with ones and moves everything to `out`.
    pub(super) fn finish(&mut self, out: &mut Vec<u8>) {
        self.bits.store(&mut self.bytes);
        if self.bits.waiting > 0 {
            let length = 8 - self.bits.waiting;
            self.bits.put(((1 << length) - 1) << LENGTH_BITS | length);
            self.bits.store(&mut self.bytes);
        }
        self.take(out);
    }
}

fn stuff(bytes: &[u8], out: &mut Vec<u8>) {
    for byte in bytes {
        out.push(*byte);
        if *byte == u8::MAX {
            out.push(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bits of a symbol and a value after it.
    fn coded(bits: &mut Vec<bool>, (code, length): (u16, u8), value: i32) {
        let size = size(value);
        let value = if value < 0 {
            value + (1 << size) - 1
        } else {
            value
        };
        bits.extend((0..length).rev().map(|bit| code >> bit & 1 == 1));
        bits.extend((0..size).rev().map(|bit| value >> bit & 1 == 1));
    }

    /// Blocks as T.81, F.1.2 defines them.
    fn defined(blocks: &[[i16; BLOCK]], table: usize) -> Vec<u8> {
        let (dc, ac) = (DC[table].codes(), AC[table].codes());
        let (mut bits, mut last) = (Vec::new(), 0);
        for block in blocks {
            let difference = i32::from(block[0]) - last;
            last = i32::from(block[0]);
            coded(&mut bits, dc[size(difference) as usize], difference);
            let mut run = 0;
            for value in block[1..].iter().map(|value| i32::from(*value)) {
                if value == 0 {
                    run += 1;
                    continue;
                }
                (0..run / 16).for_each(|_| coded(&mut bits, ac[0xf0], 0));
                coded(&mut bits, ac[(run % 16) << 4 | size(value) as usize], value);
                run = 0;
            }
            if run > 0 {
                coded(&mut bits, ac[0], 0);
            }
        }
        bits.resize(bits.len().next_multiple_of(8), true);
        let byte = |bits: &[bool]| bits.iter().fold(0, |byte, bit| byte << 1 | u8::from(*bit));
        let stuffed = |byte| std::iter::once(byte).chain((byte == 255).then_some(0));
        bits.chunks(8).map(byte).flat_map(stuffed).collect()
    }

    /// Sparse and full blocks of small and of large values, so that every run meets every size,
    /// after each number of waiting bits.
    #[test]
    fn bits_are_those_of_the_standard() {
        let codes = CoefficientCodes::of_both();
        let mut state = 1_u64;
        let mut random = |below: u64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % below
        };
        for round in 0..20_000 {
            let (share, most) = (1 + random(64), random(10));
            let blocks: [[i16; BLOCK]; 4] = std::array::from_fn(|_| {
                std::array::from_fn(|k| {
                    let size = if k == 0 { 10 } else { 1 + random(1 + most) };
                    let value = i16::try_from(random(1 << size)).unwrap();
                    let value = if random(2) == 0 { value } else { -value };
                    if k == 0 || random(64) < share {
                        value
                    } else {
                        0
                    }
                })
            });
            let mut group = Blocks::default();
            for (block, coefficients) in group.iter_mut().zip(blocks) {
                block.coefficients = coefficients;
                block.nonzero = (0..BLOCK)
                    .filter(|k| coefficients[*k] != 0)
                    .map(|k| 1 << k)
                    .sum();
                block.is_near = coefficients[1..]
                    .iter()
                    .all(|value| (-NEAR_VALUES..NEAR_VALUES).contains(&i32::from(*value)));
            }
            let table = (round % 2) as usize;
            let order: Vec<_> = (0..4)
                .map(|block| BlockPlace {
                    block,
                    component: table,
                })
                .collect();
            let (mut bits, mut out) = (ScanWriter::new(), Vec::new());
            bits.put_group(&group, &order, &codes, &mut Predictors::default(), &mut out);
            bits.finish(&mut out);
            assert!(out == defined(&blocks, table), "round {round}: {blocks:?}");
        }
    }
}
