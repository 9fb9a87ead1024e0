//! EXIF (2.32, section 4.6; 3.0): what a file says about its making, kept tag by tag. Left out is
//! what describes the stored pixels and would be wrong of others: orientation, size, thumbnail,
//! subject area; and the resolution, which the writers state again. Maker's notes stay at their
//! place in the block, because many have offsets from its beginning; those with an image in them
//! are dropped. Memory: at most [`MOST_BYTES`], whatever the directories claim, and as much work.

use std::borrow::Cow;
use std::ops::RangeInclusive;

use super::resolution::{Resolution, ResolutionUnit};
use super::{Dropped, DroppedKind};
use crate::codec::StepCounter;
use crate::codec::ifd::read::{Directory, Entry, File};
use crate::codec::ifd::write::{DirectoryWriter, UNDEFINED, offset};

/// The largest block that is kept, below what a segment of a JPEG holds.
pub(super) const MOST_BYTES: usize = 65_000;
/// Header, ends of the directories, and the entries that are added.
const FRAME_BYTES: usize = 256;
/// An entry in a directory.
const ENTRY_BYTES: usize = 12;

const EXIF: u16 = 0x8769;
const GPS: u16 = 0x8825;
const INTEROPERABILITY: u16 = 0xA005;
const MAKER_NOTE: u16 = 0x927C;
/// Microsoft's room for more.
const PADDING: u16 = 0xEA1C;

/// Tags of the main directory of a block that describe the stored pixels, or that have a carrier of
/// their own.
const OF_PIXELS: [RangeInclusive<u16>; 12] = [
    254..=259,
    262..=266,
    273..=274,
    277..=284,
    288..=296,
    317..=317,
    320..=330,
    338..=347,
    512..=521,
    700..=700,
    33_723..=34_675,
    PADDING..=PADDING,
];
/// Those of the EXIF directory: size, subject area and location.
const OF_PICTURE: [u16; 6] = [0xA002, 0xA003, 0x9214, 0xA214, INTEROPERABILITY, PADDING];
/// Tags of a page of a TIFF that describe what it shows: document, description, maker and model,
/// page, software, date, artist, computer, copyright, rating, and those of Windows.
const OF_PAGE: [RangeInclusive<u16>; 8] = [
    269..=272,
    285..=285,
    305..=306,
    315..=316,
    18_246..=18_246,
    18_249..=18_249,
    33_432..=33_432,
    40_091..=40_095,
];
const DESCRIPTION: u16 = 270;

/// The kept tags of a file.
#[derive(Debug)]
pub(super) struct Exif {
    little: bool,
    pool: Vec<u8>,
    main: Vec<Tag>,
    exif: Vec<Tag>,
    gps: Vec<Tag>,
    interoperability: Vec<Tag>,
    maker_note: Option<MakerNote>,
}

/// A tag; its values are in the pool.
#[derive(Clone, Copy, Debug)]
struct Tag {
    tag: u16,
    kind: u16,
    count: u32,
    at: u32,
    length: u32,
}

/// A maker's note, and where it begins in its block.
#[derive(Debug)]
struct MakerNote {
    at: usize,
    data: Box<[u8]>,
}

impl Exif {
    /// Reads a block: a TIFF header, with or without the prefix `Exif\0\0` of JPEG. Returns its
    /// resolution too.
    pub(super) fn of_block(
        block: &[u8],
        dropped: &mut Dropped,
        work: &StepCounter<'_>,
    ) -> (Option<Self>, Option<Resolution>) {
        let block = block.strip_prefix(b"Exif\0\0").unwrap_or(block);
        let main = (block.len() <= 2 * MOST_BYTES)
            .then(|| File::new(block))
            .flatten()
            .and_then(|file| file.first().ok());
        let Some(main) = main else {
            dropped.add(DroppedKind::Exif);
            return (None, None);
        };
        let resolution = main.resolution(work).ok().flatten();
        let is_kept = |entry: &Entry<'_>| !OF_PIXELS.iter().any(|range| range.contains(&entry.tag));
        (Self::read(&main, is_kept, dropped, work), resolution)
    }

