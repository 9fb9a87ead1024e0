//! Reads and writes image files. [`probe`] reads a header and allocates nothing; [`open`] checks
//! the limits on that header before memory is allocated for the image, and [`Opened::decode`]
//! decodes the pixels until it is cancelled; [`Writer`] encodes strips of rows into a file, PNG and
//! JPEG strip by strip in any order.

#[forbid(unsafe_code)]
mod alloc;
#[forbid(unsafe_code)]
mod bits;
#[forbid(unsafe_code)]
mod bmp;
#[forbid(unsafe_code)]
mod decode;
#[forbid(unsafe_code)]
mod encoder;
#[forbid(unsafe_code)]
mod gif;
#[forbid(unsafe_code)]
mod ifd;
mod jpeg;
#[forbid(unsafe_code)]
mod labels;
#[forbid(unsafe_code)]
mod metadata;
#[forbid(unsafe_code)]
mod orientation;
mod png;
#[forbid(unsafe_code)]
mod prefix_code;
#[forbid(unsafe_code)]
mod probe;
#[forbid(unsafe_code)]
mod profile;
#[cfg(test)]
mod tests;
#[forbid(unsafe_code)]
mod tiff;
#[forbid(unsafe_code)]
mod webp;
#[forbid(unsafe_code)]
mod work;
#[forbid(unsafe_code)]
mod write;

pub use decode::{Decoded, Opened, decode, open};
pub use gif::write::GifAnimation;
pub use jpeg::write::JpegWriter;
pub use labels::{DecodedLabels, open_labels};
pub use metadata::{Carried, METADATA_BYTES, Metadata, Ratio, Resolution, ResolutionUnit};
pub use png::write::{Animation, PngWriter, Profile, Strip, StripChecksum};
pub use probe::{Header, probe};
pub use profile::PROFILE_BYTES;
pub use tiff::floats::FloatTiff;
pub use work::StepCounter;
pub use write::Writer;

pub use crate::format::{
    CodecError, Compression, Dropped, DroppedKind, Encoding, Format, ImageLimits, Repairs,
    SourceFormat, Subsampling,
};
pub use crate::pixmap::{Labels, Palette, PixelLayout};
