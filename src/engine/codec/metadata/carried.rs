//! The metadata of one output in the form of each format.

use std::sync::Arc;

use super::exif::{self, Exif};
use super::resolution::{Resolution, ResolutionUnit};
use super::{Dropped, DroppedKind, KeptChunk, Metadata, PngChunk};
use crate::codec::ifd::write::{BYTE, DirectoryWriter, UNDEFINED};
use crate::codec::{Format, Profile};
use crate::format::TextSupport;
use crate::pixmap::Extent;

/// The keyword of XMP in a PNG, and what follows it: not compressed, of no language.
const XMP_IN_PNG: &[u8] = b"XML:com.adobe.xmp\0\0\0\0\0";
const XMP_IN_JPEG: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";
const COMMENT: &[u8] = b"Comment\0";
/// The largest number of pHYs, and of JFIF.
const MOST_IN_PNG: u32 = u32::MAX >> 1;
const MOST_IN_JPEG: u32 = u16::MAX as u32;

const APP1: u8 = 0xE1;
const COM: u8 = 0xFE;
/// The most bytes of a comment in a JPEG.
const MOST_IN_SEGMENT: usize = 65_533;

/// The metadata of an output: those of its source, at its resolution.
#[derive(Clone, Debug)]
pub struct Carried {
    source: Arc<Metadata>,
    resolution: Option<Resolution>,
    colour_only: bool,
}

impl Carried {
    /// Those of an image of `target` pixels that shows `canvas` pixels of the source.
    #[must_use]
    pub fn new(source: &Arc<Metadata>, target: Extent, canvas: Extent) -> Self {
        let resolution = source
            .resolution
            .and_then(|resolution| resolution.scaled(target, canvas));
        Self {
            source: Arc::clone(source),
            resolution,
            colour_only: false,
        }
    }

    /// A profile alone.
    #[cfg(test)]
    pub(in crate::codec) fn of_icc(icc: &[u8]) -> Self {
        let source = Metadata {
            profile: Some(Profile::new(icc)),
            ..Metadata::default()
        };
        Self {
            source: Arc::new(source),
            resolution: None,
            colour_only: false,
        }
    }

    /// Those of a preview: what its numbers mean, and nothing else.
    #[must_use]
    pub fn colour_only(self) -> Self {
        Self {
            resolution: None,
            colour_only: true,
            ..self
        }
    }

    /// Whether a file of this format, grey or not, says less about colour than the source, and what
    /// else it lacks.
    #[must_use]
    pub fn losses(&self, format: Format, grey: bool) -> (bool, Dropped) {
        let Self {
            source,
            resolution,
            colour_only,
        } = self;
        let kept = format.info().metadata;
        let lost_profile =
            source.profile.is_some() && (!kept.is_any || self.profile(grey).is_none());
        let lost_colour = source.profile_dropped
            || lost_profile
            || source.needs_chunks && !kept.has_colour_chunks;
        if *colour_only {
            return (lost_colour, Dropped::default());
        }
        let mut dropped = source.dropped;
        dropped.add_if(
            source.resolution.is_some() && (!kept.is_any || resolution.is_none()),
            DroppedKind::Resolution,
        );
        // The frames of an animation have pixels alone.
        dropped.add_if(!kept.is_any && source.exif.is_some(), DroppedKind::Exif);
        dropped.add_if(!kept.is_any && source.xmp.is_some(), DroppedKind::Xmp);
        let has_maker_note = source.exif.as_ref().is_some_and(Exif::has_maker_note);
        dropped.add_if(
            has_maker_note && !kept.has_maker_note,
            DroppedKind::MakerNote,
        );
        let is_lost = |text: &KeptChunk| match kept.texts {
            TextSupport::All => false,
            TextSupport::Comments => comment_of(text).is_none(),
            TextSupport::None => true,
        };
        dropped.add_if(source.texts.iter().any(is_lost), DroppedKind::Text);
        dropped.add_if(
            !source.comments.is_empty() && kept.texts == TextSupport::None,
            DroppedKind::Comment,
        );
        (lost_colour, dropped)
    }

