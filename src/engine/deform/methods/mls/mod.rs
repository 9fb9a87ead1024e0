//! Moving least squares (Schaefer, McPhail, Warren 2006): at every position the map of a class that
//! fits the handles best, those nearby most. Three methods, which differ in the class.

pub(in crate::deform) mod falloff;
mod fit;
mod fitted_moments;
pub(in crate::deform) mod geodesic;
pub(in crate::deform) mod incomplete_beta;
pub(in crate::deform) mod metric;
pub(in crate::deform) mod moments;
mod posed_sums;
mod quadrature;
mod quick_moments;
pub(in crate::deform) mod row;
pub(in crate::deform) mod segment_moments;
mod segments;
mod single_sums;

use std::sync::Arc;

use self::falloff::{Falloff, Power};
use self::fitted_moments::{affine_factors, similarity_factors};
use self::incomplete_beta::IncompleteBeta;
use self::metric::Euclidean;
use self::moments::MomentInputs;
use self::posed_sums::PosedSums;
use self::row::RowInputs;
use self::single_sums::SingleSums;
use super::{AcceptedHandles, Interpolation, Method, MethodInfo};
use crate::deform::columns::{PointSource, Rank, rank};
use crate::deform::form::CoefficientForm;
use crate::deform::kernel;
use crate::deform::lanes::Vertices;
use crate::deform::point_map::{
    BuiltMap, CoefficientsOf, DisplacementsOf, Identity, MapInput, PointMap,
    PosedWithoutCoefficients, RestSet,
};
use crate::deform::workspace::Workspace;
use crate::deform::{DeformError, Handles, IsCancelled, Parameter, Parameters, Warning};
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;

/// Sets of more points are posed by moments where rows are used once.
const MANY_POINTS: usize = 128;
/// Sets of at most this many points are posed from a table, which takes less time than their sums.
const FEW_POINTS: usize = 32;
/// The largest alpha at which affine moments are accurate: above it, the weights at most positions
/// differ by more than numbers hold.
const MOST_AFFINE: f64 = 2.0;
/// The least alpha of points and of lines at which f is smooth: below, it has cusps at points or
/// creases along lines (mathematics 2.4, 3.4), of which differences of vertices say nothing.
const SMOOTH_POINTS: f64 = 1.0;
const SMOOTH_LINES: f64 = 1.5;

/// The mass of a point beside lines. Beyond this range the ratios of masses would overflow or
/// underflow in f64.
pub(in crate::deform) const POINT_MASS: Parameter = Parameter {
    path: "point_mass",
    least: 1e-9,
    most: 1e9,
    rule: "lie between 1e-9 and 1e9 px",
    default: |handles| handles.mean_segment_length().unwrap_or(1.0),
    sentence: "The length of line that pulls as much as a point, in px.",
};

static PARAMETERS: [Parameter; 2] = [
    Parameter {
        path: "alpha",
        least: 0.0,
        most: 8.0,
        rule: "be above 0 and at most 8",
        default: |handles| Falloff::default_alpha(handles.has_lines()),
        sentence: "How quickly the influence of a handle falls off with distance.",
    },
    POINT_MASS,
];

/// Four fall-offs.
static CANDIDATES: [&[(&str, f64)]; 4] = [
    &[("alpha", 0.75)],
    &[("alpha", 1.0)],
    &[("alpha", 1.5)],
    &[("alpha", 2.0)],
];

const fn info(method: Method, name: &'static str, title: &'static str) -> MethodInfo {
    MethodInfo {
        method,
        name,
        title,
        sentence: "",
        handles: AcceptedHandles::All,
        parameters: &PARAMETERS,
        has_object: false,
        interpolation: Interpolation::Always,
        can_unfold: true,
        can_mirror: false,
        can_scale: false,
        candidates: &CANDIDATES,
        candidate_order: 0,
        system: None,
        mesh: None,
        geodesic: None,
        resolve,
        map: |_| Err(DeformError::Cancelled),
    }
}

/// Rotations, eq. (8).
pub(super) static RIGID: MethodInfo = MethodInfo {
    sentence: "Rotation and translation only, without scaling, like cardboard.",
    candidate_order: 2,
    geodesic: Some(CoefficientForm::Rigid),
    map: |input| map(input, CoefficientForm::Rigid),
    ..info(Method::Rigid, "rigid", "Rigid")
};

