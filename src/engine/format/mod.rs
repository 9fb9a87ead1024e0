//! The file formats: names, media types, recognition by the first bytes, and the largest sides. Of
//! GIF, single images are read, and animations are written; BMP is only read. Nothing is read or
//! written here: the module `codec` does that.

mod dropped;
mod encoding;
mod error;
mod limits;
mod repairs;

pub use self::dropped::{Dropped, DroppedKind};
pub use self::encoding::{Compression, Encoding, EncodingChoice, Subsampling};
pub use self::error::CodecError;
pub use self::limits::ImageLimits;
pub use self::repairs::Repairs;
use crate::pixmap::Depth;

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
    /// TIFF.
    Tiff,
    /// GIF: the frames of an animation alone.
    Gif,
}

/// A file format that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SourceFormat {
    /// A format that is written too.
    Written(Format),
    /// BMP.
    Bmp,
}

/// What is known of a file format that is written.
#[derive(Clone, Copy, Debug)]
pub struct FormatInfo {
    /// The format.
    pub format: Format,
    /// The name in messages.
    pub name: &'static str,
    /// The word for it in requests and options.
    pub word: &'static str,
    /// The media type.
    pub media_type: &'static str,
    /// The ends of file names, the usual one first.
    pub extensions: &'static [&'static str],
    /// The longest side that it can store, px.
    pub max_side: u32,
    /// The most pixels that it can store.
    pub max_pixels: u64,
    /// Whether every sample is stored as it is, in 8 bit or in the depth of the image.
    pub is_lossless: bool,
    /// Whether pixels can be transparent.
    pub has_alpha: bool,
    /// The most bits of a sample.
    pub depth: Depth,
    /// Whether it is written strip by strip, in parallel and without the whole image in memory.
    pub streams: bool,
    /// Whether labels, indices of a palette among them, are stored as they are.
    pub keeps_labels: bool,
    /// Whether single images are written, and not the frames of an animation alone.
    pub is_of_pictures: bool,
    /// Whether a client chooses a quality.
    pub has_quality: bool,
    /// What its files hold beside the pixels.
    pub metadata: MetadataSupport,
}

/// The metadata that files of a format can hold.
#[derive(Clone, Copy, Debug)]
pub struct MetadataSupport {
    /// Whether there are any: profile, resolution, EXIF and XMP.
    pub is_any: bool,
    /// Whether there are the chunks of a PNG that say what its numbers mean.
    pub has_colour_chunks: bool,
    /// Whether EXIF keeps its maker note.
    pub has_maker_note: bool,
    /// Which texts there are.
    pub texts: TextSupport,
}

/// The texts that files of a format can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextSupport {
    /// None.
    None,
    /// Comments, which have no keyword.
    Comments,
    /// Comments, and texts with any keyword.
    All,
}

impl MetadataSupport {
    /// EXIF, XMP, a profile and a resolution, and nothing else.
    const USUAL: Self = Self {
        is_any: true,
        has_colour_chunks: false,
        has_maker_note: true,
        texts: TextSupport::None,
    };
}

