//! Codes filtered bytes as a deflate block. Bytes are split into groups of eight that are not all
//! zero, runs of at least eight zeros (a literal and matches of distance 1), and fewer than eight
//! at the end; `walk` does this both to count symbols and to write codes. Codes are looked up for
//! two bytes at a time (`PairTable`: 65536 codes of at most 24 bits with their lengths, 256 KiB)
//! or, in strips too short for such a table, for one; four go to a store. A level may code many
//! groups at once (`Lookup::many`). Cost: about 0.4 ns per byte with pairs, 0.6 without.

use super::block::{END_OF_BLOCK, LITERAL_SYMBOLS};
use crate::codec::bits::BitWriter;
use crate::codec::prefix_code::Codes;

/// Longest code. Two fit 26 bits, with space for their length in a `u32`; four fit a 64-bit store
/// together with 7 waiting bits.
pub(super) const MAX_CODE_BITS: usize = 12;

/// Filtered bytes that are coded at once; a multiple of 8.
pub(super) const PIECE_BYTES: usize = 4096;

/// Upper bound of a coded piece (12 bits per byte; a coded run is never longer than its bytes).
const CODED_PIECE_BYTES: usize = 8192;
/// Output of a coded piece; stores may reach 24 bytes beyond.
pub(super) type CodeBuffer = [u8; CODED_PIECE_BYTES + 24];

/// An empty stage.
pub(super) const STAGE_EMPTY: CodeBuffer = [0; CODED_PIECE_BYTES + 24];

const _: () = assert!(
    PIECE_BYTES * MAX_CODE_BITS / 8 + 16 < CODED_PIECE_BYTES && CODED_PIECE_BYTES.is_power_of_two()
);

/// The tables of a strip's code.
#[derive(Debug)]
pub(super) struct Tables<'a, L> {
    pub(super) pairs: &'a L,
    pub(super) single: &'a Single,
}

/// Appends the codes of at most `PIECE_BYTES` bytes to `out`.
#[inline(always)]
pub(super) fn code_piece<L: Lookup>(
    piece: &[u8],
    tables: Tables<'_, L>,
    stage: &mut CodeBuffer,
    bits: &mut BitWriter,
    out: &mut Vec<u8>,
) {
    let mut coder = Coder {
        bits: Staged {
            waiting: bits.waiting,
            filled: bits.filled & 7,
            at: 0,
            stage,
        },
        tables,
    };
    walk(piece, &mut coder);
    let Staged {
        waiting,
        filled,
        at,
        ..
    } = coder.bits;
    *bits = BitWriter { waiting, filled };
    out.extend_from_slice(&stage[..at]);
}

/// Receives the parts of filtered bytes: groups of eight that are not all zero, runs of zeros, and
/// single bytes at the end.
pub(super) trait Sink {
    /// Takes any number of whole groups from the front, up to the first that is all zero; returns
    /// their number of bytes.
    #[inline(always)]
    fn many(&mut self, _bytes: &[u8]) -> usize {
        0
    }
    fn eight(&mut self, bytes: u64);
    /// `count >= 8`.
    fn zeros(&mut self, count: usize);
    fn one(&mut self, byte: u8);
}

#[inline(always)]
pub(super) fn walk<S: Sink>(bytes: &[u8], sink: &mut S) {
    let mut rest = bytes;
    loop {
        rest = &rest[sink.many(rest)..];
        let Some((eight, after)) = rest.split_first_chunk::<8>() else {
            break;
        };
        let eight = u64::from_le_bytes(*eight);
        rest = after;
        if eight != 0 {
            sink.eight(eight);
            continue;
        }
        let mut count = 8;
        while let Some((eight, after)) = rest.split_first_chunk::<8>() {
            let zeros = (u64::from_le_bytes(*eight).trailing_zeros() / 8) as usize;
            count += zeros;
            if zeros < 8 {
                rest = &rest[zeros..];
                break;
            }
            rest = after;
        }
        sink.zeros(count);
    }
    for &byte in rest {
        sink.one(byte);
    }
}

/// Splits a run of zeros into a literal (length 1), matches of the greatest length, and the rest as
/// a match or, if too short, as literals.
#[inline(always)]
fn split_zeros(mut count: usize, mut take: impl FnMut(usize)) {
    let mut length = 1;
    while count > 0 {
        take(length);
        count -= length;
        length = if count < SHORTEST_MATCH {
            1
        } else {
            count.min(LONGEST_MATCH)
        };
    }
}

