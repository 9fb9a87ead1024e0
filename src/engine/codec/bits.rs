//! A little-endian bit stream (RFC 1951, 3.1.1). Up to 7 bits wait between calls, so a `put` of at
//! most 56 bits always fits. This writer is for headers and ends; the coding loop keeps the same
//! two words in registers.

/// Bits that do not fill a byte yet.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BitWriter {
    /// The waiting bits, first lowest; zero above `filled`.
    pub(super) waiting: u64,
    /// How many, below 8.
    pub(super) filled: u32,
}

impl BitWriter {
    /// Appends the low `length <= 56` bits of `code`, whose other bits are zero.
    pub(super) fn put(&mut self, out: &mut Vec<u8>, code: u64, length: u32) {
        debug_assert!(length <= 56 && code >> length == 0);
        self.waiting |= code << self.filled;
        self.filled += length;
        let whole = self.filled as usize / 8;
        out.extend_from_slice(&self.waiting.to_le_bytes()[..whole]);
        self.waiting >>= self.filled & 56;
        self.filled &= 7;
    }

    /// Fills the last byte with zeros.
    pub(super) fn pad(&mut self, out: &mut Vec<u8>) {
        self.put(out, 0, (8 - self.filled) & 7);
    }
}