/// Every format that is written, in the order of [`Format`].
pub const FORMATS: [FormatInfo; 5] = [
    FormatInfo {
        format: Format::Png,
        name: "PNG",
        word: "png",
        media_type: "image/png",
        extensions: &["png"],
        max_side: u32::MAX >> 1,
        max_pixels: u64::MAX,
        is_lossless: true,
        has_alpha: true,
        depth: Depth::Sixteen,
        streams: true,
        keeps_labels: true,
        is_of_pictures: true,
        has_quality: false,
        metadata: MetadataSupport {
            has_colour_chunks: true,
            texts: TextSupport::All,
            ..MetadataSupport::USUAL
        },
    },
    FormatInfo {
        format: Format::Jpeg,
        name: "JPEG",
        word: "jpeg",
        media_type: "image/jpeg",
        extensions: &["jpg", "jpeg"],
        max_side: u16::MAX as u32,
        max_pixels: u64::MAX,
        is_lossless: false,
        has_alpha: false,
        depth: Depth::Eight,
        streams: true,
        keeps_labels: false,
        is_of_pictures: true,
        has_quality: true,
        metadata: MetadataSupport {
            texts: TextSupport::Comments,
            ..MetadataSupport::USUAL
        },
    },
    FormatInfo {
        format: Format::WebP,
        name: "WebP",
        word: "webp",
        media_type: "image/webp",
        extensions: &["webp"],
        max_side: 1 << 14,
        max_pixels: u64::MAX,
        is_lossless: true,
        has_alpha: true,
        depth: Depth::Eight,
        streams: false,
        keeps_labels: false,
        is_of_pictures: true,
        has_quality: false,
        metadata: MetadataSupport::USUAL,
    },
    FormatInfo {
        format: Format::Tiff,
        name: "TIFF",
        word: "tiff",
        media_type: "image/tiff",
        extensions: &["tif", "tiff"],
        max_side: u32::MAX >> 1,
        // Offsets have 32 bits, and a pixel up to 8 bytes.
        max_pixels: u32::MAX as u64 / 9,
        is_lossless: true,
        has_alpha: true,
        depth: Depth::Sixteen,
        streams: false,
        keeps_labels: true,
        is_of_pictures: true,
        has_quality: false,
        metadata: MetadataSupport {
            has_maker_note: false,
            ..MetadataSupport::USUAL
        },
    },
    FormatInfo {
        format: Format::Gif,
        name: "GIF",
        word: "gif",
        media_type: "image/gif",
        extensions: &["gif"],
        max_side: u16::MAX as u32,
        max_pixels: u64::MAX,
        is_lossless: false,
        has_alpha: true,
        depth: Depth::Eight,
        streams: false,
        keeps_labels: false,
        is_of_pictures: false,
        has_quality: false,
        metadata: MetadataSupport {
            is_any: false,
            ..MetadataSupport::USUAL
        },
    },
];

/// The name of BMP in messages, and the end of its files' names.
const BMP: (&str, &str) = ("BMP", "bmp");

/// The names of the formats that are read, as a list.
///
/// ```
/// assert_eq!(mlswarp::format::source_names(), "PNG, JPEG, WebP, TIFF, GIF, BMP");
/// ```
#[must_use]
pub fn source_names() -> String {
    let names: Vec<&str> = FORMATS.iter().map(|row| row.name).chain([BMP.0]).collect();
    names.join(", ")
}

/// The ends of the names of files that are read.
pub fn source_extensions() -> impl Iterator<Item = &'static str> {
    let written = FORMATS.iter().flat_map(|row| row.extensions).copied();
    written.chain([BMP.1])
}

/// The words of the formats of single images.
pub fn words() -> impl Iterator<Item = &'static str> {
    Format::ALL.into_iter().map(|format| format.info().word)
}

impl Format {
    /// The formats of single images, the default first.
    pub const ALL: [Self; 4] = [Self::Png, Self::Jpeg, Self::WebP, Self::Tiff];

    /// What is known of it.
    #[must_use]
    pub const fn info(self) -> &'static FormatInfo {
        &FORMATS[self as usize]
    }

    /// The format of files whose names end in this, in upper or lower case.
    ///
    /// ```
    /// use mlswarp::format::Format;
    /// assert_eq!(Format::of_extension("JPEG"), Some(Format::Jpeg));
    /// // Its frames are written as animations only.
    /// assert_eq!(Format::of_extension("gif"), None);
    /// ```
    #[must_use]
    pub fn of_extension(extension: &str) -> Option<Self> {
        let is_end = |end: &&str| end.eq_ignore_ascii_case(extension);
        Self::ALL
            .into_iter()
            .find(|format| format.info().extensions.iter().any(is_end))
    }

    /// The name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.info().name
    }

    /// The media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        self.info().media_type
    }

    /// The usual extension of file names.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        self.info().extensions[0]
    }

    /// The longest side that the format can store, px.
    #[must_use]
    pub const fn max_side(self) -> u32 {
        self.info().max_side
    }

    /// The most pixels that the format can store.
    #[must_use]
    pub const fn max_pixels(self) -> u64 {
        self.info().max_pixels
    }

    /// Whether labels are stored as they are.
    #[must_use]
    pub const fn keeps_labels(self) -> bool {
        self.info().keeps_labels
    }
}

