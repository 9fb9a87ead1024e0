//! The segments of a JPEG: markers and their data, and what those of applications say.

use std::borrow::Cow;

use crate::codec::metadata::{DroppedKind, Found, Resolution, ResolutionUnit, photoshop};
use crate::codec::{CodecError, Format, StepCounter};

const TEM: u8 = 0x01;
pub(super) const DHT: u8 = 0xC4;
const RST0: u8 = 0xD0;
pub(super) const SOI: u8 = 0xD8;
pub(super) const EOI: u8 = 0xD9;
pub(super) const SOS: u8 = 0xDA;
pub(super) const APP0: u8 = 0xE0;
const APP1: u8 = 0xE1;
pub(super) const APP2: u8 = 0xE2;
const APP11: u8 = 0xEB;
const APP12: u8 = 0xEC;
pub(super) const APP13: u8 = 0xED;
const APP14: u8 = 0xEE;
pub(super) const APP15: u8 = 0xEF;
pub(super) const COM: u8 = 0xFE;

pub(super) fn bad(detail: impl ToString) -> CodecError {
    CodecError::bad(Format::Jpeg.name(), detail)
}

pub(super) fn cut_off() -> CodecError {
    bad("it is cut off before its end")
}

/// A segment, from the byte before its marker to its end.
pub(super) struct MarkerSegment<'a> {
    pub(super) marker: u8,
    pub(super) data: &'a [u8],
    pub(super) start: usize,
    pub(super) end: usize,
}

impl<'a> MarkerSegment<'a> {
    /// The segment at `at`. Zero bytes before it, which some programs write, are skipped, and so
    /// are fill bytes before its marker. Markers without a length have no data.
    pub(super) fn at(
        bytes: &'a [u8],
        at: usize,
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let rest = bytes.get(at..).ok_or_else(cut_off)?;
        let zeros = rest.iter().take_while(|byte| **byte == 0).count();
        work.step(1 + zeros as u64)?;
        let start = at + zeros;
        if *bytes.get(start).ok_or_else(cut_off)? != 0xFF {
            return Err(bad("a segment does not begin with a marker"));
        }
        let mut at = start;
        while *bytes.get(at).ok_or_else(cut_off)? == 0xFF {
            work.step(1)?;
            at += 1;
        }
        let (marker, at) = (bytes[at], at + 1);
        if matches!(marker, TEM | RST0..=EOI) {
            return Ok(Self {
                marker,
                data: &[],
                start,
                end: at,
            });
        }
        let length = usize::from(u16::from_be_bytes(
            *bytes[at..].first_chunk().ok_or_else(cut_off)?,
        ));
        if length < 2 {
            return Err(bad("a segment shorter than its own length field"));
        }
        let data = bytes[at..].get(2..length).ok_or_else(cut_off)?;
        Ok(Self {
            marker,
            data,
            start,
            end: at + length,
        })
    }
}

/// Looks at a segment that no pixel needs.
pub(super) fn find<'a>(segment: &MarkerSegment<'a>, found: &mut Found<'a>, work: &StepCounter<'_>) {
    let data = segment.data;
    match segment.marker {
        APP0 => {
            // Version, unit, across and down.
            if let Some([_, _, unit, x0, x1, y0, y1, ..]) = data.strip_prefix(b"JFIF\0") {
                let unit = match unit {
                    1 => ResolutionUnit::Inch,
                    2 => ResolutionUnit::Centimetre,
                    _ => ResolutionUnit::Unknown,
                };
                let [x, y] =
                    [[*x0, *x1], [*y0, *y1]].map(|number| u16::from_be_bytes(number).into());
                found.resolution = Resolution::whole(x, y, unit);
            }
        }
        APP1 if data.starts_with(b"Exif\0\0") => found.exif = found.exif.or(Some(data)),
        APP1 => match data.strip_prefix(b"http://ns.adobe.com/xap/1.0/\0") {
            Some(packet) if found.xmp.is_none() => found.xmp = Some(Cow::Borrowed(packet)),
            None if data.starts_with(b"http://ns.adobe.com/xmp/extension/\0") => {
                found.dropped.add(DroppedKind::ExtendedXmp)
            }
            _ => found.dropped.add(DroppedKind::Application),
        },
        APP2 => found.dropped.add(if data.starts_with(b"MPF\0") {
            DroppedKind::FurtherImages
        } else {
            DroppedKind::Application
        }),
        APP11 => found.dropped.add(DroppedKind::Credentials),
        APP13 => match data.strip_prefix(b"Photoshop 3.0\0") {
            Some(resources) => photoshop::resources(resources, &mut found.dropped, work),
            None => found.dropped.add(DroppedKind::Application),
        },
        // How an encoder has encoded.
        APP12 if data.starts_with(b"Ducky") => {}
        APP14 if data.starts_with(b"Adobe") => {}
        COM => found.add_comment(Cow::Borrowed(data)),
        other if (APP0..=APP15).contains(&other) => found.dropped.add(DroppedKind::Application),
        _ => {}
    }
}
