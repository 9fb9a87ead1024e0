//! What a method must be able to do, and may do better than others. A method is one file below
//! `methods`; everybody else asks it through these traits and never which one it is.

use std::fmt;
use std::sync::Arc;

use super::columns::{HandleElements, Rank};
use super::form::{CoefficientForm, MotionLanes};
use super::lanes::{LANES, Vertices};
use super::mesh_solver::MeshSolver;
use super::tiles::TILE_LANES;
use super::workspace::Workspace;
use super::{DeformError, Handles, IsCancelled, Parameters, Warning};
use crate::geometry::{Point, Vec2};
use crate::topology::Mask;

/// Handles at rest as a map sees them, coincident points as one.
#[derive(Clone, Debug)]
pub(super) struct RestSet {
    pub(super) sources: HandleElements,
    pub(super) rank: Rank,
    pub(super) form: CoefficientForm,
    /// Of all handles, px: lengths of the set are measured by it.
    pub(super) extent: f64,
}

/// What a method makes a map from.
pub(super) struct MapInput<'a> {
    pub(super) handles: &'a Handles,
    pub(super) sources: &'a HandleElements,
    /// Effective values of all parameters of the method.
    pub(super) parameters: &'a Parameters,
    /// Whether the map will be evaluated; else it is only described, and needs no system.
    pub(super) is_solved: bool,
    pub(super) cancelled: IsCancelled<'a>,
}

/// The map of a set, and what was decided for all positions.
pub(super) struct BuiltMap {
    pub(super) map: Arc<dyn PointMap>,
    pub(super) rank: Rank,
    pub(super) form: CoefficientForm,
    pub(super) warnings: Vec<Warning>,
}

/// How a method makes its map.
pub(super) type MakeMap = fn(&MapInput<'_>) -> Result<BuiltMap, DeformError>;

/// What a method makes its mesh from.
pub(super) struct MeshInput<'a> {
    pub(super) set: &'a RestSet,
    /// Those that are given; others follow from the mask.
    pub(super) parameters: &'a Parameters,
    pub(super) mask: &'a Arc<Mask>,
    /// The client's handle of a column.
    pub(super) handle_of: &'a dyn Fn(usize) -> usize,
    /// Most operations.
    pub(super) most_operations: u64,
    pub(super) cancelled: IsCancelled<'a>,
}

/// The mesh of a set, ready to be posed.
pub(super) struct BuiltMesh {
    pub(super) map: Arc<dyn PointMap>,
    /// Effective values.
    pub(super) parameters: Parameters,
    pub(super) warnings: Vec<Warning>,
}