    /// Reads the page of a TIFF.
    pub(super) fn of_page(
        page: &Directory<'_>,
        dropped: &mut Dropped,
        work: &StepCounter<'_>,
    ) -> Option<Self> {
        // Of a description that states the shape of the stored array, nothing would be true.
        let states_shape = |entry: &Entry<'_>| {
            entry.tag == DESCRIPTION
                && (entry.data.starts_with(b"{\"shape\"") || is_ome(entry.data))
        };
        let is_kept = |entry: &Entry<'_>| {
            OF_PAGE.iter().any(|range| range.contains(&entry.tag)) && !states_shape(entry)
        };
        Self::read(page, is_kept, dropped, work)
    }

    fn read(
        main: &Directory<'_>,
        is_kept: impl Fn(&Entry<'_>) -> bool,
        dropped: &mut Dropped,
        work: &StepCounter<'_>,
    ) -> Option<Self> {
        let file = main.file;
        let below = |directory: &Directory<'_>, tag: u16| {
            let values = directory.values(tag, work).ok().flatten()?;
            file.directory(usize::try_from(values.get(0)?).ok()?).ok()
        };
        let exif = below(main, EXIF);
        let gps = below(main, GPS);
        let interoperability = exif.as_ref().and_then(|exif| below(exif, INTEROPERABILITY));
        let mut this = Self {
            little: file.little,
            pool: Vec::new(),
            main: Vec::new(),
            exif: Vec::new(),
            gps: Vec::new(),
            interoperability: Vec::new(),
            maker_note: None,
        };
        let mut bytes = FRAME_BYTES;
        let mut gather = |directory: Option<&Directory<'_>>,
                          is_kept: &dyn Fn(&Entry<'_>) -> bool| {
            let mut tags = Vec::new();
            // Types of BigTIFF have no place in a block.
            let entries = directory
                .into_iter()
                .flat_map(Directory::entries)
                .filter(|entry| !(16..=18).contains(&entry.kind));
            for entry in entries.filter(is_kept) {
                work.step(1).ok()?;
                bytes += ENTRY_BYTES + entry.data.len() + 1;
                if bytes > MOST_BYTES {
                    return None;
                }
                let (at, length) = (offset(this.pool.len()), offset(entry.data.len()));
                let count = u32::try_from(entry.count).ok()?;
                this.pool.extend_from_slice(entry.data);
                tags.push(Tag {
                    tag: entry.tag,
                    kind: entry.kind,
                    count,
                    at,
                    length,
                });
            }
            Some(tags)
        };
        let gathered = (|| {
            let main = gather(Some(main), &|entry| {
                is_kept(entry) && !matches!(entry.tag, EXIF | GPS)
            })?;
            let exif = gather(exif.as_ref(), &|entry| {
                !OF_PICTURE.contains(&entry.tag) && entry.tag != MAKER_NOTE
            })?;
            Some((
                main,
                exif,
                gather(gps.as_ref(), &|_| true)?,
                gather(interoperability.as_ref(), &|entry| entry.tag <= 2)?,
            ))
        })();
        let Some((main, own, gps, interoperability)) = gathered else {
            dropped.add(DroppedKind::Exif);
            return None;
        };
        this = Self {
            main,
            exif: own,
            gps,
            interoperability,
            ..this
        };
        if let Some(note) = exif.and_then(|exif| exif.entry(MAKER_NOTE, work).ok().flatten()) {
            let has_picture = note
                .data
                .windows(3)
                .any(|bytes| bytes == [0xFF, 0xD8, 0xFF]);
            if has_picture
                || note.at < 8
                || note.data.len() <= 4
                || note.at + note.data.len() + bytes > MOST_BYTES
            {
                dropped.add(DroppedKind::MakerNote);
            } else {
                this.maker_note = Some(MakerNote {
                    at: note.at,
                    data: note.data.into(),
                });
            }
        }
        let is_empty = [&this.main, &this.exif, &this.gps]
            .into_iter()
            .all(Vec::is_empty)
            && this.maker_note.is_none();
        (!is_empty).then_some(this)
    }

    /// Memory held, bytes.
    pub(super) fn bytes(&self) -> usize {
        let tags = [&self.main, &self.exif, &self.gps, &self.interoperability]
            .map(Vec::len)
            .iter()
            .sum::<usize>();
        self.pool.len()
            + tags * size_of::<Tag>()
            + self.maker_note.as_ref().map_or(0, |note| note.data.len())
    }

    pub(super) const fn has_maker_note(&self) -> bool {
        self.maker_note.is_some()
    }

    /// The values of a tag in a byte order.
    fn data(&self, tag: Tag, little: bool) -> Cow<'_, [u8]> {
        let data = &self.pool[tag.at as usize..][..tag.length as usize];
        let width = match tag.kind {
            3 | 8 => 2,
            4 | 5 | 9 | 10 | 11 | 13 => 4,
            12 | 16..=18 => 8,
            _ => 1,
        };
        if width == 1 || little == self.little {
            return Cow::Borrowed(data);
        }
        Cow::Owned(
            data.chunks(width)
                .flat_map(|number| number.iter().rev())
                .copied()
                .collect(),
        )
    }

    fn put(&self, tags: &[Tag], little: bool, directory: &mut DirectoryWriter<'_>) {
        tags.iter().for_each(|tag| {
            directory.entry(
                tag.tag,
                tag.kind,
                tag.count as usize,
                &self.data(*tag, little),
            )
        });
    }

    /// Appends the directories below the main one to the file that begins at `start`; returns their
    /// pointers. `note`: the offset of the maker's note in that file.
    fn put_below(
        &self,
        (out, start): (&mut Vec<u8>, usize),
        little: bool,
        note: Option<[u8; 4]>,
    ) -> Vec<(u16, u32)> {
        let mut pointers = Vec::new();
        let mut below = Vec::new();
        if !self.interoperability.is_empty() {
            let mut directory = DirectoryWriter::of(out, start, little);
            self.put(&self.interoperability, little, &mut directory);
            below.push((INTEROPERABILITY, offset(directory.finish())));
        }
        if !self.exif.is_empty() || !below.is_empty() || note.is_some() {
            let mut directory = DirectoryWriter::of(out, start, little);
            self.put(&self.exif, little, &mut directory);
            below.iter().for_each(|(tag, at)| directory.long(*tag, *at));
            if let (Some(MakerNote { data, .. }), Some(at)) = (&self.maker_note, note) {
                directory.placed(MAKER_NOTE, UNDEFINED, data.len(), at);
            }
            pointers.push((EXIF, offset(directory.finish())));
        }
        if !self.gps.is_empty() {
            let mut directory = DirectoryWriter::of(out, start, little);
            self.put(&self.gps, little, &mut directory);
            pointers.push((GPS, offset(directory.finish())));
        }
        pointers
    }

    /// Appends the directories below the main one to a big-endian TIFF; returns their pointers.
    /// Without the maker's note.
    pub(super) fn put_below_page(&self, out: &mut Vec<u8>, start: usize) -> Vec<(u16, u32)> {
        self.put_below((out, start), false, None)
    }

    /// Adds the tags of the main directory to that of a big-endian TIFF.
    pub(super) fn put_main(&self, directory: &mut DirectoryWriter<'_>) {
        self.put(&self.main, false, directory);
    }
}

