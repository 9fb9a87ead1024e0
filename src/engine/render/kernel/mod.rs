//! The inner loops of the renderer, and the selection of an instruction set. `scalar` is the
//! reference and defines every result: f32 operations in a fixed order without fused products, and
//! integers; so all levels give the same bytes. `avx2` compiles the scalar loops that the compiler
//! can vectorise again, and has a hand-written sampler and cells. `avx512` has its own cells. For
//! WebAssembly, which is compiled for size, what takes time is compiled for speed, and `simd128`
//! has a hand-written sampler. Rejected variants: `notes.md`.

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
mod bilinear;
#[forbid(unsafe_code)]
mod cell_block;
#[forbid(unsafe_code)]
mod cells;
#[forbid(unsafe_code)]
mod footprints;
#[forbid(unsafe_code)]
mod rounding;
#[forbid(unsafe_code)]
mod scalar;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
#[expect(
    unsafe_code,
    reason = "loads of texels at places that were clamped to the image"
)]
mod simd128;

use std::ops::Range;

use super::snapped_grid::{BLOCK_COLUMNS, Corner, SnappedGrid, YRange};
use super::source::Packed;
use crate::level::SimdLevel;
use crate::pixmap::Channels;

pub(super) use cell_block::CellBlock;
pub(super) use cells::{LANES, Piece, Raster, UNCOVERED};
pub(super) use footprints::{
    Alike, BATCH, FootprintBatch, FootprintGrid, GROUP_PIXELS, KINDS, MAX_FOOTPRINT_SAMPLES,
    one_sample_up_to,
};
pub(super) use scalar::{
    CellRow, Edges, NOTES, Neighbours, ROUND_SAMPLE, SOUND, STEEP, Spans, UPRIGHT, fixed, jacobian,
};

/// The kernels of a level that this machine has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernel(SimdLevel);

/// Calls the function of this name in the level's module.
macro_rules! dispatch {
    ($self:ident, $name:ident($($argument:expr),*)) => {
        match $self.0 {
            SimdLevel::Scalar => scalar::$name($($argument),*),
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx2 => avx2::$name($self, $($argument),*),
            #[cfg(target_arch = "x86_64")]
            SimdLevel::Avx512 => avx512::$name($self, $($argument),*),
            #[cfg(not(target_arch = "x86_64"))]
            SimdLevel::Avx2 | SimdLevel::Avx512 => scalar::$name($($argument),*),
        }
    };
}

impl Kernel {
    /// The kernels of a level; scalar if the machine lacks it.
    pub(super) fn new(level: SimdLevel) -> Self {
        Self(if level.is_supported() {
            level
        } else {
            SimdLevel::Scalar
        })
    }

    /// The level in use.
    pub(super) const fn level(self) -> SimdLevel {
        self.0
    }

