//! A drawing of one pose: to pixels, or to a file of any format.

use super::PosedWarp;
use crate::pixmap::{Extent, Pixels};
use crate::render::{Filter, Outside};
use crate::warp::{
    CanvasSpec, DrawnPixels, LabelValues, OutputSpec, RasterSource, Target, WarpError,
};

/// An image, labels or coverage in a pose. Nothing is drawn until pixels or a file are asked for.
///
/// ```
/// use mlswarp::{Image, Warper};
/// use mlswarp::render::{Filter, Outside};
/// let image = Image::from_grey8(2, 2, vec![10, 20, 30, 40])?;
/// let posed = Warper::new(image.extent(), &[[0.5, 0.5]])?.pose(&[[1.5, 0.5]])?;
/// let rendering = posed.render(&image)?.filter(Filter::Nearest).outside(Outside::Edge);
/// assert_eq!(rendering.pixels()?.into_samples(), vec![10_u8, 10, 30, 30].into());
/// # Ok::<(), mlswarp::warp::WarpError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Rendering<'a> {
    posed: &'a PosedWarp,
    source: RasterSource<'a>,
    output: OutputSpec,
}

impl<'a> Rendering<'a> {
    pub(super) fn new(posed: &'a PosedWarp, source: RasterSource<'a>) -> Self {
        Self {
            posed,
            source,
            output: OutputSpec::default(),
        }
    }

    /// How the image is sampled between its pixel centres.
    #[must_use]
    pub fn filter(self, filter: Filter) -> Self {
        self.with(|output| output.filter = filter)
    }

    /// What fills pixels that the posed image does not cover.
    #[must_use]
    pub fn outside(self, outside: Outside) -> Self {
        self.with(|output| output.outside = outside)
    }

    /// The part of the posed plane that is drawn.
    #[must_use]
    pub fn canvas(self, canvas: CanvasSpec) -> Self {
        self.with(|output| output.canvas = canvas)
    }

    /// The width of the result, px; its height keeps the proportions.
    #[must_use]
    pub fn width(self, width: u32) -> Self {
        self.with(|output| output.width = Some(width))
    }

    /// Every other option of the output.
    ///
    /// ```
    /// use mlswarp::{Image, Warper};
    /// use mlswarp::format::Format;
    /// let image = Image::from_rgb8(64, 48, vec![128; 64 * 48 * 3])?;
    /// let posed = Warper::new(image.extent(), &[[9.0, 9.0]])?.pose(&[[12.0, 9.0]])?;
    /// let rendering = posed.render(&image)?.with(|output| output.quality = 95);
    /// assert!(rendering.file(Format::Jpeg)?.starts_with(b"\xFF\xD8"));
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    #[must_use]
    pub fn with(mut self, change: impl FnOnce(&mut OutputSpec)) -> Self {
        change(&mut self.output);
        self
    }

    /// The size of the result.
    ///
    /// # Errors
    /// A size over the limits; a canvas that fits nothing; cancelled.
    pub fn extent(&self) -> Result<Extent, WarpError> {
        self.target(&self.output).map(|target| target.extent)
    }

    /// The pixels, with the depth and the channels of the image. Where nothing is drawn, an image
    /// without alpha is black. Only a colour outside turns grey into RGB.
    ///
    /// # Errors
    /// A value outside that the samples cannot have; a size over the limits; cancelled.
    pub fn pixels(&self) -> Result<Pixels, WarpError> {
        self.drawn(false).map(DrawnPixels::into_pixels)
    }

    /// The pixels with the depth of the image and an alpha channel: grey with alpha, or RGBA. It is
    /// 0 where nothing is drawn.
    ///
    /// # Errors
    /// Those of [`Rendering::pixels`].
    ///
    /// ```
    /// use mlswarp::{Image, Warper};
    /// let image = Image::from_grey16(2, 1, vec![1000, 2000])?;
    /// let posed = Warper::new(image.extent(), &[[0.5, 0.5]])?.pose(&[[1.5, 0.5]])?;
    /// let pixels = posed.render(&image)?.pixels_with_alpha()?;
    /// assert_eq!(pixels.into_samples(), vec![0_u16, 0, 1000, 65_535].into());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn pixels_with_alpha(&self) -> Result<Pixels, WarpError> {
        self.drawn(true).map(DrawnPixels::into_pixels)
    }

    /// The labels with the bits that they came with.
    ///
    /// # Errors
    /// A value outside; a size over the limits; cancelled.
    pub fn labels(&self) -> Result<LabelValues, WarpError> {
        self.drawn(false).map(DrawnPixels::into_labels)
    }

    fn drawn(&self, has_alpha: bool) -> Result<DrawnPixels, WarpError> {
        self.source.check_outside(&self.output)?;
        let target = Target {
            force_alpha: has_alpha,
            ..self.target(&self.output)?
        };
        self.posed.warper().cancellable(|cancelled| {
            let posed = self.posed.posed_mesh();
            self.source.draw(target, posed, &self.output, cancelled)
        })
    }

    pub(super) fn target(&self, output: &OutputSpec) -> Result<Target, WarpError> {
        let (warper, posed) = (self.posed.warper(), self.posed.posed_mesh());
        warper.cancellable(|cancelled| {
            output.target(warper.extent(), posed, warper.limits(), cancelled)
        })
    }

    #[cfg(feature = "codec")]
    pub(super) const fn posed(&self) -> &PosedWarp {
        self.posed
    }

    #[cfg(feature = "codec")]
    pub(super) const fn source(&self) -> RasterSource<'a> {
        self.source
    }

    #[cfg(feature = "codec")]
    pub(super) const fn output(&self) -> &OutputSpec {
        &self.output
    }
}
