//! The deformation f of one set of handles at rest: exact at any position, for any pose. Everything
//! that does not depend on a position is decided once here: degenerate sets, coincidences, the
//! effective family.

use std::sync::Arc;

use super::coincidences::Coincidences;
use super::columns::{Element, HandleElements, Rank, elements, rank};
use super::conflicts::{Conflicts, Member};
use super::falloff::Falloff;
use super::global_affine::GlobalAffine;
use super::groups::{Coincident, CoincidentPolicy, Groups, coincidence_distance};
use super::handles::{Handles, MAX_COORDINATE};
use super::incomplete_beta::IncompleteBeta;
use super::kernel;
use super::lanes::{Coefficients, Vertices};
use super::row::RowInputs;
use super::segment_moments::Workspace;
use super::spline::{Sites, Spline};
use super::{ConflictingHandles, DeformError, Handle, IsCancelled, Method, Pose, Warning};
use crate::geometry::Vec2;

/// Masses outside of this range would overflow or underflow the ratios in f64, px.
const POINT_MASS: std::ops::RangeInclusive<f64> = 1e-9..=1e9;
/// Smoothing of a spline.
const SMOOTHING_RANGE: std::ops::RangeInclusive<f64> = 0.0..=1e9;

/// Handles at rest with the parameters of their method: everything that f depends on except the
/// pose.
#[derive(Clone, Debug)]
pub struct RestDeformation {
    /// Coincident points are one handle.
    pub(super) handles: Handles,
    /// The client's handles, if some of their points coincide.
    pub(super) grouped: Option<Box<(Handles, Groups)>>,
    policy: CoincidentPolicy,
    pub(super) model: Model,
    /// The family whose rows are used: affine on a line falls back to similarity; the rows of a
    /// spline are real, on a line complex.
    pub(super) family: Method,
    pub(super) rank: Rank,
    pub(super) elements: Vec<Element>,
    pub(super) sources: HandleElements,
    /// The client's handle of each element; the first one of a group.
    owners: Vec<usize>,
    coincidences: Coincidences,
    warnings: Vec<Warning>,
}

/// How f is computed.
#[derive(Clone, Debug)]
pub(super) enum Model {
    /// A map is fitted at every position.
    MovingLeastSquares {
        falloff: Falloff,
        point_mass: f64,
        beta: Option<Arc<IncompleteBeta>>,
    },
    /// One map; no spline is needed for handles at one position.
    ThinPlateSpline {
        smoothing: f64,
        spline: Option<Arc<Spline>>,
    },
    /// One affine map; none is needed for handles at one position.
    GlobalAffine {
        point_mass: f64,
        map: Option<Arc<GlobalAffine>>,
    },
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

/// The family that handles of this rank determine, and the warnings.
fn determined(method: Method, rank: Rank) -> (Method, Vec<Warning>) {
    match (method, rank) {
        (Method::Affine, Rank::Collinear) => (
            Method::Similarity,
            vec![Warning::AffineDegenerateUsedSimilarity],
        ),
        (_, Rank::OnePlace) => (method, vec![Warning::TranslationOnly]),
        _ => (method, vec![]),
    }
}

impl RestDeformation {
    /// `point_mass`: the length whose pull equals a point's from afar, px; matters only where
    /// points and lines are mixed.
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
        Self::new_unless(
            handles,
            Coincident::default(),
            method,
            falloff,
            point_mass,
            &|| false,
        )
    }

