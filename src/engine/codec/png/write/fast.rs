//! `Compression::Fast`: Paeth residuals (the strip's first row: Sub), an order-0 Huffman code of at
//! most 12 bits for them, and runs of zeros as matches of distance 1. No match search. The code is
//! made from a sample of the strip's rows; every byte and every length has a code, so all other
//! rows can be written too. Rows are filtered in pieces of 4 KiB that are coded while they are in
//! the first-level cache. Cost: about 0.4 ns per byte, and scratch of 256 KiB per thread. Rejected
//! variants: `notes.md`.

use std::cell::Cell;

use super::block::{END_OF_BLOCK, LITERAL_SYMBOLS, block_header};
use super::coder::{
    CodeBuffer, Counts, Lookup, MAX_CODE_BITS, PIECE_BYTES, PairTable, STAGE_EMPTY, Single, Tables,
    code_piece, fill_pairs, walk,
};
use super::rows::{self, PAETH, SUB, StripRows};
use crate::codec::bits::BitWriter;
use crate::codec::prefix_code::Codes;

/// Size of the sample from which the code is made, filtered bytes.
const SAMPLE_BYTES: usize = 16 << 10;

/// Weight of a sampled byte relative to the minimum of every symbol.
const SAMPLED_WEIGHT: u32 = 8;

/// Smaller strips look up single bytes, because the table of pairs costs about 15 us.
const PAIRS_FROM_BYTES: usize = 48 << 10;

/// The parts of `body` that differ between levels. The defaults are the portable code.
pub(super) trait FastKernel: Sized {
    /// Codes all rows, looking up two bytes at a time, or one in small strips. A method and not a
    /// closure, so that it is compiled for the level of its caller.
    #[inline(always)]
    fn code(single: &Single, coder: RowCoder<'_>) -> Option<u32> {
        if coder.rows.filtered_len() < PAIRS_FROM_BYTES {
            return coder.code::<Self>(single);
        }
        let mut pairs = PAIRS
            .take()
            .unwrap_or_else(|| vec![0; 1 << 16].try_into().expect("65536 entries"));
        fill_pairs(single, &mut pairs);
        let adler = coder.code::<Self>(&*pairs);
        PAIRS.set(Some(pairs));
        adler
    }

    /// Calls `code_piece` as a function of its own. Inlined into the loop over rows, some variables
    /// of its inner loop are kept in memory (56 to 58 instructions for eight bytes, not 54),
    /// depending on how the crate is divided for compilation.
    #[inline(never)]
    fn piece<L: Lookup>(
        piece: &[u8],
        tables: Tables<'_, L>,
        stage: &mut CodeBuffer,
        bits: &mut BitWriter,
        out: &mut Vec<u8>,
    ) {
        code_piece(piece, tables, stage, bits, out);
    }
}

/// The defaults.
pub(super) struct Portable;

impl FastKernel for Portable {}

/// Codes a strip; `None` as soon as `out` is longer than `most`. Compiled once per level.
#[inline(always)]
pub(super) fn body<K: FastKernel>(
    rows: StripRows<'_>,
    last: bool,
    most: usize,
    out: &mut Vec<u8>,
) -> Option<u32> {
    let mut piece = [0; PIECE_BYTES];
    let codes = Codes::new(&sample(rows, &mut piece), MAX_CODE_BITS);
    let mut bits = BitWriter::default();
    block_header(&codes, last, &mut bits, out);
    let single = Single::new(&codes);
    let coder = RowCoder {
        rows,
        single: &single,
        piece: &mut piece,
        bits: &mut bits,
        most,
        out: &mut *out,
    };
    let adler = K::code(&single, coder)?;
    bits.put(
        out,
        codes.bits[END_OF_BLOCK].into(),
        codes.length[END_OF_BLOCK].into(),
    );
    end(last, &mut bits, out);
    (out.len() <= most).then_some(adler)
}

/// Ends a strip on a byte, with an empty stored block if another strip follows.
pub(super) fn end(last: bool, bits: &mut BitWriter, out: &mut Vec<u8>) {
    if !last {
        bits.put(out, 0, 3);
        bits.pad(out);
        out.extend_from_slice(&[0, 0, 0xff, 0xff]);
    }
    bits.pad(out);
}

