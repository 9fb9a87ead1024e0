//! A posed grid drawn a few rows at a time. Two ways lead to a row's coordinates: column crossings, where the row crosses every column and meets
//! upright cells only (those that crossings do not show well enough, `kernel::soundness`, are drawn over them, and the cells beside them in their
//! column, which a chord across both would miss as well), and cell by cell elsewhere.
//! Which way is taken depends on the mesh and the row alone: any banding gives the same bytes. O(cells touched + pixels).

use std::ops::Range;

use super::border::Border;
use super::cell;
use super::edge::Edge;
use super::kernel::{BARE, Canvas, CellRow, Kernel, LANES, NOTES, SOUND, Spans, UPRIGHT};
use super::lattice::{BLOCK, LIMIT, Lattice, Reach, column_centre, row_centre};
use super::sampler;
use super::source::Source;
use super::{Outside, RenderOptions};
use crate::geometry::Point;
use crate::pixmap::Channels;

/// Rows whose coordinates are made together.
const STRIP: u32 = 32;
/// Pixels beyond the row that kernels may write.
const SLACK: usize = LANES;
/// Crossings in f32 are nearer than this to the exact ones, px.
const DOUBT: f32 = 1.0 / 32.0;
/// The farthest pixel that single precision tells apart from its neighbours by less than 1/256 px.
const FARTHEST: u32 = 1 << 15;

/// A mesh that is ready to be drawn.
#[derive(Debug)]
pub(super) struct Drawing {
    pub(super) lattice: Lattice,
    border: Border,
    options: RenderOptions,
    kernel: Kernel,
    /// The source is read reduced by 2^level.
    level: u32,
    /// The cells that crossings do not show well, a bit each, `[rows - 1][blocks]`.
    bent: Vec<u8>,
    /// How each row is drawn.
    ways: Vec<Way>,
    /// Every pixel of the target is certainly covered.
    pub(super) covered: bool,
}

/// How a row is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Way {
    /// It crosses every column and meets sound cells only: by column crossings.
    Plain,
    /// It crosses every column and meets upright cells only: the same, then those that are not shown well over it. Upright cells lie in order,
    /// so that none of them hides another.
    Mended,
    /// Cell by cell.
    Cells,
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
    /// The row of cells where each column last crossed a row.
    cells: Vec<usize>,
    /// What each row of the strip covers that is drawn by crossings.
    covered: Vec<Range<usize>>,
    /// Where each row has pixels that nothing is painted on.
    bare: Vec<Range<usize>>,
}

impl Drawing {
    pub(super) fn new(lattice: Lattice, options: RenderOptions, level: u32, kernel: Kernel) -> Self {
        let mut border = Border::new(&lattice);
        let covered = border.surrounds(options.target);
        if !covered && options.outside == Outside::Edge {
            border.index();
        }
        let crossing = rows_that_cross(&lattice, options.target.height());
        let mut drawing = Self { lattice, border, options, kernel, level, bent: vec![], ways: vec![], covered };
        drawing.judge(&crossing);
        drawing
    }

