//! What a file says of itself before it is decoded. The format is told by the first bytes, never by a name. Everything here
//! reads numbers out of headers: the file is walked chunk by chunk, nothing proportional to the picture is allocated, and
//! every size is computed in u64. `Header::decode_bytes` is what a caller reserves before it lets `decode` run.

use super::orientation::Orientation;
use super::{CodecError, Format, StepCounter, jpeg, png, webp};
use crate::pixmap::{Channels, Depth, Extent};

/// What a file's header says; nothing was allocated to learn it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Format by the file's first bytes, whatever its name.
    pub format: Format,
    /// Size of the upright picture (EXIF orientation applied).
    pub extent: Extent,
    /// What `decode` yields: RGBA when the file can hold transparency, else RGB (grey included).
    pub channels: Channels,
    /// What `decode` yields: sixteen bit for a 16-bit PNG, else eight.
    pub depth: Depth,
    /// Predicted peak of memory while decoding, bytes: the picture, the decoder's own planes, and what turning it upright takes. Never less
    /// than the real one; for a lossless WebP [`super::Opened::header`] is closer, for it has read the codes.
    pub decode_bytes: u64,
}

/// What the allocator keeps of a decoder's tables and rows, measured below 700 KiB.
const TURNING_SLACK: u64 = 1 << 20;

/// A recognised file whose header has been read.
#[derive(Debug)]
pub(super) enum Parsed<'a> {
    Png(png::read::PngFile<'a>),
    Jpeg(jpeg::read::JpegFile<'a>),
    WebP(webp::read::WebPFile<'a>),
}

impl<'a> Parsed<'a> {
    pub(super) fn new(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        Ok(match Format::of(bytes)? {
            Format::Png => Self::Png(png::read::PngFile::parse(bytes, work)?),
            Format::Jpeg => Self::Jpeg(jpeg::read::JpegFile::parse(bytes, work)?),
            Format::WebP => Self::WebP(webp::read::WebPFile::parse(bytes, work)?),
        })
    }

    pub(super) fn orientation(&self) -> Orientation {
        let exif = match self {
            Self::Png(file) => file.exif,
            Self::Jpeg(file) => file.exif,
            Self::WebP(file) => file.exif,
        };
        exif.map_or_else(Orientation::default, Orientation::from_exif)
    }

    /// Width and height as the rows are stored.
    pub(super) fn stored(&self) -> Extent {
        match self {
            Self::Png(file) => file.extent,
            Self::Jpeg(file) => file.extent,
            Self::WebP(file) => file.extent,
        }
    }

    pub(super) fn header(&self) -> Header {
        let (format, channels, depth, decoder_bytes) = match self {
            Self::Png(file) => (Format::Png, file.channels(), file.depth(), file.decoder_bytes()),
            Self::Jpeg(file) => (Format::Jpeg, Channels::Rgb, Depth::Eight, file.decoder_bytes()),
            Self::WebP(file) => (Format::WebP, file.channels(), Depth::Eight, file.decoder_bytes()),
        };
        let stored = self.stored();
        let picture = picture_bytes(stored, channels, depth);
        let swaps = self.orientation().swaps_sides();
        let extent = if swaps { Extent::new(stored.height(), stored.width()).expect("both sides are non-zero") } else { stored };
        // The decoder's planes are gone when the picture is turned, so the peak is the larger of the two, not the sum; its
        // small blocks stay with the allocator.
        let beside = if swaps { decoder_bytes.max(picture.saturating_add(TURNING_SLACK)) } else { decoder_bytes };
        Header { format, extent, channels, depth, decode_bytes: picture.saturating_add(beside) }
    }
}

/// Bytes of the samples.
pub(super) fn picture_bytes(extent: Extent, channels: Channels, depth: Depth) -> u64 {
    extent.pixels().saturating_mul((channels.count() * depth.bytes()) as u64)
}

/// Reads the header only: a few steps for each chunk or segment of the file, whatever sizes they claim.
///
/// # Errors
/// [`CodecError::Unsupported`] when the format (or its variant) is not read, [`CodecError::TooLarge`] for an animation,
/// [`CodecError::Bad`] when the header itself is damaged. Limits on size are the caller's: see [`super::Limits::check`].
pub fn probe(bytes: &[u8], work: &StepCounter<'_>) -> Result<Header, CodecError> {
    Parsed::new(bytes, work).map(|parsed| parsed.header())
}
