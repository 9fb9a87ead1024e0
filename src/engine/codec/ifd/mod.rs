//! Image file directories, the lists of tags of TIFF and EXIF.

pub(super) mod read;
pub(super) mod write;
