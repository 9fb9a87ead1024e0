//! Reads TIFF (6.0): one page of grey, palette or RGB, with or without alpha, in strips or tiles, not compressed or with LZW, deflate or
//! PackBits. The directory is read in place; rows are decoded one at a time. Grey becomes RGB, palettes and 1, 2, 4 bit are expanded, 16
//! bit stays 16 bit, and premultiplied alpha is divided out. Memory: the picture and a few rows; work: in proportion to the picture and
//! the file.

use std::io::Read;

use super::data::Compression;
use super::directory::{Directory, File, Values, bad, cut_off, unsupported};
use crate::codec::alloc::{room, sample_count, zeros};
use crate::codec::orientation::Orientation;
use crate::codec::profile::{MAX_ICC, keep_rgb_profile};
use crate::codec::{CodecError, Palette, StepCounter};
use crate::pixmap::{Channels, Depth, Extent, Samples};

/// Samples of a pixel, those that are not read included.
const MOST_SAMPLES: u32 = 16;
/// Additional width of a tile beyond twice the picture's.
const FREE_TILE: u64 = 4096;

/// What the samples of a pixel mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Colour {
    Grey { white_is_zero: bool },
    Rgb,
    Palette,
}

/// The sample that is alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Alpha {
    index: usize,
    is_premultiplied: bool,
}

/// A TIFF whose directory has been read.
#[derive(Debug)]
pub(in crate::codec) struct TiffFile<'a> {
    file: File<'a>,
    pub(in crate::codec) extent: Extent,
    pub(in crate::codec) orientation: Orientation,
    bits: u32,
    /// Samples of a pixel.
    stored: usize,
    colour: Colour,
    alpha: Option<Alpha>,
    palette: Option<Values<'a>>,
    compression: Compression,
    differences: bool,
    /// Size of a strip or tile.
    part: (u32, u32),
    offsets: Values<'a>,
    lengths: Values<'a>,
    profile: Option<&'a [u8]>,
    /// Samples are read as they are stored.
    pub(in crate::codec) labels: bool,
}

impl<'a> TiffFile<'a> {
    pub(in crate::codec) fn parse(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        let file = File::new(bytes);
        let page = file.only_page(work)?;
        let number = |tag, default| page.number(tag, default, work);
        let (width, height) = (number(256, 0)?, number(257, 0)?);
        let extent = Extent::new(width, height).ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        let colour = match page.values(262, work)?.and_then(|values| values.get(0)).ok_or_else(|| bad("no photometric interpretation"))? {
            kind @ (0 | 1) => Colour::Grey { white_is_zero: kind == 0 },
            2 => Colour::Rgb,
            3 => Colour::Palette,
            5 => return Err(unsupported("of CMYK colours")),
            6 => return Err(unsupported("of YCbCr colours")),
            8..=10 => return Err(unsupported("of Lab colours")),
            kind => return Err(unsupported(format_args!("of photometric interpretation {kind}"))),
        };
        if !matches!(page.uniform(339, 1, "format", work)?, 1 | 4) {
            return Err(unsupported("of signed or floating-point samples"));
        }
        let (stored, bits) = (number(277, 1)?, page.uniform(258, 1, "depth", work)?);
        let colours = if colour == Colour::Rgb { 3 } else { 1 };
        if !(colours..=MOST_SAMPLES).contains(&stored) {
            return Err(unsupported(format_args!("whose number of samples per pixel is {stored}")));
        }
        if !matches!((bits, stored, colour), (8, ..) | (16, _, Colour::Grey { .. } | Colour::Rgb) | (1 | 2 | 4, 1, _)) {
            return Err(unsupported(format_args!("whose bits per sample are {bits} and samples per pixel {stored}")));
        }
        if stored > 1 && number(284, 1)? != 1 {
            return Err(unsupported("whose channels are in separate planes"));
        }
        if number(266, 1)? != 1 {
            return Err(unsupported("whose bits are in reverse order"));
        }
        let compression = number(259, 1)?;
        let compression =
            Compression::from_number(compression).ok_or_else(|| unsupported(format_args!("with {}", Compression::name_of(compression))))?;
        let differences = match number(317, 1)? {
            1 => false,
            2 if bits >= 8 => true,
            kind => return Err(unsupported(format_args!("with predictor {kind} of {bits} bits"))),
        };
        let extra = (colours as usize)..(stored as usize);
        let alpha = match page.values(338, work)? {
            Some(kinds) => extra.clone().zip(0..).find_map(|(index, nth)| match kinds.get(nth)? {
                1 => Some(Alpha { index, is_premultiplied: true }),
                2 => Some(Alpha { index, is_premultiplied: false }),
                _ => None,
            }),
            // Without the tag, other readers take the only additional sample for alpha, too.
            None => (extra.len() == 1).then_some(Alpha { index: extra.start, is_premultiplied: false }),
        };
        if colour == Colour::Palette && stored > 1 {
            return Err(unsupported("of a palette with alpha"));
        }
        let palette = page.values(320, work)?;
        if colour == Colour::Palette && palette.is_none_or(|palette| palette.len() < 3 << bits) {
            return Err(bad("too few colours in its palette"));
        }
        let (part, offsets, lengths) = Self::parts(&page, extent, work)?;
        let profile = page.values(34_675, work)?.map(|values| values.data);
        let orientation = page.orientation(work)?;
        let stored = stored as usize;
        let this = Self {
            file,
            extent,
            orientation,
            bits,
            stored,
            colour,
            alpha,
            palette,
            compression,
            differences,
            part,
            offsets,
            lengths,
            profile,
            labels: false,
        };
        Ok(this)
    }

