//! A posed grid drawn in strips of rows. Coordinates come from column crossings, and from single
//! cells where crossings are inaccurate or out of order (`row_strategy`). The strategy depends on
//! the mesh and the row alone, so every division into bands gives the same bytes. Cost: O(cells
//! touched + pixels).

mod cut_strips;
mod ordered_cells;
mod row_spans;

use std::ops::Range;

use self::row_spans::{gaps, runs};
use super::border::{Border, BorderSearch, UncoveredRows};
use super::canvas::Window;
use super::cell;
use super::footprint::{AveragedSamples, FootprintSource, Footprints};
use super::kernel::{Kernel, LANES, NOTES, Raster, UNCOVERED};
use super::row_split::RowSplit;
use super::row_strategy::{RowStrategies, RowStrategy};
use super::sampler;
use super::snapped_grid::{BLOCK_COLUMNS, SnappedGrid};
use super::source::Source;
use super::{Filter, Outside, RenderOptions};
use crate::pixmap::{Channels, Extent};

/// Rows whose coordinates are computed together.
pub(crate) const STRIP_ROWS: u32 = 32;
/// Pixels behind the end of a row that kernels may write.
const SLACK_PIXELS: usize = LANES;

/// A prepared mesh.
#[derive(Debug)]
pub(super) struct Drawing {
    pub(super) lattice: SnappedGrid,
    footprints: Option<Footprints>,
    border: Border,
    filter: Filter,
    outside: Outside,
    kernel: Kernel,
    window: Window,
    /// The source is sampled at a reduction by 2^level.
    level: u32,
    strategies: RowStrategies,
    /// Every pixel of the window that is drawn is certainly covered.
    pub(super) covered: bool,
}

/// Coordinates of a strip and the buffers to compute them; one per band.
#[derive(Debug, Default)]
struct StripScratch {
    u: Vec<f32>,
    v: Vec<f32>,
    /// The same of a single quad of a cut grid.
    quad_u: Vec<f32>,
    quad_v: Vec<f32>,
    x_crossings: Vec<f32>,
    v_crossings: Vec<f32>,
    notes: Vec<[f32; BLOCK_COLUMNS]>,
    first: Vec<u32>,
    runs: Vec<Range<usize>>,
    /// The row of cells in which each column last crossed a row.
    cells: Vec<usize>,
    /// The pixels that each row drawn by crossings covers.
    covered: Vec<Range<usize>>,
    /// The range of each row that has uncovered pixels.
    uncovered: Vec<Range<usize>>,
    split: RowSplit,
}

impl Drawing {
    /// `source` is the size of the whole source at the scale of the target.
    pub(super) fn new(
        (lattice, footprints): (SnappedGrid, Option<Footprints>),
        window: Window,
        source: Extent,
        options: RenderOptions,
        level: u32,
        kernel: Kernel,
    ) -> Self {
        let mut border = Border::new(&lattice);
        let covered = lattice.cut.is_none() && border.surrounds(&window.columns, &window.rows);
        if !covered && matches!(options.outside, Outside::Edge | Outside::Reflect) {
            border.index();
            if options.outside == Outside::Reflect {
                border.mirror(&lattice);
            }
        }
        let strategies = RowStrategies::new(&lattice, window.rows.end, source.height(), kernel);
        Self {
            lattice,
            footprints,
            border,
            filter: options.filter,
            outside: options.outside,
            kernel,
            window,
            level,
            strategies,
            covered,
        }
    }

    /// Draws the part of target rows that lies in the window, or less when cancelled. Shapes:
    /// `out: [rows][width of the target]`, pixels.
    pub(super) fn band(
        &self,
        source: &Source,
        channels: Channels,
        (rows, out): (&Range<u32>, &mut [u8]),
        cancelled: &dyn Fn() -> bool,
    ) {
        let pixel = channels.count() * source.pixmap().depth().bytes();
        let pitch = out.len() / rows.len() / pixel;
        let sampled = FootprintSource {
            kernel: self.kernel,
            source,
            level: self.level,
            filter: self.filter,
            channels,
        };
        let mut samples = self.footprints.is_some().then(AveragedSamples::default);
        self.each_line(rows, cancelled, |at, line, scratch| {
            self.paint(sampled, line, scratch, samples.as_mut(), (at * pitch, out))
        });
        if let (Some(footprints), Some(samples)) = (&self.footprints, &mut samples) {
            footprints.finish(sampled, samples, out);
        }
    }

