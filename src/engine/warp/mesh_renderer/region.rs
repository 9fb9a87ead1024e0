//! Draws a source of which a region moves, and the holes that the region leaves. `warp/region.rs`
//! has the rule.

use std::ops::Range;

use super::super::region::MaskDrawer;
use super::super::{Holes, RasterSource, Region};
use super::MeshRenderer;
use crate::geometry::Mesh;
use crate::pixmap::{Channels, Extent, PixelLayout};
use crate::render::{FULL_WEIGHT, Outside, RenderOptions, STRIP_ROWS, blend};

const HALF_WEIGHT: u16 = FULL_WEIGHT / 2;

/// Memory for mixing, bytes, of each thread.
#[cfg(feature = "codec")]
pub(super) fn work_bytes(target: Extent) -> u64 {
    /// Two pictures and a mask of four 16-bit samples each, and four weights.
    const PIXEL_BYTES: u64 = 32;
    u64::from(STRIP_ROWS) * u64::from(target.width()) * PIXEL_BYTES
}

/// Draws a source of which only the content of a region moves.
#[derive(Debug)]
pub(in super::super) struct RegionDrawer {
    background: MeshRenderer,
    moved: MeshRenderer,
    weights: Weights,
    /// Those of the result, if the source is an image.
    channels: Channels,
}

impl RegionDrawer {
    pub(in super::super) fn new(
        source: RasterSource<'_>,
        region: &Region,
        mesh: &Mesh,
        options: RenderOptions,
        holes: Holes,
    ) -> Self {
        let at_rest = Mesh::identity(*mesh.grid());
        let background = MeshRenderer::new(source, &at_rest, options);
        // What is outside the moved part is not visible: the mask is 0 there.
        let moved = MeshRenderer::new(
            source,
            mesh,
            RenderOptions {
                outside: Outside::Colour([0, 0, 0, u8::MAX]),
                force_alpha: false,
                ..options
            },
        );
        let weights = Weights {
            mask: region.drawer(mesh, options),
            mask_at_rest: (holes == Holes::Transparent).then(|| region.drawer(&at_rest, options)),
        };
        let channels = match &background {
            MeshRenderer::Image { renderer, .. } if holes == Holes::Keep => renderer.channels(),
            MeshRenderer::Image { .. }
            | MeshRenderer::Labels { .. }
            | MeshRenderer::Coverage(_)
            | MeshRenderer::CutCoverage { .. }
            | MeshRenderer::Region(_)
            | MeshRenderer::Holes(_) => Channels::Rgba,
        };
        Self {
            background,
            moved,
            weights,
            channels,
        }
    }

    pub(super) fn target(&self) -> Extent {
        self.background.target()
    }

    #[cfg(feature = "codec")]
    pub(super) fn adds_alpha(&self) -> bool {
        match (&self.background, &self.moved) {
            (MeshRenderer::Image { .. }, MeshRenderer::Image { renderer, .. }) => {
                self.channels != renderer.channels()
            }
            _ => false,
        }
    }

    pub(super) fn layout(&self) -> PixelLayout {
        let layout = self.background.layout();
        if matches!(self.background, MeshRenderer::Image { .. }) {
            PixelLayout {
                channels: self.channels,
                ..layout
            }
        } else {
            layout
        }
    }

    pub(super) fn pixel_bytes(&self) -> usize {
        if let MeshRenderer::Image { renderer, .. } = &self.background {
            self.channels.count() * renderer.depth().bytes()
        } else {
            self.background.pixel_bytes()
        }
    }

    pub(super) fn computed_width(&self) -> u32 {
        let pictures = self
            .background
            .computed_width()
            .saturating_add(self.moved.computed_width());
        pictures.saturating_add(self.weights.mask.computed_width().saturating_mul(2))
    }

    pub(super) fn band(&self, rows: Range<u32>, out: &mut [u8], cancelled: &dyn Fn() -> bool) {
        let row = out.len() / rows.len().max(1);
        for (first, out) in rows
            .clone()
            .step_by(STRIP_ROWS as usize)
            .zip(out.chunks_mut(STRIP_ROWS as usize * row))
        {
            self.strip(first..rows.end.min(first + STRIP_ROWS), out, cancelled);
        }
    }

