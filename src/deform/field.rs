//! The deformation f of one set of handles at rest: exact at any place, for any pose. Everything that does not depend on a place is decided
//! once here: degenerate sets, meetings, the effective family.

use std::cell::RefCell;

use super::columns::{Element, Rank, elements, rank};
use super::falloff::Falloff;
use super::family::displacement;
use super::handles::Handles;
use super::meetings::Meetings;
use super::row::{Row, Scratch, Waist};
use super::{DeformError, Handle, Method, Pose, Warning};
use crate::geometry::{Point, Vec2};

/// Masses outside of this range would leave f64's ratios, px.
const POINT_MASS: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

/// Handles at rest with method, fall-off and point mass: all that f depends on beside the pose.
#[derive(Clone, Debug)]
pub struct Field {
    handles: Handles,
    falloff: Falloff,
    point_mass: f64,
    /// The family whose rows are used: affine on a line falls back to similarity.
    family: Method,
    rank: Rank,
    elements: Vec<Element>,
    owners: Vec<usize>,
    meetings: Meetings,
    warnings: Vec<Warning>,
}

/// Rows and scratch that a caller keeps while it maps many places.
#[derive(Debug)]
pub(super) struct Workspace {
    pub(super) row: Row,
    pub(super) scratch: Scratch,
}

impl Workspace {
    pub(super) fn new(columns: usize) -> Self {
        Self { row: Row::zeroed(columns), scratch: Scratch::default() }
    }
}

impl Field {
    /// `point_mass`: the length whose pull a point has from afar, px; matters only where points and lines are mixed.
    ///
    /// # Errors
    /// A mass out of range, or handles that meet at too many places.
    pub fn new(handles: Handles, method: Method, falloff: Falloff, point_mass: f64) -> Result<Self, DeformError> {
        if !POINT_MASS.contains(&point_mass) {
            return Err(DeformError::BadPointMass { value: point_mass });
        }
        let (elements, owners) = elements(&handles, point_mass);
        let meetings = Meetings::find(&elements, handles.extent())?;
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
        Ok(Self { handles, falloff, point_mass, family, rank, elements, owners, meetings, warnings })
    }

    /// The handles at rest.
    #[must_use]
    pub const fn handles(&self) -> &Handles {
        &self.handles
    }

    /// The fall-off.
    #[must_use]
    pub const fn falloff(&self) -> Falloff {
        self.falloff
    }

    /// The mass of a point, px.
    #[must_use]
    pub const fn point_mass(&self) -> f64 {
        self.point_mass
    }

    /// The family whose rows are used.
    #[must_use]
    pub const fn family(&self) -> Method {
        self.family
    }

    /// Pairs posed handles with the rest handles and checks that no place is asked to be in two.
    ///
    /// # Errors
    /// Shapes, numbers, contradictory targets.
    pub fn pose(&self, posed: &[Handle]) -> Result<Pose, DeformError> {
        let pose = Pose::new(&self.handles, posed)?;
        self.meetings.check(&self.elements, &self.owners, &pose)?;
        Ok(pose)
    }

    /// What a client should know of this set and pose, in the order of [`Warning`]; of rotations that are undefined the plan knows.
    #[must_use]
    pub fn warnings(&self, pose: &Pose) -> Vec<Warning> {
        let mut warnings = self.warnings.clone();
        if self.meetings.tears(&self.elements, pose) {
            warnings.push(Warning::NearDuplicateHandles);
        }
        warnings.sort_unstable();
        warnings
    }

    /// f of a place, in f64 by the quadrature nodes: the definition, not the grid.
    #[must_use]
    pub fn map(&self, pose: &Pose, place: Point) -> Point {
        thread_local!(static WORKSPACE: RefCell<Workspace> = RefCell::new(Workspace::new(0)));
        WORKSPACE.with_borrow_mut(|workspace| {
            let columns = self.handles.columns();
            workspace.row.h.resize(columns, Vec2::ZERO);
            workspace.row.wn.resize(columns, 0.0);
            self.row(place, true, workspace);
            place + displacement(self.family, &workspace.row, pose.displacements())
        })
    }

    /// The row of a vertex into the workspace. `exact`: quadrature nodes throughout.
    pub(super) fn row(&self, v: Point, exact: bool, workspace: &mut Workspace) {
        let Workspace { row, scratch } = workspace;
        match self.rank {
            Rank::Empty => row.clear(),
            Rank::OnePlace => self.translation(row),
            Rank::Collinear | Rank::Full => {
                let waist =
                    Waist { elements: &self.elements, extent: self.handles.extent(), falloff: self.falloff, method: self.family, exact };
                waist.row(v, scratch, row);
            }
        }
    }

    /// All handles at one place: the mass-weighted mean of their displacements, for every family.
    fn translation(&self, row: &mut Row) {
        row.clear();
        let masses = self.elements.iter().filter_map(|e| match e {
            Element::Point { mass, column, .. } => Some((*column, *mass)),
            Element::Segment(_) => None,
        });
        let total: f64 = masses.clone().map(|(_, mass)| mass).sum();
        for (column, mass) in masses {
            match self.family {
                Method::Affine | Method::Similarity => row.h[column].x = mass / total,
                Method::Rigid => row.wn[column] = mass / total,
            }
        }
    }
}
