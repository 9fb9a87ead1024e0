//! The JPEG writer: baseline, with the Huffman tables of the standard, encoded as a head,
//! independent strips and a tail (ITU-T T.81, JFIF).
//!
//! A strip is a restart interval of whole rows of macroblocks, so strips can be encoded in any
//! order and on any thread, and are sent in order. The bytes depend on the samples, the shape and
//! the encoding alone. Shapes: samples `[rows][width][1 to 4]`, 8 bit.

#[forbid(unsafe_code)]
mod coder;
mod kernel;
#[forbid(unsafe_code)]
mod lanes;
#[forbid(unsafe_code)]
mod markers;
#[forbid(unsafe_code)]
mod strip;
#[forbid(unsafe_code)]
mod tables;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::sync::{Arc, LazyLock};

use self::coder::{BLOCK_BYTES, CoefficientCodes};
use self::lanes::Quantiser;
use self::strip::{Components, Job};
use self::tables::BLOCK;
use crate::codec::{Carried, PixelLayout, Subsampling};
use crate::level::SimdLevel;

/// Samples of a strip, bytes. Below, the end of each strip costs too much; above, two threads share
/// an image of 500 x 500 unevenly.
const STRIP_BYTES: u64 = 512 << 10;
/// Images with fewer bytes are one strip.
const ONE_STRIP_BYTES: u64 = 96 << 10;

/// Writes one JPEG in independent strips. Cheap to create and to clone.
#[derive(Debug, Clone)]
pub struct JpegWriter {
    shape: PixelLayout,
    components: Components,
    /// The background of transparent pixels.
    background: [u8; 3],
    level: SimdLevel,
    /// Rows of a strip but the last, a multiple of the side of a macroblock.
    strip_rows: u32,
    quantisers: Arc<[Quantiser; 2]>,
    head: Arc<[u8]>,
}

impl JpegWriter {
    /// A writer for one image of 8 bit and of a valid size for JPEG. `quality`: 1 to 100. A grey
    /// image becomes a file of one component.
    ///
    /// # Panics
    /// If a side is longer than 65,535 px, or if the profile does not fit into 255 segments.
    #[must_use]
    pub fn new(
        shape: PixelLayout,
        quality: u8,
        subsampling: Subsampling,
        background: [u8; 3],
        metadata: Option<&Carried>,
    ) -> Self {
        let components = match subsampling {
            _ if shape.grey => Components::Grey,
            Subsampling::Full => Components::Full,
            Subsampling::Half => Components::Half,
        };
        let side = u32::try_from(components.side()).expect("16 or less");
        let (width, height) = (shape.extent.width(), shape.extent.height());
        let bytes = u64::from(width) * u64::from(height) * shape.samples() as u64;
        // An even number, so that two threads have equal work.
        let strips = if bytes <= ONE_STRIP_BYTES {
            1
        } else {
            2 * bytes.div_ceil(2 * STRIP_BYTES)
        };
        let strip_rows = height
            .div_ceil(u32::try_from(strips).map_or(height, |strips| strips.min(height)))
            .next_multiple_of(side);
        let interval = width.div_ceil(side) * (strip_rows / side);
        let interval =
            (strip_rows < height).then(|| u16::try_from(interval).expect("a strip is short"));
        let steps = tables::quantisation(quality);
        let quantisers = Arc::new(steps.each_ref().map(Quantiser::new));
        let head = markers::head(shape.extent, components, &steps, interval, metadata).into();
        Self {
            shape,
            components,
            background,
            level: SimdLevel::detect(),
            strip_rows,
            quantisers,
            head,
        }
    }

    /// Encodes with another level.
    #[must_use]
    pub fn with_level(self, level: SimdLevel) -> Self {
        Self { level, ..self }
    }

    /// Number of strips.
    #[must_use]
    pub fn strips(&self) -> usize {
        self.shape.extent.height().div_ceil(self.strip_rows) as usize
    }

    /// Rows of a strip.
    ///
    /// # Panics
    /// If there is no such strip.
    #[must_use]
    pub fn rows(&self, strip: usize) -> Range<u32> {
        let height = self.shape.extent.height();
        let start = u32::try_from(strip)
            .ok()
            .and_then(|strip| strip.checked_mul(self.strip_rows))
            .filter(|start| *start < height);
        let start = start.expect("a strip of the picture");
        start..height.min(start.saturating_add(self.strip_rows))
    }

    /// Upper bound of the whole file, bytes, whatever the samples. Each byte of a block may need a
    /// zero after it.
    #[must_use]
    pub fn max_bytes(&self) -> u64 {
        let blocks = self.components.blocks() as u64;
        let strips = self.strips() as u64 * 4;
        self.macroblocks() * blocks * 2 * BLOCK_BYTES as u64
            + strips
            + self.head.len() as u64
            + markers::END.len() as u64
    }

    /// Upper bound of the memory for writing, bytes: the file and a copy in 8 bit. The squares of a
    /// block's coefficients sum to 64 x 128^2 at most, so a coefficient takes no more than 18 bits
    /// on average (128 after no zeros); zeros after bytes 255 add less than 6.
    #[must_use]
    pub fn work_bytes(&self) -> u64 {
        const COEFFICIENT: u64 = 3;
        let blocks = self.macroblocks() * self.components.blocks() as u64;
        let samples = self.shape.extent.pixels() * self.shape.samples() as u64;
        blocks * BLOCK as u64 * COEFFICIENT
            + samples
            + self.strips() as u64 * 4
            + self.head.len() as u64
    }

    fn macroblocks(&self) -> u64 {
        let side = self.components.side();
        let [across, down] = [self.shape.extent.width(), self.shape.extent.height()]
            .map(|length| (length as usize).div_ceil(side) as u64);
        across * down
    }

    /// The bytes before the first strip.
    #[must_use]
    pub fn head(&self) -> &[u8] {
        &self.head
    }

    /// Encodes a strip and appends it. `wanted` is called between rows of macroblocks; when it
    /// returns false, the strip is incomplete.
    ///
    /// # Panics
    /// If the samples are not the strip's rows.
    pub fn strip_into(
        &self,
        index: usize,
        samples: &[u8],
        out: &mut Vec<u8>,
        wanted: &dyn Fn() -> bool,
    ) {
        /// The same for every image.
        static CODES: LazyLock<[CoefficientCodes; 2]> = LazyLock::new(CoefficientCodes::of_both);
        let (width, channels) = (self.shape.extent.width() as usize, self.shape.samples());
        assert_eq!(
            samples.len(),
            self.rows(index).len() * width * channels,
            "the samples of the strip"
        );
        let Self {
            components,
            background,
            ..
        } = *self;
        out.extend(markers::restart(index).into_iter().flatten());
        let job = Job {
            samples,
            width,
            channels,
            components,
            background,
            quantisers: &self.quantisers,
            codes: &CODES,
        };
        kernel::encode(self.level, &job, out, wanted);
    }

    /// The bytes after the last strip.
    #[must_use]
    pub const fn tail() -> &'static [u8] {
        &markers::END
    }
}
