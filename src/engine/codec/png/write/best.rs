//! `Compression::Best`: every row uses the filter with the least sum of absolute residuals (PNG 3rd
//! edition, 12.7), and the strip is coded twice: by flate2 at its highest level, and without
//! matches in blocks of 64 KiB with a code each. The smaller result is kept. For photographs it is
//! the second (short distant matches cost more than the literals that they replace, and flate2 has
//! no `Z_FILTERED` to forbid them), for drawings the first, by far. Scratch: five rows, a block,
//! one coded strip, and the library's state. Cost: about 0.2 us per byte.

use flate2::{Compress, Compression, FlushCompress};

use super::rows::{self, PAETH, SUB, StripRows};
use super::{fast, stored};
use crate::codec::bits::BitWriter;

/// The compression level of the library: its highest with a window of 32 KiB.
const DEFLATE_LEVEL: u32 = 9;

/// Filtered bytes of a block without matches, exceeded by at most a row.
const BLOCK_BYTES: usize = 64 << 10;

/// Appends the deflate blocks of one strip, ended on a byte; returns the Adler-32 of the filtered
/// rows. Stops between rows when `wanted` returns false; the output is then incomplete.
pub(super) fn encode(
    rows: StripRows<'_>,
    last: bool,
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) -> u32 {
    let start = out.len();
    let filtered = rows.filtered_len();
    let most = filtered
        + usize::try_from(stored::overhead(filtered as u64))
            .expect("less than the rows themselves");
    out.reserve(filtered / 2 + 1024);
    let adler = with_matches(rows, last, out, wanted);
    let literal = without_matches(rows, last, filtered / 2, wanted);
    if literal.len() < out.len() - start {
        out.truncate(start);
        out.extend_from_slice(&literal);
    }
    if out.len() - start > most {
        out.truncate(start);
        return stored::encode(rows, last, out);
    }
    adler
}

fn with_matches(
    rows: StripRows<'_>,
    last: bool,
    out: &mut Vec<u8>,
    wanted: &dyn Fn() -> bool,
) -> u32 {
    let mut adler = simd_adler32::Adler32::new();
    let mut deflate = Compress::new(Compression::new(DEFLATE_LEVEL), false);
    for_each_filtered(rows, wanted, |row| {
        adler.write(row);
        feed(&mut deflate, row, FlushCompress::None, out);
    });
    feed(
        &mut deflate,
        &[],
        if last {
            FlushCompress::Finish
        } else {
            FlushCompress::Sync
        },
        out,
    );
    adler.finish()
}

fn without_matches(
    rows: StripRows<'_>,
    last: bool,
    reserve: usize,
    wanted: &dyn Fn() -> bool,
) -> Vec<u8> {
    let mut out = Vec::with_capacity(reserve);
    let mut bits = BitWriter::default();
    let mut block = Vec::with_capacity(BLOCK_BYTES.min(rows.filtered_len()) + rows.row_bytes() + 1);
    let mut left = rows.filtered_len();
    for_each_filtered(rows, wanted, |row| {
        block.extend_from_slice(row);
        left -= row.len();
        if block.len() >= BLOCK_BYTES || left == 0 {
            fast::block(&block, last && left == 0, &mut bits, &mut out);
            block.clear();
        }
    });
    fast::end(last, &mut bits, &mut out);
    out
}

/// Calls `take` with every filtered row, including its filter byte, as long as it is wanted.
fn for_each_filtered(rows: StripRows<'_>, wanted: &dyn Fn() -> bool, mut take: impl FnMut(&[u8])) {
    let mut candidates: [Vec<u8>; 5] = std::array::from_fn(|filter| {
        let mut row = vec![0; rows.row_bytes() + 1];
        row[0] = u8::try_from(filter).expect("five filters");
        row
    });
    for index in (0..rows.count()).take_while(|_| wanted()) {
        take(choose(rows, index, &mut candidates));
    }
}

/// Filters one row with every allowed filter and returns the result with the smallest residuals, as
/// signed bytes.
fn choose<'a>(rows: StripRows<'_>, index: usize, candidates: &'a mut [Vec<u8>; 5]) -> &'a [u8] {
    let (row, bpp) = (rows.row(index), rows.bpp());
    candidates[0][1..].copy_from_slice(row);
    rows::sub(row, bpp, 0, &mut candidates[usize::from(SUB)][1..]);
    let open = if index == 0 {
        2
    } else {
        let above = rows.row(index - 1);
        rows::up(row, above, 0, &mut candidates[2][1..]);
        rows::average(row, above, bpp, &mut candidates[3][1..]);
        rows::paeth(row, above, bpp, 0, &mut candidates[usize::from(PAETH)][1..]);
        5
    };
    let size = |row: &Vec<u8>| {
        row[1..]
            .iter()
            .map(|&residual| u64::from(residual.cast_signed().unsigned_abs()))
            .sum::<u64>()
    };
    candidates[..open]
        .iter()
        .min_by_key(|row| size(row))
        .expect("two filters at least")
}

/// Passes `input` to the library and appends its output.
fn feed(deflate: &mut Compress, mut input: &[u8], flush: FlushCompress, out: &mut Vec<u8>) {
    loop {
        out.reserve(4096);
        let before = deflate.total_in();
        let status = deflate
            .compress_vec(input, out, flush)
            .expect("a compressor without a dictionary has no errors");
        let taken = usize::try_from(deflate.total_in() - before).expect("at most the input");
        input = &input[taken..];
        let room = out.len() < out.capacity();
        if status == flate2::Status::StreamEnd
            || (input.is_empty() && room && !matches!(flush, FlushCompress::Finish))
        {
            return;
        }
    }
}
