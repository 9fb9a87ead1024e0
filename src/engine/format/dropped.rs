//! The kinds of metadata that an output may lack.

/// A kind of metadata.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DroppedKind {
    /// Pixels per unit of length.
    Resolution,
    /// EXIF.
    Exif,
    /// The maker's note of EXIF.
    MakerNote,
    /// An XMP packet.
    Xmp,
    /// Parts of XMP beyond the packet of 64 KiB.
    ExtendedXmp,
    /// IPTC-IIM.
    Iptc,
    /// Paths of Photoshop.
    Paths,
    /// Layers of Photoshop.
    Layers,
    /// Texts with keywords.
    Text,
    /// Comments.
    Comment,
    /// Tags of GeoTIFF and GDAL.
    Georeference,
    /// The description of OME-TIFF.
    OmeXml,
    /// Tags of ImageJ.
    ImageJ,
    /// A page that masks the image.
    Mask,
    /// Images behind the image, such as a gain map.
    FurtherImages,
    /// Content credentials.
    Credentials,
    /// The significant bits of samples.
    SignificantBits,
    /// What samples or pixels measure.
    Calibration,
    /// Data of applications, in chunks, segments, blocks or tags.
    Application,
}

/// Names in reports, in the order of the kinds.
const NAMES: [&str; 19] = [
    "resolution",
    "EXIF",
    "maker note",
    "XMP",
    "extended XMP",
    "IPTC",
    "paths",
    "Photoshop layers",
    "text",
    "comment",
    "GeoTIFF",
    "OME-XML",
    "ImageJ tags",
    "transparency mask",
    "further images",
    "C2PA",
    "significant bits",
    "calibration",
    "application data",
];

/// A set of kinds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Dropped(u32);

impl Dropped {
    /// Adds a kind.
    pub fn add(&mut self, kind: DroppedKind) {
        self.0 |= 1 << kind as u32;
    }

    /// Adds a kind if that is so.
    pub fn add_if(&mut self, is_so: bool, kind: DroppedKind) {
        if is_so {
            self.add(kind);
        }
    }

    /// Whether nothing is dropped.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The names of the kinds.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        NAMES
            .into_iter()
            .enumerate()
            .filter(move |(k, _)| self.0 >> k & 1 == 1)
            .map(|(_, name)| name)
    }
}

impl std::ops::BitOrAssign for Dropped {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_its_name() {
        let mut dropped = Dropped::default();
        assert!(dropped.is_empty());
        dropped.add(DroppedKind::Application);
        dropped.add_if(true, DroppedKind::Exif);
        dropped.add_if(false, DroppedKind::Xmp);
        assert_eq!(
            dropped.names().collect::<Vec<_>>(),
            ["EXIF", "application data"]
        );
        assert_eq!(DroppedKind::Application as usize + 1, NAMES.len());
    }
}
