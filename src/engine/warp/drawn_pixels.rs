//! A drawing in memory: the same rows as those of a file, without a file.

use super::mesh_renderer::MeshRenderer;
use super::{OutputSpec, PosedMesh, Quantity, RasterSource, Target, WarpError};
use crate::deform::IsCancelled;
use crate::parallel::prelude::*;
use crate::pixmap::{Channels, Depth, PixelLayout, Pixels};
use crate::render::band_rows;

/// Pixels that are computed between two checks of cancellation.
const PIXELS_PER_CHECK: u32 = 1 << 18;

/// Labels with the bits that they came with, row by row; of colours, all samples of a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LabelValues {
    /// 8 bit.
    Eight(Vec<u8>),
    /// 16 bit.
    Sixteen(Vec<u16>),
    /// 32 bit.
    ThirtyTwo(Vec<u32>),
}

/// What was drawn.
#[derive(Debug)]
pub(crate) struct DrawnPixels {
    layout: PixelLayout,
    /// As a PNG stores them: 16 bit big-endian.
    samples: Vec<u8>,
    is_32_bit: bool,
}

impl DrawnPixels {
    pub(crate) fn into_pixels(self) -> Pixels {
        Pixels::of_png_order(self.layout, self.samples)
    }

    pub(crate) fn into_labels(self) -> LabelValues {
        if self.is_32_bit {
            let labels = self.samples.as_chunks::<4>().0.iter();
            return LabelValues::ThirtyTwo(
                labels.map(|label| u32::from_be_bytes(*label)).collect(),
            );
        }
        match self.layout.depth {
            Depth::Eight => LabelValues::Eight(self.samples),
            Depth::Sixteen => {
                let labels = self.samples.as_chunks::<2>().0.iter();
                LabelValues::Sixteen(labels.map(|label| u16::from_be_bytes(*label)).collect())
            }
        }
    }
}

/// Room for a number of values, all of them the default.
///
/// # Errors
/// More than there is memory for.
pub(crate) fn reserved<T: Copy + Default>(count: u64) -> Result<Vec<T>, WarpError> {
    /// Values that are copied at once.
    const PIECE: usize = 4096;
    let mut values = Vec::new();
    let room = usize::try_from(count)
        .ok()
        .filter(|count| values.try_reserve_exact(*count).is_ok());
    let Some(length) = room else {
        return Err(WarpError::TooLarge {
            what: Quantity::Memory,
            limit: isize::MAX.unsigned_abs() as u64,
            actual: count.saturating_mul(size_of::<T>() as u64),
        });
    };
    // Copies of a first piece: compiled for size, `resize` writes one value at a time.
    values.resize(length.min(PIECE), T::default());
    while values.len() < length {
        values.extend_from_within(..PIECE.min(length - values.len()));
    }
    Ok(values)
}

impl RasterSource<'_> {
    /// Draws a target of `output` in memory, in parallel. A source without alpha stays without it
    /// unless the target is to have it.
    pub(crate) fn draw(
        self,
        target: Target,
        posed: &PosedMesh,
        output: &OutputSpec,
        cancelled: IsCancelled<'_>,
    ) -> Result<DrawnPixels, WarpError> {
        self.make_copies(target, posed, output, cancelled)?;
        let drawer = self.drawer(target, posed, output);
        let drawn = drawer.layout();
        let has_alpha = match self {
            Self::Image(image) => image.has_alpha() || target.force_alpha,
            Self::Labels(_) | Self::Coverage(_) | Self::Holes(_) => {
                drawn.channels == Channels::Rgba
            }
        };
        let layout = PixelLayout {
            channels: if has_alpha {
                drawn.channels
            } else {
                Channels::Rgb
            },
            ..drawn
        };
        let mut samples = reserved(layout.sample_bytes())?;
        draw_rows(&drawer, layout, &mut samples, cancelled).ok_or(WarpError::Cancelled)?;
        Ok(DrawnPixels {
            layout,
            samples,
            is_32_bit: matches!(self, Self::Labels(image) if image.labels.is_32_bit),
        })
    }
}

/// `None` when cancelled.
fn draw_rows(
    drawer: &MeshRenderer,
    layout: PixelLayout,
    out: &mut [u8],
    cancelled: IsCancelled<'_>,
) -> Option<()> {
    let (width, drawn) = (layout.extent.width() as usize, drawer.pixel_bytes());
    let step = band_rows(PIXELS_PER_CHECK, drawer.computed_width());
    let row = width * layout.pixel_bytes();
    let band = |scratch: &mut Vec<u8>, (index, out): (usize, &mut [u8])| {
        if cancelled() {
            return None;
        }
        let first = u32::try_from(index * step as usize).ok()?;
        let rows = first..first.saturating_add(step).min(layout.extent.height());
        if layout.pixel_bytes() == drawn {
            drawer.band(rows, out, cancelled);
            return (!cancelled()).then_some(());
        }
        scratch.resize(out.len() / layout.pixel_bytes() * drawn, 0);
        drawer.band(rows, scratch, cancelled);
        keep(layout, scratch, drawn, out);
        (!cancelled()).then_some(())
    };
    out.par_chunks_mut(row * step as usize)
        .enumerate()
        .try_for_each_init(Vec::new, band)
}

/// Of drawn pixels, the first of three equal colours, and alpha, as far as the layout has them.
fn keep(layout: PixelLayout, drawn: &[u8], drawn_bytes: usize, out: &mut [u8]) {
    let sample = layout.depth.bytes();
    let colours = if layout.grey { sample } else { 3 * sample };
    let kept = out.chunks_exact_mut(layout.pixel_bytes());
    for (out, pixel) in kept.zip(drawn.chunks_exact(drawn_bytes)) {
        let (colour, alpha) = out.split_at_mut(colours);
        colour.copy_from_slice(&pixel[..colours]);
        alpha.copy_from_slice(&pixel[3 * sample..][..alpha.len()]);
    }
}
