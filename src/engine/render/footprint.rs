//! Area-aware sampling where the warp shrinks the source. The Jacobian of the posed grid, interpolated between its vertices, gives the
//! parallelogram of the source that a target pixel shows: its footprint. A side longer than [`LEAST`] is divided into samples, at most
//! [`MOST`] per pixel, which are averaged, colours weighted by alpha; if their distance is still larger, they are read from a box-reduced
//! copy. The footprint grows from a point at [`LEAST`] to its full size at [`FULL`], and depends on the source position alone, so there are
//! no seams between cells, canvases or bands.

#![expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid and to the range of the samples")]

use std::ops::Range;

use super::Filter;
use super::kernel::{Kernel, is_shrinking, jacobian};
use super::lattice::{Lattice, ONE, YRange};
use super::sampler;
use super::source::Source;
use crate::geometry::{Mesh, Vec2};
use crate::pixmap::{Channels, Depth};

/// The shrinking up to which a position is sampled as a point.
const LEAST: f32 = 1.5;
/// The shrinking from which the whole footprint is averaged.
const FULL: f32 = 2.0;
/// Rows of a target up to which the columns of a cell are kept for each.
const HIGH: usize = 16;
/// Longest side of a footprint, px of the source for a px of the posed plane.
const LONGEST: f32 = 64.0;
/// Most samples of a pixel.
const MOST: usize = 16;
/// Largest distance of samples, px of the picture from which they are read.
const APART: f32 = 1.5;
/// Samples that are computed together.
const BATCH: usize = 1024;

/// How the samples of a pixel are arranged: along both sides of the footprint, and the reduction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    across: usize,
    down: usize,
    reduction: u32,
}

/// The sides of a footprint, coordinates of the sampler.
type Sides = [[f32; 2]; 2];

/// The footprints of a mesh that shrinks the source somewhere.
#[derive(Debug)]
pub(super) struct Footprints {
    columns: usize,
    rows: usize,
    /// At the corners of marked cells, `[rows][columns]`: derivatives of the posed position by the rest position, of x and y along x, of x
    /// and y along y.
    jacobians: Vec<[f32; 4]>,
    /// The cells that may shrink the source, and those beside them, `[rows][columns]`.
    marked: Vec<bool>,
    /// For each row of the target, the columns between which such cells are drawn.
    drawn: Vec<Range<usize>>,
    /// The sampler's coordinate of the first column and row, and cells per unit.
    origin: [f32; 2],
    cells: [f32; 2],
    /// The sampler's coordinates per px of the source for a px of the target.
    scale: [[f32; 2]; 2],
}

/// Column and row of the cells that shrink the source noticeably.
pub(super) fn shrinking_cells(mesh: &Mesh, kernel: Kernel) -> Vec<(usize, usize)> {
    let columns = mesh.grid().columns() as usize;
    let (width, height) = mesh.grid().cell();
    let per = [(1.0 / width) as f32, (1.0 / height) as f32];
    let mut found = Vec::new();
    let mut lines = mesh.displacement().chunks_exact(columns).enumerate();
    let Some((_, mut above)) = lines.next() else { return found };
    for (j, below) in lines {
        // Most rows have none.
        if kernel.shrinks(above, below, per) {
            let cells = above.iter().zip(&above[1..]).zip(below).enumerate();
            found.extend(cells.filter(|(_, ((a, right), below))| is_shrinking(**a, **right, **below, per)).map(|(i, _)| (i, j - 1)));
        }
        above = below;
    }
    found
}

/// The Jacobian at a vertex by central differences.
fn jacobian_at(mesh: &Mesh, i: u32, j: u32) -> [f32; 4] {
    let grid = mesh.grid();
    let between = |at: u32, lines: u32| (at.saturating_sub(1), (at + 1).min(lines - 1));
    let ((left, right), (top, bottom)) = (between(i, grid.columns()), between(j, grid.rows()));
    let difference = |a: Vec2, b: Vec2| [(b.x - a.x) as f32, (b.y - a.y) as f32];
    let along_x = difference(mesh.displaced(left, j), mesh.displaced(right, j));
    let along_y = difference(mesh.displaced(i, top), mesh.displaced(i, bottom));
    let (width, height) = (grid.x(right) - grid.x(left), grid.y(bottom) - grid.y(top));
    jacobian(along_x, along_y, [(1.0 / width) as f32, (1.0 / height) as f32])
}

