//! Coordinate maps: an array of f32 with a position for every pixel of a canvas, for other
//! programs. A file is computed in bands of rows that do not depend on one another, so that only
//! one needs to be in memory.

use std::ops::Range;

use super::digest::Collector;
use super::pixel_positions::PixelPositions;
use super::{Digest, MapDirection, MapFormat, MapSpec, PosedMesh, Quantity, Target, WarpError};
use crate::codec::FloatTiff;
use crate::deform::IsCancelled;
use crate::geometry::PIXEL_CENTER;
use crate::pixmap::Extent;
use crate::render::Canvas;

/// Bytes of a position: two f32.
const POSITION_BYTES: u64 = 8;
/// Samples of a pixel: x and y.
const SAMPLES_PER_PIXEL: u16 = 2;

/// A map that is ready to be written.
#[derive(Debug)]
pub struct CoordinateMap {
    positions: PixelPositions,
    target: Target,
    format: MapFormat,
    tiff: Option<FloatTiff>,
    band_rows: u32,
    etag: Digest,
}

impl CoordinateMap {
    /// Prepares the map of a posed grid on a target of `spec`.
    ///
    /// # Errors
    /// Too large for the format.
    pub fn new(spec: &MapSpec, posed: &PosedMesh, target: Target) -> Result<Self, WarpError> {
        let positions = PixelPositions::new(spec.direction, posed.mesh(), target);
        let band_rows = positions.band_rows();
        let tiff = match spec.format {
            MapFormat::Npy => None,
            MapFormat::Tiff => {
                let limit = u64::from(u32::MAX) / (POSITION_BYTES + 1);
                let too_large = WarpError::TooLarge {
                    what: Quantity::MapPixels,
                    limit,
                    actual: target.extent.pixels(),
                };
                Some(FloatTiff::new(target.extent, SAMPLES_PER_PIXEL, band_rows).ok_or(too_large)?)
            }
        };
        Ok(Self {
            positions,
            target,
            format: spec.format,
            tiff,
            band_rows,
            etag: etag(spec, posed, target),
        })
    }

    /// The part of the plane that it covers, and its size.
    #[must_use]
    pub const fn target(&self) -> Target {
        self.target
    }

    /// File format.
    #[must_use]
    pub const fn format(&self) -> MapFormat {
        self.format
    }

    /// Digest of the resolved request and the version: the ETag.
    #[must_use]
    pub const fn etag(&self) -> Digest {
        self.etag
    }

    /// Bytes of the file.
    #[must_use]
    pub fn file_bytes(&self) -> u64 {
        let tail = self.tiff.as_ref().map_or(0, |tiff| tiff.tail().len());
        self.target.extent.pixels() * POSITION_BYTES + (self.head().len() + tail) as u64
    }

    /// Memory for the computation of one band, the band included, bytes.
    #[must_use]
    pub const fn band_bytes(&self) -> u64 {
        2 * self.band_rows as u64 * self.target.extent.width() as u64 * POSITION_BYTES
    }

    /// Number of bands.
    #[must_use]
    pub const fn bands(&self) -> u32 {
        self.target.extent.height().div_ceil(self.band_rows)
    }

    /// The rows of a band.
    fn rows(&self, band: u32) -> Range<u32> {
        band * self.band_rows..((band + 1) * self.band_rows).min(self.target.extent.height())
    }

    /// The bytes of a band; those of the first begin with the head of the file, those of the last
    /// end with its tail.
    ///
    /// # Errors
    /// Cancelled.
    ///
    /// # Panics
    /// If there is no such band.
    pub fn band(&self, band: u32, cancelled: IsCancelled<'_>) -> Result<Vec<u8>, WarpError> {
        let rows = self.rows(band);
        assert!(!rows.is_empty(), "band {band} of {}", self.bands());
        let mut positions = vec![[0.0; 2]; rows.len() * self.target.extent.width() as usize];
        self.positions.rows(rows, &mut positions, cancelled);
        if cancelled() {
            return Err(WarpError::Cancelled);
        }
        let mut bytes = if band == 0 { self.head() } else { Vec::new() };
        bytes.reserve_exact(8 * positions.len());
        // Indices of an array: the centre of the first pixel is 0, 0.
        #[expect(clippy::cast_possible_truncation, reason = "1/2")]
        let indices = positions
            .as_flattened()
            .iter()
            .map(|c| c - PIXEL_CENTER as f32);
        match self.format {
            MapFormat::Npy => bytes.extend(indices.flat_map(f32::to_le_bytes)),
            MapFormat::Tiff => bytes.extend(indices.flat_map(f32::to_be_bytes)),
        }
        if band + 1 == self.bands()
            && let Some(tiff) = &self.tiff
        {
            bytes.extend(tiff.tail());
        }
        Ok(bytes)
    }

    fn head(&self) -> Vec<u8> {
        match &self.tiff {
            Some(tiff) => tiff.head(),
            None => npy_head(self.target.extent),
        }
    }
}

fn etag(spec: &MapSpec, posed: &PosedMesh, Target { canvas, extent, .. }: Target) -> Digest {
    let kind = [
        spec.direction == MapDirection::Forward,
        spec.format == MapFormat::Tiff,
        canvas.is_some(),
    ]
    .map(u8::from);
    let Canvas {
        x,
        y,
        extent: shown,
    } = canvas.unwrap_or(Canvas::of(extent));
    let digest = Collector::new("mlswarp map 1")
        .bytes(&posed.digest().0)
        .bytes(&kind)
        .bytes(&x.to_le_bytes())
        .bytes(&y.to_le_bytes());
    let sides = [
        extent.width(),
        extent.height(),
        shown.width(),
        shown.height(),
    ];
    sides
        .into_iter()
        .fold(digest, |digest, side| digest.integer(side.into()))
        .finish()
}

/// The head of an array of f32 in NumPy's format, version 1: its length is a multiple of 64.
fn npy_head(extent: Extent) -> Vec<u8> {
    const PREFIX_BYTES: usize = 10;
    let shape = format!(
        "({}, {}, {SAMPLES_PER_PIXEL})",
        extent.height(),
        extent.width()
    );
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let padded = (PREFIX_BYTES + header.len() + 1).next_multiple_of(64) - PREFIX_BYTES;
    header.extend(std::iter::repeat_n(' ', padded - header.len() - 1));
    header.push('\n');
    let length = u16::try_from(header.len()).expect("a short text");
    [
        b"\x93NUMPY\x01\0",
        length.to_le_bytes().as_slice(),
        header.as_bytes(),
    ]
    .concat()
}
