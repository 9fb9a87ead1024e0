//! The target image J: warped images are added pixel by pixel with their colour weights, and the
//! sum is rounded once.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::parallel::prelude::*;

use super::super::digest::Collector;
use super::super::image::Inherited;
use super::super::{Image, OutputSpec, PosedMesh, RasterSource, Target, WarpError};
use crate::deform::IsCancelled;
use crate::geometry::lane_math::pow;
use crate::pixmap::{Channels, Depth, Extent, Pixmap, Samples};
use crate::render::Canvas;

/// Rows that are drawn before cancellation is asked for again.
const ROWS_PER_CHECK: usize = 16;
/// Bytes of a pixel of the sum.
const PIXEL_BYTES: u64 = 16;

/// The values that are added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum BlendSpace {
    /// Samples as files have them.
    #[default]
    Srgb,
    /// Intensities of light, by the curve of sRGB.
    Linear,
}

/// How pixels are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    /// No weight is negative: colours weigh as much as they cover, so what an image does not cover
    /// does not darken the sum. Sums: `b alpha c` and `b alpha`.
    Coverage,
    /// A difference of colours, or one image alone: nothing is divided. Sums: `b c`, and the least
    /// alpha.
    Difference,
}

/// The sum of warped images.
#[derive(Debug)]
pub struct ImageSum {
    target: Target,
    space: BlendSpace,
    rule: Rule,
    /// Shape `[height][width]`.
    pixels: Vec<[f32; 4]>,
    depth: Depth,
    is_grey: bool,
    has_alpha: bool,
    digest: Collector,
    /// The values of the samples of this depth, for all images that have it.
    curve: Option<(Depth, Vec<f32>)>,
    /// From the first image.
    inherited: Option<Inherited>,
}

/// The target image, and what was lost by rounding it.
#[derive(Debug)]
pub struct BlendedImage {
    /// The image.
    pub image: Image,
    /// Samples that were below 0 or above the largest value, and were cut off.
    pub clamped: u64,
}

impl ImageSum {
    /// Memory of a sum of this size with the image that is made of it, bytes.
    #[must_use]
    pub fn bytes(extent: Extent) -> u64 {
        extent.pixels().saturating_mul(PIXEL_BYTES + 12)
    }

    /// An empty sum. `canvas`: the part of the reference frame that it shows; `extent`: its size in
    /// pixels; `weights`: the colour weights of all images that will be added.
    #[must_use]
    pub fn new(canvas: Canvas, extent: Extent, space: BlendSpace, weights: &[f64]) -> Self {
        let is_negative = weights.iter().any(|weight| *weight < 0.0);
        let is_single = weights.iter().filter(|weight| **weight != 0.0).count() == 1;
        let rule = if is_negative || is_single {
            Rule::Difference
        } else {
            Rule::Coverage
        };
        let empty = match rule {
            Rule::Coverage => [0.0; 4],
            Rule::Difference => [0.0, 0.0, 0.0, 1.0],
        };
        let pixels = usize::try_from(extent.pixels()).expect("checked against the limit of images");
        let digest = Collector::new("mlswarp blend 1")
            .integer(u64::from(space == BlendSpace::Linear))
            .integer(extent.width().into())
            .integer(extent.height().into())
            .bytes(format!("{canvas:?}").as_bytes());
        Self {
            target: Target::of(Some(canvas), extent),
            space,
            rule,
            pixels: vec![empty; pixels],
            depth: Depth::Eight,
            is_grey: true,
            has_alpha: false,
            digest,
            curve: None,
            inherited: None,
        }
    }

    /// Makes the copies of an image (packed, reduced) for which [`ImageSum::add`] otherwise takes
    /// the time. They are kept, and other drawings of the image wait while they are made.
    ///
    /// # Errors
    /// Cancelled.
    pub fn make_copies(
        &self,
        image: &Image,
        posed: &PosedMesh,
        (weight, mirrored_in): (f64, Option<u32>),
        output: &OutputSpec,
        cancelled: IsCancelled<'_>,
    ) -> Result<(), WarpError> {
        if weight == 0.0 {
            return Ok(());
        }
        let target = self.target_of(mirrored_in);
        RasterSource::Image(image).make_copies(target, posed, output, cancelled)
    }

