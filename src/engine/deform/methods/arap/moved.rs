//! The parts of a mesh that handles move.

use std::hint::black_box;

use super::held::{Held, MAX_HELD};
use super::mesh::LatticeMesh;
use super::part::{KEPT_ANCHORS, OrderedPart, PartCost, QuadAnchor, RigidPart};
use super::turn::{QuadMesh, QuadShape};
use crate::deform::point_map::MeshInput;
use crate::deform::{DeformError, MeshQuantity, Warning};
use crate::geometry::{Point, Vec2};
use crate::topology::CutLattice;

/// Multiplications of a linear system that an operation takes.
const MULTIPLICATIONS_PER_OPERATION: u64 = 16;

/// A part with a handle.
#[derive(Debug)]
pub(super) struct MovedPart {
    /// Its vertices in the lattice.
    pub(super) vertices: Vec<u32>,
    /// Of each position that is held, the share of each column in its displacement.
    pub(super) targets: Vec<Vec<(usize, f64)>>,
    /// None if one position is held: then all of it moves alike.
    pub(super) rigid: Option<RigidPart>,
}

/// The parts that have something that is held.
pub(super) fn moved_parts(
    input: &MeshInput<'_>,
    mesh: &LatticeMesh,
    held: &[Held],
) -> Result<(Vec<MovedPart>, Vec<Warning>), DeformError> {
    let lattice = mesh.lattice();
    let part = |held: &Held| lattice.quads()[held.quad].part;
    // Parts share no vertex, so each has its own equations, and one without a handle has none.
    let mut quads_of = vec![Vec::new(); lattice.parts() as usize];
    for (k, quad) in lattice.quads().iter().enumerate() {
        quads_of[quad.part as usize].push(k);
    }
    let mut local = vec![u32::MAX; lattice.vertices().len()];
    let (mut parts, mut warnings, mut cost) = (Vec::new(), Vec::new(), PartCost::default());
    // What is held is in the order of the parts.
    for held in held.chunk_by(|a, b| part(a) == part(b)) {
        let (vertices, part_mesh) =
            mesh_of_part(lattice, &quads_of[part(&held[0]) as usize], &mut local);
        let targets = held.iter().map(|held| held.columns.clone()).collect();
        // One position says nothing about a rotation: the second energy would be singular.
        let rigid = if held.len() < 2 {
            warnings.push(Warning::TranslationOnly);
            None
        } else {
            let anchors = held.iter().map(|held| {
                let anchor = mesh.anchor(held.quad, held.at);
                QuadAnchor {
                    vertices: anchor.vertices.map(|corner| local[corner as usize]),
                    ..anchor
                }
            });
            // The order of elimination says what the factors will take, before any memory is taken
            // for them: a cell that many pieces share makes them far larger than the area does.
            let cancelled = DeformError::Cancelled;
            let ordered = OrderedPart::new(part_mesh, anchors.collect(), input.cancelled);
            let ordered = ordered.ok_or(cancelled.clone())?;
            cost = cost.with(ordered.cost());
            check_cost(
                cost,
                lattice.vertices().len(),
                held.len(),
                input.most_operations,
            )?;
            let rigid = ordered.solve(input.cancelled).ok_or(cancelled)?;
            if rigid.is_soft() {
                warnings.push(Warning::NearDuplicateHandles);
            }
            Some(rigid)
        };
        parts.push(MovedPart {
            vertices,
            targets,
            rigid,
        });
    }
    warnings.sort_unstable();
    warnings.dedup();
    Ok((parts, warnings))
}

/// The vertices of a part in the lattice, and its mesh. `quads`: of the lattice. `local`: of each
/// vertex of the lattice, its number in its part once that is known.
fn mesh_of_part(lattice: &CutLattice, quads: &[usize], local: &mut [u32]) -> (Vec<u32>, QuadMesh) {
    let mut vertices = Vec::new();
    let mut number = |corner: u32| {
        let at = &mut local[corner as usize];
        if *at == u32::MAX {
            *at = u32::try_from(vertices.len()).unwrap_or(u32::MAX);
            vertices.push(corner);
        }
        *at
    };
    let numbered = quads.iter().map(|quad| lattice.quads()[*quad].vertices);
    let quads = numbered.map(|corners| (corners.map(&mut number), 0));
    let quads = quads.collect();
    let side = f64::from(lattice.spacing());
    let corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)];
    let corners = corners.map(|(x, y)| Vec2::new(x, y));
    let position = |vertex: &u32| lattice.vertices()[*vertex as usize];
    let mesh = QuadMesh {
        shapes: vec![QuadShape::new(corners, &QuadShape::ALL)],
        quads,
        positions: vertices.iter().map(position).collect(),
    };
    (vertices, mesh)
}

/// Orders the vertices of a mesh of one part and factorises its energies, as often as it is called.
/// `None`: the mesh has several parts, or something is held beside it.
pub(super) fn factorisation(mesh: &LatticeMesh, held: &[Point]) -> Option<impl Fn() + use<>> {
    let lattice = mesh.lattice();
    if lattice.parts() != 1 {
        return None;
    }
    let quads: Vec<usize> = (0..lattice.quads().len()).collect();
    let mut local = vec![u32::MAX; lattice.vertices().len()];
    let (_, part) = mesh_of_part(lattice, &quads, &mut local);
    let anchor = |at: &Point| {
        let anchor = mesh.anchor(mesh.quad_of(*at, 0.0)?, *at);
        let vertices = anchor.vertices.map(|corner| local[corner as usize]);
        Some(QuadAnchor { vertices, ..anchor })
    };
    let anchors: Vec<QuadAnchor> = held.iter().map(anchor).collect::<Option<_>>()?;
    Some(move || {
        let ordered = OrderedPart::new(part.clone(), anchors.clone(), &|| false);
        black_box(ordered.and_then(|ordered| ordered.factors(&|| false)));
    })
}

/// Errors: More memory than was estimated, which cells of many pieces can take, or too much work.
fn check_cost(
    cost: PartCost,
    vertices: usize,
    held: usize,
    most_operations: u64,
) -> Result<(), DeformError> {
    let operations = cost.multiplications / MULTIPLICATIONS_PER_OPERATION;
    let most_bytes = bytes_of(vertices as u64, held as u64);
    let limits = [
        (MeshQuantity::Bytes, most_bytes, cost.bytes),
        (MeshQuantity::Operations, most_operations, operations),
    ];
    match limits.into_iter().find(|(_, limit, actual)| actual > limit) {
        Some((what, limit, actual)) => Err(DeformError::MeshTooLarge {
            what,
            limit,
            actual,
        }),
        None => Ok(()),
    }
}

/// Memory of a mesh of this many vertices, bytes: its lattice, its dust, two factors, and the
/// response to what is held.
pub(super) fn bytes_of(vertices: u64, held: u64) -> u64 {
    let logarithm = u64::from(vertices.max(2).ilog2()) + 1;
    let held = held.min(MAX_HELD);
    vertices * (128 * logarithm + 24 * held.min(KEPT_ANCHORS as u64) + 592)
        + 96 * held * held
        + (1 << 20)
}
