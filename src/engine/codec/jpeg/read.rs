//! Reads JPEG (ITU-T T.81; JFIF, EXIF, ICC.1 annex B.4): walks the segments for the header;
//! `zune-jpeg` decodes baseline and progressive Huffman images of 8 bit to RGB. Decoders fill
//! missing data with grey, so completeness is checked here: behind the data come one-bits and the
//! marker EOI. No Huffman code consists of ones alone (T.81, annex C), so a truncated scan meets an
//! invalid code instead of zeros. A file without EOI is read if its scans state every bit of every
//! coefficient, and if the image is the same whether ones or zeros follow. Cost: one copy of the
//! file; without EOI, the work of decoding twice.

use std::ops::Range;

use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::scans::Precision;
use super::segments::{
    APP0, APP2, APP13, APP15, COM, DHT, EOI, MarkerSegment, SOI, SOS, bad, cut_off, find,
};
use crate::codec::alloc::{room, sample_count, zeros};
use crate::codec::metadata::Found;
use crate::codec::profile::{MAX_ICC, keep_profile};
use crate::codec::work::{Bytes, StepCounter};
use crate::codec::{CodecError, Repairs};
use crate::pixmap::{Channels, Extent, Samples};

/// Bytes of one-bits before EOI: enough for the magnitude bits that a truncated code still
/// requests, and a whole code of 16 bits.
const PADDING_BYTES: usize = 8;
/// The most places with bytes between segments.
const MOST_GAPS: usize = 64;

const SOF0: u8 = 0xC0;
const SOF2: u8 = 0xC2;
const JPG: u8 = 0xC8;
const DAC: u8 = 0xCC;
const SOF15: u8 = 0xCF;
const RST0: u8 = 0xD0;
const RST7: u8 = 0xD7;

