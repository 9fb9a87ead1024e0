//! Objects of another kind that people send: annotations, landmark files, answers of other routes. They are known by their members, so
//! what is said about them is about this object, and not about one of its fields.

use super::json::{Kind, Node};
use crate::problem::words::quote;

/// The types of GeoJSON (RFC 7946, section 1.4) with the member that each has.
const GEOJSON: [(&str, &str); 9] = [
    ("FeatureCollection", "features"),
    ("Feature", "geometry"),
    ("Point", "coordinates"),
    ("MultiPoint", "coordinates"),
    ("LineString", "coordinates"),
    ("MultiLineString", "coordinates"),
    ("Polygon", "coordinates"),
    ("MultiPolygon", "coordinates"),
    ("GeometryCollection", "geometries"),
];
/// The members of other kinds, with what they are and where they go. A kind has all of its members.
const KINDS: [(&[&str], &str); 6] = [
    (
        &["p", "format", "units"],
        "an answer of POST /landmarks: send its `p`, `q` and `units` alone, or the file as landmarks (the part `landmarks`, or --landmarks FILE)",
    ),
    (&["best", "candidates"], "an answer of /fit: the fields of its `best` (`method`, `alpha`, `smoothing`) are those of a warp object"),
    (&["id", "image", "p", "seq"], "the object of a session: a warp object has its `p`, `method`, `alpha`, `units` and `output`, and `q`"),
    (
        &["images", "annotations", "categories"],
        "a COCO file: send its keypoints as `points` and its boxes as `boxes`, [left, top, right, bottom], to POST /points",
    ),
    (&["shapes", "imagePath"], "a labelme file: send it as landmarks (the part `landmarks`, or --landmarks FILE)"),
    (&["type", "Landmarks"], "a BigWarp file: send it as landmarks (the part `landmarks`, or --landmarks FILE)"),
];

/// What an object is that has fields other than the `known` ones, and where it goes.
pub(super) fn recognised(object: &Node<'_, '_>, known: &[&str]) -> Option<String> {
    let value = |wanted: &str| object.pairs().find(|(name, _)| name.trim_matches('"') == wanted).map(|(_, value)| value);
    let text = |name: &str| value(name).and_then(|value| value.strip_prefix('"')?.strip_suffix('"'));
    if let Some((name, _)) = GEOJSON.iter().find(|(name, member)| text("type") == Some(name) && value(member).is_some()) {
        let place = if known.contains(&"geojson") { "put it in `geojson`" } else { "POST /points maps it, in the field `geojson`" };
        return Some(format!("this is GeoJSON, a {name}: {place}"));
    }
    if let (Some(code), Some(detail), Some(_)) = (text("code"), text("detail"), value("title")) {
        return Some(format!("this is an error of an earlier request, {}: {}", quote(code), quote(detail)));
    }
    let has =
        |members: &[&str]| members.iter().all(|member| value(member).is_some()) && !members.iter().all(|member| known.contains(member));
    KINDS.iter().find(|(members, _)| has(members)).map(|(_, what)| format!("this is {what}"))
}

/// A hint to follow the kind of a value that is not an object.
pub(super) fn of_list(list: &Node<'_, '_>) -> &'static str {
    let mut hint = "";
    let _ = list.items::<crate::problem::Problem>("", |index, item| {
        hint = match (index, item.kind()) {
            (0, Kind::Array) => "; handles are {\"p\": [...], \"q\": [...]}",
            (0, Kind::Object) if recognised(&item, &[]).is_some_and(|what| what.contains("GeoJSON")) => {
                "; GeoJSON goes in the field `geojson`, a list of features as {\"type\": \"FeatureCollection\", \"features\": [...]}"
            }
            _ => return Err(item.wrong_kind("")),
        };
        Ok(())
    });
    hint
}

#[cfg(test)]
mod tests {
    use super::super::fields::{FIT, WARP, WARP_WITH_POINTS};
    use super::super::json;

    fn told(text: &str, known: &[&str]) -> String {
        super::recognised(&json::value(text).unwrap(), known).unwrap_or_default()
    }

    #[test]
    fn files_and_answers_of_other_kinds_are_recognised() {
        for (text, says) in [
            (r#"{"type": "FeatureCollection", "features": []}"#, "GeoJSON, a FeatureCollection"),
            (r#"{"p": [], "type": "Feature", "geometry": null}"#, "GeoJSON, a Feature"),
            (r#"{"type": "Polygon", "coordinates": []}"#, "GeoJSON, a Polygon"),
            (r#"{"p": [], "names": ["a"], "units": "px", "format": "csv"}"#, "an answer of POST /landmarks"),
            (r#"{"best": {}, "candidates": []}"#, "an answer of /fit"),
            (r#"{"id": "x", "image": {}, "p": [], "seq": null, "grid": {}}"#, "the object of a session"),
            (r#"{"images": [], "annotations": [], "categories": []}"#, "a COCO file"),
            (r#"{"version": "5", "shapes": [], "imagePath": "a.png"}"#, "a labelme file"),
            (r#"{"type": "BigWarpLandmarks", "Landmarks": []}"#, "a BigWarp file"),
            (r#"{"title": "T", "code": "bad_value", "detail": "`q` is missing"}"#, "an error of an earlier request, `bad_value`"),
        ] {
            assert!(told(text, &WARP).contains(says), "{text}: {}", told(text, &WARP));
        }
        for plain in [r#"{"p": [], "format": "png"}"#, r#"{"type": "tps", "p": []}"#, r#"{"type": "Point"}"#, r#"{"best": 1}"#, "{}"] {
            assert_eq!(told(plain, &WARP), "", "{plain}");
        }
        assert!(told(r#"{"type": "Feature", "geometry": 1}"#, &WARP_WITH_POINTS).ends_with("put it in `geojson`"));
        assert_eq!(told(r#"{"p": [], "candidates": []}"#, &FIT), "");
    }
}
