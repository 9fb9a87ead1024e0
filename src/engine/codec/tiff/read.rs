//! Reads TIFF (6.0; `BigTIFF`): one page of grey, palette or RGB, with or without alpha, in strips
//! or tiles, interleaved or in planes, not compressed or with LZW, deflate, PackBits, CCITT group 4
//! or JPEG. The directory is read in place; rows are decoded one at a time (JPEG: a strip or tile).
//! Grey becomes RGB, palettes and 1, 2, 4 bit are expanded, 16 bit stays 16 bit, and premultiplied
//! alpha is divided out. An image has no samples that are neither colour nor alpha: such files are
//! refused, never reduced. Memory: the image and a few rows; work: in proportion to the image
//! and the file.

use super::data::TiffCompression;
use super::found::found;
use super::pages::{only_page, orientation, uniform, unsupported};
use super::parts::Parts;
use crate::codec::ifd::read::{Directory, File, Values, bad};
use crate::codec::metadata::Found;
use crate::codec::orientation::ExifOrientation;
use crate::codec::profile::{MAX_ICC, keep_profile};
use crate::codec::{CodecError, Palette, StepCounter};
use crate::pixmap::{Channels, Depth, Extent};

/// The largest JPEG tables, which precede every strip or tile: two of quantisation and four of
/// codes take 600 bytes.
const MOST_TABLES: usize = 2048;
/// The widest line of group 4.
const WIDEST_FAX: u32 = 1 << 20;

/// What the samples of a pixel mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Photometric {
    Grey {
        white_is_zero: bool,
    },
    Rgb,
    Palette,
    /// Brightness and differences of colour; only of JPEG.
    YCbCr,
}

/// The sample behind the colours that is alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Alpha {
    pub(super) is_premultiplied: bool,
}

/// A TIFF whose directory has been read.
#[derive(Debug)]
pub(in crate::codec) struct TiffFile<'a> {
    pub(super) file: File<'a>,
    pub(in crate::codec) extent: Extent,
    pub(in crate::codec) orientation: ExifOrientation,
    pub(in crate::codec) found: Found<'a>,
    pub(super) bits: u32,
    /// Whether samples may be negative.
    pub(super) is_signed: bool,
    /// Samples of a pixel.
    pub(super) stored: usize,
    pub(super) is_planar: bool,
    pub(super) colour: Photometric,
    pub(super) alpha: Option<Alpha>,
    pub(super) palette: Option<Values<'a>>,
    pub(super) compression: TiffCompression,
    /// Whether bytes begin with their lowest bit.
    pub(super) is_reversed: bool,
    pub(super) differences: bool,
    /// What the JPEG of every strip or tile begins with.
    pub(super) tables: &'a [u8],
    pub(super) parts: Parts<'a>,
    longest_part: u64,
    profile: Option<&'a [u8]>,
    /// Samples are read as they are stored.
    pub(in crate::codec) labels: bool,
}

/// Refuses depths and numbers of samples that no reader here knows.
fn check_samples(
    (bits, stored): (u32, u32),
    colour: Photometric,
    compression: TiffCompression,
    has_alpha: bool,
    width: u32,
) -> Result<(), CodecError> {
    let is_jpeg = compression == TiffCompression::Jpeg;
    let is_known = match (bits, stored, colour) {
        (8, ..) => true,
        (16, _, Photometric::Grey { .. } | Photometric::Rgb) | (1 | 2 | 4, 1, _) => !is_jpeg,
        // Labels.
        (32 | 64, 1, Photometric::Grey { .. }) => !is_jpeg,
        _ => false,
    };
    if !is_known
        || compression == TiffCompression::Group4 && (bits, stored) != (1, 1)
        || is_jpeg && has_alpha
    {
        return Err(unsupported(format_args!(
            "whose bits per sample are {bits} and samples per pixel {stored}"
        )));
    }
    if compression == TiffCompression::Group4 && width > WIDEST_FAX {
        return Err(unsupported(format_args!(
            "of group 4 with lines of {width} pixels"
        )));
    }
    Ok(())
}

