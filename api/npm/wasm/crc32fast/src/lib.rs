//! CRC-32 of PNG (RFC 2083, appendix), with the functions of the crate of this name that the
//! engine and the crate `png` call. The tables of that crate are 16 KiB that cannot be compressed;
//! here the first call computes them.

use std::array;
use std::sync::LazyLock;

/// Bytes that are added at a time.
const STEP: usize = 8;

/// What a byte adds to a sum, when 0 to 7 zeros follow it.
static TABLES: LazyLock<Box<[[u32; 256]; STEP]>> = LazyLock::new(|| {
    let one = |byte: usize| {
        (0..8).fold(u32::try_from(byte).unwrap_or(0), |sum, _| {
            sum >> 1 ^ if sum & 1 == 0 { 0 } else { 0xedb8_8320 }
        })
    };
    let first: [u32; 256] = array::from_fn(one);
    let mut tables = Box::new([first; STEP]);
    for zeros in 1..STEP {
        tables[zeros] = tables[zeros - 1].map(|sum| sum >> 8 ^ first[sum as usize & 0xff]);
    }
    tables
});

/// The sum of the bytes so far.
#[derive(Clone, Debug, Default)]
pub struct Hasher(u32);

impl Hasher {
    /// The sum of no bytes.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        let tables = &**TABLES;
        let (steps, rest) = bytes.as_chunks::<STEP>();
        let sum = steps.iter().fold(!self.0, |sum, step| {
            let bytes = (u64::from_le_bytes(*step) ^ u64::from(sum)).to_le_bytes();
            let parts = bytes.iter().zip(tables.iter().rev());
            parts.fold(0, |sum, (byte, table)| sum ^ table[usize::from(*byte)])
        });
        self.0 = !rest.iter().fold(sum, |sum, byte| {
            sum >> 8 ^ tables[0][(sum as usize ^ usize::from(*byte)) & 0xff]
        });
    }

    /// The sum.
    #[must_use]
    pub fn finalize(self) -> u32 {
        self.0
    }

    /// Starts again.
    pub fn reset(&mut self) {
        self.0 = 0;
    }
}

/// The sum of these bytes.
#[must_use]
pub fn hash(bytes: &[u8]) -> u32 {
    let mut sum = Hasher::new();
    sum.update(bytes);
    sum.finalize()
}
