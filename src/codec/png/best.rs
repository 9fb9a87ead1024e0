//! `Compression::Best`: every row takes the filter with the least sum of absolute residuals (PNG 3rd edition, 12.7), and flate2 at its
//! highest level does the rest. A strip is flushed to a byte (`Z_SYNC_FLUSH`), the last one finished. Scratch: five rows and what the library keeps.

use flate2::{Compress, Compression, FlushCompress};

use super::rows::{self, PAETH, Rows, SUB};
use super::stored;

/// Level of the library: its highest that reads 32 KiB back.
const LEVEL: u32 = 9;

/// Appends the deflate blocks of one strip, ended on a byte; returns the Adler-32 of the filtered rows.
pub(super) fn encode(rows: Rows<'_>, last: bool, out: &mut Vec<u8>) -> u32 {
    let start = out.len();
    let filtered = rows.filtered_len();
    let most = filtered + usize::try_from(stored::overhead(filtered as u64)).expect("less than the rows themselves");
    out.reserve(filtered / 2 + 1024);
    let mut adler = simd_adler32::Adler32::new();
    let mut deflate = Compress::new(Compression::new(LEVEL), false);
    let mut candidates: [Vec<u8>; 5] = std::array::from_fn(|filter| {
        let mut row = vec![0; rows.row_bytes() + 1];
        row[0] = u8::try_from(filter).expect("five filters");
        row
    });
    for index in 0..rows.count() {
        let chosen = choose(rows, index, &mut candidates);
        adler.write(chosen);
        feed(&mut deflate, chosen, FlushCompress::None, out);
        if out.len() - start > most {
            break;
        }
    }
    feed(&mut deflate, &[], if last { FlushCompress::Finish } else { FlushCompress::Sync }, out);
    if out.len() - start > most {
        out.truncate(start);
        return stored::encode(rows, last, out);
    }
    adler.finish()
}

/// Filters one row in all ways that are open to it and returns the one with the smallest residuals, as signed bytes.
fn choose<'a>(rows: Rows<'_>, index: usize, candidates: &'a mut [Vec<u8>; 5]) -> &'a [u8] {
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
    let size = |row: &Vec<u8>| row[1..].iter().map(|&residual| u64::from(residual.cast_signed().unsigned_abs())).sum::<u64>();
    candidates[..open].iter().min_by_key(|row| size(row)).expect("two filters at least")
}

/// Hands `input` to the library and takes all that it gives back.
fn feed(deflate: &mut Compress, mut input: &[u8], flush: FlushCompress, out: &mut Vec<u8>) {
    loop {
        out.reserve(4096);
        let before = deflate.total_in();
        let status = deflate.compress_vec(input, out, flush).expect("a compressor without a dictionary has no errors");
        let taken = usize::try_from(deflate.total_in() - before).expect("at most the input");
        input = &input[taken..];
        let room = out.len() < out.capacity();
        if status == flate2::Status::StreamEnd || (input.is_empty() && room && !matches!(flush, FlushCompress::Finish)) {
            return;
        }
    }
}