impl<'a> TiffFile<'a> {
    pub(in crate::codec) fn parse(
        bytes: &'a [u8],
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let file = File::new(bytes).ok_or_else(|| bad("its header is damaged"))?;
        let (page, has_mask) = only_page(file, work)?;
        let number = |tag, default| page.number(tag, default, work);
        let (width, height) = (number(256, 0)?, number(257, 0)?);
        let extent = Extent::new(width, height)
            .ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        let compression = number(259, 1)?;
        let compression = TiffCompression::from_number(compression).ok_or_else(|| {
            unsupported(format_args!(
                "with {}",
                TiffCompression::name_of(compression)
            ))
        })?;
        let colour = colour_of(&page, compression, work)?;
        let is_signed = is_signed(&page, work)?;
        let (stored, bits) = (number(277, 1)?, uniform(&page, 258, 1, "depth", work)?);
        let colours = if matches!(colour, Photometric::Rgb | Photometric::YCbCr) {
            3
        } else {
            1
        };
        if stored < colours {
            return Err(unsupported(format_args!(
                "whose number of samples per pixel is {stored}"
            )));
        }
        let alpha = alpha_of(&page, colour, (stored, colours), work)?;
        if is_signed && (bits < 8 || stored > 1) {
            return Err(unsupported("of samples with a sign"));
        }
        let is_jpeg = compression == TiffCompression::Jpeg;
        check_samples((bits, stored), colour, compression, alpha.is_some(), width)?;
        let is_planar = stored > 1 && number(284, 1)? == 2;
        if is_planar && is_jpeg {
            return Err(unsupported("of JPEG whose channels are in separate planes"));
        }
        let is_reversed = number(266, 1)? == 2;
        if is_reversed
            && (bits != 1
                || !matches!(compression, TiffCompression::None | TiffCompression::Group4))
        {
            return Err(unsupported("whose bits are in reverse order"));
        }
        let differences = match number(317, 1)? {
            _ if is_jpeg || compression == TiffCompression::Group4 => false,
            1 => false,
            2 if bits >= 8 => true,
            kind => {
                return Err(unsupported(format_args!(
                    "with predictor {kind} of {bits} bits"
                )));
            }
        };
        let palette = page.values(320, work)?;
        if colour == Photometric::Palette && palette.is_none_or(|palette| palette.len() < 3 << bits)
        {
            return Err(bad("too few colours in its palette"));
        }
        let tables = page
            .values(347, work)?
            .filter(|_| is_jpeg)
            .map_or(&[][..], |values| values.data);
        if tables.len() > MOST_TABLES {
            return Err(bad(format!("JPEG tables of {} bytes", tables.len())));
        }
        let parts = Parts::of(&page, extent, compression, work)?;
        let longest_part = if is_jpeg {
            parts.longest(work)?.min(bytes.len() as u64)
        } else {
            0
        };
        let (found, profile) = found(page, has_mask, work)?;
        Ok(Self {
            file,
            extent,
            orientation: orientation(&page, work)?,
            found,
            bits,
            is_signed,
            stored: stored as usize,
            is_planar,
            colour,
            alpha,
            palette,
            compression,
            is_reversed,
            differences,
            tables,
            parts,
            longest_part,
            profile,
            labels: false,
        })
    }

    /// Whether samples may be negative, or larger than 16 bits hold.
    pub(super) const fn is_counted(&self) -> bool {
        self.bits > 16 || self.is_signed
    }

    /// Refuses what is read as labels only.
    pub(in crate::codec) fn check_picture(&self) -> Result<(), CodecError> {
        if self.is_counted() {
            let sign = if self.is_signed { " with a sign" } else { "" };
            return Err(unsupported(format_args!(
                "of samples of {} bits{sign}. If they are labels, send the file as a layer with \
                    `?kind=labels` (offline: `--kind labels`); \
                 if they are a picture, save it with 16 bits",
                self.bits
            )));
        }
        Ok(())
    }

    pub(in crate::codec) fn channels(&self) -> Channels {
        if self.alpha.is_none() {
            Channels::Rgb
        } else {
            Channels::Rgba
        }
    }

    pub(in crate::codec) const fn depth(&self) -> Depth {
        if self.bits >= 16 {
            Depth::Sixteen
        } else {
            Depth::Eight
        }
    }

    pub(in crate::codec) const fn is_grey(&self) -> bool {
        matches!(self.colour, Photometric::Grey { .. })
            || self.labels && matches!(self.colour, Photometric::Palette)
    }

    /// Planes that are stored one after the other.
    pub(super) const fn planes(&self) -> usize {
        if self.is_planar { self.stored } else { 1 }
    }

    /// Samples of a pixel in a plane.
    pub(super) const fn interleaved(&self) -> usize {
        if self.is_planar { 1 } else { self.stored }
    }

    /// Bytes of a row of a strip or tile.
    pub(super) fn row_bytes(&self) -> u64 {
        (u64::from(self.parts.width) * self.interleaved() as u64 * u64::from(self.bits)).div_ceil(8)
    }

