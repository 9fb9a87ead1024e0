//! A posed grid and its report: everything that follows from the handles alone, before any pixel.

use std::sync::Arc;

use super::digest::Collector;
use super::plausibility::PosedHandles;
use super::resolved_rest::FINE_BYTES;
use super::unfolded::Unfolded;
use super::{
    CompiledRest, Digest, Folds, Region, RemovedFolds, ResolvedRest, Units, Warning, WarpError,
};
#[cfg(feature = "codec")]
use super::{OutputSpec, RasterSource, Target};
use crate::deform::{self, Conflict, IsCancelled, Pose, PosedMap, RestDeformation};
use crate::geometry::{CellTree, Folding, Mesh, Orientation, Point, Vec2};
use crate::render::{Canvas, Outside};

/// Below this |m| the rotation that rigid fits is nearly arbitrary (mathematics section 2.4).
const LEAST_ROTATION: f32 = 0.1;

/// Warnings and figures of a warp, known before its first pixel. A [`Quality`](super::Quality) has
/// the figures that take longer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// In the order of [`Warning`].
    pub warnings: Vec<Warning>,
    /// Drawn cells that fold: their orientation is not that of the whole.
    pub folds: u64,
    /// That of most of the picture.
    pub orientation: Orientation,
    /// Largest distance between a posed handle and its drawn position, px of the source; handles
    /// outside the picture are not drawn, and positions at which handles contradict each other are
    /// left out. With smoothing, f does not take the handles to their targets: then the distance
    /// from where it takes them. Points that are one handle because they lie within a distance of
    /// each other count at their own positions.
    pub residual: f64,
    /// Cells of the grid that are farther than the tolerance from the exact map.
    pub exceeded: u64,
    /// The first groups of handles that coincide at rest and move differently, at most 100.
    pub coincident: Vec<Conflict>,
}

impl Report {
    fn warn(&mut self, warning: Warning) {
        self.warnings.push(warning);
        self.warnings = Warning::in_order(std::mem::take(&mut self.warnings));
    }
}

/// A posed mesh and its report.
#[derive(Clone, Debug)]
pub struct PosedMesh {
    mesh: Mesh,
    report: Report,
    digest: Digest,
    unit: (f64, f64),
    units: Units,
    handles: PosedHandles,
    exceeded: Vec<(u32, u32)>,
    region: Option<Region>,
    /// What the mesh follows from, if its folds were removed.
    unfolded: Option<Arc<Unfolded>>,
    /// Where inverses seek the cells of positions.
    tree: Option<Arc<CellTree>>,
}

impl PosedMesh {
    /// Poses the grid, within its tolerance if it has one. CPU work, microseconds to a millisecond;
    /// longer only if the grid is large, the plan has no table, or cells are subdivided for the
    /// first time. Stops when `cancelled` returns true.
    ///
    /// # Errors
    /// `folds: reject` and the grid folds; cancelled.
    pub fn new(
        setup: &ResolvedRest,
        plan: &CompiledRest,
        pose: &Pose,
        folds: Folds,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let f = setup.without_table(plan, pose);
        let mut posed = Self::of_map(setup, plan, f.as_ref(), pose, folds, cancelled)?;
        if posed.is_unfolded() {
            // The mesh is the map.
            return Ok(posed);
        }
        let folded = (posed.report.folds > 0).then_some(posed.report.orientation);
        if let Some(subdivided) =
            setup.subdivide(plan, f.as_ref(), &posed.mesh, folded, pose, cancelled)?
        {
            posed.mesh = posed.mesh.subdivided(subdivided.subdivision);
            posed.report.residual = residual(setup.field(), pose, &posed.mesh, cancelled)?;
            posed.report.exceeded = subdivided.exceeded.len() as u64;
            posed.exceeded = subdivided.exceeded;
            if !posed.exceeded.is_empty() {
                posed.report.warn(Warning::ToleranceExceeded);
            }
            posed.digest = Collector::new("mlswarp refined pose 1")
                .bytes(&posed.digest.0)
                .float(setup.tolerance().unwrap_or_default())
                .finish();
        }
        Ok(posed)
    }

    /// Like [`PosedMesh::new`], without regard to a tolerance: the grid as it is.
    ///
    /// # Errors
    /// Those of [`PosedMesh::new`].
    pub fn coarse(
        setup: &ResolvedRest,
        plan: &CompiledRest,
        pose: &Pose,
        folds: Folds,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let f = setup.without_table(plan, pose);
        Self::of_map(setup, plan, f.as_ref(), pose, folds, cancelled)
    }

