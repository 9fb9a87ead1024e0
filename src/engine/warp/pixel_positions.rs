//! A position for every pixel of a canvas, row by row.

use std::ops::Range;

use super::Target;
use crate::geometry::{Mesh, PIXEL_CENTER, Point};
use crate::pixmap::Extent;
use crate::render::{Canvas, InverseMap, band_rows};

/// Positions that are computed for a band.
const BAND_POSITIONS: u32 = 1 << 16;

/// Which positions a map has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum MapDirection {
    /// For each pixel of the posed plane, the source position that is drawn there; NaN where
    /// nothing is.
    #[default]
    Inverse,
    /// For each pixel of the plane at rest, the posed position at which it is drawn; NaN outside
    /// the source.
    Forward,
}

/// The positions of the pixels of a target.
#[derive(Debug)]
pub(crate) struct PixelPositions {
    source: PositionSource,
    target: Target,
}

#[derive(Debug)]
enum PositionSource {
    Inverse(InverseMap),
    Forward(Mesh),
}

impl PixelPositions {
    pub(crate) fn new(direction: MapDirection, mesh: &Mesh, target: Target) -> Self {
        let source = match direction {
            MapDirection::Inverse => {
                PositionSource::Inverse(InverseMap::new(mesh, target.extent, target.canvas))
            }
            MapDirection::Forward => PositionSource::Forward(mesh.clone()),
        };
        Self { source, target }
    }

    /// The rows of a band whose positions are computed at once.
    pub(crate) fn band_rows(&self) -> u32 {
        let computed = match &self.source {
            PositionSource::Inverse(inverse) => inverse.computed_width(),
            PositionSource::Forward(_) => self.target.extent.width(),
        };
        band_rows(BAND_POSITIONS, computed)
    }

    /// The positions of some rows, NaN where nothing is; anything when cancelled. Shapes:
    /// `out: [rows][width]`.
    pub(crate) fn rows(
        &self,
        rows: Range<u32>,
        out: &mut [[f32; 2]],
        cancelled: &dyn Fn() -> bool,
    ) {
        match &self.source {
            PositionSource::Inverse(inverse) => inverse.rows(rows, out, cancelled),
            PositionSource::Forward(mesh) => {
                forward(mesh, self.target.canvas, self.target.extent, rows, out);
            }
        }
    }
}

/// The posed positions of the pixel centres of a canvas at rest.
fn forward(
    mesh: &Mesh,
    canvas: Option<Canvas>,
    target: Extent,
    rows: Range<u32>,
    out: &mut [[f32; 2]],
) {
    let [left, top, right, bottom] = canvas.map_or(
        [0.0, 0.0, mesh.grid().width(), mesh.grid().height()],
        |canvas| canvas.edges(),
    );
    let px = (right - left) / f64::from(target.width());
    let py = (bottom - top) / f64::from(target.height());
    for (row, out) in rows.zip(out.chunks_exact_mut(target.width() as usize)) {
        let y = top + (f64::from(row) + PIXEL_CENTER) * py;
        for (column, out) in (0..target.width()).zip(out) {
            let posed = mesh.map(Point::new(
                left + (f64::from(column) + PIXEL_CENTER) * px,
                y,
            ));
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the format of the contract is f32"
            )]
            let position = posed.map_or([f32::NAN; 2], |p| [p.x as f32, p.y as f32]);
            *out = position;
        }
    }
}
