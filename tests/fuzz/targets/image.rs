//! Any bytes as a picture's file, behind limits. What is decoded is what the header said, and neither takes more than it said.

use mlswarp::codec::{self, Limits, probe};

const LIMITS: Limits = Limits { max_pixels: 1 << 20, max_side: 1 << 12 };
/// Most bytes that decoding a picture within the limits may be predicted to take beside five times the file: 16 a pixel, its tables, 2 MiB.
const MOST: u64 = (16 << 20) + (128 << 20) + (2 << 20);

pub(super) fn decode(bytes: &[u8]) {
    let header = probe(bytes);
    let Ok(decoded) = codec::decode(bytes, &LIMITS) else { return };
    let header = header.expect("what is decoded has a header");
    let pixmap = &decoded.pixmap;
    assert_eq!((header.extent, header.channels, header.depth), (pixmap.extent(), pixmap.channels(), pixmap.depth()));
    assert!(header.decode_bytes > pixmap.bytes() as u64);
    assert!(header.decode_bytes <= MOST + 5 * bytes.len() as u64, "{} bytes", header.decode_bytes);
}
