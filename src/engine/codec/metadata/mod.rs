//! What a file says about its image beside the pixels: resolution, colour, EXIF, XMP, texts. A
//! reader collects it as slices of the file ([`Found`]); [`Metadata`] is what is kept, with the
//! memory of an image; [`Carried`] is that of one output. What an output cannot hold is named
//! ([`Dropped`]). Memory: at most [`METADATA_BYTES`] beside the profile.

mod carried;
pub(super) mod exif;
pub(super) mod photoshop;
pub(super) mod png_colour;
pub(super) mod resolution;
mod xmp;

use std::borrow::Cow;

pub use self::carried::Carried;
use self::exif::Exif;
pub use self::resolution::{Ratio, Resolution, ResolutionUnit};
pub(super) use super::DroppedKind;
use super::ifd::read::Directory;
use super::{CodecError, Dropped, Profile, StepCounter};

/// Upper bound of the memory of metadata beside the profile, bytes.
pub const METADATA_BYTES: u64 = 512 << 10;
/// The largest sum of a file's texts or of its comments, bytes.
const MOST_TEXT_BYTES: usize = 64 << 10;
/// The most texts or comments of a file.
const MOST_TEXTS: usize = 256;

/// A PNG chunk: its type and its data.
pub(super) type PngChunk<T> = ([u8; 4], T);
/// The same, kept after its file is gone.
pub(super) type KeptChunk = PngChunk<Box<[u8]>>;

/// What a reader has found in a file.
#[derive(Clone, Debug, Default)]
pub(super) struct Found<'a> {
    pub(super) exif: Option<&'a [u8]>,
    /// The page of a TIFF, whose tags are those of EXIF.
    pub(super) page: Option<Directory<'a>>,
    pub(super) xmp: Option<Cow<'a, [u8]>>,
    /// That of the format itself.
    pub(super) resolution: Option<Resolution>,
    /// Chunks of PNG that say what the numbers mean.
    pub(super) colour: Vec<PngChunk<&'a [u8]>>,
    /// Texts of PNG.
    pub(super) texts: Vec<PngChunk<&'a [u8]>>,
    pub(super) comments: Vec<Cow<'a, [u8]>>,
    pub(super) dropped: Dropped,
    /// Whether it says about colour what is not kept.
    pub(super) colour_dropped: bool,
}

impl<'a> Found<'a> {
    pub(super) fn add_text(&mut self, kind: [u8; 4], data: &'a [u8]) {
        if has_room(self.texts.iter().map(|text| text.1.len()), data.len()) {
            self.texts.push((kind, data));
        } else {
            self.dropped.add(DroppedKind::Text);
        }
    }

    pub(super) fn add_comment(&mut self, comment: Cow<'a, [u8]>) {
        if has_room(
            self.comments.iter().map(|comment| comment.len()),
            comment.len(),
        ) {
            self.comments.push(comment);
        } else {
            self.dropped.add(DroppedKind::Comment);
        }
    }
}

/// Whether `more` bytes fit beside texts of these lengths.
fn has_room(lengths: impl ExactSizeIterator<Item = usize>, more: usize) -> bool {
    lengths.len() < MOST_TEXTS && lengths.sum::<usize>() + more <= MOST_TEXT_BYTES
}

/// The metadata of a file, as far as they are kept.
#[derive(Debug, Default)]
pub struct Metadata {
    resolution: Option<Resolution>,
    profile: Option<Profile>,
    colour: Vec<KeptChunk>,
    /// Whether only the chunks say what the numbers mean, and it is not sRGB.
    needs_chunks: bool,
    exif: Option<Exif>,
    xmp: Option<Vec<u8>>,
    texts: Vec<KeptChunk>,
    comments: Vec<Box<[u8]>>,
    dropped: Dropped,
    profile_dropped: bool,
}

impl Metadata {
    /// Keeps what was found. `icc`: whether the file has a profile, and the one that is kept;
    /// `swaps`: whether the upright image has the sides of the stored one swapped.
    ///
    /// # Errors
    /// [`CodecError::Cancelled`].
    pub(super) fn new(
        found: &Found<'_>,
        (has_icc, icc): (bool, Option<&[u8]>),
        swaps: bool,
        work: &StepCounter<'_>,
    ) -> Result<Self, CodecError> {
        let mut dropped = found.dropped;
        let (of_block, of_exif) = found.exif.map_or((None, None), |exif| {
            Exif::of_block(exif, &mut dropped, work)
        });
        let of_page = found
            .page
            .as_ref()
            .and_then(|page| Exif::of_page(page, &mut dropped, work));
        let xmp = found.xmp.as_deref().and_then(xmp::kept);
        dropped.add_if(found.xmp.is_some() && xmp.is_none(), DroppedKind::Xmp);
        // A format's own resolution without a unit is the shape of a pixel, and one of whole
        // numbers may be rounded; EXIF may have more.
        let own = found.resolution.filter(|own| {
            own.unit != ResolutionUnit::Unknown && !of_exif.is_some_and(|exif| own.is_rounded(exif))
        });
        let resolution = own.or(of_exif).or(found.resolution);
        work.check()?;
        Ok(Self {
            resolution: resolution.map(|stored| if swaps { stored.swapped() } else { stored }),
            profile: icc.map(Profile::new),
            colour: found
                .colour
                .iter()
                .map(|(kind, data)| (*kind, (*data).into()))
                .collect(),
            needs_chunks: !png_colour::is_srgb(&found.colour, icc.is_some()),
            exif: of_page.or(of_block),
            xmp,
            texts: found
                .texts
                .iter()
                .map(|(kind, data)| (*kind, (*data).into()))
                .collect(),
            comments: found
                .comments
                .iter()
                .map(|comment| comment.as_ref().into())
                .collect(),
            dropped,
            profile_dropped: found.colour_dropped || has_icc && icc.is_none(),
        })
    }

    /// Pixels per unit of length of the upright image.
    #[must_use]
    pub const fn resolution(&self) -> Option<Resolution> {
        self.resolution
    }

    /// The ICC profile, which describes grey if the file has one sample for the three colours, and
    /// RGB otherwise.
    #[must_use]
    pub fn icc(&self) -> Option<&[u8]> {
        self.profile.as_ref().map(Profile::icc)
    }

    /// Whether the file says about colour what is not kept.
    #[must_use]
    pub const fn profile_dropped(&self) -> bool {
        self.profile_dropped
    }

    /// What of the file is kept in no output.
    #[must_use]
    pub const fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Memory held, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let chunks = |chunks: &[PngChunk<Box<[u8]>>]| {
            chunks
                .iter()
                .map(|(_, data)| data.len() + size_of::<PngChunk<Box<[u8]>>>())
                .sum::<usize>()
        };
        let comments = self
            .comments
            .iter()
            .map(|comment| comment.len() + size_of::<Box<[u8]>>())
            .sum::<usize>();
        let packets =
            self.xmp.as_ref().map_or(0, Vec::len) + self.exif.as_ref().map_or(0, Exif::bytes);
        self.profile.as_ref().map_or(0, Profile::bytes)
            + chunks(&self.colour)
            + chunks(&self.texts)
            + comments
            + packets
    }
}
