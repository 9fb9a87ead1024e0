//! `Compression::Fast`: Paeth residuals (the strip's first row: Sub), an order-0 Huffman code of at most 12 bits for them, and runs of zeros as
//! matches of distance 1. No match search. The code comes from a sample of the strip's own rows; every byte and every length has a code, so
//! whatever the other rows hold can be written. Rows are filtered in pieces of 4 KiB that are coded while they are in the first-level cache.
//! Residuals are looked up two at a time (256 KiB of table: 65536 codes of at most 24 bits with their lengths), four to a store.
//! Cost: about 0.4 ns a byte, scratch 256 KiB a thread. What was tried: `notes.md`.

use std::cell::Cell;

use super::bits::BitWriter;
use super::huffman::{self, Codes, END, LITERALS};
use super::rows::{self, PAETH, Rows, SUB};
use super::{kernel, stored};

/// Longest code. Two fit 26 bits with room for their length in a `u32`; four fit a 64-bit store beside 7 waiting bits.
const LIMIT: usize = 12;

/// Filtered bytes that are coded at once; a multiple of 8.
const PIECE: usize = 4096;

/// Most bytes a piece is coded to (12 bits a byte; a run is never longer than its bytes).
const STAGE: usize = 8192;
const _: () = assert!(PIECE * LIMIT / 8 + 16 < STAGE && STAGE.is_power_of_two());

/// Filtered bytes that the code table is made from.
const SAMPLE: usize = 16 << 10;

/// How much a byte that was sampled outweighs one that was not.
const SAMPLED: u32 = 8;

/// Strips below this are looked up byte by byte: the table of pairs costs about 15 us.
const PAIRS_FROM: usize = 48 << 10;

/// Appends the deflate blocks of one strip, ended on a byte; returns the Adler-32 of the filtered rows.
pub(super) fn encode(level: kernel::Level, rows: Rows<'_>, last: bool, out: &mut Vec<u8>) -> u32 {
    let start = out.len();
    let filtered = rows.filtered_len();
    let most = filtered + usize::try_from(stored::overhead(filtered as u64)).expect("less than the rows themselves");
    out.reserve(filtered / 2 + 1024);
    kernel::fast(level, rows, last, start + most, out).unwrap_or_else(|| {
        out.truncate(start);
        stored::encode(rows, last, out)
    })
}

/// The whole of `encode` but the fallback; `None` as soon as `out` is longer than `most`. Compiled once a level.
#[inline(always)]
pub(super) fn body(rows: Rows<'_>, last: bool, most: usize, out: &mut Vec<u8>) -> Option<u32> {
    let mut piece = [0; PIECE];
    let codes = Codes::new(&sample(rows, &mut piece), LIMIT);
    let mut bits = BitWriter::default();
    huffman::block_header(&codes, last, &mut bits, out);
    let (single, runs) = (Single::new(&codes), Runs::new(&codes));
    let adler = if rows.filtered_len() < PAIRS_FROM {
        code_rows(rows, &single, &single, &runs, &mut piece, &mut bits, most, out)
    } else {
        let mut pairs = PAIRS.take().unwrap_or_else(|| vec![0; 1 << 16].try_into().expect("65536 entries"));
        fill_pairs(&single, &mut pairs);
        let adler = code_rows(rows, &Pairs(&pairs), &single, &runs, &mut piece, &mut bits, most, out);
        PAIRS.set(Some(pairs));
        adler
    }?;
    bits.put(out, codes.bits[END].into(), codes.length[END].into());
    end(last, &mut bits, out);
    (out.len() <= most).then_some(adler)
}

/// Ends a strip on a byte. An empty stored block does, where another strip follows.
pub(super) fn end(last: bool, bits: &mut BitWriter, out: &mut Vec<u8>) {
    if !last {
        bits.put(out, 0, 3);
        bits.pad(out);
        out.extend_from_slice(&[0, 0, 0xff, 0xff]);
    }
    bits.pad(out);
}

