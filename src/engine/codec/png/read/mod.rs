//! Reads PNG (W3C, third edition): walks the chunks for the header, then takes rows from the `png`
//! crate one at a time, so memory is touched only as data arrives. Grey becomes RGB, palettes and
//! 1, 2, 4 bit are expanded, a tRNS chunk becomes alpha, 16 bit stays 16 bit. The checksums of
//! chunks that pixels need must match, and so must that of the pixels. Other chunks with a wrong
//! checksum are left out, and what is missing behind the pixels is added ([`Repairs`]). Shapes:
//! samples `[height][width][channels]`, rows as stored.

mod walk;

use std::borrow::Cow;
use std::io::Read;

use self::walk::chunk_at;
use crate::codec::alloc::{room, sample_count, zeros};
use crate::codec::metadata::Found;
use crate::codec::profile::{MAX_ICC, keep_profile};
use crate::codec::work::{Pieces, StepCounter};
use crate::codec::{CodecError, Format, Palette, Repairs};
use crate::pixmap::{Channels, Depth, Extent, Samples};

const SIGNATURE_BYTES: usize = 8;

/// Largest expansion by deflate: matches of 258 bytes at two bits each.
const MAX_INFLATION: u64 = 1032;

/// Largest size of the data per byte of filtered rows. Deflate without any gain takes 9/8 (fixed
/// codes); the rest is for encoders that write stored blocks of a few bytes.
const DATA_PER_BYTE: u64 = 2;
/// Additional data per row: an encoder may flush each row, which takes 5 bytes, or some blocks of
/// its own.
const DATA_PER_ROW: u64 = 16;
/// Additional data for an image of any size.
const FREE_DATA: u64 = 64 << 10;
/// Bytes per data chunk, beside one chunk for each row: encoders have buffers of some KiB, the
/// smallest known half a KiB.
const BYTES_PER_CHUNK: u64 = 512;
/// Additional data chunks for an image of any size: test suites have small images with a chunk
/// for each byte.
const FREE_CHUNKS: u64 = 4096;

/// Bytes of deflated profiles and texts beyond their inflated size: the same reserve as for the
/// data of an image.
const FREE_DEFLATED: usize = 64 << 10;
/// The largest XMP packet that is inflated.
const MOST_XMP: usize = 1 << 17;

/// An empty IEND.
const EMPTY_IEND: [u8; 12] = *b"\0\0\0\0IEND\xAE\x42\x60\x82";
/// Bytes of a chunk beside its data.
const CHUNK_OVERHEAD_BYTES: u64 = 12;

/// First column, first row, column step, row step of the seven passes.
const ADAM7: [(usize, usize, usize, usize); 7] = [
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
];

/// A PNG whose chunks have been walked.
#[derive(Debug)]
pub(in crate::codec) struct PngFile<'a> {
    bytes: &'a [u8],
    pub(in crate::codec) extent: Extent,
    bits: u8,
    colour: u8,
    interlaced: bool,
    transparency: bool,
    /// Whether it has chunks that must not reach the decoder, or lacks its end.
    is_copied: bool,
    pub(in crate::codec) found: Found<'a>,
    pub(in crate::codec) repairs: Repairs,
    profile: Option<&'a [u8]>,
    palette: Option<&'a [u8]>,
    alpha: &'a [u8],
    /// Samples are read as they are stored.
    pub(in crate::codec) labels: bool,
    idat_bytes: u64,
    idat_chunks: u64,
    /// The end of IEND, or of the last whole chunk.
    end: usize,
    /// The data of a last IDAT that is cut off.
    rest: &'a [u8],
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::Png.name(), detail)
}

fn cut_off() -> CodecError {
    bad("it is cut off before its end")
}

fn wrong_checksum(kind: [u8; 4]) -> CodecError {
    bad(format!(
        "the chunk {} has a wrong checksum, so it is damaged",
        kind.escape_ascii()
    ))
}

