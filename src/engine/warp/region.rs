//! A region: the part of a picture whose content moves. Everything else stays as it is.
//!
//! A mask of the picture's size says how much of each position belongs to the region, 0 to 1. The drawn picture has three layers, all on
//! the same canvas, at the same scale and with the same filter:
//!
//! * the *background* S: the source at rest, as a warp without handles draws it, with what `outside` puts beyond it;
//! * the *moved part* M: the source through the posed mesh;
//! * the *moved mask* m: the mask through the posed mesh, 0 where no posed cell is; and the *mask at rest* r.
//!
//! At each pixel the result is `m M + k S`, in colours times alpha, where k is the share of the background that is kept:
//!
//! * `holes: keep`: `k = 1 - m`;
//! * `holes: transparent`: `k = min(1 - m, 1 - r)`. The content of the region is taken from the background, as far as the moved part does
//!   not replace it.
//!
//! What `transparent` leaves open, `1 - m - k = max(0, r - m)`, is the *hole*: content moved away from it, and nothing covers it.
//!
//! Where m is 0 (and r, with transparent holes), the result is the background bit for bit. Where m is 1, it is the moved part: a mask that
//! is 1 everywhere gives the warp without a region wherever a posed cell is drawn. Where nothing moves, m = r and M = S, and the result is
//! the source. A feathered mask gives a transition as wide as the feather. Coverage is mixed like the picture. Labels are not mixed: a pixel
//! has the label of the moved part where m is at least 1/2, otherwise that of the background, and 0 in a transparent hole of more than 1/2.
//!
//! A region changes what is drawn, not f: annotations, maps and reports are those of the whole warp.

use std::ops::Range;
use std::sync::Arc;

use super::{Digest, Image};
use crate::geometry::Mesh;
use crate::pixmap::{Depth, Extent, Samples};
use crate::render::{FULL_WEIGHT, Outside, RenderOptions, Renderer, Source};

/// Pixels of the mask around a cell that a filter may add to it.
const FILTER_REACH: f64 = 2.0;

/// The part of a picture that moves: a mask of the picture's size, feathered or not. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Region {
    mask: Arc<Source>,
    channel: MaskChannel,
    digest: Digest,
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
    /// A picture as a mask: its alpha if it has transparent pixels, otherwise its luma; white, or opaque, moves.
    #[must_use]
    pub fn new(mask: &Image) -> Self {
        let channel = if mask.source.pixmap().is_opaque() { MaskChannel::Luma } else { MaskChannel::Alpha };
        Self { mask: Arc::clone(&mask.source), channel, digest: mask.digest() }
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

    /// Left, top, right and bottom edge of a box that contains the picture and all posed cells with some of the mask, px. Work: each pixel
    /// of the mask is read once, whatever the size of the cells.
    pub(super) fn bounds(&self, mesh: &Mesh) -> [f64; 4] {
        let grid = mesh.grid();
        let (width, height) = (self.extent().width() as usize, self.extent().height() as usize);
        let mut bounds = [0.0, 0.0, grid.width(), grid.height()];
        // For each column, the number of rows down to the last pixel of the mask that has been read.
        let (mut last, mut read) = (vec![0; width], 0);
        // For each column, the number of columns before it that have some of the mask in the rows of the cells.
        let mut before = vec![0_u32; width + 1];
        for j in 0..grid.rows() - 1 {
            let rows = pixels(grid.vertex(0, j).y, grid.vertex(0, j + 1).y, height);
            for y in read..rows.end {
                for (x, last) in last.iter_mut().enumerate() {
                    if self.weight_at(x, y) > 0 {
                        *last = y + 1;
                    }
                }
            }
            read = rows.end;
            for x in 0..width {
                before[x + 1] = before[x] + u32::from(last[x] > rows.start);
            }
            for i in 0..grid.columns() - 1 {
                let columns = pixels(grid.vertex(i, j).x, grid.vertex(i + 1, j).x, width);
                if before[columns.end] > before[columns.start] {
                    let [left, top, right, bottom] = mesh.cell_bounds(i, j);
                    bounds = [bounds[0].min(left), bounds[1].min(top), bounds[2].max(right), bounds[3].max(bottom)];
                }
            }
        }
        bounds
    }

    fn weight_at(&self, x: usize, y: usize) -> u16 {
        let pixmap = self.mask.pixmap();
        let count = pixmap.channels().count();
        let start = (y * pixmap.extent().width() as usize + x) * count;
        let mut pixel = [FULL_WEIGHT; 4];
        for (k, value) in pixel.iter_mut().enumerate().take(count) {
            *value = match pixmap.samples() {
                Samples::Eight(samples) => widened(samples[start + k]),
                Samples::Sixteen(samples) => samples[start + k],
            };
        }
        self.channel.weight(&pixel)
    }

    /// The mask through a mesh, 0 outside.
    pub(super) fn drawer(&self, mesh: &Mesh, options: RenderOptions) -> MaskDrawer {
        let alpha = if self.channel == MaskChannel::Alpha { 0 } else { u8::MAX };
        let options = RenderOptions { outside: Outside::Colour([0, 0, 0, alpha]), force_alpha: false, ..options };
        MaskDrawer { renderer: Renderer::new(Arc::clone(&self.mask), mesh, options), channel: self.channel }
    }
}

/// The pixels of a mask, of `side` px, that a cell between these coordinates may show.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "float to integer saturates")]
fn pixels(from: f64, to: f64, side: usize) -> Range<usize> {
    ((from - FILTER_REACH).floor() as usize).min(side - 1)..((to + FILTER_REACH).ceil() as usize).min(side)
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
    pub(super) fn weights(&self, rows: Range<u32>) -> Vec<u16> {
        let (count, depth) = (self.renderer.channels().count(), self.renderer.depth());
        let mut samples = vec![0; rows.len() * self.renderer.target().width() as usize * count * depth.bytes()];
        self.renderer.band(rows, &mut samples);
        let pixels = samples.chunks_exact(count * depth.bytes());
        let weight = |pixel: &[u8]| {
            let mut values = [FULL_WEIGHT; 4];
            match depth {
                Depth::Eight => values.iter_mut().zip(pixel).for_each(|(value, sample)| *value = widened(*sample)),
                Depth::Sixteen => {
                    values.iter_mut().zip(pixel.as_chunks().0).for_each(|(value, sample)| *value = u16::from_be_bytes(*sample));
                }
            }
            self.channel.weight(&values)
        };
        pixels.map(weight).collect()
    }
}
