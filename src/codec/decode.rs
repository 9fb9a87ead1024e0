//! STUB
use super::{CodecError, Limits};
use crate::pixmap::Pixmap;

/// An upright picture and what must travel with it.
#[derive(Debug, Clone)]
pub struct Decoded {
    /// The upright pixels.
    pub pixmap: Pixmap,
    /// The file's ICC profile when it describes RGB, to be written back.
    pub icc: Option<Vec<u8>>,
}

/// Decodes a file after its header has passed `limits`.
pub fn decode(_bytes: &[u8], _limits: &Limits) -> Result<Decoded, CodecError> {
    todo!()
}
