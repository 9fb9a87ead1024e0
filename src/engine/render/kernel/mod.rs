//! The inner loops of the renderer and the one place where an instruction set is chosen. `scalar` is the reference and defines every result:
//! f32 operations in a fixed order without fused products, and integers; so each level gives the same bytes. `avx2` repeats it: the loops
//! that a compiler can widen are the scalar ones compiled again, the sampler and the cells are written by hand. `avx512` has cells of its own.
//! What was tried and dropped: `notes.md`.

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "AVX2 intrinsics behind run-time detection")]
mod avx2;
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "AVX2 intrinsics behind run-time detection")]
mod avx2_cells;
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "AVX-512 intrinsics behind run-time detection")]
mod avx512;
#[forbid(unsafe_code)]
mod cells;
#[forbid(unsafe_code)]
mod scalar;

use std::ops::Range;

use super::lattice::{Lattice, YRange};
use super::source::Packed;
use crate::level::Level;
use crate::pixmap::Channels;

pub(super) use cells::{Canvas, CellBlock, LANES, Piece, UNCOVERED};
pub(super) use scalar::{CellRow, Edges, NOTES, Neighbours, ROUND_SAMPLE, SOUND, STEEP, Spans, UPRIGHT, fixed};

/// The kernels of a level that this machine was seen to have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernel(Level);

/// Calls the same function of the module that belongs to the level.
macro_rules! dispatch {
    ($self:ident, $name:ident($($argument:expr),*)) => {
        match $self.0 {
            Level::Scalar => scalar::$name($($argument),*),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => avx2::$name($self, $($argument),*),
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => avx512::$name($self, $($argument),*),
            #[cfg(not(target_arch = "x86_64"))]
            Level::Avx2 | Level::Avx512 => scalar::$name($($argument),*),
        }
    };
}

impl Kernel {
    /// The kernels of a level; scalar where the machine does not have it.
    pub(super) fn new(level: Level) -> Self {
        Self(if level.is_here() { level } else { Level::Scalar })
    }

    /// The level in use.
    pub(super) const fn level(self) -> Level {
        self.0
    }

    /// Poses a row of vertices and snaps it to the lattice.
    pub(super) fn snap(self, rest_x: &[f64], rest_y: f64, displacement: &[[f32; 2]], scale: [f64; 2], x: &mut [i32], y: &mut [i32]) {
        dispatch!(self, snap(rest_x, rest_y, displacement, scale, x, y));
    }

    /// How far the vertices of each block of a line, and the one right of it, reach up and down.
    pub(super) fn reaches(self, y: &[i32], reaches: &mut [YRange]) {
        dispatch!(self, reaches(y, reaches));
    }

    /// The vectors from some vertices to others, times `scale`.
    pub(super) fn edges(self, from: (&[i32], &[i32]), to: (&[i32], &[i32]), scale: f32, edges: &mut Edges) {
        dispatch!(self, edges(from, to, scale, edges));
    }

    /// How each cell of a row may be drawn: [`SOUND`], [`UPRIGHT`], or 0; upright ones may be [`STEEP`] besides.
    pub(super) fn soundness(self, cells: &Neighbours<'_>, soundness: &mut [u8]) {
        dispatch!(self, soundness(cells, soundness));
    }

    /// How each cell of a row may be drawn if it is steep: [`SOUND`], [`UPRIGHT`], or 0.
    pub(super) fn steepness(self, cells: &CellRow<'_>, above: &[f32], below: &[f32], soundness: &mut [u8]) {
        dispatch!(self, steepness(cells, above, below, soundness));
    }

    /// How much the columns bend at the line between two rows of cells: squared jump of the derivative along them.
    pub(super) fn bends(self, above: &CellRow<'_>, below: &CellRow<'_>, bends: &mut [f32]) {
        dispatch!(self, bends(above, below, bends));
    }

    /// Where every column crosses target rows: x, px, and v, `[rows][pitch + BLOCK]`, zero before and where nothing is crossed; of no meaning for a
    /// column that crosses a row more than once.
    pub(super) fn crossings(self, lattice: &Lattice, rows: Range<u32>, x: &mut [f32], v: &mut [f32]) {
        dispatch!(self, crossings(lattice, rows, x, v));
    }

    /// Coordinates along a row from the crossings of the columns.
    pub(super) fn spans(self, spans: &mut Spans<'_>, u: &mut [f32], v: &mut [f32]) {
        dispatch!(self, spans(spans, u, v));
    }

    /// Looks at a block of cells: which rows of the canvas they meet, and whether they are convex.
    pub(super) fn glance(self, lattice: &Lattice, j: usize, block: usize, canvas: &Canvas<'_>, seen: &mut CellBlock) {
        dispatch!(self, glance(lattice, j, block, canvas, seen));
    }

    /// Draws a piece in the rows of the canvas whose bits are set; all must lie between its highest corner and its lowest.
    pub(super) fn fill(self, piece: &Piece, rows: u32, canvas: &mut Canvas<'_>) {
        dispatch!(self, fill(piece, rows, canvas));
    }

    /// Bilinear samples of a run of pixels.
    pub(super) fn sample(self, packed: &Packed, u: &[f32], v: &[f32], channels: Channels, out: &mut [u8]) {
        dispatch!(self, sample(packed, u, v, channels, out));
    }
}
