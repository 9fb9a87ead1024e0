//! The deformation f of one set of handles at rest: exact at any position, for any pose. Everything
//! that does not depend on a position is decided once here: degenerate sets, coincidences, the
//! effective form.

use std::borrow::Cow;
use std::sync::Arc;

use super::coincidences::Coincidences;
use super::columns::{Element, HandleElements, Rank, elements};
use super::conflicts::{Conflicts, Member};
use super::form::CoefficientForm;
use super::groups::{Coincident, CoincidentPolicy, Groups, coincidence_distance};
use super::handles::{Handles, MAX_COORDINATE};
use super::lanes::{Coefficients, Vertices};
use super::methods::mls::geodesic::GeodesicLeastSquares;
use super::point_map::{
    BuiltMap, BuiltMesh, CoefficientsOf, Identity, MapInput, PointMap, PosedOnce, RestSet,
};
use super::workspace::Workspace;
use super::{
    ConflictingHandles, DeformError, Falloff, Handle, IsCancelled, Method, NotTaken, Parameters,
    Pose, Warning,
};
use crate::geometry::Vec2;
use crate::topology::Mask;

/// Handles at rest with the parameters of their method: everything that f depends on except the
/// pose.
#[derive(Clone, Debug)]
pub struct RestDeformation {
    /// Coincident points are one handle.
    pub(super) handles: Handles,
    /// The client's handles, if some of their points coincide.
    pub(super) grouped: Option<Box<(Handles, Groups)>>,
    policy: CoincidentPolicy,
    method: Method,
    /// Effective values.
    parameters: Parameters,
    pub(super) map: Arc<dyn PointMap>,
    /// The form of the coefficients is that which the handles determine: affine on a line falls
    /// back to similarity; the coefficients of a spline are real, on a line complex.
    pub(super) set: RestSet,
    pub(super) elements: Vec<Element>,
    /// The client's handle of each element; the first one of a group.
    owners: Vec<usize>,
    coincidences: Coincidences,
    warnings: Vec<Warning>,
}

/// Handles whose coincident points are one.
struct Grouped {
    handles: Handles,
    grouped: Option<Box<(Handles, Groups)>>,
    elements: Vec<Element>,
    owners: Vec<usize>,
    coincidences: Coincidences,
}

impl Grouped {
    fn new(
        handles: Handles,
        coincident: Coincident,
        point_mass: f64,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, DeformError> {
        let within = coincident.within;
        if !(0.0..=MAX_COORDINATE).contains(&within) {
            return Err(DeformError::BadWithin { value: within });
        }
        let groups = Groups::find(
            &handles,
            within.max(coincidence_distance(handles.extent())),
            cancelled,
        )?;
        let (handles, grouped, handle_of) = match groups {
            Some((groups, merged, handle_of)) => {
                (merged, Some(Box::new((handles, groups))), Some(handle_of))
            }
            None => (handles, None, None),
        };
        let (elements, mut owners) = elements(&handles, point_mass);
        if let Some(handle_of) = handle_of {
            owners
                .iter_mut()
                .for_each(|owner| *owner = handle_of[*owner]);
        }
        let coincidences = Coincidences::find(&elements, handles.extent(), cancelled)?;
        Ok(Self {
            handles,
            grouped,
            elements,
            owners,
            coincidences,
        })
    }
}

impl RestDeformation {
    /// Moving least squares, with a fall-off that fits the handles. `point_mass`: the length whose
    /// pull equals a point's from afar, px; matters only where points and lines are mixed. Nothing
    /// cancels it; [`RestDeformation::of`] takes everything that there is to choose.
    ///
    /// # Errors
    /// A mass or a distance out of range, too many coincidences of handles, or too many lines close
    /// to each other.
    pub fn new(
        handles: Handles,
        method: Method,
        falloff: Falloff,
        point_mass: f64,
    ) -> Result<Self, DeformError> {
        let given = Parameters::default()
            .with("alpha", falloff.alpha())
            .with("point_mass", point_mass);
        Self::of(handles, Coincident::default(), method, &given, &|| false)
    }

