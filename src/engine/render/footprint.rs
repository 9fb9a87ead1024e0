//! Area-aware sampling where the warp shrinks the source. The Jacobian of the posed grid,
//! interpolated between its vertices, gives the parallelogram of the source that a target pixel
//! shows: its footprint. Its sides grow from a point at a shrinking of 1.5 to their full size at 2.
//! A side longer than 1.5 px is divided into samples, at most 16 per pixel, which are averaged,
//! colours weighted by alpha; if their distance is still larger, they are read from a box-reduced
//! copy (`kernel::footprints`). The footprint depends on the source position alone, so there are no
//! seams between cells, canvases or bands.

use std::ops::Range;

use super::Filter;
use super::kernel::{
    Alike, BATCH, FootprintBatch, FootprintGrid, GROUP_PIXELS, KINDS, Kernel,
    MAX_FOOTPRINT_SAMPLES, jacobian, one_sample_up_to,
};
use super::sampler;
use super::snapped_grid::{STEPS_PER_PX, SnappedGrid, YRange};
use super::source::Source;
use crate::geometry::Mesh;
use crate::pixmap::{Channels, Depth};

/// Vertices shrink the source by less than this share of the shrinking between them.
const SHRINKING_MARGIN: f32 = 0.967;
/// Rows of a target up to which the columns of a cell are kept for each.
const HIGH_CELL_ROWS: usize = 16;

/// The footprints of a mesh that shrinks the source somewhere.
#[derive(Debug)]
pub(super) struct Footprints {
    grid: FootprintGrid,
    /// For each row of the target, the columns between which marked cells are drawn.
    drawn: DrawnColumns,
}

/// What is sampled, at a reduction by 2 to the power of `level`, and how.
#[derive(Clone, Copy, Debug)]
pub(super) struct FootprintSource<'a> {
    pub(super) kernel: Kernel,
    pub(super) source: &'a Source,
    pub(super) level: u32,
    pub(super) filter: Filter,
    pub(super) channels: Channels,
}

/// The buffers of averaged pixels; one per band.
#[derive(Debug, Default)]
pub(super) struct AveragedSamples {
    batch: FootprintBatch,
    /// Pixels whose samples are read from another copy.
    rest: Box<Alike>,
    u: Vec<f32>,
    v: Vec<f32>,
    bytes: Vec<u8>,
    sums: Vec<u16>,
}

/// The cells in which pixels need several samples, because they shrink the source, 1 or 0,
/// `[rows - 1][columns - 1]`; empty if there are none. `sampled`: px of the sampled image for a
/// px of the source, along each axis; `scale`: px of the target.
pub(super) fn shrinking_cells(
    mesh: &Mesh,
    sampled: [f64; 2],
    scale: [f64; 2],
    kernel: Kernel,
) -> Vec<u8> {
    let grid = mesh.grid();
    let columns = grid.columns() as usize;
    let (width, height) = grid.cell();
    #[expect(
        clippy::cast_possible_truncation,
        reason = "f32 is enough to compare with"
    )]
    let (per, limit) = (
        [(1.0 / width) as f32, (1.0 / height) as f32],
        SHRINKING_MARGIN
            * one_sample_up_to((sampled[0].max(sampled[1]) / scale[0].min(scale[1])) as f32),
    );
    let mut found = vec![0; (grid.rows() as usize - 1) * (columns - 1)];
    let lines = mesh.displacement().chunks_exact(columns);
    for ((above, below), found) in lines
        .clone()
        .zip(lines.skip(1))
        .zip(found.chunks_exact_mut(columns - 1))
    {
        kernel.shrinks((above, below), per, limit, found);
    }
    if found.iter().fold(0, |any, cell| any | cell) == 0 {
        Vec::new()
    } else {
        found
    }
}

