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
    /// Over a limit.
    #[error("{what}: {actual}; at most {limit}")]
    TooLarge {
        /// Which limit: `handle_columns`, `grid_vertices`, `output_side`, `output_pixels`.
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
