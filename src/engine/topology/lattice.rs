//! The cut lattice: one quad for each connected component of the subject in a cell, so that parts
//! that do not touch share no vertex (mathematics 11.1).

use super::Mask;
use super::cell_components::{CellComponents, NO_COMPONENT};

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
    pub(super) spacing: u32,
    /// Cells along each axis.
    cells: [usize; 2],
    pub(super) quads: Vec<Quad>,
    /// The first quad of each cell, cells row by row.
    first_quad: Vec<u32>,
    /// Lines of the lattice that each vertex lies on: its position divided by the spacing.
    pub(super) vertices: Vec<[u32; 2]>,
    parts: u32,
    /// Of each cell with several components: its index, and the component of each pixel, row by
    /// row; ascending.
    split: Vec<(u32, Box<[u16]>)>,
}

/// What the memory of a lattice depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LatticeSize {
    /// Cells of the image.
    pub cells: u64,
    /// Quads.
    pub quads: u64,
    /// Quads in cells that are not whole: each has a set of texels.
    pub sets: u64,
    /// Cells with several quads: each has the components of its pixels.
    pub split: u64,
}

impl LatticeSize {
    /// Bytes of a lattice with cells of `side` px and of the quads as they are drawn, with what
    /// their construction needs.
    #[must_use]
    pub const fn bytes(&self, side: u32) -> u64 {
        let labels = 2 * (side as u64 * side as u64) + 64;
        // Quads that share no vertex have four each; both know the first quad of each cell.
        340 * self.quads + set_bytes(side) * self.sets + labels * self.split + 8 * self.cells
    }

    /// Bytes of the quads as they are drawn, and of what their vertices belong to.
    #[must_use]
    pub const fn kept_bytes(&self, side: u32) -> u64 {
        168 * self.quads + set_bytes(side) * self.sets + 4 * self.cells
    }
}

/// Bytes of a set of texels.
const fn set_bytes(side: u32) -> u64 {
    8 * (side as u64 * side as u64).div_ceil(64)
}

/// Work after which cancellation is asked for, in pixels and words.
const PIXELS_PER_CHECK: usize = 1 << 15;

/// Counts work between two looks at whether it is still needed.
#[derive(Debug, Default)]
pub(super) struct CheckedWork(usize);

impl CheckedWork {
    /// `None` when cancelled.
    pub(super) fn add(&mut self, pixels: usize, cancelled: &dyn Fn() -> bool) -> Option<()> {
        self.0 += pixels;
        if self.0 >= PIXELS_PER_CHECK {
            self.0 = 0;
            return (!cancelled()).then_some(());
        }
        Some(())
    }
}

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
    /// The size of a lattice, or one that takes more than `most` bytes; `None` when cancelled.
    #[must_use]
    pub fn size(
        mask: &Mask,
        spacing: u32,
        most: u64,
        cancelled: &dyn Fn() -> bool,
    ) -> Option<LatticeSize> {
        let spacing = spacing.clamp(1, MAX_SPACING);
        let side = spacing as usize;
        let (width, height) = mask.size();
        let cells = [width.div_ceil(side), height.div_ceil(side)];
        let mut size = LatticeSize {
            cells: (cells[0] * cells[1]) as u64,
            ..LatticeSize::default()
        };
        let (mut components, mut work) = (CellComponents::new(side), CheckedWork::default());
        for (row, column) in (0..cells[1]).flat_map(|row| (0..cells[0]).map(move |k| (row, k))) {
            work.add(side * side, cancelled)?;
            let count: u64 = components.find(mask, column, row).into();
            size.quads += count;
            size.split += u64::from(count > 1);
            if !mask.is_whole(column * side, row * side, side) {
                size.sets += count;
            }
            if size.bytes(spacing) > most {
                break;
            }
        }
        Some(size)
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
        let (mut components, mut work) = (CellComponents::new(side), CheckedWork::default());
        for row in 0..cells[1] {
            for column in 0..cells[0] {
                work.add(side * side, cancelled)?;
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
pub(super) const fn index(k: usize) -> u32 {
    k as u32
}
