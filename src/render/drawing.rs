//! A posed grid drawn a few rows at a time. Two ways lead to a row's coordinates: column crossings, where all cells between two columns are sound
//! (`kernel::sound`) and the row crosses both, and cell by cell elsewhere (`mixed` divides them). Which way is taken depends on the mesh and
//! the row alone: any banding gives the same bytes. O(cells touched + pixels).

use std::ops::Range;

use super::border::Border;
use super::cell::{self, Canvas, Line};
use super::edge::Edge;
use super::kernel::{CellRow, Kernel, NOTES, SOUND, Spans, UPRIGHT};
use super::lattice::{BLOCK, LIMIT, Lattice, Reach, column_centre, row_centre};
use super::mixed::Kinds;
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
/// u where nothing is painted; no place has it.
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
    /// How each cell may be drawn, `[rows - 1][columns - 1]`.
    soundness: Vec<u8>,
    /// The rows that cross every column an odd number of times.
    crossing: Range<u32>,
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
    /// It crosses every column and meets upright cells only: the same, then the cells of bent strips over it.
    Ordered,
    /// Good strips by column crossings, all else cell by cell.
    Divided,
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
    kinds: Kinds,
    good: Vec<Range<usize>>,
    /// The row of cells where each column last crossed a row.
    cells: Vec<usize>,
    /// What each ordered row of the strip covers.
    covered: Vec<Range<usize>>,
    /// Pixels of each divided row that nothing is painted on.
    bare: Vec<usize>,
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
        let crossing = rows_that_cross(&lattice, options.target.height());
        let (soundness, ways) = sound_cells(&lattice, &options, &crossing, kernel);
        Self { lattice, border, options, kernel, level, soundness, crossing, ways, covered }
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
        scratch.pitch = if all_plain { 0 } else { pitch };
        let size = if all_plain { 1 } else { strip.len() } * pitch;
        if scratch.u.len() < size {
            scratch.u.resize(size, BARE);
            scratch.v.resize(size, 0.0);
        }
        scratch.x_crossings.fill(0.0);
        scratch.v_crossings.fill(0.0);
        self.kernel.crossings(&self.lattice, strip.clone(), &mut scratch.x_crossings, &mut scratch.v_crossings);
        if all_plain {
            return;
        }
        let all_cross = self.crossing.start <= strip.start && strip.end <= self.crossing.end;
        scratch.kinds.begin(&self.lattice, &self.soundness, strip, all_cross);
        scratch.covered.clear();
        scratch.bare.clear();
        scratch.bare.resize(strip.len(), 0);
        for (index, (row, way)) in strip.clone().zip(ways).enumerate() {
            scratch.runs.clear();
            if *way == Way::Ordered {
                self.spans(row, index, 0..self.lattice.columns - 1, scratch);
            }
            scratch.covered.push(scratch.runs.first().cloned().unwrap_or_default());
            if *way != Way::Divided {
                continue;
            }
            let stride = self.lattice.pitch + BLOCK;
            let mut good = std::mem::take(&mut scratch.good);
            scratch.kinds.decide(&self.lattice, row, &scratch.x_crossings[index * stride..(index + 1) * stride], &mut good);
            for cells in &good {
                self.spans(row, index, cells.clone(), scratch);
            }
            for gap in gaps(&scratch.runs, width as usize) {
                scratch.bare[index] += gap.len();
                scratch.u[index * pitch..][gap].fill(BARE);
            }
            scratch.good = good;
        }
        let kinds = &scratch.kinds;
        let cells = |i: &(usize, usize)| kinds.some(i.0);
        let draw = |cell: (usize, usize), canvas: &mut Strip| {
            let sound = self.soundness[cell.1 * (self.lattice.columns - 1) + cell.0] == SOUND;
            cell::draw(self.kernel, &self.lattice, cell, sound, strip, width, canvas);
        };
        let (u, v) = (&mut scratch.u, &mut scratch.v);
        let mut canvas = Strip { first: strip.start, kinds, ways, way: Way::Ordered, pitch, u, v, bare: &mut scratch.bare };
        if ways.contains(&Way::Ordered) {
            self.lattice.cells_touching(strip.clone()).filter(cells).for_each(|cell| draw(cell, &mut canvas));
        }
        if ways.contains(&Way::Divided) {
            // From the last cell back, bare pixels only: the same picture, and no more work where the strip is full, however often it is covered.
            canvas.way = Way::Divided;
            for cell in self.lattice.cells_touching(strip.clone()).filter(cells).rev() {
                if canvas.bare.iter().all(|&bare| bare == 0) {
                    break;
                }
                draw(cell, &mut canvas);
            }
        }
    }

    /// Finds a row's coordinates and notes the runs of pixels that the picture covers; returns where the row begins in the scratch.
    fn coordinates(&self, row: u32, strip: &Range<u32>, scratch: &mut Scratch) -> usize {
        let index = (row - strip.start) as usize;
        let start = index * scratch.pitch;
        scratch.runs.clear();
        match self.ways[row as usize] {
            Way::Plain => self.spans(row, index, 0..self.lattice.columns - 1, scratch),
            Way::Ordered => scratch.runs.extend(Some(scratch.covered[index].clone()).filter(|run| !run.is_empty())),
            Way::Divided => runs(&scratch.u[start..start + self.options.target.width() as usize], &mut scratch.runs),
        }
        start
    }

    /// Coordinates of a row between the first and the last column of a range of good strips, and the run of pixels that they cover.
    fn spans(&self, row: u32, index: usize, cells: Range<usize>, scratch: &mut Scratch) {
        let width = self.options.target.width() as usize;
        let mut pixel = |column: usize| {
            let crossing = self.crossing(column, row, &mut scratch.cells[column]);
            crossing.map_or(0, |pixel| usize::try_from(pixel).unwrap_or(0).min(width))
        };
        let covered = pixel(cells.start)..pixel(cells.end);
        if covered.is_empty() {
            return;
        }
        let stride = self.lattice.pitch + BLOCK;
        let crossings = index * stride + cells.start..(index + 1) * stride;
        let mut spans = Spans {
            x: &scratch.x_crossings[crossings.clone()],
            v: &scratch.v_crossings[crossings],
            u: &self.lattice.u[cells.start..],
            columns: cells.len() + 1,
            width,
            covered: covered.clone(),
            notes: &mut scratch.notes,
            first: &mut scratch.first,
        };
        let row = index * scratch.pitch..index * scratch.pitch + width + SLACK;
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

/// The rows of a strip in which cells are drawn one by one.
struct Strip<'a> {
    first: u32,
    kinds: &'a Kinds,
    ways: &'a [Way],
    /// The rows that are drawn: ordered ones are painted over, divided ones where they are bare.
    way: Way,
    pitch: usize,
    u: &'a mut [f32],
    v: &'a mut [f32],
    bare: &'a mut [usize],
}

