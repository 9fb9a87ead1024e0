//! A part of a mesh, posed as rigidly as possible (Igarashi, Moscovich, Hughes 2005; mathematics
//! 10.6): first every triangle as similar as possible to itself at rest, then as congruent as
//! possible to itself turned as in the first step. All in displacements, so that the identity is
//! exact.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over corners and triangles are written alike, whatever they index"
)]

use super::dissection::Dissection;
use super::fronts::{Factor, MatrixEntry, SolveSpace, eliminate};
use crate::deform::kernel::{LaneWork, run_at};
use crate::geometry::Vec2;
use crate::level::SimdLevel;

/// Triangles of a quad that are summed at once.
const TRIANGLES: usize = 4;
/// How forces on more anchors than these move the vertices is solved for in each pose, instead of
/// kept.
pub(super) const KEPT_ANCHORS: usize = 32;
/// Anchors that determine each other to this share of the mean are held less strictly, by this
/// share of it.
const DEPENDENT_SHARE: f64 = 1e-9;
const SOFT_SHARE: f64 = 1e-8;
/// A triangle that the first step makes smaller than this share has no rotation.
const UNDEFINED_SHARE: f64 = 1e-12;

/// The triangles of a quad at rest.
#[derive(Clone, Debug)]
pub(super) struct QuadShape {
    /// Where each corner is from the centre of each triangle, px, if it belongs to that, else 0.
    x: [[f64; TRIANGLES]; 4],
    y: [[f64; TRIANGLES]; 4],
    /// 1 divided by the sum of the squares of these, for each triangle; 0 without a triangle.
    per_size: [f64; TRIANGLES],
    /// The energies of the two steps.
    similar: [[Vec2; 4]; 4],
    congruent: [[f64; 4]; 4],
}

impl QuadShape {
    /// All triangles of its corners: no direction is preferred.
    pub(super) const ALL: [[usize; 3]; 4] = [[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]];

    /// `triangles`: at most four, of indices of `corners`.
    pub(super) fn new(corners: [Vec2; 4], triangles: &[[usize; 3]]) -> Self {
        let mut shape = Self {
            x: [[0.0; TRIANGLES]; 4],
            y: [[0.0; TRIANGLES]; 4],
            per_size: [0.0; TRIANGLES],
            similar: [[Vec2::ZERO; 4]; 4],
            congruent: [[0.0; 4]; 4],
        };
        for (lane, triangle) in triangles.iter().enumerate() {
            let z = triangle.map(|k| corners[k]);
            let centre = (z[0] + z[1] + z[2]) * (1.0 / 3.0);
            let mut size = 0.0;
            for k in 0..3 {
                let offset = z[k] - centre;
                (shape.x[triangle[k]][lane], shape.y[triangle[k]][lane]) = (offset.x, offset.y);
                size += offset.norm2();
            }
            shape.per_size[lane] = 1.0 / size;
            for k in 0..3 {
                let at = [triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]];
                let [i, j, l] = at.map(|k| corners[k]);
                let (side, other) = (j - i, l - i);
                // Where the third corner is, in the frame of the first two.
                let c = other.complex_mul(side.conj()) * (1.0 / side.norm2());
                let row = [c - Vec2::new(1.0, 0.0), -c, Vec2::new(1.0, 0.0)];
                for (a, row_a) in at.iter().zip(row) {
                    for (b, row_b) in at.iter().zip(row) {
                        let entry = &mut shape.similar[*a][*b];
                        *entry += row_a.conj().complex_mul(row_b);
                    }
                }
                for (a, b, sign) in [(0, 0, 1.0), (1, 1, 1.0), (0, 1, -1.0), (1, 0, -1.0)] {
                    shape.congruent[at[a]][at[b]] += sign;
                }
            }
        }
        shape
    }

    /// The pull of the corners towards the triangles that turn as those of displaced corners do,
    /// and the least share that a triangle keeps of itself.
    #[inline(always)]
    fn turn(&self, u: [Vec2; 4]) -> ([Vec2; 4], f64) {
        let (mut re, mut im) = ([0.0; TRIANGLES], [0.0; TRIANGLES]);
        for k in 0..4 {
            for lane in 0..TRIANGLES {
                let (x, y) = (self.x[k][lane], self.y[k][lane]);
                re[lane] += x * u[k].x + y * u[k].y;
                im[lane] += x * u[k].y - y * u[k].x;
            }
        }
        let mut least = [1.0; TRIANGLES];
        for lane in 0..TRIANGLES {
            let (x, y) = (
                re[lane] * self.per_size[lane],
                im[lane] * self.per_size[lane],
            );
            let along = 1.0 + x;
            let n = (along * along + y * y).sqrt();
            // (1 + u) / |1 + u| - 1 without cancellation. Both sides of a choice are computed, so
            // that the lanes are vectors.
            let (little, much) = (-y * y / (along + n), along - n);
            let change = if along > 0.0 { little } else { much };
            let (cos, sin) = (3.0 * change / n, 3.0 * y / n);
            let is_defined = n >= UNDEFINED_SHARE;
            re[lane] = if is_defined { cos } else { 0.0 };
            im[lane] = if is_defined { sin } else { 0.0 };
            least[lane] = n;
        }
        let mut pull = [Vec2::ZERO; 4];
        for k in 0..4 {
            let (mut px, mut py) = ([0.0; TRIANGLES], [0.0; TRIANGLES]);
            for lane in 0..TRIANGLES {
                let (x, y) = (self.x[k][lane], self.y[k][lane]);
                px[lane] = re[lane] * x - im[lane] * y;
                py[lane] = re[lane] * y + im[lane] * x;
            }
            pull[k] = Vec2::new(
                (px[0] + px[1]) + (px[2] + px[3]),
                (py[0] + py[1]) + (py[2] + py[3]),
            );
        }
        (pull, least[0].min(least[1]).min(least[2].min(least[3])))
    }
}

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

