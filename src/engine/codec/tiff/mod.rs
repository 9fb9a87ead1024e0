//! TIFF files (TIFF 6.0, `BigTIFF`): the reader and the writer.

mod data;
mod fax;
pub(super) mod floats;
mod found;
mod pages;
mod parts;
pub(super) mod read;
mod samples;
pub(super) mod write;