impl Footprints {
    /// `cells`: those of [`shrinking_cells`]. `scale`: px of the target per px of the source. `height`: rows of the target.
    pub(super) fn new(mesh: &Mesh, cells: &[(usize, usize)], lattice: &Lattice, scale: [f64; 2], height: u32) -> Self {
        let grid = mesh.grid();
        let (columns, rows) = (grid.columns() as usize, grid.rows() as usize);
        let mut marked = vec![false; columns * rows];
        let mut jacobians = vec![[0.0; 4]; columns * rows];
        let mut drawn = DrawnColumns::new(height as usize);
        let around = |at: usize, lines: usize| at.saturating_sub(1)..(at + 2).min(lines - 1);
        for (i, j) in cells.iter().flat_map(|(i, j)| around(*j, rows).flat_map(|j| around(*i, columns).map(move |i| (i, j)))) {
            if !std::mem::replace(&mut marked[j * columns + i], true) {
                drawn.add(lattice.cell_extent(i, j), lattice.cell_range(i, j));
                for (i, j) in [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)] {
                    jacobians[j * columns + i] = jacobian_at(mesh, i as u32, j as u32);
                }
            }
        }
        let cell = grid.cell();
        let units = [
            f64::from(lattice.u[columns - 1] - lattice.u[0]) / grid.width(),
            f64::from(lattice.v[rows - 1] - lattice.v[0]) / grid.height(),
        ];
        Self {
            columns,
            rows,
            jacobians,
            marked,
            drawn: drawn.finish(),
            origin: [lattice.u[0], lattice.v[0]],
            cells: [(1.0 / (units[0] * cell.0)) as f32, (1.0 / (units[1] * cell.1)) as f32],
            scale: scale.map(|scale| units.map(|unit| (unit / scale) as f32)),
        }
    }

    /// The cell of a coordinate along one axis, and the position in it.
    fn locate(&self, coordinate: f32, axis: usize) -> (usize, f32) {
        let lines = [self.columns, self.rows][axis];
        let at = ((coordinate - self.origin[axis]) * self.cells[axis]).clamp(0.0, (lines - 1) as f32);
        let cell = (at as usize).min(lines - 2);
        (cell, (at - cell as f32).min(1.0))
    }

    /// The footprint at a position of the source; `None`: a point.
    fn at(&self, u: f32, v: f32) -> Option<(Shape, Sides)> {
        let ((i, s), (j, t)) = (self.locate(u, 0), self.locate(v, 1));
        let first = j * self.columns + i;
        if !self.marked[first] {
            return None;
        }
        let (top, bottom) = (&self.jacobians[first..first + 2], &self.jacobians[first + self.columns..][..2]);
        let blend = |k: usize| {
            let (above, below) = (top[0][k] + s * (top[1][k] - top[0][k]), bottom[0][k] + s * (bottom[1][k] - bottom[0][k]));
            above + t * (below - above)
        };
        let [xx, yx, xy, yy] = [blend(0), blend(1), blend(2), blend(3)];
        // Where cells have no area, the longest footprint.
        let det = (xx * yy - xy * yx).abs().max(f32::MIN_POSITIVE);
        let least = LEAST * LEAST * det * det;
        if yy * yy + yx * yx <= least && xx * xx + xy * xy <= least {
            return None;
        }
        let mut sides = [[yy, -yx], [-xy, xx]];
        let mut lengths = [0.0_f32; 2];
        for ((side, length), scale) in sides.iter_mut().zip(&mut lengths).zip(&self.scale) {
            let raw = (side[0] * side[0] + side[1] * side[1]).sqrt();
            let own = (raw / det).min(LONGEST);
            let grown = own * ((own - LEAST) * (1.0 / (FULL - LEAST))).clamp(0.0, 1.0);
            let factor = if raw > 0.0 { grown / raw } else { 0.0 };
            *side = [side[0] * factor * scale[0], side[1] * factor * scale[1]];
            *length = (side[0] * side[0] + side[1] * side[1]).sqrt() * (1.0 / 128.0);
        }
        let [a, b] = lengths;
        if a <= 0.0 && b <= 0.0 {
            return None;
        }
        let needed = |length: f32, most: usize| (1..most).find(|n| n.is_power_of_two() && length <= APART * *n as f32).unwrap_or(most);
        let (short, long) = (a.min(b), a.max(b));
        let few = needed(short, 4);
        let many = needed(long, MOST / few);
        let distance = (long / many as f32).max(short / few as f32);
        let reduction = (0..16_u32).find(|k| distance <= APART * (1_u32 << k) as f32).unwrap_or(16);
        let (across, down) = if a < b { (few, many) } else { (many, few) };
        Some((Shape { across, down, reduction }, sides))
    }

    /// Samples a run of pixels of a row at a reduction by `2^level`, as [`sampler::sample`] does where the source is not shrunk. `at`: the row
    /// and the column of the first pixel.
    pub(super) fn sample(
        &self,
        kernel: Kernel,
        (source, level): (&Source, u32),
        filter: Filter,
        (u, v): (&[f32], &[f32]),
        (row, column): (u32, usize),
        (channels, out): (Channels, &mut [u8]),
    ) {
        let pixel = channels.count() * source.pixmap().depth().bytes();
        let marked = self.drawn.get(row as usize).cloned().unwrap_or_default();
        let at = |column_of: usize| column_of.saturating_sub(column).min(u.len());
        let (start, end) = if marked.is_empty() { (u.len(), u.len()) } else { (at(marked.start), at(marked.end)) };
        for run in [0..start, end..u.len()] {
            if !run.is_empty() {
                let out = &mut out[run.start * pixel..run.end * pixel];
                sampler::sample(kernel, source.level(level), filter, &u[run.clone()], &v[run], channels, out);
            }
        }
        if start < end {
            let out = &mut out[start * pixel..end * pixel];
            self.sample_shrunken(kernel, (source, level), filter, (&u[start..end], &v[start..end]), channels, out);
        }
    }

    /// Samples pixels some of which may have footprints.
    fn sample_shrunken(
        &self,
        kernel: Kernel,
        (source, level): (&Source, u32),
        filter: Filter,
        (u, v): (&[f32], &[f32]),
        channels: Channels,
        out: &mut [u8],
    ) {
        let depth = source.pixmap().depth();
        let pixel = channels.count() * depth.bytes();
        let (mut us, mut vs, mut bytes) = (Vec::new(), Vec::new(), Vec::new());
        let mut at = 0;
        let mut next = self.footprint(u, v, 0);
        while at < u.len() {
            let shape = next.map(|(shape, _)| shape);
            let first = at;
            us.clear();
            vs.clear();
            while at < u.len() && next.map(|(shape, _)| shape) == shape && us.len() < BATCH {
                if let Some((shape, sides)) = next {
                    shape.spread(u[at], v[at], &sides, &mut us, &mut vs);
                }
                at += 1;
                next = self.footprint(u, v, at);
            }
            let out = &mut out[first * pixel..at * pixel];
            match shape {
                None => sampler::sample(kernel, source.level(level), filter, &u[first..at], &v[first..at], channels, out),
                Some(shape) => {
                    bytes.resize(us.len() * pixel, 0);
                    sampler::sample(kernel, source.level(level + shape.reduction), filter, &us, &vs, channels, &mut bytes);
                    let count = shape.across * shape.down;
                    let opaque = source.pixmap().channels() == Channels::Rgb;
                    for (out, samples) in out.chunks_exact_mut(pixel).zip(bytes.chunks_exact(count * pixel)) {
                        average(samples, out, depth, opaque);
                    }
                }
            }
        }
    }

    fn footprint(&self, u: &[f32], v: &[f32], at: usize) -> Option<(Shape, Sides)> {
        self.at(*u.get(at)?, *v.get(at)?)
    }
}

