//! The file formats: names, media types, recognition by the first bytes, and the largest sides.

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
}

impl Format {
    /// All formats, the default first.
    pub const ALL: [Self; 3] = [Self::Png, Self::Jpeg, Self::WebP];

    /// The format of a file, by its first bytes.
    ///
    /// # Errors
    /// [`CodecError::Unsupported`], which names what the bytes look like.
    pub fn of(bytes: &[u8]) -> Result<Self, CodecError> {
        match bytes {
            [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1A, b'\n', ..] => Ok(Self::Png),
            [0xFF, 0xD8, 0xFF, ..] => Ok(Self::Jpeg),
            [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Ok(Self::WebP),
            _ => Err(CodecError::unsupported(looks_like(bytes))),
        }
    }

    /// The name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::WebP => "WebP",
        }
    }

    /// The media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
            Self::WebP => "image/webp",
        }
    }

    /// The longest side that the format can store, px.
    #[must_use]
    pub const fn max_side(self) -> u32 {
        match self {
            Self::Png => u32::MAX >> 1,
            Self::Jpeg => u16::MAX as u32,
            Self::WebP => 1 << 14,
        }
    }
}

/// Describes the format of bytes that are not read here.
fn looks_like(bytes: &[u8]) -> String {
    let known = match bytes {
        [] => "nothing (0 bytes)",
        [b'G', b'I', b'F', b'8', ..] => "GIF",
        [b'B', b'M', ..] => "BMP",
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => "TIFF",
        [0xFF, 0x0A, ..] | [0, 0, 0, 12, b'J', b'X', b'L', b' ', ..] => "JPEG XL",
        [0, 0, 0, 12, b'j', b'P', b' ', b' ', ..] => "JPEG 2000",
        [_, _, _, _, b'f', b't', b'y', b'p', b'a', b'v', b'i', ..] => "AVIF",
        [_, _, _, _, b'f', b't', b'y', b'p', b'h' | b'm', ..] => "HEIC",
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