    fn of_map(
        setup: &ResolvedRest,
        plan: &CompiledRest,
        f: Option<&PosedMap<'_>>,
        pose: &Pose,
        folds: Folds,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        setup.check_folds(folds)?;
        let (mesh, quality) = setup.mesh(plan, f, pose, cancelled)?;
        let (mesh, unfolded) = match folds {
            Folds::Remove => match setup.unfold(plan, pose, &mesh, cancelled)? {
                Some((mesh, unfolded)) => (mesh, Some(Arc::new(unfolded))),
                None => (mesh, None),
            },
            Folds::Report | Folds::Reject => (mesh, None),
        };
        let mesh = setup.in_order(mesh, plan, cancelled)?;
        let Folding { orientation, cells } = mesh.folding(cancelled).ok_or(WarpError::Cancelled)?;
        if folds == Folds::Reject && cells > 0 {
            return Err(WarpError::Folded { cells });
        }
        let residual = residual(setup.field(), pose, &mesh, cancelled)?;
        let warnings = setup.warnings_anywhere(pose);
        let coincident = pose.conflicts().listed.clone();
        let mut report = Report {
            warnings,
            folds: cells,
            orientation,
            residual,
            coincident,
            exceeded: 0,
        };
        if quality.least_rotation < LEAST_ROTATION {
            report.warn(Warning::Deform(deform::Warning::RotationUndefined));
        }
        if orientation == Orientation::Mirrored {
            report.warn(Warning::Mirrored);
        }
        if let Some(of) = &unfolded {
            let cells = cells + of.border_crossings();
            if cells > 0 {
                report.warn(Warning::FoldsRemain { cells });
            }
        }
        let (units, handles) = (setup.units(), setup.posed_handles(pose));
        let (mut digest, unit) = (digest(setup, pose), setup.unit());
        if let Some(depth) = setup.depth.as_ref().filter(|_| mesh.order().is_some()) {
            digest = depth.digest(digest);
        }
        if unfolded.is_some() {
            digest = Collector::new("mlswarp unfolded 3")
                .bytes(&digest.0)
                .finish();
        }
        Ok(Self {
            mesh,
            report,
            digest,
            unit,
            units,
            handles,
            exceeded: Vec::new(),
            region: None,
            unfolded,
            tree: None,
        })
    }

    /// The same pose, of which only the content of a region moves. Its mask has the size of the
    /// picture.
    #[must_use]
    pub fn within(self, region: Region) -> Self {
        Self {
            region: Some(region),
            ..self
        }
    }

    /// Checks that pixels which nothing covers can be filled so.
    ///
    /// # Errors
    /// A grid that is cut along a mask has no border to continue beyond.
    pub fn check_outside(&self, outside: Outside) -> Result<(), WarpError> {
        let continues = matches!(outside, Outside::Edge | Outside::Reflect);
        if continues && self.mesh.cut_mesh().is_some() {
            return Err(WarpError::CutBorder);
        }
        Ok(())
    }

    /// The region that moves, if it is not the whole picture.
    #[must_use]
    pub const fn region(&self) -> Option<&Region> {
        self.region.as_ref()
    }

    /// Left, top, right and bottom edge of the smallest box that contains everything that is drawn,
    /// px; with a region, cells that have some of it count as a whole.
    ///
    /// # Errors
    /// Cancelled.
    pub fn bounds(&self, cancelled: IsCancelled<'_>) -> Result<[f64; 4], WarpError> {
        let bounds = match &self.region {
            None => self.mesh.bounds(cancelled),
            Some(region) => region.bounds(&self.mesh, cancelled),
        };
        bounds.ok_or(WarpError::Cancelled)
    }

    /// Whether folds were removed: then what the mesh draws is the map.
    #[must_use]
    pub const fn is_unfolded(&self) -> bool {
        self.unfolded.is_some()
    }

    /// What was done to remove folds, if some were.
    #[must_use]
    pub fn removed_folds(&self) -> Option<RemovedFolds> {
        self.unfolded.as_ref().map(|of| of.removed())
    }

    pub(super) const fn unfolded(&self) -> Option<&Arc<Unfolded>> {
        self.unfolded.as_ref()
    }

    /// Memory for mapping many positions outside of the image, if folds were removed, bytes.
    #[must_use]
    pub fn factor_bytes(&self) -> u64 {
        self.unfolded.as_ref().map_or(0, |of| of.factor_bytes())
    }

    /// Prepares mapping many positions outside of the image, if folds were removed.
    ///
    /// # Errors
    /// Cancelled.
    pub fn keep_factors(&self, cancelled: IsCancelled<'_>) -> Result<(), WarpError> {
        if let Some(unfolded) = &self.unfolded {
            return unfolded.keep_factors(cancelled).ok_or(WarpError::Cancelled);
        }
        Ok(())
    }

    /// Memory of what [`PosedMesh::keep_tree`] prepares, bytes.
    #[must_use]
    pub fn tree_bytes(&self) -> u64 {
        CellTree::bytes_for(&self.mesh)
    }

    /// Prepares several inverses of this pose: without this each makes its own tree of cells.
    ///
    /// # Errors
    /// Cancelled.
    pub fn keep_tree(&mut self, cancelled: IsCancelled<'_>) -> Result<(), WarpError> {
        let tree = CellTree::unless(&self.mesh, cancelled).ok_or(WarpError::Cancelled)?;
        self.tree = Some(Arc::new(tree));
        Ok(())
    }