/// A JPEG whose segments have been walked up to its first scan.
#[derive(Debug)]
pub(in crate::codec) struct JpegFile<'a> {
    bytes: &'a [u8],
    pub(in crate::codec) extent: Extent,
    progressive: bool,
    /// The number of each component, and its horizontal and vertical sampling factor.
    components: Vec<u8>,
    factors: Vec<(u64, u64)>,
    pub(in crate::codec) found: Found<'a>,
    /// Whether there are bytes between the segments of the header.
    has_gap: bool,
    /// Sequence number, number of parts, part.
    profile: Vec<(u8, u8, &'a [u8])>,
    /// The header of the first scan, and the start of its entropy-coded data.
    scan: (&'a [u8], usize),
    /// Whether the components are the colours, as in some TIFF files.
    pub(in crate::codec) is_rgb: bool,
}

/// The scans of a file.
struct Scans {
    /// End of the first scan's entropy-coded data.
    first: usize,
    /// End of the last one's.
    end: usize,
    count: u32,
    entropy_bytes: u64,
    /// Bytes between segments, which are left out.
    gaps: Vec<Range<usize>>,
    /// Whether the mark of the end is missing.
    is_open: bool,
}

fn damaged<E>(_: E) -> CodecError {
    bad("its pixels are damaged or end too early")
}

impl<'a> JpegFile<'a> {
    pub(in crate::codec) fn parse(
        bytes: &'a [u8],
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let mut frame = None;
        let mut found = Found::default();
        let mut profile = Vec::new();
        let (mut profile_bytes, mut has_gap) = (0, false);
        let mut at = 2;
        loop {
            let segment = MarkerSegment::at(bytes, at, work)?;
            has_gap |= segment.start > at;
            at = segment.end;
            match segment.marker {
                DHT => {}
                JPG | DAC => {
                    return Err(CodecError::unsupported(
                        "a JPEG with arithmetic coding or extensions",
                    ));
                }
                marker @ SOF0..=SOF15 if frame.is_none() => {
                    frame = Some(FrameHeader::parse(marker, segment.data)?)
                }
                SOF0..=SOF15 => return Err(bad("two frames")),
                APP2 if segment.data.starts_with(b"ICC_PROFILE\0") => {
                    if let Some([number, count, part @ ..]) = segment.data.get(12..)
                        && profile_bytes + part.len() <= MAX_ICC + usize::from(u16::MAX)
                        && profile.len() < usize::from(u8::MAX)
                    {
                        profile_bytes += part.len();
                        profile.push((*number, *count, part));
                    }
                }
                SOI | EOI => return Err(bad("it ends before its first scan")),
                SOS => {
                    let FrameHeader {
                        extent,
                        progressive,
                        components,
                        factors,
                    } = frame.ok_or_else(|| bad("a scan before the frame"))?;
                    // The decoder silently drops the last rows of such a scan if they are
                    // truncated.
                    if !progressive
                        && segment
                            .data
                            .first()
                            .is_none_or(|&count| usize::from(count) != factors.len())
                    {
                        return Err(CodecError::unsupported(
                            "a baseline JPEG whose components come in separate scans",
                        ));
                    }
                    let scan = (segment.data, at);
                    return Ok(Self {
                        bytes,
                        extent,
                        progressive,
                        components,
                        factors,
                        found,
                        has_gap,
                        profile,
                        scan,
                        is_rgb: false,
                    });
                }
                _ => find(&segment, &mut found, work),
            }
        }
    }

    /// Number of 8 x 8 blocks of all components, rounded up to whole MCUs.
    fn padded_blocks(&self) -> u64 {
        let (h_max, v_max) = self.largest_factors();
        let columns = u64::from(self.extent.width()).div_ceil(8 * h_max);
        let rows = u64::from(self.extent.height()).div_ceil(8 * v_max);
        self.factors
            .iter()
            .map(|(h, v)| columns * rows * h * v)
            .sum()
    }

    /// Number of blocks that a file must code, each with at least one bit.
    fn coded_blocks(&self) -> u64 {
        let (h_max, v_max) = self.largest_factors();
        let blocks =
            |side: u32, factor: u64, max: u64| (u64::from(side) * factor).div_ceil(8 * max);
        self.factors
            .iter()
            .map(|&(h, v)| {
                blocks(self.extent.width(), h, h_max) * blocks(self.extent.height(), v, v_max)
            })
            .sum()
    }

    fn largest_factors(&self) -> (u64, u64) {
        self.factors.iter().fold((1, 1), |(h, v), factors| {
            (h.max(factors.0), v.max(factors.1))
        })
    }

    /// Memory beside the image: the copy of the file, the coefficients of all blocks of a
    /// progressive image, and some rows of MCUs before and after upsampling.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        let coefficients = if self.progressive {
            2 * 64 * self.padded_blocks()
        } else {
            0
        };
        let (h_max, v_max) = self.largest_factors();
        let row_of_mcus = u64::from(self.extent.width()).next_multiple_of(8 * h_max) * 8 * v_max;
        (256 << 10) + 2 * self.bytes.len() as u64 + coefficients + 2 * 4 * 4 * row_of_mcus
    }

    /// Walks all scans.
    fn scans(&self, work: &StepCounter<'_>) -> Result<Scans, CodecError> {
        let (header, mut at) = self.scan;
        let mut scans = Scans {
            first: 0,
            end: 0,
            count: 1,
            entropy_bytes: 0,
            gaps: Vec::new(),
            is_open: false,
        };
        let mut precision = Precision::new(&self.components);
        precision.add(header);
        loop {
            let rest = self.bytes.get(at..).unwrap_or_default();
            let run = rest.iter().position(|&byte| byte == 0xFF);
            let length = run.unwrap_or(rest.len());
            work.step(1 + length as u64)?;
            scans.entropy_bytes += length as u64;
            at += length;
            match self.bytes.get(at + 1) {
                Some(0) => {
                    scans.entropy_bytes += 1;
                    at += 2;
                    continue;
                }
                Some(RST0..=RST7) => {
                    at += 2;
                    continue;
                }
                Some(0xFF) => {
                    at += 1;
                    continue;
                }
                _ => {}
            }
            if scans.first == 0 {
                scans.first = at;
            }
            scans.end = at;
            loop {
                let segment = match MarkerSegment::at(self.bytes, at, work) {
                    Ok(segment) => segment,
                    Err(CodecError::Cancelled) => return Err(CodecError::Cancelled),
                    // Behind the last scan that an image needs, nothing is missing but the mark of
                    // the end.
                    Err(error) if self.progressive && !precision.is_full() => return Err(error),
                    Err(_) => {
                        return Ok(Scans {
                            is_open: true,
                            ..scans
                        });
                    }
                };
                if segment.start > at {
                    scans.gaps.push(at..segment.start);
                    if scans.gaps.len() > MOST_GAPS {
                        return Err(bad("too many bytes between its segments"));
                    }
                }
                at = segment.end;
                match segment.marker {
                    EOI => return Ok(scans),
                    SOI => return Err(bad("a picture begins inside a picture")),
                    SOS => {
                        scans.count += 1;
                        precision.add(segment.data);
                        break;
                    }
                    _ => {}
                }
            }
        }
    }

    /// The file as far as the decoder needs it, without its end.
    fn needed(&self, scans: &Scans, work: &StepCounter<'_>) -> Result<Vec<u8>, CodecError> {
        // The decoder omits the last rows if it sees a marker ahead of them, so nothing may follow
        // a single scan.
        let end = if self.progressive {
            scans.end
        } else {
            scans.first
        };
        let mut whole = room::<u8>((end + 2 * PADDING_BYTES + 2) as u64)?;
        whole.extend_from_slice(&[0xFF, SOI]);
        let (_, scan) = self.scan;
        let mut at = 2;
        while at < scan {
            let segment = MarkerSegment::at(self.bytes, at, work)?;
            // Of the segments of applications, Adobe's says what the components are.
            if !matches!(segment.marker, APP0..=APP13 | APP15 | COM) {
                whole.extend_from_slice(&self.bytes[segment.start..segment.end]);
            }
            at = segment.end;
        }
        for gap in scans.gaps.iter().filter(|gap| gap.end <= end) {
            whole.extend_from_slice(&self.bytes[at..gap.start]);
            at = gap.end;
        }
        whole.extend_from_slice(&self.bytes[at..end]);
        Ok(whole)
    }

    /// The stored rows, RGB, and what was mended.
    pub(in crate::codec) fn samples(
        &self,
        work: &StepCounter<'_>,
    ) -> Result<(Samples, Repairs), CodecError> {
        let scans = self.scans(work)?;
        if scans.entropy_bytes.saturating_mul(8) < self.coded_blocks() {
            return Err(bad(format!(
                "{} bytes of data cannot hold the picture",
                scans.entropy_bytes
            )));
        }
        if !self.progressive && scans.count > 1 {
            return Err(bad("a second scan of components that are complete"));
        }
        let mut whole = self.needed(&scans, work)?;
        let length = whole.len();
        // The decoder looks for the marker directly behind the first scan of a progressive image,
        // where ones would hide it.
        if !(self.progressive && scans.count == 1) {
            whole.extend_from_slice(&[0xFF, 0].repeat(PADDING_BYTES));
        }
        whole.extend_from_slice(&[0xFF, EOI]);
        let mut out = zeros::<u8>(sample_count(self.extent.pixels(), Channels::Rgb), work)?;
        self.decode(&whole, &mut out, work)?;
        if scans.is_open {
            let with_ones = checksum(&out, work)?;
            whole.truncate(length);
            whole.extend_from_slice(&[0; 2 * PADDING_BYTES]);
            whole.extend_from_slice(&[0xFF, EOI]);
            let is_same =
                self.decode(&whole, &mut out, work).is_ok() && checksum(&out, work)? == with_ones;
            work.check()?;
            if !is_same {
                return Err(cut_off());
            }
        }
        let repairs = Repairs {
            end: scans.is_open,
            gap: self.has_gap || !scans.gaps.is_empty(),
            checksum: false,
        };
        Ok((Samples::Eight(out), repairs))
    }

    fn decode(
        &self,
        whole: &[u8],
        out: &mut [u8],
        work: &StepCounter<'_>,
    ) -> Result<(), CodecError> {
        let (width, height) = (self.extent.width() as usize, self.extent.height() as usize);
        let options = DecoderOptions::default()
            .set_strict_mode(true)
            .set_max_width(width)
            .set_max_height(height)
            .jpeg_set_out_colorspace(ColorSpace::RGB);
        let mut decoder =
            zune_jpeg::JpegDecoder::new_with_options(Bytes::new(whole, work), options);
        decoder.decode_headers().map_err(damaged)?;
        if let Some(stored) = decoder.input_colorspace().filter(|_| self.is_rgb) {
            decoder.set_options(options.jpeg_set_out_colorspace(stored));
        }
        let components = decoder
            .info()
            .map_or(0, |info| usize::from(info.components));
        if decoder.dimensions() != Some((width, height)) || components != self.factors.len() {
            return Err(bad("two headers that disagree"));
        }
        if decoder.output_buffer_size() != Some(out.len()) {
            return Err(bad("another colour space than RGB"));
        }
        decoder.decode_into(out).map_err(damaged)
    }

    pub(in crate::codec) const fn is_progressive(&self) -> bool {
        self.progressive
    }

    pub(in crate::codec) fn is_grey(&self) -> bool {
        self.factors.len() == 1
    }

    pub(in crate::codec) fn has_profile(&self) -> bool {
        !self.profile.is_empty()
    }

    /// The profile, with its parts in order.
    pub(in crate::codec) fn icc(&self) -> Option<Vec<u8>> {
        if !matches!(self.factors.len(), 1 | 3) || self.profile.is_empty() {
            return None;
        }
        let mut parts = self.profile.clone();
        parts.sort_unstable_by_key(|&(number, ..)| number);
        let in_order = (1..).zip(&parts).all(|(n, &(number, count, _))| {
            usize::from(number) == n && usize::from(count) == parts.len()
        });
        let profile = in_order.then(|| {
            parts
                .iter()
                .flat_map(|(.., part)| part.iter().copied())
                .collect()
        })?;
        keep_profile(profile, self.is_grey())
    }
}

