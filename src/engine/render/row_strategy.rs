//! Chooses how each row of the target is drawn: by column crossings where cells are upright, cell
//! by cell where they are not. Crossings draw everything between two columns at once; drawing by
//! cells handles any shape, and later cells hide earlier ones. A row may be split between both at
//! columns that it crosses exactly once, if everything drawn by cells lies between two such
//! columns: then neither part hides the other. The choice depends on the mesh and the row alone.
//! Cost: O(cells + rows).

use std::ops::Range;

use super::kernel::{CellRow, Edges, Kernel, Neighbours, SOUND, STEEP, UPRIGHT};
use super::snapped_grid::{BLOCK_COLUMNS, STEPS_PER_PX, SnappedGrid, YRange};

/// Rows are split only if at most one in this number of cells is folded; with more, finding the
/// splits costs more than it saves.
const CELLS_PER_FOLD: usize = 24;
/// Rows are split only if, on average, a block of cells meets at most this multiple of its share of
/// rows.
const MAX_ROW_SHARES: u64 = 16;
/// Rows of cells lower than this at rest, px of the sampled image, and their neighbours are not
/// classified: their columns have no direction.
const LEAST_HEIGHT: f32 = 1.0 / 64.0;
/// The farthest pixel at which single precision still resolves 1/256 px.
const FARTHEST_PX: u32 = 1 << 15;

/// How a row is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum RowStrategy {
    /// Crosses every column and meets only sound cells: drawn by column crossings.
    Scanline,
    /// Crosses every column and meets only upright cells: drawn by column crossings, then the
    /// inaccurate cells over them. Upright cells are ordered, so none hides another.
    ScanlineWithFixups,
    /// Some columns cell by cell, the others as `ScanlineWithFixups` (`row_split`).
    Mixed,
}

/// The strategies of all rows.
#[derive(Debug)]
pub(super) struct RowStrategies {
    rows: Vec<RowStrategy>,
    /// Blocks of cells per row of cells.
    blocks: usize,
    /// Cells that crossings draw inaccurately, one bit each, `[rows - 1][blocks]`.
    inaccurate: Vec<u8>,
    /// Cells that are not upright, in the same layout.
    folded: Vec<u8>,
    /// The rows that may be split.
    splittable: Range<u32>,
}

impl RowStrategies {
    /// For this many rows; `source` is the height of the whole source at this scale.
    pub(super) fn new(lattice: &SnappedGrid, height: u32, source: u32, kernel: Kernel) -> Self {
        let blocks = lattice.blocks();
        let none = vec![0; (lattice.rows - 1) * blocks];
        let mut strategies = Self {
            rows: vec![RowStrategy::Mixed; height as usize],
            blocks,
            inaccurate: none.clone(),
            folded: none,
            splittable: 0..0,
        };
        let crossing = rows_that_cross(lattice, height);
        strategies.rows[crossing.start as usize..crossing.end.max(crossing.start) as usize]
            .fill(RowStrategy::Scanline);
        strategies.classify(lattice, kernel);
        let folded: u32 = strategies
            .folded
            .iter()
            .map(|cells| cells.count_ones())
            .sum();
        let met: u64 = lattice
            .block_ranges
            .iter()
            .map(|range| u64::from(range.bottom.abs_diff(range.top) / STEPS_PER_PX.unsigned_abs()))
            .sum();
        let are_few = folded as usize * CELLS_PER_FOLD <= strategies.folded.len() * BLOCK_COLUMNS;
        if are_few && met <= MAX_ROW_SHARES * u64::from(source) * blocks as u64 {
            strategies.splittable = crossing;
        }
        strategies
    }

    /// The strategy of a row.
    pub(super) fn of(&self, row: u32) -> RowStrategy {
        self.rows[row as usize]
    }

    /// The cells of a row of cells that crossings draw inaccurately.
    pub(super) fn inaccurate(&self, j: usize) -> &[u8] {
        &self.inaccurate[j * self.blocks..][..self.blocks]
    }

    /// The cells of a row of cells that are not upright.
    pub(super) fn folded(&self, j: usize) -> &[u8] {
        &self.folded[j * self.blocks..][..self.blocks]
    }

    /// Whether a row may be split: it crosses every column, few cells are folded, and few of them
    /// meet each row.
    pub(super) fn is_splittable(&self, row: u32) -> bool {
        self.splittable.contains(&row)
    }