    /// Memory beside the image: the decoders' windows, and a row as stored and as samples of up
    /// to two bytes, or the changes of four lines of group 4; of JPEG a strip or tile as RGB, its
    /// data three times, and rows of its blocks.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        let width = u64::from(self.parts.width);
        let rows = self.row_bytes() + 2 * width * self.interleaved() as u64;
        let more = match self.compression {
            TiffCompression::Jpeg => {
                let pixels = width * u64::from(self.parts.height);
                3 * pixels + 3 * (self.longest_part + MOST_TABLES as u64) + 1024 * (width + 32)
            }
            TiffCompression::Group4 => 32 * width,
            TiffCompression::None
            | TiffCompression::Lzw
            | TiffCompression::Deflate
            | TiffCompression::PackBits => 0,
        };
        (512 << 10) + rows + more
    }

    /// The palette of a label image: the upper bytes of its 16-bit colours.
    pub(in crate::codec) fn label_palette(&self) -> Option<Palette> {
        let palette = self
            .palette
            .filter(|_| self.colour == Photometric::Palette && self.bits <= 8)?;
        let colours = 1_usize << self.bits;
        #[expect(clippy::cast_possible_truncation, reason = "the upper byte of 16 bits")]
        let sample = |index: usize| (palette.get(index).unwrap_or(0) >> 8) as u8;
        let colours = (0..colours)
            .map(|k| [0, 1, 2].map(|c| sample(c * colours + k)))
            .collect();
        Some(Palette {
            colours,
            alpha: Vec::new(),
        })
    }

    pub(in crate::codec) const fn has_profile(&self) -> bool {
        self.profile.is_some()
    }

    pub(in crate::codec) fn icc(&self) -> Option<Vec<u8>> {
        let profile = self.profile.filter(|profile| profile.len() <= MAX_ICC)?;
        keep_profile(
            profile.to_vec(),
            matches!(self.colour, Photometric::Grey { .. }),
        )
    }
}

fn colour_of(
    page: &Directory<'_>,
    compression: TiffCompression,
    work: &StepCounter<'_>,
) -> Result<Photometric, CodecError> {
    let kind = page
        .values(262, work)?
        .and_then(|values| values.get(0))
        .ok_or_else(|| bad("no photometric interpretation"))?;
    Err(match kind {
        0 | 1 => {
            return Ok(Photometric::Grey {
                white_is_zero: kind == 0,
            });
        }
        2 => return Ok(Photometric::Rgb),
        3 => return Ok(Photometric::Palette),
        6 if compression == TiffCompression::Jpeg => return Ok(Photometric::YCbCr),
        5 => unsupported("of CMYK colours"),
        6 => unsupported("of YCbCr colours without JPEG"),
        8..=10 => unsupported("of Lab colours"),
        kind => unsupported(format_args!("of photometric interpretation {kind}")),
    })
}

/// Whether samples may be negative.
fn is_signed(page: &Directory<'_>, work: &StepCounter<'_>) -> Result<bool, CodecError> {
    match uniform(page, 339, 1, "format", work)? {
        1 | 4 => Ok(false),
        2 => Ok(true),
        3 => Err(unsupported(
            "of floating-point samples, which are measurements rather than a picture. To warp \
                them, fetch the positions with POST /map \
             (offline: mlswarp map) and sample the array there, for example with cv2.remap",
        )),
        _ => Err(unsupported("of complex samples")),
    }
}

/// The alpha of pixels with this number of stored samples, and of colours among them. Other samples
/// have no place in an image.
fn alpha_of(
    page: &Directory<'_>,
    colour: Photometric,
    (stored, colours): (u32, u32),
    work: &StepCounter<'_>,
) -> Result<Option<Alpha>, CodecError> {
    match (
        stored - colours,
        page.values(338, work)?.and_then(|kinds| kinds.get(0)),
    ) {
        (0, _) => Ok(None),
        // Writers that leave the tag out mean an image with alpha; two samples without it are as
        // often two channels of a microscope.
        (1, None) if matches!(colour, Photometric::Rgb) => Ok(Some(Alpha {
            is_premultiplied: false,
        })),
        (1, Some(kind @ (1 | 2))) if colour != Photometric::Palette => Ok(Some(Alpha {
            is_premultiplied: kind == 1,
        })),
        (extra, _) => {
            let colours = if colours == 1 {
                "1 is the colour"
            } else {
                "3 are the colours"
            };
            let others = if extra == 1 {
                "the other is"
            } else {
                "the others are"
            };
            Err(unsupported(format_args!(
                "of {stored} samples per pixel, of which {colours}; {others} not alpha \
                    (ExtraSamples 1 or 2), and would be lost. Save each \
                 channel as a file of its own, and send them as layers of a session"
            )))
        }
    }
}
