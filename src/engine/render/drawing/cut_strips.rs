//! A cut grid, drawn quad by quad: from the last one back, into pixels that are not covered yet.

use std::ops::Range;

use super::{Drawing, SLACK_PIXELS, StripScratch};
use crate::render::cell;
use crate::render::kernel::{Raster, UNCOVERED};
use crate::render::snapped_cut::{SnappedCut, SnappedQuad};

/// Quads after which the uncovered pixels are counted again.
const QUADS_PER_LOOK: usize = 64;

impl Drawing {
    /// Writes the source coordinates of all pixels of a strip into the scratch, from its second row
    /// on.
    pub(super) fn draw_cut(
        &self,
        cut: &SnappedCut,
        strip: &Range<u32>,
        scratch: &mut StripScratch,
        cancelled: &dyn Fn() -> bool,
    ) {
        let (width, rows) = (self.width(), strip.len());
        let pitch = width + SLACK_PIXELS;
        for plane in [
            &mut scratch.u,
            &mut scratch.v,
            &mut scratch.quad_u,
            &mut scratch.quad_v,
        ] {
            plane.resize(plane.len().max((1 + rows) * pitch), 0.0);
        }
        for row in 1..=rows {
            let (drawn, slack) = (row * pitch..row * pitch + width, row * pitch + width..);
            for plane in [&mut scratch.u, &mut scratch.quad_u] {
                plane[drawn.clone()].fill(UNCOVERED);
                plane[slack.clone()][..SLACK_PIXELS].fill(0.0);
            }
        }
        scratch.uncovered.clear();
        scratch.uncovered.resize(rows, 0..width);
        let mut all = vec![0..width; rows];
        let every_row = u32::MAX >> (u32::BITS as usize - rows);
        let StripScratch {
            u,
            v,
            quad_u,
            quad_v,
            uncovered,
            ..
        } = scratch;
        let mut raster = Raster {
            first: strip.start,
            width,
            pitch,
            u: &mut u[pitch..],
            v: &mut v[pitch..],
            over: false,
            uncovered,
            open: every_row,
        };
        let mut single = Raster {
            first: strip.start,
            width,
            pitch,
            u: &mut quad_u[pitch..],
            v: &mut quad_v[pitch..],
            over: true,
            uncovered: &mut all,
            open: every_row,
        };
        let meeting = |is_loose: bool| {
            let quads = cut.quads.iter().rev();
            quads.filter(move |quad| quad.cell.is_loose == is_loose && quad.meets(strip))
        };
        let meeting = meeting(false).chain(meeting(true));
        for (k, quad) in meeting.enumerate() {
            if k % QUADS_PER_LOOK == 0 {
                raster.shrink();
                if raster.open == 0 || cancelled() {
                    break;
                }
            }
            if quad.is_partial() {
                // What the quad covers is found first: it leaves the texels of others uncovered.
                cell::draw_single(self.kernel, &quad.corners, &self.lattice, &mut single);
                take(cut, quad, rows, &mut single, &mut raster);
            } else {
                cell::draw_single(self.kernel, &quad.corners, &self.lattice, &mut raster);
            }
        }
        raster.shrink();
    }
}

/// Copies the pixels of a quad to uncovered ones, where the quad owns the texel that it shows.
fn take(
    cut: &SnappedCut,
    quad: &SnappedQuad,
    rows: usize,
    from: &mut Raster<'_>,
    to: &mut Raster<'_>,
) {
    let [rows, pixels] = quad.pixels(from.first, rows, from.width);
    for row in rows {
        let pixels = row * from.pitch + pixels.start..row * from.pitch + pixels.end;
        for at in pixels {
            let (u, v) = (std::mem::replace(&mut from.u[at], UNCOVERED), from.v[at]);
            if u != UNCOVERED && to.u[at] == UNCOVERED && cut.draws(quad, u, v) {
                (to.u[at], to.v[at]) = (u, v);
            }
        }
    }
}
