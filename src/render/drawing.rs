//! A posed grid drawn strip by strip. Two ways lead to a row's coordinates: column crossings where every cell that the row touches is sound
//! and the row crosses every column (then the posed picture is one run of pixels), and cell by cell elsewhere. Which way a row goes depends on
//! the mesh alone, and each row is drawn by itself: any banding gives the same bytes. O(cells touched + pixels) a strip.

use std::ops::Range;

use super::border::Border;
use super::cell::{self, Canvas, Line};
use super::edge::Edge;
use super::kernel::{CellRow, Kernel, NOTES, Spans};
use super::lattice::{BLOCK, LIMIT, Lattice, column_centre, first_row, row_centre};
use super::sampler;
use super::source::Source;
use super::{Outside, RenderOptions};
use crate::geometry::Point;
use crate::pixmap::Channels;

/// Rows whose coordinates are made together.
const STRIP: u32 = 16;
/// Pixels beyond the row that kernels may write.
const SLACK: usize = 16;
/// The farthest pixel that single precision tells apart from its neighbours by less than 1/256 px.
const FARTHEST: u32 = 1 << 15;
/// Where nothing is painted, u is below this.
const BARE: f32 = f32::NEG_INFINITY;

/// A mesh that is ready to be drawn.
#[derive(Debug)]
pub(super) struct Drawing {
    pub(super) lattice: Lattice,
    border: Border,
    options: RenderOptions,
    kernel: Kernel,
    /// The source is read reduced by 2^level.
    level: u32,
    /// Whether a row is drawn cell by cell.
    general: Vec<bool>,
    /// Every pixel of the target is certainly covered.
    pub(super) covered: bool,
}

/// Coordinates of a strip and what they are made from; one a band.
#[derive(Debug, Default)]
struct Scratch {
    u: Vec<f32>,
    v: Vec<f32>,
    x_crossings: Vec<f32>,
    v_crossings: Vec<f32>,
    notes: Vec<[f32; BLOCK]>,
    first: Vec<u32>,
    runs: Vec<Range<usize>>,
    /// Pixels from one row's coordinates to the next one's: 0 where rows are made and used one by one.
    pitch: usize,
}

impl Drawing {
    pub(super) fn new(lattice: Lattice, options: RenderOptions, level: u32, kernel: Kernel) -> Self {
        let mut border = Border::new(&lattice);
        let covered = border.surrounds(options.target);
        if !covered && options.outside == Outside::Edge {
            border.index();
        }
        let general = general_rows(&lattice, &options, kernel);
        Self { lattice, border, options, kernel, level, general, covered }
    }

    /// Draws target rows.
    pub(super) fn band(&self, source: &Source, channels: Channels, rows: Range<u32>, out: &mut [u8]) {
        let source = source.level(self.level);
        let pixel = channels.count() * source.pixmap().depth().bytes();
        let width = self.options.target.width() as usize;
        let mut scratch = self.scratch();
        for first in rows.clone().step_by(STRIP as usize) {
            let strip = first..rows.end.min(first.saturating_add(STRIP));
            let at = (strip.start - rows.start) as usize * width * pixel;
            let out = &mut out[at..at + strip.len() * width * pixel];
            self.prepare(&strip, &mut scratch);
            for (row, out) in strip.clone().zip(out.chunks_exact_mut(width * pixel)) {
                let line = self.coordinates(row, &strip, &mut scratch);
                self.paint(source, channels, row, line, &mut scratch, out);
            }
        }
    }

    fn scratch(&self) -> Scratch {
        let blocks = self.lattice.pitch / BLOCK;
        let crossings = STRIP as usize * (self.lattice.pitch + BLOCK);
        Scratch {
            x_crossings: vec![0.0; crossings],
            v_crossings: vec![0.0; crossings],
            notes: vec![[0.0; BLOCK]; blocks * NOTES],
            first: vec![0; (blocks + 1) * BLOCK],
            ..Scratch::default()
        }
    }

