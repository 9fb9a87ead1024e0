//! The plane: points, displacements, the grid at rest and the mesh that is drawn. Standard library
//! only.
//!
//! **Coordinates.** x to the right, y down, unit one pixel of the source image; the image covers
//! `[0, W] x [0, H]` and the centre of pixel `(i, j)` is `(i + PIXEL_CENTER, j + PIXEL_CENTER)`. A
//! position is a [`Point`], a displacement a [`Vec2`]. Points are at *rest* (where the handles were
//! placed) or *posed* (where they were moved to); images are *source* or *target*.

mod border;
mod cell_tree;
mod cut_cells;
mod display_number;
mod distortion;
mod drawing_order;
mod fold_regions;
mod folding;
mod grid;
pub(crate) mod lane_math;
mod mesh;
mod subdivision;
mod untangle;
mod vec;

pub use cell_tree::{CellKey, CellTree};
pub use cut_cells::{CutCell, CutCells, CutMesh};
pub use display_number::DisplayNumber;
pub use distortion::{Distortion, Summary};
pub use drawing_order::DrawingOrder;
pub use fold_regions::FoldRegions;
pub use folding::{Folding, Orientation};
pub use grid::Grid;
pub use mesh::Mesh;
pub use subdivision::{SubdividedCell, Subdivision};
pub use untangle::{Untangled, untangle};
pub use vec::{Point, Vec2};

/// Offset of a pixel's centre from its corner, px.
pub const PIXEL_CENTER: f64 = 0.5;