    /// The size of a strip or tile, and where they are.
    fn parts(page: &Directory<'a>, extent: Extent, work: &StepCounter<'_>) -> Result<((u32, u32), Values<'a>, Values<'a>), CodecError> {
        let tiles = page.values(324, work)?;
        let (part, offsets, lengths) = match tiles {
            Some(offsets) => {
                let side = |tag| page.number(tag, 0, work);
                ((side(322)?, side(323)?), Some(offsets), page.values(325, work)?)
            }
            None => {
                let rows = page.number(278, u32::MAX, work)?.min(extent.height());
                ((extent.width(), rows), page.values(273, work)?, page.values(279, work)?)
            }
        };
        let (Some(offsets), Some(lengths)) = (offsets, lengths) else { return Err(bad("no strips or tiles")) };
        if part.0 == 0 || part.1 == 0 || u64::from(part.0) > 2 * u64::from(extent.width()) + FREE_TILE {
            return Err(bad(format!("strips or tiles of {} x {} pixels", part.0, part.1)));
        }
        Ok((part, offsets, lengths))
    }

    pub(in crate::codec) fn channels(&self) -> Channels {
        if self.alpha.is_none() { Channels::Rgb } else { Channels::Rgba }
    }

    pub(in crate::codec) const fn depth(&self) -> Depth {
        if self.bits == 16 { Depth::Sixteen } else { Depth::Eight }
    }

    pub(in crate::codec) const fn is_grey(&self) -> bool {
        matches!(self.colour, Colour::Grey { .. }) || self.labels && matches!(self.colour, Colour::Palette)
    }

    /// Bytes of a row of a strip or tile.
    fn row_bytes(&self) -> u64 {
        (u64::from(self.part.0) * self.stored as u64 * u64::from(self.bits)).div_ceil(8)
    }

