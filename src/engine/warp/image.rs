//! A picture in memory, from a file or from pixels, shared by all warps of it.

use std::sync::{Arc, OnceLock};

use super::digest::Collector;
use super::region::{for_each_pixel, occupied_words};
use super::{Digest, WarpError};
#[cfg(feature = "codec")]
use crate::codec::{self, ImageLimits, Metadata, Opened, StepCounter};
#[cfg(feature = "codec")]
use crate::deform::IsCancelled;
use crate::format::Repairs;
use crate::pixmap::{Channels, Depth, Extent, PixelFormat, Pixels, Pixmap, Samples};
use crate::render::Source;

/// An upright picture with its derived copies for sampling, and its metadata for every output.
///
/// ```
/// use mlswarp::Image;
/// let image = Image::from_rgb8(2, 1, vec![255, 0, 0, 0, 0, 255])?;
/// assert!(!image.has_alpha());
/// # Ok::<(), mlswarp::warp::WarpError>(())
/// ```
#[derive(Debug)]
pub struct Image {
    /// Of the file, or of the pixels when it is needed.
    digest: OnceLock<Digest>,
    pub(super) source: Arc<Source>,
    /// Which pixels have some of a mask, if the picture has been one.
    pub(super) occupied: Arc<OnceLock<Vec<u64>>>,
    #[cfg(feature = "codec")]
    pub(super) metadata: Arc<Metadata>,
    /// What of the file was mended.
    pub(super) repairs: Repairs,
    /// Whether file or pixels have one sample for the three colours.
    pub(super) grey: bool,
}

/// What a file has beside pixels: its metadata, where there are files.
#[derive(Clone, Debug)]
pub(super) struct Inherited(#[cfg(feature = "codec")] Arc<Metadata>);

impl Inherited {
    #[cfg(feature = "codec")]
    fn put(self, image: &mut Image) {
        image.metadata = self.0;
    }

    #[cfg(not(feature = "codec"))]
    const fn put(self, _: &mut Image) {}
}

/// Reads and names files.
#[cfg(feature = "codec")]
impl Image {
    /// Digest of the file's bytes: the key under which the picture is cached.
    #[must_use]
    pub fn digest_of(file: &[u8]) -> Digest {
        Digest::of(file)
    }

    /// Upper bound of the memory for decoding an opened file and using its picture, bytes.
    #[must_use]
    pub fn peak_bytes(opened: &Opened<'_>) -> u64 {
        let header = opened.header();
        let used = used_bytes(header.extent, header.channels, header.depth);
        header
            .decode_bytes
            .max(used)
            .saturating_add(codec::PROFILE_BYTES + codec::METADATA_BYTES)
    }

    /// Decodes a file within limits. CPU work; do not call it on async threads. Stops when
    /// `cancelled` returns true.
    ///
    /// # Errors
    /// See [`codec::CodecError`]; cancelled.
    ///
    /// ```
    /// use mlswarp::warp::{Image, ImageLimits};
    /// let file = include_bytes!("../test_files/images/chelsea.png");
    /// let image = Image::decode(file, &ImageLimits::default(), &|| false)?;
    /// assert_eq!((image.extent().width(), image.extent().height()), (451, 300));
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn decode(
        file: &[u8],
        limits: &ImageLimits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let steps = StepCounter::new(cancelled);
        let opened = codec::open(file, limits, &steps)?;
        Self::decode_as(Self::digest_of(file), &opened)
    }

    /// Like [`Self::decode`], for an opened file whose digest is known.
    ///
    /// # Errors
    /// See [`codec::CodecError`].
    pub fn decode_as(digest: Digest, opened: &Opened<'_>) -> Result<Self, WarpError> {
        let decoded = opened.decode()?;
        Ok(Self {
            metadata: Arc::new(decoded.metadata),
            repairs: decoded.repairs,
            ..Self::new(OnceLock::from(digest), decoded.pixmap, opened.header().grey)
        })
    }
}

impl Image {
    /// A picture of pixels, which has no metadata.
    #[must_use]
    pub fn from_pixels(pixels: Pixels) -> Self {
        let (pixmap, grey) = pixels.into_pixmap();
        Self::new(OnceLock::new(), pixmap, grey)
    }

    fn new(digest: OnceLock<Digest>, pixmap: Pixmap, grey: bool) -> Self {
        Self {
            digest,
            source: Arc::new(Source::new(pixmap)),
            occupied: Arc::default(),
            #[cfg(feature = "codec")]
            metadata: Arc::default(),
            repairs: Repairs::default(),
            grey,
        }
    }

    /// A picture that was made from others; its metadata are those of one of their files.
    pub(super) fn of_parts(
        digest: Digest,
        pixmap: Pixmap,
        inherited: Inherited,
        grey: bool,
    ) -> Self {
        let mut image = Self::new(OnceLock::from(digest), pixmap, grey);
        inherited.put(&mut image);
        image
    }

    /// What pictures that are made of this one have of its file.
    pub(super) fn inherited(&self) -> Inherited {
        Inherited(
            #[cfg(feature = "codec")]
            Arc::clone(&self.metadata),
        )
    }

    /// A picture that no file has. `name`: of its digest.
    #[cfg(test)]
    pub(super) fn of_pixmap(name: &str, pixmap: Pixmap, grey: bool) -> Self {
        Self::new(OnceLock::from(Digest::of(name.as_bytes())), pixmap, grey)
    }

    /// The digest of the file; of a picture of pixels, that of its layout and its samples, which is
    /// computed when it is asked for first.
    #[must_use]
    pub fn digest(&self) -> Digest {
        *self.digest.get_or_init(|| {
            let pixmap = self.source.pixmap();
            let digest = Collector::new("mlswarp pixels 1")
                .integer(pixmap.extent().width().into())
                .integer(pixmap.channels().count() as u64)
                .integer(pixmap.depth().bytes() as u64)
                .integer(self.grey.into());
            match pixmap.samples() {
                Samples::Eight(samples) => digest.bytes(samples),
                Samples::Sixteen(samples) => {
                    let bytes = samples.iter().flat_map(|sample| sample.to_le_bytes());
                    digest.bytes(&bytes.collect::<Vec<u8>>())
                }
            }
            .finish()
        })
    }

    /// A copy of the pixels, with the samples that file or pixels had.
    ///
    /// ```
    /// use mlswarp::Image;
    /// let image = Image::from_grey16(2, 1, vec![7, 65_535])?;
    /// assert_eq!(image.to_pixels().into_samples(), vec![7_u16, 65_535].into());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    #[must_use]
    pub fn to_pixels(&self) -> Pixels {
        Pixels::of_pixmap(self.source.pixmap(), self.pixel_format())
    }

    /// What the samples of a pixel are: of the file, or of the pixels.
    #[must_use]
    pub fn pixel_format(&self) -> PixelFormat {
        match (self.grey, self.has_alpha()) {
            (true, false) => PixelFormat::Grey,
            (true, true) => PixelFormat::GreyAlpha,
            (false, false) => PixelFormat::Rgb,
            (false, true) => PixelFormat::Rgba,
        }
    }

    /// What of the file was mended.
    #[must_use]
    pub const fn repairs(&self) -> Repairs {
        self.repairs
    }

    /// Upright size.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.source.pixmap().extent()
    }

    /// The alpha of a row of pixels, up to [`FULL_WEIGHT`](crate::render::FULL_WEIGHT).
    pub(super) fn alpha_of_row(&self, y: u32, alpha: &mut Vec<u16>) {
        alpha.clear();
        for_each_pixel(self.source.pixmap(), y, |pixel| alpha.push(pixel[3]));
    }

    /// Whether the picture has an alpha channel.
    #[must_use]
    pub fn has_alpha(&self) -> bool {
        self.source.pixmap().channels() == Channels::Rgba
    }

    /// Upper bound of the memory of the picture, all sampling copies included, bytes: its weight in
    /// a cache.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let pixmap = self.source.pixmap();
        let used = used_bytes(pixmap.extent(), pixmap.channels(), pixmap.depth());
        #[cfg(feature = "codec")]
        let used = used + self.metadata.bytes() as u64;
        used
    }
}