impl Footprints {
    /// `shrinking`: what [`shrinking_cells`] found. `scale`: px of the target per px of the source.
    /// `columns`, `height`: of the target.
    pub(super) fn new(
        mesh: &Mesh,
        shrinking: &[u8],
        lattice: &SnappedGrid,
        scale: [f64; 2],
        (width, height): (usize, u32),
        kernel: Kernel,
    ) -> Self {
        let grid = mesh.grid();
        let (columns, rows) = (grid.columns() as usize, grid.rows() as usize);
        let cell = grid.cell();
        let units = [
            f64::from(lattice.u[columns - 1] - lattice.u[0]) / grid.width(),
            f64::from(lattice.v[rows - 1] - lattice.v[0]) / grid.height(),
        ];
        #[expect(
            clippy::cast_possible_truncation,
            reason = "sampler coordinates are f32"
        )]
        let scale = scale.map(|scale| units.map(|unit| (unit / scale) as f32));
        let largest = scale
            .iter()
            .flatten()
            .fold(0.0_f32, |largest, scale| largest.max(*scale));
        let limit = one_sample_up_to(largest / 128.0);
        let mut marked = vec![0; columns * rows];
        let mut jacobians = vec![[0.0; 4]; columns * rows];
        let mut drawn = DrawnColumns::new(width, height as usize);
        let across: Vec<f64> = (0..grid.columns()).map(|i| grid.x(i)).collect();
        let down: Vec<f64> = (0..grid.rows()).map(|j| grid.y(j)).collect();
        let (per_x, per_y) = (per_px(&across), per_px(&down));
        let (mut last, cells) = (usize::MAX, columns - 1);
        for j in 0..rows - 1 {
            // Cells beside those that shrink the source are marked too.
            let marked = &mut marked[j * columns..][..cells];
            for line in shrinking[j.saturating_sub(1) * cells..(j + 2).min(rows - 1) * cells]
                .chunks_exact(cells)
            {
                marked
                    .iter_mut()
                    .zip(line)
                    .for_each(|(marked, cell)| *marked |= cell);
                marked[1..]
                    .iter_mut()
                    .zip(line)
                    .for_each(|(marked, cell)| *marked |= cell);
                marked
                    .iter_mut()
                    .zip(&line[1..])
                    .for_each(|(marked, cell)| *marked |= cell);
            }
            let is_marked = |cell: &u8| *cell != 0;
            let Some(first) = marked.iter().position(is_marked) else {
                continue;
            };
            let end = marked.iter().rposition(is_marked).unwrap_or(first) + 1;
            for j in [j, j + 1]
                .into_iter()
                .filter(|j| last == usize::MAX || *j > last)
            {
                jacobians_of_line(
                    mesh,
                    j,
                    (&per_x, per_y[j]),
                    &mut jacobians[j * columns..][..columns],
                );
            }
            last = j + 1;
            let line = |j: usize| &jacobians[j * columns..][first..=end];
            kernel.unmark((line(j), line(j + 1)), limit, &mut marked[first..end]);
            for i in (first..end).filter(|i| marked[*i] != 0) {
                drawn.add(lattice.cell_extent(i, j), lattice.cell_range(i, j));
            }
        }
        drawn.finish();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "sampler coordinates are f32"
        )]
        let cells = [
            (1.0 / (units[0] * cell.0)) as f32,
            (1.0 / (units[1] * cell.1)) as f32,
        ];
        let origin = [lattice.u[0], lattice.v[0]];
        Self {
            grid: FootprintGrid {
                columns,
                rows,
                jacobians,
                marked,
                origin,
                cells,
                scale,
                limit,
            },
            drawn,
        }
    }

    /// Samples a run of `len` pixels of a row, as [`sampler::sample`] does where the source is not
    /// shrunk. `row` and `column`: of its first pixel; `u` and `v`: of its pixels and
    /// [`LANES`] more; `first`: its index in `out`. Pixels that need several samples are complete
    /// after [`Self::finish`].
    pub(super) fn sample(
        &self,
        sampled: FootprintSource<'_>,
        (row, column, len): (u32, usize, usize),
        (u, v): (&[f32], &[f32]),
        samples: &mut AveragedSamples,
        (first, out): (usize, &mut [u8]),
    ) {
        let FootprintSource {
            kernel,
            source,
            level,
            filter,
            channels,
        } = sampled;
        let pixel = channels.count() * source.pixmap().depth().bytes();
        sampler::sample(
            kernel,
            source.level(level),
            filter,
            &u[..len],
            &v[..len],
            channels,
            &mut out[first * pixel..][..len * pixel],
        );
        for marked in self.drawn.runs(row as usize) {
            let at = |column_of: usize| column_of.saturating_sub(column).min(len);
            let (mut start, end) = (at(marked.start), at(marked.end));
            while start < end {
                let next = end.min(start + GROUP_PIXELS);
                kernel.footprints(
                    &self.grid,
                    (&u[start..], &v[start..]),
                    next - start,
                    first + start,
                    &mut samples.batch,
                );
                start = next;
                if samples.batch.waiting() >= GROUP_PIXELS {
                    kernel.shapes(&self.grid, &mut samples.batch);
                    samples.average(BATCH - GROUP_PIXELS + 1, sampled, out);
                }
            }
        }
    }

    /// Completes the pixels that need several samples.
    pub(super) fn finish(
        &self,
        sampled: FootprintSource<'_>,
        samples: &mut AveragedSamples,
        out: &mut [u8],
    ) {
        sampled.kernel.shapes(&self.grid, &mut samples.batch);
        samples.average(1, sampled, out);
    }
}

