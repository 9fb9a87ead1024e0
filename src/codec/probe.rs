//! STUB
use super::CodecError;
use crate::pixmap::Extent;

/// A file format that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
    /// WebP.
    WebP,
}

/// What a file's header says; nothing was allocated to learn it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Format by the file's first bytes, whatever its name.
    pub format: Format,
    /// Size of the upright picture (EXIF orientation applied).
    pub extent: Extent,
}

/// Reads the header only.
pub fn probe(_bytes: &[u8]) -> Result<Header, CodecError> {
    todo!()
}