const SHORTEST_MATCH: usize = 3;
const LONGEST_MATCH: usize = 258;

/// First length of the symbols 257 and on, and their numbers of extra bits (RFC 1951, 3.2.5).
const LENGTHS: [u16; 29] = [
    3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131,
    163, 195, 227, 258,
];
const EXTRA_BITS: [u8; 29] = [
    0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0,
];

fn length_symbol(length: usize) -> usize {
    END_OF_BLOCK + LENGTHS.partition_point(|&first| usize::from(first) <= length)
}

#[derive(Debug)]
pub(super) struct Counts {
    /// Four tables, so that equal neighbours do not wait for each other's store.
    bytes: [[u32; 256]; 4],
    lengths: [u32; LITERAL_SYMBOLS],
}

impl Default for Counts {
    fn default() -> Self {
        Self {
            bytes: [[0; 256]; 4],
            lengths: [0; LITERAL_SYMBOLS],
        }
    }
}

impl Counts {
    pub(super) fn total(&self) -> [u32; LITERAL_SYMBOLS] {
        let mut total = self.lengths;
        for table in &self.bytes {
            for (total, count) in total.iter_mut().zip(table) {
                *total += count;
            }
        }
        total
    }
}

impl Sink for Counts {
    #[inline(always)]
    fn eight(&mut self, bytes: u64) {
        for (byte, lane) in bytes
            .to_le_bytes()
            .into_iter()
            .zip([0, 1, 2, 3, 0, 1, 2, 3])
        {
            self.bytes[lane][usize::from(byte)] += 1;
        }
    }

    #[inline(always)]
    fn zeros(&mut self, count: usize) {
        split_zeros(count, |length| match length {
            1 => self.bytes[0][0] += 1,
            _ => self.lengths[length_symbol(length)] += 1,
        });
    }

    #[inline(always)]
    fn one(&mut self, byte: u8) {
        self.bytes[0][usize::from(byte)] += 1;
    }
}

/// Bits of an entry below its code. Six, although a length needs five, because two entries may be
/// added including their lengths.
const LENGTH_BITS: u32 = 6;

/// `code << 6 | length`: shifts of 64-bit words use six bits of their count, so shifting by an
/// entry shifts by its length.
const fn entry(code: u32, length: u32) -> u32 {
    code << LENGTH_BITS | length
}

#[inline(always)]
pub(super) const fn code(entry: u32) -> u64 {
    (entry >> LENGTH_BITS) as u64
}

/// The length of an entry, or of a sum of two.
#[inline(always)]
pub(super) const fn length(entry: u32) -> u32 {
    entry & ((1 << LENGTH_BITS) - 1)
}

/// Codes of two neighbouring bytes, the first lowest.
pub(super) trait Lookup {
    fn two(&self, bytes: u16) -> u32;

    /// Codes groups for [`Sink::many`].
    #[inline(always)]
    fn many(&self, _bytes: &[u8], _bits: &mut Staged<'_>) -> usize {
        0
    }
}

/// One entry for each byte, and one for each length of a run of zeros: below 3 a literal, else a
/// match with its extra bits and the distance's one bit.
#[derive(Debug)]
pub(super) struct Single {
    bytes: [u32; 256],
    runs: [u32; LONGEST_MATCH + 1],
}

impl Single {
    pub(super) fn new(codes: &Codes<LITERAL_SYMBOLS>) -> Self {
        let byte = |byte: usize| entry(codes.bits[byte].into(), codes.length[byte].into());
        let run = |length| {
            if length < SHORTEST_MATCH {
                return byte(0);
            }
            let symbol = length_symbol(length);
            let (first, extra_bits) = (
                LENGTHS[symbol - END_OF_BLOCK - 1],
                EXTRA_BITS[symbol - END_OF_BLOCK - 1],
            );
            let (code, bits) = (
                u32::from(codes.bits[symbol]),
                u32::from(codes.length[symbol]),
            );
            let extra = u32::try_from(length).expect("at most 258") - u32::from(first);
            // The distance code is a single zero bit.
            entry(code | extra << bits, bits + u32::from(extra_bits) + 1)
        };
        Self {
            bytes: std::array::from_fn(byte),
            runs: std::array::from_fn(run),
        }
    }

    #[inline(always)]
    pub(super) fn one(&self, byte: u8) -> u32 {
        self.bytes[usize::from(byte)]
    }
}

