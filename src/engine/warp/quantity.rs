//! What limits are about.

use std::fmt;

use crate::deform::Method;

/// What is counted or measured against a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Columns of the handles: one for each point, two for each segment.
    HandleColumns,
    /// Handles of a method that solves a system of them.
    SystemHandles(Method),
    /// Handles on which methods are compared.
    FitHandles,
    /// Vertices of a grid.
    GridVertices,
    /// Columns of vertices of a grid.
    GridColumns,
    /// Rows of vertices of a grid.
    GridRows,
    /// The longer side of an output, px.
    OutputSide,
    /// Pixels of an output.
    OutputPixels,
    /// The longer side of the whole source at the scale of the output, px.
    ScaledSourceSide,
    /// The longer side of a map, px.
    MapSide,
    /// Pixels of a map.
    MapPixels,
    /// The longer side of a canvas, px.
    CanvasSide,
    /// How far a canvas reaches from the corner of the image, px.
    CanvasEdge,
    /// Pixels of a canvas.
    CanvasPixels,
    /// Positions at which outlines are examined.
    OutlineSamples,
    /// Memory of coefficients, bytes.
    PlanBytes,
    /// Memory of pixels, bytes.
    Memory,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::HandleColumns => "columns of the handles",
            Self::SystemHandles(method) => {
                return write!(f, "handles of the method {}", method.info().name);
            }
            Self::FitHandles => "handles that are compared",
            Self::GridVertices => "vertices of the grid",
            Self::GridColumns => "columns of the grid",
            Self::GridRows => "rows of the grid",
            Self::OutputSide => "longer side of the output in px",
            Self::OutputPixels => "pixels of the output",
            Self::ScaledSourceSide => "longer side of the scaled source in px",
            Self::MapSide => "longer side of the map in px",
            Self::MapPixels => "pixels of the map",
            Self::CanvasSide => "longer side of the canvas in px",
            Self::CanvasEdge => "distance of the canvas from the corner of the image in px",
            Self::CanvasPixels => "pixels of the canvas",
            Self::OutlineSamples => "samples of the outlines",
            Self::PlanBytes => "bytes of coefficients",
            Self::Memory => "bytes of pixels",
        };
        f.write_str(name)
    }
}
