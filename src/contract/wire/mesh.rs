//! The grid of a mesh: in the answer of `POST /sessions/{id}/mesh`, and in the first message of a
//! drag socket.

use mlswarp::geometry::Grid;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{CompactLattice, PosedMesh, ResolvedRest};
use serde::{Serialize, Serializer};

use super::AsJson;

/// A grid and the picture that it covers.
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
    /// Distance of neighbouring grid lines, px: they lie at 0, c, 2c, ... and the last at the
    /// picture's edge.
    pub cell: [f64; 2],
    /// What a compact mesh has besides.
    #[serde(flatten)]
    pub compact: Option<CompactShape>,
}

/// Additional fields of that message with `mesh=compact`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CompactShape {
    /// Always "compact".
    mesh: &'static str,
    /// The requested tolerance, px.
    tolerance: f64,
    /// See [`CompactLattice::error`].
    error: Option<f64>,
}

impl MeshShape {
    /// The grid of a session over an image of the size `extent`.
    pub fn new(setup: &ResolvedRest, extent: Extent) -> Self {
        Self::of(setup.grid(), extent)
    }

    /// The grid of a compact mesh over an image of the size `extent`.
    pub fn compact(lattice: &CompactLattice, extent: Extent) -> Self {
        let compact = CompactShape {
            mesh: "compact",
            tolerance: lattice.tolerance(),
            error: lattice.error(),
        };
        Self {
            compact: Some(compact),
            ..Self::of(&lattice.grid(), extent)
        }
    }

    fn of(grid: &Grid, extent: Extent) -> Self {
        let (columns, rows, cell) = (grid.columns(), grid.rows(), grid.cell());
        Self {
            columns,
            rows,
            width: extent.width(),
            height: extent.height(),
            cell: cell.into(),
            compact: None,
        }
    }
}

/// A posed mesh as JSON.
#[derive(Debug, Serialize)]
pub struct MeshObject<'a> {
    /// The grid at rest.
    #[serde(flatten)]
    pub shape: MeshShape,
    /// Row by row, in the session's units.
    pub vertices: AsJson<&'a PosedMesh>,
}

impl Serialize for AsJson<&PosedMesh> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_seq(self.0.vertices())
    }
}