    /// Writes the source positions of the covered pixels of target rows, at most `most`, and leaves
    /// the others, or fewer when cancelled. The filter is [`Filter::Nearest`] and the level 0, so
    /// that the sampler's coordinates are px of the source. Shapes:
    /// `out: [rows][width of the target]`.
    pub(super) fn positions(
        &self,
        rows: &Range<u32>,
        most: [f32; 2],
        out: &mut [[f32; 2]],
        cancelled: &dyn Fn() -> bool,
    ) {
        debug_assert!(self.filter == Filter::Nearest && self.level == 0);
        let Window {
            columns,
            first: (left, _),
            ..
        } = &self.window;
        let pitch = out.len() / rows.len();
        self.each_line(rows, cancelled, |at, (_, start), scratch| {
            for run in &scratch.runs {
                let run = run.start.max(columns.start)..run.end;
                if run.is_empty() {
                    continue;
                }
                let out = &mut out[at * pitch + left + run.start - columns.start..][..run.len()];
                let (u, v) = (&scratch.u[start..][run.clone()], &scratch.v[start..][run]);
                for (out, (u, v)) in out.iter_mut().zip(u.iter().zip(v)) {
                    *out = [u.clamp(0.0, most[0]), v.clamp(0.0, most[1])];
                }
            }
        });
    }

    /// Computes the coordinates of the target rows that lie in the window: the index of each among
    /// `rows`, the row of the window, and where it begins in the scratch. Cancellation is checked
    /// for each strip, and within it where cells are drawn one by one.
    #[inline(always)]
    fn each_line(
        &self,
        rows: &Range<u32>,
        cancelled: &dyn Fn() -> bool,
        mut draw: impl FnMut(usize, (u32, usize), &StripScratch),
    ) {
        let Window {
            rows: drawn,
            first: (_, top),
            ..
        } = &self.window;
        // The target's rows that lie in the window.
        let (start, end) = (
            rows.start.max(*top),
            rows.end.min(top + (drawn.end - drawn.start)),
        );
        if start >= end {
            return;
        }
        let mut at = (start - rows.start) as usize;
        let mut scratch = self.scratch();
        let within = drawn.start + (start - top)..drawn.start + (end - top);
        for first in within.clone().step_by(STRIP_ROWS as usize) {
            let strip = first..within.end.min(first.saturating_add(STRIP_ROWS));
            self.prepare(&strip, &mut scratch, cancelled);
            if cancelled() {
                return;
            }
            if self.is_extended() {
                self.extend(&strip, &mut scratch);
            }
            for row in strip.clone() {
                let line = if self.is_extended() {
                    self.extended(row, &strip, &mut scratch)
                } else {
                    self.coordinates(row, &strip, &mut scratch)
                };
                draw(at, (row, line), &scratch);
                at += 1;
            }
        }
    }

    /// The columns of the window up to the last one that is drawn.
    pub(super) const fn width(&self) -> usize {
        self.window.columns.end
    }

    /// Whether uncovered pixels show the image's edge, or what is mirrored there; a cut grid has
    /// no such edge.
    fn is_extended(&self) -> bool {
        !self.covered
            && self.lattice.cut.is_none()
            && matches!(self.outside, Outside::Edge | Outside::Reflect)
    }

    /// Computes the coordinates of all pixels of a strip.
    fn extend(&self, strip: &Range<u32>, scratch: &mut StripScratch) {
        let width = self.width();
        let pitch = width + SLACK_PIXELS;
        for row in strip.clone() {
            let start = self.coordinates(row, strip, scratch);
            for gap in gaps(&scratch.runs, width) {
                scratch.u[start..][gap].fill(UNCOVERED);
            }
        }
        let rows = pitch..(1 + strip.len()) * pitch;
        let (u, v) = (&mut scratch.u[rows.clone()], &mut scratch.v[rows]);
        BorderSearch::new(&self.border).fill(&mut UncoveredRows {
            first: strip.start,
            left: self.window.columns.start,
            width,
            pitch,
            u,
            v,
        });
    }

    /// Start of a row of an extended strip in the scratch: one run, as wide as the target.
    fn extended(&self, row: u32, strip: &Range<u32>, scratch: &mut StripScratch) -> usize {
        let width = self.width();
        scratch.runs.clear();
        scratch.runs.push(0..width);
        (1 + (row - strip.start) as usize) * (width + SLACK_PIXELS)
    }

    fn scratch(&self) -> StripScratch {
        let blocks = self.lattice.pitch / BLOCK_COLUMNS;
        let crossings = STRIP_ROWS as usize * (self.lattice.pitch + BLOCK_COLUMNS);
        StripScratch {
            x_crossings: vec![0.0; crossings],
            v_crossings: vec![0.0; crossings],
            notes: vec![[0.0; BLOCK_COLUMNS]; blocks * NOTES],
            first: vec![0; (blocks + 1) * BLOCK_COLUMNS],
            cells: vec![0; self.lattice.columns],
            ..StripScratch::default()
        }
    }

