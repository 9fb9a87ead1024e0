//! What the quads of the cut lattice draw, and what their vertices belong to. Every pixel is looked
//! at once for all quads of its cell, so that work does not grow with their number.

use super::lattice::{CheckedWork, index};
use super::pixel::nearest_of_pixel;
use super::{CutLattice, Mask};
use crate::geometry::{CutCell, CutCells, Grid, Point};

/// What the quads of one cell draw.
struct DrawnTexels {
    /// Words of a set.
    words: usize,
    /// The sets of all quads so far, and where those of this cell begin.
    sets: Vec<u64>,
    first: usize,
    /// Texels of each quad, and whether they are stray.
    quads: Vec<(usize, bool)>,
    /// The quads by their parts.
    by_part: Vec<(u32, usize)>,
    /// Parts beside the pixel that is looked at.
    beside: Vec<u32>,
}

impl DrawnTexels {
    fn draw(&mut self, quad: usize, bit: usize) {
        let word = &mut self.sets[self.first + quad * self.words + bit / 64];
        if *word >> (bit % 64) & 1 == 0 {
            *word |= 1 << (bit % 64);
            self.quads[quad].0 += 1;
        }
    }

    /// Looks at all pixels of a cell that is not whole and has quads.
    fn find(&mut self, lattice: &CutLattice, mask: &Mask, column: usize, row: usize) {
        let (side, (width, height)) = (lattice.spacing as usize, mask.size());
        let own = lattice.quads_of(column, row);
        self.first = self.sets.len();
        self.sets.resize(self.first + own.len() * self.words, 0);
        self.quads.clear();
        self.quads.resize(own.len(), (0, false));
        self.by_part.clear();
        let parts = lattice.quads[own.clone()].iter().map(|quad| quad.part);
        self.by_part.extend(parts.zip(0..));
        self.by_part.sort_unstable();
        let (x0, y0) = (column * side, row * side);
        let (wide, high) = (side.min(width - x0), side.min(height - y0));
        for (y, x) in (0..high).flat_map(|y| (0..wide).map(move |x| (y, x))) {
            let (px, py, bit) = (x0 + x, y0 + y, y * side + x);
            if !mask.is_visible(px, py) {
                self.sample(lattice, mask, (px, py, bit), &own);
            } else if let Some(quad) = lattice.quad_at(mask, px, py) {
                self.draw(quad - own.start, bit);
                self.quads[quad - own.start].1 |= mask.is_stray(px, py);
            }
        }
        if self.quads[0].0 == wide * high {
            // The only quad of its cell, which needs no set.
            self.sets.truncate(self.first);
        }
    }

    /// A pixel that is not visible is drawn by the quads beside it, and by those of its cell that
    /// are of one part with quads beside it in other cells.
    fn sample(
        &mut self,
        lattice: &CutLattice,
        mask: &Mask,
        (px, py, bit): (usize, usize, usize),
        own: &std::ops::Range<usize>,
    ) {
        self.beside.clear();
        for y in py.saturating_sub(1)..py + 2 {
            for x in px.saturating_sub(1)..px + 2 {
                match lattice.quad_at(mask, x, y) {
                    Some(quad) if own.contains(&quad) => self.draw(quad - own.start, bit),
                    Some(quad) => {
                        let part = lattice.quads[quad].part;
                        if !self.beside.contains(&part) {
                            self.beside.push(part);
                        }
                    }
                    None => {}
                }
            }
        }
        for k in 0..self.beside.len() {
            let part = self.beside[k];
            let first = self.by_part.partition_point(|(own, _)| *own < part);
            // Such a quad reaches the border of its cell: there are few.
            for at in first..self.by_part.len() {
                let (own, quad) = self.by_part[at];
                if own != part {
                    break;
                }
                self.draw(quad, bit);
            }
        }
    }
}

