//! The posed grid as the rasteriser sees it: vertices snapped to a lattice of 1/256 target px, so that edges are compared exactly in
//! integers, and the sampler's coordinate of every column and row of the grid. Structure of arrays `[rows][pitch]`, the pitch a multiple of
//! [`BLOCK`] (the last vertex of a row is repeated). Cells are bounded by ranges of y, per row of cells and per block of cells, by which a
//! strip of target rows finds the cells that touch it. Memory and time O(vertices).

#![expect(clippy::cast_possible_truncation, reason = "lattice places are clamped to +-LIMIT before they are narrowed")]

use super::kernel::{Kernel, LONGEST_SIDE};
use super::{Filter, RenderOptions};
use crate::geometry::{Mesh, PIXEL_CENTER};
use crate::pixmap::Extent;

/// Lattice steps in a target pixel.
pub(super) const ONE: i32 = 256;
/// The lattice place of the first pixel's centre.
pub(super) const HALF: i32 = ONE / 2;
/// The farthest lattice place: 2^21 px; vertices beyond are drawn there. Products of two differences stay below 2^62.
pub(super) const LIMIT: i32 = 1 << 29;
/// What cells that are drawn in f32 show at most, px of the sampled picture along either axis.
const WIDEST: f32 = 1024.0;
/// Columns that are handled together.
pub(super) const BLOCK: usize = 8;

/// A range of lattice y, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct YRange {
    pub(super) top: i32,
    pub(super) bottom: i32,
}

impl YRange {
    pub(super) const NOWHERE: Self = Self { top: i32::MAX, bottom: i32::MIN };

    pub(super) fn join(self, other: Self) -> Self {
        Self { top: self.top.min(other.top), bottom: self.bottom.max(other.bottom) }
    }

    /// Those of `rows` whose pixel centres may lie inside.
    pub(super) fn rows(self, rows: &std::ops::Range<u32>) -> std::ops::Range<u32> {
        let clip = |y: i32| u32::try_from(first_row(y).max(0)).unwrap_or(u32::MAX).clamp(rows.start, rows.end);
        clip(self.top)..clip(self.bottom)
    }

    /// Some row of pixel centres out of `rows` may lie inside.
    pub(super) fn meets(self, rows: &std::ops::Range<u32>) -> bool {
        let (first, last) = (row_centre(rows.start), row_centre(rows.end) - i64::from(ONE));
        i64::from(self.top) <= last && i64::from(self.bottom) > first
    }
}

/// Lattice y of the centres of a row of pixels.
pub(super) const fn row_centre(row: u32) -> i64 {
    row as i64 * ONE as i64 + HALF as i64
}

/// Lattice x of the centre of a column of pixels.
pub(super) const fn column_centre(pixel: usize) -> f64 {
    pixel as f64 * ONE as f64 + HALF as f64
}

/// The first row whose centre is at or below a lattice y.
pub(super) const fn first_row(y: i32) -> i64 {
    (y as i64 - HALF as i64 + ONE as i64 - 1).div_euclid(ONE as i64)
}

/// A vertex: its lattice place and the sampler's coordinates there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub(super) x: i32,
    pub(super) y: i32,
    pub(super) u: f32,
    pub(super) v: f32,
}

/// The posed grid on the lattice.
#[derive(Debug)]
pub(super) struct Lattice {
    /// Vertices in a row.
    pub(super) columns: usize,
    /// Vertices in a column.
    pub(super) rows: usize,
    /// `columns` rounded up to whole blocks.
    pub(super) pitch: usize,
    /// Lattice places, `[rows][pitch]` and a block behind the last.
    pub(super) x: Vec<i32>,
    /// Lattice places, `[rows][pitch]` and a block behind the last.
    pub(super) y: Vec<i32>,
    /// The sampler's coordinate of each column, `[pitch + BLOCK]`.
    pub(super) u: Vec<f32>,
    /// The sampler's coordinate of each row.
    pub(super) v: Vec<f32>,
    /// The sampler's coordinates grow by this for a px of the sampled picture.
    pub(super) unit: f32,
    /// Cells with longer sides are drawn in double precision, lattice steps.
    pub(super) longest_side: i32,
    /// Reach of each row of cells.
    pub(super) row_reach: Vec<YRange>,
    /// Reach of each block of cells, `[rows - 1][pitch / BLOCK]`.
    pub(super) block_reach: Vec<YRange>,
}

/// From a place at rest to the sampler's coordinate: `scale * x + offset`.
struct Axis {
    scale: f64,
    offset: f64,
}

impl Axis {
    fn new(filter: Filter, source: u32, grid: f64, k: u32) -> Self {
        let pixels = f64::from(source) / grid / f64::from(k).exp2();
        match filter {
            Filter::Nearest => Self { scale: pixels, offset: 0.0 },
            // 1/128 px from the first pixel's centre; the half turns truncation into rounding.
            Filter::Bilinear => Self { scale: 128.0 * pixels, offset: 0.5 - 128.0 * PIXEL_CENTER },
        }
    }

    fn at(&self, rest: f64) -> f32 {
        (rest * self.scale + self.offset) as f32
    }
}

