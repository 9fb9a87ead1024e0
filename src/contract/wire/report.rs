//! `POST /report` and `/sessions/{id}/report`: the request without an image, and the response.

use mlswarp::deform::Class;
use mlswarp::geometry::{FoldRegions, Orientation, Point, Summary};
use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    Alignment, CoordinateFrame, Quality, RemovedFolds, RoundTrip, ToleranceQuality,
};
use serde::ser::{Serialize, SerializeMap, Serializer};

use super::{AsJson, EXTENT, WarningEntry, WarpObject, WarpPatch, fields, json, size};
use crate::problem::Problem;

/// Longest text of a number and its comma, bytes.
const NUMBER_TEXT: usize = 25;
/// The names and the single numbers of a response, bytes.
const FIXED_TEXT: usize = 2048;

/// The body of `/report`: a warp object with `q`, and the extent of the picture.
#[derive(Clone, Debug, PartialEq)]
pub struct ReportObject {
    /// The warp object.
    pub warp: WarpObject,
    /// The extent `[W, H]`.
    pub extent: Extent,
}

impl ReportObject {
    /// Reads the object. `q` may be absent if there is no `p`.
    pub(super) fn parse(json: &[u8]) -> Result<Self, Problem> {
        let root = json::root(json)?;
        let [warp @ .., extent] = root.fields(&fields::WARP_WITH_EXTENT)?;
        let warp = WarpPatch::read_all(warp)?.into_object()?;
        let extent = size(&extent.ok_or_else(|| root.missing("extent", EXTENT))?)?;
        warp.posed()?;
        Ok(Self { warp, extent })
    }
}

/// The response of `/report`.
#[derive(Debug)]
pub struct ReportAnswer<'a> {
    /// The figures.
    pub quality: &'a Quality,
    /// How q was aligned, if that was requested.
    pub alignment: Option<Alignment>,
    /// Those of the header `Warp-Warning`, with their figures.
    pub warnings: &'a [WarningEntry],
    /// The picture that the output asks for, in px; `None` if `fit` has nothing to show. Boxes are
    /// in its frame.
    pub picture: Option<CoordinateFrame>,
}

impl ReportAnswer<'_> {
    /// Upper bound of its JSON, bytes.
    #[must_use]
    pub fn text_bytes(&self) -> usize {
        let Quality {
            residuals,
            folds,
            coincident,
            ..
        } = self.quality;
        let groups: usize = coincident.iter().map(|group| group.handles.len() + 8).sum();
        let warnings: usize = self.warnings.iter().map(WarningEntry::text_bytes).sum();
        FIXED_TEXT + warnings + NUMBER_TEXT * (residuals.len() + 4 * folds.boxes.len() + groups)
    }
}

// Numbers that are not finite become `null`.
impl Serialize for ReportAnswer<'_> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let Quality {
            residuals,
            folds,
            removed,
            orientation,
            distortion,
            canvas,
            covered,
            tolerance,
            coincident,
            round_trip,
        } = self.quality;
        let picture = self.picture;
        let mut object = s.serialize_map(Some(15))?;
        object.serialize_entry("residuals", residuals)?;
        object.serialize_entry("folds", &AsJson((folds, *removed, picture)))?;
        object.serialize_entry("mirrored", &(*orientation == Orientation::Mirrored))?;
        object.serialize_entry("area_factor", &distortion.area_factor.map(AsJson))?;
        object.serialize_entry("shear", &distortion.shear.map(AsJson))?;
        object.serialize_entry("canvas", &canvas.map(AsJson))?;
        object.serialize_entry("width", &picture.map(|picture| picture.image().width()))?;
        object.serialize_entry("height", &picture.map(|picture| picture.image().height()))?;
        object.serialize_entry("scale", &picture.map(|picture| picture.scale()))?;
        object.serialize_entry("covered", covered)?;
        object.serialize_entry("tolerance", &tolerance.map(AsJson))?;
        object.serialize_entry("coincident", &AsJson(coincident.as_slice()))?;
        object.serialize_entry("round_trip", &AsJson(*round_trip))?;
        object.serialize_entry("align", &self.alignment.map(AsJson))?;
        object.serialize_entry("warnings", self.warnings)?;
        object.end()
    }
}

/// Folds, with boxes in the frame of a picture.
impl Serialize for AsJson<(&FoldRegions, Option<RemovedFolds>, Option<CoordinateFrame>)> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let (
            FoldRegions {
                cells,
                share,
                regions,
                boxes,
            },
            removed,
            picture,
        ) = self.0;
        let corner = |x, y| {
            picture.map_or(Point::new(x, y), |picture| {
                picture.from_plane(Point::new(x, y))
            })
        };
        let shown = |[left, top, right, bottom]: &[f64; 4]| {
            let (first, last) = (corner(*left, *top), corner(*right, *bottom));
            [first.x, first.y, last.x, last.y]
        };
        let boxes: Vec<[f64; 4]> = boxes.iter().map(shown).collect();
        let mut object = s.serialize_map(Some(4 + usize::from(removed.is_some())))?;
        object.serialize_entry("cells", cells)?;
        object.serialize_entry("share", share)?;
        object.serialize_entry("regions", regions)?;
        object.serialize_entry("boxes", &boxes)?;
        if let Some(removed) = removed {
            object.serialize_entry("removed", &AsJson(removed))?;
        }
        object.end()
    }
}

impl Serialize for AsJson<RemovedFolds> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let RemovedFolds {
            factors,
            cells,
            mended,
        } = self.0;
        let mut object = s.serialize_map(Some(3))?;
        object.serialize_entry("factors", &factors)?;
        object.serialize_entry("cells", &cells)?;
        object.serialize_entry("mended", &mended)?;
        object.end()
    }
}

impl Serialize for AsJson<Summary> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let Summary { min, median, max } = self.0;
        let mut object = s.serialize_map(Some(3))?;
        object.serialize_entry("min", &min)?;
        object.serialize_entry("median", &median)?;
        object.serialize_entry("max", &max)?;
        object.end()
    }
}

impl Serialize for AsJson<ToleranceQuality> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let ToleranceQuality { px, exceeded } = self.0;
        let mut object = s.serialize_map(Some(3))?;
        object.serialize_entry("px", &px)?;
        object.serialize_entry("met", &(exceeded == 0))?;
        object.serialize_entry("exceeded", &exceeded)?;
        object.end()
    }
}

impl Serialize for AsJson<Alignment> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let class = match self.0.class {
            Class::Translation => "translation",
            Class::Rigid => "rigid",
            Class::Similarity => "similarity",
            Class::Affine => "affine",
        };
        let mut object = s.serialize_map(Some(2))?;
        object.serialize_entry("class", class)?;
        object.serialize_entry("matrix", &self.0.map.matrix())?;
        object.end()
    }
}

impl Serialize for AsJson<RoundTrip> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let RoundTrip {
            positions,
            in_folds,
            missing,
            distance,
        } = self.0;
        let mut object = s.serialize_map(Some(5))?;
        object.serialize_entry("positions", &positions)?;
        object.serialize_entry("in_folds", &in_folds)?;
        object.serialize_entry("missing", &missing)?;
        object.serialize_entry("median", &distance.map(|distance| distance.median))?;
        object.serialize_entry("max", &distance.map(|distance| distance.max))?;
        object.end()
    }
}
