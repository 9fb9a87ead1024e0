//! WebP files: the reader, its check of lossless streams, and the writer.

mod encode;
pub(super) mod read;
mod vp8l;
pub(super) mod write;
