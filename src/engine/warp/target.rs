//! The target picture: which part of the posed plane it shows, and its size.

#[cfg(feature = "codec")]
use std::sync::Arc;

use super::spec::at_most;
use super::{Limits, OutputSpec, PosedMesh, Quantity, WarpError};
#[cfg(feature = "codec")]
use crate::codec::{Carried, Metadata};
use crate::deform::IsCancelled;
use crate::pixmap::Extent;
use crate::render::{Canvas, RenderOptions, window_count};

/// Positions are drawn to 1/256 px; what is nearer to a whole px is on it.
const STEPS_PER_PX: f64 = 256.0;
/// The farthest edge of a canvas from the origin, px, as of handles.
pub const FARTHEST_EDGE_PX: i32 = 1_000_000;
/// The longest side of the whole source at the scale of a target, px: the rasteriser holds
/// positions up to twice as far from a window.
const LONGEST_SCALED_SOURCE: u64 = 1 << 20;
/// Memory of a window that is drawn, bytes per vertex of the posed grid.
const WINDOW_BYTES_PER_VERTEX: u64 = 48;

/// The requested canvas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CanvasSpec {
    /// The box of the source.
    #[default]
    Same,
    /// The smallest box of whole px that contains the whole posed picture.
    Fit,
    /// This box.
    Box(Canvas),
}

impl CanvasSpec {
    /// The box that is drawn if that does not depend on the pose.
    #[must_use]
    pub const fn before_pose(self, source: Extent) -> Option<Canvas> {
        match self {
            Self::Same => Some(Canvas::of(source)),
            Self::Fit => None,
            Self::Box(canvas) => Some(canvas),
        }
    }

    /// The box that is drawn; `None` if the posed picture of `fit` has no area or extends too far.
    ///
    /// # Errors
    /// Cancelled.
    pub fn of(
        self,
        source: Extent,
        posed: &PosedMesh,
        cancelled: IsCancelled<'_>,
    ) -> Result<Option<Canvas>, WarpError> {
        match self
            .before_pose(source)
            .map_or_else(|| fit(posed, cancelled), Ok)
        {
            Err(WarpError::Cancelled) => Err(WarpError::Cancelled),
            canvas => Ok(canvas.ok()),
        }
    }
}

/// Errors: A result without area, or one that extends beyond [`FARTHEST_EDGE_PX`]; cancelled.
fn fit(posed: &PosedMesh, cancelled: IsCancelled<'_>) -> Result<Canvas, WarpError> {
    let [left, top, right, bottom] = posed
        .bounds(cancelled)?
        .map(|edge| (edge * STEPS_PER_PX).round() / STEPS_PER_PX);
    let farthest = [left, top, right, bottom]
        .into_iter()
        .fold(0.0, |far: f64, edge| far.max(edge.abs()));
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to integer saturates"
    )]
    if farthest > f64::from(FARTHEST_EDGE_PX) {
        return Err(WarpError::TooLarge {
            what: Quantity::CanvasEdge,
            limit: FARTHEST_EDGE_PX.unsigned_abs().into(),
            actual: farthest.ceil() as u64,
        });
    }
    #[expect(clippy::cast_possible_truncation, reason = "at most the farthest edge")]
    let (x, y) = (left.floor() as i32, top.floor() as i32);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most twice the farthest edge"
    )]
    let side = |low: f64, high: f64| {
        if high > low {
            (high.ceil() - low.floor()) as u32
        } else {
            0
        }
    };
    Extent::new(side(left, right), side(top, bottom))
        .map(|extent| Canvas { x, y, extent })
        .ok_or(WarpError::NothingVisible)
}

/// The part of the posed plane that a target picture shows, and the size of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// The part of the posed plane; `None` for the box of the source, which is requested as `same`.
    pub canvas: Option<Canvas>,
    /// The size of the picture, px.
    pub extent: Extent,
    /// Whether the picture has alpha even if every pixel is opaque: either all pictures of a batch
    /// have alpha, or none has.
    pub force_alpha: bool,
    /// Whether the picture is a preview, whose file has no more metadata than its colours need.
    pub is_preview: bool,
}

impl Target {
    /// A picture of this size that shows a part of the posed plane, or the box of the source.
    #[must_use]
    pub const fn of(canvas: Option<Canvas>, extent: Extent) -> Self {
        Self {
            canvas,
            extent,
            force_alpha: false,
            is_preview: false,
        }
    }

    /// The metadata that the picture has from a source of this size.
    #[cfg(feature = "codec")]
    pub(super) fn carried(&self, metadata: &Arc<Metadata>, source: Extent) -> Carried {
        let carried = Carried::new(
            metadata,
            self.extent,
            self.canvas.map_or(source, |canvas| canvas.extent),
        );
        if self.is_preview {
            carried.colour_only()
        } else {
            carried
        }
    }

