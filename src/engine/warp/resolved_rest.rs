//! Rest handles resolved against a picture's size: pixels, effective alpha and point mass, grid
//! dimensions. All numbers are validated here, except those of q.

use std::sync::Arc;

use super::cut_rest::{self, CutRest};
use super::plausibility;
use super::rest_depth::RestDepth;
use super::rest_parameters::{
    AUTO_CELL, auto_cell, check_parameters, field, plan_key, resolve_grid, to_px, unit,
};
use super::spec::at_most;
use super::{
    CompiledRest, Digest, Folds, GridSpec, Limits, Metric, Quantity, RestMask, RestSpec, Task,
    Units, Warning, WarpError, work,
};
use crate::deform::{
    self, Handle, Handles, IsCancelled, Parameters, Pose, PoseQuality, PosedMap, RestDeformation,
    SubdividedMesh, Subdivider, SubdivisionCache, pose_without_table,
};
use crate::geometry::{Grid, Mesh, Orientation};
use crate::pixmap::Extent;
use crate::topology::Mask;

/// Two f32 and the renderer's corner, or two f32 twice, and most of that again for the vertices
/// that halved cells share.
pub(super) const FINE_BYTES: u64 = 64;
/// The rasteriser's share of a tolerance: at most its own accuracy, px of the source, or half.
const DRAWN_WITHIN: f64 = 1.0 / 16.0;
/// Most vertices inside the cells of a grid: a number for each of its own, and a number in any
/// case.
const FINE_PER_VERTEX: usize = 4;
const FINE_ALWAYS: usize = 1 << 16;
/// Most vertices inside a cell of the size of `grid: auto`.
const FINE_PER_CELL: usize = 17 * 17;
/// Most coefficients for vertices inside cells, unless the grid's own are more: several seconds.
const FINE_COEFFICIENTS: usize = 1 << 28;
/// Memory for exact rows, bytes for each byte of the table, up to a size of the rows that larger
/// tables alone exceed.
const EXACT_PER_BYTE: u64 = 4;
const EXACT_ALWAYS: u64 = 64 << 20;

/// Everything that a warp depends on except the pixels and the pose.
#[derive(Clone, Debug)]
pub struct ResolvedRest {
    field: Arc<RestDeformation>,
    grid: Grid,
    /// Of the client's coordinates.
    units: Units,
    mixed: bool,
    mask: Option<RestMask>,
    /// The quads that are drawn instead of the cells of the grid, if that is cut along the mask.
    pub(super) cut: Option<Arc<CutRest>>,
    /// The warnings of the rest handles.
    pub(super) warnings: Vec<Warning>,
    /// The depths of the handles, if they differ.
    pub(super) depth: Option<Arc<RestDepth>>,
    /// Of the drawn picture, px.
    tolerance: Option<f64>,
    plan_key: Digest,
    table_bytes: Option<u64>,
    /// Whether a pose takes about as long as one with a table that may be kept.
    is_quick: bool,
    /// For exact rows that are kept with the table.
    exact_bytes: u64,
    /// Most operations of a task.
    max_work: u64,
}

impl ResolvedRest {
    /// Resolves and validates. Cheap relative to a plan: O(handles log handles). A spline is
    /// computed here: O(handles^3). Stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Invalid handles, parameters or grid, or too many of them; cancelled.
    ///
    /// ```
    /// use mlswarp::deform::Handle;
    /// use mlswarp::geometry::Point;
    /// use mlswarp::pixmap::Extent;
    /// use mlswarp::warp::{Limits, ResolvedRest, RestSpec};
    /// let p = vec![Handle::Point(Point::new(100.0, 100.0))];
    /// let rest = RestSpec { p, ..RestSpec::default() };
    /// let extent = Extent::new(640, 480).unwrap();
    /// let resolved = ResolvedRest::new(&rest, extent, &Limits::default(), &|| false)?;
    /// // The fall-off that holds for points alone.
    /// assert_eq!(resolved.alpha(), Some(1.0));
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn new(
        rest: &RestSpec,
        extent: Extent,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        Self::resolve(rest, extent, limits, true, cancelled)
    }