/// Rotations with a uniform scale, eqs. (6), (7).
pub(super) static SIMILARITY: MethodInfo = MethodInfo {
    sentence: "Allows scaling and keeps angles: use it to make something larger or smaller.",
    can_scale: true,
    candidate_order: 1,
    geodesic: Some(CoefficientForm::Complex),
    map: |input| map(input, CoefficientForm::Complex),
    ..info(Method::Similarity, "similarity", "Similarity")
};

/// Affine maps, eq. (5).
pub(super) static AFFINE: MethodInfo = MethodInfo {
    sentence: "Also allows stretching and shear: follows the handles most freely.",
    can_mirror: true,
    can_scale: true,
    geodesic: Some(CoefficientForm::Real),
    map: |input| map(input, CoefficientForm::Real),
    ..info(Method::Affine, "affine", "Affine")
};

fn resolve(handles: &Handles, given: &Parameters) -> Result<Parameters, DeformError> {
    let alpha = given.get("alpha");
    // The range of alpha depends on the handles, and has a code of its own.
    if let Some(alpha) = alpha {
        Falloff::new(alpha, handles.has_lines())?;
    }
    given.resolved(&PARAMETERS, handles)
}

fn map(input: &MapInput<'_>, form: CoefficientForm) -> Result<BuiltMap, DeformError> {
    let (handles, rank) = (input.handles, rank(input.handles));
    let value = |path| input.parameters.get(path).unwrap_or(1.0);
    let (falloff, point_mass) = (
        Falloff::new(value("alpha"), handles.has_lines())?,
        value("point_mass"),
    );
    let (form, mut warnings) = determined(form, rank);
    let mut beta = None;
    if handles.has_lines() {
        if falloff.alpha() < 1.0 {
            warnings.push(Warning::LineAlphaBelowOne);
        }
        beta = IncompleteBeta::new(falloff.alpha()).map(Arc::new);
    }
    let map = Arc::new(MovingLeastSquares {
        falloff,
        point_mass,
        beta,
    });
    Ok(BuiltMap {
        map,
        rank,
        form,
        warnings,
    })
}

/// The form that handles of this rank determine, and the warnings.
pub(super) fn determined(form: CoefficientForm, rank: Rank) -> (CoefficientForm, Vec<Warning>) {
    match (form, rank) {
        (CoefficientForm::Real, Rank::Collinear) => (
            CoefficientForm::Complex,
            vec![Warning::AffineDegenerateUsedSimilarity],
        ),
        (_, Rank::OnePlace) => (form, vec![Warning::TranslationOnly]),
        _ => (form, vec![]),
    }
}

/// What a pose is computed from. The set alone decides, so that every machine draws the same.
#[derive(Clone, Copy, Debug, PartialEq)]
enum PosedFrom {
    /// Coefficients: a table of the grid, and rows inside cells that are kept.
    Coefficients,
    /// [`SingleSums`], without a table: some dozen points of equal mass at alpha 1, similarity or
    /// rigid.
    SingleSums,
    /// [`MomentInputs`]: many points. Above alpha 2 the grid has its table still.
    Moments,
}

/// A map that is fitted at every position.
#[derive(Clone, Debug)]
struct MovingLeastSquares {
    falloff: Falloff,
    point_mass: f64,
    /// The closed form of segments, if alpha has one.
    beta: Option<Arc<IncompleteBeta>>,
}

fn are_of_equal_mass(points: &[PointSource]) -> bool {
    points.windows(2).all(|pair| pair[0].mass == pair[1].mass)
}

impl MovingLeastSquares {
    /// Whether moments are accurate: of points alone.
    fn has_moments(&self, set: &RestSet) -> bool {
        // Affine moments of points on nearly one line are accurate only if none of them is much
        // lighter than the others.
        let is_accurate =
            || self.falloff.alpha() <= MOST_AFFINE && are_of_equal_mass(&set.sources.points);
        (set.form != CoefficientForm::Real || is_accurate())
            && set.sources.segments.is_empty()
            && matches!(set.rank, Rank::Collinear | Rank::Full)
    }

    /// The coefficients of a form.
    fn rows<const N: usize>(
        &self,
        set: &RestSet,
        form: CoefficientForm,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        let Workspace { rows, scratch } = workspace;
        let inputs = RowInputs {
            metric: Euclidean,
            sources: &set.sources,
            extent: set.extent,
            falloff: self.falloff,
            beta: self.beta.as_deref(),
            point_mass: self.point_mass,
            form,
            exact,
        };
        kernel::rows(&inputs, v, scratch, rows);
    }

