//! The posed grid, as its client is told.

use mlswarp::pixmap::Extent;
use mlswarp::warp::{Posed, Setup};
use serde::Serialize;
use serde::ser::{SerializeSeq as _, Serializer};

use super::AsJson;

/// What a mesh is laid over: the shape of everything that is sent for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeshShape {
    /// Vertices in a row.
    pub columns: u32,
    /// Vertices in a column.
    pub rows: u32,
    /// Width of the picture, px.
    pub width: u32,
    /// Height of the picture, px.
    pub height: u32,
    /// Distance of neighbouring grid lines, px: they lie at 0, c, 2c, ... and the last at the picture's edge.
    pub cell: [f64; 2],
}

impl MeshShape {
    /// The grid of a setup over its picture.
    pub fn new(setup: &Setup, extent: Extent) -> Self {
        let ((columns, rows), cell) = (setup.grid(), setup.cell());
        Self { columns, rows, width: extent.width(), height: extent.height(), cell: cell.into() }
    }
}

/// The answer of `POST /sessions/{id}/mesh`.
#[derive(Debug, Serialize)]
pub struct MeshObject<'a> {
    /// The grid.
    #[serde(flatten)]
    pub shape: MeshShape,
    /// Row by row, in the session's units.
    pub vertices: AsJson<&'a Posed>,
}

impl Serialize for AsJson<&Posed> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut array = s.serialize_seq(Some(self.0.mesh().grid().len()))?;
        self.0.vertices().try_for_each(|vertex| array.serialize_element(&vertex))?;
        array.end()
    }
}
