//! Reads WebP (RFC 9649): walks the chunks for the header; `image` decodes the bitstream. The
//! decoder gets a container made here that holds only the frame with validated size, alpha and
//! length, so flags that promise absent chunks do no harm, and a frame larger than its canvas is
//! refused before memory is allocated. Cost: one copy of the file.

use std::borrow::Cow;

use image::ImageDecoder as _;
use image::codecs::webp::WebPDecoder;

use super::vp8l;
use crate::codec::alloc::{room, sample_count, zeros};
use crate::codec::metadata::{DroppedKind, Found};
use crate::codec::profile::{MAX_ICC, keep_profile};
use crate::codec::work::{Pieces, StepCounter};
use crate::codec::{CodecError, Format, Repairs};
use crate::pixmap::{Channels, Extent, Samples};

const ANIMATION_FLAG: u8 = 0b0000_0010;
const EXIF_FLAG: u8 = 0b0000_1000;
const ALPHA_FLAG: u8 = 0b0001_0000;
/// The bits of an ALPH chunk's first byte that give its coding, and their value for a lossless
/// stream.
const ALPHA_CODING: u8 = 0b11;
const ALPHA_LOSSLESS: u8 = 1;
/// Position, size, duration and flags of an animation's frame, before its chunks.
const ANMF_HEAD: usize = 16;

#[derive(Clone, Copy, Debug)]
enum WebPBitstream<'a> {
    /// VP8, and its ALPH chunk.
    Lossy(&'a [u8], Option<&'a [u8]>),
    /// VP8L.
    Lossless(&'a [u8], bool),
}

/// A VP8L stream, and its width and height if the stream does not contain them.
type Stream<'a> = (&'a [u8], Option<(u32, u32)>);

/// A WebP whose chunks have been walked.
#[derive(Debug)]
pub(in crate::codec) struct WebPFile<'a> {
    pub(in crate::codec) extent: Extent,
    coding: WebPBitstream<'a>,
    pub(in crate::codec) found: Found<'a>,
    pub(in crate::codec) repairs: Repairs,
    profile: Option<&'a [u8]>,
    /// Memory for the tables of a lossless stream's prefix codes: an upper bound, and exact once
    /// the codes have been read.
    code_bytes: u64,
}

fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::WebP.name(), detail)
}

fn damaged<E>(_: E) -> CodecError {
    bad("its pixels are damaged or end too early")
}

/// The chunks of a container, the first of each kind.
#[derive(Default)]
struct Chunks<'a> {
    canvas: Option<&'a [u8]>,
    vp8: Option<&'a [u8]>,
    vp8l: Option<&'a [u8]>,
    alpha: Option<&'a [u8]>,
    profile: Option<&'a [u8]>,
    exif: Option<&'a [u8]>,
    xmp: Option<&'a [u8]>,
    frame: Option<&'a [u8]>,
    frames: u64,
    /// Content credentials, and chunks of others.
    has_credentials: bool,
    has_others: bool,
    /// Whether the last chunk is cut off.
    is_open: bool,
}

impl<'a> Chunks<'a> {
    fn walk(mut rest: &'a [u8], work: &StepCounter<'_>) -> Result<Self, CodecError> {
        let mut found = Self::default();
        while let Some((head, behind)) = rest.split_first_chunk::<8>() {
            work.step(1)?;
            let size = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
            let size = usize::try_from(size).map_err(|_| bad("a chunk longer than memory"))?;
            let Some(data) = behind.get(..size) else {
                // Behind the image, only what no pixel needs may be cut off.
                let has_picture = found.vp8.or(found.vp8l).or(found.frame).is_some();
                found.is_open = has_picture && &head[..4] == b"XMP ";
                return if found.is_open {
                    Ok(found)
                } else {
                    Err(bad("a chunk is cut off"))
                };
            };
            let place = match &head[..4] {
                b"VP8X" => &mut found.canvas,
                b"VP8 " => &mut found.vp8,
                b"VP8L" => &mut found.vp8l,
                b"ALPH" => &mut found.alpha,
                b"ICCP" => &mut found.profile,
                b"EXIF" => &mut found.exif,
                b"XMP " => &mut found.xmp,
                b"ANMF" => {
                    found.frames += 1;
                    &mut found.frame
                }
                kind => {
                    found.has_credentials |= kind == b"C2PA";
                    found.has_others |= !matches!(kind, b"C2PA" | b"ANIM");
                    &mut None
                }
            };
            place.get_or_insert(data);
            // A last chunk of odd length may lack its padding, because the container's length has
            // been checked.
            rest = behind.get(size + size % 2..).unwrap_or_default();
        }
        Ok(found)
    }
}