    /// Classifies all cells.
    fn classify(&mut self, lattice: &SnappedGrid, kernel: Kernel) {
        let target = 0..u32::try_from(self.rows.len()).unwrap_or(u32::MAX);
        let mut classifier = CellClassifier::new(lattice, kernel);
        // The number of cells of a kind that begin at a row, minus those that end there.
        let (mut fixups, mut mixed) = (
            vec![0_i32; self.rows.len() + 1],
            vec![0_i32; self.rows.len() + 1],
        );
        for j in 0..lattice.rows - 1 {
            for (b, soundness) in classifier.at(j).chunks(BLOCK_COLUMNS).enumerate() {
                let not = |kind: u8| {
                    soundness.iter().enumerate().fold(0_u8, |cells, (k, seen)| {
                        cells | u8::from(seen & kind == 0) << k
                    })
                };
                let mut left = not(SOUND);
                if left == 0 {
                    continue;
                }
                let (at, folded) = (j * self.blocks + b, not(SOUND | UPRIGHT));
                self.inaccurate[at] |= left;
                self.folded[at] = folded;
                while left != 0 {
                    let k = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let (i, range) = (
                        b * BLOCK_COLUMNS + k,
                        lattice.cell_range(b * BLOCK_COLUMNS + k, j),
                    );
                    let (rows, known) = (
                        range.rows(&target),
                        if folded >> k & 1 == 1 {
                            &mut mixed
                        } else {
                            &mut fixups
                        },
                    );
                    known[rows.start as usize] += 1;
                    known[rows.end.max(rows.start) as usize] -= 1;
                    if soundness[k] & STEEP != 0 {
                        self.mark_inaccurate(lattice, i, j, range);
                    }
                }
            }
        }
        for cell in lattice.fine.cells() {
            let (at, bit) = (
                cell.j * self.blocks + cell.i / BLOCK_COLUMNS,
                1 << (cell.i % BLOCK_COLUMNS),
            );
            self.inaccurate[at] |= bit;
            // Where the border is not straight, crossings would paint beyond it.
            self.folded[at] |= if cell.is_ragged { bit } else { 0 };
            let (rows, known) = (
                lattice.cell_range(cell.i, cell.j).rows(&target),
                if cell.is_ragged {
                    &mut mixed
                } else {
                    &mut fixups
                },
            );
            known[rows.start as usize] += 1;
            known[rows.end.max(rows.start) as usize] -= 1;
        }
        let (mut open_fixups, mut open_mixed) = (0, 0);
        for (row, (fixups, mixed)) in self.rows.iter_mut().zip(fixups.iter().zip(&mixed)) {
            (open_fixups, open_mixed) = (open_fixups + fixups, open_mixed + mixed);
            *row = (*row).max(if open_mixed > 0 {
                RowStrategy::Mixed
            } else if open_fixups > 0 {
                RowStrategy::ScanlineWithFixups
            } else {
                RowStrategy::Scanline
            });
        }
    }

    /// The chord of a row between two columns affects all cells that the row meets between them.
    fn mark_inaccurate(&mut self, lattice: &SnappedGrid, i: usize, j: usize, range: YRange) {
        let shares = |k: &usize| {
            let other = lattice.cell_range(i, *k);
            other.top < range.bottom && range.top < other.bottom
        };
        for k in (0..j)
            .rev()
            .take_while(shares)
            .chain((j + 1..lattice.rows - 1).take_while(shares))
        {
            self.inaccurate[k * self.blocks + i / BLOCK_COLUMNS] |= 1 << (i % BLOCK_COLUMNS);
        }
    }
}

/// Classifies the cells, one row of cells after the other.
struct CellClassifier<'a> {
    lattice: &'a SnappedGrid,
    kernel: Kernel,
    /// Lines above and below the previous row, this row, and the next row.
    lines: [Edges; 4],
    /// Columns of the same rows.
    columns: [Edges; 3],
    soundness: Vec<u8>,
}

impl<'a> CellClassifier<'a> {
    fn new(lattice: &'a SnappedGrid, kernel: Kernel) -> Self {
        let edges = || Edges {
            x: vec![0.0; lattice.columns],
            y: vec![0.0; lattice.columns],
        };
        let (lines, columns) = (
            std::array::from_fn(|_| edges()),
            std::array::from_fn(|_| edges()),
        );
        let mut classifier = Self {
            lattice,
            kernel,
            lines,
            columns,
            soundness: vec![0; lattice.columns - 1],
        };
        classifier.line(0);
        classifier.column(0);
        classifier.line(1);
        classifier
    }

