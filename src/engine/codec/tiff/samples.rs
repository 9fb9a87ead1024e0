//! The samples of a TIFF: decodes its strips and tiles, and converts them to RGB or RGBA. Shapes:
//! `[height][width][channels]`.

use std::io::Read as _;

use super::data::TiffCompression;
use super::read::{Alpha, Photometric, TiffFile};
use crate::codec::alloc::{room, sample_count, zeros};
use crate::codec::ifd::read::{bad, cut_off};
use crate::codec::jpeg::read::JpegFile;
use crate::codec::{CodecError, Repairs, StepCounter};
use crate::pixmap::{Depth, Samples};

/// The largest label.
const MOST_LABEL: u64 = u16::MAX as u64;

fn damaged<E>(_: E) -> CodecError {
    bad("its pixels are damaged or end too early")
}

/// An error of a strip or tile, as one of the file.
fn of_tiff(error: CodecError) -> CodecError {
    match error {
        CodecError::Bad { ref detail, .. } => bad(format!("in its JPEG data: {detail}")),
        CodecError::Unsupported { .. } | CodecError::TooLarge { .. } | CodecError::Cancelled => {
            error
        }
    }
}

impl<'a> TiffFile<'a> {
    /// Strips or tiles in a row and in a column.
    pub(super) const fn grid(&self) -> (u32, u32) {
        (
            self.extent.width().div_ceil(self.parts.width),
            self.extent.height().div_ceil(self.parts.height),
        )
    }

    /// Strips or tiles of a plane.
    pub(super) fn parts_of_plane(&self) -> u64 {
        let (across, down) = self.grid();
        u64::from(across) * u64::from(down)
    }