    /// The profile, if it is for such samples.
    pub(in crate::codec) fn profile(&self, grey: bool) -> Option<&Profile> {
        self.source
            .profile
            .as_ref()
            .filter(|profile| profile.is_grey() == grey)
    }

    /// The XMP packet.
    pub(in crate::codec) fn xmp(&self) -> Option<&[u8]> {
        self.source.xmp.as_deref().filter(|_| !self.colour_only)
    }

    fn exif(&self) -> Option<&Exif> {
        self.source.exif.as_ref().filter(|_| !self.colour_only)
    }

    /// The resolution in a unit of EXIF and TIFF.
    fn resolution_in_tags(&self) -> Option<Resolution> {
        let unit = if self.resolution?.unit == ResolutionUnit::Inch {
            ResolutionUnit::Inch
        } else {
            ResolutionUnit::Centimetre
        };
        self.resolution?.in_unit(unit)
    }

    /// A block of EXIF; `says_resolution`: whether the format itself says the resolution.
    pub(in crate::codec) fn exif_block(&self, says_resolution: bool) -> Option<Vec<u8>> {
        let resolution = self.resolution_in_tags().filter(|_| !says_resolution);
        (self.exif().is_some() || resolution.is_some())
            .then(|| exif::block(self.exif(), resolution))
    }

    /// The chunks of a PNG that come before its palette.
    pub(in crate::codec) fn chunks_of_colour(
        &self,
        grey: bool,
    ) -> (Option<&Profile>, &[KeptChunk]) {
        (self.profile(grey), &self.source.colour)
    }

    /// The chunks of a PNG that may follow its palette.
    pub(in crate::codec) fn chunks(&self) -> Vec<PngChunk<Vec<u8>>> {
        let mut chunks = Vec::new();
        let mut says_resolution = self.resolution.is_none();
        if let Some(resolution) = self.resolution
            && let Some(([x, y], is_near)) = resolution
                .in_unit(ResolutionUnit::Metre)
                .and_then(|metre| metre.rounded(MOST_IN_PNG))
        {
            let has_unit = resolution.unit != ResolutionUnit::Unknown;
            says_resolution = is_near;
            if has_unit || is_near {
                chunks.push((
                    *b"pHYs",
                    [
                        &x.to_be_bytes()[..],
                        &y.to_be_bytes(),
                        &[u8::from(has_unit)],
                    ]
                    .concat(),
                ));
            }
        }
        chunks.extend(
            self.exif_block(says_resolution)
                .map(|block| (*b"eXIf", block)),
        );
        chunks.extend(self.xmp().map(|xmp| (*b"iTXt", [XMP_IN_PNG, xmp].concat())));
        if !self.colour_only {
            chunks.extend(
                self.source
                    .texts
                    .iter()
                    .map(|(kind, data)| (*kind, data.to_vec())),
            );
            chunks.extend(self.source.comments.iter().map(|comment| text_of(comment)));
        }
        chunks
    }

    /// The density of JFIF: its unit, across and down; and whether it says the resolution.
    pub(in crate::codec) fn density(&self) -> (u8, [u16; 2], bool) {
        let Some(resolution) = self.resolution else {
            return (0, [1; 2], true);
        };
        let in_unit = |unit| Some((unit, resolution.in_unit(unit)?.rounded(MOST_IN_JPEG)?));
        let units = if resolution.unit == ResolutionUnit::Centimetre {
            [ResolutionUnit::Centimetre, ResolutionUnit::Inch]
        } else {
            [ResolutionUnit::Inch, ResolutionUnit::Centimetre]
        };
        let near = units
            .into_iter()
            .filter_map(in_unit)
            .find(|(_, (_, is_near))| *is_near);
        let nearest = near
            .or_else(|| in_unit(units[0]).filter(|_| resolution.unit != ResolutionUnit::Unknown));
        let Some((unit, (numbers, is_near))) = nearest else {
            return (0, [1; 2], false);
        };
        let unit = match (resolution.unit, unit) {
            (ResolutionUnit::Unknown, _) => 0,
            (_, ResolutionUnit::Inch) => 1,
            _ => 2,
        };
        #[expect(clippy::cast_possible_truncation, reason = "at most that of JFIF")]
        (unit, numbers.map(|number| number as u16), is_near)
    }

