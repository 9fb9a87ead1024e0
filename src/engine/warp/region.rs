//! A region: the part of a picture whose content moves. Everything else stays as it is.
//!
//! A mask of the picture's size says how much of each position belongs to the region, 0 to 1. The
//! drawn picture has three layers, all on the same canvas, at the same scale and with the same
//! filter:
//!
//! * the *background* S: the source at rest, as a warp without handles draws it, with what
//!   `outside` puts beyond it;
//! * the *moved part* M: the source through the posed mesh;
//! * the *moved mask* m: the mask through the posed mesh, 0 where no posed cell is; and the *mask
//!   at rest* r.
//!
//! At each pixel the result is `m M + k S`, in colours times alpha, where k is the share of the
//! background that is kept:
//!
//! * `holes: keep`: `k = 1 - m`;
//! * `holes: transparent`: `k = min(1 - m, 1 - r)`. The content of the region is taken from the
//!   background, as far as the moved part does not replace it.
//!
//! What `transparent` leaves open, `1 - m - k = max(0, r - m)`, is the *hole*: content moved away
//! from it, and nothing covers it.
//!
//! Where m is 0 (and r, with transparent holes), the result is the background bit for bit. Where m
//! is 1, it is the moved part: a mask that is 1 everywhere gives the warp without a region wherever
//! a posed cell is drawn. Where nothing moves, m = r and M = S, and the result is the source. A
//! feathered mask gives a transition as wide as the feather. Coverage is mixed like the picture.
//! Labels are not mixed: a pixel has the label of the moved part where m is at least 1/2, otherwise
//! that of the background, and 0 in a transparent hole of more than 1/2.
//!
//! A region changes what is drawn, not f: annotations, maps and reports are those of the whole
//! warp.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use super::{Digest, Image};
use crate::deform::IsCancelled;
use crate::geometry::Mesh;
use crate::pixmap::{Depth, Extent, Pixmap, Samples};
use crate::render::{FULL_WEIGHT, Outside, RenderOptions, Renderer, Source};

/// Pixels of the mask around a cell that a filter may add to it.
const FILTER_REACH: f64 = 2.0;

/// Bits of a word.
const WORD_BITS: usize = u64::BITS as usize;

/// The part of a picture that moves: a mask of the picture's size, feathered or not. Cheap to
/// clone.
#[derive(Clone, Debug)]
pub struct Region {
    mask: Arc<Source>,
    channel: MaskChannel,
    digest: Digest,
    /// See [`Region::occupied`]; kept with the picture.
    occupied: Arc<OnceLock<Vec<u64>>>,
}

/// Where a mask has its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum MaskChannel {
    Alpha,
    Luma,
}

impl MaskChannel {
    /// The value of a pixel, 0 to [`FULL_WEIGHT`].
    fn weight(self, pixel: &[u16]) -> u16 {
        match self {
            Self::Alpha => pixel[3],
            Self::Luma => {
                let [r, g, b] = [pixel[0], pixel[1], pixel[2]].map(u32::from);
                // Rec. 709; exactly the value of a grey pixel.
                #[expect(clippy::cast_possible_truncation, reason = "a mean of 16-bit numbers")]
                let luma = ((2126 * r + 7152 * g + 722 * b + 5000) / 10_000) as u16;
                luma
            }
        }
    }
}

impl Region {
    /// A picture as a mask: its alpha if it has transparent pixels, otherwise its luma; white, or
    /// opaque, moves.
    #[must_use]
    pub fn new(mask: &Image) -> Self {
        let channel = if mask.source.pixmap().is_opaque() {
            MaskChannel::Luma
        } else {
            MaskChannel::Alpha
        };
        Self {
            mask: Arc::clone(&mask.source),
            channel,
            digest: mask.digest(),
            occupied: Arc::clone(&mask.occupied),
        }
    }

    pub(super) fn mask(&self) -> &Source {
        &self.mask
    }