/// A block of kept tags and a resolution.
pub(super) fn block(exif: Option<&Exif>, resolution: Option<Resolution>) -> Vec<u8> {
    let little = exif.is_some_and(|exif| exif.little);
    let mut out = if little {
        b"II*\0\0\0\0\0".to_vec()
    } else {
        b"MM\0*\0\0\0\0".to_vec()
    };
    let mut pointers = Vec::new();
    if let Some(exif) = exif {
        let note = exif.maker_note.as_ref().map(|MakerNote { at, data }| {
            out.resize(*at, 0);
            out.extend_from_slice(data);
            if little {
                offset(*at).to_le_bytes()
            } else {
                offset(*at).to_be_bytes()
            }
        });
        pointers = exif.put_below((&mut out, 0), little, note);
    }
    let mut directory = DirectoryWriter::of(&mut out, 0, little);
    if let Some(exif) = exif {
        exif.put(&exif.main, little, &mut directory);
    }
    if let Some(resolution) = resolution {
        put_resolution(resolution, &mut directory);
    }
    pointers
        .iter()
        .for_each(|(tag, at)| directory.long(*tag, *at));
    directory.close();
    out
}

/// Adds the tags of a resolution, in inches, centimetres or an unknown unit.
pub(super) fn put_resolution(resolution: Resolution, directory: &mut DirectoryWriter<'_>) {
    let Resolution { x, y, unit } = resolution;
    directory.ratio(282, x.numerator, x.denominator);
    directory.ratio(283, y.numerator, y.denominator);
    let unit = match unit {
        ResolutionUnit::Unknown => 1,
        ResolutionUnit::Inch => 2,
        ResolutionUnit::Centimetre | ResolutionUnit::Metre => 3,
    };
    directory.short(296, unit);
}

/// Whether a description is that of OME-TIFF, which states size, type and channels of the stored
/// pixels.
pub(in crate::codec) fn is_ome(description: &[u8]) -> bool {
    let head = &description[..description.len().min(1024)];
    head.windows(4).any(|window| window == b"<OME")
}