/// The quads of a part.
#[derive(Debug)]
pub(super) struct QuadMesh {
    pub(super) shapes: Vec<QuadShape>,
    /// The corners of each quad, and its shape.
    pub(super) quads: Vec<([u32; 4], u8)>,
    /// Lines of the lattice on which each vertex lies.
    pub(super) positions: Vec<[u32; 2]>,
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
    /// `block(k)`: the energy of quad k. `None` when cancelled.
    fn new(
        order: &Dissection,
        (elements, quads): (&[[u32; 4]], usize),
        block: impl Fn(usize) -> [[E; 4]; 4],
        anchors: &[QuadAnchor],
        vertices: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let diagonal = |k: usize| (0..4).map(|i| block(k)[i][i].re()).sum::<f64>();
        let weight = (0..quads).map(diagonal).sum::<f64>() / vertices as f64;
        // Without handles the energy leaves a motion of the whole free, so its matrix is singular.
        // `w B^H B` makes it definite before anything is divided (mathematics 10.6), and adds each
        // anchor as one more element of four corners.
        let element = |k: usize| {
            let Some(anchor) = k.checked_sub(quads) else {
                return block(k);
            };
            let of = anchors[anchor].weights;
            of.map(|a| of.map(|b| E::ONE * (weight * a * b)))
        };
        let factor = Factor::new(order, elements, element, cancelled)?;
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
                for (response, force) in response.chunks_exact(u.len()).zip(by) {
                    if cancelled() {
                        return None;
                    }
                    for (u, entry) in u.iter_mut().zip(response) {
                        *u += entry.act(force);
                    }
                }
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

    /// `None` when cancelled.
    pub(super) fn solve(self, cancelled: &dyn Fn() -> bool) -> Option<RigidPart> {
        let Self {
            mesh,
            anchors,
            elements,
            order,
        } = self;
        let shape = |k: usize| &mesh.shapes[usize::from(mesh.quads[k].1)];
        let (quads, vertices) = (mesh.quads.len(), mesh.positions.len());
        let all = (&*elements, quads);
        let similar = |k| shape(k).similar;
        let similar = HeldEnergy::new(&order, all, similar, &anchors, vertices, cancelled)?;
        let congruent = |k| shape(k).congruent;
        let congruent = HeldEnergy::new(&order, all, congruent, &anchors, vertices, cancelled)?;
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

/// What pulls the vertices towards the triangles that turn as in the first step, and the least
/// share that one of them keeps of itself.
struct Turned<'a> {
    mesh: &'a QuadMesh,
    similar: &'a [Vec2],
}

impl LaneWork for Turned<'_> {
    type Output = (Vec<Vec2>, f64);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut u = vec![Vec2::ZERO; self.similar.len()];
        let mut least = 1.0_f64;
        for (vertices, shape) in &self.mesh.quads {
            let shape = &self.mesh.shapes[usize::from(*shape)];
            let mut corners = [Vec2::ZERO; 4];
            for (corner, vertex) in corners.iter_mut().zip(vertices) {
                *corner = self.similar[*vertex as usize];
            }
            let (pull, share) = shape.turn(corners);
            for (vertex, pull) in vertices.iter().zip(pull) {
                u[*vertex as usize] += pull;
            }
            least = least.min(share);
        }
        (u, least)
    }
}