impl Canvas for Strip<'_> {
    fn wants(&self, row: u32, column: usize) -> bool {
        let index = (row - self.first) as usize;
        self.ways[index] == self.way && (self.way == Way::Ordered || self.bare[index] > 0) && self.kinds.drawn(row, column)
    }

    fn backwards(&self) -> bool {
        self.way == Way::Divided
    }

    fn paint(&mut self, row: u32, pixels: Range<usize>, line: Line) {
        let index = (row - self.first) as usize;
        let (u, v) = (&mut self.u[index * self.pitch..][pixels.clone()], &mut self.v[index * self.pitch..][pixels]);
        let (mut k, mut painted) = (0.0, 0);
        for (u, v) in u.iter_mut().zip(v) {
            if self.way == Way::Ordered || *u == BARE {
                *u = line.u + k * line.du;
                *v = line.v + k * line.dv;
                painted += 1;
            }
            k += 1.0;
        }
        self.bare[index] = self.bare[index].saturating_sub(painted);
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

/// How cells and target rows are drawn.
fn sound_cells(lattice: &Lattice, options: &RenderOptions, crossing: &Range<u32>, kernel: Kernel) -> (Vec<u8>, Vec<Way>) {
    let height = options.target.height();
    let cells = lattice.columns - 1;
    let mut soundness = vec![0; cells * (lattice.rows - 1)];
    let mut ways = vec![Way::Divided; height as usize];
    if height > FARTHEST || options.target.width() > FARTHEST {
        return (soundness, ways);
    }
    if !crossing.is_empty() {
        ways[crossing.start as usize..crossing.end as usize].fill(Way::Plain);
    }
    let row_of_cells = |j: usize| {
        let line = |j: usize| (&lattice.x[j * lattice.pitch..][..lattice.pitch], &lattice.y[j * lattice.pitch..][..lattice.pitch]);
        let unit = lattice.unit.recip();
        CellRow { top: line(j), bottom: line(j + 1), u: &lattice.u, height: (lattice.v[j + 1] - lattice.v[j]) * unit, unit }
    };
    let (mut above, mut below) = (vec![0.0; lattice.columns], vec![0.0; lattice.columns]);
    for (j, soundness) in soundness.chunks_exact_mut(cells).enumerate() {
        let row = row_of_cells(j);
        if j + 2 < lattice.rows {
            kernel.bends(&row, &row_of_cells(j + 1), &mut below);
        } else {
            below.fill(0.0);
        }
        kernel.soundness(&row, &above, &below, soundness);
        if !soundness.iter().fold(true, |all, &s| all & (s == SOUND)) {
            for (i, &soundness) in soundness.iter().enumerate().filter(|(_, s)| **s != SOUND) {
                let way = if soundness == UPRIGHT { Way::Ordered } else { Way::Divided };
                let rows = lattice.cell_reach(i, j).rows(&(0..height));
                for row in rows {
                    ways[row as usize] = ways[row as usize].max(way);
                }
            }
        }
        std::mem::swap(&mut above, &mut below);
    }
    (soundness, ways)
}