    /// What the rows of a strip have in common: crossings of the columns, and all that is drawn cell by cell.
    fn prepare(&self, strip: &Range<u32>, scratch: &mut Scratch) {
        let general = &self.general[strip.start as usize..strip.end as usize];
        let any = general.iter().any(|&general| general);
        let pitch = self.options.target.width() as usize + SLACK;
        scratch.pitch = if any { pitch } else { 0 };
        let size = if any { strip.len() } else { 1 } * pitch;
        if scratch.u.len() < size {
            scratch.u.resize(size, BARE);
            scratch.v.resize(size, 0.0);
        }
        if general.iter().any(|&general| !general) {
            self.kernel.crossings(&self.lattice, strip.clone(), &mut scratch.x_crossings, &mut scratch.v_crossings);
        }
        if any {
            scratch.u[..size].fill(BARE);
            let mut canvas = Strip { first: strip.start, general, pitch, u: &mut scratch.u, v: &mut scratch.v };
            for cell in self.lattice.cells_touching(strip.clone()) {
                cell::draw(&self.lattice, cell, strip, self.options.target.width(), &mut canvas);
            }
        }
    }

    /// Finds a row's coordinates and notes the runs of pixels that the picture covers; returns where the row begins in the scratch.
    fn coordinates(&self, row: u32, strip: &Range<u32>, scratch: &mut Scratch) -> usize {
        let width = self.options.target.width() as usize;
        let index = (row - strip.start) as usize;
        let start = index * scratch.pitch;
        scratch.runs.clear();
        if self.general[row as usize] {
            runs(&scratch.u[start..start + width], &mut scratch.runs);
            return start;
        }
        let stride = self.lattice.pitch + BLOCK;
        let covered = self.covered_run(row);
        let mut spans = Spans {
            x: &scratch.x_crossings[index * stride..(index + 1) * stride],
            v: &scratch.v_crossings[index * stride..(index + 1) * stride],
            u: &self.lattice.u,
            columns: self.lattice.columns,
            width,
            covered: covered.clone(),
            notes: &mut scratch.notes,
            first: &mut scratch.first,
        };
        self.kernel.spans(&mut spans, &mut scratch.u[start..start + width + SLACK], &mut scratch.v[start..start + width + SLACK]);
        if !covered.is_empty() {
            scratch.runs.push(covered);
        }
        start
    }

    /// The pixels between the first and the last column, exactly; for rows that cross both once.
    fn covered_run(&self, row: u32) -> Range<usize> {
        let width = self.options.target.width() as usize;
        let pixel = |column| self.crossing(column, row).map_or(0, |pixel| usize::try_from(pixel).unwrap_or(0).min(width));
        let (first, end) = (pixel(0), pixel(self.lattice.columns - 1));
        first..end.max(first)
    }

    /// The first pixel right of where a column crosses a row.
    fn crossing(&self, column: usize, row: u32) -> Option<i64> {
        let y = row_centre(row);
        let (mut above, mut below) = (0, self.lattice.rows - 1);
        // Invariant of a column that crosses once: it is above the row at `above`, below it at `below`.
        while below - above > 1 {
            let middle = (above + below) / 2;
            if i64::from(self.lattice.y[middle * self.lattice.pitch + column]) <= y { above = middle } else { below = middle }
        }
        Edge::new(self.lattice.corner(column, above), self.lattice.corner(column, below))?.crossing(y).map(|crossing| crossing.pixel)
    }

    /// Samples a row whose coordinates are known, and paints what lies outside.
    fn paint(&self, source: &Source, channels: Channels, row: u32, start: usize, scratch: &mut Scratch, out: &mut [u8]) {
        let width = self.options.target.width() as usize;
        let depth = source.pixmap().depth();
        let pixel = channels.count() * depth.bytes();
        let whole = scratch.runs.first().is_some_and(|run| run.len() == width);
        if !whole {
            if let Some(colour) = sampler::outside_pixel(self.options.outside, depth) {
                for gap in gaps(&scratch.runs, width) {
                    out[gap.start * pixel..gap.end * pixel].chunks_exact_mut(pixel).for_each(|p| p.copy_from_slice(&colour[..pixel]));
                }
            } else {
                #[expect(clippy::cast_precision_loss, reason = "rows on the target have far fewer than 53 bits")]
                let y = row_centre(row) as f64;
                for x in gaps(&scratch.runs, width).flatten() {
                    (scratch.u[start + x], scratch.v[start + x]) = self.border.nearest(Point::new(column_centre(x), y));
                }
                scratch.runs.clear();
                scratch.runs.push(0..width);
            }
        }
        for run in &scratch.runs {
            let (u, v) = (&scratch.u[start..][run.clone()], &scratch.v[start..][run.clone()]);
            sampler::sample(self.kernel, source, self.options.filter, u, v, channels, &mut out[run.start * pixel..run.end * pixel]);
        }
    }

    /// Whether a row is drawn cell by cell.
    #[cfg(test)]
    pub(super) fn is_general(&self, row: u32) -> bool {
        self.general[row as usize]
    }

