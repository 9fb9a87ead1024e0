//! What the page of a TIFF says beside its pixels.

use std::borrow::Cow;

use crate::codec::ifd::read::Directory;
use crate::codec::metadata::exif::is_ome;
use crate::codec::metadata::{DroppedKind, Found, photoshop};
use crate::codec::{CodecError, StepCounter};

/// Tags from here on are registered to programs.
const FIRST_PRIVATE_TAG: u16 = 32_768;

/// Collects what is kept, and names what is not; the second result is the colour profile.
/// `has_mask`: whether another page masks the image.
pub(super) fn found<'a>(
    page: Directory<'a>,
    has_mask: bool,
    work: &StepCounter<'_>,
) -> Result<(Found<'a>, Option<&'a [u8]>), CodecError> {
    let resolution = page.resolution(work).unwrap_or_default();
    let mut found = Found {
        page: Some(page),
        resolution,
        ..Found::default()
    };
    let (mut profile, mut has_colour) = (None, false);
    let dropped = &mut found.dropped;
    dropped.add_if(has_mask, DroppedKind::Mask);
    for entry in page.entries() {
        work.step(1)?;
        match entry.tag {
            // Description.
            270 => dropped.add_if(is_ome(entry.data), DroppedKind::OmeXml),
            // Transfer function, white point, primaries.
            301 | 318 | 319 => has_colour = true,
            700 => found.xmp = Some(Cow::Borrowed(entry.data)),
            33_550 | 33_922 | 34_264 | 34_735..=34_737 | 42_112 | 42_113 => {
                dropped.add(DroppedKind::Georeference)
            }
            33_723 => dropped.add(DroppedKind::Iptc),
            34_377 => photoshop::resources(entry.data, dropped, work),
            34_675 => profile = Some(entry.data),
            37_724 => dropped.add(DroppedKind::Layers),
            50_838 | 50_839 => dropped.add(DroppedKind::ImageJ),
            // Copyright, EXIF, GPS and the tags of Windows are kept; the others describe the stored
            // pixels.
            33_432
            | 34_665
            | 34_853
            | 40_091..=40_095
            | 32_781
            | 32_932
            | 32_995..=32_998
            | 0xEA1C
            | 0xEA1D => {}
            FIRST_PRIVATE_TAG.. => dropped.add(DroppedKind::Application),
            _ => {}
        }
    }
    found.colour_dropped = has_colour && profile.is_none();
    Ok((found, profile))
}