/// Sums samples, to compare two images in the memory of one.
fn checksum(samples: &[u8], work: &StepCounter<'_>) -> Result<u32, CodecError> {
    const PIECE: usize = 1 << 22;
    let mut sum = crc32fast::Hasher::new();
    for piece in samples.chunks(PIECE) {
        work.check()?;
        sum.update(piece);
    }
    Ok(sum.finalize())
}

struct FrameHeader {
    extent: Extent,
    progressive: bool,
    components: Vec<u8>,
    factors: Vec<(u64, u64)>,
}

impl FrameHeader {
    fn parse(marker: u8, data: &[u8]) -> Result<Self, CodecError> {
        if marker > SOF2 {
            return Err(CodecError::unsupported(format!(
                "a JPEG of coding process {}",
                marker - SOF0
            )));
        }
        let &[precision, h1, h0, w1, w0, count, ref components @ ..] = data else {
            return Err(bad("a frame header that is too short"));
        };
        let (width, height) = (u16::from_be_bytes([w1, w0]), u16::from_be_bytes([h1, h0]));
        let extent = Extent::new(width.into(), height.into())
            .ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        if precision != 8 {
            return Err(CodecError::unsupported(format!(
                "a JPEG of {precision} bits a sample"
            )));
        }
        if components.len() != 3 * usize::from(count) {
            return Err(bad("a frame header of the wrong size"));
        }
        if !matches!(count, 1 | 3 | 4) {
            return Err(CodecError::unsupported(format!(
                "a JPEG of {count} components"
            )));
        }
        let factors: Vec<_> = components
            .chunks_exact(3)
            .map(|c| (u64::from(c[1] >> 4), u64::from(c[1] & 15)))
            .collect();
        if factors
            .iter()
            .any(|&(h, v)| !matches!((h, v), (1..=4, 1..=4)))
        {
            return Err(bad("a sampling factor outside 1 to 4"));
        }
        let components = components.chunks_exact(3).map(|c| c[0]).collect();
        Ok(Self {
            extent,
            progressive: marker == SOF2,
            components,
            factors,
        })
    }
}
