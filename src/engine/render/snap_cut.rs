//! Snaps the quads of a cut mesh. Apart from what is snapped, which the kernels read.

use std::sync::Arc;

use super::fixed_point::{Corner, YRange};
use super::kernel::Kernel;
use super::snap_subdivided::SamplerCoordinates;
use super::snapped_cut::{SnappedCut, SnappedQuad};
use crate::geometry::{CutCell, CutMesh, DrawingOrder};

impl SnappedCut {
    /// Snaps the quads of a mesh; arguments as of [`super::snapped_grid::SnappedGrid::new`].
    pub(super) fn new(
        (mesh, order): (&CutMesh, Option<&DrawingOrder>),
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
        let cells = rest.cells();
        let quads = match order {
            None => cells.iter().map(quad).collect(),
            Some(order) => {
                let ordered = order.cells().iter();
                ordered.map(|cell| quad(&cells[*cell as usize])).collect()
            }
        };
        Self {
            rest: Arc::clone(rest),
            quads,
        }
    }
}
