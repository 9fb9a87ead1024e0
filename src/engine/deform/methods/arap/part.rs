//! A part of a mesh, posed as rigidly as possible (Igarashi, Moscovich, Hughes 2005; mathematics
//! 10.6): first every triangle as similar as possible to itself at rest, then as congruent as
//! possible to itself turned as in the first step. All in displacements, so that the identity is
//! exact.

use super::dissection::Dissection;
use super::fronts::{Factor, MatrixEntry, SolveSpace, eliminate};
use super::turn::{QuadMesh, Turned};
use crate::deform::kernel::{LaneWork, run_at};
use crate::geometry::Vec2;
use crate::level::SimdLevel;

/// How forces on more anchors than these move the vertices is solved for in each pose, instead of
/// kept.
pub(super) const KEPT_ANCHORS: usize = 32;
/// Anchors that determine each other to this share of the mean are held less strictly, by this
/// share of it.
const DEPENDENT_SHARE: f64 = 1e-9;
const SOFT_SHARE: f64 = 1e-8;

/// A position of the mesh that is held: the weights of the corners of its quad.
#[derive(Clone, Copy, Debug)]
pub(super) struct QuadAnchor {
    pub(super) vertices: [u32; 4],
    pub(super) weights: [f64; 4],
}

impl QuadAnchor {
    /// The displacement of the position.
    pub(super) fn displaced(&self, u: &[Vec2]) -> Vec2 {
        let mut sum = Vec2::ZERO;
        for (vertex, weight) in self.vertices.iter().zip(self.weights) {
            sum += u[*vertex as usize] * weight;
        }
        sum
    }

    fn spread(&self, force: Vec2, to: &mut [Vec2]) {
        for (vertex, weight) in self.vertices.iter().zip(self.weights) {
            to[*vertex as usize] += force * weight;
        }
    }
}

/// A quadratic energy of the vertices, with anchors that are held.
#[derive(Debug)]
struct HeldEnergy<E> {
    factor: Factor<E>,
    /// How far a force on one anchor moves each: factor, and its diagonal.
    compliance: (Vec<E>, Vec<f64>),
    /// How far a force on each anchor moves each vertex; none if there are many anchors.
    response: Option<Vec<E>>,
    /// What targets are multiplied by because the anchors are not held strictly.
    stretch: f64,
    is_soft: bool,
}

impl<E: MatrixEntry> HeldEnergy<E> {
    /// `None` when cancelled.
    fn new(
        (factor, weight): (Factor<E>, f64),
        (order, anchors): (&Dissection, &[QuadAnchor]),
        vertices: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let count = anchors.len();
        let mut held = Self {
            factor,
            compliance: (Vec::new(), vec![0.0; count]),
            response: (count <= KEPT_ANCHORS).then(Vec::new),
            stretch: 1.0,
            is_soft: false,
        };
        let mut square = Vec::with_capacity(count * count);
        let (mut column, mut space) = (vec![E::default(); vertices], SolveSpace::<E>::default());
        for anchor in anchors {
            if cancelled() {
                return None;
            }
            column.fill(E::default());
            for (vertex, of) in anchor.vertices.iter().zip(anchor.weights) {
                let at = &mut column[*vertex as usize];
                *at += E::ONE * of;
            }
            held.factor
                .solve(order, &mut column, &mut space, cancelled)?;
            square.extend(anchors.iter().map(|other| {
                let corners = other.vertices.iter().zip(other.weights);
                corners.fold(E::default(), |sum, (vertex, of)| {
                    sum + column[*vertex as usize] * of
                })
            }));
            if let Some(response) = &mut held.response {
                response.extend_from_slice(&column);
            }
        }
        let mean = (0..count).map(|k| square[k * count + k].re()).sum::<f64>() / count as f64;
        held.compliance.0.clone_from(&square);
        // S depends on the anchors alone and is small. A pivot next to nothing says that an anchor
        // follows from others, as the fifth in one quad does; then they are held less strictly.
        let pivots = &mut held.compliance.1;
        eliminate(&mut held.compliance.0, count, count, pivots, cancelled)?;
        if pivots
            .iter()
            .any(|pivot| pivot.is_nan() || *pivot < DEPENDENT_SHARE * mean)
        {
            let softness = SOFT_SHARE * mean;
            for k in 0..count {
                let at = &mut square[k * count + k];
                *at += E::ONE * softness;
            }
            eliminate(&mut square, count, count, pivots, cancelled)?;
            held.compliance.0 = square;
            held.stretch = 1.0 + weight * softness;
            held.is_soft = true;
        }
        Some(held)
    }

