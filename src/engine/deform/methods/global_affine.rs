//! One affine map for the whole plane: that of least squares over all handles, without a fall-off.
//! It does not interpolate the handles. Handles on a line determine a similarity only. A segment
//! counts with the integral over its length. O(columns) for a position.

use std::sync::Arc;

use super::mls::{POINT_MASS, determined};
use super::{AcceptedHandles, Interpolation, Method, MethodInfo};
use crate::deform::columns::{HandleElements, PointSource, Rank, RestSegment, rank};
use crate::deform::form::CoefficientForm;
use crate::deform::lanes::{Coefficients, Vertices};
use crate::deform::point_map::{BuiltMap, CoefficientsOf, Identity, MapInput, PointMap, RestSet};
use crate::deform::workspace::Workspace;
use crate::deform::{DeformError, IsCancelled, Parameter};
use crate::geometry::{Point, Vec2};

/// In keys of plans.
const PLAN_IDENTITY: u64 = 4;

static PARAMETERS: [Parameter; 1] = [POINT_MASS];

/// The row of the table.
pub(super) static INFO: MethodInfo = MethodInfo {
    method: Method::GlobalAffine,
    name: "global_affine",
    title: "Global",
    sentence: "Moves, turns, stretches and shears the whole picture as one: it passes near the \
        handles, not through them.",
    handles: AcceptedHandles::All,
    parameters: &PARAMETERS,
    has_object: false,
    interpolation: Interpolation::Never,
    can_unfold: false,
    can_mirror: true,
    can_scale: true,
    candidates: &[&[]],
    candidate_order: 4,
    system: None,
    mesh: None,
    geodesic: None,
    resolve: |handles, given| given.resolved(&PARAMETERS, handles),
    map,
};

fn map(input: &MapInput<'_>) -> Result<BuiltMap, DeformError> {
    let rank = rank(input.handles);
    let (form, warnings) = determined(CoefficientForm::Real, rank);
    let map = Arc::new(OneMap(GlobalAffine::of(input.sources, rank)));
    Ok(BuiltMap {
        map,
        rank,
        form,
        warnings,
    })
}

/// The map of a set; none is needed for handles at one position.
#[derive(Debug)]
struct OneMap(Option<GlobalAffine>);

impl<const N: usize> CoefficientsOf<N> for OneMap {
    fn coefficients(
        &self,
        _: &RestSet,
        v: &Vertices<N>,
        _exact: bool,
        workspace: &mut Workspace<N>,
    ) {
        let map = self.0.as_ref().expect("has an extent");
        map.rows(v, &mut workspace.rows);
    }
}

impl PointMap for OneMap {
    fn identity(&self, form: CoefficientForm) -> Identity {
        Identity {
            plan: PLAN_IDENTITY,
            rest: form as u64,
            numbers: vec![],
        }
    }

    fn is_smooth(&self, _set: &RestSet) -> bool {
        true
    }

    fn of_part(&self, part: &RestSet, _cancelled: IsCancelled<'_>) -> Option<Arc<dyn PointMap>> {
        Some(Arc::new(Self(GlobalAffine::of(&part.sources, part.rank))))
    }
}

/// The coefficients of all columns: affine functions of the position.
#[derive(Clone, Debug)]
struct GlobalAffine {
    /// The mean of the handles at rest; the frame's origin.
    centre: Point,
    /// Direction of the frame: the one in which the handles extend farthest.
    tau: Vec2,
    /// Slope of the regression of y on x in the frame.
    slope: f64,
    /// Whether the map is a similarity, because the handles lie on a line.
    is_complex: bool,
    columns: Vec<Column>,
}

/// The coefficient of a column at `e` in the frame: `share + gradient . (e.x, e.y - slope e.x)`,
/// for a similarity `share + e conj(gradient)`.
#[derive(Clone, Copy, Debug)]
struct Column {
    column: usize,
    share: f64,
    gradient: Vec2,
}

/// A column as a mass: its first moment is `mass * at`.
#[derive(Clone, Copy, Debug)]
struct Mass {
    column: usize,
    mass: f64,
    at: Vec2,
}

/// A straight piece of mass from `a` to `b`; a point is one of length 0.
#[derive(Clone, Copy, Debug)]
struct Piece {
    mass: f64,
    a: Vec2,
    b: Vec2,
}

impl Piece {
    /// The integral of the product of two linear functions with these values at a and b.
    fn integral(&self, f: [f64; 2], g: [f64; 2]) -> f64 {
        self.mass * (2.0 * (f[0] * g[0] + f[1] * g[1]) + f[0] * g[1] + f[1] * g[0]) / 6.0
    }
}

impl GlobalAffine {
    fn of(sources: &HandleElements, rank: Rank) -> Option<Self> {
        match rank {
            Rank::Empty | Rank::OnePlace => None,
            Rank::Collinear | Rank::Full => Some(Self::new(sources, rank == Rank::Collinear)),
        }
    }

