//! Handles at rest whose map is known on a mesh: positions between its vertices follow from it.

use std::sync::Arc;

use super::mesh_solver::MeshSolver;
use super::point_map::{MeshInput, MeshMethod};
use super::{DeformError, IsCancelled, Pose, PoseQuality, RestDeformation};
use crate::geometry::{CutCells, CutMesh, Mesh};
use crate::topology::Mask;

impl RestDeformation {
    /// The same deformation on the mesh of its method. Its map follows the mask.
    pub(super) fn on_mesh(
        self,
        method: &MeshMethod,
        mask: &Arc<Mask>,
        most_operations: u64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        let built = (method.make)(&MeshInput {
            set: &self.set,
            parameters: self.parameters(),
            mask,
            handle_of: &|column| self.owner_of(column),
            most_operations,
            cancelled,
        })?;
        Ok(self.with_mesh(built))
    }

    /// The quads of the mesh on which the map is known, if it is known on a mesh only.
    #[must_use]
    pub fn mesh_cells(&self) -> Option<&Arc<CutCells>> {
        self.map.mesh().map(MeshSolver::cells)
    }

    /// That mesh in a pose; `None` when cancelled, or if there is none.
    #[must_use]
    pub fn pose_mesh(
        &self,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<(Mesh, PoseQuality)> {
        let solver = self.map.mesh()?;
        let (moved, least_rotation) = solver.pose(pose.displacements(), cancelled)?;
        let mesh = CutMesh::new(Arc::clone(solver.cells()), moved);
        Some((Mesh::cut(mesh), PoseQuality { least_rotation }))
    }
}