    fn strip(&self, rows: Range<u32>, out: &mut [u8], cancelled: &dyn Fn() -> bool) {
        self.draw_background(rows.clone(), out, cancelled);
        let Some(weights) = self.weights.of(rows.clone(), cancelled) else {
            return;
        };
        let mut samples = vec![0; weights.len() * self.moved.pixel_bytes()];
        self.moved.band(rows, &mut samples, cancelled);
        match &self.moved {
            MeshRenderer::Image { renderer, .. } => blend(
                out,
                self.channels,
                &samples,
                renderer.channels(),
                renderer.depth(),
                &weights,
            ),
            MeshRenderer::Labels { .. } => {
                let pixel = self.moved.pixel_bytes();
                for ((out, moved), [m, k]) in out
                    .chunks_exact_mut(pixel)
                    .zip(samples.chunks_exact(pixel))
                    .zip(weights)
                {
                    if m > HALF_WEIGHT {
                        out.copy_from_slice(moved);
                    } else if FULL_WEIGHT - m - k > HALF_WEIGHT {
                        out.fill(0);
                    }
                }
            }
            MeshRenderer::Coverage(_)
            | MeshRenderer::CutCoverage { .. }
            | MeshRenderer::Region(_)
            | MeshRenderer::Holes(_) => {
                let pixel = self.moved.pixel_bytes();
                for ((out, moved), weights) in out
                    .chunks_exact_mut(pixel)
                    .zip(samples.chunks_exact(pixel))
                    .zip(weights)
                {
                    out.fill(mixed(moved[0], out[0], weights));
                }
            }
        }
    }

    fn draw_background(&self, rows: Range<u32>, out: &mut [u8], cancelled: &dyn Fn() -> bool) {
        let MeshRenderer::Image { renderer, .. } = &self.background else {
            return self.background.band(rows, out, cancelled);
        };
        if renderer.channels() == self.channels {
            return renderer.band(rows, out, cancelled);
        }
        let (colours, alpha) = (3 * renderer.depth().bytes(), renderer.depth().bytes());
        let mut samples = vec![0; out.len() / (colours + alpha) * colours];
        renderer.band(rows, &mut samples, cancelled);
        for (out, pixel) in out
            .chunks_exact_mut(colours + alpha)
            .zip(samples.chunks_exact(colours))
        {
            out[..colours].copy_from_slice(pixel);
            out[colours..].fill(u8::MAX);
        }
    }
}

/// The weighted sum of two samples; the weights add up to at most [`FULL_WEIGHT`].
fn mixed(a: u8, b: u8, [w, v]: [u16; 2]) -> u8 {
    let sum = u32::from(a) * u32::from(w) + u32::from(b) * u32::from(v);
    #[expect(clippy::cast_possible_truncation, reason = "a mean of 8-bit numbers")]
    let mean = ((sum + u32::from(HALF_WEIGHT)) / u32::from(FULL_WEIGHT)) as u8;
    mean
}

/// The weights of the moved part and of the background.
#[derive(Debug)]
struct Weights {
    mask: MaskDrawer,
    /// With transparent holes.
    mask_at_rest: Option<MaskDrawer>,
}

impl Weights {
    /// The weights of the moved part and of the background for each pixel of target rows; `None` if
    /// all pixels show the background alone.
    fn of(&self, rows: Range<u32>, cancelled: &dyn Fn() -> bool) -> Option<Vec<[u16; 2]>> {
        let moved = self.mask.weights(rows.clone(), cancelled);
        let at_rest = self
            .mask_at_rest
            .as_ref()
            .map(|mask| mask.weights(rows, cancelled));
        let is_background = |mask: &[u16]| mask.iter().all(|share| *share == 0);
        if is_background(&moved) && at_rest.as_deref().is_none_or(is_background) {
            return None;
        }
        Some(match at_rest {
            None => moved.into_iter().map(|m| [m, FULL_WEIGHT - m]).collect(),
            Some(at_rest) => moved
                .into_iter()
                .zip(at_rest)
                .map(|(m, r)| [m, FULL_WEIGHT - m.max(r)])
                .collect(),
        })
    }
}

/// Draws the holes that a region leaves: grey, opaque, 8 bit.
#[derive(Debug)]
pub(in super::super) struct HolesDrawer {
    mask: MaskDrawer,
    mask_at_rest: MaskDrawer,
    target: Extent,
}

impl HolesDrawer {
    pub(super) fn new(region: &Region, mesh: &Mesh, options: RenderOptions) -> Self {
        let at_rest = Mesh::identity(*mesh.grid());
        Self {
            mask: region.drawer(mesh, options),
            mask_at_rest: region.drawer(&at_rest, options),
            target: options.target,
        }
    }

    pub(super) const fn target(&self) -> Extent {
        self.target
    }

    pub(super) fn computed_width(&self) -> u32 {
        self.mask
            .computed_width()
            .saturating_add(self.mask_at_rest.computed_width())
    }

    pub(super) fn band(&self, rows: Range<u32>, out: &mut [u8], cancelled: &dyn Fn() -> bool) {
        let row = out.len() / rows.len().max(1);
        for (first, out) in rows
            .clone()
            .step_by(STRIP_ROWS as usize)
            .zip(out.chunks_mut(STRIP_ROWS as usize * row))
        {
            let rows = first..rows.end.min(first + STRIP_ROWS);
            let holes = self
                .mask_at_rest
                .weights(rows.clone(), cancelled)
                .into_iter()
                .zip(self.mask.weights(rows, cancelled));
            for (out, (r, m)) in out.as_chunks_mut::<3>().0.iter_mut().zip(holes) {
                *out = [mixed(u8::MAX, 0, [r.saturating_sub(m), 0]); 3];
            }
        }
    }
}
