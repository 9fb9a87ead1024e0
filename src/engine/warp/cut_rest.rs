//! A grid that is cut along a mask: one quad for each piece of the subject in a cell, so that the
//! parts of the subject move independently (mathematics 11.1).

use std::sync::Arc;

use super::rest_parameters::to_px;
use super::spec::{at_most, system_bytes};
use super::{
    GridError, GridSpec, Limits, Metric, Quantity, RestSpec, Task, Units, WarpError, work,
};
use crate::deform::{
    CoefficientTable, DeformError, Handle, IsCancelled, MeshMethod, Pose, PoseQuality,
    RestDeformation,
};
use crate::geometry::{CutCells, CutMesh, DrawingOrder, Grid, Mesh, Point};
use crate::pixmap::Extent;
use crate::topology::{CutLattice, Distances, LatticeSize, MAX_SPACING, Mask, Nodes};

/// Cells are not subdivided, so they are small: as many pixels a side as give about this number of
/// quads and not more cells of the whole image than that, and at least [`LEAST_CELL`].
const QUADS: usize = 40_000;
const MOST_CELLS: usize = 1 << 21;
const LEAST_CELL: u32 = 2;
/// The pixel of a vertex that no handle moves.
const AT_REST: u32 = u32::MAX - 1;

/// The quads of a cut grid at rest.
#[derive(Debug)]
pub(super) struct CutRest {
    cells: Arc<CutCells>,
    /// Each vertex, and the pixel that it belongs to, counted row by row.
    vertices: Vec<(Point, u32)>,
}

