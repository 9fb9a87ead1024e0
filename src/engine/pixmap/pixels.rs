//! Pixels in a caller's layout: grey or colours, with alpha or without, and their conversion to the
//! RGB or RGBA of a [`Pixmap`] and back.

use std::fmt;

use super::{Channels, Depth, Extent, PixelLayout, Pixmap, Samples};

/// What the samples of a pixel are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// One grey sample.
    Grey,
    /// Grey and straight alpha.
    GreyAlpha,
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue and straight alpha.
    Rgba,
}

impl PixelFormat {
    /// Samples per pixel.
    #[must_use]
    pub const fn samples(self) -> usize {
        match self {
            Self::Grey => 1,
            Self::GreyAlpha => 2,
            Self::Rgb => 3,
            Self::Rgba => 4,
        }
    }

    const fn is_grey(self) -> bool {
        matches!(self, Self::Grey | Self::GreyAlpha)
    }

    const fn channels(self) -> Channels {
        match self {
            Self::Grey | Self::Rgb => Channels::Rgb,
            Self::GreyAlpha | Self::Rgba => Channels::Rgba,
        }
    }
}

/// Why samples are not the pixels of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelError {
    /// A side of 0 px.
    Empty {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Another number of samples than the image has.
    Count {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Samples of a pixel.
        samples: usize,
        /// From the start of a row to that of the next, samples.
        stride: usize,
        /// The number that was given.
        actual: usize,
    },
    /// Rows that overlap.
    Stride {
        /// Samples of a row.
        row: usize,
        /// From the start of a row to that of the next, samples.
        stride: usize,
    },
}

impl fmt::Display for PixelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Empty { width, height } => {
                write!(f, "a picture of {width} x {height} px has no pixels")
            }
            Self::Count {
                width,
                height,
                samples,
                stride,
                actual,
            } => {
                write!(f, "{width} x {height} px of {samples} samples each")?;
                if stride as u64 != u64::from(width) * samples as u64 {
                    write!(f, ", in rows that begin {stride} samples apart,")?;
                }
                write!(f, " do not fit a buffer of {actual} samples")
            }
            Self::Stride { row, stride } => write!(
                f,
                "rows of {row} samples cannot begin {stride} samples apart"
            ),
        }
    }
}

impl std::error::Error for PixelError {}

impl From<Vec<u8>> for Samples {
    fn from(samples: Vec<u8>) -> Self {
        Self::Eight(samples)
    }
}

impl From<Vec<u16>> for Samples {
    fn from(samples: Vec<u16>) -> Self {
        Self::Sixteen(samples)
    }
}

impl From<&[u8]> for Samples {
    fn from(samples: &[u8]) -> Self {
        Self::Eight(samples.to_vec())
    }
}

impl From<&[u16]> for Samples {
    fn from(samples: &[u16]) -> Self {
        Self::Sixteen(samples.to_vec())
    }
}

/// The size of an image of one number for each pixel.
///
/// # Errors
/// A side of 0 px; another number.
pub(crate) fn extent_of(width: u32, height: u32, actual: usize) -> Result<Extent, PixelError> {
    let extent = Extent::new(width, height).ok_or(PixelError::Empty { width, height })?;
    if extent.pixels() == actual as u64 {
        return Ok(extent);
    }
    Err(PixelError::Count {
        width,
        height,
        samples: 1,
        stride: width as usize,
        actual,
    })
}

/// The pixels of an image: rows without gaps, `[height][width][samples]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pixels {
    extent: Extent,
    format: PixelFormat,
    samples: Samples,
}

impl Pixels {
    /// Checks the number of samples. A vector is taken as it is, a slice is copied.
    ///
    /// # Errors
    /// A side of 0 px; another number of samples than `width * height * format.samples()`.
    ///
    /// ```
    /// use mlswarp::pixmap::{PixelFormat, Pixels};
    /// assert!(Pixels::new(2, 1, PixelFormat::Grey, vec![0_u16, 65535]).is_ok());
    /// let error = Pixels::new(2, 1, PixelFormat::Rgb, vec![0_u8; 5]).unwrap_err();
    /// assert_eq!(
    ///     error.to_string(),
    ///     "2 x 1 px of 3 samples each do not fit a buffer of 5 samples"
    /// );
    /// ```
    pub fn new(
        width: u32,
        height: u32,
        format: PixelFormat,
        samples: impl Into<Samples>,
    ) -> Result<Self, PixelError> {
        let row = (width as usize).saturating_mul(format.samples());
        Self::strided(width, height, format, samples, row)
    }