    /// Memory beside the picture: the decoders' windows, and a row as stored and as samples of up to two bytes.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        (512 << 10) + self.row_bytes() + 2 * u64::from(self.part.0) * self.stored as u64
    }

    /// Strips or tiles in a row and in a column.
    const fn grid(&self) -> (u32, u32) {
        (self.extent.width().div_ceil(self.part.0), self.extent.height().div_ceil(self.part.1))
    }

    /// The data of a strip or tile.
    fn data(&self, index: usize) -> Result<&'a [u8], CodecError> {
        let range = self.offsets.get(index).zip(self.lengths.get(index)).ok_or_else(|| bad("too few strips or tiles"))?;
        let (at, length) = (range.0 as usize, range.1 as usize);
        at.checked_add(length).and_then(|end| self.file.bytes.get(at..end)).ok_or_else(cut_off)
    }

    /// Checks that the parts are there, that they can hold the picture, and that they are not the same bytes again and again, so that
    /// the work is in proportion to the file and the picture.
    fn weigh_data(&self, work: &StepCounter<'_>) -> Result<(), CodecError> {
        let (across, down) = self.grid();
        let parts = u64::from(across) * u64::from(down);
        if parts > self.offsets.len() as u64 {
            return Err(bad("too few strips or tiles"));
        }
        let mut total = 0;
        for index in 0..self.offsets.len().min(usize::try_from(parts).unwrap_or(usize::MAX)) {
            work.step(1)?;
            total += self.data(index)?.len() as u64;
        }
        if total > self.file.bytes.len() as u64 {
            return Err(bad("strips or tiles that overlap"));
        }
        let row = (u64::from(self.extent.width()) * self.stored as u64 * u64::from(self.bits)).div_ceil(8);
        if total.saturating_mul(self.compression.expansion()) < row * u64::from(self.extent.height()) {
            return Err(bad(format!("{total} bytes of data cannot hold the picture")));
        }
        Ok(())
    }

    /// The stored rows.
    pub(in crate::codec) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        self.weigh_data(work)?;
        match self.depth() {
            Depth::Eight => self.rows::<u8>(work).map(Samples::Eight),
            Depth::Sixteen => self.rows::<u16>(work).map(Samples::Sixteen),
        }
    }

    fn rows<T: Sample>(&self, work: &StepCounter<'_>) -> Result<Vec<T>, CodecError> {
        let (width, height, count) = (self.extent.width() as usize, self.extent.height() as usize, self.channels().count());
        let (part_width, part_height) = (self.part.0 as usize, self.part.1 as usize);
        let (across, down) = self.grid();
        let mut out = zeros::<T>(sample_count(self.extent.pixels(), self.channels()), work)?;
        let mut row = zeros::<u8>(self.row_bytes(), work)?;
        let mut samples = room::<T>(self.part.0 as u64 * self.stored as u64)?;
        for tile_y in 0..down as usize {
            for tile_x in 0..across as usize {
                let mut data = self.compression.reader(self.data(tile_y * across as usize + tile_x)?, work);
                let left = tile_x * part_width;
                let columns = part_width.min(width - left);
                let top = tile_y * part_height;
                for y in top..(top + part_height).min(height) {
                    work.check()?;
                    data.read_exact(&mut row).map_err(bad)?;
                    samples.clear();
                    T::unpack(&row, self, &mut samples);
                    if self.differences {
                        for index in self.stored..samples.len() {
                            samples[index] = samples[index].plus(samples[index - self.stored]);
                        }
                    }
                    let into = &mut out[(y * width + left) * count..][..columns * count];
                    for (into, from) in into.chunks_exact_mut(count).zip(samples.chunks_exact(self.stored)) {
                        self.pixel(from, into);
                    }
                }
                // The end of the data, with the checksum of deflate.
                if self.compression == Compression::Deflate {
                    let _ = data.read(&mut [0]).map_err(bad)?;
                }
            }
        }
        Ok(out)
    }

    /// Converts a pixel to RGB or RGBA.
    fn pixel<T: Sample>(&self, from: &[T], into: &mut [T]) {
        match self.colour {
            Colour::Rgb => into[..3].copy_from_slice(&from[..3]),
            Colour::Grey { .. } | Colour::Palette if self.labels => into[..3].fill(from[0]),
            Colour::Grey { white_is_zero } => into[..3].fill(if white_is_zero { from[0].inverted() } else { from[0] }),
            Colour::Palette => {
                let colours = 1 << self.bits;
                for (c, sample) in into[..3].iter_mut().enumerate() {
                    let value = self.palette.and_then(|palette| palette.get(c * colours + from[0].index())).unwrap_or(0);
                    *sample = T::from_short(value);
                }
            }
        }
        if let ([colours @ .., alpha], Some(Alpha { index, is_premultiplied })) = (into, self.alpha) {
            *alpha = from[index];
            if is_premultiplied && !self.labels {
                colours.iter_mut().for_each(|sample| *sample = sample.divided(*alpha));
            }
        }
    }

    /// The palette of a label image: the upper bytes of its 16-bit colours.
    pub(in crate::codec) fn label_palette(&self) -> Option<Palette> {
        let palette = self.palette.filter(|_| self.colour == Colour::Palette && self.bits <= 8)?;
        let colours = 1_usize << self.bits;
        let sample = |index: usize| u8::from_short(palette.get(index).unwrap_or(0));
        let colours = (0..colours).map(|k| [0, 1, 2].map(|c| sample(c * colours + k))).collect();
        Some(Palette { colours, alpha: Vec::new() })
    }

    pub(in crate::codec) const fn has_profile(&self) -> bool {
        self.profile.is_some()
    }

    pub(in crate::codec) fn icc(&self) -> Option<Vec<u8>> {
        let profile = self.profile.filter(|profile| !self.is_grey() && profile.len() <= MAX_ICC)?;
        keep_rgb_profile(profile.to_vec())
    }
}