/// Upper bound of the memory that a picture takes with all that is derived from it, bytes.
fn used_bytes(extent: Extent, channels: Channels, depth: Depth) -> u64 {
    Source::bytes(extent, channels, depth).saturating_add(8 * occupied_words(extent) as u64)
}

/// Pictures of samples in row order, without gaps.
macro_rules! from_samples {
    ($($name:ident, $sample:ty, $format:ident, $what:literal;)*) => {
        impl Image {
            $(
                #[doc = concat!("A picture of ", $what, ", row by row. A vector is not copied.")]
                ///
                /// # Errors
                /// Another number of samples than that of the pixels.
                pub fn $name(
                    width: u32,
                    height: u32,
                    samples: impl Into<Vec<$sample>>,
                ) -> Result<Self, WarpError> {
                    let samples = samples.into();
                    let pixels = Pixels::new(width, height, PixelFormat::$format, samples)?;
                    Ok(Self::from_pixels(pixels))
                }
            )*
        }
    };
}
from_samples! {
    from_grey8, u8, Grey, "grey of 8 bit";
    from_grey_alpha8, u8, GreyAlpha, "grey and straight alpha of 8 bit";
    from_rgb8, u8, Rgb, "red, green and blue of 8 bit";
    from_rgba8, u8, Rgba, "red, green, blue and straight alpha of 8 bit";
    from_grey16, u16, Grey, "grey of 16 bit";
    from_grey_alpha16, u16, GreyAlpha, "grey and straight alpha of 16 bit";
    from_rgb16, u16, Rgb, "red, green and blue of 16 bit";
    from_rgba16, u16, Rgba, "red, green, blue and straight alpha of 16 bit";
}