    /// The thin-plate spline of points. `smoothing`: 0 goes through the posed handles; more bends
    /// less, towards the affine map that fits them best. A weight divides the smoothing of its
    /// handle. Takes O(points^3), and nothing cancels it; [`RestDeformation::of`] can be cancelled.
    ///
    /// # Errors
    /// Lines, a smoothing out of range, too many coincidences of handles.
    pub fn spline(handles: Handles, smoothing: f64) -> Result<Self, DeformError> {
        let given = Parameters::default().with("smoothing", smoothing);
        let coincident = Coincident::default();
        Self::of(
            handles,
            coincident,
            Method::ThinPlateSpline,
            &given,
            &|| false,
        )
    }

    /// The deformation of a method with its parameters; those that are not given have their
    /// defaults, and those of other methods are not used. Stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Handles that the method does not take, a parameter or a distance out of range, too many
    /// coincidences of handles, too many lines close to each other; cancelled.
    pub fn of(
        handles: Handles,
        coincident: Coincident,
        method: Method,
        given: &Parameters,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        Self::build(handles, coincident, method, given, true, cancelled)
    }

    /// Like [`RestDeformation::of`] without the linear system of the method, which takes nearly all
    /// of the time: it is described by this, and cannot be evaluated.
    ///
    /// # Errors
    /// Those of [`RestDeformation::of`].
    pub(crate) fn without_system(
        handles: Handles,
        coincident: Coincident,
        method: Method,
        given: &Parameters,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        Self::build(handles, coincident, method, given, false, cancelled)
    }

    fn build(
        handles: Handles,
        coincident: Coincident,
        method: Method,
        given: &Parameters,
        is_solved: bool,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        let info = method.info();
        info.check(&handles)?;
        let parameters = info.resolve(&handles, given)?;
        let point_mass = parameters.get("point_mass").unwrap_or(1.0);
        let Grouped {
            handles,
            grouped,
            elements,
            owners,
            coincidences,
        } = Grouped::new(handles, coincident, point_mass, cancelled)?;
        let sources = HandleElements::of(&elements);
        let BuiltMap {
            map,
            rank,
            form,
            warnings,
        } = (info.map)(&MapInput {
            handles: &handles,
            sources: &sources,
            parameters: &parameters,
            is_solved,
            cancelled,
        })?;
        let set = RestSet {
            sources,
            rank,
            form,
            extent: handles.extent(),
        };
        Ok(Self {
            handles,
            grouped,
            policy: coincident.policy,
            method,
            parameters,
            map,
            set,
            elements,
            owners,
            coincidences,
            warnings,
        })
    }

    /// The same deformation inside a mask: handles act along the shortest paths to them. `limits`:
    /// of its distances, in bytes and operations. Work in parallel on the current pool.
    ///
    /// # Errors
    /// A method that is not moving least squares, a handle outside the mask, a mask without a pixel
    /// or of too many parts; cancelled.
    pub fn inside(
        self,
        mask: &Arc<Mask>,
        limits: (u64, u64),
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        let info = self.method.info();
        if let Some(method) = &info.mesh {
            return self.on_mesh(method, mask, limits.1, cancelled);
        }
        let Some(wanted) = info.geodesic else {
            return Err(DeformError::NoMetric { method: info.name });
        };
        let value = |path| self.parameters.get(path).unwrap_or(1.0);
        let falloff = Falloff::new(value("alpha"), self.handles.has_lines())?;
        let weight = (falloff, value("point_mass"));
        // Points come first there.
        let owners = self.elements.iter().zip(&self.owners);
        let (of_points, of_segments): (Vec<_>, Vec<_>) =
            owners.partition(|(element, _)| matches!(element, Element::Point { .. }));
        let owners: Vec<usize> = of_points
            .into_iter()
            .chain(of_segments)
            .map(|(_, owner)| *owner)
            .collect();
        let (map, form, warnings) = GeodesicLeastSquares::new(
            &self.set,
            wanted,
            weight,
            mask,
            &|element| owners[element],
            limits,
            cancelled,
        )?;
        // Each part has its own rank.
        let rank = match self.set.rank {
            Rank::Empty => Rank::Empty,
            _ => Rank::Full,
        };
        let set = RestSet {
            form,
            rank,
            ..self.set
        };
        Ok(Self {
            map: Arc::new(map),
            set,
            warnings,
            ..self
        })
    }

