//! The shape of what an image shows: its mask, a lattice that is cut where the mask is not
//! connected, and distances inside the mask (mathematics 11).

mod cell_components;
mod distance;
mod drawn_cells;
mod lattice;
mod mask;
mod neighbours;
mod nodes;
mod pixel;
mod sight;
mod stray;
mod taut;

/// A handle beside the mask counts as on its nearest pixel within this distance, px.
pub const HANDLE_TO_MASK_PX: f64 = 3.0;
/// A position farther from the mask than this belongs to no part, px.
pub const POSITION_TO_MASK_PX: f64 = 16.0;

pub use distance::{Distances, OutsideMask, PathOrigin};
pub use lattice::{CutLattice, LatticeSize, MAX_SPACING, Quad};
pub use mask::{Mask, Membership};
pub use nodes::{NoNodes, Nodes, NodesSize};
pub use sight::Sights;

#[cfg(test)]
mod tests;
