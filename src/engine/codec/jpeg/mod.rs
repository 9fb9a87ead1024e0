//! JPEG files: the reader and the writer.

#[forbid(unsafe_code)]
pub(super) mod read;
#[forbid(unsafe_code)]
mod scans;
#[forbid(unsafe_code)]
mod segments;
pub(super) mod write;
