//! The quads of a cut grid as the rasteriser uses them. Cost: O(vertices + quads).

use std::sync::Arc;

use super::fixed_point::{Corner, YRange, first_row};
use super::kernel::Kernel;
use super::snap_subdivided::SamplerCoordinates;
use crate::geometry::{CutCell, CutCells, CutMesh};

/// The quads of a cut mesh, in the order in which they are drawn.
#[derive(Debug)]
pub(super) struct SnappedCut {
    rest: Arc<CutCells>,
    pub(super) quads: Vec<SnappedQuad>,
}

/// A posed quad.
#[derive(Clone, Copy, Debug)]
pub(super) struct SnappedQuad {
    pub(super) corners: [Corner; 4],
    y: YRange,
    cell: CutCell,
    /// Pixels of its cell per unit of the sampler's coordinates.
    per_unit: [f32; 2],
}

impl SnappedCut {
    /// Snaps the quads of a mesh; arguments as of [`super::snapped_grid::SnappedGrid::new`].
    pub(super) fn new(
        mesh: &CutMesh,
        (scale, origin): ([f64; 2], [f64; 2]),
        sampled: &impl SamplerCoordinates,
        kernel: Kernel,
    ) -> Self {
        let rest = mesh.cells();
        let corner = |(vertex, displacement): (u32, &[f32; 2])| {
            let at = rest.vertex(vertex);
            let (mut x, mut y) = ([0], [0]);
            let displacement = std::slice::from_ref(displacement);
            kernel.snap(
                &[at.x - origin[0]],
                at.y - origin[1],
                displacement,
                scale,
                &mut x,
                &mut y,
            );
            Corner {
                x: x[0],
                y: y[0],
                u: sampled.u(at.x),
                v: sampled.v(at.y),
            }
        };
        let corners: Vec<Corner> = (0..).zip(mesh.displacement()).map(corner).collect();
        let quad = |cell: &CutCell| {
            let corners = cell.vertices.map(|vertex| corners[vertex as usize]);
            let y = corners.iter().fold(YRange::NOWHERE, |range, corner| {
                range.join(YRange {
                    top: corner.y,
                    bottom: corner.y,
                })
            });
            let [from, to] = [cell.cell, cell.cell.map(|line| line + 1)];
            let grid = rest.grid();
            let size = [
                grid.x(to[0]) - grid.x(from[0]),
                grid.y(to[1]) - grid.y(from[1]),
            ];
            #[expect(clippy::cast_possible_truncation, reason = "a few pixels")]
            let [width, height] = size.map(|side| side as f32);
            SnappedQuad {
                corners,
                y,
                cell: *cell,
                per_unit: [
                    width / (corners[1].u - corners[0].u),
                    height / (corners[3].v - corners[0].v),
                ],
            }
        };
        Self {
            rest: Arc::clone(rest),
            quads: rest.cells().iter().map(quad).collect(),
        }
    }

    /// Whether a quad draws the texel at sampler coordinates.
    pub(super) fn draws(&self, quad: &SnappedQuad, u: f32, v: f32) -> bool {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "float to integer saturates"
        )]
        let pixel = |along: f32, per_unit: f32| (along * per_unit) as u32;
        let last = self.rest.side() - 1;
        let x = pixel(u - quad.corners[0].u, quad.per_unit[0]).min(last);
        let y = pixel(v - quad.corners[0].v, quad.per_unit[1]).min(last);
        self.rest.draws(&quad.cell, x, y)
    }
}

impl SnappedQuad {
    /// Whether some texels of its cell are not drawn.
    pub(super) const fn is_partial(&self) -> bool {
        self.cell.texels.is_some()
    }

    /// Whether it may touch target rows.
    pub(super) fn meets(&self, rows: &std::ops::Range<u32>) -> bool {
        self.y.meets(rows)
    }

    /// The rows and pixels of a strip that it may touch.
    pub(super) fn pixels(
        &self,
        first: u32,
        rows: usize,
        width: usize,
    ) -> [std::ops::Range<usize>; 2] {
        let clip = |at: i64, end: usize| usize::try_from(at.max(0)).unwrap_or(0).min(end);
        let row = |y: i32| clip(first_row(y) - i64::from(first), rows);
        let x = self.corners.map(|corner| corner.x);
        let (left, right) = (
            x.iter().min().copied().unwrap_or(0),
            x.iter().max().copied().unwrap_or(0),
        );
        // Rows and columns of pixels have the same rule.
        [
            row(self.y.top)..row(self.y.bottom),
            clip(first_row(left), width)..clip(first_row(right), width),
        ]
    }
}