    /// The part that the rows of a strip share: crossings of the columns, and everything drawn cell
    /// by cell.
    fn prepare(
        &self,
        strip: &Range<u32>,
        scratch: &mut StripScratch,
        cancelled: &dyn Fn() -> bool,
    ) {
        if let Some(cut) = &self.lattice.cut {
            return self.draw_cut(cut, strip, scratch, cancelled);
        }
        let width = self.width();
        let all_plain = strip
            .clone()
            .all(|row| self.strategies.of(row) == RowStrategy::Scanline);
        let pitch = width + SLACK_PIXELS;
        // Rows drawn by crossings alone are computed and used one by one, in the first row of the
        // scratch, unless they are extended; the others follow it.
        let size = if all_plain && !self.is_extended() {
            1
        } else {
            1 + strip.len()
        } * pitch;
        if scratch.u.len() < size {
            scratch.u.resize(size, 0.0);
            scratch.v.resize(size, 0.0);
        }
        let rows_of = |strategy: RowStrategy| {
            strip.clone().rev().fold(0, |rows, row| {
                rows << 1 | u32::from(self.strategies.of(row) == strategy)
            })
        };
        let (mended, divided) = (
            rows_of(RowStrategy::ScanlineWithFixups),
            rows_of(RowStrategy::Mixed),
        );
        if strip.clone().any(|row| {
            self.strategies.of(row) != RowStrategy::Mixed || self.strategies.is_splittable(row)
        }) {
            scratch.x_crossings.fill(0.0);
            scratch.v_crossings.fill(0.0);
            self.kernel.crossings(
                &self.lattice,
                strip.clone(),
                &mut scratch.x_crossings,
                &mut scratch.v_crossings,
            );
        }
        if all_plain {
            return;
        }
        scratch
            .split
            .prepare(&self.lattice, &self.strategies, strip, divided);
        scratch.covered.clear();
        scratch.uncovered.clear();
        for (index, row) in strip.clone().enumerate() {
            scratch.runs.clear();
            let mut uncovered = 0..0;
            match self.strategies.of(row) {
                RowStrategy::Scanline => {}
                RowStrategy::ScanlineWithFixups => self.spans(
                    row,
                    index,
                    0..self.lattice.columns - 1,
                    (index + 1) * pitch,
                    scratch,
                ),
                RowStrategy::Mixed => {
                    uncovered = self.divided(row, index, (index + 1) * pitch, scratch)
                }
            }
            scratch.uncovered.push(uncovered);
            scratch
                .covered
                .push(scratch.runs.first().cloned().unwrap_or_default());
        }
        self.draw_cells(strip, (mended, divided), scratch, cancelled);
    }

    /// Draws cell by cell what crossings do not give: in `mended` rows the cells where they are
    /// inaccurate, in `divided` rows every part that is not split into columns. Bits of rows, the
    /// first of the strip lowest.
    fn draw_cells(
        &self,
        strip: &Range<u32>,
        (mended, divided): (u32, u32),
        scratch: &mut StripScratch,
        cancelled: &dyn Fn() -> bool,
    ) {
        let pitch = self.width() + SLACK_PIXELS;
        let drawn = mended | divided;
        let (u, v, uncovered) = (
            &mut scratch.u[pitch..],
            &mut scratch.v[pitch..],
            &mut scratch.uncovered,
        );
        let mut raster = Raster {
            first: strip.start,
            width: self.width(),
            pitch,
            u,
            v,
            over: true,
            uncovered,
            open: drawn,
        };
        let RowSplit {
            per_cell, blocks, ..
        } = &scratch.split;
        let ordered = |b: usize| {
            (0..BLOCK_COLUMNS).fold(0, |cells, k| {
                cells | u8::from(drawn & !per_cell[b * BLOCK_COLUMNS + k] != 0) << k
            })
        };
        let ordered: Vec<u8> = (0..blocks.len()).map(ordered).collect();
        for j in self.lattice.rows_touching(strip) {
            if cancelled() {
                return;
            }
            let inaccurate = self.strategies.inaccurate(j);
            cell::draw_row(
                self.kernel,
                &self.lattice,
                j,
                |b| inaccurate[b] & ordered[b],
                |i| drawn & !per_cell[i],
                strip,
                &mut raster,
            );
        }
        // From the last cell back and into uncovered pixels only: the same image, without
        // repeated work where cells overlap.
        (raster.over, raster.open) = (false, divided);
        if let Some(order) = &self.lattice.order {
            return self.draw_in_order(order, strip, (blocks, per_cell), &mut raster, cancelled);
        }
        for j in self.lattice.rows_touching(strip).rev() {
            if raster.open == 0 || cancelled() {
                break;
            }
            cell::draw_row(
                self.kernel,
                &self.lattice,
                j,
                |b| blocks[b],
                |i| per_cell[i],
                strip,
                &mut raster,
            );
        }
        raster.shrink();
    }

