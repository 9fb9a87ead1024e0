//! As rigid as possible (Igarashi, Moscovich, Hughes 2005; mathematics 10.6): a mesh of what the
//! image shows, whose pieces turn and keep their shape as well as they can. It is factorised once
//! for handles at rest; a pose is two linear solutions.

mod dissection;
mod fronts;
mod held;
mod mesh;
mod moved;
mod part;
#[cfg(test)]
mod tests;
mod turn;

use std::sync::Arc;

use self::held::held_positions;
use self::mesh::{LatticeMesh, MAX_VERTICES};
use self::moved::{MovedPart, bytes_of, moved_parts};
use self::part::{PoseSpace, RigidPart};
use super::{AcceptedHandles, Interpolation, Method, MethodInfo};
use crate::deform::columns::rank;
use crate::deform::form::CoefficientForm;
use crate::deform::lanes::Vertices;
use crate::deform::mesh_solver::MeshSolver;
use crate::deform::point_map::{
    BuiltMap, BuiltMesh, CoefficientsOf, Displacements, DisplacementsOf, Identity, MapInput,
    MeshInput, MeshMethod, PointMap, PosedWithoutCoefficients, RestSet,
};
use crate::deform::workspace::Workspace;
use crate::deform::{DeformError, Handles, IsCancelled, Parameter, Parameters};
use crate::geometry::{CutCells, Point, Vec2};
use crate::topology::{CutLattice, LatticeSize, Mask};

/// In keys of plans and digests of handles at rest.
const IDENTITY: u64 = 64;
/// A mask of this many cells has them of the default size.
const DEFAULT_CELLS: f64 = 3000.0;
/// Default sides lie between these, px.
const DEFAULT_SIDES: (f64, f64) = (4.0, 32.0);
/// Operations for the quad of a position: beside the mask, the nearest pixel of the mask is sought
/// among a thousand.
const QUAD_OPERATIONS: u64 = 400;
const WITHOUT_TABLE: &str =
    "the method `arap` has no table of coefficients: its second step is not linear in `q`";

const CELL: &str = "arap/cell";

static PARAMETERS: [Parameter; 1] = [Parameter {
    path: CELL,
    least: 2.0,
    most: 64.0,
    rule: "be a whole number from 2 to 64 px",
    default: |_| f64::NAN,
    sentence: "Side of the pieces of the mesh, in px; by default about 3000 of them cover the \
        picture.",
}];

/// The row of the table.
pub(super) static INFO: MethodInfo = MethodInfo {
    method: Method::AsRigidAsPossible,
    name: "arap",
    title: "Puppet",
    sentence: "Poses a cut-out like a puppet of rubber: it follows the outline, and its pieces \
        turn and keep their size where they can.",
    handles: AcceptedHandles::All,
    parameters: &PARAMETERS,
    has_object: true,
    interpolation: Interpolation::Always,
    can_unfold: false,
    can_mirror: false,
    can_scale: false,
    candidates: &[],
    candidate_order: 6,
    system: None,
    mesh: Some(MeshMethod {
        cell: |given, mask| f64::from(side(given, mask)),
        bytes: bytes_for,
        make,
    }),
    geodesic: None,
    resolve,
    map,
};

/// The side of a cell that is given stays; the default depends on the mask.
fn resolve(handles: &Handles, given: &Parameters) -> Result<Parameters, DeformError> {
    let Some(value) = given.get(CELL) else {
        return Ok(Parameters::default());
    };
    let resolved = given.resolved(&PARAMETERS, handles)?;
    if value.fract() == 0.0 {
        Ok(resolved)
    } else {
        let rule = PARAMETERS[0].rule;
        Err(DeformError::BadParameter {
            path: CELL,
            value,
            rule,
        })
    }
}

fn side(given: &Parameters, mask: &Mask) -> u32 {
    let default = || {
        let side = (mask.inside() as f64 / DEFAULT_CELLS).sqrt().round();
        side.clamp(DEFAULT_SIDES.0, DEFAULT_SIDES.1)
    };
    let side = given.get(CELL).unwrap_or_else(default);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the range"
    )]
    let side = side.clamp(PARAMETERS[0].least, PARAMETERS[0].most) as u32;
    side
}