    /// Size of the mask, which must be that of the picture.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.mask.pixmap().extent()
    }

    /// The digest of the mask's file.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// Left, top, right and bottom edge of a box that contains the picture and all posed cells with
    /// some of the mask, px. Work: the pixels of a mask are read once for all poses, and their bits
    /// once for each. `None` when cancelled, which is checked for each row.
    pub(super) fn bounds(&self, mesh: &Mesh, cancelled: IsCancelled<'_>) -> Option<[f64; 4]> {
        let occupied = self.occupied(cancelled)?;
        let grid = mesh.grid();
        let (width, height) = (
            self.extent().width() as usize,
            self.extent().height() as usize,
        );
        let mut bounds = [0.0, 0.0, grid.width(), grid.height()];
        // The columns of the mask that have some of it in the rows of the cells.
        let mut columns = vec![0_u64; width.div_ceil(WORD_BITS)];
        for j in 0..grid.rows() - 1 {
            if cancelled() {
                return None;
            }
            let rows = pixels(grid.vertex(0, j).y, grid.vertex(0, j + 1).y, height);
            columns.fill(0);
            for row in occupied[rows.start * columns.len()..rows.end * columns.len()]
                .chunks_exact(columns.len())
            {
                columns
                    .iter_mut()
                    .zip(row)
                    .for_each(|(column, row)| *column |= row);
            }
            for i in 0..grid.columns() - 1 {
                if has_bit(
                    &columns,
                    pixels(grid.vertex(i, j).x, grid.vertex(i + 1, j).x, width),
                ) {
                    let [left, top, right, bottom] = mesh.cell_bounds(i, j);
                    bounds = [
                        bounds[0].min(left),
                        bounds[1].min(top),
                        bounds[2].max(right),
                        bounds[3].max(bottom),
                    ];
                }
            }
        }
        Some(bounds)
    }

    /// A bit for each pixel: whether it has some of the mask. Rows of whole words.
    fn occupied(&self, cancelled: IsCancelled<'_>) -> Option<&[u64]> {
        if self.occupied.get().is_none() {
            let pixmap = self.mask.pixmap();
            let row = pixmap.extent().width() as usize * pixmap.channels().count();
            let channel = self.channel;
            let occupied = match pixmap.samples() {
                Samples::Eight(samples) => {
                    // The luma is above 0 if any of its samples is; to ask for that is several
                    // times as quick.
                    let has_some = |pixel: &[u8]| match channel {
                        MaskChannel::Alpha => pixel[3] > 0,
                        MaskChannel::Luma => pixel[0] | pixel[1] | pixel[2] > 0,
                    };
                    self.occupied_rows(samples.chunks_exact(row), has_some, cancelled)?
                }
                Samples::Sixteen(samples) => {
                    let has_some = |pixel: &[u16]| channel.weight(pixel) > 0;
                    self.occupied_rows(samples.chunks_exact(row), has_some, cancelled)?
                }
            };
            // Another request may have been first, with the same.
            let _ = self.occupied.set(occupied);
        }
        self.occupied.get().map(Vec::as_slice)
    }

    fn occupied_rows<'a, S: 'a>(
        &self,
        rows: impl Iterator<Item = &'a [S]>,
        has_some: impl Fn(&[S]) -> bool,
        cancelled: IsCancelled<'_>,
    ) -> Option<Vec<u64>> {
        let count = self.mask.pixmap().channels().count();
        let mut occupied = Vec::with_capacity(occupied_words(self.extent()));
        for row in rows {
            if cancelled() {
                return None;
            }
            let word = |pixels: &[S]| {
                pixels
                    .chunks_exact(count)
                    .rev()
                    .fold(0, |word, pixel| word << 1 | u64::from(has_some(pixel)))
            };
            occupied.extend(row.chunks(WORD_BITS * count).map(word));
        }
        Some(occupied)
    }

    /// Appends the weights of a row of the mask.
    pub(super) fn weights_of_row(&self, y: u32, weights: &mut Vec<u16>) {
        let channel = self.channel;
        for_each_pixel(self.mask.pixmap(), y, |pixel| {
            weights.push(channel.weight(pixel))
        });
    }

    /// The mask through a mesh, 0 outside.
    pub(super) fn drawer(&self, mesh: &Mesh, options: RenderOptions) -> MaskDrawer {
        let alpha = if self.channel == MaskChannel::Alpha {
            0
        } else {
            u8::MAX
        };
        let options = RenderOptions {
            outside: Outside::Colour([0, 0, 0, alpha]),
            force_alpha: false,
            ..options
        };
        MaskDrawer {
            renderer: Renderer::new(Arc::clone(&self.mask), mesh, options),
            channel: self.channel,
        }
    }
}