    /// What is quickest on most machines, first pictures included.
    fn posed_from(&self, set: &RestSet) -> PosedFrom {
        let points = &set.sources.points;
        if points.len() <= FEW_POINTS || !self.has_moments(set) {
            return PosedFrom::Coefficients;
        }
        if points.len() > MANY_POINTS {
            return PosedFrom::Moments;
        }
        let is_single = self.falloff.power() == Power::One
            && set.form != CoefficientForm::Real
            && are_of_equal_mass(points);
        if is_single {
            PosedFrom::SingleSums
        } else {
            PosedFrom::Coefficients
        }
    }
}

impl<const N: usize> CoefficientsOf<N> for MovingLeastSquares {
    fn coefficients(
        &self,
        set: &RestSet,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        self.rows(set, set.form, v, exact, workspace);
    }

    fn weights(&self, set: &RestSet, v: &Vertices<N>, workspace: &mut Workspace<N>) {
        self.rows(set, CoefficientForm::Rigid, v, false, workspace);
    }
}

impl PointMap for MovingLeastSquares {
    fn has_weights(&self) -> bool {
        true
    }

    fn identity(&self, form: CoefficientForm) -> Identity {
        let (plan, rest) = (form as u64, form as u64);
        Identity {
            plan,
            rest,
            numbers: vec![self.falloff.alpha()],
        }
    }

    fn is_smooth(&self, set: &RestSet) -> bool {
        let least = if set.sources.segments.is_empty() {
            SMOOTH_POINTS
        } else {
            SMOOTH_LINES
        };
        self.falloff.alpha() >= least
    }

    fn of_part(&self, _part: &RestSet, _cancelled: IsCancelled<'_>) -> Option<Arc<dyn PointMap>> {
        Some(Arc::new(self.clone()))
    }

    fn has_table(&self, set: &RestSet) -> bool {
        match self.posed_from(set) {
            PosedFrom::Coefficients => true,
            PosedFrom::SingleSums => false,
            PosedFrom::Moments => !MomentInputs::are_tiled(self.falloff),
        }
    }

    fn keeps_coefficients(&self, set: &RestSet) -> bool {
        // Of many points they exceed any memory, and sums take little longer than reading them.
        self.posed_from(set) == PosedFrom::Coefficients
    }

    fn posed<'a>(
        &'a self,
        set: &'a RestSet,
        displacements: &'a [Vec2],
        exact: bool,
    ) -> Option<Box<dyn PosedWithoutCoefficients + 'a>> {
        let (points, falloff) = (&set.sources.points, self.falloff);
        let d = displacements;
        match self.posed_from(set) {
            _ if exact => None,
            PosedFrom::Coefficients => None,
            PosedFrom::SingleSums => Some(Box::new(SingleSums::new(points, d, falloff, set.form))),
            PosedFrom::Moments => {
                let are_tiled = MomentInputs::are_tiled(falloff);
                let inputs = MomentInputs::new(points, d, falloff, set.form, are_tiled);
                Some(Box::new(inputs))
            }
        }
    }

    fn posed_once<'a>(
        &'a self,
        set: &'a RestSet,
        displacements: &'a [Vec2],
    ) -> Option<Box<dyn crate::deform::point_map::PosedOnce + 'a>> {
        let weight = (self.falloff, self.beta.as_deref());
        let (sources, d) = (&set.sources, displacements);
        Some(match set.form {
            CoefficientForm::Real => Box::new(PosedSums::new(sources, d, weight, affine_factors)),
            CoefficientForm::Complex | CoefficientForm::Rigid => {
                Box::new(PosedSums::new(sources, d, weight, similarity_factors))
            }
        })
    }
}

impl<const N: usize> DisplacementsOf<N> for MomentInputs<'_> {}

impl<const N: usize> DisplacementsOf<N> for SingleSums<'_> {}

impl PosedWithoutCoefficients for SingleSums<'_> {
    fn displaced(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Option<Vec<[f32; 3]>>> {
        let displaced = self.displaced_at(SimdLevel::detect(), places, cancelled);
        displaced.map(Some)
    }
}

impl PosedWithoutCoefficients for MomentInputs<'_> {
    fn displaced(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Option<Vec<[f32; 3]>>> {
        let displaced = self.displaced_at(SimdLevel::detect(), places, cancelled);
        displaced.map(Some)
    }
}
