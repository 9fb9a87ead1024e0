//! The cut lattice: one quad for each connected component of the subject in a cell, so that parts
//! that do not touch share no vertex (mathematics 11.1).

use super::Mask;
use super::cell_components::{CellComponents, NO_COMPONENT};
use super::pixel::nearest_of_pixel;
use crate::geometry::{CutCell, CutCells, Grid, Point};

/// A quad of the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quad {
    /// Column and row of its cell.
    pub cell: [u32; 2],
    /// Its vertices: top left, top right, bottom right, bottom left.
    pub vertices: [u32; 4],
    /// Quads are of one part if edges that they share connect them.
    pub part: u32,
    /// Which component of its cell it is, in the order of their first pixels.
    pub component: u16,
}

/// The cut lattice of a mask.
#[derive(Debug)]
pub struct CutLattice {
    spacing: u32,
    /// Cells along each axis.
    cells: [usize; 2],
    quads: Vec<Quad>,
    /// The first quad of each cell, cells row by row.
    first_quad: Vec<u32>,
    /// Lines of the lattice that each vertex lies on: its position divided by the spacing.
    vertices: Vec<[u32; 2]>,
    parts: u32,
    /// Of each cell with several components: its index, and the component of each pixel, row by
    /// row; ascending.
    split: Vec<(u32, Box<[u16]>)>,
}

/// Quads after which somebody is asked whether the work is still needed.
const QUADS_PER_CHECK: usize = 256;
/// Cells have at most this many pixels a side, so that components have numbers.
pub const MAX_SPACING: u32 = 128;

/// Sets that are merged.
struct Merged(Vec<u32>);

impl Merged {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "CutLattice::new limits the number"
    )]
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    fn find(&mut self, mut k: u32) -> u32 {
        while self.0[k as usize] != k {
            let up = self.0[self.0[k as usize] as usize];
            self.0[k as usize] = up;
            k = up;
        }
        k
    }

    /// The smaller number names the set, so that names do not depend on the order of merging.
    fn merge(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// Numbers the sets in the order of their first members; returns how many there are.
    fn number(mut self) -> (Vec<u32>, u32) {
        let mut count = 0;
        let mut numbers = vec![0; self.0.len()];
        for k in 0..self.0.len() {
            #[expect(clippy::cast_possible_truncation, reason = "as in `new`")]
            let root = self.find(k as u32) as usize;
            numbers[k] = if root == k {
                count += 1;
                count - 1
            } else {
                numbers[root]
            };
        }
        (numbers, count)
    }
}

impl CutLattice {
    /// Bytes that a lattice of this many quads takes, with what its construction needs and without
    /// sets of texels.
    #[must_use]
    pub const fn bytes_for(quads: u64) -> u64 {
        quads * 160
    }

