//! Reads JPEG (ITU-T T.81; JFIF, EXIF, ICC.1 annex B.4): walks the segments for the header; `zune-jpeg` decodes baseline and progressive
//! Huffman pictures of 8 bit to RGB. Decoders fill missing data with grey, so completeness is checked here: the marker EOI must be present
//! outside every segment, and is passed on behind a run of one-bits. No Huffman code consists of ones alone (T.81, annex C), so a
//! truncated scan meets an invalid code instead of zeros. Cost: one copy of the file.

use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::codec::alloc::{room, sample_count, zeros};
use crate::codec::profile::{MAX_ICC, keep_rgb_profile};
use crate::codec::work::{Bytes, StepCounter};
use crate::codec::{CodecError, Format};
use crate::pixmap::{Channels, Extent, Samples};

/// Bytes of one-bits before EOI: enough for the magnitude bits that a truncated code still requests, and a whole code of 16 bits.
const ONES: usize = 8;

const SOF0: u8 = 0xC0;
const SOF2: u8 = 0xC2;
const DHT: u8 = 0xC4;
const JPG: u8 = 0xC8;
const DAC: u8 = 0xCC;
const SOF15: u8 = 0xCF;
const RST0: u8 = 0xD0;
const RST7: u8 = 0xD7;
const SOI: u8 = 0xD8;
const EOI: u8 = 0xD9;
const SOS: u8 = 0xDA;
const APP1: u8 = 0xE1;
const APP2: u8 = 0xE2;
const TEM: u8 = 0x01;

/// A JPEG whose segments have been walked up to its first scan.
#[derive(Debug)]
pub(in crate::codec) struct JpegFile<'a> {
    bytes: &'a [u8],
    pub(in crate::codec) extent: Extent,
    progressive: bool,
    /// Horizontal and vertical sampling factor of each component.
    factors: Vec<(u64, u64)>,
    pub(in crate::codec) exif: Option<&'a [u8]>,
    /// Sequence number, number of parts, part.
    profile: Vec<(u8, u8, &'a [u8])>,
    /// Start of the first scan's entropy-coded data.
    scan: usize,
}

struct Segment<'a> {
    marker: u8,
    data: &'a [u8],
    end: usize,
}

/// The end of the scans.
struct End {
    /// End of the first scan's entropy-coded data.
    first_scan: usize,
    /// Position of EOI.
    eoi: usize,
    scans: u32,
    entropy_bytes: u64,
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::Jpeg.name(), detail)
}

fn cut_off() -> CodecError {
    bad("it is cut off before its end")
}

/// The segment whose marker is at `at`; fill bytes before the marker are skipped. Markers without a length are empty.
fn segment_at<'a>(bytes: &'a [u8], mut at: usize, work: &StepCounter<'_>) -> Result<Segment<'a>, CodecError> {
    if *bytes.get(at).ok_or_else(cut_off)? != 0xFF {
        return Err(bad("a segment does not begin with a marker"));
    }
    work.step(1)?;
    while *bytes.get(at).ok_or_else(cut_off)? == 0xFF {
        work.step(1)?;
        at += 1;
    }
    let (marker, at) = (bytes[at], at + 1);
    if matches!(marker, TEM | RST0..=EOI) {
        return Ok(Segment { marker, data: &[], end: at });
    }
    let length = usize::from(u16::from_be_bytes(*bytes[at..].first_chunk().ok_or_else(cut_off)?));
    if length < 2 {
        return Err(bad("a segment shorter than its own length field"));
    }
    let data = bytes[at..].get(2..length).ok_or_else(cut_off)?;
    Ok(Segment { marker, data, end: at + length })
}