/// For each row of a target, the columns between which some cells are drawn.
struct DrawnColumns {
    lines: Vec<Range<usize>>,
    /// The rows and columns of cells that are higher than [`HIGH`].
    high: (Range<usize>, Range<usize>),
}

impl DrawnColumns {
    /// No columns; joined with others, those.
    const NONE: Range<usize> = Range { start: usize::MAX, end: 0 };

    fn new(height: usize) -> Self {
        Self { lines: vec![Self::NONE; height], high: (Self::NONE, Self::NONE) }
    }

    /// Adds a cell, and a pixel more on every side.
    fn add(&mut self, (left, right): (i32, i32), range: YRange) {
        let pixel = |at: i32| usize::try_from(at.div_euclid(ONE)).unwrap_or(0);
        let lines = pixel(range.top).saturating_sub(1)..(pixel(range.bottom) + 2).min(self.lines.len());
        let columns = pixel(left).saturating_sub(1)..pixel(right) + 2;
        if lines.len() > HIGH {
            self.high = (join(&self.high.0, &lines), join(&self.high.1, &columns));
        } else {
            self.join(lines, &columns);
        }
    }

    fn join(&mut self, lines: Range<usize>, columns: &Range<usize>) {
        self.lines.get_mut(lines).unwrap_or_default().iter_mut().for_each(|line| *line = join(line, columns));
    }