    /// Poses a row of vertices and snaps it to the lattice.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn snap(
        self,
        rest_x: &[f64],
        rest_y: f64,
        displacement: &[[f32; 2]],
        scale: [f64; 2],
        x: &mut [i32],
        y: &mut [i32],
    ) {
        dispatch!(self, snap(rest_x, rest_y, displacement, scale, x, y));
    }

    /// The y that each block along a line reaches: by its vertices and the next one.
    pub(super) fn y_ranges(self, y: &[i32], y_ranges: &mut [YRange]) {
        dispatch!(self, y_ranges(y, y_ranges));
    }

    /// The vectors from some vertices to others, times `scale`.
    pub(super) fn edges(
        self,
        from: (&[i32], &[i32]),
        to: (&[i32], &[i32]),
        scale: f32,
        edges: &mut Edges,
    ) {
        dispatch!(self, edges(from, to, scale, edges));
    }

    /// How each cell of a row may be drawn: [`SOUND`], [`UPRIGHT`] or 0; upright cells may also
    /// have the bit [`STEEP`].
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn soundness(self, cells: &Neighbours<'_>, soundness: &mut [u8]) {
        dispatch!(self, soundness(cells, soundness));
    }

    /// How each steep cell of a row may be drawn: [`SOUND`], [`UPRIGHT`] or 0.
    pub(super) fn steepness(
        self,
        cells: &CellRow<'_>,
        above: &[f32],
        below: &[f32],
        soundness: &mut [u8],
    ) {
        dispatch!(self, steepness(cells, above, below, soundness));
    }

    /// The bend of the columns at the line between two rows of cells: squared jump of the
    /// derivative along them.
    pub(super) fn bends(self, above: &CellRow<'_>, below: &CellRow<'_>, bends: &mut [f32]) {
        dispatch!(self, bends(above, below, bends));
    }

    /// Whether each cell between two lines of vertices shrinks the source by more than `least`,
    /// from its left and upper sides: 1 or 0. `lines`: displacements, px; `per`: cells per px of
    /// the source.
    pub(super) fn shrinks(
        self,
        lines: (&[[f32; 2]], &[[f32; 2]]),
        per: [f32; 2],
        least: f32,
        shrinking: &mut [u8],
    ) {
        dispatch!(self, shrinks(lines, per, least, shrinking));
    }

    /// Appends the first `len` pixels, as far as they lie in marked cells, to those that wait for
    /// [`Self::shapes`]. `places`: u and v, with whole groups of [`LANES`]; `first`: index of the
    /// first pixel.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn footprints(
        self,
        grid: &FootprintGrid,
        places: (&[f32], &[f32]),
        len: usize,
        first: usize,
        batch: &mut FootprintBatch,
    ) {
        dispatch!(self, footprints(grid, places, len, first, batch));
    }

    /// Appends those of a group of waiting pixels that need several samples to their kinds. There
    /// must be room for as many of each kind.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn shapes(self, grid: &FootprintGrid, batch: &mut FootprintBatch) {
        dispatch!(self, shapes(grid, batch));
    }

    /// Clears the marks of cells between two lines of Jacobians in which every pixel needs one
    /// sample.
    pub(super) fn unmark(self, lines: (&[[f32; 4]], &[[f32; 4]]), limit: f32, marked: &mut [u8]) {
        dispatch!(self, unmark(lines, limit, marked));
    }

    /// The positions of `2^log` samples of each pixel: the first samples of all, then the second
    /// ones.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn positions(self, alike: &Alike, log: u32, u: &mut [f32], v: &mut [f32]) {
        dispatch!(self, positions(alike, log, u, v));
    }

    /// Crossings of every column with target rows: x, px, and v, `[rows][pitch + BLOCK]`, zero
    /// before the call and where nothing is crossed; meaningless for a column that crosses a row
    /// more than once.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn crossings(
        self,
        lattice: &SnappedGrid,
        rows: Range<u32>,
        x: &mut [f32],
        v: &mut [f32],
    ) {
        dispatch!(self, crossings(lattice, rows, x, v));
    }

    /// Coordinates along a row from the crossings of the columns.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn spans(self, spans: &mut Spans<'_>, u: &mut [f32], v: &mut [f32]) {
        dispatch!(self, spans(spans, u, v));
    }

    /// Classifies a block of cells: the rows of the raster that they meet, and whether they are
    /// convex.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn classify(
        self,
        lattice: &SnappedGrid,
        j: usize,
        block: usize,
        raster: &Raster<'_>,
        seen: &mut CellBlock,
    ) {
        dispatch!(self, classify(lattice, j, block, raster, seen));
    }

    /// The same for single cells.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn classify_parts(
        self,
        parts: &[[Corner; 4]; BLOCK_COLUMNS],
        lattice: &SnappedGrid,
        raster: &Raster<'_>,
        seen: &mut CellBlock,
    ) {
        dispatch!(self, classify_parts(parts, lattice, raster, seen));
    }

    /// Draws a piece in the rows of the raster whose bits are set; all must lie between its highest
    /// and its lowest corner.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn fill(self, piece: &Piece, rows: u32, raster: &mut Raster<'_>) {
        dispatch!(self, fill(piece, rows, raster));
    }

    /// Bilinear samples of a run of pixels.
    #[cfg_attr(optimized_for_size, optimize(speed), inline(never))]
    pub(super) fn sample(
        self,
        packed: &Packed,
        u: &[f32],
        v: &[f32],
        channels: Channels,
        out: &mut [u8],
    ) {
        dispatch!(self, sample(packed, u, v, channels, out));
    }
}