    /// The data of a strip or tile.
    pub(super) fn data(&self, index: usize) -> Result<&'a [u8], CodecError> {
        let range = self
            .parts
            .offsets
            .get(index)
            .zip(self.parts.lengths.get(index))
            .ok_or_else(|| bad("too few strips or tiles"))?;
        let (at, length) = (usize::try_from(range.0).ok(), usize::try_from(range.1).ok());
        let range = at
            .zip(length)
            .and_then(|(at, length)| Some(at..at.checked_add(length)?));
        range
            .and_then(|range| self.file.bytes.get(range))
            .ok_or_else(cut_off)
    }

    /// Checks that the parts are there, that they can hold the image, and that they are not the
    /// same bytes again and again, so that the work is in proportion to the file and the image.
    pub(super) fn weigh_data(&self, work: &StepCounter<'_>) -> Result<(), CodecError> {
        let parts = self.parts_of_plane() * self.planes() as u64;
        if parts > self.parts.offsets.len() as u64 {
            return Err(bad("too few strips or tiles"));
        }
        let mut total = 0;
        for index in 0..usize::try_from(parts).unwrap_or(usize::MAX) {
            work.step(1)?;
            total += self.data(index)?.len() as u64;
        }
        if total > self.file.bytes.len() as u64 {
            return Err(bad("strips or tiles that overlap"));
        }
        let row = (u64::from(self.extent.width()) * self.stored as u64 * u64::from(self.bits))
            .div_ceil(8);
        if total.saturating_mul(self.compression.expansion())
            < row * u64::from(self.extent.height())
        {
            return Err(bad(format!(
                "{total} bytes of data cannot hold the picture"
            )));
        }
        Ok(())
    }

    /// The stored rows.
    pub(in crate::codec) fn samples(
        &self,
        work: &StepCounter<'_>,
    ) -> Result<(Samples, Repairs), CodecError> {
        self.weigh_data(work)?;
        let samples = match self.depth() {
            Depth::Eight if self.compression == TiffCompression::Jpeg => return self.jpeg(work),
            Depth::Eight => Samples::Eight(self.rows(work)?),
            Depth::Sixteen => Samples::Sixteen(self.rows(work)?),
        };
        Ok((samples, Repairs::default()))
    }

    fn rows<T: TiffSample>(&self, work: &StepCounter<'_>) -> Result<Vec<T>, CodecError> {
        let (width, height, count) = (
            self.extent.width() as usize,
            self.extent.height() as usize,
            self.channels().count(),
        );
        let (part_width, part_height) = (self.parts.width as usize, self.parts.height as usize);
        let (across, down) = self.grid();
        let interleaved = self.interleaved();
        let mut out = zeros::<T>(sample_count(self.extent.pixels(), self.channels()), work)?;
        let mut row = zeros::<u8>(self.row_bytes(), work)?;
        let mut samples = room::<T>(self.parts.width as u64 * interleaved as u64)?;
        let mut index = 0;
        for plane in 0..self.planes() {
            for tile in 0..across as usize * down as usize {
                let (tile_x, tile_y) = (tile % across as usize, tile / across as usize);
                let form = (self.parts.width, self.is_reversed);
                let mut data = self
                    .compression
                    .reader(self.data(index)?, form, work)
                    .map_err(damaged)?;
                index += 1;
                let left = tile_x * part_width;
                let columns = part_width.min(width - left);
                let top = tile_y * part_height;
                for y in top..(top + part_height).min(height) {
                    work.check()?;
                    data.read_exact(&mut row).map_err(damaged)?;
                    samples.clear();
                    if self.is_counted() {
                        self.count(&row, &mut samples)?;
                    } else {
                        T::unpack(&row, self, &mut samples);
                    }
                    if self.differences && !self.is_counted() {
                        for index in interleaved..samples.len() {
                            samples[index] = samples[index].plus(samples[index - interleaved]);
                        }
                    }
                    let into = &mut out[(y * width + left) * count..][..columns * count];
                    for (into, from) in into
                        .chunks_exact_mut(count)
                        .zip(samples.chunks_exact(interleaved))
                    {
                        if self.is_planar {
                            self.sample(plane, from[0], into)
                        } else {
                            self.pixel(from, into)
                        }
                    }
                }
                // The end of the data, with the checksum of deflate.
                if self.compression == TiffCompression::Deflate {
                    let _ = data.read(&mut [0]).map_err(damaged)?;
                }
            }
        }
        if self.is_planar {
            for row in out.chunks_exact_mut(width * count) {
                work.check()?;
                row.chunks_exact_mut(count)
                    .for_each(|pixel| self.divide(pixel));
            }
        }
        Ok(out)
    }

    /// The stored rows of JPEG, in strips or tiles that are files without their common tables.
    fn jpeg(&self, work: &StepCounter<'_>) -> Result<(Samples, Repairs), CodecError> {
        let (width, height) = (self.extent.width() as usize, self.extent.height() as usize);
        let (across, down) = self.grid();
        let mut out = zeros::<u8>(3 * self.extent.pixels(), work)?;
        let mut repairs = Repairs::default();
        let is_white_zero = self.colour
            == Photometric::Grey {
                white_is_zero: true,
            }
            && !self.labels;
        for tile in 0..across as usize * down as usize {
            let (left, top) = (
                tile % across as usize * self.parts.width as usize,
                tile / across as usize * self.parts.height as usize,
            );
            let (columns, rows) = (
                (self.parts.width as usize).min(width - left),
                (self.parts.height as usize).min(height - top),
            );
            let data = self.data(tile)?;
            // Tables end with a mark of their own, and the data begin with one.
            let tables = self
                .tables
                .strip_suffix(&[0xFF, 0xD9])
                .unwrap_or(self.tables);
            let data = if tables.is_empty() {
                data
            } else {
                data.strip_prefix(&[0xFF, 0xD8]).unwrap_or(data)
            };
            work.step((tables.len() + data.len()) as u64)?;
            let whole = [tables, data].concat();
            let mut file = JpegFile::parse(&whole, work).map_err(of_tiff)?;
            file.is_rgb = self.colour == Photometric::Rgb;
            let (part_width, part_height) =
                (file.extent.width() as usize, file.extent.height() as usize);
            let is_whole = part_width >= columns
                && part_height >= rows
                && part_width <= self.parts.width as usize;
            if !is_whole
                || part_height > self.parts.height as usize
                || file.is_grey() != (self.stored == 1)
                || file.is_progressive()
            {
                return Err(bad("JPEG data of another size or kind than the file says"));
            }
            let (samples, mended) = file.samples(work).map_err(of_tiff)?;
            let Samples::Eight(samples) = samples else {
                return Err(cut_off());
            };
            repairs = Repairs {
                end: repairs.end || mended.end,
                gap: repairs.gap || mended.gap,
                ..repairs
            };
            for (y, row) in samples.chunks_exact(3 * part_width).take(rows).enumerate() {
                let into = &mut out[3 * ((top + y) * width + left)..][..3 * columns];
                into.copy_from_slice(&row[..3 * columns]);
                if is_white_zero {
                    into.iter_mut().for_each(|sample| *sample = !*sample);
                }
            }
        }
        Ok((Samples::Eight(out), repairs))
    }

    /// Converts a pixel to RGB or RGBA.
    fn pixel<T: TiffSample>(&self, from: &[T], into: &mut [T]) {
        match self.colour {
            Photometric::Rgb | Photometric::YCbCr => into[..3].copy_from_slice(&from[..3]),
            Photometric::Grey { .. } | Photometric::Palette if self.labels => {
                into[..3].fill(from[0])
            }
            Photometric::Grey { white_is_zero } => into[..3].fill(if white_is_zero {
                from[0].inverted()
            } else {
                from[0]
            }),
            Photometric::Palette => {
                let colours = 1 << self.bits;
                for (c, sample) in into[..3].iter_mut().enumerate() {
                    let value = self
                        .palette
                        .and_then(|palette| palette.get(c * colours + from[0].index()))
                        .unwrap_or(0);
                    *sample = T::from_short(value);
                }
            }
        }
        if let (Some(alpha), Some(_)) = (into.get_mut(3), self.alpha) {
            *alpha = from[from.len() - 1];
            self.divide(into);
        }
    }

    /// Converts a sample of a plane.
    fn sample<T: TiffSample>(&self, plane: usize, from: T, into: &mut [T]) {
        match self.colour {
            Photometric::Grey { white_is_zero } if plane == 0 => {
                into[..3].fill(if white_is_zero && !self.labels {
                    from.inverted()
                } else {
                    from
                });
            }
            Photometric::Grey { .. } => into[3] = from,
            Photometric::Rgb | Photometric::Palette | Photometric::YCbCr => into[plane] = from,
        }
    }

    /// Divides premultiplied alpha out.
    fn divide<T: TiffSample>(&self, pixel: &mut [T]) {
        if let (
            [colours @ .., alpha],
            Some(Alpha {
                is_premultiplied: true,
            }),
        ) = (pixel, self.alpha)
            && !self.labels
        {
            colours
                .iter_mut()
                .for_each(|sample| *sample = sample.divided(*alpha));
        }
    }

    /// Appends the labels of a row that may be negative, or larger than 16 bits hold, if none of
    /// them is.
    fn count<T: TiffSample>(&self, row: &[u8], out: &mut Vec<T>) -> Result<(), CodecError> {
        let most = u64::MAX >> (64 - self.bits);
        let mut label = 0;
        for number in row.chunks_exact(self.bits as usize / 8) {
            let number = self.file.number(number);
            label = if self.differences {
                number.wrapping_add(label) & most
            } else {
                number
            };
            if self.is_signed && label > most >> 1 {
                return Err(CodecError::unsupported(
                    "a TIFF with negative labels; labels are numbers from 0 to 65535",
                ));
            }
            if label > MOST_LABEL {
                return Err(CodecError::unsupported(format!(
                    "a TIFF with the label {label}; labels are numbers from 0 to 65535. Renumber \
                        them, for example with \
                     skimage.segmentation.relabel_sequential"
                )));
            }
            out.push(T::from_label(label));
        }
        Ok(())
    }
}