    /// Moves the vertices so that the anchors are displaced by `by` more. `None` when cancelled.
    fn pull(
        &self,
        (order, anchors): (&Dissection, &[QuadAnchor]),
        mut by: Vec<Vec2>,
        u: &mut [Vec2],
        space: &mut PoseSpace,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<()> {
        // The forces that move the anchors where they belong: S = L D L^H, forwards, by the
        // diagonal, backwards.
        let (dense, pivots) = &self.compliance;
        let n = by.len();
        for j in 0..n {
            for i in j + 1..n {
                by[i] = by[i] - dense[j * n + i].act(by[j]);
            }
        }
        for (value, pivot) in by.iter_mut().zip(pivots) {
            *value = *value * (1.0 / pivot);
        }
        for j in (0..n).rev() {
            for i in j + 1..n {
                by[j] = by[j] - dense[j * n + i].conj().act(by[i]);
            }
        }
        // Then the vertices that these forces move: by sums over what is kept for each anchor, or
        // by one more solution if there are too many to keep.
        match &self.response {
            Some(response) => {
                let moved = PulledVertices {
                    response,
                    forces: &by,
                    u,
                    cancelled,
                };
                run_at(SimdLevel::detect(), moved)?;
            }
            None => {
                space.forces.clear();
                space.forces.resize(u.len(), Vec2::ZERO);
                for (anchor, force) in anchors.iter().zip(by) {
                    anchor.spread(force, &mut space.forces);
                }
                let forces = &mut space.forces;
                self.factor
                    .solve(order, forces, &mut space.solve, cancelled)?;
                u.iter_mut()
                    .zip(&*forces)
                    .for_each(|(u, moved)| *u += *moved);
            }
        }
        Some(())
    }
}

/// The vertices, moved further by the forces on the anchors.
struct PulledVertices<'a, E> {
    response: &'a [E],
    forces: &'a [Vec2],
    u: &'a mut [Vec2],
    cancelled: &'a dyn Fn() -> bool,
}

impl<E: MatrixEntry> LaneWork for PulledVertices<'_, E> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(self) -> Option<()> {
        let n = self.u.len();
        let forces = self.forces.chunks(4);
        for (response, forces) in self.response.chunks(4 * n).zip(forces) {
            if (self.cancelled)() {
                return None;
            }
            // Four anchors are read with one pass over the vertices.
            if let [f0, f1, f2, f3] = *forces {
                let (a, b) = response.split_at(2 * n);
                let ((a, b), (c, d)) = (a.split_at(n), b.split_at(n));
                let entries = a.iter().zip(b).zip(c.iter().zip(d));
                for (u, ((a, b), (c, d))) in self.u.iter_mut().zip(entries) {
                    *u = *u + a.act(f0) + b.act(f1) + c.act(f2) + d.act(f3);
                }
                continue;
            }
            for (response, force) in response.chunks_exact(n).zip(forces) {
                for (u, entry) in self.u.iter_mut().zip(response) {
                    *u += entry.act(*force);
                }
            }
        }
        Some(())
    }
}

/// Memory that a pose needs for a while.
#[derive(Debug, Default)]
pub(super) struct PoseSpace {
    solve: SolveSpace<Vec2>,
    forces: Vec<Vec2>,
}

/// A part with anchors at two positions or more.
#[derive(Debug)]
pub(super) struct RigidPart {
    mesh: QuadMesh,
    anchors: Vec<QuadAnchor>,
    order: Dissection,
    similar: HeldEnergy<Vec2>,
    congruent: HeldEnergy<f64>,
}

/// What parts take, before they are computed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PartCost {
    /// Memory, bytes.
    pub(super) bytes: u64,
    /// Multiplications of real numbers.
    pub(super) multiplications: u64,
}

impl PartCost {
    /// The sum of both.
    pub(super) const fn with(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            multiplications: self.multiplications + other.multiplications,
        }
    }
}

/// The energies of the two steps, factorised, and the weights of their anchors.
#[derive(Debug)]
pub(super) struct Factors {
    similar: (Factor<Vec2>, f64),
    congruent: (Factor<f64>, f64),
}

/// A part whose vertices are ordered.
#[derive(Debug)]
pub(super) struct OrderedPart {
    mesh: QuadMesh,
    anchors: Vec<QuadAnchor>,
    elements: Vec<[u32; 4]>,
    order: Dissection,
}

impl OrderedPart {
    /// Orders the vertices of a connected mesh. `None` when cancelled.
    pub(super) fn new(
        mesh: QuadMesh,
        anchors: Vec<QuadAnchor>,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let of_quads = mesh.quads.iter().map(|(vertices, _)| *vertices);
        let of_anchors = anchors.iter().map(|anchor| anchor.vertices);
        let elements: Vec<[u32; 4]> = of_quads.chain(of_anchors).collect();
        let order = Dissection::new(&mesh.positions, &elements, cancelled)?;
        Some(Self {
            mesh,
            anchors,
            elements,
            order,
        })
    }

    pub(super) fn cost(&self) -> PartCost {
        let (multiplications, waiting) = self.order.cost();
        let (anchors, vertices) = (self.anchors.len() as u64, self.mesh.positions.len() as u64);
        let values = self.order.values as u64;
        let kept = if self.anchors.len() <= KEPT_ANCHORS {
            anchors * vertices
        } else {
            0
        };
        let both = (size_of::<Vec2>() + size_of::<f64>()) as u64;
        PartCost {
            bytes: self.order.bytes()
                + both * (values + kept + 2 * anchors * anchors)
                + (waiting * size_of::<Vec2>() as u64)
                + 64 * vertices,
            // A complex product is four multiplications, and the second step has real numbers.
            multiplications: 5 * multiplications
                + 10 * anchors * values
                + 5 * anchors * anchors * anchors / 3,
        }
    }

