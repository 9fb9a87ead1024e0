//! The header of a deflate block with a code of its own (RFC 1951, 3.2.7).

use crate::codec::bits::BitWriter;
use crate::codec::prefix_code::{Codes, SentLengths};

/// Symbols of the literal and length alphabet: bytes, end of block, 29 lengths.
pub(super) const LITERAL_SYMBOLS: usize = 286;

/// The end of a block.
pub(super) const END_OF_BLOCK: usize = 256;

/// The order in which the lengths of the code of lengths are sent.
const LENGTH_ORDER: [usize; 19] = [
    16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15,
];

/// Writes the header of a block of dynamic codes: `codes` for literals and lengths, and one
/// distance code for distance 1, one bit long.
pub(super) fn block_header(
    codes: &Codes<LITERAL_SYMBOLS>,
    last: bool,
    bits: &mut BitWriter,
    out: &mut Vec<u8>,
) {
    let mut lengths = codes.length.to_vec();
    lengths.push(1);
    let sent = SentLengths::new(&lengths);
    bits.put(out, u64::from(last), 1);
    bits.put(out, 2, 2);
    bits.put(out, (LITERAL_SYMBOLS - 257) as u64, 5);
    bits.put(out, 0, 5);
    sent.put_code(&LENGTH_ORDER, bits, out);
    sent.put_runs(bits, out);
}
