//! The layout of pixels in files and buffers, and labels in such a layout.

use super::{Channels, Depth, Extent};

/// The layout of an image's pixels where grey takes one sample: in files and in buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PixelLayout {
    /// Size.
    pub extent: Extent,
    /// RGB or RGBA.
    pub channels: Channels,
    /// Whether the colours of every pixel are equal, so that one sample is enough for them.
    pub grey: bool,
    /// 8 or 16 bit.
    pub depth: Depth,
}

impl PixelLayout {
    /// Samples per pixel.
    #[must_use]
    pub const fn samples(self) -> usize {
        if self.grey {
            self.channels.count() - 2
        } else {
            self.channels.count()
        }
    }

    /// Bytes of all samples.
    #[must_use]
    pub const fn sample_bytes(self) -> u64 {
        self.extent
            .pixels()
            .saturating_mul(self.pixel_bytes() as u64)
    }

    /// Bytes of the samples of a pixel.
    #[must_use]
    pub const fn pixel_bytes(self) -> usize {
        self.samples() * self.depth.bytes()
    }
}

/// The colours of the labels of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Palette {
    /// Red, green and blue of each label, at most 256.
    pub colours: Vec<[u8; 3]>,
    /// Alpha of the first labels; the others are opaque.
    pub alpha: Vec<u8>,
}

/// Upright labels: numbers instead of colours.
#[derive(Clone, Debug)]
pub struct Labels {
    /// Size, depth and samples per pixel.
    pub shape: PixelLayout,
    /// The colours of the labels, if the file has them.
    pub palette: Option<Palette>,
    /// The labels as a PNG stores them (16 bit big-endian). Shapes:
    /// `[height][width][shape.samples()]`.
    pub values: Vec<u8>,
    /// Whether the four bytes of a pixel are one number of 32 bit, big-endian, which no format
    /// stores.
    pub is_32_bit: bool,
}
