//! The pixels: straight (not premultiplied) samples as decoded, row-major, 8 or 16 bit, RGB or
//! RGBA. Standard library only.

use std::num::NonZeroU32;

mod layout;
mod pixels;
mod reduce;

pub use layout::{Labels, Palette, PixelLayout};
pub(crate) use pixels::extent_of;
pub use pixels::{PixelError, PixelFormat, Pixels};
pub use reduce::sample_bytes;

/// Width and height in pixels, neither zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extent {
    width: NonZeroU32,
    height: NonZeroU32,
}

impl Extent {
    /// `None` when a side is zero.
    ///
    /// ```
    /// use mlswarp::pixmap::Extent;
    /// assert_eq!(Extent::new(640, 480).map(Extent::pixels), Some(307_200));
    /// assert_eq!(Extent::new(640, 0), None);
    /// ```
    #[must_use]
    pub const fn new(width: u32, height: u32) -> Option<Self> {
        match (NonZeroU32::new(width), NonZeroU32::new(height)) {
            (Some(width), Some(height)) => Some(Self { width, height }),
            _ => None,
        }
    }

    /// Pixels in a row.
    #[must_use]
    pub const fn width(self) -> u32 {
        self.width.get()
    }

    /// Rows.
    #[must_use]
    pub const fn height(self) -> u32 {
        self.height.get()
    }

    /// Number of pixels.
    #[must_use]
    pub const fn pixels(self) -> u64 {
        self.width() as u64 * self.height() as u64
    }
}

/// The samples of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channels {
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue and straight alpha.
    Rgba,
}

impl Channels {
    /// Samples per pixel.
    #[must_use]
    pub const fn count(self) -> usize {
        match self {
            Self::Rgb => 3,
            Self::Rgba => 4,
        }
    }
}

/// Bits per sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Depth {
    /// 0..=255.
    Eight,
    /// 0..=65535.
    Sixteen,
}

impl Depth {
    /// Bytes per sample.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Eight => 1,
            Self::Sixteen => 2,
        }
    }

    /// The largest sample.
    #[must_use]
    pub const fn largest(self) -> u16 {
        match self {
            Self::Eight => u8::MAX as u16,
            Self::Sixteen => u16::MAX,
        }
    }
}

/// The samples, `[height][width][channels]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Samples {
    /// 8 bit.
    Eight(Vec<u8>),
    /// 16 bit, in the machine's byte order.
    Sixteen(Vec<u16>),
}

/// Whether the alpha of all RGBA pixels is `most`.
pub(crate) fn is_opaque<S: Copy + PartialEq>(rgba: &[S], most: S) -> bool {
    rgba.chunks_exact(4).all(|pixel| pixel[3] == most)
}

/// An upright image. Shapes: samples `[height][width][channels]`, straight alpha.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pixmap {
    extent: Extent,
    channels: Channels,
    samples: Samples,
    opaque: bool,
}

impl Pixmap {
    /// # Panics
    /// If the number of samples is not `width * height * channels`.
    ///
    /// ```
    /// use mlswarp::pixmap::{Channels, Extent, Pixmap, Samples};
    /// let extent = Extent::new(2, 1).unwrap();
    /// let samples = Samples::Eight(vec![255, 0, 0, 255, 0, 0, 255, 128]);
    /// assert!(!Pixmap::new(extent, Channels::Rgba, samples).is_opaque());
    /// ```
    #[must_use]
    pub fn new(extent: Extent, channels: Channels, samples: Samples) -> Self {
        let opaque = channels == Channels::Rgb
            || match &samples {
                Samples::Eight(s) => is_opaque(s, u8::MAX),
                Samples::Sixteen(s) => is_opaque(s, u16::MAX),
            };
        Self::of_opacity(extent, channels, samples, opaque)
    }

    /// Like [`Pixmap::new`] where it is known whether no pixel is transparent.
    ///
    /// # Panics
    /// If the number of samples is not `width * height * channels`.
    #[must_use]
    pub fn of_opacity(extent: Extent, channels: Channels, samples: Samples, opaque: bool) -> Self {
        let len = match &samples {
            Samples::Eight(s) => s.len(),
            Samples::Sixteen(s) => s.len(),
        };
        assert_eq!(
            len as u64,
            extent.pixels() * channels.count() as u64,
            "samples fill the extent"
        );
        Self {
            extent,
            channels,
            samples,
            opaque,
        }
    }

    /// Size.
    #[must_use]
    pub const fn extent(&self) -> Extent {
        self.extent
    }

    /// RGB or RGBA.
    #[must_use]
    pub const fn channels(&self) -> Channels {
        self.channels
    }

    /// 8 or 16 bit.
    #[must_use]
    pub const fn depth(&self) -> Depth {
        match self.samples {
            Samples::Eight(_) => Depth::Eight,
            Samples::Sixteen(_) => Depth::Sixteen,
        }
    }

    /// The samples, `[height][width][channels]`.
    #[must_use]
    pub const fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Whether no pixel is transparent: RGB, or RGBA with maximum alpha everywhere.
    #[must_use]
    pub const fn is_opaque(&self) -> bool {
        self.opaque
    }

    /// Memory of the samples, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        match &self.samples {
            Samples::Eight(s) => s.len(),
            Samples::Sixteen(s) => 2 * s.len(),
        }
    }
}
