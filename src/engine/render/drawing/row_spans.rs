//! Which pixels of a row lie between which columns of the grid: the part of a row that column
//! crossings give, and the pixels that it covers.

use std::ops::Range;

use super::{Drawing, SLACK_PIXELS, StripScratch};
use crate::render::edge::Edge;
use crate::render::kernel::{Spans, UNCOVERED};
use crate::render::row_split::CROSSING_ERROR_PX;
use crate::render::snapped_grid::{BLOCK_COLUMNS, row_centre};

impl Drawing {
    /// Coordinates of a split row between the columns drawn by cells, from `start` on in the
    /// scratch, the rest uncovered; returns the covered range.
    pub(super) fn divided(
        &self,
        row: u32,
        index: usize,
        start: usize,
        scratch: &mut StripScratch,
    ) -> Range<usize> {
        let width = self.width();
        let stride = self.lattice.pitch + BLOCK_COLUMNS;
        scratch
            .split
            .split(index, &scratch.x_crossings[index * stride..]);
        let parts = std::mem::take(&mut scratch.split.parts);
        let (mut column, mut end, mut uncovered) = (0, 0, width..0);
        let mut clear = |pixels: Range<usize>, u: &mut [f32]| {
            if !pixels.is_empty() {
                uncovered = uncovered.start.min(pixels.start)..pixels.end;
                u[start..][pixels].fill(UNCOVERED);
            }
        };
        let cells = self.lattice.columns - 1;
        for per_cell in parts
            .iter()
            .map(|part| part.cells.clone())
            .chain(std::iter::once(cells..cells))
        {
            if column < per_cell.start {
                scratch.runs.clear();
                self.spans(row, index, column..per_cell.start, start, scratch);
                if let Some(run) = scratch.runs.pop() {
                    clear(end..run.start, &mut scratch.u);
                    end = run.end;
                }
            }
            column = per_cell.end;
        }
        clear(end..width, &mut scratch.u);
        scratch.u[start + width..][..SLACK_PIXELS].fill(0.0);
        scratch.split.parts = parts;
        uncovered
    }

    /// Coordinates of a row from its crossings of some columns, from `start` on in the scratch, and
    /// the run of pixels between the first and the last.
    pub(super) fn spans(
        &self,
        row: u32,
        index: usize,
        columns: Range<usize>,
        start: usize,
        scratch: &mut StripScratch,
    ) {
        let width = self.width();
        let stride = self.lattice.pitch + BLOCK_COLUMNS;
        let x = &scratch.x_crossings[index * stride..];
        let mut pixel = |column: usize| {
            // Where single precision is certain.
            let place = x[column] - 0.5;
            let beyond = place.ceil() - place;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                clippy::cast_precision_loss,
                reason = "between 0 and the width"
            )]
            if place > 0.0
                && place < width as f32
                && beyond > CROSSING_ERROR_PX
                && beyond < 1.0 - CROSSING_ERROR_PX
            {
                return place.ceil() as usize;
            }
            let crossing = self.crossing(column, row, &mut scratch.cells[column]);
            crossing.map_or(0, |pixel| usize::try_from(pixel).unwrap_or(0).min(width))
        };
        let covered = pixel(columns.start)..pixel(columns.end);
        if covered.is_empty() {
            return;
        }
        let crossings = index * stride + columns.start..(index + 1) * stride;
        let mut spans = Spans {
            x: &scratch.x_crossings[crossings.clone()],
            v: &scratch.v_crossings[crossings],
            u: &self.lattice.u[columns.start..],
            columns: columns.len() + 1,
            width,
            covered: covered.clone(),
            notes: &mut scratch.notes,
            first: &mut scratch.first,
        };
        let row = start..start + width + SLACK_PIXELS;
        self.kernel
            .spans(&mut spans, &mut scratch.u[row.clone()], &mut scratch.v[row]);
        scratch.runs.push(covered);
    }

    /// The first pixel right of a column's single crossing with a row; `cell` is the row of cells
    /// to try first, and where it was found.
    pub(super) fn crossing(&self, column: usize, row: u32, cell: &mut usize) -> Option<i64> {
        let y = row_centre(row);
        let is_above =
            |line: usize| i64::from(self.lattice.y[line * self.lattice.pitch + column]) <= y;
        let (mut above, mut below) = (*cell, *cell + 1);
        if !is_above(above) || is_above(below) {
            (above, below) = (0, self.lattice.rows - 1);
        }
        // The column is above the row at `above` and below it at `below`.
        while below - above > 1 {
            let middle = above.midpoint(below);
            if is_above(middle) {
                above = middle
            } else {
                below = middle
            }
        }
        *cell = above;
        Edge::new(
            self.lattice.corner(column, above),
            self.lattice.corner(column, below),
        )?
        .crossing(y)
        .map(|crossing| crossing.pixel)
    }
}

/// The runs of covered pixels.
pub(super) fn runs(u: &[f32], runs: &mut Vec<Range<usize>>) {
    let mut at = 0;
    while let Some(start) = u[at..].iter().position(|&u| u != UNCOVERED).map(|k| at + k) {
        // Whole groups first, because most runs are long.
        let painted =
            |group: &&[f32; 16]| group.iter().fold(true, |all, &u| all & (u != UNCOVERED));
        at = start + 16 * u[start..].as_chunks().0.iter().take_while(painted).count();
        at = u[at..]
            .iter()
            .position(|&u| u == UNCOVERED)
            .map_or(u.len(), |k| at + k);
        runs.push(start..at);
    }
}

/// The gaps between runs.
pub(super) fn gaps(runs: &[Range<usize>], width: usize) -> impl Iterator<Item = Range<usize>> {
    let starts = std::iter::once(0).chain(runs.iter().map(|run| run.end));
    let ends = runs
        .iter()
        .map(|run| run.start)
        .chain(std::iter::once(width));
    starts
        .zip(ends)
        .map(|(start, end)| start..end)
        .filter(|gap| !gap.is_empty())
}