    /// The segments of a JPEG, without its profile: markers and contents.
    pub(in crate::codec) fn segments(&self, says_resolution: bool) -> Vec<(u8, Vec<u8>)> {
        let exif = self
            .exif_block(says_resolution)
            .map(|block| (APP1, [&b"Exif\0\0"[..], &block].concat()));
        let xmp = self.xmp().map(|xmp| (APP1, [XMP_IN_JPEG, xmp].concat()));
        let texts = self
            .source
            .texts
            .iter()
            .filter_map(comment_of)
            .chain(self.source.comments.iter().map(|comment| &**comment));
        let comments = texts
            .filter(|_| !self.colour_only)
            .map(|text| (COM, text[..text.len().min(MOST_IN_SEGMENT)].to_vec()));
        exif.into_iter().chain(xmp).chain(comments).collect()
    }

    /// Adds the tags to the main directory of a TIFF; `pointers`: what [`Self::put_below_page`] has
    /// returned.
    pub(in crate::codec) fn put_tags(
        &self,
        grey: bool,
        pointers: &[(u16, u32)],
        directory: &mut DirectoryWriter<'_>,
    ) {
        if let Some(exif) = self.exif() {
            exif.put_main(directory);
        }
        pointers
            .iter()
            .for_each(|(tag, at)| directory.long(*tag, *at));
        if let Some(xmp) = self.xmp() {
            directory.entry(700, BYTE, xmp.len(), xmp);
        }
        if let Some(icc) = self.profile(grey).map(Profile::icc) {
            directory.entry(34_675, UNDEFINED, icc.len(), icc);
        }
    }

    /// Appends the directories below the main one to a TIFF.
    pub(in crate::codec) fn put_below_page(
        &self,
        out: &mut Vec<u8>,
        start: usize,
    ) -> Vec<(u16, u32)> {
        self.exif()
            .map_or_else(Vec::new, |exif| exif.put_below_page(out, start))
    }

    /// Adds the resolution to a TIFF, which must state one: without a known one, square pixels of
    /// no size.
    pub(in crate::codec) fn put_resolution(
        this: Option<&Self>,
        directory: &mut DirectoryWriter<'_>,
    ) {
        let known = this.and_then(Self::resolution_in_tags);
        exif::put_resolution(known.unwrap_or(Resolution::SQUARE), directory);
    }

    /// Upper bound of what these metadata add to a file, bytes.
    pub(in crate::codec) fn most_bytes(&self) -> u64 {
        2 * self.source.bytes() as u64 + exif::MOST_BYTES as u64
    }
}

/// The text of a PNG's comment, if it is one that is not compressed.
fn comment_of((kind, data): &KeptChunk) -> Option<&[u8]> {
    let text = data.strip_prefix(COMMENT)?;
    match kind {
        b"tEXt" => Some(text),
        // Not compressed; behind the language and the translated keyword.
        b"iTXt" => {
            let mut parts = text.strip_prefix(&[0, 0])?.splitn(3, |byte| *byte == 0);
            parts.nth(2)
        }
        _ => None,
    }
}

/// A comment as a text of PNG: Latin-1, or UTF-8.
fn text_of(comment: &[u8]) -> PngChunk<Vec<u8>> {
    // A zero byte would end it.
    let text: Vec<u8> = comment.iter().copied().filter(|byte| *byte != 0).collect();
    if !text.is_ascii() && std::str::from_utf8(&text).is_ok() {
        return (*b"iTXt", [COMMENT, &[0; 4], &text].concat());
    }
    (*b"tEXt", [COMMENT, &text].concat())
}