/// The pixels of a mask, of `side` px, that a cell between these coordinates may show.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates"
)]
fn pixels(from: f64, to: f64, side: usize) -> Range<usize> {
    ((from - FILTER_REACH).floor() as usize).min(side - 1)
        ..((to + FILTER_REACH).ceil() as usize).min(side)
}

/// Words of the bits of a picture.
pub(super) fn occupied_words(extent: Extent) -> usize {
    (extent.width() as usize).div_ceil(WORD_BITS) * extent.height() as usize
}

/// Whether a bit of this range is set.
fn has_bit(words: &[u64], bits: Range<usize>) -> bool {
    let (first, last) = (bits.start / WORD_BITS, (bits.end - 1) / WORD_BITS);
    let (from, to) = (
        u64::MAX << (bits.start % WORD_BITS),
        u64::MAX >> (WORD_BITS - 1 - (bits.end - 1) % WORD_BITS),
    );
    if first == last {
        return words[first] & from & to != 0;
    }
    words[first] & from != 0
        || words[last] & to != 0
        || words[first + 1..last].iter().any(|word| *word != 0)
}

/// Calls a function with the samples of each pixel of a row, in 16 bits; opaque without alpha.
pub(super) fn for_each_pixel(pixmap: &Pixmap, y: u32, mut pixel: impl FnMut(&[u16; 4])) {
    let count = pixmap.channels().count();
    let row = pixmap.extent().width() as usize * count;
    let row = y as usize * row..(y as usize + 1) * row;
    let mut values = [FULL_WEIGHT; 4];
    match pixmap.samples() {
        Samples::Eight(samples) => {
            for samples in samples[row].chunks_exact(count) {
                values
                    .iter_mut()
                    .zip(samples)
                    .for_each(|(value, s)| *value = widened(*s));
                pixel(&values);
            }
        }
        Samples::Sixteen(samples) => {
            for samples in samples[row].chunks_exact(count) {
                values
                    .iter_mut()
                    .zip(samples)
                    .for_each(|(value, s)| *value = *s);
                pixel(&values);
            }
        }
    }
}

const fn widened(sample: u8) -> u16 {
    257 * sample as u16
}

/// Draws a mask.
#[derive(Debug)]
pub(super) struct MaskDrawer {
    renderer: Renderer,
    channel: MaskChannel,
}

impl MaskDrawer {
    /// Pixels whose source positions are computed to draw a row, at most.
    pub(super) fn computed_width(&self) -> u32 {
        self.renderer.computed_width()
    }

    /// The weights of the pixels of target rows, 0 to [`FULL_WEIGHT`].
    pub(super) fn weights(&self, rows: Range<u32>, cancelled: &dyn Fn() -> bool) -> Vec<u16> {
        let (count, depth) = (self.renderer.channels().count(), self.renderer.depth());
        let mut samples =
            vec![0; rows.len() * self.renderer.target().width() as usize * count * depth.bytes()];
        self.renderer.band(rows, &mut samples, cancelled);
        let pixels = samples.chunks_exact(count * depth.bytes());
        let weight = |pixel: &[u8]| {
            let mut values = [FULL_WEIGHT; 4];
            match depth {
                Depth::Eight => values
                    .iter_mut()
                    .zip(pixel)
                    .for_each(|(value, sample)| *value = widened(*sample)),
                Depth::Sixteen => {
                    values
                        .iter_mut()
                        .zip(pixel.as_chunks().0)
                        .for_each(|(value, sample)| *value = u16::from_be_bytes(*sample));
                }
            }
            self.channel.weight(&values)
        };
        pixels.map(weight).collect()
    }
}
