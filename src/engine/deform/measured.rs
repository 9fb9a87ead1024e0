//! What is known of cells of a posed grid: their vertices at several levels, and the errors there.

use std::borrow::Cow;
use std::ops::Deref;

use super::subdivision_cache::{MAX_SUBDIVISION_DEPTH, group};

/// What is known of some cells.
#[derive(Debug)]
pub(super) struct MeasuredCells {
    /// One more than the index of each cell of the grid, or 0.
    index: Vec<u32>,
    pub(super) known: Vec<(u32, Measured)>,
}

/// What is known of a cell.
#[derive(Debug)]
pub(super) struct Measured {
    /// Displacements on `[2^depth + 1][2^depth + 1]`.
    pub(super) vertices: CellVertices,
    pub(super) depth: u8,
    /// The largest error of the cell halved k times, for each k below `depth`.
    pub(super) errors: [f32; MAX_SUBDIVISION_DEPTH],
    /// Halved at least this many times, because a neighbour is.
    pub(super) least: u8,
    /// The vertices are not interpolated.
    pub(super) is_exact: bool,
}

/// Vertices of a cell that is halved once.
const HALVED_VERTICES: usize = 9;

/// The vertices of a cell.
#[derive(Debug)]
pub(super) enum CellVertices {
    /// Not halved, or once, as most cells: without an allocation for each.
    Small([[f32; 2]; HALVED_VERTICES], usize),
    Large(Vec<[f32; 2]>),
}

impl CellVertices {
    fn new(len: usize) -> Self {
        if len <= HALVED_VERTICES {
            Self::Small([[0.0; 2]; HALVED_VERTICES], len)
        } else {
            Self::Large(vec![[0.0; 2]; len])
        }
    }

    fn as_mut(&mut self) -> &mut [[f32; 2]] {
        match self {
            Self::Small(vertices, len) => &mut vertices[..*len],
            Self::Large(vertices) => vertices,
        }
    }
}

impl Deref for CellVertices {
    type Target = [[f32; 2]];

    fn deref(&self) -> &Self::Target {
        match self {
            Self::Small(vertices, len) => &vertices[..*len],
            Self::Large(vertices) => vertices,
        }
    }
}

impl MeasuredCells {
    /// Nothing is known yet; `cells`: at least their number.
    pub(super) fn new(cells: usize) -> Self {
        Self {
            index: vec![0; cells],
            known: Vec::new(),
        }
    }

    /// The index of a known cell.
    pub(super) fn position(&self, cell: u32) -> Option<usize> {
        (self.index[cell as usize] as usize).checked_sub(1)
    }

    pub(super) fn get(&self, cell: &u32) -> Option<&Measured> {
        self.position(*cell).map(|at| &self.known[at].1)
    }

    pub(super) fn get_or_insert(&mut self, cell: u32, corners: [[f32; 2]; 4]) -> &mut Measured {
        let index = &mut self.index[cell as usize];
        if *index == 0 {
            self.known.push((cell, Measured::new(corners)));
            *index = u32::try_from(self.known.len()).expect("fewer than the grid has");
        }
        let at = *index as usize - 1;
        &mut self.known[at].1
    }

    /// The positions of known cells in [`Self::known`], row by row.
    pub(super) fn in_order(&self) -> impl Iterator<Item = usize> {
        self.index
            .iter()
            .filter_map(|index| (*index as usize).checked_sub(1))
    }
}

impl Measured {
    pub(super) fn new(corners: [[f32; 2]; 4]) -> Self {
        let mut vertices = CellVertices::new(corners.len());
        vertices.as_mut().copy_from_slice(&corners);
        Self {
            vertices,
            depth: 0,
            errors: [0.0; MAX_SUBDIVISION_DEPTH],
            least: 0,
            is_exact: false,
        }
    }

    /// A cell that is halved once; `error`: that of its patch at the new vertices.
    pub(super) fn halved(
        [a, b, c, d]: [[f32; 2]; 4],
        [above, left, centre, right, below]: [[f32; 2]; 5],
        error: f32,
    ) -> Self {
        let mut errors = [0.0; MAX_SUBDIVISION_DEPTH];
        errors[0] = error;
        let vertices = [a, above, b, left, centre, right, c, below, d];
        Self {
            vertices: CellVertices::Small(vertices, HALVED_VERTICES),
            depth: 1,
            errors,
            least: 0,
            is_exact: false,
        }
    }