    /// `is_solved`: whether the linear system of the method is computed, without which nothing can
    /// be posed.
    pub(super) fn resolve(
        rest: &RestSpec,
        extent: Extent,
        limits: &Limits,
        is_solved: bool,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let columns = rest.p.iter().map(|h| h.columns() as u64).sum();
        at_most(Quantity::HandleColumns, limits.columns as u64, columns)?;
        check_parameters(rest)?;
        rest.check_depth().map_err(WarpError::Rest)?;
        let mask = cut_rest::mask_of(rest, extent)?;
        let (width, height) = (f64::from(extent.width()), f64::from(extent.height()));
        let grid = match &mask {
            Some(mask) => cut_rest::resolve_grid(rest, mask, limits)?,
            None => resolve_grid(rest.grid, width, height, limits)?,
        };
        let p = to_px(&rest.p, unit(rest.units, &grid));
        let handles = Handles::new(p, rest.weights.clone()).map_err(WarpError::Rest)?;
        let mixed = handles.has_points() && handles.has_lines();
        if let Some(system) = rest.method.info().system.as_ref().filter(|_| is_solved) {
            work::at_most(
                Task::System(rest.method),
                limits.work,
                (system.operations)(rest.p.len() as u64),
            )?;
        }
        let field = field(handles, rest, is_solved, cancelled);
        let field = match &mask {
            Some(mask) => field
                .and_then(|field| field.inside(mask, (limits.plan_bytes, limits.work), cancelled)),
            None => field,
        };
        let field = field.map_err(WarpError::of_rest)?;
        let mut warnings = plausibility::of_rest(field.handles(), &grid, rest.units);
        warnings.extend(rest.left_out());
        let mut known = rest.mask.clone();
        if mask.is_none() && rest.metric == Metric::Geodesic {
            known = None;
            warnings.push(Warning::MaskIsEverything);
        }
        let depth = RestDepth::new(&field, rest.depth.as_deref());
        let resolved = Self::on_grid(
            Arc::new(field),
            grid,
            rest.grid,
            (rest.units, mixed, known, warnings),
            limits,
        );
        let resolved = Self { depth, ..resolved };
        match mask {
            Some(mask) => resolved.cut_along(&mask, limits, cancelled),
            None => resolved.check_grid().map(|()| resolved),
        }
    }