/// A sample of 8 or 16 bit.
trait TiffSample: Copy + Default {
    /// Appends the samples of a row.
    fn unpack(row: &[u8], file: &TiffFile<'_>, out: &mut Vec<Self>);
    fn plus(self, other: Self) -> Self;
    fn inverted(self) -> Self;
    fn index(self) -> usize;
    fn from_short(value: u64) -> Self;
    fn from_label(label: u64) -> Self;
    /// Without its factor `alpha`.
    fn divided(self, alpha: Self) -> Self;
}

impl TiffSample for u8 {
    fn unpack(row: &[u8], file: &TiffFile<'_>, out: &mut Vec<Self>) {
        if file.bits == 8 {
            return out.extend_from_slice(row);
        }
        let most = (1_u16 << file.bits) - 1;
        let scale = if file.colour == Photometric::Palette || file.labels {
            1
        } else {
            255 / most
        };
        let per_byte = 8 / file.bits;
        for index in 0..file.parts.width {
            let shift = 8 - file.bits * (index % per_byte + 1);
            #[expect(clippy::cast_possible_truncation, reason = "at most 255")]
            out.push(
                ((u16::from(row[(index / per_byte) as usize]) >> shift & most) * scale) as Self,
            );
        }
    }

    fn plus(self, other: Self) -> Self {
        self.wrapping_add(other)
    }

    fn inverted(self) -> Self {
        !self
    }

    fn index(self) -> usize {
        self.into()
    }

    #[expect(clippy::cast_possible_truncation, reason = "the upper byte of 16 bits")]
    fn from_short(value: u64) -> Self {
        (value >> 8) as Self
    }

    #[expect(clippy::cast_possible_truncation, reason = "a sample of 8 bits")]
    fn from_label(label: u64) -> Self {
        label as Self
    }

    fn divided(self, alpha: Self) -> Self {
        let (sample, alpha) = (u32::from(self), u32::from(alpha));
        (sample * 255 + alpha / 2)
            .checked_div(alpha)
            .map_or(0, |straight| straight.min(255) as Self)
    }
}

impl TiffSample for u16 {
    fn unpack(row: &[u8], file: &TiffFile<'_>, out: &mut Vec<Self>) {
        out.extend(
            row.as_chunks()
                .0
                .iter()
                .map(|bytes| file.file.short(*bytes)),
        );
    }

    fn plus(self, other: Self) -> Self {
        self.wrapping_add(other)
    }

    fn inverted(self) -> Self {
        !self
    }

    fn index(self) -> usize {
        self.into()
    }

    #[expect(clippy::cast_possible_truncation, reason = "16 bits")]
    fn from_short(value: u64) -> Self {
        value as Self
    }

    #[expect(clippy::cast_possible_truncation, reason = "16 bits")]
    fn from_label(label: u64) -> Self {
        label as Self
    }

    fn divided(self, alpha: Self) -> Self {
        let (sample, alpha) = (u64::from(self), u64::from(alpha));
        (sample * 65_535 + alpha / 2)
            .checked_div(alpha)
            .map_or(0, |straight| straight.min(65_535) as Self)
    }
}