fn bytes_for(
    given: &Parameters,
    mask: &Mask,
    held: u64,
    cancelled: IsCancelled<'_>,
) -> Option<u64> {
    let side = side(given, mask);
    let size = CutLattice::size(mask, side, u64::MAX, cancelled)?;
    // More are refused.
    let quads = size.quads.min(MAX_VERTICES as u64);
    let size = LatticeSize {
        quads,
        sets: size.sets.min(quads),
        split: size.split.min(quads),
        ..size
    };
    // A part of k quads has at most 2 k + 2 vertices, most have little more than k.
    let vertices = (2 * quads).min(MAX_VERTICES as u64);
    Some(bytes_of(vertices, held) + size.bytes(side))
}

/// Without a mask there is no mesh: this describes handles only.
fn map(input: &MapInput<'_>) -> Result<BuiltMap, DeformError> {
    if input.is_solved {
        return Err(DeformError::NeedsMask { method: INFO.name });
    }
    Ok(BuiltMap {
        map: Arc::new(AsRigidAsPossible { posable: None }),
        rank: rank(input.handles),
        form: CoefficientForm::Real,
        warnings: vec![],
    })
}

/// The map; without a mesh before the mask is known.
#[derive(Debug)]
struct AsRigidAsPossible {
    posable: Option<PosableMesh>,
}

/// For benchmarks: what orders the vertices of the mesh of a mask, in pieces of `side` px, and
/// factorises the energies of both steps with the positions that are held. `None`: there is no mesh
/// of one part, or a position lies beside it.
#[doc(hidden)]
#[must_use]
pub fn factorisation(mask: &Arc<Mask>, side: u32, held: &[Point]) -> Option<impl Fn() + use<>> {
    let mesh = LatticeMesh::new(mask, side, &|| false).ok()?;
    moved::factorisation(&mesh, held)
}

/// A mesh, and what of it handles move.
#[derive(Debug)]
struct PosableMesh {
    mesh: LatticeMesh,
    parts: Vec<MovedPart>,
}

fn make(input: &MeshInput<'_>) -> Result<BuiltMesh, DeformError> {
    let side = side(input.parameters, input.mask);
    let mesh = LatticeMesh::new(input.mask, side, input.cancelled)?;
    let held = held_positions(input, &mesh, f64::from(side))?;
    let (parts, warnings) = moved_parts(input, &mesh, &held)?;
    Ok(BuiltMesh {
        map: Arc::new(AsRigidAsPossible {
            posable: Some(PosableMesh { mesh, parts }),
        }),
        parameters: input.parameters.with(CELL, f64::from(side)),
        warnings,
    })
}

impl PosableMesh {
    /// The displacements of all vertices of the lattice, px, and the least share of itself that a
    /// triangle keeps in the first step; `None` when cancelled.
    fn displace(&self, d: &[Vec2], cancelled: &dyn Fn() -> bool) -> Option<(Vec<Vec2>, f64)> {
        let of_part =
            |part: &RigidPart, d: &[Vec2], space: &mut PoseSpace| part.pose(d, space, cancelled);
        self.moved(d, of_part, cancelled)
    }

    /// What `of_part` makes of the displacements of what is held in a part.
    fn moved(
        &self,
        d: &[Vec2],
        of_part: impl Fn(&RigidPart, &[Vec2], &mut PoseSpace) -> Option<(Vec<Vec2>, f64)>,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<(Vec<Vec2>, f64)> {
        let mut u = vec![Vec2::ZERO; self.mesh.lattice().vertices().len()];
        let (mut least, mut space) = (1.0_f64, PoseSpace::default());
        for part in &self.parts {
            if cancelled() {
                return None;
            }
            let target = |columns: &Vec<(usize, f64)>| {
                let shares = columns.iter().map(|(column, share)| d[*column] * *share);
                shares.fold(Vec2::ZERO, |sum, d| sum + d)
            };
            let targets: Vec<Vec2> = part.targets.iter().map(target).collect();
            match &part.rigid {
                _ if targets.iter().all(|target| *target == Vec2::ZERO) => {}
                None => part
                    .vertices
                    .iter()
                    .for_each(|v| u[*v as usize] = targets[0]),
                Some(rigid) => {
                    let (moved, share) = of_part(rigid, &targets, &mut space)?;
                    least = least.min(share);
                    for (vertex, moved) in part.vertices.iter().zip(moved) {
                        u[*vertex as usize] = moved;
                    }
                }
            }
        }
        self.mesh.move_dust(&mut u);
        Some((u, least))
    }
}

impl MeshSolver for PosableMesh {
    fn cells(&self) -> &Arc<CutCells> {
        self.mesh.cells()
    }