    /// The same handles with the map of a mesh, on which each part has its own rank.
    pub(super) fn with_mesh(self, built: BuiltMesh) -> Self {
        let rank = match self.set.rank {
            Rank::Empty => Rank::Empty,
            Rank::OnePlace | Rank::Collinear | Rank::Full => Rank::Full,
        };
        Self {
            map: built.map,
            parameters: built.parameters,
            set: RestSet { rank, ..self.set },
            warnings: built.warnings,
            ..self
        }
    }

    /// The map of the same method of other handles at rest, as many and of the same forms as
    /// [`RestDeformation::handles`].
    ///
    /// # Errors
    /// Those of [`RestDeformation::of`].
    pub(super) fn at(
        &self,
        handles: Vec<Handle>,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        let places = Handles::new(handles, None)?;
        // Those of groups may be heavier than a client's.
        let weights = self.handles.weights().to_vec();
        let handles = Handles::of_valid(places.handles().to_vec(), weights);
        let (coincident, method) = (Coincident::default(), self.method);
        Self::of(handles, coincident, method, &self.parameters, cancelled)
    }

    /// The client's handle of a column; the first one of a group.
    pub(super) fn owner_of(&self, column: usize) -> usize {
        let is_after = |element: &Element| element.column() <= column;
        let after = self.elements.partition_point(is_after);
        self.owners[after.saturating_sub(1)]
    }

    /// The handles at rest; coincident points are one handle.
    #[must_use]
    pub const fn handles(&self) -> &Handles {
        &self.handles
    }

    /// The client's handles at rest.
    #[must_use]
    pub fn client_handles(&self) -> &Handles {
        self.grouped
            .as_ref()
            .map_or(&self.handles, |grouped| &grouped.0)
    }

    /// The method.
    #[must_use]
    pub const fn method(&self) -> Method {
        self.method
    }

    /// The effective values of the method's parameters.
    #[must_use]
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The form of the coefficients.
    #[must_use]
    pub const fn form(&self) -> CoefficientForm {
        self.set.form
    }

    /// What caches and digests know the map by, beside its handles.
    #[must_use]
    pub fn identity(&self) -> Identity {
        self.map.identity(self.set.form)
    }

    /// How a table of coefficients is laid out for clients that pose by themselves.
    #[must_use]
    pub fn layout(&self) -> u32 {
        self.map.layout(self.set.form)
    }

    /// Operations for weighing a segment at a position.
    #[must_use]
    pub fn segment_operations(&self) -> u64 {
        self.map.segment_operations()
    }

    /// Operations for the coefficients of a position, beyond those of weighing each handle once.
    #[must_use]
    pub fn operations(&self) -> u64 {
        self.map.operations(self.handles.columns() as u64)
    }

    /// The number of vectors that coefficients multiply.
    #[must_use]
    pub fn terms(&self) -> usize {
        self.map.terms(self.handles.columns())
    }

    /// f of displaced columns at positions that are used once, if that takes less than rows.
    pub(super) fn posed_once<'a>(&'a self, d: &'a [Vec2]) -> Option<Box<dyn PosedOnce + 'a>> {
        let has_extent = matches!(self.set.rank, Rank::Collinear | Rank::Full);
        has_extent.then(|| self.map.posed_once(&self.set, d))?
    }