impl Lattice {
    /// Poses and snaps `mesh` for a target; `source` is the whole source picture, sampled reduced by `2^k`.
    pub(super) fn new(mesh: &Mesh, source: Extent, k: u32, options: &RenderOptions, kernel: Kernel) -> Self {
        let grid = mesh.grid();
        let (columns, rows) = (grid.columns() as usize, grid.rows() as usize);
        let pitch = columns.next_multiple_of(BLOCK);
        let across = Axis::new(options.filter, source.width(), grid.width(), k);
        let down = Axis::new(options.filter, source.height(), grid.height(), k);
        let scale = [f64::from(options.target.width()) / grid.width(), f64::from(options.target.height()) / grid.height()];
        let scale = scale.map(|s| s * f64::from(ONE));
        let rest_x: Vec<f64> = (0..grid.columns()).map(|i| grid.x(i)).collect();
        let mut u: Vec<f32> = rest_x.iter().map(|&x| across.at(x)).collect();
        u.resize(pitch + BLOCK, across.at(grid.width()));
        let v: Vec<f32> = (0..grid.rows()).map(|j| down.at(grid.y(j))).collect();
        let (mut x, mut y) = (vec![0; rows * pitch + BLOCK], vec![0; rows * pitch + BLOCK]);
        for ((j, displacement), (x, y)) in
            (0..).zip(mesh.displacement().chunks_exact(columns)).zip(x.chunks_exact_mut(pitch).zip(y.chunks_exact_mut(pitch)))
        {
            kernel.snap(&rest_x, grid.y(j), displacement, scale, &mut x[..columns], &mut y[..columns]);
            let last = (x[columns - 1], y[columns - 1]);
            x[columns..].fill(last.0);
            y[columns..].fill(last.1);
        }
        let (row_reach, block_reach) = reaches(&y, pitch, kernel);
        let unit = match options.filter {
            Filter::Nearest => 1.0,
            Filter::Bilinear => 128.0,
        };
        // Cells that show very much of the source ask for more digits than f32 has: none of them is drawn in it.
        let widest = u.windows(2).chain(v.windows(2)).map(|ab| (ab[1] - ab[0]).abs()).fold(0.0, f32::max);
        let longest_side = if widest <= WIDEST * unit { LONGEST_SIDE } else { 0 };
        Self { columns, rows, pitch, x, y, u, v, unit, longest_side, row_reach, block_reach }
    }

    /// A vertex.
    pub(super) fn corner(&self, column: usize, row: usize) -> Corner {
        let index = row * self.pitch + column;
        Corner { x: self.x[index], y: self.y[index], u: self.u[column], v: self.v[row] }
    }

    /// How far a cell reaches up and down.
    pub(super) fn cell_reach(&self, i: usize, j: usize) -> YRange {
        let above = j * self.pitch + i;
        let below = above + self.pitch;
        let (a, b, c, d) = (self.y[above], self.y[above + 1], self.y[below], self.y[below + 1]);
        YRange { top: a.min(b).min(c).min(d), bottom: a.max(b).max(c).max(d) }
    }

    /// The rows of cells that may touch target rows.
    pub(super) fn rows_touching(&self, rows: &std::ops::Range<u32>) -> impl DoubleEndedIterator<Item = usize> + '_ {
        let rows = rows.clone();
        (0..self.rows - 1).filter(move |&j| self.row_reach[j].meets(&rows))
    }

    /// Blocks of cells in a row of them.
    pub(super) fn blocks(&self) -> usize {
        (self.columns - 1).div_ceil(BLOCK)
    }

    /// Whether some cell of a block may touch target rows.
    pub(super) fn block_touches(&self, j: usize, block: usize, rows: &std::ops::Range<u32>) -> bool {
        self.block_reach[j * (self.pitch / BLOCK) + block].meets(rows)
    }

    #[cfg(test)]
    /// The cells that may touch target rows, in painter's order: row by row, `(column, row)`.
    pub(super) fn cells_touching(&self, rows: std::ops::Range<u32>) -> impl DoubleEndedIterator<Item = (usize, usize)> + '_ {
        let blocks = self.pitch / BLOCK;
        let meets = move |reach: &YRange| reach.meets(&rows);
        let rows = meets.clone();
        (0..self.rows - 1).filter(move |&j| rows(&self.row_reach[j])).flat_map(move |j| {
            let meets = meets.clone();
            let cells = self.columns - 1;
            (0..blocks)
                .filter(move |&b| meets(&self.block_reach[j * blocks + b]))
                .flat_map(move |b| (b * BLOCK..((b + 1) * BLOCK).min(cells)).map(move |i| (i, j)))
        })
    }
}

/// Reaches of the rows of cells and of their blocks.
fn reaches(y: &[i32], pitch: usize, kernel: Kernel) -> (Vec<YRange>, Vec<YRange>) {
    let blocks = pitch / BLOCK;
    let mut lines = vec![YRange::NOWHERE; y.len() / pitch * blocks];
    for (y, reaches) in y.chunks_exact(pitch).zip(lines.chunks_exact_mut(blocks)) {
        kernel.reaches(y, reaches);
    }
    let block_reach: Vec<YRange> = lines.iter().zip(&lines[blocks..]).map(|(above, below)| above.join(*below)).collect();
    let row_reach = block_reach.chunks_exact(blocks).map(|row| row.iter().copied().fold(YRange::NOWHERE, YRange::join)).collect();
    (row_reach, block_reach)
}
