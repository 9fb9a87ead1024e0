//! The second step of a part (mathematics 10.6): how far the triangles of its quads turn.

#![expect(
    clippy::needless_range_loop,
    reason = "loops over corners and triangles are written alike, whatever they index"
)]

use crate::deform::kernel::LaneWork;
use crate::geometry::Vec2;

/// Triangles of a quad that are summed at once.
const TRIANGLES: usize = 4;
/// Quads whose triangles turn at once.
const QUADS: usize = 8;
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
    pub(super) similar: [[Vec2; 4]; 4],
    pub(super) congruent: [[f64; 4]; 4],
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

    /// The pull of the corners of some quads towards the triangles that turn as those of displaced
    /// corners do, and the least share that a triangle keeps of itself.
    #[inline(always)]
    fn turn(&self, u: &[CornerLanes; 4]) -> ([CornerLanes; 4], [f64; QUADS]) {
        let mut least = [1.0_f64; QUADS];
        let (mut re, mut im) = ([[0.0; QUADS]; TRIANGLES], [[0.0; QUADS]; TRIANGLES]);
        for t in 0..TRIANGLES {
            for lane in 0..QUADS {
                let (mut x, mut y) = (0.0, 0.0);
                for k in 0..4 {
                    x += self.x[k][t] * u[k].x[lane] + self.y[k][t] * u[k].y[lane];
                    y += self.x[k][t] * u[k].y[lane] - self.y[k][t] * u[k].x[lane];
                }
                let (x, y) = (x * self.per_size[t], y * self.per_size[t]);
                let along = 1.0 + x;
                let n = (along * along + y * y).sqrt();
                // (1 + u) / |1 + u| - 1 without cancellation. Both sides of a choice are computed,
                // so that the lanes are vectors.
                let (little, much) = (-y * y / (along + n), along - n);
                let change = if along > 0.0 { little } else { much };
                let (cos, sin) = (3.0 * change / n, 3.0 * y / n);
                let is_defined = n >= UNDEFINED_SHARE;
                re[t][lane] = if is_defined { cos } else { 0.0 };
                im[t][lane] = if is_defined { sin } else { 0.0 };
                least[lane] = if n < least[lane] { n } else { least[lane] };
            }
        }
        let mut pull = [CornerLanes::default(); 4];
        for k in 0..4 {
            for lane in 0..QUADS {
                let x = |t: usize| re[t][lane] * self.x[k][t] - im[t][lane] * self.y[k][t];
                let y = |t: usize| re[t][lane] * self.y[k][t] + im[t][lane] * self.x[k][t];
                pull[k].x[lane] = (x(0) + x(1)) + (x(2) + x(3));
                pull[k].y[lane] = (y(0) + y(1)) + (y(2) + y(3));
            }
        }
        (pull, least)
    }
}

/// A corner of each of some quads.
#[derive(Clone, Copy, Default)]
struct CornerLanes {
    x: [f64; QUADS],
    y: [f64; QUADS],
}

/// The quads of a part.
#[derive(Clone, Debug)]
pub(super) struct QuadMesh {
    pub(super) shapes: Vec<QuadShape>,
    /// The corners of each quad, and its shape.
    pub(super) quads: Vec<([u32; 4], u8)>,
    /// Lines of the lattice on which each vertex lies.
    pub(super) positions: Vec<[u32; 2]>,
}

/// What pulls the vertices towards the triangles that turn as in the first step, and the least
/// share that one of them keeps of itself.
pub(super) struct Turned<'a> {
    pub(super) mesh: &'a QuadMesh,
    pub(super) similar: &'a [Vec2],
}

impl LaneWork for Turned<'_> {
    type Output = (Vec<Vec2>, f64);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut u = vec![Vec2::ZERO; self.similar.len()];
        let mut least = 1.0_f64;
        let alike = self.mesh.quads.chunk_by(|a, b| a.1 == b.1);
        for quads in alike.flat_map(|quads| quads.chunks(QUADS)) {
            // Lanes without a quad stay as they are.
            let mut corners = [CornerLanes::default(); 4];
            for (lane, (vertices, _)) in quads.iter().enumerate() {
                for k in 0..4 {
                    let at = self.similar[vertices[k] as usize];
                    (corners[k].x[lane], corners[k].y[lane]) = (at.x, at.y);
                }
            }
            let (pull, shares) = self.mesh.shapes[usize::from(quads[0].1)].turn(&corners);
            for (lane, (vertices, _)) in quads.iter().enumerate() {
                for k in 0..4 {
                    u[vertices[k] as usize] += Vec2::new(pull[k].x[lane], pull[k].y[lane]);
                }
            }
            least = shares.into_iter().fold(least, f64::min);
        }
        (u, least)
    }
}