    /// Computes a row's coordinates and its covered runs; returns where the row begins in the
    /// scratch.
    fn coordinates(&self, row: u32, strip: &Range<u32>, scratch: &mut StripScratch) -> usize {
        let index = (row - strip.start) as usize;
        let width = self.width();
        let strategy = if self.lattice.cut.is_some() {
            RowStrategy::Mixed
        } else {
            self.strategies.of(row)
        };
        let start = if strategy == RowStrategy::Scanline && !self.is_extended() {
            0
        } else {
            (index + 1) * (width + SLACK_PIXELS)
        };
        scratch.runs.clear();
        match strategy {
            RowStrategy::Scanline => {
                self.spans(row, index, 0..self.lattice.columns - 1, start, scratch)
            }
            RowStrategy::ScanlineWithFixups => scratch
                .runs
                .extend(Some(scratch.covered[index].clone()).filter(|run| !run.is_empty())),
            RowStrategy::Mixed if scratch.uncovered[index].is_empty() => {
                scratch.runs.push(0..width)
            }
            RowStrategy::Mixed => runs(&scratch.u[start..start + width], &mut scratch.runs),
        }
        start
    }

    /// Samples a row with known coordinates and fills what is outside. `first`: index of the row's
    /// first pixel in `out`.
    fn paint(
        &self,
        sampled: FootprintSource<'_>,
        (row, start): (u32, usize),
        scratch: &StripScratch,
        mut samples: Option<&mut AveragedSamples>,
        (first, out): (usize, &mut [u8]),
    ) {
        let FootprintSource {
            kernel,
            source,
            level,
            filter,
            channels,
        } = sampled;
        let width = self.width();
        let depth = source.pixmap().depth();
        let pixel = channels.count() * depth.bytes();
        let Window {
            columns,
            first: (left, _),
            ..
        } = &self.window;
        // What is drawn of a run, and its pixels in `out`.
        let drawn = |run: &Range<usize>| {
            let run = run.start.max(columns.start)..run.end;
            let at = |column: usize| first + left + column - columns.start;
            (!run.is_empty()).then(|| (run.clone(), at(run.start)..at(run.end)))
        };
        if let Some(colour) = sampler::outside_pixel(self.outside, depth) {
            for (_, pixels) in gaps(&scratch.runs, width).filter_map(|gap| drawn(&gap)) {
                sampler::fill(
                    &mut out[pixels.start * pixel..pixels.end * pixel],
                    &colour[..pixel],
                );
            }
        }
        for (run, pixels) in scratch.runs.iter().filter_map(drawn) {
            let (u, v) = (
                &scratch.u[start + run.start..],
                &scratch.v[start + run.start..],
            );
            match (&self.footprints, &mut samples) {
                (Some(footprints), Some(samples)) => {
                    footprints.sample(
                        sampled,
                        (row, run.start, run.len()),
                        // Kernels may read behind the row, too.
                        (
                            &u[..run.len() + SLACK_PIXELS],
                            &v[..run.len() + SLACK_PIXELS],
                        ),
                        samples,
                        (pixels.start, out),
                    );
                }
                _ => {
                    let (u, v) = (&u[..run.len()], &v[..run.len()]);
                    let out = &mut out[pixels.start * pixel..pixels.end * pixel];
                    sampler::sample(kernel, source.level(level), filter, u, v, channels, out);
                }
            }
        }
    }

    /// Samples points from now on.
    #[cfg(test)]
    pub(super) fn sample_points(&mut self) {
        self.footprints = None;
    }

    /// Whether a row is drawn by column crossings, with or without fixups.
    #[cfg(test)]
    pub(super) fn crosses(&self, row: u32) -> bool {
        self.strategies.of(row) != RowStrategy::Mixed
    }

    /// Whether a row is drawn by column crossings alone.
    #[cfg(test)]
    pub(super) fn is_plain(&self, row: u32) -> bool {
        self.strategies.of(row) == RowStrategy::Scanline
    }

    /// Whether a row is drawn by crossings on some columns and by cells on others.
    #[cfg(test)]
    pub(super) fn is_mixed(&self, row: u32) -> bool {
        self.strategies.of(row) == RowStrategy::Mixed && self.strategies.is_splittable(row)
    }

    /// A row's coordinates and its covered runs.
    #[cfg(test)]
    pub(super) fn row(&self, row: u32) -> (Vec<f32>, Vec<f32>, Vec<Range<usize>>) {
        let mut scratch = self.scratch();
        let strip = row..row + 1;
        self.prepare(&strip, &mut scratch, &|| false);
        let start = self.coordinates(row, &strip, &mut scratch);
        let width = self.width();
        (
            scratch.u[start..start + width].to_vec(),
            scratch.v[start..start + width].to_vec(),
            scratch.runs,
        )
    }
}