impl<'a> PngFile<'a> {
    pub(in crate::codec) fn parse(
        bytes: &'a [u8],
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let ihdr = chunk_at(bytes, SIGNATURE_BYTES)
            .filter(|chunk| &chunk.kind == b"IHDR")
            .ok_or_else(|| bad("no header chunk"))?;
        if !ihdr.is_intact(work)? {
            return Err(wrong_checksum(ihdr.kind));
        }
        let &[
            w0,
            w1,
            w2,
            w3,
            h0,
            h1,
            h2,
            h3,
            bits,
            colour,
            0,
            0,
            interlace @ (0 | 1),
        ] = ihdr.data
        else {
            return Err(bad(
                "a header chunk of the wrong size or with an unknown method",
            ));
        };
        let (width, height) = (
            u32::from_be_bytes([w0, w1, w2, w3]),
            u32::from_be_bytes([h0, h1, h2, h3]),
        );
        let extent = Extent::new(width, height)
            .ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        if !matches!(
            (colour, bits),
            (0, 1 | 2 | 4 | 8 | 16) | (3, 1 | 2 | 4 | 8) | (2 | 4 | 6, 8 | 16)
        ) {
            return Err(bad(format!("colour type {colour} with {bits} bits")));
        }
        let mut file = Self {
            bytes,
            extent,
            bits,
            colour,
            interlaced: interlace == 1,
            transparency: false,
            is_copied: false,
            found: Found::default(),
            repairs: Repairs::default(),
            profile: None,
            palette: None,
            alpha: &[],
            labels: false,
            idat_bytes: 0,
            idat_chunks: 0,
            end: ihdr.end,
            rest: &[],
        };
        file.walk(ihdr.end, work)?;
        Ok(file)
    }

    pub(in crate::codec) fn channels(&self) -> Channels {
        if self.transparency && !self.labels || matches!(self.colour, 4 | 6) {
            Channels::Rgba
        } else {
            Channels::Rgb
        }
    }

    pub(in crate::codec) fn is_grey(&self) -> bool {
        matches!(self.colour, 0 | 4) || self.labels && self.colour == 3
    }

    pub(in crate::codec) fn depth(&self) -> Depth {
        if self.bits == 16 {
            Depth::Sixteen
        } else {
            Depth::Eight
        }
    }

