//! Why a picture was not warped: sorted by what the client has to change.

use thiserror::Error;

use crate::codec::CodecError;
use crate::deform::DeformError;

/// Why a picture was not warped.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum WarpError {
    /// The file.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The rest handles p, or a parameter.
    #[error("{0}")]
    Rest(DeformError),
    /// The posed handles q.
    #[error("{0}")]
    Posed(DeformError),
    /// A place to be mapped is not one.
    #[error("place {index} has a coordinate of {value:e} px; at most {limit} px either way")]
    BadPlace {
        /// Which place.
        index: usize,
        /// Its coordinate, px.
        value: f64,
        /// The limit, px.
        limit: f64,
    },
    /// Nobody waits for the result any more.
    #[error("the work was given up: nobody waits for it any more")]
    GivenUp,
    /// Over a limit.
    #[error("{what}: {actual}; at most {limit}")]
    TooLarge {
        /// Which limit: `handle_columns`, `grid_vertices`, `grid_columns`, `grid_rows`, `output_side`, `output_pixels`.
        what: &'static str,
        /// The limit.
        limit: u64,
        /// What was asked for.
        actual: u64,
    },
    /// A grid that is not one.
    #[error("{0}")]
    BadGrid(String),
    /// `folds: reject` and the posed grid folds.
    #[error("the warp folds in {cells} cells of the grid")]
    Folded {
        /// Folded cells.
        cells: u64,
    },
}

impl WarpError {
    /// The same error of places that were mapped as a part of a longer list, `offset` places from its start.
    #[must_use]
    pub fn with_place_offset(self, offset: usize) -> Self {
        match self {
            Self::BadPlace { index, value, limit } => Self::BadPlace { index: index + offset, value, limit },
            other => other,
        }
    }
}