    /// Memory for drawing a mesh beyond that of one posed grid, bytes: far from the source, a
    /// canvas is drawn in several windows, and with a region, picture and mask are drawn posed and
    /// at rest.
    #[must_use]
    pub fn window_bytes(&self, posed: &PosedMesh) -> u64 {
        let windows = self
            .canvas
            .map_or(1, |canvas| window_count(canvas, self.extent));
        let drawings = if posed.region().is_some() { 4 } else { 1 };
        (windows * drawings - 1) * posed.mesh().vertices() * WINDOW_BYTES_PER_VERTEX
    }

    pub(super) fn options(self, output: &OutputSpec) -> RenderOptions {
        let Self {
            canvas,
            extent,
            force_alpha,
            ..
        } = self;
        RenderOptions {
            target: extent,
            canvas,
            filter: output.filter,
            outside: output.outside,
            force_alpha,
        }
    }
}

impl OutputSpec {
    /// Checks the size of the target as far as it is known before anything is posed.
    ///
    /// # Errors
    /// Over the limits.
    pub fn check(&self, source: Extent, limits: &Limits) -> Result<(), WarpError> {
        self.target_before_pose(source, limits).map(drop)
    }

    /// The target, if it does not depend on the pose.
    ///
    /// # Errors
    /// Over the limits.
    pub fn target_before_pose(
        &self,
        source: Extent,
        limits: &Limits,
    ) -> Result<Option<Target>, WarpError> {
        let canvas = self.canvas.before_pose(source);
        canvas
            .map(|canvas| self.target_of(canvas, source, limits))
            .transpose()
    }

    /// The target of a pose.
    ///
    /// # Errors
    /// Over the limits; nothing to show; cancelled.
    pub fn target(
        &self,
        source: Extent,
        posed: &PosedMesh,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Target, WarpError> {
        let canvas = self
            .canvas
            .before_pose(source)
            .map_or_else(|| fit(posed, cancelled), Ok)?;
        self.target_of(canvas, source, limits)
    }

    fn target_of(
        &self,
        canvas: Canvas,
        source: Extent,
        limits: &Limits,
    ) -> Result<Target, WarpError> {
        let extent = self.extent_of(canvas, source, limits)?;
        Ok(Target::of(
            (self.canvas != CanvasSpec::Same).then_some(canvas),
            extent,
        ))
    }

    /// The size of the target on this canvas, whatever the limits.
    pub(super) fn size_of(&self, canvas: Canvas) -> Extent {
        let Some(width) = self.width else {
            return canvas.extent;
        };
        let height = u32::try_from(height_of(canvas, width)).unwrap_or(u32::MAX);
        Extent::new(width, height).unwrap_or(canvas.extent)
    }

    /// The size of the target: `width` with the height that keeps the proportions.
    fn extent_of(
        &self,
        canvas: Canvas,
        source: Extent,
        limits: &Limits,
    ) -> Result<Extent, WarpError> {
        let (w, h) = (
            u64::from(canvas.extent.width()),
            u64::from(canvas.extent.height()),
        );
        let max_side = u64::from(limits.image.max_side.min(self.format.max_side()));
        let max_pixels = limits.image.max_pixels.min(self.format.max_pixels());
        let Some(width) = self.width else {
            if self.canvas == CanvasSpec::Same {
                // The source is within the limits of pictures.
                at_most(
                    Quantity::OutputSide,
                    self.format.max_side().into(),
                    w.max(h),
                )?;
                at_most(Quantity::OutputPixels, self.format.max_pixels(), w * h)?;
            } else {
                at_most(Quantity::CanvasSide, max_side, w.max(h))?;
                at_most(Quantity::CanvasPixels, max_pixels, w * h)?;
            }
            return Ok(canvas.extent);
        };
        at_most(Quantity::OutputSide, max_side, width.into())?;
        let height = height_of(canvas, width);
        at_most(Quantity::OutputSide, max_side, height)?;
        at_most(
            Quantity::OutputPixels,
            max_pixels,
            height * u64::from(width),
        )?;
        at_most(
            Quantity::ScaledSourceSide,
            LONGEST_SCALED_SOURCE,
            u64::from(source.width().max(source.height())) * u64::from(width) / w,
        )?;
        let height = u32::try_from(height).expect("at most max_side");
        Extent::new(width, height).ok_or(WarpError::TooLarge {
            what: Quantity::OutputSide,
            limit: max_side,
            actual: 0,
        })
    }
}

/// The height that keeps the proportions, max(1, round(H w / W)).
fn height_of(canvas: Canvas, width: u32) -> u64 {
    let (w, h) = (
        u64::from(canvas.extent.width()),
        u64::from(canvas.extent.height()),
    );
    ((2 * h * u64::from(width) + w) / (2 * w)).max(1)
}