    fn finish(mut self) -> Vec<Range<usize>> {
        let (lines, columns) = std::mem::replace(&mut self.high, (Self::NONE, Self::NONE));
        self.join(lines, &columns);
        self.lines
    }
}

fn join(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    a.start.min(b.start)..a.end.max(b.end)
}

impl Shape {
    /// Appends the positions of a pixel's samples.
    fn spread(self, u: f32, v: f32, [a, b]: &Sides, us: &mut Vec<f32>, vs: &mut Vec<f32>) {
        let share = 1.0 / (1_u32 << self.reduction) as f32;
        // 128 times the position, px, is 63.5 larger than the coordinate.
        let reduced = |coordinate: f32| (coordinate + 63.5) * share - 63.5;
        let offset = |k: usize, count: usize| (k as f32 + 0.5) / count as f32 - 0.5;
        for j in 0..self.down {
            let y = offset(j, self.down);
            for i in 0..self.across {
                let x = offset(i, self.across);
                us.push(reduced(u + x * a[0] + y * b[0]));
                vs.push(reduced(v + x * a[1] + y * b[1]));
            }
        }
    }
}

/// The mean of the pixels in `samples`, colours weighted by alpha.
fn average(samples: &[u8], out: &mut [u8], depth: Depth, opaque: bool) {
    let read = |bytes: &[u8], k: usize| match depth {
        Depth::Eight => u64::from(bytes[k]),
        Depth::Sixteen => u64::from(u16::from_be_bytes([bytes[2 * k], bytes[2 * k + 1]])),
    };
    let channels = out.len() / depth.bytes();
    let count = (samples.len() / out.len()) as u64;
    let mut sums = [0_u64; 4];
    for pixel in samples.chunks_exact(out.len()) {
        let alpha = if opaque { 1 } else { read(pixel, 3) };
        for (k, sum) in sums.iter_mut().enumerate().take(channels) {
            *sum += if k == 3 { read(pixel, 3) } else { alpha * read(pixel, k) };
        }
    }
    let weight = if opaque { count } else { sums[3] };
    for (k, sum) in sums.into_iter().enumerate().take(channels) {
        let divisor = if k == 3 { count } else { weight };
        let mean = (sum + divisor / 2).checked_div(divisor).unwrap_or(0);
        match depth {
            Depth::Eight => out[k] = mean as u8,
            Depth::Sixteen => out[2 * k..2 * k + 2].copy_from_slice(&(mean as u16).to_be_bytes()),
        }
    }
}
