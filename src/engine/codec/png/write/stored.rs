//! Stored deflate blocks (RFC 1951, 3.2.4) of unfiltered rows: used by `Compression::None`, and as
//! the fallback if coding would make a strip longer. One copy, one Adler-32 pass over bytes still
//! in the cache. Shapes: samples `[rows][row_bytes]`.

use super::rows::StripRows;

/// Most bytes of one block.
const MAX_BLOCK_BYTES: usize = 65_535;

/// Header bytes of one block.
const BLOCK_HEADER_BYTES: u64 = 5;

/// Bytes that storing `filtered` bytes adds.
pub(super) const fn overhead(filtered: u64) -> u64 {
    BLOCK_HEADER_BYTES * filtered.div_ceil(MAX_BLOCK_BYTES as u64)
}

/// Appends all rows with filter 0; returns their Adler-32.
pub(super) fn encode(rows: StripRows<'_>, last: bool, out: &mut Vec<u8>) -> u32 {
    let filtered = rows.filtered_len();
    out.reserve(
        filtered
            + usize::try_from(overhead(filtered as u64)).expect("less than the rows themselves"),
    );
    let mut adler = simd_adler32::Adler32::new();
    let mut left = filtered;
    let mut block = begin(out, left, last);
    let mut put = |mut bytes: &[u8], out: &mut Vec<u8>| {
        while !bytes.is_empty() {
            if block.room == 0 {
                adler.write(&out[block.start..]);
                left -= out.len() - block.start;
                block = begin(out, left, last);
            }
            let (now, later) = bytes.split_at(bytes.len().min(block.room));
            out.extend_from_slice(now);
            block.room -= now.len();
            bytes = later;
        }
    };
    for row in rows.iter() {
        put(&[0], out);
        put(row, out);
    }
    adler.write(&out[block.start..]);
    adler.finish()
}

struct StoredBlock {
    start: usize,
    room: usize,
}

fn begin(out: &mut Vec<u8>, left: usize, last: bool) -> StoredBlock {
    let room = left.min(MAX_BLOCK_BYTES);
    let length = u16::try_from(room).expect("BLOCK is the largest u16");
    out.push(u8::from(last && left <= MAX_BLOCK_BYTES));
    out.extend_from_slice(&length.to_le_bytes());
    out.extend_from_slice(&(!length).to_le_bytes());
    StoredBlock {
        start: out.len(),
        room,
    }
}
