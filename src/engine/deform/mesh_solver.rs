//! Maps that are known on a mesh of their own only: the second trait that a method may implement,
//! beside [`super::point_map::PointMap`], which is asked for everything else.

use std::sync::Arc;

use crate::geometry::{CutCells, Vec2};

/// A mesh that is posed as a whole.
pub(super) trait MeshSolver {
    /// Its quads at rest.
    fn cells(&self) -> &Arc<CutCells>;

    /// The displacements of their vertices, px, and the least share of itself that a piece keeps
    /// where its rotation is found: near 0 the rotation is undefined. `None` when cancelled.
    fn pose(
        &self,
        displacements: &[Vec2],
        cancelled: &dyn Fn() -> bool,
    ) -> Option<(Vec<[f32; 2]>, f32)>;

    /// Displacements that turn nothing, carried from the columns to the vertices: as smoothly as
    /// possible, and nowhere beyond those of the columns. `None` when cancelled.
    fn carry(&self, displacements: &[Vec2], cancelled: &dyn Fn() -> bool) -> Option<Vec<[f32; 2]>>;
}
