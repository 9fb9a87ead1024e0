//! Conversion of a posed mesh to the lattice: snaps every vertex and bounds the cells by ranges of
//! y. Cost: O(vertices).

#![expect(
    clippy::cast_possible_truncation,
    reason = "coordinates of the sampler are kept as f32"
)]

use super::Filter;
use super::kernel::Kernel;
use super::snap_subdivided::SamplerCoordinates;
use super::snapped_cut::SnappedCut;
use super::snapped_grid::{BLOCK_COLUMNS, LONGEST_SIDE_STEPS, STEPS_PER_PX, SnappedGrid, YRange};
use super::subdivided_cells::SnappedSubdividedCells;
use crate::geometry::{Mesh, PIXEL_CENTER};
use crate::pixmap::Extent;

/// The largest extent of a cell that is drawn in f32, px of the sampled image along either axis.
const WIDEST_CELL_PX: f32 = 1024.0;

/// The share of the renderer's tolerance that column crossings may use; the rest is for snapping.
const CROSSING_SHARE: f32 = 7.0 / 8.0;

/// Converts a rest position to the sampler's coordinate: `scale * x + offset`.
struct SamplerAxis {
    scale: f64,
    offset: f64,
}

impl SamplerAxis {
    fn new(filter: Filter, source: u32, grid: f64, k: u32) -> Self {
        let pixels = f64::from(source) / grid / f64::from(1_u32 << k);
        match filter {
            Filter::Nearest => Self {
                scale: pixels,
                offset: 0.0,
            },
            // 1/128 px from the first pixel's centre; the half turns truncation into rounding.
            Filter::Bilinear | Filter::Bicubic => Self {
                scale: 128.0 * pixels,
                offset: 0.5 - 128.0 * PIXEL_CENTER,
            },
        }
    }

    fn at(&self, rest: f64) -> f32 {
        (rest * self.scale + self.offset) as f32
    }
}

/// Both axes.
struct Axes {
    across: SamplerAxis,
    down: SamplerAxis,
}

impl SamplerCoordinates for Axes {
    fn u(&self, x: f64) -> f32 {
        self.across.at(x)
    }

    fn v(&self, y: f64) -> f32 {
        self.down.at(y)
    }
}

impl SnappedGrid {
    /// Poses and snaps `mesh`; `source` is the full source image, sampled at a reduction by
    /// `2^k`. `scale`: px of the target per px of the source; `origin`: the position of the window
    /// that is drawn, px of the source.
    pub(super) fn new(
        mesh: &Mesh,
        source: Extent,
        k: u32,
        filter: Filter,
        (scale, origin): ([f64; 2], [f64; 2]),
        kernel: Kernel,
    ) -> Self {
        let grid = mesh.grid();
        let (columns, rows) = (grid.columns() as usize, grid.rows() as usize);
        let pitch = columns.next_multiple_of(BLOCK_COLUMNS);
        let axes = Axes {
            across: SamplerAxis::new(filter, source.width(), grid.width(), k),
            down: SamplerAxis::new(filter, source.height(), grid.height(), k),
        };
        let scale = scale.map(|s| s * f64::from(STEPS_PER_PX));
        let mut u: Vec<f32> = (0..grid.columns()).map(|i| axes.u(grid.x(i))).collect();
        let rest_x: Vec<f64> = (0..grid.columns()).map(|i| grid.x(i) - origin[0]).collect();
        u.resize(pitch + BLOCK_COLUMNS, axes.u(grid.width()));
        let v: Vec<f32> = (0..grid.rows()).map(|j| axes.v(grid.y(j))).collect();
        let (mut x, mut y) = (
            vec![0; rows * pitch + BLOCK_COLUMNS],
            vec![0; rows * pitch + BLOCK_COLUMNS],
        );
        for ((j, displacement), (x, y)) in (0..)
            .zip(mesh.displacement().chunks_exact(columns))
            .zip(x.chunks_exact_mut(pitch).zip(y.chunks_exact_mut(pitch)))
        {
            kernel.snap(
                &rest_x,
                grid.y(j) - origin[1],
                displacement,
                scale,
                &mut x[..columns],
                &mut y[..columns],
            );
            let last = (x[columns - 1], y[columns - 1]);
            x[columns..].fill(last.0);
            y[columns..].fill(last.1);
        }
        let (row_ranges, block_ranges) = y_ranges(&y, pitch, kernel);
        let unit = match filter {
            Filter::Nearest => 1.0,
            Filter::Bilinear | Filter::Bicubic => 128.0,
        };
        // Cells that show a very large part of the source need more digits than f32 has: none of
        // them is drawn in it.
        let widest = u
            .windows(2)
            .chain(v.windows(2))
            .map(|ab| (ab[1] - ab[0]).abs())
            .fold(0.0, f32::max);
        let longest_side = if widest <= WIDEST_CELL_PX * unit {
            LONGEST_SIDE_STEPS
        } else {
            0
        };
        let crossing_error = CROSSING_SHARE * mesh.subdivision().drawn_within();
        let fine = SnappedSubdividedCells::new(mesh, (scale, origin), &axes, kernel);
        let cut = mesh.cut_mesh();
        let cut = cut.map(|cut| {
            let ordered = (cut, mesh.order().map(|order| &**order));
            SnappedCut::new(ordered, (scale, origin), &axes, kernel)
        });
        let mut lattice = Self {
            columns,
            rows,
            pitch,
            x,
            y,
            u,
            v,
            unit,
            longest_side,
            crossing_error,
            row_ranges,
            block_ranges,
            fine,
            cut,
            order: mesh.order().cloned(),
        };
        lattice.cover_fine_cells();
        lattice
    }
}

/// The y that each row of cells reaches, and each block in it.
fn y_ranges(y: &[i32], pitch: usize, kernel: Kernel) -> (Vec<YRange>, Vec<YRange>) {
    let blocks = pitch / BLOCK_COLUMNS;
    let mut lines = vec![YRange::NOWHERE; y.len() / pitch * blocks];
    for (y, y_ranges) in y.chunks_exact(pitch).zip(lines.chunks_exact_mut(blocks)) {
        kernel.y_ranges(y, y_ranges);
    }
    let block_ranges: Vec<YRange> = lines
        .iter()
        .zip(&lines[blocks..])
        .map(|(above, below)| above.join(*below))
        .collect();
    let row_ranges = block_ranges
        .chunks_exact(blocks)
        .map(|row| row.iter().copied().fold(YRange::NOWHERE, YRange::join))
        .collect();
    (row_ranges, block_ranges)
}