/// One block of filtered bytes with the code that is best for exactly them; for `Compression::Best`.
pub(super) fn block(filtered: &[u8], last: bool, bits: &mut BitWriter, out: &mut Vec<u8>) {
    let mut counts = Counts::default();
    filtered.chunks(PIECE).for_each(|piece| walk(piece, &mut counts));
    let mut weights = counts.total();
    weights[END] = 1;
    let codes = Codes::new(&weights, LIMIT);
    huffman::block_header(&codes, last, bits, out);
    let (single, runs) = (Single::new(&codes), Runs::new(&codes));
    let mut stage = [0; STAGE + 8];
    for piece in filtered.chunks(PIECE) {
        code_piece(piece, &single, &single, &runs, &mut stage, bits, out);
    }
    bits.put(out, codes.bits[END].into(), codes.length[END].into());
}

thread_local! {
    /// The table of pairs outlives a strip: its 64 pages are not faulted in anew.
    static PAIRS: Cell<Option<Box<[u32; 1 << 16]>>> = const { Cell::new(None) };
}

/// Weights of all symbols, from about `SAMPLE` bytes of evenly spread rows.
#[inline(always)]
fn sample(rows: Rows<'_>, piece: &mut [u8; PIECE]) -> [u32; LITERALS] {
    let mut counts = Counts::default();
    let step = (rows.filtered_len() / SAMPLE).clamp(1, rows.count());
    // The middle of every stretch of `step` rows; never the first row alone, which has a filter of its own.
    let mut index = step / 2;
    while index < rows.count() {
        let mut from = 0;
        while from < rows.row_bytes() {
            let n = PIECE.min(rows.row_bytes() - from);
            filter(rows, index, from, &mut piece[..n]);
            walk(&piece[..n], &mut counts);
            from += n;
        }
        index += step;
    }
    let mut weights = counts.total().map(|weight| weight.saturating_mul(SAMPLED).saturating_add(1));
    let sampled = u32::try_from(rows.count() / step).unwrap_or(u32::MAX);
    weights[usize::from(PAETH)] = weights[usize::from(PAETH)].saturating_add(sampled.saturating_mul(SAMPLED));
    weights
}

#[inline(always)]
fn filter(rows: Rows<'_>, index: usize, from: usize, out: &mut [u8]) {
    if index == 0 {
        rows::sub(rows.row(0), rows.bpp(), from, out);
    } else {
        rows::paeth(rows.row(index), rows.row(index - 1), rows.bpp(), from, out);
    }
}

/// Filters and codes all rows; `None` as soon as `out` is longer than `most`.
#[inline(always)]
fn code_rows<L: Lookup>(
    rows: Rows<'_>,
    lookup: &L,
    single: &Single,
    runs: &Runs,
    piece: &mut [u8; PIECE],
    bits: &mut BitWriter,
    most: usize,
    out: &mut Vec<u8>,
) -> Option<u32> {
    let mut stage = [0; STAGE + 8];
    let mut adler = simd_adler32::Adler32::new();
    let mut filled = 0;
    for index in 0..rows.count() {
        piece[filled] = if index == 0 { SUB } else { PAETH };
        filled += 1;
        let mut from = 0;
        loop {
            let n = (PIECE - filled).min(rows.row_bytes() - from);
            filter(rows, index, from, &mut piece[filled..filled + n]);
            from += n;
            filled += n;
            if filled == PIECE {
                adler.write(piece);
                code_piece(piece, lookup, single, runs, &mut stage, bits, out);
                filled = 0;
                if out.len() > most {
                    return None;
                }
            }
            if from == rows.row_bytes() {
                break;
            }
        }
    }
    adler.write(&piece[..filled]);
    code_piece(&piece[..filled], lookup, single, runs, &mut stage, bits, out);
    (out.len() <= most).then(|| adler.finish())
}

#[inline(always)]
fn code_piece<L: Lookup>(
    piece: &[u8],
    lookup: &L,
    single: &Single,
    runs: &Runs,
    stage: &mut [u8; STAGE + 8],
    bits: &mut BitWriter,
    out: &mut Vec<u8>,
) {
    let mut coder = Coder { waiting: bits.waiting, filled: bits.filled, at: 0, lookup, single, runs, stage };
    walk(piece, &mut coder);
    let Coder { waiting, filled, at, .. } = coder;
    *bits = BitWriter { waiting, filled };
    out.extend_from_slice(&stage[..at]);
}