impl<'a> WebPFile<'a> {
    pub(in crate::codec) fn parse(
        bytes: &'a [u8],
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let size = bytes
            .get(4..8)
            .and_then(|size| size.first_chunk())
            .map_or(0, |size| u32::from_le_bytes(*size));
        let end = usize::try_from(size)
            .ok()
            .and_then(|size| size.checked_add(8))
            .unwrap_or(usize::MAX);
        let body = bytes
            .get(12..end)
            .or(bytes.get(12..))
            .ok_or_else(|| bad("it is cut off before its end"))?;
        let mut chunks = Chunks::walk(body, work)?;
        // EXIF has the orientation.
        let lacks_exif = chunks.exif.is_none()
            && chunks
                .canvas
                .is_some_and(|canvas| canvas.first().is_some_and(|flags| flags & EXIF_FLAG != 0));
        if lacks_exif && end > bytes.len() {
            return Err(bad("it is cut off before its end"));
        }
        let repairs = Repairs {
            end: chunks.is_open || end > bytes.len(),
            ..Repairs::default()
        };
        let mut found = Found {
            exif: chunks.exif,
            xmp: chunks.xmp.map(Cow::Borrowed),
            ..Found::default()
        };
        found
            .dropped
            .add_if(chunks.has_credentials, DroppedKind::Credentials);
        found
            .dropped
            .add_if(chunks.has_others, DroppedKind::Application);

        let canvas = chunks.canvas.map(WebPCanvas::parse).transpose()?;
        if chunks.frames > 1 {
            return Err(CodecError::TooLarge {
                what: "image_frames",
                limit: 1,
                actual: chunks.frames,
            });
        }
        if let (Some(canvas), Some(frame)) = (&canvas, chunks.frame)
            && canvas.animated
        {
            let head = frame
                .get(..ANMF_HEAD)
                .ok_or_else(|| bad("a frame is cut off"))?;
            if head[..6] != [0; 6] {
                return Err(bad("its only frame does not cover the canvas"));
            }
            let inner = Chunks::walk(&frame[ANMF_HEAD..], work)?;
            if inner.is_open {
                return Err(bad("a chunk is cut off"));
            }
            chunks = Chunks {
                vp8: inner.vp8,
                vp8l: inner.vp8l,
                alpha: inner.alpha,
                ..chunks
            };
        }

        let (extent, coding) = match (chunks.vp8, chunks.vp8l) {
            (Some(vp8), None) => (
                vp8_extent(vp8)?,
                WebPBitstream::Lossy(vp8, chunks.alpha.filter(|_| canvas.is_some())),
            ),
            (None, Some(vp8l)) => {
                let (extent, alpha) = vp8l_header(vp8l)?;
                (extent, WebPBitstream::Lossless(vp8l, alpha))
            }
            (None, None) => return Err(bad("no picture")),
            (Some(_), Some(_)) => return Err(bad("two pictures")),
        };
        if canvas.is_some_and(|canvas| {
            (canvas.width, canvas.height) != (extent.width(), extent.height())
        }) {
            return Err(bad("a picture of another size than its canvas"));
        }
        let mut file = Self {
            extent,
            coding,
            found,
            repairs,
            profile: chunks.profile,
            code_bytes: 0,
        };
        if file.lossless_stream().is_some() {
            file.code_bytes = vp8l::most_code_bytes(extent.pixels());
        }
        Ok(file)
    }