    /// Decides how target rows are drawn, and notes the cells that are not sound; `crossing` are the rows that cross every column.
    fn judge(&mut self, crossing: &Range<u32>) {
        let (lattice, target) = (&self.lattice, self.options.target);
        let height = target.height();
        self.ways = vec![Way::Cells; height as usize];
        if crossing.is_empty() || height.max(target.width()) > FARTHEST {
            return;
        }
        self.ways[crossing.start as usize..crossing.end as usize].fill(Way::Plain);
        let row_of_cells = |j: usize| {
            let line = |j: usize| (&lattice.x[j * lattice.pitch..][..lattice.pitch], &lattice.y[j * lattice.pitch..][..lattice.pitch]);
            let unit = lattice.unit.recip();
            CellRow { top: line(j), bottom: line(j + 1), u: &lattice.u, height: (lattice.v[j + 1] - lattice.v[j]) * unit, unit }
        };
        let (mut above, mut below) = (vec![0.0; lattice.columns], vec![0.0; lattice.columns]);
        let mut soundness = vec![0; lattice.columns - 1];
        self.bent = vec![0; (lattice.rows - 1) * lattice.blocks()];
        for j in 0..lattice.rows - 1 {
            let row = row_of_cells(j);
            if j + 2 < lattice.rows {
                self.kernel.bends(&row, &row_of_cells(j + 1), &mut below);
            } else {
                below.fill(0.0);
            }
            self.kernel.soundness(&row, &above, &below, &mut soundness);
            if !soundness.iter().fold(true, |all, &s| all & (s == SOUND)) {
                for (i, &soundness) in soundness.iter().enumerate().filter(|(_, s)| **s != SOUND) {
                    // The chord of a row from column to column belongs to all cells that the row meets between them.
                    let (reach, bit) = (lattice.cell_reach(i, j), 1 << (i % BLOCK));
                    let shares = |k: &usize| {
                        let other = lattice.cell_reach(i, *k);
                        other.top < reach.bottom && reach.top < other.bottom
                    };
                    let above = (0..j).rev().take_while(shares);
                    for k in above.chain((j..lattice.rows - 1).take_while(shares)) {
                        self.bent[k * lattice.blocks() + i / BLOCK] |= bit;
                    }
                    let way = if soundness == UPRIGHT { Way::Mended } else { Way::Cells };
                    let rows = reach.rows(&(0..height));
                    for known in &mut self.ways[rows.start as usize..rows.end as usize] {
                        *known = way.max(*known);
                    }
                }
            }
            std::mem::swap(&mut above, &mut below);
        }
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
            cells: vec![0; self.lattice.columns],
            ..Scratch::default()
        }
    }

    /// What the rows of a strip have in common: crossings of the columns, and all that is drawn cell by cell.
    fn prepare(&self, strip: &Range<u32>, scratch: &mut Scratch) {
        let width = self.options.target.width();
        let ways = &self.ways[strip.start as usize..strip.end as usize];
        let all_plain = ways.iter().all(|&way| way == Way::Plain);
        let pitch = width as usize + SLACK;
        // Plain rows are made and used one by one, in the first place; the others stand behind it.
        let size = if all_plain { 1 } else { 1 + strip.len() } * pitch;
        if scratch.u.len() < size {
            scratch.u.resize(size, 0.0);
            scratch.v.resize(size, 0.0);
        }
        if ways.iter().any(|&way| way != Way::Cells) {
            scratch.x_crossings.fill(0.0);
            scratch.v_crossings.fill(0.0);
            self.kernel.crossings(&self.lattice, strip.clone(), &mut scratch.x_crossings, &mut scratch.v_crossings);
        }
        if all_plain {
            return;
        }
        scratch.covered.clear();
        scratch.bare.clear();
        for (index, (row, way)) in strip.clone().zip(ways).enumerate() {
            scratch.runs.clear();
            if *way == Way::Cells {
                let u = &mut scratch.u[(index + 1) * pitch..][..pitch];
                u[..width as usize].fill(BARE);
                u[width as usize..].fill(0.0);
            } else if *way == Way::Mended {
                self.spans(row, index, (index + 1) * pitch, scratch);
            }
            scratch.bare.push(0..width as usize);
            scratch.covered.push(scratch.runs.first().cloned().unwrap_or_default());
        }
        let rows_of = |way: Way| ways.iter().rev().fold(0, |rows, &w| rows << 1 | u32::from(w == way));
        let (u, v, bare) = (&mut scratch.u[pitch..], &mut scratch.v[pitch..], &mut scratch.bare);
        let mut canvas = Canvas { first: strip.start, width: width as usize, pitch, u, v, over: true, bare, open: rows_of(Way::Mended) };
        let blocks = self.lattice.blocks();
        if canvas.open != 0 {
            for j in self.lattice.rows_touching(strip) {
                cell::draw_row(self.kernel, &self.lattice, j, |b| self.bent[j * blocks + b], strip, &mut canvas);
            }
        }
        // From the last cell back, bare pixels only: the same picture, and no more work where the strip is full, however often it is covered.
        (canvas.over, canvas.open) = (false, rows_of(Way::Cells));
        for j in self.lattice.rows_touching(strip).rev() {
            if canvas.open == 0 {
                break;
            }
            cell::draw_row(self.kernel, &self.lattice, j, |b| self.lattice.cells_of(b), strip, &mut canvas);
        }
    }

    /// Finds a row's coordinates and notes the runs of pixels that the picture covers; returns where the row begins in the scratch.
    fn coordinates(&self, row: u32, strip: &Range<u32>, scratch: &mut Scratch) -> usize {
        let index = (row - strip.start) as usize;
        let width = self.options.target.width() as usize;
        let way = self.ways[row as usize];
        let start = if way == Way::Plain { 0 } else { (index + 1) * (width + SLACK) };
        scratch.runs.clear();
        match way {
            Way::Plain => self.spans(row, index, start, scratch),
            Way::Mended => scratch.runs.extend(Some(scratch.covered[index].clone()).filter(|run| !run.is_empty())),
            Way::Cells => runs(&scratch.u[start..start + width], &mut scratch.runs),
        }
        start
    }

    /// Coordinates of a row from its crossings of all columns, from `start` on in the scratch, and the run of pixels between the first and the last.
    fn spans(&self, row: u32, index: usize, start: usize, scratch: &mut Scratch) {
        let width = self.options.target.width() as usize;
        let stride = self.lattice.pitch + BLOCK;
        let x = &scratch.x_crossings[index * stride..];
        let mut pixel = |column: usize| {
            // Where single precision leaves no doubt.
            let place = x[column] - 0.5;
            let beyond = place.ceil() - place;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                clippy::cast_precision_loss,
                reason = "between 0 and the width"
            )]
            if place > 0.0 && place < width as f32 && beyond > DOUBT && beyond < 1.0 - DOUBT {
                return place.ceil() as usize;
            }
            let crossing = self.crossing(column, row, &mut scratch.cells[column]);
            crossing.map_or(0, |pixel| usize::try_from(pixel).unwrap_or(0).min(width))
        };
        let covered = pixel(0)..pixel(self.lattice.columns - 1);
        if covered.is_empty() {
            return;
        }
        let crossings = index * stride..(index + 1) * stride;
        let mut spans = Spans {
            x: &scratch.x_crossings[crossings.clone()],
            v: &scratch.v_crossings[crossings],
            u: &self.lattice.u,
            columns: self.lattice.columns,
            width,
            covered: covered.clone(),
            notes: &mut scratch.notes,
            first: &mut scratch.first,
        };
        let row = start..start + width + SLACK;
        self.kernel.spans(&mut spans, &mut scratch.u[row.clone()], &mut scratch.v[row]);
        scratch.runs.push(covered);
    }

    /// The first pixel right of where a column crosses a row, once; `cell` is the row of cells where it may be, and where it was found.
    fn crossing(&self, column: usize, row: u32, cell: &mut usize) -> Option<i64> {
        let y = row_centre(row);
        let is_above = |line: usize| i64::from(self.lattice.y[line * self.lattice.pitch + column]) <= y;
        let (mut above, mut below) = (*cell, *cell + 1);
        if !is_above(above) || is_above(below) {
            (above, below) = (0, self.lattice.rows - 1);
        }
        // The column is above the row at `above`, below it at `below`.
        while below - above > 1 {
            let middle = above.midpoint(below);
            if is_above(middle) { above = middle } else { below = middle }
        }
        *cell = above;
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
                    sampler::fill(&mut out[gap.start * pixel..gap.end * pixel], &colour[..pixel]);
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

    /// Whether a row is drawn by column crossings, mended or not.
    #[cfg(test)]
    pub(super) fn crosses(&self, row: u32) -> bool {
        self.ways[row as usize] != Way::Cells
    }

    /// Whether a row is drawn by column crossings alone.
    #[cfg(test)]
    pub(super) fn is_plain(&self, row: u32) -> bool {
        self.ways[row as usize] == Way::Plain
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

/// The runs of painted pixels.
fn runs(u: &[f32], runs: &mut Vec<Range<usize>>) {
    let mut at = 0;
    while let Some(start) = u[at..].iter().position(|&u| u != BARE).map(|k| at + k) {
        // Whole groups first: runs are long as a rule.
        let painted = |group: &&[f32; 16]| group.iter().fold(true, |all, &u| all & (u != BARE));
        at = start + 16 * u[start..].as_chunks().0.iter().take_while(painted).count();
        at = u[at..].iter().position(|&u| u == BARE).map_or(u.len(), |k| at + k);
        runs.push(start..at);
    }
}

/// What lies between runs.
fn gaps(runs: &[Range<usize>], width: usize) -> impl Iterator<Item = Range<usize>> {
    let starts = std::iter::once(0).chain(runs.iter().map(|run| run.end));
    let ends = runs.iter().map(|run| run.start).chain(std::iter::once(width));
    starts.zip(ends).map(|(start, end)| start..end).filter(|gap| !gap.is_empty())
}

/// The target rows that begin or end beyond every column.
fn rows_that_cross(lattice: &Lattice, height: u32) -> Range<u32> {
    let line = |j: usize| &lattice.y[j * lattice.pitch..][..lattice.columns];
    let top = line(0).iter().fold(-LIMIT, |top, &y| top.max(y));
    let bottom = line(lattice.rows - 1).iter().fold(LIMIT, |bottom, &y| bottom.min(y));
    Reach { top, bottom }.rows(&(0..height))
}