    /// Adds an image, posed by its mesh, with a weight. `mirrored_in`: the mesh is that of the
    /// mirrored target in a frame of this width, px, and what is drawn is mirrored; so an image and
    /// its mirror image differ by nothing but the side. An image of weight 0 adds nothing but the
    /// metadata of the result, if it is the first.
    ///
    /// # Errors
    /// Cancelled; the sum is then incomplete.
    pub fn add(
        &mut self,
        image: &Image,
        posed: &PosedMesh,
        (weight, mirrored_in): (f64, Option<u32>),
        output: &OutputSpec,
        cancelled: IsCancelled<'_>,
    ) -> Result<(), WarpError> {
        self.inherited.get_or_insert_with(|| image.inherited());
        let drawn = format!("{:?} {:?}", output.filter, output.outside);
        self.digest = std::mem::take(&mut self.digest)
            .bytes(&image.digest().0)
            .bytes(&posed.digest().0)
            .float(weight)
            .integer(mirrored_in.map_or(0, u64::from))
            .bytes(drawn.as_bytes());
        if weight == 0.0 {
            return Ok(());
        }
        let source = RasterSource::Image(image);
        let target = self.target_of(mirrored_in);
        let is_mirrored = mirrored_in.is_some();
        source.make_copies(target, posed, output, cancelled)?;
        let drawer = source.drawer(target, posed, output);
        let (width, depth) = (self.target.extent.width() as usize, source.depth());
        let pixel_bytes = drawer.pixel_bytes();
        let line_bytes = width * pixel_bytes;
        self.curve.take_if(|(of, _)| *of != depth);
        let curve = self
            .curve
            .get_or_insert_with(|| (depth, decoding_curve(self.space, depth)));
        let (read, curve) = (line_reader(depth, pixel_bytes), &*curve.1);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "sums are in single precision"
        )]
        let (weight, rule) = (weight as f32, self.rule);
        let bands = self
            .pixels
            .par_chunks_mut(ROWS_PER_CHECK * width)
            .enumerate();
        bands.for_each(|(band, pixels)| {
            if cancelled() {
                return;
            }
            let rows = rows_of(band, pixels.len() / width);
            let mut samples = vec![0; pixels.len() * pixel_bytes];
            drawer.band(rows, &mut samples, cancelled);
            let mut line = vec![[0.0; 4]; width];
            for (sums, bytes) in pixels
                .chunks_exact_mut(width)
                .zip(samples.chunks_exact(line_bytes))
            {
                read(bytes, curve, &mut line);
                if is_mirrored {
                    line.reverse();
                }
                rule.add(sums, &line, weight);
            }
        });
        if cancelled() {
            return Err(WarpError::Cancelled);
        }
        self.is_grey &= image.grey && output.outside.is_grey();
        self.has_alpha |= image.has_alpha();
        if depth == Depth::Sixteen {
            self.depth = depth;
        }
        Ok(())
    }

    /// The part of the reference frame that is drawn, or of its mirror image.
    fn target_of(&self, mirrored_in: Option<u32>) -> Target {
        let canvas = self.target.canvas.map(|canvas| match mirrored_in {
            Some(width) => {
                let right = i64::from(canvas.x) + i64::from(canvas.extent.width());
                let x = i32::try_from(i64::from(width) - right).unwrap_or(i32::MAX);
                Canvas { x, ..canvas }
            }
            None => canvas,
        });
        Target {
            canvas,
            ..self.target
        }
    }

    /// The sum as an image, with the metadata of the first one. `None` if nothing was added.
    ///
    /// # Errors
    /// Cancelled.
    pub fn finish(self, cancelled: IsCancelled<'_>) -> Result<Option<BlendedImage>, WarpError> {
        let Some(inherited) = self.inherited.clone() else {
            return Ok(None);
        };
        let clamped = AtomicU64::new(0);
        let is_opaque = || {
            self.pixels
                .par_iter()
                .all(|sum| sum[3] >= 1.0 - ALPHA_ROUNDING)
        };
        let channels = if self.has_alpha || !is_opaque() {
            Channels::Rgba
        } else {
            Channels::Rgb
        };
        let count = channels.count();
        let rows = ROWS_PER_CHECK * self.target.extent.width() as usize;
        let mut samples = vec![0_u16; self.pixels.len() * count];
        samples
            .par_chunks_mut(rows * count)
            .zip(self.pixels.par_chunks(rows))
            .for_each(|(out, sums)| {
                if cancelled() {
                    return;
                }
                let pixels = sums.iter().zip(out.chunks_exact_mut(count));
                let lost: u64 = pixels.map(|(sum, out)| self.put(*sum, out)).sum();
                clamped.fetch_add(lost, Ordering::Relaxed);
            });
        if cancelled() {
            return Err(WarpError::Cancelled);
        }
        let samples = match self.depth {
            Depth::Eight => {
                Samples::Eight(samples.into_iter().map(|v| v.to_le_bytes()[0]).collect())
            }
            Depth::Sixteen => Samples::Sixteen(samples),
        };
        let pixmap = Pixmap::new(self.target.extent, channels, samples);
        let image = Image::of_parts(self.digest.finish(), pixmap, inherited, self.is_grey);
        Ok(Some(BlendedImage {
            image,
            clamped: clamped.into_inner(),
        }))
    }

    /// Writes a pixel; returns how many of its colours were cut off.
    fn put(&self, sum: [f32; 4], out: &mut [u16]) -> u64 {
        let [r, g, b, alpha] = sum.map(f64::from);
        let share = match self.rule {
            Rule::Coverage if alpha > 0.0 => 1.0 / alpha,
            Rule::Coverage => 0.0,
            Rule::Difference => 1.0,
        };
        let largest = f64::from(self.depth.largest());
        let mut lost = 0;
        for (value, out) in [r, g, b].into_iter().zip(out.iter_mut()) {
            let value = encoded(self.space, value * share) * largest;
            let rounded = value.round().clamp(0.0, largest);
            // A pixel that is not visible loses nothing.
            lost += u64::from(alpha > 0.0 && (value.round() - rounded).abs() > 0.5);
            *out = to_sample(rounded);
        }
        if let Some(out) = out.get_mut(3) {
            *out = to_sample((alpha * largest).round().clamp(0.0, largest));
        }
        lost
    }
}