    /// Appends a grid line.
    fn line(&mut self, j: usize) {
        let (x, y) = self.vertices(j);
        self.lines.rotate_left(1);
        self.kernel
            .edges((x, y), (&x[1..], &y[1..]), 1.0, &mut self.lines[3]);
    }

    /// Appends the columns of a row of cells.
    fn column(&mut self, j: usize) {
        let (above, below, per_px) = (self.vertices(j), self.vertices(j + 1), 1.0 / self.height(j));
        self.columns.rotate_left(1);
        self.kernel
            .edges(above, below, per_px, &mut self.columns[2]);
    }

    fn vertices(&self, j: usize) -> (&'a [i32], &'a [i32]) {
        let line = j * self.lattice.pitch..j * self.lattice.pitch + self.lattice.columns;
        (&self.lattice.x[line.clone()], &self.lattice.y[line])
    }

    /// Height of a row of cells at rest, px of the sampled image.
    fn height(&self, j: usize) -> f32 {
        (self.lattice.v[j + 1] - self.lattice.v[j]) / self.lattice.unit
    }

    /// How the cells of a row may be drawn: [`SOUND`], [`UPRIGHT`] or 0; steep cells also have the
    /// bit [`STEEP`]. Rows must be requested in order.
    fn at(&mut self, j: usize) -> &[u8] {
        let (lattice, last) = (self.lattice, self.lattice.rows - 2);
        if j < last {
            self.column(j + 1);
            self.line(j + 2);
        } else {
            self.columns.rotate_left(1);
            self.lines.rotate_left(1);
        }
        let [over, top, bottom, under] = &self.lines;
        let [above, columns, below] = &self.columns;
        let (over, above, before) = if j > 0 {
            (over, above, j - 1)
        } else {
            (top, columns, j)
        };
        let (under, below, behind) = if j < last {
            (under, below, j + 1)
        } else {
            (bottom, columns, j)
        };
        let height = self
            .height(before)
            .min(self.height(j))
            .min(self.height(behind));
        let (lines, columns) = ([over, top, bottom, under], [above, columns, below]);
        self.kernel.soundness(
            &Neighbours {
                lines,
                columns,
                height,
                u: &lattice.u,
                unit: lattice.unit.recip(),
                tolerance: lattice.crossing_error,
            },
            &mut self.soundness,
        );
        let is_far = |line: (&[i32], &[i32])| {
            [line.0, line.1]
                .into_iter()
                .flatten()
                .fold(0, |far, place| far.max(place.unsigned_abs()))
                >= FARTHEST_PX * STEPS_PER_PX.unsigned_abs()
        };
        if height < LEAST_HEIGHT || is_far(self.vertices(j)) || is_far(self.vertices(j + 1)) {
            self.soundness.fill(0);
        }
        if self.soundness.iter().fold(0, |any, &s| any | s) & STEEP != 0 {
            self.classify_steep(j);
        }
        &self.soundness
    }

    /// Classifies the steep cells of a row.
    fn classify_steep(&mut self, j: usize) {
        let (lattice, unit) = (self.lattice, self.lattice.unit.recip());
        let row = |j: usize| CellRow {
            top: self.vertices(j),
            bottom: self.vertices(j + 1),
            u: &lattice.u,
            height: self.height(j),
            unit,
            tolerance: lattice.crossing_error,
        };
        let (mut above, mut below) = (vec![0.0; lattice.columns], vec![0.0; lattice.columns]);
        if j > 0 {
            self.kernel.bends(&row(j - 1), &row(j), &mut above);
        }
        if j + 2 < lattice.rows {
            self.kernel.bends(&row(j), &row(j + 1), &mut below);
        }
        let mut steepness = vec![0; self.soundness.len()];
        self.kernel
            .steepness(&row(j), &above, &below, &mut steepness);
        for (seen, steep) in self
            .soundness
            .iter_mut()
            .zip(&steepness)
            .filter(|(seen, _)| **seen & STEEP != 0)
        {
            *seen = if *steep == SOUND {
                SOUND
            } else {
                *steep | STEEP
            };
        }
    }
}

/// The target rows that cross every column.
fn rows_that_cross(lattice: &SnappedGrid, height: u32) -> Range<u32> {
    let line = |j: usize| &lattice.y[j * lattice.pitch..][..lattice.columns];
    let top = line(0).iter().fold(i32::MIN, |top, &y| top.max(y));
    let bottom = line(lattice.rows - 1)
        .iter()
        .fold(i32::MAX, |bottom, &y| bottom.min(y));
    YRange { top, bottom }.rows(&(0..height))
}