/// A sample of 8 or 16 bit.
trait Sample: Copy + Default {
    /// Appends the samples of a row.
    fn unpack(row: &[u8], file: &TiffFile<'_>, out: &mut Vec<Self>);
    fn plus(self, other: Self) -> Self;
    fn inverted(self) -> Self;
    fn index(self) -> usize;
    fn from_short(value: u32) -> Self;
    /// Without its factor `alpha`.
    fn divided(self, alpha: Self) -> Self;
}

impl Sample for u8 {
    fn unpack(row: &[u8], file: &TiffFile<'_>, out: &mut Vec<Self>) {
        if file.bits == 8 {
            return out.extend_from_slice(row);
        }
        let most = (1_u16 << file.bits) - 1;
        let scale = if file.colour == Colour::Palette || file.labels { 1 } else { 255 / most };
        let per_byte = 8 / file.bits;
        for index in 0..file.part.0 {
            let shift = 8 - file.bits * (index % per_byte + 1);
            #[expect(clippy::cast_possible_truncation, reason = "at most 255")]
            out.push(((u16::from(row[(index / per_byte) as usize]) >> shift & most) * scale) as Self);
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
    fn from_short(value: u32) -> Self {
        (value >> 8) as Self
    }

    fn divided(self, alpha: Self) -> Self {
        let (sample, alpha) = (u32::from(self), u32::from(alpha));
        (sample * 255 + alpha / 2).checked_div(alpha).map_or(0, |straight| straight.min(255) as Self)
    }
}

impl Sample for u16 {
    fn unpack(row: &[u8], file: &TiffFile<'_>, out: &mut Vec<Self>) {
        out.extend(row.as_chunks().0.iter().map(|bytes| file.file.short(*bytes)));
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
    fn from_short(value: u32) -> Self {
        value as Self
    }

    fn divided(self, alpha: Self) -> Self {
        let (sample, alpha) = (u64::from(self), u64::from(alpha));
        (sample * 65_535 + alpha / 2).checked_div(alpha).map_or(0, |straight| straight.min(65_535) as Self)
    }
}