    /// At least two positions. `line`: all lie on one.
    fn new(sources: &HandleElements, line: bool) -> Self {
        let first = sources
            .points
            .first()
            .map_or_else(|| sources.segments[0].a, |source| source.p);
        let point = |source: &PointSource| Piece {
            mass: source.mass,
            a: source.p - first,
            b: source.p - first,
        };
        let segment = |s: &RestSegment| Piece {
            mass: s.weight * s.length,
            a: s.a - first,
            b: s.b - first,
        };
        let mut pieces: Vec<Piece> = sources
            .points
            .iter()
            .map(point)
            .chain(sources.segments.iter().map(segment))
            .collect();
        let total: f64 = pieces.iter().map(|piece| piece.mass).sum();
        let mean = pieces.iter().fold(Vec2::ZERO, |sum, Piece { mass, a, b }| {
            sum + (*a + *b) * (0.5 * mass / total)
        });
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for piece in &mut pieces {
            (piece.mass, piece.a, piece.b) = (piece.mass / total, piece.a - mean, piece.b - mean);
            let (x, y) = ([piece.a.x, piece.b.x], [piece.a.y, piece.b.y]);
            (xx, xy, yy) = (
                xx + piece.integral(x, x),
                xy + piece.integral(x, y),
                yy + piece.integral(y, y),
            );
        }
        let tau = Vec2::new(xx - yy, 2.0 * xy).half_angle();
        for Piece { a, b, .. } in &mut pieces {
            (*a, *b) = (turned(*a, tau), turned(*b, tau));
        }
        // The tangent first, then what is left across it, so that handles near a line keep their
        // digits.
        let sum = |f: &dyn Fn(Vec2) -> f64, g: &dyn Fn(Vec2) -> f64| -> f64 {
            pieces
                .iter()
                .map(|piece| piece.integral([f(piece.a), f(piece.b)], [g(piece.a), g(piece.b)]))
                .sum()
        };
        let along = sum(&|p| p.x, &|p| p.x);
        let slope = if line {
            0.0
        } else {
            sum(&|p| p.x, &|p| p.y) / along
        };
        let rest = |p: Vec2| p.y - slope * p.x;
        let across = sum(&rest, &rest);
        let spread = along + across;
        let masses = masses(sources, &pieces);
        let columns = masses.map(|Mass { column, mass, at }| {
            let gradient = if line {
                at * (1.0 / spread)
            } else {
                Vec2::new(at.x / along, (at.y - slope * at.x) / across)
            };
            Column {
                column,
                share: mass,
                gradient,
            }
        });
        Self {
            centre: first + mean,
            tau,
            slope,
            is_complex: line,
            columns: columns.collect(),
        }
    }

    /// The coefficients of N vertices.
    fn rows<const N: usize>(&self, v: &Vertices<N>, rows: &mut Coefficients<N>) {
        let (mut ex, mut ey) = ([0.0; N], [0.0; N]);
        for k in 0..N {
            let e = turned(Point::new(v.x[k], v.y[k]) - self.centre, self.tau);
            (ex[k], ey[k]) = (e.x, e.y - self.slope * e.x);
        }
        for Column {
            column,
            share,
            gradient,
        } in &self.columns
        {
            let [re, im] = &mut rows.h[*column];
            for k in 0..N {
                re[k] = share + (ex[k] * gradient.x + ey[k] * gradient.y);
                im[k] = if self.is_complex {
                    ey[k] * gradient.x - ex[k] * gradient.y
                } else {
                    0.0
                };
            }
        }
    }
}

/// The columns of all sources; `pieces` in their order. The first moment of an end is the integral
/// of the position times the end's share.
fn masses<'a>(sources: &'a HandleElements, pieces: &'a [Piece]) -> impl Iterator<Item = Mass> + 'a {
    let (points, segments) = pieces.split_at(sources.points.len());
    let points = sources
        .points
        .iter()
        .zip(points)
        .map(|(source, piece)| Mass {
            column: source.column,
            mass: piece.mass,
            at: piece.a * piece.mass,
        });
    let segments =
        sources
            .segments
            .iter()
            .zip(segments)
            .flat_map(|(segment, Piece { mass, a, b })| {
                let end = |column: usize, near: Vec2, far: Vec2| Mass {
                    column,
                    mass: 0.5 * mass,
                    at: (near * 2.0 + far) * (mass / 6.0),
                };
                [end(segment.column, *a, *b), end(segment.column + 1, *b, *a)]
            });
    points.chain(segments)
}

/// `p conj(tau)`.
fn turned(p: Vec2, tau: Vec2) -> Vec2 {
    Vec2::new(p.dot(tau), tau.cross(p))
}