    /// Adds the vertices of one halving more, and the error of the present lattice at them.
    pub(super) fn deepen(&mut self, fresh: &[[f32; 2]], size: [f32; 2]) {
        let coarse = (1_usize << self.depth) + 1;
        let fine = 2 * coarse - 1;
        let mut lattice = CellVertices::new(fine * fine);
        let vertices = lattice.as_mut();
        for (b, row) in self.vertices.chunks_exact(coarse).enumerate() {
            for (a, d) in row.iter().enumerate() {
                vertices[2 * b * fine + 2 * a] = *d;
            }
        }
        let (mut worst, split) = (0.0_f32, split_error(&self.vertices, coarse, size));
        let mean = |a: [f32; 2], b: [f32; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        for ((a, b), d) in group(self.depth + 1).zip(fresh) {
            let (a, b) = (a as usize, b as usize);
            let old = |a: usize, b: usize| self.vertices[b / 2 * coarse + a / 2];
            let patch = match (a & 1, b & 1) {
                (1, 0) => mean(old(a, b), old(a + 1, b)),
                (0, _) => mean(old(a, b), old(a, b + 1)),
                _ => mean(
                    mean(old(a, b), old(a + 1, b)),
                    mean(old(a, b + 1), old(a + 1, b + 1)),
                ),
            };
            worst = worst.max(distance(*d, patch));
            vertices[b * fine + a] = *d;
        }
        self.vertices = lattice;
        self.errors[usize::from(self.depth)] = worst + split;
        self.depth += 1;
    }

    /// The vertices of the cell halved `level` times.
    pub(super) fn at_level(&self, level: u8) -> Cow<'_, [[f32; 2]]> {
        at_level(&self.vertices, (1 << self.depth) + 1, level)
    }
}

/// Whether a cell is drawn as its patch: see [`split_error`].
pub(super) fn is_convex([a, b, c, d]: &[[f32; 2]; 4], [width, height]: [f32; 2]) -> bool {
    let cross = |a: [f32; 2], b: [f32; 2]| a[0] * b[1] - a[1] * b[0];
    let (top, bottom) = (
        [width + (b[0] - a[0]), b[1] - a[1]],
        [width + (d[0] - c[0]), d[1] - c[1]],
    );
    let (left, right) = (
        [c[0] - a[0], height + (c[1] - a[1])],
        [d[0] - b[0], height + (d[1] - b[1])],
    );
    (cross(top, left) > 0.0)
        & (cross(top, right) > 0.0)
        & (cross(bottom, left) > 0.0)
        & (cross(bottom, right) > 0.0)
}

/// The largest difference between the cells of a cell's lattice and how they are drawn, px: cells
/// that are not convex are split into two triangles, which differ from the patch by a quarter of
/// its twist.
pub(super) fn split_error(vertices: &[[f32; 2]], side: usize, size: [f32; 2]) -> f32 {
    let (width, height) = (size[0] / (side - 1) as f32, size[1] / (side - 1) as f32);
    let cross = |a: [f32; 2], b: [f32; 2]| a[0] * b[1] - a[1] * b[0];
    let mut worst = 0.0_f32;
    for (above, below) in vertices
        .chunks_exact(side)
        .zip(vertices.chunks_exact(side).skip(1))
    {
        for (ab, dc) in above.windows(2).zip(below.windows(2)) {
            let across = |ab: &[[f32; 2]]| [width + (ab[1][0] - ab[0][0]), ab[1][1] - ab[0][1]];
            let down = |k: usize| [dc[k][0] - ab[k][0], height + (dc[k][1] - ab[k][1])];
            let (top, bottom, left, right) = (across(ab), across(dc), down(0), down(1));
            let least = cross(top, left)
                .min(cross(top, right))
                .min(cross(bottom, left))
                .min(cross(bottom, right));
            if least <= 0.0 {
                worst = worst.max(0.25 * distance(bottom, top));
            }
        }
    }
    worst
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    let (x, y) = (a[0] - b[0], a[1] - b[1]);
    (x * x + y * y).sqrt()
}

/// Some of the vertices of a lattice: those of a coarser one.
pub(super) fn at_level(vertices: &[[f32; 2]], side: usize, level: u8) -> Cow<'_, [[f32; 2]]> {
    let step = (side - 1) >> level;
    if step == 1 {
        return Cow::Borrowed(vertices);
    }
    (0..side)
        .step_by(step)
        .flat_map(|b| (0..side).step_by(step).map(move |a| vertices[b * side + a]))
        .collect()
}

/// The index of a vertex on an edge (top, right, bottom, left) of a lattice, from left to right or
/// from top to bottom.
pub(super) const fn on_edge(k: usize, side: usize, edge: usize) -> usize {
    match edge {
        0 => k,
        1 => k * side + side - 1,
        2 => (side - 1) * side + k,
        _ => k * side,
    }
}

/// The fewest halvings with which an edge meets the tolerance.
pub(super) fn edge_level(vertices: &[[f32; 2]], side: usize, edge: usize, tolerance: f32) -> u8 {
    let line = |k: usize| vertices[on_edge(k, side, edge)];
    let last = u8::try_from((side - 1).ilog2()).expect("a few levels");
    let is_within = |level: &u8| {
        let step = (side - 1) >> level;
        (0..side - 1).step_by(step).all(|from| {
            let (a, b) = (line(from), line(from + step));
            (1..step).all(|k| {
                let share = k as f32 / step as f32;
                let straight = [a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share];
                distance(line(from + k), straight) <= tolerance
            })
        })
    };
    (0..last).find(is_within).unwrap_or(last)
}