impl<'a> JpegFile<'a> {
    pub(in crate::codec) fn parse(bytes: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        let mut frame = None;
        let mut exif = None;
        let mut profile = Vec::new();
        let mut profile_bytes = 0;
        let mut at = 2;
        loop {
            let segment = segment_at(bytes, at, work)?;
            at = segment.end;
            match segment.marker {
                DHT => {}
                JPG | DAC => return Err(CodecError::unsupported("a JPEG with arithmetic coding or extensions")),
                marker @ SOF0..=SOF15 if frame.is_none() => frame = Some(Frame::parse(marker, segment.data)?),
                SOF0..=SOF15 => return Err(bad("two frames")),
                APP1 if exif.is_none() && segment.data.starts_with(b"Exif\0\0") => exif = Some(segment.data),
                APP2 => {
                    if let Some([number, count, part @ ..]) = segment.data.strip_prefix(b"ICC_PROFILE\0")
                        && profile_bytes + part.len() <= MAX_ICC + usize::from(u16::MAX)
                        && profile.len() < usize::from(u8::MAX)
                    {
                        profile_bytes += part.len();
                        profile.push((*number, *count, part));
                    }
                }
                SOI | EOI => return Err(bad("it ends before its first scan")),
                SOS => {
                    let Frame { extent, progressive, factors } = frame.ok_or_else(|| bad("a scan before the frame"))?;
                    // The decoder silently drops the last rows of such a scan if they are truncated.
                    if !progressive && segment.data.first().is_none_or(|&count| usize::from(count) != factors.len()) {
                        return Err(CodecError::unsupported("a baseline JPEG whose components come in separate scans"));
                    }
                    return Ok(Self { bytes, extent, progressive, factors, exif, profile, scan: at });
                }
                _ => {}
            }
        }
    }

    /// Number of 8 x 8 blocks of all components, rounded up to whole MCUs.
    fn padded_blocks(&self) -> u64 {
        let (h_max, v_max) = self.largest_factors();
        let columns = u64::from(self.extent.width()).div_ceil(8 * h_max);
        let rows = u64::from(self.extent.height()).div_ceil(8 * v_max);
        self.factors.iter().map(|(h, v)| columns * rows * h * v).sum()
    }

    /// Number of blocks that a file must code, each with at least one bit.
    fn coded_blocks(&self) -> u64 {
        let (h_max, v_max) = self.largest_factors();
        let blocks = |side: u32, factor: u64, max: u64| (u64::from(side) * factor).div_ceil(8 * max);
        self.factors.iter().map(|&(h, v)| blocks(self.extent.width(), h, h_max) * blocks(self.extent.height(), v, v_max)).sum()
    }

    fn largest_factors(&self) -> (u64, u64) {
        self.factors.iter().fold((1, 1), |(h, v), factors| (h.max(factors.0), v.max(factors.1)))
    }