    fn pose(&self, d: &[Vec2], cancelled: &dyn Fn() -> bool) -> Option<(Vec<[f32; 2]>, f32)> {
        let (u, least) = self.displace(d, cancelled)?;
        #[expect(clippy::cast_possible_truncation, reason = "compared with 0.1")]
        let least = least as f32;
        Some((self.mesh.drawn(&u), least))
    }

    fn carry(&self, d: &[Vec2], cancelled: &dyn Fn() -> bool) -> Option<Vec<[f32; 2]>> {
        let of_part = |part: &RigidPart, d: &[Vec2], space: &mut PoseSpace| {
            Some((part.carry(d, space, cancelled)?, 1.0))
        };
        let (u, _) = self.moved(d, of_part, cancelled)?;
        Some(self.mesh.drawn(&u))
    }
}

impl<const N: usize> CoefficientsOf<N> for AsRigidAsPossible {
    fn coefficients(&self, _: &RestSet, _: &Vertices<N>, _: bool, workspace: &mut Workspace<N>) {
        // Not asked for: positions are posed without coefficients.
        workspace.rows.clear();
    }
}

impl PointMap for AsRigidAsPossible {
    fn identity(&self, _form: CoefficientForm) -> Identity {
        let side = |posable: &PosableMesh| f64::from(posable.mesh.lattice().spacing());
        Identity {
            plan: IDENTITY,
            rest: IDENTITY,
            numbers: self.posable.iter().map(side).collect(),
        }
    }

    fn is_smooth(&self, _set: &RestSet) -> bool {
        false
    }

    fn of_part(&self, _part: &RestSet, _cancelled: IsCancelled<'_>) -> Option<Arc<dyn PointMap>> {
        // It is no candidate: methods are compared in the plane.
        Some(Arc::new(Self { posable: None }))
    }

    fn without_table(&self) -> Option<&'static str> {
        Some(WITHOUT_TABLE)
    }

    fn operations(&self, _columns: u64) -> u64 {
        QUAD_OPERATIONS
    }

    fn posed<'a>(
        &'a self,
        _set: &'a RestSet,
        displacements: &'a [Vec2],
        _exact: bool,
    ) -> Option<Box<dyn PosedWithoutCoefficients + 'a>> {
        let posable = self.posable.as_ref()?;
        let (u, _) = posable.displace(displacements, &|| false)?;
        Some(Box::new(PosedVertices {
            mesh: &posable.mesh,
            u,
        }))
    }

    fn mesh(&self) -> Option<&dyn MeshSolver> {
        self.posable
            .as_ref()
            .map(|posable| posable as &dyn MeshSolver)
    }
}

/// The displaced vertices of one pose.
#[derive(Debug)]
struct PosedVertices<'a> {
    mesh: &'a LatticeMesh,
    u: Vec<Vec2>,
}

impl<const N: usize> DisplacementsOf<N> for PosedVertices<'_> {
    fn displacements(&self, v: &Vertices<N>) -> Option<Displacements<N>> {
        let (mut x, mut y) = ([0.0; N], [0.0; N]);
        for lane in 0..N {
            let at = Point::new(v.x[lane], v.y[lane]);
            let moved = self.mesh.displaced(&self.u, at);
            (x[lane], y[lane]) = (moved.x, moved.y);
        }
        Some(([x, y], 1.0))
    }
}

impl PosedWithoutCoefficients for PosedVertices<'_> {}