    /// The vectors that coefficients multiply, px.
    pub(super) fn terms_of<'a>(&self, displacements: &'a [Vec2]) -> Cow<'a, [Vec2]> {
        let terms = self.map.terms_of(displacements);
        terms.map_or(Cow::Borrowed(displacements), Cow::Owned)
    }

    /// The client's handles of each group of coincident points, ascending.
    #[must_use]
    pub fn groups(&self) -> Vec<Vec<usize>> {
        self.grouped
            .iter()
            .flat_map(|grouped| grouped.1.handles())
            .collect()
    }

    /// Pairs posed handles with the client's handles at rest. Coincident points move by the
    /// weighted mean of their displacements.
    ///
    /// # Errors
    /// Shapes, numbers; conflicting targets, if the policy is to reject them.
    pub fn pose(&self, posed: &[Handle]) -> Result<Pose, DeformError> {
        let given = Pose::new(self.client_handles(), posed)?;
        if let Some(column) = self.map.undefined(given.displacements()) {
            let is_its = |element: &&Element| element.column() == column;
            let element = self.elements.iter().position(|element| is_its(&element));
            return Err(DeformError::NotTaken {
                handle: self.owners[element.unwrap_or_default()],
                method: self.method.info().name,
                reason: NotTaken::NoDirection,
            });
        }
        let (displacements, conflicts) = match self.grouped.as_deref() {
            Some((_, groups)) => {
                let mean = groups.displacements(given.displacements());
                let conflicts = self.conflicts(&mean, Some((groups, given.displacements())));
                (mean, conflicts)
            }
            None => {
                let conflicts = self.conflicts(given.displacements(), None);
                (given.into_displacements(), conflicts)
            }
        };
        if self.policy == CoincidentPolicy::Reject && conflicts.total > 0 {
            let ConflictingHandles { listed, total, .. } = conflicts;
            return Err(DeformError::Contradictory { listed, total });
        }
        Ok(Pose::of_columns(displacements, conflicts))
    }

    /// `given`: the groups and the displacements of the client's columns.
    fn conflicts(
        &self,
        displacements: &[Vec2],
        given: Option<(&Groups, &[Vec2])>,
    ) -> ConflictingHandles {
        let tolerance = self.coincidences.tolerance();
        let mut found = Conflicts::new(tolerance);
        if let Some((groups, given)) = given {
            groups.add_conflicts(&mut found, &self.handles, given, displacements, tolerance);
        }
        self.coincidences.add_conflicts(
            &mut found,
            &self.elements,
            displacements,
            |element, displacement| {
                let column = self.elements[element].column();
                let members: Option<Vec<Member>> = given
                    .and_then(|(groups, given)| groups.members(column, given))
                    .map(Iterator::collect);
                members.unwrap_or_else(|| {
                    let handle = self.owners[element];
                    let weights = self.client_handles().weights();
                    // Columns of the client's set identify the points of groups; these must differ
                    // from them.
                    vec![Member {
                        element: usize::MAX - element,
                        handle,
                        weight: weights[handle],
                        displacement,
                    }]
                })
            },
        );
        found.finish()
    }

    /// Warnings for this set and pose, in the order of [`Warning`], except undefined rotations,
    /// which only the plan finds.
    #[must_use]
    pub fn warnings(&self, pose: &Pose) -> Vec<Warning> {
        let mut warnings = self.warnings.clone();
        if self
            .coincidences
            .tears(&self.elements, pose.displacements())
        {
            warnings.push(Warning::NearDuplicateHandles);
        }
        if pose.conflicts().total > 0 {
            warnings.push(Warning::CoincidentHandles);
        }
        warnings.sort_unstable();
        warnings
    }

    /// The rows of N vertices into the workspace. `exact`: quadrature nodes throughout.
    pub(super) fn rows<const N: usize>(
        &self,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) where
        dyn PointMap: CoefficientsOf<N>,
    {
        match self.set.rank {
            Rank::Empty => workspace.rows.clear(),
            Rank::OnePlace => self.translation(&mut workspace.rows),
            Rank::Collinear | Rank::Full => {
                let map: &dyn PointMap = &*self.map;
                CoefficientsOf::<N>::coefficients(map, &self.set, v, exact, workspace);
            }
        }
    }

    /// All handles at one position: the mass-weighted mean of their displacements, whatever the
    /// method.
    fn translation<const N: usize>(&self, rows: &mut Coefficients<N>) {
        rows.clear();
        let points = &self.set.sources.points;
        let total: f64 = points.iter().map(|mark| mark.mass).sum();
        for mark in points {
            match self.set.form {
                CoefficientForm::Real | CoefficientForm::Complex => {
                    rows.h[mark.column][0] = [mark.mass / total; N]
                }
                CoefficientForm::Rigid => rows.wn[mark.column] = [mark.mass / total; N],
            }
        }
    }
}