    /// Memory beside the picture: the copy of the file, the coefficients of all blocks of a progressive picture, and some rows of MCUs
    /// before and after upsampling.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        let coefficients = if self.progressive { 2 * 64 * self.padded_blocks() } else { 0 };
        let (h_max, v_max) = self.largest_factors();
        let row_of_mcus = u64::from(self.extent.width()).next_multiple_of(8 * h_max) * 8 * v_max;
        (256 << 10) + 2 * self.bytes.len() as u64 + coefficients + 2 * 4 * 4 * row_of_mcus
    }

    /// Walks all scans.
    fn find_end(&self, work: &StepCounter<'_>) -> Result<End, CodecError> {
        let mut end = End { first_scan: 0, eoi: 0, scans: 1, entropy_bytes: 0 };
        let mut at = self.scan;
        loop {
            let rest = self.bytes.get(at..).ok_or_else(cut_off)?;
            let run = rest.iter().position(|&byte| byte == 0xFF).ok_or_else(cut_off)?;
            work.step(1 + run as u64)?;
            end.entropy_bytes += run as u64;
            at += run;
            match self.bytes.get(at + 1).ok_or_else(cut_off)? {
                0 => {
                    end.entropy_bytes += 1;
                    at += 2;
                }
                RST0..=RST7 => at += 2,
                0xFF => at += 1,
                _ => loop {
                    if end.first_scan == 0 {
                        end.first_scan = at;
                    }
                    let segment = segment_at(self.bytes, at, work)?;
                    match segment.marker {
                        EOI => return Ok(End { eoi: at, ..end }),
                        SOI => return Err(bad("a picture begins inside a picture")),
                        SOS => {
                            end.scans += 1;
                            at = segment.end;
                            break;
                        }
                        _ => at = segment.end,
                    }
                },
            }
        }
    }

    /// The stored rows, RGB.
    pub(in crate::codec) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let end = self.find_end(work)?;
        if end.entropy_bytes.saturating_mul(8) < self.coded_blocks() {
            return Err(bad(format!("{} bytes of data cannot hold the picture", end.entropy_bytes)));
        }
        if !self.progressive && end.scans > 1 {
            return Err(bad("a second scan of components that are complete"));
        }
        // The decoder omits the last rows if it sees a marker ahead of them, so nothing may follow a single scan.
        let data_end = if self.progressive { end.eoi } else { end.first_scan };
        let mut whole = room::<u8>((data_end + 2 * ONES + 2) as u64)?;
        whole.extend_from_slice(&self.bytes[..data_end]);
        // The decoder looks for the marker directly behind the first scan of a progressive picture, where ones would hide it.
        if !(self.progressive && end.scans == 1) {
            whole.extend_from_slice(&[0xFF, 0].repeat(ONES));
        }
        whole.extend_from_slice(&[0xFF, EOI]);

        let (width, height) = (self.extent.width() as usize, self.extent.height() as usize);
        let options = DecoderOptions::default()
            .set_strict_mode(true)
            .set_max_width(width)
            .set_max_height(height)
            .jpeg_set_out_colorspace(ColorSpace::RGB);
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(Bytes::new(whole.as_slice(), work), options);
        decoder.decode_headers().map_err(bad)?;
        let components = decoder.info().map_or(0, |info| usize::from(info.components));
        if decoder.dimensions() != Some((width, height)) || components != self.factors.len() {
            return Err(bad("two headers that disagree"));
        }
        let len = sample_count(self.extent.pixels(), Channels::Rgb);
        let mut out = zeros::<u8>(len, work)?;
        if decoder.output_buffer_size() != Some(out.len()) {
            return Err(bad("another colour space than RGB"));
        }
        decoder.decode_into(&mut out).map_err(bad)?;
        Ok(Samples::Eight(out))
    }

    pub(in crate::codec) fn is_grey(&self) -> bool {
        self.factors.len() == 1
    }

    pub(in crate::codec) fn has_profile(&self) -> bool {
        !self.profile.is_empty()
    }

    /// The profile, with its parts in order.
    pub(in crate::codec) fn icc(&self) -> Option<Vec<u8>> {
        if self.factors.len() != 3 || self.profile.is_empty() {
            return None;
        }
        let mut parts = self.profile.clone();
        parts.sort_unstable_by_key(|&(number, ..)| number);
        let in_order = (1..).zip(&parts).all(|(n, &(number, count, _))| usize::from(number) == n && usize::from(count) == parts.len());
        in_order.then(|| parts.iter().flat_map(|(.., part)| part.iter().copied()).collect()).and_then(keep_rgb_profile)
    }
}

struct Frame {
    extent: Extent,
    progressive: bool,
    factors: Vec<(u64, u64)>,
}

impl Frame {
    fn parse(marker: u8, data: &[u8]) -> Result<Self, CodecError> {
        if marker > SOF2 {
            return Err(CodecError::unsupported(format!("a JPEG of coding process {}", marker - SOF0)));
        }
        let &[precision, h1, h0, w1, w0, count, ref components @ ..] = data else {
            return Err(bad("a frame header that is too short"));
        };
        let (width, height) = (u16::from_be_bytes([w1, w0]), u16::from_be_bytes([h1, h0]));
        let extent = Extent::new(width.into(), height.into()).ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))?;
        if precision != 8 {
            return Err(CodecError::unsupported(format!("a JPEG of {precision} bits a sample")));
        }
        if components.len() != 3 * usize::from(count) {
            return Err(bad("a frame header of the wrong size"));
        }
        if !matches!(count, 1 | 3 | 4) {
            return Err(CodecError::unsupported(format!("a JPEG of {count} components")));
        }
        let factors: Vec<_> = components.chunks_exact(3).map(|c| (u64::from(c[1] >> 4), u64::from(c[1] & 15))).collect();
        if factors.iter().any(|&(h, v)| !matches!((h, v), (1..=4, 1..=4))) {
            return Err(bad("a sampling factor outside 1 to 4"));
        }
        Ok(Self { extent, progressive: marker == SOF2, factors })
    }
}
