//! JPEG files: the reader and the writer.

#[forbid(unsafe_code)]
pub(super) mod read;
pub(super) mod write;