    fn lossless_stream(&self) -> Option<Stream<'a>> {
        match self.coding {
            WebPBitstream::Lossless(vp8l, _) => Some((vp8l, None)),
            WebPBitstream::Lossy(_, Some([head, stream @ ..]))
                if head & ALPHA_CODING == ALPHA_LOSSLESS =>
            {
                Some((stream, Some((self.extent.width(), self.extent.height()))))
            }
            WebPBitstream::Lossy(..) => None,
        }
    }

    /// Computes the memory for the tables of the prefix codes.
    pub(in crate::codec) fn read_codes(
        &mut self,
        work: &StepCounter<'_>,
    ) -> Result<(), CodecError> {
        if let Some((stream, size)) = self.lossless_stream() {
            self.code_bytes = vp8l::code_bytes(stream, size, self.code_bytes, work)?;
        }
        Ok(())
    }

    pub(in crate::codec) fn channels(&self) -> Channels {
        match self.coding {
            WebPBitstream::Lossy(_, Some(_)) | WebPBitstream::Lossless(_, true) => Channels::Rgba,
            WebPBitstream::Lossy(_, None) | WebPBitstream::Lossless(_, false) => Channels::Rgb,
        }
    }

    /// Memory beside the image: the copy of the frame (for VP8 its partitions twice more); for
    /// VP8 its planes (3/2 bytes per pixel of whole macroblocks, and a record of each); for ALPH
    /// its RGBA and its green; for VP8L the RGBA that is decoded when RGB is wanted, up to three
    /// quarter-size images of transforms and code groups, and the tables of its codes.
    pub(in crate::codec) fn decoder_bytes(&self) -> u64 {
        let (width, height) = (
            u64::from(self.extent.width()),
            u64::from(self.extent.height()),
        );
        let pixels = width * height;
        let (data, planes) = match self.coding {
            WebPBitstream::Lossy(vp8, alpha) => {
                let macroblocks = width.div_ceil(16) * height.div_ceil(16);
                let alpha_planes = if alpha.is_some() { 6 * pixels } else { 0 };
                (
                    3 * vp8.len() + alpha.map_or(0, <[u8]>::len),
                    macroblocks * (384 + 2 * 64) + alpha_planes,
                )
            }
            WebPBitstream::Lossless(vp8l, true) => (vp8l.len(), pixels),
            WebPBitstream::Lossless(vp8l, false) => (vp8l.len(), 5 * pixels),
        };
        (1 << 20) + data as u64 + planes + self.code_bytes
    }

    /// A container with a canvas and the frame.
    fn remade(&self) -> Result<Vec<u8>, CodecError> {
        let chunks: [(&[u8; 4], &[u8]); 2] = match self.coding {
            WebPBitstream::Lossy(vp8, alpha) => {
                [(b"ALPH", alpha.unwrap_or_default()), (b"VP8 ", vp8)]
            }
            WebPBitstream::Lossless(vp8l, _) => [(b"ALPH", &[]), (b"VP8L", vp8l)],
        };
        let mut canvas = [0; 10];
        canvas[0] = if self.channels() == Channels::Rgba {
            ALPHA_FLAG
        } else {
            0
        };
        canvas[4..7].copy_from_slice(&(self.extent.width() - 1).to_le_bytes()[..3]);
        canvas[7..10].copy_from_slice(&(self.extent.height() - 1).to_le_bytes()[..3]);
        let mut out = room::<u8>(
            64 + chunks
                .iter()
                .map(|(_, data)| data.len() as u64)
                .sum::<u64>(),
        )?;
        out.extend_from_slice(b"RIFF\0\0\0\0WEBP");
        for (kind, data) in [(b"VP8X", canvas.as_slice())].into_iter().chain(chunks) {
            if !data.is_empty() {
                let size =
                    u32::try_from(data.len()).map_err(|_| bad("a chunk longer than 4 GiB"))?;
                out.extend_from_slice(kind);
                out.extend_from_slice(&size.to_le_bytes());
                out.extend_from_slice(data);
                out.resize(out.len().next_multiple_of(2), 0);
            }
        }
        let size = u32::try_from(out.len() - 8).map_err(|_| bad("a file longer than 4 GiB"))?;
        out[4..8].copy_from_slice(&size.to_le_bytes());
        Ok(out)
    }

    /// The stored rows.
    pub(in crate::codec) fn samples(&self, work: &StepCounter<'_>) -> Result<Samples, CodecError> {
        let decoder = WebPDecoder::new(Pieces::new(self.remade()?, work)).map_err(damaged)?;
        let len = sample_count(self.extent.pixels(), self.channels());
        if decoder.dimensions() != (self.extent.width(), self.extent.height())
            || decoder.total_bytes() != len
        {
            return Err(bad("two headers that disagree"));
        }
        let mut out = zeros::<u8>(len, work)?;
        decoder.read_image(&mut out).map_err(damaged)?;
        Ok(Samples::Eight(out))
    }

    pub(in crate::codec) fn has_profile(&self) -> bool {
        self.profile.is_some()
    }

    pub(in crate::codec) fn icc(&self) -> Option<Vec<u8>> {
        self.profile
            .filter(|profile| profile.len() <= MAX_ICC)
            .map(<[u8]>::to_vec)
            .and_then(|profile| keep_profile(profile, false))
    }
}

struct WebPCanvas {
    animated: bool,
    width: u32,
    height: u32,
}

impl WebPCanvas {
    fn parse(data: &[u8]) -> Result<Self, CodecError> {
        let &[flags, _, _, _, w0, w1, w2, h0, h1, h2, ..] = data else {
            return Err(bad("a canvas that is too short"));
        };
        Ok(Self {
            animated: flags & ANIMATION_FLAG != 0,
            width: 1 + u32::from_le_bytes([w0, w1, w2, 0]),
            height: 1 + u32::from_le_bytes([h0, h1, h2, 0]),
        })
    }
}

fn vp8_extent(data: &[u8]) -> Result<Extent, CodecError> {
    let &[tag, _, _, 0x9D, 0x01, 0x2A, w0, w1, h0, h1, ..] = data else {
        return Err(bad("no VP8 key frame"));
    };
    if tag & 1 != 0 {
        return Err(bad("a VP8 frame that depends on another"));
    }
    let [width, height] =
        [[w0, w1], [h0, h1]].map(|side| u32::from(u16::from_le_bytes(side) & 0x3FFF));
    Extent::new(width, height).ok_or_else(|| bad(format!("a picture of {width} x {height} pixels")))
}

/// Size, and whether alpha is used.
fn vp8l_header(data: &[u8]) -> Result<(Extent, bool), CodecError> {
    let &[0x2F, b0, b1, b2, b3, ..] = data else {
        return Err(bad("no VP8L signature"));
    };
    let bits = u32::from_le_bytes([b0, b1, b2, b3]);
    if bits >> 29 != 0 {
        return Err(bad("an unknown version of VP8L"));
    }
    let extent = Extent::new(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF))
        .expect("one more than a number is not zero");
    Ok((extent, bits >> 28 & 1 == 1))
}
