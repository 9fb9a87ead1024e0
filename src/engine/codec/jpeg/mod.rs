//! JPEG files: the reader and the writer.

pub(super) mod read;
pub(super) mod write;