impl Lookup for Single {
    #[inline(always)]
    fn two(&self, bytes: u16) -> u32 {
        let [first, second] = bytes.to_le_bytes();
        pair(self.one(first), self.one(second))
    }
}

#[inline(always)]
fn pair(first: u32, second: u32) -> u32 {
    let second_code = second - length(second);
    (second_code << length(first)) + first + length(second)
}

/// One entry for each pair of bytes.
pub(super) type PairTable = [u32; 1 << 16];

impl Lookup for PairTable {
    #[inline(always)]
    fn two(&self, bytes: u16) -> u32 {
        self[usize::from(bytes)]
    }
}

#[inline(always)]
pub(super) fn fill_pairs(single: &Single, pairs: &mut PairTable) {
    for (row, &second) in pairs.chunks_exact_mut(256).zip(&single.bytes) {
        for (two, &first) in row.iter_mut().zip(&single.bytes) {
            *two = pair(first, second);
        }
    }
}

/// Bits on their way to the stage.
pub(super) struct Staged<'a> {
    waiting: u64,
    filled: u32,
    at: usize,
    stage: &'a mut CodeBuffer,
}

/// For the kernel that codes many bytes at once.
#[cfg(target_arch = "x86_64")]
impl Staged<'_> {
    /// A copy that a loop can keep in registers; [`Staged::go_on`] takes its result back.
    #[inline(always)]
    pub(super) fn lend(&mut self) -> Staged<'_> {
        Staged {
            waiting: self.waiting,
            filled: self.filled,
            at: self.at,
            stage: &mut *self.stage,
        }
    }

    /// The result of a copy.
    #[inline(always)]
    pub(super) fn ended(self) -> (u64, u32, usize) {
        (self.waiting, self.filled, self.at)
    }

    #[inline(always)]
    pub(super) fn go_on(&mut self, (waiting, filled, at): (u64, u32, usize)) {
        (self.waiting, self.filled, self.at) = (waiting, filled, at);
    }
}

impl Staged<'_> {
    /// `length <= 56`.
    #[inline(always)]
    pub(super) fn put(&mut self, code: u64, length: u32) {
        // Never changes the value (STAGE holds the longest coded piece); it replaces a bounds
        // check.
        self.at &= CODED_PIECE_BYTES - 1;
        self.put_next(code, length);
    }

    /// Like [`Self::put`], directly after it, so that its mask serves both.
    #[inline(always)]
    fn put_next(&mut self, code: u64, length: u32) {
        self.waiting |= code << self.filled;
        self.filled += length;
        self.stage[self.at..self.at + 8].copy_from_slice(&self.waiting.to_le_bytes());
        self.at += (self.filled / 8) as usize;
        self.waiting >>= self.filled & 56;
        self.filled &= 7;
    }
}

struct Coder<'a, L> {
    bits: Staged<'a>,
    tables: Tables<'a, L>,
}

impl<L: Lookup> Coder<'_, L> {
    #[inline(always)]
    fn put_entry(&mut self, entry: u32) {
        self.bits.put(code(entry), length(entry));
    }

    /// Two pairs, 48 bits at most.
    #[inline(always)]
    fn four(first: u32, second: u32) -> (u64, u32) {
        (
            code(first) | code(second).wrapping_shl(first),
            length(first.wrapping_add(second)),
        )
    }
}

impl<L: Lookup> Sink for Coder<'_, L> {
    #[inline(always)]
    fn many(&mut self, bytes: &[u8]) -> usize {
        self.tables.pairs.many(bytes, &mut self.bits)
    }

    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the low half word of a shifted word is what is meant"
    )]
    fn eight(&mut self, bytes: u64) {
        let [a, b, c, d] =
            [0, 16, 32, 48].map(|shift| self.tables.pairs.two((bytes >> shift) as u16));
        let (fore, fore_length) = Self::four(a, b);
        self.bits.put(fore, fore_length);
        let (rear, rear_length) = Self::four(c, d);
        self.bits.put_next(rear, rear_length);
    }

    #[inline(always)]
    fn zeros(&mut self, count: usize) {
        split_zeros(count, |length| {
            self.put_entry(self.tables.single.runs[length])
        });
    }

    #[inline(always)]
    fn one(&mut self, byte: u8) {
        self.put_entry(self.tables.single.one(byte));
    }
}