/// A method that has a mesh of its own.
#[derive(Debug)]
pub struct MeshMethod {
    /// The side of its cells, px, a whole number.
    pub(crate) cell: fn(&Parameters, &Mask) -> f64,
    /// Memory for the mesh of a mask and this number of positions that are held, bytes; `None` when
    /// cancelled.
    pub(crate) bytes: fn(&Parameters, &Mask, u64, IsCancelled<'_>) -> Option<u64>,
    /// How it makes its mesh.
    pub(super) make: fn(&MeshInput<'_>) -> Result<BuiltMesh, DeformError>,
}

/// What caches and digests know a map by, beside the handles. No two methods may have the same.
#[derive(Clone, Debug, PartialEq)]
pub struct Identity {
    /// In the key of a plan.
    pub plan: u64,
    /// In the digest of handles at rest.
    pub rest: u64,
    /// Parameters, other than the mass of points, on which coefficients depend.
    pub numbers: Vec<f64>,
}

/// The coefficients of N positions. Implemented once for every N.
pub(super) trait CoefficientsOf<const N: usize> {
    /// The coefficients of all terms into `workspace.rows`; only of sets with an extent. `exact`:
    /// as precise as the definition, whatever it takes.
    fn coefficients(
        &self,
        set: &RestSet,
        v: &Vertices<N>,
        exact: bool,
        workspace: &mut Workspace<N>,
    );

    /// The weight of each column at N positions into `workspace.rows.wn`, of maps that have them.
    /// They add up to 1, or are 0 where no handle acts.
    fn weights(&self, _set: &RestSet, _v: &Vertices<N>, _workspace: &mut Workspace<N>) {}
}

/// `f(v) - v` of N positions, px, and the least |m| (rigid), else 1.
pub(super) type Displacements<const N: usize> = ([[f64; N]; 2], f32);

/// f of one pose at N positions without their coefficients, as precisely as these. Implemented once
/// for every N.
pub(super) trait DisplacementsOf<const N: usize> {
    /// `None`: coefficients are more precise.
    fn displacements(&self, _v: &Vertices<N>) -> Option<Displacements<N>> {
        None
    }
}

/// f of one pose, for positions that are used once.
pub(super) trait PosedWithoutCoefficients:
    DisplacementsOf<1> + DisplacementsOf<LANES> + Send + Sync
{
    /// `f(v) - v`, px, and |m| (rigid), else 1, of every position, in the precision of a table and
    /// in parallel. The outer `None`: cancelled; the inner: not faster than block after block.
    fn displaced(
        &self,
        _places: &[Point],
        _cancelled: IsCancelled<'_>,
    ) -> Option<Option<Vec<[f32; 3]>>> {
        Some(None)
    }
}

/// f of one pose at any share of the way of its handles, for positions that are used once.
pub(super) trait PosedOnce: fmt::Debug + Send + Sync {
    /// The motion of every position, a block after the other. Returns the indices of those that are
    /// not precise, and need their rows.
    fn motions(&self, places: &[Point], out: &mut [MotionLanes<TILE_LANES>]) -> Vec<usize>;

    /// Where the whole way takes every position, with the same result.
    fn map(&self, form: CoefficientForm, places: &[Point], out: &mut [Point]) -> Vec<usize>;
}

/// A map whose value is known at any position.
pub(super) trait PointMap: CoefficientsOf<1> + CoefficientsOf<LANES> + Send + Sync {
    /// See [`Identity`].
    fn identity(&self, form: CoefficientForm) -> Identity;

    /// Whether f has neither cusps nor creases, of which vertices nearby say nothing.
    fn is_smooth(&self, set: &RestSet) -> bool;

    /// The map of some of the handles, with the parameters and lengths of this one; for comparing
    /// methods. `None` when cancelled.
    fn of_part(&self, part: &RestSet, cancelled: IsCancelled<'_>) -> Option<Arc<dyn PointMap>>;

    /// Whether columns have weights at a position. If not, f is linear in displacements that all
    /// columns share, or is known on a mesh.
    fn has_weights(&self) -> bool {
        false
    }

    /// The number of vectors that coefficients multiply.
    fn terms(&self, columns: usize) -> usize {
        columns
    }

    /// These vectors, if they are not the displacements of the columns.
    fn terms_of(&self, _displacements: &[Vec2]) -> Option<Vec<Vec2>> {
        None
    }

    /// The column of the first handle whose displacement leaves f undefined.
    fn undefined(&self, _displacements: &[Vec2]) -> Option<usize> {
        None
    }

    /// How the coefficients are laid out for clients that pose by themselves.
    fn layout(&self, form: CoefficientForm) -> u32 {
        form as u32
    }

    /// Its mesh, if it is known on a mesh of its own only.
    fn mesh(&self) -> Option<&dyn MeshSolver> {
        None
    }

    /// The reason why the method has no table of coefficients, not even for clients; `None` if it
    /// has one.
    fn without_table(&self) -> Option<&'static str> {
        None
    }

    /// Whether a pose is read from a table of coefficients. If not, `posed` takes no longer.
    fn has_table(&self, _set: &RestSet) -> bool {
        self.without_table().is_none()
    }

    /// Whether coefficients inside cells are worth keeping.
    fn keeps_coefficients(&self, _set: &RestSet) -> bool {
        true
    }

    /// Operations for weighing a segment at a position. Moving least squares integrate over it:
    /// that takes as long as eight points, whose weights are a power without a logarithm.
    fn segment_operations(&self) -> u64 {
        16
    }

    /// Operations for the coefficients of a position, beyond those of weighing each handle once.
    fn operations(&self, _columns: u64) -> u64 {
        0
    }

    /// f of a pose, where that takes less time than coefficients that are used once. `exact`:
    /// whether only exact displacements will be asked for.
    fn posed<'a>(
        &'a self,
        _set: &'a RestSet,
        _displacements: &'a [Vec2],
        _exact: bool,
    ) -> Option<Box<dyn PosedWithoutCoefficients + 'a>> {
        None
    }

    /// The same at any share of the way of the handles.
    fn posed_once<'a>(
        &'a self,
        _set: &'a RestSet,
        _displacements: &'a [Vec2],
    ) -> Option<Box<dyn PosedOnce + 'a>> {
        None
    }

    /// For each column its displacement less the one that the map of all others predicts, px, if
    /// there is a closed form. The outer `None`: cancelled.
    fn left_out(
        &self,
        _displacements: &[Vec2],
        _cancelled: IsCancelled<'_>,
    ) -> Option<Option<Vec<Vec2>>> {
        Some(None)
    }
}

// `Debug` as a bound of the traits would bring the text of every field of every method into each
// program that draws.
impl fmt::Debug for dyn PointMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PointMap")
    }
}

impl fmt::Debug for dyn PosedWithoutCoefficients + '_ {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PosedWithoutCoefficients")
    }
}