impl SourceFormat {
    /// The format of a file, by its first bytes.
    ///
    /// # Errors
    /// [`CodecError::Unsupported`], which names what the bytes look like.
    ///
    /// ```
    /// use mlswarp::format::{Format, SourceFormat};
    /// let found = SourceFormat::of(b"\x89PNG\r\n\x1a\n").unwrap();
    /// assert_eq!(found, SourceFormat::Written(Format::Png));
    /// assert_eq!(found.media_type(), "image/png");
    /// ```
    pub fn of(bytes: &[u8]) -> Result<Self, CodecError> {
        Ok(match bytes {
            [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1A, b'\n', ..] => Self::Written(Format::Png),
            [0xFF, 0xD8, 0xFF, ..] => Self::Written(Format::Jpeg),
            [
                b'R',
                b'I',
                b'F',
                b'F',
                _,
                _,
                _,
                _,
                b'W',
                b'E',
                b'B',
                b'P',
                ..,
            ] => Self::Written(Format::WebP),
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => {
                Self::Written(Format::Tiff)
            }
            [b'G', b'I', b'F', b'8', b'7' | b'9', b'a', ..] => Self::Written(Format::Gif),
            [b'B', b'M', ..] => Self::Bmp,
            _ => return Err(CodecError::unsupported(looks_like(bytes))),
        })
    }

    /// The name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Written(format) => format.name(),
            Self::Bmp => BMP.0,
        }
    }

    /// The media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Written(format) => format.media_type(),
            Self::Bmp => "image/bmp",
        }
    }
}

/// Describes the format of bytes that are not read here.
fn looks_like(bytes: &[u8]) -> String {
    let known = match bytes {
        [] => "an empty file (0 bytes)",
        [0, 0, 1 | 2, 0, ..] => "ICO",
        [0xFF, 0x0A, ..] | [0, 0, 0, 12, b'J', b'X', b'L', b' ', ..] => "JPEG XL",
        [0, 0, 0, 12, b'j', b'P', b' ', b' ', ..] => "JPEG 2000",
        [_, _, _, _, b'f', b't', b'y', b'p', brand @ ..] => iso_media(brand),
        [b'%', b'P', b'D', b'F', ..] => "PDF",
        [b'%', b'!', b'P', b'S', ..] => "PostScript",
        [b'8', b'B', b'P', b'S', ..] => "Photoshop (PSD)",
        [b'g', b'i', b'm', b'p', b' ', ..] => "GIMP (XCF)",
        [0x76, 0x2F, 0x31, 0x01, ..] => "OpenEXR",
        [b'q', b'o', b'i', b'f', ..] => "QOI",
        [b'P', b'1'..=b'7', b' ' | b'\n' | b'\r', ..] => "PNM",
        [b'P', b'K', 3, 4, ..] => "a ZIP archive",
        [0x1F, 0x8B, ..] => "a gzip archive",
        [b'd', b'a', b't', b'a', b':', ..] => "a data URL; send the bytes of the file",
        [b'i', b'V', b'B', b'O', b'R', b'w', b'0', b'K', ..] | [b'/', b'9', b'j', b'/', ..] => {
            "base64; send the bytes of the file"
        }
        [b'{' | b'[', ..] => "JSON",
        [b'<', ..] | [0xEF, 0xBB, 0xBF, b'<', ..] => {
            let head = &bytes[..bytes.len().min(1024)];
            if head.windows(4).any(|tag| tag == b"<svg") {
                "SVG"
            } else {
                "XML or HTML"
            }
        }
        [_] => "1 byte, too short for an image",
        _ if bytes.len() < 12 => return format!("{} bytes, too short for an image", bytes.len()),
        _ => {
            let [a, b, c, d] = [bytes[0], bytes[1], bytes[2], bytes[3]];
            return format!("an unknown format that begins with {a:02x} {b:02x} {c:02x} {d:02x}");
        }
    };
    known.to_owned()
}

/// Describes a file of the ISO base media format by its brand.
const fn iso_media(brand: &[u8]) -> &'static str {
    match brand {
        [b'a', b'v', b'i', b'f' | b's', ..] => "AVIF",
        [b'h', b'e', ..] | [b'm', b'i' | b's', b'f', b'1', ..] => "HEIC",
        [b'c', b'r', b'x', ..] => "a camera's raw format",
        _ => "a video",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_its_row_and_names_of_its_own() {
        let pictures: Vec<Format> = FORMATS
            .iter()
            .filter(|row| row.is_of_pictures)
            .map(|row| row.format)
            .collect();
        assert_eq!(pictures, Format::ALL);
        for (k, row) in FORMATS.iter().enumerate() {
            assert_eq!(row.format as usize, k);
            let others = || FORMATS.iter().filter(|other| other.format != row.format);
            assert!(others().all(|other| {
                other.name != row.name
                    && other.word != row.word
                    && other.media_type != row.media_type
                    && other
                        .extensions
                        .iter()
                        .all(|end| !row.extensions.contains(end))
            }));
        }
    }
}
