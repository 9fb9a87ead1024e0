//! The deformation f of one set of handles at rest: exact at any position, for any pose. Everything that does not depend on a position is
//! decided once here: degenerate sets, coincidences, the effective family.

use std::cell::RefCell;
use std::sync::Arc;

use super::coincidences::Coincidences;
use super::columns::{Element, Rank, Sources, elements, rank};
use super::falloff::Falloff;
use super::family::{displacement, rotation};
use super::handles::{COINCIDENT_SHARE, Handles};
use super::kernel;
use super::lanes::{Rows, Vertices};
use super::row::RowInputs;
use super::span::Scratch;
use super::spline::{PosedSpline, Sites, Spline};
use super::{DeformError, Handle, IsCancelled, Method, Pose, Warning};
use crate::geometry::{Point, Vec2};

/// Masses outside of this range would overflow or underflow the ratios in f64, px.
const POINT_MASS: std::ops::RangeInclusive<f64> = 1e-9..=1e9;
/// Smoothing of a spline.
const SMOOTHING: std::ops::RangeInclusive<f64> = 0.0..=1e9;

/// Handles at rest with the parameters of their method: everything that f depends on except the pose.
#[derive(Clone, Debug)]
pub struct Field {
    handles: Handles,
    model: Model,
    /// The family whose rows are used: affine on a line falls back to similarity; the rows of a spline are real, on a line complex.
    family: Method,
    rank: Rank,
    elements: Vec<Element>,
    sources: Sources,
    owners: Vec<usize>,
    coincidences: Coincidences,
    warnings: Vec<Warning>,
}

/// How f is computed.
#[derive(Clone, Debug)]
enum Model {
    /// A map is fitted at every position.
    MovingLeastSquares { falloff: Falloff, point_mass: f64 },
    /// One map; no spline is needed for handles at one position.
    ThinPlateSpline { smoothing: f64, spline: Option<Arc<Spline>> },
}

/// f of one pose: what does not depend on the position is computed once.
#[derive(Debug)]
pub struct Deformation<'a> {
    field: &'a Field,
    pose: &'a Pose,
    spline: Option<PosedSpline<'a>>,
}

/// Rows and scratch, reused while many positions are mapped, N at once.
#[derive(Debug)]
pub(super) struct Workspace<const N: usize> {
    pub(super) rows: Rows<N>,
    pub(super) scratch: Scratch<N>,
}

impl<const N: usize> Workspace<N> {
    pub(super) fn new(columns: usize) -> Self {
        Self { rows: Rows::zeroed(columns), scratch: Scratch::default() }
    }
}

impl Field {
    /// `point_mass`: the length whose pull equals a point's from afar, px; matters only where points and lines are mixed.
    ///
    /// # Errors
    /// A mass out of range, too many coincidences of handles, or too many lines close to each other.
    pub fn new(handles: Handles, method: Method, falloff: Falloff, point_mass: f64) -> Result<Self, DeformError> {
        Self::new_unless(handles, method, falloff, point_mass, &|| false)
    }

