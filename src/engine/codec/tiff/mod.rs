//! TIFF files (TIFF 6.0): the reader and the writer.

mod data;
mod directory;
pub(super) mod floats;
pub(super) mod read;
pub(super) mod write;
