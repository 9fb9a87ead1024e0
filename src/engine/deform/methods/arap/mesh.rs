//! The cut lattice of a mask as a mesh: which quad has a position, and where the vertices are that
//! are drawn.

use std::sync::Arc;

use super::part::QuadAnchor;
use crate::deform::DeformError;
use crate::geometry::{CutCells, Point, Vec2};
use crate::topology::{CutLattice, Mask, POSITION_TO_MASK_PX};

/// Most vertices of a mesh.
pub(super) const MAX_VERTICES: usize = 60_000;

/// The mesh of a mask.
#[derive(Debug)]
pub(super) struct LatticeMesh {
    mask: Arc<Mask>,
    lattice: CutLattice,
    cells: Arc<CutCells>,
    /// The vertices of dust, and the positions of the subject's quads that they go with.
    dust: Vec<(u32, QuadAnchor)>,
}

impl LatticeMesh {
    /// Errors: No pixel inside, too many vertices; cancelled.
    pub(super) fn new(
        mask: &Arc<Mask>,
        side: u32,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, DeformError> {
        if mask.inside() == 0 {
            return Err(DeformError::EmptyMask);
        }
        let too_many = || {
            if cancelled() {
                DeformError::Cancelled
            } else {
                DeformError::TooManyVertices {
                    limit: MAX_VERTICES,
                }
            }
        };
        let lattice = CutLattice::new(mask, side, MAX_VERTICES, cancelled).ok_or_else(too_many)?;
        if lattice.vertices().len() > MAX_VERTICES {
            return Err(too_many());
        }
        let cells = lattice.cells_of(mask, cancelled);
        let cells = cells.ok_or(DeformError::Cancelled)?;
        let mut mesh = Self {
            mask: Arc::clone(mask),
            lattice,
            cells: Arc::new(cells),
            dust: Vec::new(),
        };
        mesh.dust = mesh.find_dust(cancelled).ok_or(DeformError::Cancelled)?;
        Ok(mesh)
    }

    /// Dust goes with the quad of the nearest pixel inside, which is continued to it. `None` when
    /// cancelled.
    fn find_dust(&self, cancelled: &dyn Fn() -> bool) -> Option<Vec<(u32, QuadAnchor)>> {
        let dust = self.cells.cells().iter().filter(|quad| quad.is_loose);
        let mut vertices: Vec<u32> = dust.flat_map(|quad| quad.vertices).collect();
        if vertices.is_empty() {
            return Some(Vec::new());
        }
        vertices.sort_unstable();
        vertices.dedup();
        let pixels = self.lattice.pixels(&self.mask, cancelled)?;
        let width = self.mask.size().0;
        let anchor = |vertex: u32| {
            let pixel = pixels[vertex as usize]? as usize;
            let quad = (self.lattice).quad_at(&self.mask, pixel % width, pixel / width)?;
            let [x, y] = self.lattice.vertices()[vertex as usize].map(f64::from);
            let at = Point::new(x * self.side(), y * self.side());
            Some((vertex, self.anchor(quad, at)))
        };
        Some(vertices.into_iter().filter_map(anchor).collect())
    }

    /// Moves dust with the subject. The vertices of the subject have been moved.
    pub(super) fn move_dust(&self, u: &mut [Vec2]) {
        for (vertex, anchor) in &self.dust {
            u[*vertex as usize] = anchor.displaced(u);
        }
    }

    pub(super) const fn lattice(&self) -> &CutLattice {
        &self.lattice
    }

    pub(super) const fn cells(&self) -> &Arc<CutCells> {
        &self.cells
    }

    fn side(&self) -> f64 {
        f64::from(self.lattice.spacing())
    }

    /// The quad of the subject that draws a position, or whose pixel inside is the nearest one
    /// within a distance, px. No handle holds dust.
    pub(super) fn quad_of(&self, v: Point, within: f64) -> Option<usize> {
        self.drawn_at(v)
            .filter(|(x, y)| !self.mask.is_stray(*x, *y))
            .or_else(|| self.mask.pixel_at(v, within))
            .and_then(|(x, y)| self.lattice.quad_at(&self.mask, x, y))
    }

    /// The pixel of a position, if it is visible.
    fn drawn_at(&self, v: Point) -> Option<(usize, usize)> {
        let pixel = |c: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a pixel; float to integer saturates"
            )]
            let pixel = (c >= 0.0).then_some(c as usize);
            pixel
        };
        let own = pixel(v.x).zip(pixel(v.y));
        own.filter(|(x, y)| self.mask.is_visible(*x, *y))
    }

    /// A position of a quad: as shares of its corners, which extrapolate beside it.
    pub(super) fn anchor(&self, quad: usize, v: Point) -> QuadAnchor {
        let quad = &self.lattice.quads()[quad];
        let share = |c: f64, cell: u32| c / self.side() - f64::from(cell);
        let (s, t) = (share(v.x, quad.cell[0]), share(v.y, quad.cell[1]));
        QuadAnchor {
            vertices: quad.vertices,
            weights: [(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t],
        }
    }

    /// The displacement of a position; of those far from the mask 0.
    pub(super) fn displaced(&self, u: &[Vec2], v: Point) -> Vec2 {
        let quad = match self.drawn_at(v) {
            Some((x, y)) => self.lattice.quad_at(&self.mask, x, y),
            None => self.quad_of(v, POSITION_TO_MASK_PX),
        };
        quad.map_or(Vec2::ZERO, |quad| self.anchor(quad, v).displaced(u))
    }

    /// The displacements of the vertices as they are drawn: those beyond the right and the lower
    /// edge of the image are drawn on it.
    pub(super) fn drawn(&self, u: &[Vec2]) -> Vec<[f32; 2]> {
        let mut drawn = u.to_vec();
        let (width, height) = self.mask.size();
        for (axis, length) in [width, height].into_iter().enumerate() {
            let share = (length as f64 / self.side()).fract();
            if share == 0.0 {
                continue;
            }
            let last = self.lattice.cells()[axis] - 1;
            // Corners beyond the edge, each with the one before it.
            let pairs = if axis == 0 {
                [(1, 0), (2, 3)]
            } else {
                [(3, 0), (2, 1)]
            };
            let mut on_edge = drawn.clone();
            for quad in self.lattice.quads() {
                if quad.cell[axis] as usize == last {
                    for (beyond, before) in pairs.map(|(a, b)| (quad.vertices[a], quad.vertices[b]))
                    {
                        let (a, b) = (drawn[before as usize], drawn[beyond as usize]);
                        on_edge[beyond as usize] = a * (1.0 - share) + b * share;
                    }
                }
            }
            drawn = on_edge;
        }
        #[expect(clippy::cast_possible_truncation, reason = "meshes are f32")]
        let drawn = drawn.into_iter().map(|d| [d.x as f32, d.y as f32]);
        drawn.collect()
    }
}