    /// A row's coordinates and the runs that are covered.
    #[cfg(test)]
    pub(super) fn row(&self, row: u32) -> (Vec<f32>, Vec<f32>, Vec<Range<usize>>) {
        let mut scratch = self.scratch();
        let strip = row..row + 1;
        self.prepare(&strip, &mut scratch);
        let start = self.coordinates(row, &strip, &mut scratch);
        let width = self.options.target.width() as usize;
        (scratch.u[start..start + width].to_vec(), scratch.v[start..start + width].to_vec(), scratch.runs)
    }
}

/// The rows of a strip that are drawn cell by cell.
struct Strip<'a> {
    first: u32,
    general: &'a [bool],
    pitch: usize,
    u: &'a mut [f32],
    v: &'a mut [f32],
}

impl Canvas for Strip<'_> {
    fn wants(&self, row: u32) -> bool {
        self.general[(row - self.first) as usize]
    }

    fn paint(&mut self, row: u32, pixels: Range<usize>, line: Line) {
        let start = (row - self.first) as usize * self.pitch;
        let (u, v) = (&mut self.u[start..][pixels.clone()], &mut self.v[start..][pixels]);
        let mut k = 0.0;
        for (u, v) in u.iter_mut().zip(v) {
            *u = line.u + k * line.du;
            *v = line.v + k * line.dv;
            k += 1.0;
        }
    }
}

/// The runs of painted pixels.
fn runs(u: &[f32], runs: &mut Vec<Range<usize>>) {
    let mut at = 0;
    while let Some(start) = u[at..].iter().position(|&u| u > BARE).map(|k| at + k) {
        at = u[start..].iter().position(|&u| u <= BARE).map_or(u.len(), |k| start + k);
        runs.push(start..at);
    }
}

/// What lies between runs.
fn gaps(runs: &[Range<usize>], width: usize) -> impl Iterator<Item = Range<usize>> {
    let starts = std::iter::once(0).chain(runs.iter().map(|run| run.end));
    let ends = runs.iter().map(|run| run.start).chain(std::iter::once(width));
    starts.zip(ends).map(|(start, end)| start..end).filter(|gap| !gap.is_empty())
}

/// Which target rows are drawn cell by cell: those that touch a cell that is not sound, and those that do not cross every column.
fn general_rows(lattice: &Lattice, options: &RenderOptions, kernel: Kernel) -> Vec<bool> {
    let height = options.target.height();
    if height > FARTHEST || options.target.width() > FARTHEST {
        return vec![true; height as usize];
    }
    let clip = |y: i32| usize::try_from(first_row(y)).unwrap_or(0).min(height as usize);
    let mut general = vec![false; height as usize];
    let line = |j: usize| &lattice.y[j * lattice.pitch..][..lattice.columns];
    let top = line(0).iter().fold(-LIMIT, |top, &y| top.max(y));
    let bottom = line(lattice.rows - 1).iter().fold(LIMIT, |bottom, &y| bottom.min(y));
    general[..clip(top)].fill(true);
    general[clip(bottom).max(clip(top))..].fill(true);

    let cells = lattice.columns - 1;
    let row_of_cells = |j: usize| {
        let line = |j: usize| (&lattice.x[j * lattice.pitch..][..lattice.pitch], &lattice.y[j * lattice.pitch..][..lattice.pitch]);
        let unit = lattice.unit.recip();
        CellRow { top: line(j), bottom: line(j + 1), u: &lattice.u, height: (lattice.v[j + 1] - lattice.v[j]) * unit, unit }
    };
    let (mut above, mut below) = (vec![0.0; lattice.columns], vec![0.0; lattice.columns]);
    let mut sound = vec![false; cells];
    for j in 0..lattice.rows - 1 {
        let row = row_of_cells(j);
        if j + 2 < lattice.rows {
            kernel.bends(&row, &row_of_cells(j + 1), &mut below);
        } else {
            below.fill(0.0);
        }
        kernel.sound(&row, &above, &below, &mut sound);
        for (i, _) in sound.iter().enumerate().filter(|(_, sound)| !**sound) {
            let ys = [row.top.1[i], row.top.1[i + 1], row.bottom.1[i], row.bottom.1[i + 1]];
            let (top, bottom) = ys.iter().fold((i32::MAX, i32::MIN), |(top, bottom), &y| (top.min(y), bottom.max(y)));
            general[clip(top)..clip(bottom)].fill(true);
        }
        std::mem::swap(&mut above, &mut below);
    }
    general
}