    /// The same on the quads of the grid that is cut along a mask. They are not subdivided.
    fn cut_along(
        self,
        mask: &Mask,
        limits: &Limits,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, WarpError> {
        let of_vertex = self.work_of_vertex();
        let (field, side) = ((&*self.field, of_vertex), self.grid.cell().0);
        let (cut, bytes) = CutRest::new(field, mask, side, limits, cancelled)?;
        Ok(Self {
            tolerance: None,
            table_bytes: bytes,
            is_quick: bytes.is_some(),
            exact_bytes: 0,
            cut: Some(Arc::new(cut)),
            ..self
        })
    }

    /// `field` on a resolved grid.
    fn on_grid(
        field: Arc<RestDeformation>,
        grid: Grid,
        spec: GridSpec,
        rest: (Units, bool, Option<RestMask>, Vec<Warning>),
        limits: &Limits,
    ) -> Self {
        let (units, mixed, mask, warnings) = rest;
        let tolerance = spec.tolerance();
        let plan_key = plan_key(&field, &grid, mixed, tolerance.is_some(), mask.as_ref());
        let bytes = deform::CoefficientTable::bytes_for(&field, grid.len());
        // Where a table is not worth its time, sums take about as long as reading it would.
        let is_quick = bytes <= limits.plan_bytes;
        let table_bytes =
            (is_quick && deform::CoefficientTable::is_worthwhile(&field)).then_some(bytes);
        let left = |bytes: u64| {
            (EXACT_PER_BYTE * bytes)
                .min(bytes.max(EXACT_ALWAYS))
                .min(limits.plan_bytes - bytes)
        };
        let rows_pay =
            tolerance.is_some() && deform::CoefficientTable::rows_inside_cells_pay(&field);
        let exact_bytes = table_bytes.filter(|_| rows_pay).map_or(0, left);
        Self {
            field,
            grid,
            units,
            mixed,
            mask,
            cut: None,
            warnings,
            depth: None,
            tolerance,
            plan_key,
            table_bytes,
            is_quick,
            exact_bytes,
            max_work: limits.work,
        }
    }

    /// The same deformation on the grid that the inverse is searched on: that of `grid: auto`,
    /// unless the cells of this grid have such a size.
    ///
    /// # Errors
    /// The grid exceeds a limit.
    pub fn to_invert(&self, limits: &Limits) -> Result<Self, WarpError> {
        if self.is_inverted_itself() {
            return Ok(self.clone());
        }
        let (width, height) = (self.grid.width(), self.grid.height());
        let grid = resolve_grid(GridSpec::Auto, width, height, limits)?;
        let (mask, warnings) = (self.mask.clone(), self.warnings.clone());
        let rest = (self.units, self.mixed, mask, warnings);
        let depth = self.depth.as_ref().map(|depth| depth.to_invert());
        let resolved = Self::on_grid(Arc::clone(&self.field), grid, GridSpec::Auto, rest, limits);
        let resolved = Self { depth, ..resolved };
        resolved.check_grid().map(|()| resolved)
    }

    /// Whether the inverse is searched on this grid. The cells of a cut grid are as small as its
    /// mask asks for.
    fn is_inverted_itself(&self) -> bool {
        let (width, height) = self.grid.cell();
        let is_usual = |side: &f64| (AUTO_CELL.0..=AUTO_CELL.1).contains(side);
        self.cut.is_some() || [width, height].iter().all(is_usual)
    }

    /// About the number of cells of the grid on which the inverse is searched, if that is another
    /// one.
    pub(super) fn cells_to_invert(&self) -> u64 {
        let (width, height) = (self.grid.width(), self.grid.height());
        let other = || Grid::with_cell(width, height, auto_cell(width, height)).len() as u64;
        if self.is_inverted_itself() {
            0
        } else {
            other()
        }
    }

    /// Checks the work of the grid's coefficients, and of its order of drawing. A mesh of the
    /// method itself is checked where it is made.
    ///
    /// Errors: More than the limit.
    pub(super) fn check_grid(&self) -> Result<(), WarpError> {
        if self.field.mesh_cells().is_some() {
            return Ok(());
        }
        let operations = self.posed_vertices().saturating_mul(self.work_of_vertex());
        work::at_most(Task::Grid, self.max_work, operations)
    }

    /// Operations of a vertex before it is posed: its coefficients, and its depth, for which the
    /// handles are weighed once more unless the coefficients have their weights.
    fn work_of_vertex(&self) -> u64 {
        let of_depth = || work::of_position(&self.field);
        work::of_vertex(&self.field) + self.depth.as_ref().map_or(0, |_| of_depth())
    }

    /// Digest of everything that the coefficients depend on: rest handles and weights in px, the
    /// method and its effective parameters, resolved grid, and whether it is subdivided. Two
    /// pictures of one size share one plan.
    #[must_use]
    pub const fn plan_key(&self) -> Digest {
        self.plan_key
    }

    /// Bytes of the table that [`ResolvedRest::plan`] fills, and of the exact rows that it may
    /// keep; `None` if the warp has no table.
    #[must_use]
    pub fn plan_bytes(&self) -> Option<u64> {
        self.table_bytes.map(|bytes| bytes + self.exact_bytes)
    }

    /// Whether a pose takes about as long as one with a table that may be kept.
    #[must_use]
    pub const fn is_quickly_posed(&self) -> bool {
        self.is_quick
    }

    /// Checks the treatment of folds, before anything is posed.
    ///
    /// # Errors
    /// A method or metric whose folds cannot be removed; more work than the limit.
    pub fn check_folds(&self, folds: Folds) -> Result<(), WarpError> {
        match folds {
            Folds::Report | Folds::Reject => Ok(()),
            Folds::Remove => self.check_unfolding(),
        }
    }

    /// Checks the work of posing this number of frames, and of drawing their grids.
    ///
    /// # Errors
    /// More than the limit.
    pub fn check_frames(&self, frames: u64) -> Result<(), WarpError> {
        let of_vertex = if self.table_bytes.is_some() || self.is_tiled() {
            work::of_table(&self.field)
        } else {
            work::of_position(&self.field)
        };
        let vertices = frames.saturating_mul(self.posed_vertices());
        let operations = vertices.saturating_mul(of_vertex);
        work::at_most(Task::Survey, self.max_work, operations)
    }

    /// Checks the work of measuring a posed grid.
    ///
    /// # Errors
    /// More than the limit.
    pub fn check_quality(&self) -> Result<(), WarpError> {
        work::at_most(
            Task::Quality,
            self.max_work,
            self.posed_vertices().saturating_mul(work::CELL_OPERATIONS),
        )
    }

    /// Vertices that are posed: of a cut grid those of its quads, not of its cells.
    pub(super) fn posed_vertices(&self) -> u64 {
        let own = || self.grid.len() as u64;
        self.cut.as_ref().map_or_else(own, |cut| cut.vertices())
    }

    pub(super) const fn max_work(&self) -> u64 {
        self.max_work
    }

    /// The tolerance of the drawn picture, px.
    #[must_use]
    pub const fn tolerance(&self) -> Option<f64> {
        self.tolerance
    }

    /// Memory of a posed grid until its picture is drawn, bytes: vertices, and the renderer's data;
    /// without cells that are halved.
    #[must_use]
    pub fn posed_bytes(&self) -> u64 {
        /// Two f64, and about three times as much for the renderer.
        const VERTEX_BYTES: u64 = 64;
        /// Tiles of a pose that is not read from a table: some for a handle, one for a vertex.
        const HANDLE_BYTES: u64 = 8 << 10;
        const TILE_BYTES: u64 = 4 << 10;
        let cut = self.cut.as_ref().map_or(0, |cut| cut.posed_bytes());
        let (vertices, handles) = (self.grid.len() as u64, self.field.terms() as u64);
        let tiles =
            u64::from(self.is_tiled()) * (handles * HANDLE_BYTES).min(vertices * TILE_BYTES);
        vertices * VERTEX_BYTES + cut + tiles
    }

    /// Whether poses are sums, without a table; most of them over tiles.
    fn is_tiled(&self) -> bool {
        self.cut.is_none() && !deform::CoefficientTable::is_worthwhile(&self.field)
    }

    /// Upper bound of the memory that posing takes beside [`ResolvedRest::posed_bytes`], bytes;
    /// [`PosedMesh::extra_bytes`](super::PosedMesh::extra_bytes) is what a pose keeps of it.
    /// `is_coarse`: as [`PosedMesh::coarse`](super::PosedMesh::coarse).
    #[must_use]
    pub fn most_extra_bytes(&self, folds: Folds, is_coarse: bool) -> u64 {
        let halved = if is_coarse {
            0
        } else {
            self.most_halved_bytes()
        };
        if folds == Folds::Remove {
            return halved.max(self.unfolding_bytes());
        }
        let _ = folds;
        halved
    }

    /// Of cells that are halved to meet the tolerance.
    fn most_halved_bytes(&self) -> u64 {
        if self.tolerance.is_some() {
            self.fine_vertices() as u64 * FINE_BYTES
        } else {
            0
        }
    }

    /// Most vertices inside cells.
    pub(super) fn fine_vertices(&self) -> usize {
        let all = self.grid.len();
        let affordable = (FINE_COEFFICIENTS / self.field.handles().columns().max(1)).max(all);
        (FINE_PER_VERTEX * all + FINE_ALWAYS)
            .min(FINE_PER_CELL * all)
            .min(affordable)
    }

    /// Whether posing is split over the current rayon pool.
    #[must_use]
    pub fn uses_thread_pool(&self) -> bool {
        self.table_bytes
            .is_none_or(|bytes| !deform::CoefficientTable::is_posed_on_one_thread(bytes))
    }

    /// Fills the table of A_j in parallel on the current rayon pool. CPU work. Stops when
    /// `cancelled` returns true.
    ///
    /// # Errors
    /// Cancelled.
    pub fn plan(&self, cancelled: IsCancelled<'_>) -> Result<CompiledRest, WarpError> {
        let fill = |_| {
            let table = match &self.cut {
                Some(cut) => cut.table(&self.field, cancelled),
                None => deform::CoefficientTable::of_grid(&self.field, &self.grid, cancelled),
            };
            table.ok_or(WarpError::Cancelled)
        };
        let table = self.table_bytes.map(fill).transpose()?;
        Ok(CompiledRest {
            table,
            exact: SubdivisionCache::new(self.exact_bytes),
            exact_bytes: self.exact_bytes,
        })
    }

    /// Validates posed handles against the rest handles.
    ///
    /// # Errors
    /// Shapes, numbers, conflicting targets.
    pub fn pose(&self, q: &[Handle]) -> Result<Pose, WarpError> {
        let posed = if self.units == Units::Px {
            self.field.pose(q)
        } else {
            self.field.pose(&to_px(q, self.unit()))
        };
        posed.map_err(WarpError::Posed)
    }

    /// The handles of each group of coincident points, ascending.
    #[must_use]
    pub fn groups(&self) -> Vec<Vec<usize>> {
        self.field.groups()
    }

    /// Effective alpha, if the method has one.
    #[must_use]
    pub fn alpha(&self) -> Option<f64> {
        self.field.parameters().get("alpha")
    }

    /// Effective point mass, px; `None` unless points and lines are mixed.
    #[must_use]
    pub fn point_mass(&self) -> Option<f64> {
        let mass = self.field.parameters().get("point_mass");
        mass.filter(|_| self.mixed)
    }

    /// Effective smoothing, if the method has one.
    #[must_use]
    pub fn smoothing(&self) -> Option<f64> {
        self.field.parameters().get("smoothing")
    }

    /// Effective parameters that stand in an object of their method.
    #[must_use]
    pub fn own_parameters(&self) -> Parameters {
        let all = self.field.parameters().iter();
        all.filter(|(path, _)| path.contains('/'))
            .fold(Parameters::default(), |own, (path, value)| {
                own.with(path, value)
            })
    }

    /// The mask of the rest handles.
    #[must_use]
    pub const fn mask(&self) -> Option<&RestMask> {
        self.mask.as_ref()
    }

    /// Columns and rows of vertices of the resolved grid.
    #[must_use]
    pub const fn dimensions(&self) -> (u32, u32) {
        (self.grid.columns(), self.grid.rows())
    }

    /// Distance of neighbouring grid lines, px; the last ones may be nearer.
    #[must_use]
    pub const fn cell(&self) -> (f64, f64) {
        self.grid.cell()
    }

    /// px in one unit of the client's coordinates, per axis.
    pub(super) fn unit(&self) -> (f64, f64) {
        unit(self.units, &self.grid)
    }

    /// The resolved grid.
    #[must_use]
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }

    pub(super) const fn field(&self) -> &Arc<RestDeformation> {
        &self.field
    }

    /// The size of the source.
    ///
    /// # Panics
    /// Never: a grid has the size of a picture.
    #[must_use]
    pub fn source(&self) -> Extent {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the sides of an extent"
        )]
        let [width, height] = [self.grid.width(), self.grid.height()].map(|side| side as u32);
        Extent::new(width, height).expect("a grid has the size of a picture")
    }

    /// The units of handles and positions.
    #[must_use]
    pub const fn units(&self) -> Units {
        self.units
    }

    /// The picture's size, px, and the client's units.
    pub(super) const fn on(&self) -> (f64, f64, Units) {
        (self.grid.width(), self.grid.height(), self.units)
    }

    /// f of a pose, if its grid is not posed by a table.
    pub(super) fn without_table<'a>(
        &'a self,
        plan: &CompiledRest,
        pose: &'a Pose,
    ) -> Option<PosedMap<'a>> {
        (plan.table.is_none() && self.cut.is_none()).then(|| self.field.deformation(pose))
    }

    /// The posed mesh; without a table every vertex is computed again, which may take long. Stops
    /// when `cancelled` returns true.
    pub(super) fn mesh(
        &self,
        plan: &CompiledRest,
        f: Option<&PosedMap<'_>>,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Result<(Mesh, PoseQuality), WarpError> {
        let posed = match (f, &plan.table, &self.cut) {
            (Some(f), ..) => f.mesh(&self.grid, pose, cancelled),
            (None, table, Some(cut)) => cut.pose(&self.field, table.as_ref(), pose, cancelled),
            (None, Some(table), None) => table.pose(&self.grid, pose, cancelled),
            (None, None, None) => pose_without_table(&self.field, &self.grid, pose, cancelled),
        };
        posed.ok_or(WarpError::Cancelled)
    }

    /// The cells of a posed mesh that are drawn as smaller ones to meet the tolerance, if there is
    /// one.
    pub(super) fn subdivide(
        &self,
        plan: &CompiledRest,
        f: Option<&PosedMap<'_>>,
        mesh: &Mesh,
        folded: Option<Orientation>,
        pose: &Pose,
        cancelled: IsCancelled<'_>,
    ) -> Result<Option<SubdividedMesh>, WarpError> {
        let subdivide = |tolerance: f64| {
            let drawn_within = DRAWN_WITHIN.min(tolerance / 2.0);
            let (field, rows, vertices) = (&*self.field, &plan.exact, self.fine_vertices());
            #[expect(clippy::cast_possible_truncation, reason = "at most 1/16")]
            let subdivider = Subdivider {
                field,
                rows,
                f: f.filter(|_| !deform::CoefficientTable::is_worthwhile(field)),
                tolerance: tolerance - drawn_within,
                drawn_within: drawn_within as f32,
                folded,
                vertices,
            };
            subdivider
                .subdivide(mesh, pose, cancelled)
                .ok_or(WarpError::Cancelled)
        };
        self.tolerance.map(subdivide).transpose()
    }
}