    /// Like [`Pixels::new`], of a buffer whose rows begin `stride` samples apart. What is between
    /// them is dropped; after the last row it may be missing.
    ///
    /// # Errors
    /// A side of 0 px; a stride that is shorter than a row; a buffer that ends before the last row
    /// does, or more than a stride after its beginning.
    ///
    /// ```
    /// use mlswarp::pixmap::{PixelFormat, Pixels};
    /// let padded = vec![1_u8, 2, 0, 0, 3, 4, 0, 0];
    /// let pixels = Pixels::strided(2, 2, PixelFormat::Grey, padded, 4)?;
    /// assert_eq!(pixels, Pixels::new(2, 2, PixelFormat::Grey, vec![1_u8, 2, 3, 4])?);
    /// # Ok::<(), mlswarp::pixmap::PixelError>(())
    /// ```
    pub fn strided(
        width: u32,
        height: u32,
        format: PixelFormat,
        samples: impl Into<Samples>,
        stride: usize,
    ) -> Result<Self, PixelError> {
        let samples = samples.into();
        let extent = Extent::new(width, height).ok_or(PixelError::Empty { width, height })?;
        let row = (width as usize).saturating_mul(format.samples());
        if stride < row {
            return Err(PixelError::Stride { row, stride });
        }
        let actual = match &samples {
            Samples::Eight(samples) => samples.len(),
            Samples::Sixteen(samples) => samples.len(),
        };
        // In u64, because an address of a browser has 32 bits.
        let before_last = u64::from(height - 1).saturating_mul(stride as u64);
        let least = before_last.saturating_add(row as u64);
        let most = before_last.saturating_add(stride as u64);
        if !(least..=most).contains(&(actual as u64)) {
            return Err(PixelError::Count {
                width,
                height,
                samples: format.samples(),
                stride,
                actual,
            });
        }
        let samples = match samples {
            samples if stride == row => samples,
            Samples::Eight(samples) => Samples::Eight(without_gaps(&samples, row, stride)),
            Samples::Sixteen(samples) => Samples::Sixteen(without_gaps(&samples, row, stride)),
        };
        Ok(Self {
            extent,
            format,
            samples,
        })
    }

    /// The pixels of a layout, of samples as a PNG stores them (16 bit big-endian). The samples
    /// fill the layout.
    pub(crate) fn of_png_order(layout: PixelLayout, samples: Vec<u8>) -> Self {
        let format = match (layout.grey, layout.channels) {
            (true, Channels::Rgb) => PixelFormat::Grey,
            (true, Channels::Rgba) => PixelFormat::GreyAlpha,
            (false, Channels::Rgb) => PixelFormat::Rgb,
            (false, Channels::Rgba) => PixelFormat::Rgba,
        };
        let samples = match layout.depth {
            Depth::Eight => Samples::Eight(samples),
            Depth::Sixteen => {
                let pairs = samples.as_chunks::<2>().0;
                Samples::Sixteen(pairs.iter().map(|pair| u16::from_be_bytes(*pair)).collect())
            }
        };
        Self {
            extent: layout.extent,
            format,
            samples,
        }
    }

    /// The pixels of an image, of which grey takes one sample.
    pub(crate) fn of_pixmap(pixmap: &Pixmap, format: PixelFormat) -> Self {
        let samples = match pixmap.samples() {
            samples if !format.is_grey() => samples.clone(),
            Samples::Eight(samples) => Samples::Eight(greyed(samples, format)),
            Samples::Sixteen(samples) => Samples::Sixteen(greyed(samples, format)),
        };
        Self {
            extent: pixmap.extent(),
            format,
            samples,
        }
    }

    /// Size.
    #[must_use]
    pub const fn extent(&self) -> Extent {
        self.extent
    }

    /// What the samples of a pixel are.
    #[must_use]
    pub const fn format(&self) -> PixelFormat {
        self.format
    }

    /// The samples, `[height][width][samples]`.
    #[must_use]
    pub const fn samples(&self) -> &Samples {
        &self.samples
    }

    /// The samples without the image.
    #[must_use]
    pub fn into_samples(self) -> Samples {
        self.samples
    }

    /// The image in RGB or RGBA, and whether its colours are grey.
    pub(crate) fn into_pixmap(self) -> (Pixmap, bool) {
        let samples = match (self.samples, self.format) {
            (samples, PixelFormat::Rgb | PixelFormat::Rgba) => samples,
            (Samples::Eight(samples), format) => Samples::Eight(coloured(&samples, format)),
            (Samples::Sixteen(samples), format) => Samples::Sixteen(coloured(&samples, format)),
        };
        let pixmap = Pixmap::new(self.extent, self.format.channels(), samples);
        (pixmap, self.format.is_grey())
    }
}

fn without_gaps<S: Copy>(samples: &[S], row: usize, stride: usize) -> Vec<S> {
    samples
        .chunks(stride)
        .flat_map(|chunk| &chunk[..row])
        .copied()
        .collect()
}

/// Grey pixels with the grey three times.
fn coloured<S: Copy>(samples: &[S], format: PixelFormat) -> Vec<S> {
    let count = format.samples();
    let mut colours = Vec::with_capacity(samples.len() / count * (count + 2));
    for pixel in samples.chunks_exact(count) {
        colours.extend([pixel[0]; 3]);
        colours.extend(&pixel[1..]);
    }
    colours
}

/// Of three equal colours, the first, and alpha.
fn greyed<S: Copy>(samples: &[S], format: PixelFormat) -> Vec<S> {
    let mut grey = Vec::with_capacity(samples.len() / format.channels().count() * format.samples());
    for pixel in samples.chunks_exact(format.channels().count()) {
        grey.push(pixel[0]);
        grey.extend(&pixel[3..]);
    }
    grey
}
