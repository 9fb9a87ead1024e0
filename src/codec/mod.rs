//! Bytes to pixels and pixels to bytes. `probe` reads a header and allocates nothing; `decode` checks every limit on that header
//! before it takes memory; `PngWriter` turns strips of rows into PNG bytes, strip by strip, in any order.

mod decode;
mod error;
mod limits;
mod orientation;
mod png;
mod probe;
mod read_jpeg;
mod read_png;
mod read_webp;
#[cfg(test)]
mod tests;

pub use decode::{Decoded, decode};
pub use error::CodecError;
pub use limits::Limits;
pub use png::{Compression, PngShape, PngWriter, Strip};
pub use probe::{Format, Header, probe};