    /// The energies of both steps, factorised. `None` when cancelled.
    pub(super) fn factors(&self, cancelled: &dyn Fn() -> bool) -> Option<Factors> {
        let shape = |k: usize| &self.mesh.shapes[usize::from(self.mesh.quads[k].1)];
        Some(Factors {
            similar: self.factor(|k| shape(k).similar, cancelled)?,
            congruent: self.factor(|k| shape(k).congruent, cancelled)?,
        })
    }

    /// An energy, factorised, and the weight of its anchors. `block(k)`: the energy of quad k.
    /// `None` when cancelled.
    fn factor<E: MatrixEntry>(
        &self,
        block: impl Fn(usize) -> [[E; 4]; 4],
        cancelled: &dyn Fn() -> bool,
    ) -> Option<(Factor<E>, f64)> {
        let quads = self.mesh.quads.len();
        let diagonal = |k: usize| (0..4).map(|i| block(k)[i][i].re()).sum::<f64>();
        let sum = (0..quads).map(diagonal).sum::<f64>();
        let weight = sum / self.mesh.positions.len() as f64;
        // Without handles the energy leaves a motion of the whole free, so its matrix is singular.
        // `w B^H B` makes it definite before anything is divided (mathematics 10.6), and adds each
        // anchor as one more element of four corners.
        let element = |k: usize| {
            let Some(anchor) = k.checked_sub(quads) else {
                return block(k);
            };
            let of = self.anchors[anchor].weights;
            of.map(|a| of.map(|b| E::ONE * (weight * a * b)))
        };
        let factor = Factor::new(&self.order, &self.elements, element, cancelled)?;
        Some((factor, weight))
    }

    /// `None` when cancelled.
    pub(super) fn solve(self, cancelled: &dyn Fn() -> bool) -> Option<RigidPart> {
        let Factors { similar, congruent } = self.factors(cancelled)?;
        let Self {
            mesh,
            anchors,
            order,
            ..
        } = self;
        let (held, vertices) = ((&order, &*anchors), mesh.positions.len());
        let similar = HeldEnergy::new(similar, held, vertices, cancelled)?;
        let congruent = HeldEnergy::new(congruent, held, vertices, cancelled)?;
        Some(RigidPart {
            mesh,
            anchors,
            order,
            similar,
            congruent,
        })
    }
}

impl RigidPart {
    /// Whether anchors are so near to each other that they are not held strictly.
    pub(super) const fn is_soft(&self) -> bool {
        self.similar.is_soft || self.congruent.is_soft
    }

    /// The displacements of the vertices after the first step, in which triangles stay similar.
    /// `None` when cancelled.
    pub(super) fn similar(
        &self,
        targets: &[Vec2],
        space: &mut PoseSpace,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Vec<Vec2>> {
        let mut u = vec![Vec2::ZERO; self.mesh.positions.len()];
        let stretched = targets.iter().map(|d| *d * self.similar.stretch).collect();
        let held = (&self.order, &*self.anchors);
        self.similar
            .pull(held, stretched, &mut u, space, cancelled)?;
        Some(u)
    }

    /// The displacements of the vertices that differ least along the edges, with those of the
    /// anchors: no triangle turns. `None` when cancelled.
    pub(super) fn carry(
        &self,
        targets: &[Vec2],
        space: &mut PoseSpace,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Vec<Vec2>> {
        let mut u = vec![Vec2::ZERO; self.mesh.positions.len()];
        let targets = targets.iter().map(|d| *d * self.congruent.stretch);
        let held = (&self.order, &*self.anchors);
        self.congruent
            .pull(held, targets.collect(), &mut u, space, cancelled)?;
        Some(u)
    }

    /// The displacements of the vertices when the anchors are displaced by `targets`, px, and the
    /// least share that a triangle of the first step keeps of itself; 1 in the identity. `None`
    /// when cancelled.
    pub(super) fn pose(
        &self,
        targets: &[Vec2],
        space: &mut PoseSpace,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<(Vec<Vec2>, f64)> {
        let similar = self.similar(targets, space, cancelled)?;
        let turned = Turned {
            mesh: &self.mesh,
            similar: &similar,
        };
        let (mut u, least) = run_at(SimdLevel::detect(), turned);
        self.congruent
            .factor
            .solve(&self.order, &mut u, &mut space.solve, cancelled)?;
        let missing = self.anchors.iter().zip(targets);
        let missing = missing
            .map(|(anchor, target)| *target * self.congruent.stretch - anchor.displaced(&u))
            .collect();
        let held = (&self.order, &*self.anchors);
        self.congruent
            .pull(held, missing, &mut u, space, cancelled)?;
        Some((u, least))
    }
}