impl CutRest {
    /// Cells have `side` px, a whole number. `of_vertex`: operations of a vertex. Also returns the
    /// bytes of the table of coefficients; a mesh of the method itself has none.
    pub(super) fn new(
        (field, of_vertex): (&RestDeformation, u64),
        mask: &Mask,
        side: f64,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<(Self, Option<u64>), WarpError> {
        if let Some(cells) = field.mesh_cells() {
            let mesh = Self {
                cells: Arc::clone(cells),
                vertices: Vec::new(),
            };
            return Ok((mesh, None));
        }
        let side = whole(side);
        Self::size(mask, side, limits, cancelled)?;
        let lattice = CutLattice::new(mask, side, usize::MAX, cancelled);
        let lattice = lattice.ok_or(WarpError::Cancelled)?;
        let vertices = lattice.vertices().len();
        let bytes = CoefficientTable::bytes_for(field, vertices);
        at_most(Quantity::PlanBytes, limits.plan_bytes, bytes)?;
        let operations = (vertices as u64).saturating_mul(of_vertex);
        work::at_most(Task::Grid, limits.work, operations)?;
        let cells = lattice.cells_of(mask, cancelled);
        let pixels = lattice.pixels(mask, cancelled);
        let (Some(cells), Some(pixels)) = (cells, pixels) else {
            return Err(WarpError::Cancelled);
        };
        let pixels = (0..).zip(pixels);
        let vertices: Vec<_> = pixels
            .map(|(vertex, pixel)| (cells.vertex(vertex), pixel.unwrap_or(AT_REST)))
            .collect();
        let cut = Self {
            cells: Arc::new(cells),
            vertices,
        };
        Ok((cut, Some(bytes)))
    }

    /// The size of the lattice that a mask has with cells of `side` px.
    ///
    /// Errors: the lattice takes more memory than the limit of a plan; cancelled.
    fn size(
        mask: &Mask,
        side: u32,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<LatticeSize, WarpError> {
        let size = CutLattice::size(mask, side, limits.plan_bytes, cancelled);
        let size = size.ok_or(WarpError::Cancelled)?;
        at_most(Quantity::PlanBytes, limits.plan_bytes, size.bytes(side))?;
        Ok(size)
    }

    /// The coefficients of its vertices; `None` when cancelled.
    pub(super) fn table(
        &self,
        field: &RestDeformation,
        cancelled: IsCancelled<'_>,
    ) -> Option<CoefficientTable> {
        CoefficientTable::of_cut(field, &self.vertices, cancelled)
    }

    /// The posed mesh; `None` when cancelled.
    pub(super) fn pose(
        &self,
        field: &RestDeformation,
        table: Option<&CoefficientTable>,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<(Mesh, PoseQuality)> {
        let Some(table) = table else {
            return field.pose_mesh(pose, cancelled);
        };
        let (moved, quality) = table.displace(pose, cancelled)?;
        let cut = CutMesh::new(Arc::clone(&self.cells), moved);
        Some((Mesh::cut(cut), quality))
    }

    /// Numbers of the columns, carried to the vertices; `None` when cancelled.
    pub(super) fn carried(
        &self,
        field: &RestDeformation,
        of_columns: &[f64],
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<f32>> {
        if field.mesh_cells().is_some() {
            return field.carried_on_mesh(of_columns, cancelled);
        }
        let vertex = |k: usize| (self.vertices[k].0, Some(self.vertices[k].1));
        field.carried(of_columns, self.vertices.len(), &vertex, cancelled)
    }

    /// The order of drawing by the depths of the vertices; the outer `None`: cancelled.
    pub(super) fn order(
        &self,
        depth: &[f32],
        cancelled: IsCancelled<'_>,
    ) -> Option<Option<DrawingOrder>> {
        DrawingOrder::of_quads(&self.cells, depth, cancelled)
    }

    /// Number of quads.
    pub(super) fn quads(&self) -> u64 {
        self.cells.cells().len() as u64
    }

    /// Number of vertices.
    pub(super) fn vertices(&self) -> u64 {
        self.cells.len() as u64
    }

    /// Memory of a posed mesh until it is drawn, bytes.
    pub(super) fn posed_bytes(&self) -> u64 {
        // Displacements and corners of vertices, and the corners of quads.
        32 * self.cells.len() as u64 + 160 * self.cells.cells().len() as u64
    }
}

impl RestSpec {
    /// Memory of the deformation that [`ResolvedRest::new`](super::ResolvedRest::new) computes,
    /// beyond that of the handles; known before anything is allocated.
    ///
    /// # Errors
    /// A grid that is cut takes more memory than a plan may; cancelled: a mask is looked through.
    pub fn field_bytes(
        &self,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<FieldBytes, WarpError> {
        let handles = self.p.len() as u64;
        let system = system_bytes(self.method, handles);
        let mask = self.mask.as_ref().map(|rest| &rest.mask);
        let Some(mask) = mask.filter(|mask| self.needs_mask() && !is_plane(self, mask)) else {
            return Ok(FieldBytes {
                peak: system,
                kept: system,
            });
        };
        if let Some(method) = &self.method.info().mesh {
            let held = held_positions(self, mask, (method.cell)(&self.own, mask));
            let mesh = (method.bytes)(&self.own, mask, held, cancelled);
            let mesh = mesh.ok_or(WarpError::Cancelled)?;
            let kept = system + mask.bytes() + mesh;
            return Ok(FieldBytes { peak: kept, kept });
        }
        let stride = Nodes::stride_of(mask);
        let nodes = Nodes::size(mask, stride, cancelled).ok_or(WarpError::Cancelled)?;
        let columns: u64 = self.p.iter().map(|handle| handle.columns() as u64).sum();
        // Distances that take more are refused when they are computed, so no more is reserved.
        let of_nodes = |of_node: u64| {
            let of_node = of_node + Distances::bytes_for(1) * columns;
            nodes.nodes.saturating_mul(of_node).min(limits.plan_bytes)
        };
        // A grid that is wrong is refused before it is cut.
        let (peak, kept) = match resolve_grid(self, mask, limits) {
            Ok(grid) => {
                let side = whole(grid.cell().0);
                let size = CutRest::size(mask, side, limits, cancelled)?;
                (size.bytes(side), size.kept_bytes(side))
            }
            Err(_) => (0, 0),
        };
        // One search runs on each thread, of at most as many nodes as are not refused.
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let most_nodes = nodes.nodes.min(limits.plan_bytes / Nodes::bytes_for(1));
        let searching = Distances::search_bytes(most_nodes) * columns.min(threads as u64);
        let of_mask = system + mask.bytes() + nodes.block_bytes(stride);
        Ok(FieldBytes {
            peak: of_mask + of_nodes(Nodes::bytes_for(1)) + searching + peak,
            kept: of_mask + of_nodes(Nodes::kept_bytes(1)) + kept,
        })
    }
}

/// Memory, bytes: the most while a deformation is computed, and what it holds then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldBytes {
    /// The most.
    pub peak: u64,
    /// What is held.
    pub kept: u64,
}

/// Errors: The grid is cut, and `what` needs all cells of a grid.
pub(super) fn check_uncut(cut: Option<&Arc<CutRest>>, what: &'static str) -> Result<(), WarpError> {
    match cut {
        Some(_) => Err(WarpError::CutGrid { what }),
        None => Ok(()),
    }
}

/// The mask along which the grid is cut; none if the metric is that of the plane, or every pixel is
/// inside, which is the same.
///
/// Errors: No image, a method without a metric.
pub(super) fn mask_of(rest: &RestSpec, extent: Extent) -> Result<Option<Arc<Mask>>, WarpError> {
    if !rest.needs_mask() {
        return Ok(None);
    }
    let method = rest.method.info();
    if rest.metric == Metric::Geodesic && method.parameter("alpha").is_none() {
        let method = method.name;
        return Err(WarpError::Rest(DeformError::NoMetric { method }));
    }
    let size = (extent.width() as usize, extent.height() as usize);
    let mask = rest.mask.as_ref().map(|rest| &rest.mask);
    let mask = mask
        .filter(|mask| mask.size() == size)
        .ok_or_else(|| match method.mesh {
            Some(_) => {
                let method = method.name;
                WarpError::Rest(DeformError::NeedsMask { method })
            }
            None => WarpError::NoImage,
        })?;
    Ok((!is_plane(rest, mask)).then(|| Arc::clone(mask)))
}

/// Whether what follows the mask is the same in the plane.
fn is_plane(rest: &RestSpec, mask: &Mask) -> bool {
    mask.is_everything() && rest.method.info().mesh.is_none()
}

/// Positions that handles hold of a mesh with cells of this side: lines one in each.
fn held_positions(rest: &RestSpec, mask: &Mask, side: f64) -> u64 {
    let (width, height) = mask.size();
    let unit = match rest.units {
        Units::Px => (1.0, 1.0),
        Units::Normalized => (width as f64, height as f64),
    };
    let of_segment = |ends: &[Point]| (ends[0].distance(ends[1]) / side).ceil() + 1.0;
    let of = |handle: &Handle| match handle {
        Handle::Point(_) => 1.0,
        Handle::Polyline(places) => places.windows(2).map(of_segment).sum(),
        Handle::Missing => 0.0,
    };
    let held: f64 = to_px(&rest.p, unit).iter().map(of).sum();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to integer saturates"
    )]
    let held = held as u64;
    held
}

/// The grid whose cells a method's mesh has.
fn resolve_mesh_grid(rest: &RestSpec, method: &MeshMethod, mask: &Mask) -> Result<Grid, WarpError> {
    if rest.grid.tolerance().is_none() {
        return Err(WarpError::BadGrid(GridError::OwnMesh(rest.method)));
    }
    let [width, height] = [mask.size().0, mask.size().1].map(|side| side as f64);
    let cell = (method.cell)(&rest.own, mask);
    Ok(Grid::with_cell(width, height, cell))
}

/// A grid whose cells have a whole number of pixels.
pub(super) fn resolve_grid(
    rest: &RestSpec,
    mask: &Mask,
    limits: &Limits,
) -> Result<Grid, WarpError> {
    if let Some(method) = &rest.method.info().mesh {
        let grid = resolve_mesh_grid(rest, method, mask)?;
        at_most(
            Quantity::GridVertices,
            limits.plan_bytes / 8,
            grid.len() as u64,
        )?;
        return Ok(grid);
    }
    let side = match rest.grid {
        GridSpec::Auto => {
            let (all, mut side) = (mask.size().0 * mask.size().1, LEAST_CELL);
            let is_coarse = |side: u32| {
                let pixels = (side * side) as usize;
                pixels * QUADS >= mask.inside() && pixels * MOST_CELLS >= all
            };
            while !is_coarse(side) {
                side += 1;
            }
            side
        }
        GridSpec::Pixel => 1,
        GridSpec::Cell(side)
            if side.fract() == 0.0 && (1.0..=f64::from(MAX_SPACING)).contains(&side) =>
        {
            whole(side)
        }
        GridSpec::Cell(_) | GridSpec::Counts { .. } | GridSpec::Tolerance(_) => {
            return Err(WarpError::BadGrid(GridError::CutCells {
                most: MAX_SPACING,
            }));
        }
    };
    let [width, height] = [mask.size().0, mask.size().1].map(|side| side as f64);
    let grid = Grid::with_cell(width, height, f64::from(side));
    at_most(
        Quantity::GridVertices,
        limits.plan_bytes / 8,
        grid.len() as u64,
    )?;
    Ok(grid)
}

/// A whole number of pixels.
fn whole(side: f64) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "resolve_grid gives 1 to 128"
    )]
    let side = side as u32;
    side
}