/// Takes filtered bytes apart: eight bytes that are not all zero, runs of zeros, and single bytes at the end.
trait Sink {
    fn eight(&mut self, bytes: u64);
    /// `count >= 8`.
    fn zeros(&mut self, count: usize);
    fn one(&mut self, byte: u8);
}

#[inline(always)]
fn walk<S: Sink>(bytes: &[u8], sink: &mut S) {
    let mut rest = bytes;
    while let Some((eight, after)) = rest.split_first_chunk::<8>() {
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

/// `count` zeros taken apart: a literal, `longest` matches of the longest length, a match of `matched` when not 0, and `literals` that are too few for one.
struct Zeros {
    longest: usize,
    matched: usize,
    literals: usize,
}

#[inline(always)]
fn split_zeros(count: usize) -> Zeros {
    let (longest, left) = ((count - 1) / LONGEST, (count - 1) % LONGEST);
    if left < SHORTEST { Zeros { longest, matched: 0, literals: left } } else { Zeros { longest, matched: left, literals: 0 } }
}

const SHORTEST: usize = 3;
const LONGEST: usize = 258;

/// First length and number of extra bits of the symbols 257 and on (RFC 1951, 3.2.5).
const LENGTHS: [(u16, u8); 29] = [
    (3, 0),
    (4, 0),
    (5, 0),
    (6, 0),
    (7, 0),
    (8, 0),
    (9, 0),
    (10, 0),
    (11, 1),
    (13, 1),
    (15, 1),
    (17, 1),
    (19, 2),
    (23, 2),
    (27, 2),
    (31, 2),
    (35, 3),
    (43, 3),
    (51, 3),
    (59, 3),
    (67, 4),
    (83, 4),
    (99, 4),
    (115, 4),
    (131, 5),
    (163, 5),
    (195, 5),
    (227, 5),
    (258, 0),
];

fn length_symbol(length: usize) -> usize {
    let above = LENGTHS.partition_point(|&(first, _)| usize::from(first) <= length);
    END + above
}

struct Counts {
    /// Four tables, so that equal neighbours do not wait for each other's store.
    bytes: [[u32; 256]; 4],
    lengths: [u32; LITERALS],
}

impl Default for Counts {
    fn default() -> Self {
        Self { bytes: [[0; 256]; 4], lengths: [0; LITERALS] }
    }
}

impl Counts {
    fn total(&self) -> [u32; LITERALS] {
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
        for (byte, lane) in bytes.to_le_bytes().into_iter().zip([0, 1, 2, 3, 0, 1, 2, 3]) {
            self.bytes[lane][usize::from(byte)] += 1;
        }
    }

    #[inline(always)]
    fn zeros(&mut self, count: usize) {
        let zeros = split_zeros(count);
        let count = |n: usize| u32::try_from(n).expect("at most a piece");
        self.bytes[0][0] += count(1 + zeros.literals);
        self.lengths[END + LENGTHS.len()] += count(zeros.longest);
        if zeros.matched > 0 {
            self.lengths[length_symbol(zeros.matched)] += 1;
        }
    }

    #[inline(always)]
    fn one(&mut self, byte: u8) {
        self.bytes[0][usize::from(byte)] += 1;
    }
}

/// Bits of an entry below its code. Seven, although a length needs five: four entries may be added and their lengths with them.
const LENGTH_BITS: u32 = 7;

/// `code << 7 | length`: a shift by an entry is a shift by its length, because shifts of 64-bit words look at six bits.
const fn entry(code: u32, length: u32) -> u32 {
    code << LENGTH_BITS | length
}

#[inline(always)]
const fn code(entry: u32) -> u64 {
    (entry >> LENGTH_BITS) as u64
}

/// The length of an entry, or of a sum of entries.
#[inline(always)]
const fn length(entry: u32) -> u32 {
    entry & ((1 << LENGTH_BITS) - 1)
}

/// Codes of two neighbouring bytes, the first lowest.
trait Lookup {
    fn two(&self, bytes: u16) -> u32;
}

/// One entry a byte.
struct Single([u32; 256]);

impl Single {
    fn new(codes: &Codes<LITERALS>) -> Self {
        Self(std::array::from_fn(|byte| entry(codes.bits[byte].into(), codes.length[byte].into())))
    }

    #[inline(always)]
    fn one(&self, byte: u8) -> u32 {
        self.0[usize::from(byte)]
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

struct Pairs<'a>(&'a [u32; 1 << 16]);

impl Lookup for Pairs<'_> {
    #[inline(always)]
    fn two(&self, bytes: u16) -> u32 {
        self.0[usize::from(bytes)]
    }
}

#[inline(always)]
fn fill_pairs(single: &Single, pairs: &mut [u32; 1 << 16]) {
    for (row, &second) in pairs.chunks_exact_mut(256).zip(&single.0) {
        for (two, &first) in row.iter_mut().zip(&single.0) {
            *two = pair(first, second);
        }
    }
}

/// Codes of runs by length, with extra bits and the distance's one bit.
struct Runs([u32; LONGEST + 1]);

impl Runs {
    fn new(codes: &Codes<LITERALS>) -> Self {
        Self(std::array::from_fn(|length| {
            if length < SHORTEST {
                return 0;
            }
            let symbol = length_symbol(length);
            let (first, extra_bits) = LENGTHS[symbol - END - 1];
            let (code, bits) = (u32::from(codes.bits[symbol]), u32::from(codes.length[symbol]));
            let extra = u32::try_from(length).expect("at most 258") - u32::from(first);
            // The distance code is a single zero bit.
            entry(code | extra << bits, bits + u32::from(extra_bits) + 1)
        }))
    }
}

struct Coder<'a, L> {
    waiting: u64,
    filled: u32,
    at: usize,
    lookup: &'a L,
    single: &'a Single,
    runs: &'a Runs,
    stage: &'a mut [u8; STAGE + 8],
}

impl<L: Lookup> Coder<'_, L> {
    /// `length <= 56`.
    #[inline(always)]
    fn put(&mut self, code: u64, length: u32) {
        self.waiting |= code << self.filled;
        self.filled += length;
        // Never masks anything (STAGE holds the longest coded piece); it stands for a bounds check.
        self.at &= STAGE - 1;
        self.stage[self.at..self.at + 8].copy_from_slice(&self.waiting.to_le_bytes());
        self.at += (self.filled / 8) as usize;
        self.waiting >>= self.filled & 56;
        self.filled &= 7;
    }

    #[inline(always)]
    fn put_entry(&mut self, entry: u32) {
        self.put(code(entry), length(entry));
    }
}

