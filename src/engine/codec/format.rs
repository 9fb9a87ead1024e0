//! The file formats: names, media types, recognition by the first bytes, and the largest sides. Of
//! GIF, single pictures are read, and animations are written; BMP is only read.

use super::CodecError;

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

impl Format {
    /// The formats of pictures, the default first.
    pub const ALL: [Self; 4] = [Self::Png, Self::Jpeg, Self::WebP, Self::Tiff];

    /// The name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::WebP => "WebP",
            Self::Tiff => "TIFF",
            Self::Gif => "GIF",
        }
    }

    /// The media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
            Self::WebP => "image/webp",
            Self::Tiff => "image/tiff",
            Self::Gif => "image/gif",
        }
    }

    /// The extension of file names.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpg",
            Self::WebP => "webp",
            Self::Tiff => "tif",
            Self::Gif => "gif",
        }
    }

    /// The longest side that the format can store, px.
    #[must_use]
    pub const fn max_side(self) -> u32 {
        match self {
            Self::Png | Self::Tiff => u32::MAX >> 1,
            Self::Jpeg | Self::Gif => u16::MAX as u32,
            Self::WebP => 1 << 14,
        }
    }

    /// The most pixels that the format can store: a TIFF has offsets of 32 bits, and up to 8 bytes
    /// per pixel.
    #[must_use]
    pub const fn max_pixels(self) -> u64 {
        match self {
            Self::Tiff => u32::MAX as u64 / 9,
            Self::Png | Self::Jpeg | Self::WebP | Self::Gif => u64::MAX,
        }
    }
}

impl SourceFormat {
    /// The format of a file, by its first bytes.
    ///
    /// # Errors
    /// [`CodecError::Unsupported`], which names what the bytes look like.
    ///
    /// ```
    /// use mlswarp::codec::{Format, SourceFormat};
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
            Self::Bmp => "BMP",
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
