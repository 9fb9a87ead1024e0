//! A grid that is cut along a mask: one quad for each piece of the subject in a cell, so that the
//! parts of the subject move independently (mathematics 11.1).

use std::sync::Arc;

use super::spec::at_most;
use super::{GridSpec, Limits, Metric, RestSpec, Task, WarpError, work};
use crate::deform::{
    CoefficientTable, DeformError, IsCancelled, Pose, PoseQuality, RestDeformation,
};
use crate::geometry::{CutCells, CutMesh, Grid, Mesh, Point};
use crate::pixmap::Extent;
use crate::topology::{CutLattice, MAX_SPACING, Mask};

/// Cells are not subdivided, so they are small: as many pixels a side as give about this number of
/// quads, and at least [`LEAST_CELL`].
const QUADS: usize = 40_000;
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
    /// Cells have `side` px, a whole number. Also returns the bytes of the table of coefficients.
    pub(super) fn new(
        field: &RestDeformation,
        mask: &Mask,
        side: f64,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<(Self, u64), WarpError> {
        let most = limits.plan_bytes / CutLattice::bytes_for(1);
        let most_quads = usize::try_from(most).unwrap_or(usize::MAX);
        let lattice = CutLattice::new(mask, whole(side), most_quads, cancelled);
        let Some(lattice) = lattice else {
            let actual = if cancelled() {
                return Err(WarpError::Cancelled);
            } else {
                most + 1
            };
            return Err(WarpError::TooLarge {
                what: "grid_vertices",
                limit: most,
                actual,
            });
        };
        let cells = lattice.cells_of(mask);
        let pixels = (0..).zip(lattice.pixels(mask));
        let vertices: Vec<_> = pixels
            .map(|(vertex, pixel)| (cells.vertex(vertex), pixel.unwrap_or(AT_REST)))
            .collect();
        let bytes = CoefficientTable::bytes_for(field, vertices.len());
        at_most("plan_bytes", limits.plan_bytes, bytes)?;
        work::at_most(
            Task::Grid,
            limits.work,
            (vertices.len() as u64).saturating_mul(work::of_vertex(field)),
        )?;
        let cut = Self {
            cells: Arc::new(cells),
            vertices,
        };
        Ok((cut, bytes))
    }

    /// The coefficients of its vertices; `None` when cancelled.
    pub(super) fn table(
        &self,
        field: &RestDeformation,
        cancelled: IsCancelled<'_>,
    ) -> Option<CoefficientTable> {
        CoefficientTable::of_cut_unless(field, &self.vertices, cancelled)
    }

    /// The posed mesh; `None` when cancelled.
    pub(super) fn pose(
        &self,
        table: &CoefficientTable,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Option<(Mesh, PoseQuality)> {
        let (moved, quality) = table.displace_unless(pose, cancelled)?;
        let cut = CutMesh::new(Arc::clone(&self.cells), moved);
        Some((Mesh::cut(cut), quality))
    }

    /// Memory of a posed mesh until it is drawn, bytes.
    pub(super) fn posed_bytes(&self) -> u64 {
        // Displacements and corners of vertices, and the corners of quads.
        32 * self.vertices.len() as u64 + 160 * self.cells.cells().len() as u64
    }
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
    if rest.metric == Metric::Euclidean {
        return Ok(None);
    }
    let method = rest.method.info();
    if method.parameter("alpha").is_none() {
        let method = method.name;
        return Err(WarpError::Rest(DeformError::NoMetric { method }));
    }
    let size = (extent.width() as usize, extent.height() as usize);
    let mask = rest.mask.as_ref().map(|rest| &rest.mask);
    let mask = mask
        .filter(|mask| mask.size() == size)
        .ok_or(WarpError::NoImage)?;
    Ok((!mask.is_everything()).then(|| Arc::clone(mask)))
}

/// A grid whose cells have a whole number of pixels.
pub(super) fn resolve_grid(
    spec: GridSpec,
    mask: &Mask,
    limits: &Limits,
) -> Result<Grid, WarpError> {
    let side = match spec {
        GridSpec::Auto => {
            let mut side = LEAST_CELL;
            while (side * side) as usize * QUADS < mask.inside() {
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
            return Err(WarpError::BadGrid(format!(
                "with the metric `geodesic`, the grid is `auto`, `pixel`, or cells of 1 to \
                    {MAX_SPACING} whole px"
            )));
        }
    };
    let [width, height] = [mask.size().0, mask.size().1].map(|side| side as f64);
    let grid = Grid::with_cell(width, height, f64::from(side));
    at_most("grid_vertices", limits.plan_bytes / 8, grid.len() as u64)?;
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
