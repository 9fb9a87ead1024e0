//! What a coordinate map has: its direction, its canvas and its file.

use super::spec::at_most;
use super::{CanvasSpec, Limits, MapDirection, OutputSpec, PosedMesh, Quantity, Target, WarpError};
use crate::deform::IsCancelled;
use crate::pixmap::Extent;

/// The file of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum MapFormat {
    /// NumPy's format, version 1: `[height, width, 2]`, little-endian f32.
    #[default]
    Npy,
    /// TIFF of two bands.
    Tiff,
}

impl MapFormat {
    /// All formats, the default first.
    pub const ALL: [Self; 2] = [Self::Npy, Self::Tiff];

    /// The media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Npy => "application/x-npy",
            Self::Tiff => "image/tiff",
        }
    }
}

/// The parameters of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MapSpec {
    /// Which positions it has.
    pub direction: MapDirection,
    /// The part of the plane that it covers.
    pub canvas: CanvasSpec,
    /// Pixels in a row; default the canvas's width.
    pub width: Option<u32>,
    /// The file.
    pub format: MapFormat,
}

impl MapSpec {
    fn output(&self) -> OutputSpec {
        OutputSpec {
            canvas: self.canvas,
            width: self.width,
            ..OutputSpec::default()
        }
    }

    /// The target of a posed grid.
    ///
    /// # Errors
    /// Over the limits of pictures; nothing to show on the canvas `fit`; cancelled.
    pub fn target(
        &self,
        posed: &PosedMesh,
        source: Extent,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Target, WarpError> {
        self.check(source, limits)?;
        self.output().target(source, posed, limits, cancelled)
    }

    /// Checks the size of the map as far as it is known before anything is posed.
    ///
    /// # Errors
    /// Over the limits of pictures.
    pub fn check(&self, source: Extent, limits: &Limits) -> Result<(), WarpError> {
        if self.canvas == CanvasSpec::Same && self.width.is_none() {
            // There need not be a picture that was checked.
            at_most(
                Quantity::MapSide,
                limits.image.max_side.into(),
                source.width().max(source.height()).into(),
            )?;
            at_most(
                Quantity::MapPixels,
                limits.image.max_pixels,
                source.pixels(),
            )?;
        }
        self.output().check(source, limits)
    }
}