impl CutLattice {
    /// The quads as they are drawn. A quad draws the visible texels of its component, and those
    /// that are not visible beside them, into which samples reach. `None` when cancelled.
    #[must_use]
    pub fn cells_of(&self, mask: &Mask, cancelled: &dyn Fn() -> bool) -> Option<CutCells> {
        let side = self.spacing as usize;
        let words = (side * side).div_ceil(64);
        let mut cells = Vec::with_capacity(self.quads.len());
        let mut drawn = DrawnTexels {
            words,
            sets: Vec::with_capacity(words * self.sets(mask)),
            first: 0,
            quads: Vec::new(),
            by_part: Vec::new(),
            beside: Vec::new(),
        };
        let mut work = CheckedWork::default();
        for (column, row) in self.every_cell() {
            let quads = &self.quads[self.quads_of(column, row)];
            if quads.is_empty() {
                work.add(1, cancelled)?;
                continue;
            }
            let before = drawn.sets.len();
            if mask.is_whole(column * side, row * side, side) {
                work.add(1, cancelled)?;
                drawn.quads.clear();
            } else {
                work.add(side * side + words * quads.len(), cancelled)?;
                drawn.find(self, mask, column, row);
            }
            let has_sets = drawn.sets.len() > before;
            for (k, quad) in quads.iter().enumerate() {
                let texels = has_sets.then(|| index(before / words + k));
                let is_loose = drawn.quads.get(k).is_some_and(|(_, is_loose)| *is_loose);
                cells.push(CutCell {
                    cell: quad.cell,
                    vertices: quad.vertices,
                    texels,
                    is_loose,
                });
            }
        }
        let mut texels = drawn.sets;
        texels.shrink_to_fit();
        let [width, height] = [mask.size().0, mask.size().1].map(|side| side as f64);
        let grid = Grid::with_cell(width, height, f64::from(self.spacing));
        let vertices = self.vertices.clone();
        Some(CutCells::new(grid, self.spacing, cells, vertices, texels))
    }

    /// Quads in cells that are not whole.
    fn sets(&self, mask: &Mask) -> usize {
        let side = self.spacing as usize;
        let cells = self
            .every_cell()
            .filter(|(column, row)| !mask.is_whole(column * side, row * side, side));
        cells
            .map(|(column, row)| self.quads_of(column, row).len())
            .sum()
    }

    /// Columns and rows of the cells, row by row.
    fn every_cell(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let [columns, rows] = self.cells();
        (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row)))
    }

    /// The pixel inside, counted row by row, to which each vertex belongs: the nearest one of its
    /// quads, or the one that their rim is attached to; none where there is only stray rim far from
    /// all. `None` when cancelled.
    #[must_use]
    pub fn pixels(&self, mask: &Mask, cancelled: &dyn Fn() -> bool) -> Option<Vec<Option<u32>>> {
        let side = self.spacing as usize;
        let mut nearest = vec![(f64::INFINITY, u32::MAX); self.vertices.len()];
        let (width, height) = mask.size();
        let mut work = CheckedWork::default();
        let mut look = |quad: usize, (x, y): (usize, usize), root: (usize, usize)| {
            for vertex in self.quads[quad].vertices {
                let [column, row] = self.vertices[vertex as usize];
                let at = Point::new(
                    (column as usize * side).min(width) as f64,
                    (row as usize * side).min(height) as f64,
                );
                let distance = nearest_of_pixel(root, at, 0.0).distance(at);
                let found = (distance, index(y * width + x));
                let best = &mut nearest[vertex as usize];
                if found < *best {
                    *best = found;
                }
            }
        };
        for (column, row) in self.every_cell() {
            let quads = self.quads_of(column, row);
            if quads.is_empty() {
                work.add(1, cancelled)?;
                continue;
            }
            let (x0, y0) = (column * side, row * side);
            let (last_x, last_y) = ((x0 + side).min(width) - 1, (y0 + side).min(height) - 1);
            if mask.is_whole(x0, y0, side) {
                work.add(4, cancelled)?;
                for at in [(x0, y0), (last_x, y0), (x0, last_y), (last_x, last_y)] {
                    look(quads.start, at, at);
                }
                continue;
            }
            work.add(side * side, cancelled)?;
            for (y, x) in (y0..=last_y).flat_map(|y| (x0..=last_x).map(move |x| (y, x))) {
                if let Some(quad) = self.quad_at(mask, x, y)
                    && let Some(root) = mask.root(x, y)
                {
                    look(quad, (x, y), root);
                }
            }
        }
        let roots = nearest.into_iter().map(|(_, pixel)| {
            let pixel = (pixel != u32::MAX).then_some(pixel as usize)?;
            let (x, y) = mask.root(pixel % width, pixel / width)?;
            Some(index(y * width + x))
        });
        Some(roots.collect())
    }
}