    /// Memory beside the image: the inflater's window and a few rows, the EXIF block that the
    /// decoder keeps, a copy without frames.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        let rows = 48 * u64::from(self.extent.width());
        let exif = 4 * self.found.exif.map_or(0, |exif| exif.len() as u64);
        let copy = if self.is_copied {
            self.bytes.len() as u64 + 2 * CHUNK_OVERHEAD_BYTES
        } else {
            0
        };
        (512 << 10) + rows + exif + copy
    }

    /// Number of the filtered rows, and their bytes.
    fn filtered(&self) -> (u64, u64) {
        let samples = match self.colour {
            2 => 3,
            4 => 2,
            6 => 4,
            _ => 1,
        };
        let (width, height) = (
            u64::from(self.extent.width()),
            u64::from(self.extent.height()),
        );
        let pass = |columns: u64, rows: u64| {
            let rows = if columns == 0 { 0 } else { rows };
            (
                rows,
                rows.saturating_mul(1 + (columns * samples * u64::from(self.bits)).div_ceil(8)),
            )
        };
        if !self.interlaced {
            return pass(width, height);
        }
        let part = |side: u64, first: usize, step: usize| {
            side.saturating_sub(first as u64).div_ceil(step as u64)
        };
        let passes = ADAM7
            .iter()
            .map(|&(x, y, dx, dy)| pass(part(width, x, dx), part(height, y, dy)));
        passes.fold((0, 0), |(rows, bytes), (more_rows, more)| {
            (rows + more_rows, bytes.saturating_add(more))
        })
    }

    /// Checks that the data can hold the image and little else, so that the inflater's work for
    /// empty blocks, empty chunks and data beyond the last row is proportional to the image.
    fn weigh_data(&self) -> Result<(), CodecError> {
        let (rows, raw) = self.filtered();
        if self.idat_bytes.saturating_mul(MAX_INFLATION) < raw {
            return Err(bad(format!(
                "{} bytes of data cannot hold the picture",
                self.idat_bytes
            )));
        }
        let most = raw
            .saturating_mul(DATA_PER_BYTE)
            .saturating_add(rows * DATA_PER_ROW)
            .saturating_add(FREE_DATA);
        if self.idat_bytes > most {
            return Err(bad(format!(
                "{} bytes of data for a picture that takes at most {most}",
                self.idat_bytes
            )));
        }
        let most = rows + raw / BYTES_PER_CHUNK + FREE_CHUNKS;
        if self.idat_chunks > most {
            return Err(bad(format!(
                "{} chunks of data for a picture that takes at most {most}",
                self.idat_chunks
            )));
        }
        Ok(())
    }

    /// The file with its end, and without chunks that must not reach the decoder: those of a
    /// one-frame animation, whose frame size is another, and those with a wrong checksum.
    fn still(&self, work: &StepCounter<'_>) -> Result<Cow<'a, [u8]>, CodecError> {
        let whole = &self.bytes[..self.end];
        if !self.is_copied {
            return Ok(Cow::Borrowed(whole));
        }
        let mut copy = room((self.end + self.rest.len()) as u64 + 2 * CHUNK_OVERHEAD_BYTES)?;
        copy.extend_from_slice(&whole[..SIGNATURE_BYTES]);
        let mut at = SIGNATURE_BYTES;
        while let Some(chunk) = chunk_at(whole, at) {
            work.step(1)?;
            let is_read =
                matches!(&chunk.kind, b"IHDR" | b"PLTE" | b"tRNS") && chunk.is_intact(work)?;
            if is_read || &chunk.kind == b"IDAT" {
                copy.extend_from_slice(&whole[at..chunk.end]);
            }
            at = chunk.end;
        }
        if !self.rest.is_empty() {
            let start = copy.len() + 4;
            copy.extend_from_slice(
                &u32::try_from(self.rest.len())
                    .unwrap_or(u32::MAX)
                    .to_be_bytes(),
            );
            copy.extend_from_slice(b"IDAT");
            copy.extend_from_slice(self.rest);
            let sum = crc32fast::hash(&copy[start..]);
            copy.extend_from_slice(&sum.to_be_bytes());
        }
        copy.extend_from_slice(&EMPTY_IEND);
        Ok(Cow::Owned(copy))
    }

    /// The stored rows. `budget`: bytes that the decoder itself may allocate.
    pub(in crate::codec) fn samples(
        &self,
        budget: u64,
        work: &StepCounter<'_>,
    ) -> Result<Samples, CodecError> {
        self.weigh_data()?;
        let damaged = |error: png::DecodingError| {
            if self.repairs.end {
                cut_off()
            } else if matches!(error, png::DecodingError::IoError(_)) {
                bad("its pixels end too early")
            } else {
                self.damaged(work)
            }
        };
        let mut options = png::DecodeOptions::default();
        options.set_ignore_text_chunk(true);
        options.set_ignore_iccp_chunk(true);
        options.set_skip_ancillary_crc_failures(false);
        options.set_ignore_adler32(false);
        let mut decoder =
            png::Decoder::new_with_options(Pieces::new(self.still(work)?, work), options);
        decoder.set_limits(png::Limits {
            bytes: usize::try_from(budget).unwrap_or(usize::MAX),
        });
        decoder.set_transformations(if self.labels {
            png::Transformations::IDENTITY
        } else {
            png::Transformations::EXPAND
        });
        let mut reader = decoder.read_info().map_err(damaged)?;
        let samples = match self.depth() {
            Depth::Eight => self
                .rows::<u8, _>(&mut reader, &damaged, work)
                .map(Samples::Eight),
            Depth::Sixteen => self
                .rows::<u16, _>(&mut reader, &damaged, work)
                .map(Samples::Sixteen),
        }?;
        // The rest of the data must be complete too: its end, the checksums, IEND.
        reader.finish().map_err(damaged)?;
        Ok(samples)
    }

    /// What is wrong with pixels that cannot be decoded.
    fn damaged(&self, work: &StepCounter<'_>) -> CodecError {
        let mut at = SIGNATURE_BYTES;
        while let Some(chunk) = chunk_at(&self.bytes[..self.end], at) {
            if &chunk.kind == b"IDAT" && !chunk.is_intact(work).unwrap_or(true) {
                return wrong_checksum(chunk.kind);
            }
            at = chunk.end;
        }
        bad("its pixels are damaged, or no PNG stores them like this")
    }

    fn rows<T: PngSample, R: std::io::BufRead + std::io::Seek>(
        &self,
        reader: &mut png::Reader<R>,
        damaged: &dyn Fn(png::DecodingError) -> CodecError,
        work: &StepCounter<'_>,
    ) -> Result<Vec<T>, CodecError> {
        let (colour, bits) = reader.output_color_type();
        let (width, height) = (self.extent.width() as usize, self.extent.height() as usize);
        if reader.info().size() != (self.extent.width(), self.extent.height())
            || bits as usize
                != if self.labels {
                    self.bits.into()
                } else {
                    8 * T::BYTES
                }
            || colour.samples() > self.channels().count()
        {
            return Err(bad("two headers that disagree"));
        }
        let line = reader
            .output_line_size(self.extent.width())
            .ok_or_else(|| bad("a row longer than memory"))?;
        let mut row = room::<u8>(line as u64)?;
        row.resize(line, 0);
        let mut unpacked = room::<u8>(if self.labels && self.bits < 8 {
            width as u64
        } else {
            0
        })?;
        let per_pixel = self.channels().count();
        let len = sample_count(self.extent.pixels(), self.channels());
        if !self.interlaced {
            let mut out = room::<T>(len)?;
            for _ in 0..height {
                work.check()?;
                reader
                    .read_row(&mut row)
                    .map_err(damaged)?
                    .ok_or_else(|| bad("too few rows"))?;
                T::expand(
                    self.unpacked(&row, width, &mut unpacked),
                    colour.samples(),
                    self.channels(),
                    &mut out,
                );
            }
            return Ok(out);
        }
        let mut out = zeros::<T>(len, work)?;
        let mut pixels = room::<T>((width * per_pixel) as u64)?;
        for (first_column, first_row, column_step, row_step) in ADAM7 {
            let columns = width.saturating_sub(first_column).div_ceil(column_step);
            if columns == 0 {
                continue;
            }
            for y in (first_row..height).step_by(row_step) {
                work.check()?;
                reader
                    .read_row(&mut row)
                    .map_err(damaged)?
                    .ok_or_else(|| bad("too few rows"))?;
                pixels.clear();
                let row = &self.unpacked(&row, columns, &mut unpacked)
                    [..columns * colour.samples() * T::BYTES];
                T::expand(row, colour.samples(), self.channels(), &mut pixels);
                let target =
                    out[y * width * per_pixel..][..width * per_pixel].chunks_exact_mut(per_pixel);
                for (into, from) in target
                    .skip(first_column)
                    .step_by(column_step)
                    .zip(pixels.chunks_exact(per_pixel))
                {
                    into.copy_from_slice(from);
                }
            }
        }
        Ok(out)
    }

    /// A row of stored samples, one byte each if they have fewer than 8 bits.
    fn unpacked<'r>(&self, row: &'r [u8], columns: usize, out: &'r mut Vec<u8>) -> &'r [u8] {
        let bits = usize::from(self.bits);
        if !self.labels || bits >= 8 {
            return row;
        }
        out.clear();
        let most = (1_u8 << bits) - 1;
        out.extend((0..columns).map(|k| row[k * bits / 8] >> (8 - bits - k * bits % 8) & most));
        out
    }

    /// The palette of a label image.
    pub(in crate::codec) fn label_palette(&self) -> Result<Option<Palette>, CodecError> {
        if self.colour != 3 {
            return Ok(None);
        }
        let (colours, rest) = self.palette.unwrap_or_default().as_chunks();
        if colours.is_empty() || colours.len() > 256 || !rest.is_empty() {
            return Err(bad("no palette, or one of no whole colours"));
        }
        Ok(Some(Palette {
            colours: colours.to_vec(),
            alpha: self.alpha[..self.alpha.len().min(colours.len())].to_vec(),
        }))
    }

    pub(in crate::codec) fn has_profile(&self) -> bool {
        self.profile.is_some()
    }

    /// The profile.
    pub(in crate::codec) fn icc(&self, work: &StepCounter<'_>) -> Option<Vec<u8>> {
        let data = self.profile?;
        let name = data.iter().take(80).position(|&byte| byte == 0)?;
        let profile = inflated(data.get(name + 1..)?.strip_prefix(&[0])?, MAX_ICC, work)?;
        keep_profile(profile, matches!(self.colour, 0 | 4))
    }

    /// What was found, with XMP as text.
    pub(in crate::codec) fn found(&self, work: &StepCounter<'_>) -> Found<'a> {
        let mut found = self.found.clone();
        if let Some(Cow::Borrowed([flag, method, rest @ ..])) = found.xmp {
            // Behind the language and the translated keyword.
            let text = rest.splitn(3, |byte| *byte == 0).nth(2).unwrap_or_default();
            found.xmp = match (flag, method) {
                (0, _) => Some(Cow::Borrowed(text)),
                (1, 0) => Some(Cow::Owned(
                    inflated(text, MOST_XMP, work).unwrap_or_default(),
                )),
                _ => Some(Cow::Borrowed(&[])),
            };
        }
        found
    }
}

/// Inflates to at most one byte more than `most`; `None` if the data are damaged.
fn inflated(deflated: &[u8], most: usize, work: &StepCounter<'_>) -> Option<Vec<u8>> {
    if deflated.len() > most + FREE_DEFLATED {
        return None;
    }
    let mut out = Vec::new();
    flate2::bufread::ZlibDecoder::new(Pieces::new(deflated, work))
        .take(most as u64 + 1)
        .read_to_end(&mut out)
        .ok()?;
    Some(out)
}

/// A sample in PNG's format.
trait PngSample: Copy + Default {
    const BYTES: usize;
    const OPAQUE: Self;
    fn from_be(bytes: &[u8]) -> Self;
    fn append(row: &[u8], out: &mut Vec<Self>);

    /// Appends a row of grey, grey and alpha, RGB or RGBA (`stored` samples per pixel) as
    /// `channels`.
    fn expand(row: &[u8], stored: usize, channels: Channels, out: &mut Vec<Self>) {
        if stored == channels.count() {
            return Self::append(row, out);
        }
        for pixel in row.chunks_exact(stored * Self::BYTES) {
            let sample = |index: usize| Self::from_be(&pixel[index * Self::BYTES..]);
            match (stored, channels) {
                (1, Channels::Rgb) => out.extend([sample(0); 3]),
                (1, Channels::Rgba) => out.extend([sample(0), sample(0), sample(0), Self::OPAQUE]),
                (2, _) => out.extend([sample(0), sample(0), sample(0), sample(1)]),
                _ => out.extend([sample(0), sample(1), sample(2), Self::OPAQUE]),
            }
        }
    }
}

impl PngSample for u8 {
    const BYTES: usize = 1;
    const OPAQUE: Self = Self::MAX;

    fn from_be(bytes: &[u8]) -> Self {
        bytes[0]
    }

    fn append(row: &[u8], out: &mut Vec<Self>) {
        out.extend_from_slice(row);
    }
}

impl PngSample for u16 {
    const BYTES: usize = 2;
    const OPAQUE: Self = Self::MAX;

    fn from_be(bytes: &[u8]) -> Self {
        Self::from_be_bytes([bytes[0], bytes[1]])
    }

    fn append(row: &[u8], out: &mut Vec<Self>) {
        out.extend(
            row.as_chunks::<2>()
                .0
                .iter()
                .map(|&sample| Self::from_be_bytes(sample)),
        );
    }
}