    /// Like [`Field::new`]; stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Those of [`Field::new`]; cancelled.
    pub fn new_unless(
        handles: Handles,
        method: Method,
        falloff: Falloff,
        point_mass: f64,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, DeformError> {
        if !POINT_MASS.contains(&point_mass) {
            return Err(DeformError::BadPointMass { value: point_mass });
        }
        let (elements, owners) = elements(&handles, point_mass);
        let coincidences = Coincidences::find(&elements, handles.extent(), cancelled)?;
        let rank = rank(&handles);
        let mut warnings = Vec::new();
        let family = match (method, rank) {
            (Method::Affine, Rank::Collinear) => {
                warnings.push(Warning::AffineDegenerateUsedSimilarity);
                Method::Similarity
            }
            _ => method,
        };
        if rank == Rank::OnePlace {
            warnings.push(Warning::TranslationOnly);
        }
        if handles.has_lines() && falloff.alpha() < 1.0 {
            warnings.push(Warning::LineAlphaBelowOne);
        }
        let (model, sources) = (Model::MovingLeastSquares { falloff, point_mass }, Sources::of(&elements));
        Ok(Self { handles, model, family, rank, sources, elements, owners, coincidences, warnings })
    }

    /// The thin-plate spline of points. `smoothing`: 0 goes through the posed handles; more bends less, towards the affine map that fits
    /// them best. A weight divides the smoothing of its handle.
    ///
    /// # Errors
    /// Lines, a smoothing out of range, too many coincidences of handles.
    pub fn spline(handles: Handles, smoothing: f64) -> Result<Self, DeformError> {
        Self::spline_unless(handles, smoothing, &|| false)
    }

    /// Like [`Field::spline`], which takes O(points^3); stops when `cancelled` returns true.
    ///
    /// # Errors
    /// Those of [`Field::spline`]; cancelled.
    pub fn spline_unless(handles: Handles, smoothing: f64, cancelled: IsCancelled<'_>) -> Result<Self, DeformError> {
        if let Some(handle) = handles.handles().iter().position(|handle| matches!(handle, Handle::Polyline(_))) {
            return Err(DeformError::LineInSpline { handle });
        }
        if !SMOOTHING.contains(&smoothing) {
            return Err(DeformError::BadSmoothing { value: smoothing });
        }
        let (elements, owners) = elements(&handles, 1.0);
        let coincidences = Coincidences::find(&elements, handles.extent(), cancelled)?;
        let sources = Sources::of(&elements);
        let sites = Sites::of(&sources.points, COINCIDENT_SHARE * handles.extent());
        let rank = rank(&Handles::new(sites.positions.iter().copied().map(Handle::Point).collect(), None)?);
        let (family, warnings) = match rank {
            Rank::Empty | Rank::Full => (Method::Affine, vec![]),
            Rank::OnePlace => (Method::Affine, vec![Warning::TranslationOnly]),
            Rank::Collinear => (Method::Similarity, vec![Warning::TpsDegenerateUsedSimilarity]),
        };
        let spline = match rank {
            Rank::Empty | Rank::OnePlace => None,
            Rank::Collinear | Rank::Full => {
                let spline = Spline::new(sites, rank == Rank::Collinear, smoothing, cancelled);
                Some(Arc::new(spline.ok_or(DeformError::Cancelled)?))
            }
        };
        let model = Model::ThinPlateSpline { smoothing, spline };
        Ok(Self { handles, model, family, rank, sources, elements, owners, coincidences, warnings })
    }

    /// Bytes that [`Field::spline`] of this number of points takes; known before anything is allocated.
    #[must_use]
    pub const fn spline_bytes(points: u64) -> u64 {
        Spline::bytes(points)
    }

    /// The handles at rest.
    #[must_use]
    pub const fn handles(&self) -> &Handles {
        &self.handles
    }

    /// The fall-off; none of a spline.
    #[must_use]
    pub const fn falloff(&self) -> Option<Falloff> {
        match self.model {
            Model::MovingLeastSquares { falloff, .. } => Some(falloff),
            Model::ThinPlateSpline { .. } => None,
        }
    }

    /// The mass of a point, px; none of a spline.
    #[must_use]
    pub const fn point_mass(&self) -> Option<f64> {
        match self.model {
            Model::MovingLeastSquares { point_mass, .. } => Some(point_mass),
            Model::ThinPlateSpline { .. } => None,
        }
    }

    /// The smoothing of a spline.
    #[must_use]
    pub const fn smoothing(&self) -> Option<f64> {
        match self.model {
            Model::MovingLeastSquares { .. } => None,
            Model::ThinPlateSpline { smoothing, .. } => Some(smoothing),
        }
    }

    /// The family whose rows are used.
    #[must_use]
    pub const fn family(&self) -> Method {
        self.family
    }

    /// Pairs posed handles with the rest handles and checks that coincident handles have the same target.
    ///
    /// # Errors
    /// Shapes, numbers, contradictory targets.
    pub fn pose(&self, posed: &[Handle]) -> Result<Pose, DeformError> {
        let pose = Pose::new(&self.handles, posed)?;
        self.coincidences.check(&self.elements, &self.owners, self.handles.weights(), &pose)?;
        Ok(pose)
    }

    /// Warnings for this set and pose, in the order of [`Warning`], except undefined rotations, which only the plan finds.
    #[must_use]
    pub fn warnings(&self, pose: &Pose) -> Vec<Warning> {
        let mut warnings = self.warnings.clone();
        if self.coincidences.tears(&self.elements, pose) {
            warnings.push(Warning::NearDuplicateHandles);
        }
        warnings.sort_unstable();
        warnings
    }

    /// f of a pose, for many positions.
    #[must_use]
    pub fn deformation<'a>(&'a self, pose: &'a Pose) -> Deformation<'a> {
        Deformation { field: self, pose, spline: self.solved().map(|spline| spline.posed(pose.displacements())) }
    }

    /// f at a position; [`Field::deformation`] is for many.
    #[must_use]
    pub fn map(&self, pose: &Pose, place: Point) -> Point {
        self.deformation(pose).map(place)
    }

    /// Where f takes the handles, if not to their targets: the displacements of the columns, px.
    #[must_use]
    pub fn approximated(&self, pose: &Pose) -> Option<Vec<Vec2>> {
        self.solved().filter(|spline| !spline.interpolates())?;
        let f = self.deformation(pose);
        Some(self.sources.points.iter().map(|source| f.map(source.p) - source.p).collect())
    }

    pub(super) fn solved(&self) -> Option<&Spline> {
        match &self.model {
            Model::ThinPlateSpline { spline, .. } => spline.as_deref(),
            Model::MovingLeastSquares { .. } => None,
        }
    }

    /// The rows of N vertices into the workspace. `exact`: quadrature nodes throughout.
    pub(super) fn rows<const N: usize>(&self, v: &Vertices<N>, exact: bool, workspace: &mut Workspace<N>) {
        let Workspace { rows, scratch } = workspace;
        match self.rank {
            Rank::Empty => rows.clear(),
            Rank::OnePlace => self.translation(rows),
            Rank::Collinear | Rank::Full => match &self.model {
                Model::MovingLeastSquares { falloff, .. } => {
                    let (sources, extent, method) = (&self.sources, self.handles.extent(), self.family);
                    kernel::rows(&RowInputs { sources, extent, falloff: *falloff, method, exact }, v, scratch, rows);
                }
                Model::ThinPlateSpline { spline, .. } => spline.as_ref().expect("has an extent").rows(v, &mut scratch.sides, rows),
            },
        }
    }

    /// All handles at one position: the mass-weighted mean of their displacements, for every family.
    fn translation<const N: usize>(&self, rows: &mut Rows<N>) {
        rows.clear();
        let total: f64 = self.sources.points.iter().map(|mark| mark.mass).sum();
        for mark in &self.sources.points {
            match self.family {
                Method::Affine | Method::Similarity => rows.h[mark.column][0] = [mark.mass / total; N],
                Method::Rigid => rows.wn[mark.column] = [mark.mass / total; N],
            }
        }
    }
}

impl Deformation<'_> {
    /// f at a position, in f64 by the quadrature nodes: the definition, not the grid.
    #[must_use]
    pub fn map(&self, place: Point) -> Point {
        thread_local!(static WORKSPACE: RefCell<Workspace<1>> = RefCell::new(Workspace::new(0)));
        WORKSPACE.with_borrow_mut(|workspace| {
            let columns = self.field.handles.columns();
            workspace.rows.h.resize(columns, [[0.0]; 2]);
            workspace.rows.wn.resize(columns, [0.0]);
            let [[x], [y]] = self.displacements(&Vertices::all(place), true, workspace).0;
            place + Vec2::new(x, y)
        })
    }

    /// `f(v) - v` of N vertices, px, and the least |m| (rigid), else 1. `exact`: quadrature nodes throughout.
    pub(super) fn displacements<const N: usize>(&self, v: &Vertices<N>, exact: bool, workspace: &mut Workspace<N>) -> ([[f64; N]; 2], f32) {
        if let Some(spline) = &self.spline {
            return (spline.displacements(v), 1.0);
        }
        self.field.rows(v, exact, workspace);
        let (family, d, rows) = (self.field.family, self.pose.displacements(), &workspace.rows);
        let ([mut x, mut y], mut least) = ([[0.0; N]; 2], f32::INFINITY);
        for (k, (x, y)) in x.iter_mut().zip(&mut y).enumerate() {
            let moved = displacement(family, rows, k, d);
            (*x, *y) = (moved.x, moved.y);
            least = least.min(rotation(family, rows, k, d));
        }
        ([x, y], least)
    }
}
