//! The thin-plate spline (Bookstein 1989; mathematics 10.1): of all maps through the posed points
//! the one that bends least.

mod spline;
mod system;
mod tiled;

use std::sync::Arc;

use self::spline::{Sites, Spline};
use self::tiled::TiledSpline;
use super::{AcceptedHandles, Interpolation, Method, MethodInfo, MethodSystem};
use crate::deform::columns::{Rank, rank};
use crate::deform::form::CoefficientForm;
use crate::deform::groups::coincidence_distance;
use crate::deform::lanes::Vertices;
use crate::deform::point_map::{
    BuiltMap, CoefficientsOf, Displacements, DisplacementsOf, Identity, MapInput, PointMap,
    PosedWithoutCoefficients, RestSet,
};
use crate::deform::workspace::Workspace;
use crate::deform::{DeformError, Handle, Handles, IsCancelled, Parameter, Warning};
use crate::geometry::{Point, Vec2};
use crate::level::SimdLevel;

/// A spline of more sites has no table: computing one takes about as long as this many frames of a
/// drag without it.
const MOST_SITES: usize = 64;
/// Why a spline has no table, with the number of [`MOST_SITES`].
const WITHOUT_TABLE: &str =
    "a thin-plate spline of more than 64 points is evaluated without a table of coefficients";
/// Most handles of a spline: its system then takes about a second, and 16 MB.
const MOST_HANDLES: u64 = 2000;
/// Multiplications of a linear system that an operation takes.
const MULTIPLICATIONS_PER_OPERATION: u64 = 16;
/// What the spline is known by in keys of plans.
const PLAN_IDENTITY: u64 = 3;

const SMOOTHING: &str = "smoothing";

static PARAMETERS: [Parameter; 1] = [Parameter {
    path: SMOOTHING,
    least: 0.0,
    most: 1e9,
    rule: "lie between 0 and 1e9",
    default: |_| 0.0,
    sentence: "0 passes through the handles; more bends less and passes near them.",
}];

/// The row of the table.
pub(super) static INFO: MethodInfo = MethodInfo {
    method: Method::ThinPlateSpline,
    name: "tps",
    title: "Spline",
    sentence: "Bends the whole picture as little as it can, like a thin plate of metal.",
    handles: AcceptedHandles::Points,
    parameters: &PARAMETERS,
    has_object: false,
    interpolation: Interpolation::IfZero(SMOOTHING),
    can_unfold: true,
    can_mirror: true,
    can_scale: true,
    candidates: &[
        &[(SMOOTHING, 0.0)],
        &[(SMOOTHING, 0.001)],
        &[(SMOOTHING, 0.01)],
        &[(SMOOTHING, 0.1)],
    ],
    candidate_order: 3,
    system: Some(MethodSystem {
        name: "the spline of the handles",
        most_handles: ("spline_handles", MOST_HANDLES),
        bytes: Spline::bytes,
        operations,
        // A factorisation, and a substitution for each point.
        operations_of_comparison: |points| operations(points).saturating_mul(4),
    }),
    mesh: None,
    geodesic: None,
    resolve: |handles, given| given.resolved(&PARAMETERS, handles),
    map,
};

const fn operations(points: u64) -> u64 {
    points.saturating_mul(points).saturating_mul(points) / (6 * MULTIPLICATIONS_PER_OPERATION)
}

fn map(input: &MapInput<'_>) -> Result<BuiltMap, DeformError> {
    let smoothing = input.parameters.get(SMOOTHING).unwrap_or_default();
    let within = coincidence_distance(input.handles.extent());
    let sites = Sites::of(&input.sources.points, within);
    let positions = sites.positions.iter().copied().map(Handle::Point);
    let rank = rank(&Handles::new(positions.collect(), None)?);
    let (form, warnings) = match rank {
        Rank::Empty | Rank::Full => (CoefficientForm::Real, vec![]),
        Rank::OnePlace => (CoefficientForm::Real, vec![Warning::TranslationOnly]),
        Rank::Collinear => (
            CoefficientForm::Complex,
            vec![Warning::TpsDegenerateUsedSimilarity],
        ),
    };
    let spline = match rank {
        Rank::Collinear | Rank::Full if input.is_solved => {
            let spline = Spline::new(sites, rank == Rank::Collinear, smoothing, input.cancelled);
            Some(spline.ok_or(DeformError::Cancelled)?)
        }
        _ => None,
    };
    let map = Arc::new(ThinPlateSpline {
        smoothing,
        within,
        spline,
    });
    Ok(BuiltMap {
        map,
        rank,
        form,
        warnings,
    })
}