impl AveragedSamples {
    /// Averages the samples of pixels into those of `out`, wherever at least `least` of a kind are
    /// waiting.
    fn average(&mut self, least: usize, sampled: FootprintSource<'_>, out: &mut [u8]) {
        let depth = sampled.source.pixmap().depth();
        for (kind, log) in (0..2 * KINDS).zip((1..=MAX_FOOTPRINT_SAMPLES.ilog2()).cycle()) {
            while self.batch.alike[kind].len >= least {
                if kind >= KINDS {
                    self.batch.alike[kind].split(&mut self.rest);
                }
                match depth {
                    Depth::Eight => self.average_bytes(kind, log, sampled, out),
                    Depth::Sixteen => self.average_samples(kind, log, sampled, out),
                }
                self.batch.alike[kind].len = 0;
                if self.rest.len > 0 {
                    std::mem::swap(&mut self.batch.alike[kind], &mut self.rest);
                }
            }
        }
    }

    /// Reads the samples of all pixels of a kind: the first of each, then the second ones.
    fn read(&mut self, kind: usize, log: u32, sampled: FootprintSource<'_>, channels: Channels) {
        let FootprintSource {
            kernel,
            source,
            level,
            filter,
            ..
        } = sampled;
        let alike = &self.batch.alike[kind];
        let count = alike.len << log;
        self.u.resize(BATCH * MAX_FOOTPRINT_SAMPLES, 0.0);
        self.v.resize(BATCH * MAX_FOOTPRINT_SAMPLES, 0.0);
        kernel.positions(alike, log, &mut self.u, &mut self.v);
        let source = source.level(level + alike.reductions[0]);
        self.bytes.resize(
            count * channels.count() * source.pixmap().depth().bytes(),
            0,
        );
        sampler::sample(
            kernel,
            source,
            filter,
            &self.u[..count],
            &self.v[..count],
            channels,
            &mut self.bytes,
        );
    }

    /// Averages the samples of pixels of a kind, 8 bit.
    fn average_bytes(
        &mut self,
        kind: usize,
        log: u32,
        sampled: FootprintSource<'_>,
        out: &mut [u8],
    ) {
        // Four bytes are averaged faster than three.
        self.read(kind, log, sampled, Channels::Rgba);
        let (alike, pixel) = (&self.batch.alike[kind], sampled.channels.count());
        self.sums.clear();
        self.sums.resize(4 * alike.len, 0);
        for line in self.bytes.chunks_exact(4 * alike.len) {
            self.sums
                .iter_mut()
                .zip(line)
                .for_each(|(sum, byte)| *sum += u16::from(*byte));
        }
        let all_opaque = sampled.source.pixmap().is_opaque();
        let (sums, half) = (self.sums.as_chunks::<4>().0, 1 << (log - 1));
        for (k, (index, sums)) in alike.pixels.iter().zip(sums).enumerate() {
            let out = &mut out[index * pixel..][..pixel];
            if all_opaque || sums[3] == 255 << log {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "means stay in the range of the samples"
                )]
                let mean = sums.map(|sum| ((sum + half) >> log) as u8);
                out.copy_from_slice(&mean[..pixel]);
            } else {
                average(
                    self.bytes.chunks_exact(4).skip(k).step_by(alike.len),
                    out,
                    Depth::Eight,
                    false,
                );
            }
        }
    }

    /// Averages the samples of pixels of a kind, 16 bit.
    fn average_samples(
        &mut self,
        kind: usize,
        log: u32,
        sampled: FootprintSource<'_>,
        out: &mut [u8],
    ) {
        self.read(kind, log, sampled, sampled.channels);
        let (alike, pixel) = (&self.batch.alike[kind], 2 * sampled.channels.count());
        for (k, index) in alike.pixels[..alike.len].iter().enumerate() {
            let opaque = sampled.source.pixmap().channels() == Channels::Rgb;
            average(
                self.bytes.chunks_exact(pixel).skip(k).step_by(alike.len),
                &mut out[index * pixel..][..pixel],
                Depth::Sixteen,
                opaque,
            );
        }
    }
}

/// The reciprocals of the distances between the lines before and behind each line.
#[expect(
    clippy::cast_possible_truncation,
    reason = "f32 is enough for derivatives"
)]
fn per_px(lines: &[f64]) -> Vec<f32> {
    (0..lines.len())
        .map(|k| (1.0 / (lines[(k + 1).min(lines.len() - 1)] - lines[k.saturating_sub(1)])) as f32)
        .collect()
}