/// `code << length`, where `length < 64` are the low bits of an entry or of a sum of entries.
#[inline(always)]
const fn shifted(code: u64, entry: u32) -> u64 {
    code.wrapping_shl(entry)
}

impl<L: Lookup> Sink for Coder<'_, L> {
    #[inline(always)]
    fn eight(&mut self, bytes: u64) {
        let [a, b, c, d] = [0, 16, 32, 48].map(|shift| self.lookup.two((bytes >> shift) as u16));
        let (ab, cd) = (a.wrapping_add(b), c.wrapping_add(d));
        let first = code(a) | shifted(code(b), a);
        let second = code(c) | shifted(code(d), c);
        let whole = length(ab.wrapping_add(cd));
        if whole <= 56 {
            self.put(first | shifted(second, ab), whole);
        } else {
            self.put(first, length(ab));
            self.put(second, length(cd));
        }
    }

    #[inline(always)]
    fn zeros(&mut self, count: usize) {
        let zeros = split_zeros(count);
        let literal = self.single.one(0);
        self.put_entry(literal);
        for _ in 0..zeros.longest {
            self.put_entry(self.runs.0[LONGEST]);
        }
        if zeros.matched > 0 {
            self.put_entry(self.runs.0[zeros.matched]);
        }
        for _ in 0..zeros.literals {
            self.put_entry(literal);
        }
    }

    #[inline(always)]
    fn one(&mut self, byte: u8) {
        self.put_entry(self.single.one(byte));
    }
}