/// The spline of a set; none is needed for handles at one position.
#[derive(Debug)]
struct ThinPlateSpline {
    smoothing: f64,
    /// Points nearer than this are one site, px.
    within: f64,
    spline: Option<Spline>,
}

impl<const N: usize> CoefficientsOf<N> for ThinPlateSpline {
    fn coefficients(
        &self,
        _: &RestSet,
        v: &Vertices<N>,
        _exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        let spline = self.spline.as_ref().expect("has an extent");
        spline.rows(v, &mut workspace.scratch.sides, &mut workspace.rows);
    }
}

impl PointMap for ThinPlateSpline {
    fn identity(&self, form: CoefficientForm) -> Identity {
        Identity {
            plan: PLAN_IDENTITY,
            rest: form as u64,
            numbers: vec![self.smoothing],
        }
    }

    fn is_smooth(&self, _set: &RestSet) -> bool {
        true
    }

    fn of_part(&self, part: &RestSet, cancelled: IsCancelled<'_>) -> Option<Arc<dyn PointMap>> {
        let sites = Sites::of(&part.sources.points, self.within);
        let is_line = part.rank == Rank::Collinear;
        let spline = self
            .spline
            .as_ref()
            .map(|whole| whole.of_part(sites, is_line, self.smoothing, cancelled));
        let spline = match spline {
            Some(spline) => Some(spline?),
            None => None,
        };
        Some(Arc::new(Self { spline, ..*self }))
    }

    fn without_table(&self) -> Option<&'static str> {
        let sites = self.spline.as_ref().map_or(0, Spline::len);
        (sites > MOST_SITES).then_some(WITHOUT_TABLE)
    }

    fn operations(&self, columns: u64) -> u64 {
        // The coefficients of a position are a solution of the factorised system: a multiplication
        // for each pair of sites.
        if self.without_table().is_none() {
            columns * columns / MULTIPLICATIONS_PER_OPERATION
        } else {
            0
        }
    }

    fn posed<'a>(
        &'a self,
        _set: &'a RestSet,
        displacements: &'a [Vec2],
        _exact: bool,
    ) -> Option<Box<dyn PosedWithoutCoefficients + 'a>> {
        let spline = self.spline.as_ref()?;
        Some(Box::new(TiledSpline::new(spline.posed(displacements))))
    }

    fn left_out(&self, d: &[Vec2], cancelled: IsCancelled<'_>) -> Option<Option<Vec<Vec2>>> {
        let Some(spline) = &self.spline else {
            return Some(None);
        };
        let of_sites = spline.left_out(d, cancelled)?;
        let mut residuals = vec![Vec2::ZERO; d.len()];
        spline
            .members()
            .for_each(|(column, site)| residuals[column] = of_sites[site]);
        Some(Some(residuals))
    }
}

impl<const N: usize> DisplacementsOf<N> for TiledSpline<'_> {
    fn displacements(&self, v: &Vertices<N>) -> Option<Displacements<N>> {
        Some((self.posed.displaced_lanes(v), 1.0))
    }
}

impl PosedWithoutCoefficients for TiledSpline<'_> {
    fn displaced(
        &self,
        places: &[Point],
        cancelled: IsCancelled<'_>,
    ) -> Option<Option<Vec<[f32; 3]>>> {
        let displaced = self.displaced_at(SimdLevel::detect(), places, cancelled);
        displaced.map(Some)
    }
}