/// The Jacobians at the vertices of a line by central differences.
fn jacobians_of_line(mesh: &Mesh, j: usize, (per_x, per_y): (&[f32], f32), out: &mut [[f32; 4]]) {
    let (columns, rows) = (mesh.grid().columns() as usize, mesh.grid().rows() as usize);
    let line = |j: usize| &mesh.displacement()[j * columns..][..columns];
    let (above, here, below) = (
        line(j.saturating_sub(1)),
        line(j),
        line((j + 1).min(rows - 1)),
    );
    for (i, out) in out.iter_mut().enumerate() {
        let (left, right) = (here[i.saturating_sub(1)], here[(i + 1).min(columns - 1)]);
        let minus = |a: [f32; 2], b: [f32; 2]| [a[0] - b[0], a[1] - b[1]];
        *out = jacobian(
            minus(right, left),
            minus(below[i], above[i]),
            [per_x[i], per_y],
        );
    }
}

/// For each row of a target, the columns in which some cells are drawn, one bit for each block of
/// columns.
#[derive(Debug)]
struct DrawnColumns {
    /// Columns of a block.
    block: usize,
    lines: Vec<u64>,
    /// The rows of cells that are higher than [`HIGH_CELL_ROWS`], and their blocks.
    high: (Range<usize>, u64),
}

impl DrawnColumns {
    /// No rows; joined with others, those.
    const NONE: Range<usize> = Range {
        start: usize::MAX,
        end: 0,
    };

    fn new(width: usize, height: usize) -> Self {
        let block = width
            .div_ceil(u64::BITS as usize)
            .next_multiple_of(8)
            .max(8);
        Self {
            block,
            lines: vec![0; height],
            high: (Self::NONE, 0),
        }
    }

    /// Adds a cell, and a pixel more on every side.
    fn add(&mut self, (left, right): (i32, i32), range: YRange) {
        let pixel = |at: i32| usize::try_from(at.div_euclid(STEPS_PER_PX)).unwrap_or(0);
        let lines =
            pixel(range.top).saturating_sub(1)..(pixel(range.bottom) + 2).min(self.lines.len());
        let first = pixel(left).saturating_sub(1) / self.block;
        let last = ((pixel(right) + 1) / self.block).min(63);
        if first > last {
            return;
        }
        let blocks = u64::MAX >> (63 - (last - first)) << first;
        if lines.len() > HIGH_CELL_ROWS {
            let (rows, high) = &self.high;
            self.high = (
                rows.start.min(lines.start)..rows.end.max(lines.end),
                high | blocks,
            );
        } else {
            self.lines
                .get_mut(lines)
                .unwrap_or_default()
                .iter_mut()
                .for_each(|line| *line |= blocks);
        }
    }

    fn finish(&mut self) {
        let (lines, blocks) = &self.high;
        self.lines
            .get_mut(lines.clone())
            .unwrap_or_default()
            .iter_mut()
            .for_each(|line| *line |= blocks);
    }

    /// Ranges of columns of a row.
    fn runs(&self, row: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let mut left = self.lines.get(row).copied().unwrap_or(0);
        std::iter::from_fn(move || {
            let first = (left != 0).then(|| left.trailing_zeros())?;
            let end = first + (left >> first).trailing_ones();
            left &= u64::MAX.checked_shl(end).unwrap_or(0);
            Some(first as usize * self.block..end as usize * self.block)
        })
    }
}

/// The mean of pixels with the channels of `out`; colours weighted by alpha.
#[expect(
    clippy::cast_possible_truncation,
    reason = "means stay in the range of the samples"
)]
fn average<'a>(
    samples: impl Iterator<Item = &'a [u8]>,
    out: &mut [u8],
    depth: Depth,
    opaque: bool,
) {
    let read = |bytes: &[u8], k: usize| match depth {
        Depth::Eight => u64::from(bytes[k]),
        Depth::Sixteen => u64::from(u16::from_be_bytes([bytes[2 * k], bytes[2 * k + 1]])),
    };
    let channels = out.len() / depth.bytes();
    let (mut sums, mut count) = ([0_u64; 4], 0);
    for pixel in samples {
        count += 1;
        let alpha = if opaque { 1 } else { read(pixel, 3) };
        for (k, sum) in sums.iter_mut().enumerate().take(channels) {
            *sum += if k == 3 {
                read(pixel, 3)
            } else {
                alpha * read(pixel, k)
            };
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