    /// Like [`RestDeformation::new`]; stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Those of [`RestDeformation::new`]; cancelled.
    pub fn new_unless(
        handles: Handles,
        coincident: Coincident,
        method: Method,
        falloff: Falloff,
        point_mass: f64,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, DeformError> {
        if !POINT_MASS.contains(&point_mass) {
            return Err(DeformError::BadPointMass { value: point_mass });
        }
        let Grouped {
            handles,
            grouped,
            elements,
            owners,
            coincidences,
        } = Grouped::new(handles, coincident, point_mass, cancelled)?;
        let policy = coincident.policy;
        let rank = rank(&handles);
        let (family, mut warnings) = determined(method, rank);
        if handles.has_lines() && falloff.alpha() < 1.0 {
            warnings.push(Warning::LineAlphaBelowOne);
        }
        let beta = if handles.has_lines() {
            IncompleteBeta::new(falloff.alpha()).map(Arc::new)
        } else {
            None
        };
        let (model, sources) = (
            Model::MovingLeastSquares {
                falloff,
                point_mass,
                beta,
            },
            HandleElements::of(&elements),
        );
        Ok(Self {
            handles,
            grouped,
            policy,
            model,
            family,
            rank,
            sources,
            elements,
            owners,
            coincidences,
            warnings,
        })
    }

    /// The thin-plate spline of points. `smoothing`: 0 goes through the posed handles; more bends
    /// less, towards the affine map that fits them best. A weight divides the smoothing of its
    /// handle.
    ///
    /// # Errors
    /// Lines, a smoothing out of range, too many coincidences of handles.
    pub fn spline(handles: Handles, smoothing: f64) -> Result<Self, DeformError> {
        Self::spline_unless(handles, Coincident::default(), smoothing, &|| false)
    }

    /// Like [`RestDeformation::spline`], which takes O(points^3); stops when `cancelled` returns
    /// true.
    ///
    /// # Errors
    /// Those of [`RestDeformation::spline`]; cancelled.
    pub fn spline_unless(
        handles: Handles,
        coincident: Coincident,
        smoothing: f64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        Self::spline_of(handles, coincident, smoothing, true, cancelled)
    }

    /// The handles and parameters of [`RestDeformation::spline`] without its system, which takes
    /// nearly all of the time: it is described by this, and cannot be evaluated.
    #[cfg(feature = "codec")]
    pub(crate) fn spline_without_system(
        handles: Handles,
        coincident: Coincident,
        smoothing: f64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        Self::spline_of(handles, coincident, smoothing, false, cancelled)
    }

    fn spline_of(
        handles: Handles,
        coincident: Coincident,
        smoothing: f64,
        is_solved: bool,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        if let Some(handle) = handles
            .handles()
            .iter()
            .position(|handle| matches!(handle, Handle::Polyline(_)))
        {
            return Err(DeformError::LineInSpline { handle });
        }
        if !SMOOTHING_RANGE.contains(&smoothing) {
            return Err(DeformError::BadSmoothing { value: smoothing });
        }
        let Grouped {
            handles,
            grouped,
            elements,
            owners,
            coincidences,
        } = Grouped::new(handles, coincident, 1.0, cancelled)?;
        let (policy, sources) = (coincident.policy, HandleElements::of(&elements));
        let sites = Sites::of(&sources.points, coincidence_distance(handles.extent()));
        let rank = rank(&Handles::new(
            sites.positions.iter().copied().map(Handle::Point).collect(),
            None,
        )?);
        let (family, warnings) = match rank {
            Rank::Empty | Rank::Full => (Method::Affine, vec![]),
            Rank::OnePlace => (Method::Affine, vec![Warning::TranslationOnly]),
            Rank::Collinear => (
                Method::Similarity,
                vec![Warning::TpsDegenerateUsedSimilarity],
            ),
        };
        let spline = match rank {
            _ if !is_solved => None,
            Rank::Empty | Rank::OnePlace => None,
            Rank::Collinear | Rank::Full => {
                let spline = Spline::new(sites, rank == Rank::Collinear, smoothing, cancelled);
                Some(Arc::new(spline.ok_or(DeformError::Cancelled)?))
            }
        };
        let model = Model::ThinPlateSpline { smoothing, spline };
        Ok(Self {
            handles,
            grouped,
            policy,
            model,
            family,
            rank,
            sources,
            elements,
            owners,
            coincidences,
            warnings,
        })
    }

    /// One affine map, of least squares over all handles; `point_mass` as in
    /// [`RestDeformation::new`].
    ///
    /// # Errors
    /// Those of [`RestDeformation::new_unless`].
    pub fn global_affine_unless(
        handles: Handles,
        coincident: Coincident,
        point_mass: f64,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, DeformError> {
        if !POINT_MASS.contains(&point_mass) {
            return Err(DeformError::BadPointMass { value: point_mass });
        }
        let Grouped {
            handles,
            grouped,
            elements,
            owners,
            coincidences,
        } = Grouped::new(handles, coincident, point_mass, cancelled)?;
        let (policy, sources, rank) = (
            coincident.policy,
            HandleElements::of(&elements),
            rank(&handles),
        );
        let (family, warnings) = determined(Method::Affine, rank);
        let map = match rank {
            Rank::Empty | Rank::OnePlace => None,
            Rank::Collinear | Rank::Full => Some(Arc::new(GlobalAffine::new(
                &sources,
                rank == Rank::Collinear,
            ))),
        };
        let model = Model::GlobalAffine { point_mass, map };
        Ok(Self {
            handles,
            grouped,
            policy,
            model,
            family,
            rank,
            sources,
            elements,
            owners,
            coincidences,
            warnings,
        })
    }

    /// Bytes that [`RestDeformation::spline`] of this number of points takes; known before anything
    /// is allocated.
    #[must_use]
    pub const fn spline_bytes(points: u64) -> u64 {
        Spline::bytes(points)
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

    /// The fall-off of moving least squares.
    #[must_use]
    pub const fn falloff(&self) -> Option<Falloff> {
        match self.model {
            Model::MovingLeastSquares { falloff, .. } => Some(falloff),
            Model::ThinPlateSpline { .. } | Model::GlobalAffine { .. } => None,
        }
    }

    /// The mass of a point, px; none of a spline.
    #[must_use]
    pub const fn point_mass(&self) -> Option<f64> {
        match self.model {
            Model::MovingLeastSquares { point_mass, .. }
            | Model::GlobalAffine { point_mass, .. } => Some(point_mass),
            Model::ThinPlateSpline { .. } => None,
        }
    }

    /// The smoothing of a spline.
    #[must_use]
    pub const fn smoothing(&self) -> Option<f64> {
        match self.model {
            Model::MovingLeastSquares { .. } | Model::GlobalAffine { .. } => None,
            Model::ThinPlateSpline { smoothing, .. } => Some(smoothing),
        }
    }

    /// The family whose rows are used.
    #[must_use]
    pub const fn family(&self) -> Method {
        self.family
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

    pub(super) fn solved(&self) -> Option<&Spline> {
        match &self.model {
            Model::ThinPlateSpline { spline, .. } => spline.as_deref(),
            Model::MovingLeastSquares { .. } | Model::GlobalAffine { .. } => None,
        }
    }

    /// The rows of N vertices into the workspace. `exact`: quadrature nodes throughout.
    pub(super) fn rows<const N: usize>(
        &self,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        let Workspace { rows, scratch } = workspace;
        match self.rank {
            Rank::Empty => rows.clear(),
            Rank::OnePlace => self.translation(rows),
            Rank::Collinear | Rank::Full => match &self.model {
                Model::MovingLeastSquares {
                    falloff,
                    point_mass,
                    beta,
                } => {
                    let (sources, extent, method) =
                        (&self.sources, self.handles.extent(), self.family);
                    let (falloff, point_mass, beta) = (*falloff, *point_mass, beta.as_deref());
                    kernel::rows(
                        &RowInputs {
                            sources,
                            extent,
                            falloff,
                            beta,
                            point_mass,
                            method,
                            exact,
                        },
                        v,
                        scratch,
                        rows,
                    );
                }
                Model::ThinPlateSpline { spline, .. } => spline
                    .as_ref()
                    .expect("has an extent")
                    .rows(v, &mut scratch.sides, rows),
                Model::GlobalAffine { map, .. } => {
                    map.as_ref().expect("has an extent").rows(v, rows)
                }
            },
        }
    }

    /// All handles at one position: the mass-weighted mean of their displacements, for every
    /// family.
    fn translation<const N: usize>(&self, rows: &mut Coefficients<N>) {
        rows.clear();
        let total: f64 = self.sources.points.iter().map(|mark| mark.mass).sum();
        for mark in &self.sources.points {
            match self.family {
                Method::Affine | Method::Similarity => {
                    rows.h[mark.column][0] = [mark.mass / total; N]
                }
                Method::Rigid => rows.wn[mark.column] = [mark.mass / total; N],
            }
        }
    }
}