/// One block of filtered bytes with the optimal code for exactly them; for `Compression::Best`.
pub(super) fn block(filtered: &[u8], last: bool, bits: &mut BitWriter, out: &mut Vec<u8>) {
    let mut counts = Counts::default();
    filtered
        .chunks(PIECE_BYTES)
        .for_each(|piece| walk(piece, &mut counts));
    let mut weights = counts.total();
    weights[END_OF_BLOCK] = 1;
    let codes = Codes::new(&weights, MAX_CODE_BITS);
    block_header(&codes, last, bits, out);
    let single = Single::new(&codes);
    let mut stage = STAGE_EMPTY;
    for piece in filtered.chunks(PIECE_BYTES) {
        code_piece(
            piece,
            Tables {
                pairs: &single,
                single: &single,
            },
            &mut stage,
            bits,
            out,
        );
    }
    bits.put(
        out,
        codes.bits[END_OF_BLOCK].into(),
        codes.length[END_OF_BLOCK].into(),
    );
}

thread_local! {
    /// Kept between strips, which saves the page faults of its 64 pages.
    static PAIRS: Cell<Option<Box<PairTable>>> = const { Cell::new(None) };
}

/// Weights of all symbols, from about `SAMPLE_BYTES` bytes of evenly spaced rows.
#[inline(always)]
fn sample(rows: StripRows<'_>, piece: &mut [u8; PIECE_BYTES]) -> [u32; LITERAL_SYMBOLS] {
    let mut counts = Counts::default();
    let step = (rows.filtered_len() / SAMPLE_BYTES).clamp(1, rows.count());
    // The middle of every group of `step` rows; never the first row alone, which has another
    // filter.
    let mut index = step / 2;
    while index < rows.count() {
        let mut from = 0;
        while from < rows.row_bytes() {
            let n = PIECE_BYTES.min(rows.row_bytes() - from);
            filter(rows, index, from, &mut piece[..n]);
            walk(&piece[..n], &mut counts);
            from += n;
        }
        index += step;
    }
    let mut weights = counts
        .total()
        .map(|weight| weight.saturating_mul(SAMPLED_WEIGHT).saturating_add(1));
    let sampled = u32::try_from(rows.count() / step).unwrap_or(u32::MAX);
    weights[usize::from(PAETH)] =
        weights[usize::from(PAETH)].saturating_add(sampled.saturating_mul(SAMPLED_WEIGHT));
    weights
}

#[inline(always)]
fn filter(rows: StripRows<'_>, index: usize, from: usize, out: &mut [u8]) {
    if index == 0 {
        rows::sub(rows.row(0), rows.bpp(), from, out);
    } else {
        rows::paeth(rows.row(index), rows.row(index - 1), rows.bpp(), from, out);
    }
}

/// The state of coding a strip's rows.
pub(super) struct RowCoder<'a> {
    rows: StripRows<'a>,
    single: &'a Single,
    piece: &'a mut [u8; PIECE_BYTES],
    bits: &'a mut BitWriter,
    most: usize,
    out: &'a mut Vec<u8>,
}

impl RowCoder<'_> {
    /// Filters and codes all rows; `None` as soon as `out` is longer than `most`.
    #[inline(always)]
    pub(super) fn code<K: FastKernel>(self, lookup: &impl Lookup) -> Option<u32> {
        let Self {
            rows,
            single,
            piece,
            bits,
            most,
            out,
        } = self;
        let mut stage = STAGE_EMPTY;
        let mut adler = simd_adler32::Adler32::new();
        let mut filled = 0;
        for index in 0..rows.count() {
            piece[filled] = if index == 0 { SUB } else { PAETH };
            filled += 1;
            let mut from = 0;
            loop {
                let n = (PIECE_BYTES - filled).min(rows.row_bytes() - from);
                filter(rows, index, from, &mut piece[filled..filled + n]);
                from += n;
                filled += n;
                if filled == PIECE_BYTES {
                    adler.write(piece);
                    K::piece(
                        piece,
                        Tables {
                            pairs: lookup,
                            single,
                        },
                        &mut stage,
                        bits,
                        out,
                    );
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
        K::piece(
            &piece[..filled],
            Tables {
                pairs: lookup,
                single,
            },
            &mut stage,
            bits,
            out,
        );
        (out.len() <= most).then(|| adler.finish())
    }
}
