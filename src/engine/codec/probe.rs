//! Reads the header of a file. The first bytes determine the format, never a name. The file is
//! walked chunk by chunk, nothing proportional to the image is allocated, and sizes are computed
//! in u64. Callers reserve `Header::decode_bytes` before decoding.

use super::metadata::Found;
use super::orientation::ExifOrientation;
use super::{CodecError, Format, SourceFormat, StepCounter, bmp, gif, jpeg, png, tiff, webp};
use crate::pixmap::{Channels, Depth, Extent, sample_bytes};

/// The header of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Format by the file's first bytes.
    pub format: SourceFormat,
    /// Size of the upright image (EXIF orientation applied).
    pub extent: Extent,
    /// Channels of the decoded image: RGBA if the file can hold transparency, else RGB (grey
    /// included).
    pub channels: Channels,
    /// Whether the colours of every pixel are equal, because the file stores one sample for them.
    pub grey: bool,
    /// Depth of the decoded image: sixteen bit for a 16-bit PNG or TIFF, else eight.
    pub depth: Depth,
    /// Upper bound of the memory for decoding, bytes: the image, the decoder's planes, and the
    /// second image of an orientation. For a lossless WebP [`super::Opened::header`] is closer,
    /// because it has read the prefix codes.
    pub decode_bytes: u64,
}

/// Memory that the allocator keeps of a decoder's tables and rows; measured below 700 KiB.
const TURNING_SLACK: u64 = 1 << 20;

/// A file whose header has been read.
#[derive(Debug)]
pub(super) enum Parsed<'a> {
    Png(png::read::PngFile<'a>),
    Jpeg(jpeg::read::JpegFile<'a>),
    WebP(webp::read::WebPFile<'a>),
    Tiff(tiff::read::TiffFile<'a>),
    Gif(gif::read::GifFile<'a>),
    Bmp(bmp::BmpFile<'a>),
}

impl<'a> Parsed<'a> {
    pub(super) fn new(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        Ok(match SourceFormat::of(bytes)? {
            SourceFormat::Written(Format::Png) => {
                Self::Png(png::read::PngFile::parse(bytes, work)?)
            }
            SourceFormat::Written(Format::Jpeg) => {
                Self::Jpeg(jpeg::read::JpegFile::parse(bytes, work)?)
            }
            SourceFormat::Written(Format::WebP) => {
                Self::WebP(webp::read::WebPFile::parse(bytes, work)?)
            }
            SourceFormat::Written(Format::Tiff) => {
                Self::Tiff(tiff::read::TiffFile::parse(bytes, work)?)
            }
            SourceFormat::Written(Format::Gif) => {
                Self::Gif(gif::read::GifFile::parse(bytes, work)?)
            }
            SourceFormat::Bmp => Self::Bmp(bmp::BmpFile::parse(bytes, work)?),
        })
    }

    /// Width and height of the stored rows, and how they are turned upright.
    pub(super) fn stored(&self) -> (Extent, ExifOrientation) {
        let (extent, exif) = match self {
            Self::Png(file) => (file.extent, file.found.exif),
            Self::Jpeg(file) => (file.extent, file.found.exif),
            Self::WebP(file) => (file.extent, file.found.exif),
            Self::Tiff(file) => return (file.extent, file.orientation),
            Self::Gif(file) => (file.extent, None),
            Self::Bmp(file) => (file.extent, None),
        };
        (
            extent,
            exif.map_or_else(ExifOrientation::default, ExifOrientation::from_exif),
        )
    }

    /// What the file says beside its pixels.
    pub(super) fn found(&self, work: &StepCounter<'_>) -> Found<'a> {
        match self {
            Self::Png(file) => file.found(work),
            Self::Jpeg(file) => file.found.clone(),
            Self::WebP(file) => file.found.clone(),
            Self::Tiff(file) => file.found.clone(),
            Self::Gif(file) => file.found.clone(),
            Self::Bmp(file) => file.found(),
        }
    }

    /// Refuses what can only be read as labels.
    pub(super) fn check_picture(&self) -> Result<(), CodecError> {
        if let Self::Tiff(file) = self {
            file.check_picture()
        } else {
            Ok(())
        }
    }

    pub(super) fn header(&self) -> Header {
        let (format, channels, depth, decoder_bytes, grey) = match self {
            Self::Png(f) => (
                SourceFormat::Written(Format::Png),
                f.channels(),
                f.depth(),
                f.decoder_bytes(),
                f.is_grey(),
            ),
            Self::Jpeg(f) => (
                SourceFormat::Written(Format::Jpeg),
                Channels::Rgb,
                Depth::Eight,
                f.decoder_bytes(),
                f.is_grey(),
            ),
            Self::WebP(f) => (
                SourceFormat::Written(Format::WebP),
                f.channels(),
                Depth::Eight,
                f.decoder_bytes(),
                false,
            ),
            Self::Tiff(f) => (
                SourceFormat::Written(Format::Tiff),
                f.channels(),
                f.depth(),
                f.decoder_bytes(),
                f.is_grey(),
            ),
            Self::Gif(f) => (
                SourceFormat::Written(Format::Gif),
                f.channels(),
                Depth::Eight,
                f.decoder_bytes(),
                false,
            ),
            Self::Bmp(f) => (
                SourceFormat::Bmp,
                f.channels(),
                Depth::Eight,
                f.decoder_bytes(),
                f.is_indexed(),
            ),
        };
        let (stored, orientation) = self.stored();
        let picture = sample_bytes(stored, channels, depth);
        let swaps = orientation.swaps_sides();
        let extent = if swaps {
            Extent::new(stored.height(), stored.width()).expect("both sides are non-zero")
        } else {
            stored
        };
        // The decoder's planes are freed before the image is turned, so the peak is the larger of
        // the two, not the sum; its small blocks stay with the allocator.
        let beside = if swaps {
            decoder_bytes.max(picture.saturating_add(TURNING_SLACK))
        } else {
            decoder_bytes
        };
        Header {
            format,
            extent,
            channels,
            grey,
            depth,
            decode_bytes: picture.saturating_add(beside),
        }
    }
}

/// Reads the header: a few steps per chunk or segment of the file, whatever sizes they claim.
///
/// # Errors
/// [`CodecError::Unsupported`] for an unsupported format or variant, [`CodecError::TooLarge`] for
/// an animation, [`CodecError::Bad`] for a damaged header. The caller checks the size: see
/// [`super::ImageLimits::check`].
pub fn probe(bytes: &[u8], work: &StepCounter<'_>) -> Result<Header, CodecError> {
    Parsed::new(bytes, work).map(|parsed| parsed.header())
}