    pub(super) const fn tree(&self) -> Option<&Arc<CellTree>> {
        self.tree.as_ref()
    }

    /// Memory of the cells that are halved, and of the map if folds were removed, bytes.
    #[must_use]
    pub fn extra_bytes(&self) -> u64 {
        let unfolded = self.unfolded.as_ref().map_or(0, |of| of.bytes());
        (self.mesh.vertices() - self.mesh.grid().len() as u64) * FINE_BYTES + unfolded
    }

    /// The mesh, px.
    #[must_use]
    pub const fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Column and row of the cells of the grid that are farther than the tolerance from the exact
    /// map.
    #[must_use]
    pub fn exceeded_cells(&self) -> &[(u32, u32)] {
        &self.exceeded
    }

    /// The report, without what depends on the canvas.
    #[must_use]
    pub const fn report(&self) -> &Report {
        &self.report
    }

    /// The report of an output that shows `canvas`.
    ///
    /// # Errors
    /// Cancelled.
    pub fn into_report(
        mut self,
        canvas: Option<Canvas>,
        cancelled: IsCancelled<'_>,
    ) -> Result<Report, WarpError> {
        let shows_source = |canvas: Canvas| {
            let ([left, top, right, bottom], grid) = (canvas.edges(), self.mesh.grid());
            self.region.is_some()
                && left < grid.width()
                && right > 0.0
                && top < grid.height()
                && bottom > 0.0
        };
        let is_visible = match canvas {
            Some(canvas) if shows_source(canvas) => true,
            Some(canvas) => self
                .mesh
                .intersects(canvas.edges(), cancelled)
                .ok_or(WarpError::Cancelled)?,
            None => false,
        };
        for warning in self.handles.warnings(self.units, canvas) {
            self.report.warn(warning);
        }
        if !is_visible {
            self.report.warn(Warning::NothingVisible);
        }
        Ok(self.report)
    }

    /// Digest of everything that the mesh depends on.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// The report of a file that shows `source`.
    ///
    /// # Errors
    /// Cancelled.
    #[cfg(feature = "codec")]
    pub fn into_report_on(
        self,
        source: RasterSource<'_>,
        (target, output): (&Target, &OutputSpec),
        cancelled: IsCancelled<'_>,
    ) -> Result<Report, WarpError> {
        let mut report = self.into_report(
            Some(target.canvas.unwrap_or(Canvas::of(source.extent()))),
            cancelled,
        )?;
        report.warnings.extend(source.warnings(target, output));
        Ok(report)
    }

    /// The posed vertices row by row, in the client's units.
    pub fn vertices(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        (0..self.mesh.grid().rows()).flat_map(|row| self.row(row))
    }

    fn row(&self, row: u32) -> impl Iterator<Item = [f64; 2]> + '_ {
        let (ux, uy) = self.unit;
        (0..self.mesh.grid().columns()).map(move |column| {
            let posed = self.mesh.posed(column, row);
            [posed.x / ux, posed.y / uy]
        })
    }

    /// The posed vertices as little-endian f32, x then y.
    ///
    /// # Errors
    /// Cancelled.
    pub fn to_le_bytes(&self, cancelled: IsCancelled<'_>) -> Result<Vec<u8>, WarpError> {
        let mut out = Vec::with_capacity(8 * self.mesh.grid().len());
        for row in 0..self.mesh.grid().rows() {
            if cancelled() {
                return Err(WarpError::Cancelled);
            }
            for vertex in self.row(row) {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "the format of the contract is f32"
                )]
                out.extend(
                    vertex
                        .map(|c| c as f32)
                        .iter()
                        .flat_map(|c| c.to_le_bytes()),
                );
            }
        }
        Ok(out)
    }
}

/// Largest distance between a handle under f and its position in the mesh.
fn residual(
    field: &RestDeformation,
    pose: &Pose,
    mesh: &Mesh,
    cancelled: IsCancelled<'_>,
) -> Result<f64, WarpError> {
    let mut worst = 0.0f64;
    let mut look = |p: Point, displacement: Vec2| {
        if let Some(drawn) = mesh.map(p) {
            worst = worst.max(drawn.distance(p + displacement));
        }
    };
    field
        .for_each_constraint(pose, cancelled, &mut look)
        .ok_or(WarpError::Cancelled)?;
    field
        .look_at_grouped_points(pose, cancelled, &mut look)
        .ok_or(WarpError::Cancelled)?;
    Ok(worst)
}

fn digest(setup: &ResolvedRest, pose: &Pose) -> Digest {
    let mut digest = Collector::new("mlswarp pose 2")
        .bytes(env!("CARGO_PKG_VERSION").as_bytes())
        .bytes(&setup.plan_key().0)
        // Rows without a table are summed in another precision.
        .integer(setup.plan_bytes().is_some().into());
    for d in pose.displacements() {
        digest = digest.float(d.x).float(d.y);
    }
    digest.finish()
}
