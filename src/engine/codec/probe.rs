//! What a file says of itself before it is decoded. The format is told by the first bytes, never by a name. Everything here
//! reads numbers out of headers: the file is walked chunk by chunk, nothing proportional to the picture is allocated, and
//! every size is computed in u64. `Header::decode_bytes` is what a caller reserves before it lets `decode` run.

use super::orientation::Orientation;
use super::{CodecError, StepCounter, jpeg, png, webp};
use crate::pixmap::{Channels, Depth, Extent};

/// A file format that is read and written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Format {
    /// PNG.
    #[default]
    Png,
    /// JPEG.
    Jpeg,
    /// WebP.
    WebP,
}

impl Format {
    /// By the first bytes.
    ///
    /// # Errors
    /// [`CodecError::Unsupported`], saying what the bytes look like.
    pub fn of(bytes: &[u8]) -> Result<Self, CodecError> {
        match bytes {
            [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1A, b'\n', ..] => Ok(Self::Png),
            [0xFF, 0xD8, 0xFF, ..] => Ok(Self::Jpeg),
            [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Ok(Self::WebP),
            _ => Err(CodecError::unsupported(looks_like(bytes))),
        }
    }

    /// As it appears in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Png => png::read::NAME,
            Self::Jpeg => jpeg::read::NAME,
            Self::WebP => webp::read::NAME,
        }
    }
}

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

fn looks_like(bytes: &[u8]) -> String {
    let known = match bytes {
        [] => "nothing (0 bytes)",
        [b'G', b'I', b'F', b'8', ..] => "GIF",
        [b'B', b'M', ..] => "BMP",
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => "TIFF",
        [0xFF, 0x0A, ..] | [0, 0, 0, 12, b'J', b'X', b'L', b' ', ..] => "JPEG XL",
        [0, 0, 0, 12, b'j', b'P', b' ', b' ', ..] => "JPEG 2000",
        [_, _, _, _, b'f', b't', b'y', b'p', b'a', b'v', b'i', ..] => "AVIF",
        [_, _, _, _, b'f', b't', b'y', b'p', b'h' | b'm', ..] => "HEIF",
        [b'%', b'P', b'D', b'F', ..] => "PDF",
        [b'8', b'B', b'P', b'S', ..] => "Photoshop",
        [b'<', ..] | [0xEF, 0xBB, 0xBF, b'<', ..] => {
            let head = &bytes[..bytes.len().min(1024)];
            if head.windows(4).any(|tag| tag == b"<svg") { "SVG" } else { "XML or HTML" }
        }
        [_] => "1 byte, too few for a picture",
        _ if bytes.len() < 12 => return format!("{} bytes, too few for a picture", bytes.len()),
        _ => {
            let [a, b, c, d] = [bytes[0], bytes[1], bytes[2], bytes[3]];
            return format!("an unknown format that begins with {a:02x} {b:02x} {c:02x} {d:02x}");
        }
    };
    known.to_owned()
}
