//! How an image is encoded in each format.

use super::Format;

/// The effort of compression.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Compression {
    /// Stored, not compressed.
    None,
    /// Filter and Huffman coding, without a match search.
    #[default]
    Fast,
    /// The smallest files.
    Best,
}

/// The resolution of the colours of a JPEG file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Subsampling {
    /// Half of the image's along both axes, `4:2:0`.
    Half,
    /// The image's, `4:4:4`.
    Full,
}

/// The encoding of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Lossless, 8 or 16 bit.
    Png(Compression),
    /// 8 bit, no alpha.
    Jpeg {
        /// 1 to 100.
        quality: u8,
        /// Resolution of the colours.
        subsampling: Subsampling,
        /// The background of transparent pixels.
        ground: [u8; 3],
    },
    /// Lossless, 8 bit.
    WebP,
    /// Lossless, 8 or 16 bit.
    Tiff(Compression),
    /// A frame of an animation: at most 256 colours, which are transparent or opaque.
    Gif,
}

/// What may be chosen of an encoding. Each format takes what it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodingChoice {
    /// The effort of a lossless compression.
    pub compression: Compression,
    /// The quality of a lossy one, 1 to 100.
    pub quality: u8,
    /// The resolution of its colours; `None` follows from the quality.
    pub subsampling: Option<Subsampling>,
    /// The background of transparent pixels, if the format has no alpha.
    pub ground: [u8; 3],
}

/// From this quality on, the colours of a JPEG have full resolution if nothing else is chosen.
const FULL_COLOURS_QUALITY: u8 = 90;

impl Encoding {
    /// The encoding of a format.
    #[must_use]
    pub const fn of(format: Format, choice: EncodingChoice) -> Self {
        let EncodingChoice {
            compression,
            quality,
            subsampling,
            ground,
        } = choice;
        match format {
            Format::Png => Self::Png(compression),
            Format::Jpeg => Self::Jpeg {
                quality,
                subsampling: match subsampling {
                    Some(subsampling) => subsampling,
                    None if quality < FULL_COLOURS_QUALITY => Subsampling::Half,
                    None => Subsampling::Full,
                },
                ground,
            },
            Format::WebP => Self::WebP,
            Format::Tiff => Self::Tiff(compression),
            Format::Gif => Self::Gif,
        }
    }

    /// The format of the file.
    #[must_use]
    pub const fn format(self) -> Format {
        match self {
            Self::Png(_) => Format::Png,
            Self::Jpeg { .. } => Format::Jpeg,
            Self::WebP => Format::WebP,
            Self::Tiff(_) => Format::Tiff,
            Self::Gif => Format::Gif,
        }
    }

    /// Whether a grey image is written in grey: the format has it, and the ground adds no colour.
    #[must_use]
    pub const fn is_grey(self) -> bool {
        match self {
            Self::Png(_) | Self::Tiff(_) => true,
            Self::Jpeg {
                ground: [r, g, b], ..
            } => r == g && g == b,
            Self::WebP | Self::Gif => false,
        }
    }

    /// A number that no other encoding has, for keys of caches. It never changes.
    #[must_use]
    pub const fn identity(self) -> [u8; 5] {
        match self {
            Self::Png(Compression::None) => [0; 5],
            Self::Png(Compression::Fast) => [1, 0, 0, 0, 0],
            Self::Png(Compression::Best) => [2, 0, 0, 0, 0],
            Self::Jpeg {
                quality,
                subsampling: Subsampling::Half,
                ground: [r, g, b],
            } => [3, quality, r, g, b],
            Self::Jpeg {
                quality,
                subsampling: Subsampling::Full,
                ground: [r, g, b],
            } => [8, quality, r, g, b],
            Self::WebP => [4, 0, 0, 0, 0],
            Self::Gif => [9, 0, 0, 0, 0],
            Self::Tiff(Compression::None) => [5, 0, 0, 0, 0],
            Self::Tiff(Compression::Fast) => [6, 0, 0, 0, 0],
            Self::Tiff(Compression::Best) => [7, 0, 0, 0, 0],
        }
    }
}