/// Weights add up to 1 but for rounding.
const ALPHA_ROUNDING: f32 = 1e-5;

impl Rule {
    /// Adds colours with alpha to their sums.
    fn add(self, sums: &mut [[f32; 4]], line: &[[f32; 4]], weight: f32) {
        let pixels = sums.iter_mut().zip(line);
        match self {
            Self::Coverage => {
                for (sum, [r, g, b, alpha]) in pixels {
                    let share = weight * alpha;
                    for (sum, value) in sum.iter_mut().zip([*r, *g, *b, 1.0]) {
                        *sum += share * value;
                    }
                }
            }
            Self::Difference => {
                for (sum, [r, g, b, alpha]) in pixels {
                    let least = sum[3].min(*alpha);
                    for (sum, value) in sum.iter_mut().zip([r, g, b]) {
                        *sum += weight * value;
                    }
                    sum[3] = least;
                }
            }
        }
    }
}

fn rows_of(band: usize, rows: usize) -> Range<u32> {
    let row = |row: usize| u32::try_from(row).expect("rows of an image");
    row(band * ROWS_PER_CHECK)..row(band * ROWS_PER_CHECK + rows)
}

/// One loop for each kind of pixel, which asks nothing of it.
fn line_reader(depth: Depth, pixel_bytes: usize) -> fn(&[u8], &[f32], &mut [[f32; 4]]) {
    match (depth, pixel_bytes) {
        (Depth::Eight, 3) => read_line::<1, 3>,
        (Depth::Eight, _) => read_line::<1, 4>,
        (Depth::Sixteen, 6) => read_line::<2, 6>,
        (Depth::Sixteen, _) => read_line::<2, 8>,
    }
}

/// Reads drawn pixels: their colours, 0 to 1 in the space of the curve, and their alpha, 0 to 1.
/// Samples of 16 bits are big-endian.
fn read_line<const SAMPLE: usize, const PIXEL: usize>(
    bytes: &[u8],
    curve: &[f32],
    line: &mut [[f32; 4]],
) {
    let largest: u16 = if SAMPLE == 1 { 255 } else { u16::MAX };
    let sample = |pixel: &[u8; PIXEL], index: usize| match SAMPLE {
        1 => u16::from(pixel[index]),
        _ => u16::from_be_bytes([pixel[2 * index], pixel[2 * index + 1]]),
    };
    let curve = &curve[..=largest.into()];
    for (pixel, value) in bytes.as_chunks::<PIXEL>().0.iter().zip(line) {
        let [r, g, b] = [0, 1, 2].map(|index| curve[usize::from(sample(pixel, index))]);
        let alpha = if PIXEL == 4 * SAMPLE {
            f32::from(sample(pixel, 3)) / f32::from(largest)
        } else {
            1.0
        };
        *value = [r, g, b, alpha];
    }
}

/// The value of each sample.
fn decoding_curve(space: BlendSpace, depth: Depth) -> Vec<f32> {
    let largest = f64::from(depth.largest());
    let value = |sample: u16| match (space, f64::from(sample) / largest) {
        (BlendSpace::Srgb, share) => share,
        (BlendSpace::Linear, share) if share <= 0.04045 => share / 12.92,
        (BlendSpace::Linear, share) => pow((share + 0.055) / 1.055, 2.4),
    };
    #[expect(
        clippy::cast_possible_truncation,
        reason = "sums are in single precision"
    )]
    let single = |sample| value(sample) as f32;
    (0..=depth.largest()).map(single).collect()
}

/// A value of the space as the share of the largest sample.
fn encoded(space: BlendSpace, value: f64) -> f64 {
    match space {
        BlendSpace::Srgb => value,
        BlendSpace::Linear if value <= 0.003_130_8 => value * 12.92,
        BlendSpace::Linear => 1.055 * pow(value, 1.0 / 2.4) - 0.055,
    }
}

fn to_sample(rounded: f64) -> u16 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a whole number within the depth"
    )]
    let sample = rounded as u16;
    sample
}
