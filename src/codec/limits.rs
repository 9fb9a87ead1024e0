//! Limits of one picture, checked on numbers in a header, not on memory.

/// What one picture may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Pixels in all.
    pub max_pixels: u64,
    /// Pixels along either side.
    pub max_side: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_pixels: 50_000_000, max_side: 16_384 }
    }
}