    /// The number of quads of a lattice, or a number above `most`; `None` when cancelled.
    #[must_use]
    pub fn count(
        mask: &Mask,
        spacing: u32,
        most: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<usize> {
        let side = spacing.clamp(1, MAX_SPACING) as usize;
        let (width, height) = mask.size();
        let (mut count, mut components) = (0, CellComponents::new(side));
        for row in 0..height.div_ceil(side) {
            if cancelled() {
                return None;
            }
            for column in 0..width.div_ceil(side) {
                count += usize::from(components.find(mask, column, row));
            }
            if count > most {
                break;
            }
        }
        Some(count)
    }

    /// The lattice with cells of `spacing` px, 1 to [`MAX_SPACING`]; `None` when cancelled or if it
    /// has more than `max_quads`.
    #[must_use]
    pub fn new(
        mask: &Mask,
        spacing: u32,
        max_quads: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let side = spacing.clamp(1, MAX_SPACING) as usize;
        let (width, height) = mask.size();
        let cells = [width.div_ceil(side), height.div_ceil(side)];
        let mut lattice = Self {
            spacing,
            cells,
            quads: Vec::new(),
            first_quad: Vec::with_capacity(cells[0] * cells[1] + 1),
            vertices: Vec::new(),
            parts: 0,
            split: Vec::new(),
        };
        let mut components = CellComponents::new(side);
        for row in 0..cells[1] {
            if cancelled() {
                return None;
            }
            for column in 0..cells[0] {
                lattice.add_cell(mask, column, row, &mut components);
                if lattice.quads.len() > max_quads.min(u32::MAX as usize / 8) {
                    return None;
                }
            }
        }
        lattice.first_quad.push(index(lattice.quads.len()));
        lattice.connect(mask, cancelled)?;
        Some(lattice)
    }

    fn add_cell(
        &mut self,
        mask: &Mask,
        column: usize,
        row: usize,
        components: &mut CellComponents,
    ) {
        self.first_quad.push(index(self.quads.len()));
        let count = components.find(mask, column, row);
        let cell = [index(column), index(row)];
        for component in 0..count {
            self.quads.push(Quad {
                cell,
                vertices: [0; 4],
                part: 0,
                component,
            });
        }
        if count > 1 {
            let labels = components.labels.clone().into_boxed_slice();
            self.split
                .push((index(row * self.cells[0] + column), labels));
        }
    }

    /// Merges the vertices on common edges of quads that the subject connects.
    fn connect(&mut self, mask: &Mask, cancelled: &dyn Fn() -> bool) -> Option<()> {
        let mut corners = Merged::new(4 * self.quads.len());
        let mut parts = Merged::new(self.quads.len());
        let (width, height) = mask.size();
        let side = self.spacing as usize;
        for down in [false, true] {
            let (long, short) = if down {
                (height, width)
            } else {
                (width, height)
            };
            for line in (side..long).step_by(side) {
                if cancelled() {
                    return None;
                }
                for along in 0..short {
                    let (x, y) = if down {
                        (along, line - 1)
                    } else {
                        (line - 1, along)
                    };
                    if !mask.are_joined(x, y, down) {
                        continue;
                    }
                    let beyond = (x + usize::from(!down), y + usize::from(down));
                    let [Some(a), Some(b)] =
                        [(x, y), beyond].map(|(x, y)| self.quad_at(mask, x, y))
                    else {
                        continue;
                    };
                    let (a, b) = (index(a), index(b));
                    parts.merge(a, b);
                    // Right edge and left edge, or lower edge and upper edge.
                    let pairs = if down {
                        [(3, 0), (2, 1)]
                    } else {
                        [(1, 0), (2, 3)]
                    };
                    for (of_a, of_b) in pairs {
                        corners.merge(4 * a + of_a, 4 * b + of_b);
                    }
                }
            }
        }
        let (numbers, count) = corners.number();
        self.vertices = vec![[0; 2]; count as usize];
        let (of_part, part_count) = parts.number();
        self.parts = part_count;
        for (k, quad) in self.quads.iter_mut().enumerate() {
            quad.part = of_part[k];
            for (corner, vertex) in quad.vertices.iter_mut().enumerate() {
                *vertex = numbers[4 * k + corner];
                self.vertices[*vertex as usize] = [
                    quad.cell[0] + u32::from(corner == 1 || corner == 2),
                    quad.cell[1] + u32::from(corner >= 2),
                ];
            }
        }
        Some(())
    }

    /// The quad that draws a pixel; `None` if it is not visible.
    #[must_use]
    pub fn quad_at(&self, mask: &Mask, x: usize, y: usize) -> Option<usize> {
        if !mask.is_visible(x, y) {
            return None;
        }
        let side = self.spacing as usize;
        let cell = (y / side) * self.cells[0] + x / side;
        let first = self.first_quad[cell] as usize;
        if self.first_quad[cell + 1] as usize == first + 1 {
            return Some(first);
        }
        let at = self
            .split
            .binary_search_by_key(&cell, |(cell, _)| *cell as usize);
        let component = self.split[at.ok()?].1[(y % side) * side + x % side];
        (component != NO_COMPONENT).then_some(first + component as usize)
    }

    /// The quads as they are drawn. A quad draws the visible texels of its component, and those
    /// that are not visible beside them, into which samples reach. `None` when cancelled.
    #[must_use]
    pub fn cells_of(&self, mask: &Mask, cancelled: &dyn Fn() -> bool) -> Option<CutCells> {
        let side = self.spacing as usize;
        let mut texels = Vec::new();
        let mut set = vec![0_u64; (side * side).div_ceil(64)];
        let mut cells = Vec::with_capacity(self.quads.len());
        for (k, quad) in self.quads.iter().enumerate() {
            if k.is_multiple_of(QUADS_PER_CHECK) && cancelled() {
                return None;
            }
            set.fill(0);
            let (mut is_whole, mut is_loose) = (true, false);
            let [x0, y0] = quad.cell.map(|cell| cell as usize * side);
            let rows = if mask.is_whole(x0, y0, side) { 0 } else { side };
            for y in 0..rows {
                for x in 0..side {
                    let (px, py) = (x0 + x, y0 + y);
                    if px >= mask.size().0 || py >= mask.size().1 {
                        continue;
                    }
                    if self.draws(mask, k, px, py) {
                        let bit = y * side + x;
                        set[bit / 64] |= 1 << (bit % 64);
                        is_loose |= mask.is_visible(px, py) && mask.root(px, py).is_none();
                    } else {
                        is_whole = false;
                    }
                }
            }
            let texels = (!is_whole).then(|| {
                texels.extend_from_slice(&set);
                index(texels.len() / set.len() - 1)
            });
            cells.push(CutCell {
                cell: quad.cell,
                vertices: quad.vertices,
                texels,
                is_loose,
            });
        }
        let [width, height] = [mask.size().0, mask.size().1].map(|side| side as f64);
        let grid = Grid::with_cell(width, height, f64::from(self.spacing));
        let vertices = self.vertices.clone();
        Some(CutCells::new(grid, self.spacing, cells, vertices, texels))
    }

    /// The pixel inside, counted row by row, to which each vertex belongs: the nearest one of its
    /// quads, or the one that their rim is attached to; none where there is only rim that touches
    /// nothing. `None` when cancelled.
    #[must_use]
    pub fn pixels(&self, mask: &Mask, cancelled: &dyn Fn() -> bool) -> Option<Vec<Option<u32>>> {
        let side = self.spacing as usize;
        let mut nearest = vec![(f64::INFINITY, u32::MAX); self.vertices.len()];
        let (width, height) = mask.size();
        for (k, quad) in self.quads.iter().enumerate() {
            if k.is_multiple_of(QUADS_PER_CHECK) && cancelled() {
                return None;
            }
            let [x0, y0] = quad.cell.map(|cell| cell as usize * side);
            let (last_x, last_y) = ((x0 + side).min(width) - 1, (y0 + side).min(height) - 1);
            let mut look = |x: usize, y: usize, (rx, ry): (usize, usize)| {
                for vertex in quad.vertices {
                    let [column, row] = self.vertices[vertex as usize];
                    let at = Point::new(
                        (column as usize * side).min(width) as f64,
                        (row as usize * side).min(height) as f64,
                    );
                    let distance = nearest_of_pixel((rx, ry), at, 0.0).distance(at);
                    let found = (distance, index(y * width + x));
                    let best = &mut nearest[vertex as usize];
                    if found < *best {
                        *best = found;
                    }
                }
            };
            if mask.is_whole(x0, y0, side) {
                for (x, y) in [(x0, y0), (last_x, y0), (x0, last_y), (last_x, last_y)] {
                    look(x, y, (x, y));
                }
                continue;
            }
            for (y, x) in (y0..=last_y).flat_map(|y| (x0..=last_x).map(move |x| (y, x))) {
                if self.quad_at(mask, x, y) == Some(k)
                    && let Some(root) = mask.root(x, y)
                {
                    look(x, y, root);
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

    /// Whether a quad draws a pixel of its cell.
    fn draws(&self, mask: &Mask, quad: usize, x: usize, y: usize) -> bool {
        if mask.is_visible(x, y) {
            return self.quad_at(mask, x, y) == Some(quad);
        }
        let own = self.quads[quad];
        let beside = (y.saturating_sub(1)..y + 2)
            .flat_map(|y| (x.saturating_sub(1)..x + 2).map(move |x| (x, y)));
        beside
            .filter_map(|(x, y)| self.quad_at(mask, x, y))
            .any(|other| {
                other == quad
                    || self.quads[other].part == own.part && self.quads[other].cell != own.cell
            })
    }

    /// Side of a cell, px.
    #[must_use]
    pub const fn spacing(&self) -> u32 {
        self.spacing
    }

    /// The quads: cells row by row, and in each by the first pixel of the component.
    #[must_use]
    pub fn quads(&self) -> &[Quad] {
        &self.quads
    }

    /// The quads of a cell.
    #[must_use]
    pub fn quads_of(&self, column: usize, row: usize) -> std::ops::Range<usize> {
        let cell = row * self.cells[0] + column;
        self.first_quad[cell] as usize..self.first_quad[cell + 1] as usize
    }

    /// Cells along x and y.
    #[must_use]
    pub const fn cells(&self) -> [usize; 2] {
        self.cells
    }

    /// The lines of the lattice on which each vertex lies: its position divided by the spacing.
    #[must_use]
    pub fn vertices(&self) -> &[[u32; 2]] {
        &self.vertices
    }

    /// Number of parts.
    #[must_use]
    pub const fn parts(&self) -> u32 {
        self.parts
    }

    /// Memory of the lattice, bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let split: usize = self
            .split
            .iter()
            .map(|(_, labels)| size_of_val(&**labels))
            .sum();
        (size_of_val(&*self.quads)
            + size_of_val(&*self.first_quad)
            + size_of_val(&*self.vertices)
            + split) as u64
    }
}

/// An index of a quad, a cell or a line: `CutLattice::new` limits their number.
#[expect(
    clippy::cast_possible_truncation,
    reason = "limited by CutLattice::new"
)]
const fn index(k: usize) -> u32 {
    k as u32
}
