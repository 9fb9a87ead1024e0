//! Georeference Annotations of IIIF, JSON:
//! `{"type": "Annotation", "body": {"features": [{"properties":
//! {"resourceCoords": [x, y]}, ...}]}}`,
//! or several as the `items` of an `AnnotationPage`. The positions in the picture are read, as one
//! side, as those of QGIS; longitude and latitude are not. An annotation is an item, named by its
//! id and its label.
//!
//! Source: IIIF, "Georeference Extension" ("pixelCoords" before it was published). Positions are
//! pixels of the whole picture, whose upper left corner is 0, 0, as in the contract: nothing is
//! added.

use super::bad::{Bad, BadJson};
use super::collect::Collector;
use super::item::name_in;
use super::json::ObjectMembers;
use super::{Format, FormatReader, offset};
use crate::wire::handles::{PLACE, place};
use crate::wire::json::{Kind, Node, optional};

pub(super) const FORMAT: Format = Format {
    name: "iiif",
    title: "IIIF georeference",
    items: "annotations",
    form: FormatReader::Json(is_iiif, read),
};
const ITEMS: &str = "an array of annotations";
const FEATURES: &str = "an array of control points, GeoJSON features";

fn is_iiif(fields: &ObjectMembers<'_>) -> bool {
    let has = |name: &str, kind| fields.kind(name) == Some(kind);
    !fields.is_list
        && (has("body", Kind::Object) && (fields.has("target") || fields.has("type"))
            || has("items", Kind::Array) && fields.has("type"))
}

fn read(text: &str, root: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    let [items, body] = root.find(&["items", "body"])?;
    match (items, body) {
        (Some(items), None) => items.items::<BadJson>(ITEMS, |_, item| {
            let [body] = item.find(&["body"])?;
            let body = body
                .ok_or_else(|| item.missing("body", "a FeatureCollection with control points"))?;
            annotation(text, &item, &body, out)
        })?,
        (_, Some(body)) => annotation(text, root, &body, out)?,
        (None, None) => {}
    }
    Ok(offset(text, root))
}

fn annotation(
    text: &str,
    item: &Node<'_, '_>,
    body: &Node<'_, '_>,
    out: &mut Collector,
) -> Result<(), BadJson> {
    let [id, label] = item.find(&["id", "label"])?;
    // A label may also be an object with languages.
    let name = |node: Option<Node<'_, '_>>| {
        optional(node.filter(|node| node.kind() == Kind::String), name_in)
            .map(Option::unwrap_or_default)
    };
    if !out.item(offset(text, item), &[&name(id)?, &name(label)?])? {
        return Ok(());
    }
    let [features] = body.find(&["features"])?;
    let features = features.ok_or_else(|| body.missing("features", FEATURES))?;
    features.items::<BadJson>(FEATURES, |_, feature| {
        let at = offset(text, &feature);
        let [properties] = feature.find(&["properties"])?;
        let [new, old] = properties
            .as_ref()
            .map(|properties| properties.find(&["resourceCoords", "pixelCoords"]))
            .transpose()?
            .unwrap_or_default();
        let missing = || {
            Bad::new(
                at,
                "expected `resourceCoords` in the properties of a control \
            point, its pixel [x, y]; it is missing",
            )
        };
        let position = place(&new.or(old).ok_or_else(missing)?, PLACE)?;
        Ok(out.point(at, Some([position.x, position.y]), None)?)
    })
}
