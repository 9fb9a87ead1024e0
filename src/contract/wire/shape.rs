//! Objects of another kind that people send: annotations, landmark files, answers of other routes.
//! They are known by their members, so what is said about them is about this object, and not about
//! one of its fields.

use crate::problem::words::quote;

/// The members of an object: each name, in its quotes, and its value, as they are written.
pub(super) type Members<'j> = [(&'j str, &'j str)];

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
const KINDS: [(&[&str], &str); 5] = [
    (
        &["best", "candidates"],
        "an answer of /fit: the fields of its `best` (`method`, `alpha`, `smoothing`) are those \
            of a warp object",
    ),
    (
        &["id", "image", "p", "seq"],
        "the object of a session: a warp object has its `p`, `method`, `alpha`, `units` and \
            `output`, and `q`",
    ),
    (
        &["images", "annotations", "categories"],
        "a COCO file: send it as landmarks (the part `landmarks`, or --landmarks FILE), or its \
            boxes as `boxes`, [left, top, right, bottom], to POST /points",
    ),
    (
        &["shapes", "imagePath"],
        "a labelme file: send it as landmarks (the part `landmarks`, or --landmarks FILE)",
    ),
    (
        &["type", "Landmarks"],
        "a BigWarp file: send it as landmarks (the part `landmarks`, or --landmarks FILE)",
    ),
];

fn value<'j>(members: &Members<'j>, wanted: &str) -> Option<&'j str> {
    members
        .iter()
        .find(|(name, _)| name.trim_matches('"') == wanted)
        .map(|(_, value)| *value)
}

fn text<'j>(members: &Members<'j>, name: &str) -> Option<&'j str> {
    value(members, name)?.strip_prefix('"')?.strip_suffix('"')
}

/// The type of an object that is GeoJSON.
pub(super) fn geojson(members: &Members<'_>) -> Option<&'static str> {
    let kind = text(members, "type")?;
    let has = |(name, member): &&(&str, &str)| kind == *name && value(members, member).is_some();
    GEOJSON.iter().find(has).map(|(name, _)| *name)
}

/// What an object is that has fields other than the `known` ones, and where it goes.
pub(super) fn recognised(members: &Members<'_>, known: &[&str]) -> Option<String> {
    if let Some(name) = geojson(members) {
        let place = if known.contains(&"geojson") {
            "put it in `geojson`"
        } else {
            "POST /points maps it, in the field `geojson`"
        };
        return Some(format!("this is GeoJSON, a {name}: {place}"));
    }
    if let (Some(code), Some(detail), Some(_)) = (
        text(members, "code"),
        text(members, "detail"),
        value(members, "title"),
    ) {
        return Some(format!(
            "this is an error of an earlier request, {}: {}",
            quote(code),
            quote(detail)
        ));
    }
    // With a format of pictures, `format` is a field in the wrong place.
    let is_picture = |format: &str| mlswarp::format::source_extensions().any(|end| end == format);
    if text(members, "format").is_some_and(is_picture) {
        return None;
    }
    let has = |wanted: &[&str]| wanted.iter().all(|name| value(members, name).is_some());
    let is_new = |wanted: &[&str]| wanted.iter().any(|name| !known.contains(name));
    KINDS
        .iter()
        .find(|(wanted, _)| has(wanted) && is_new(wanted))
        .map(|(_, what)| format!("this is {what}"))
}

#[cfg(test)]
mod tests {
    use super::super::fields::{FIT, WARP, WARP_WITH_POINTS};
    use super::super::json;

    fn told(text: &str, known: &[&str]) -> String {
        super::recognised(&json::value(text).unwrap().members(), known).unwrap_or_default()
    }

    #[test]
    fn files_and_answers_of_other_kinds_are_recognised() {
        for (text, says) in [
            (
                r#"{"type": "FeatureCollection", "features": []}"#,
                "GeoJSON, a FeatureCollection",
            ),
            (
                r#"{"p": [], "type": "Feature", "geometry": null}"#,
                "GeoJSON, a Feature",
            ),
            (
                r#"{"type": "Polygon", "coordinates": []}"#,
                "GeoJSON, a Polygon",
            ),
            (r#"{"best": {}, "candidates": []}"#, "an answer of /fit"),
            (
                r#"{"id": "x", "image": {}, "p": [], "seq": null, "grid": {}}"#,
                "the object of a session",
            ),
            (
                r#"{"images": [], "annotations": [], "categories": []}"#,
                "a COCO file",
            ),
            (
                r#"{"version": "5", "shapes": [], "imagePath": "a.png"}"#,
                "a labelme file",
            ),
            (
                r#"{"type": "BigWarpLandmarks", "Landmarks": []}"#,
                "a BigWarp file",
            ),
            (
                r#"{"title": "T", "code": "bad_value", "detail": "`q` is missing"}"#,
                "an error of an earlier request, `bad_value`",
            ),
        ] {
            assert!(
                told(text, &WARP).contains(says),
                "{text}: {}",
                told(text, &WARP)
            );
        }
        for plain in [
            r#"{"p": [], "units": "px", "format": "png"}"#,
            r#"{"type": "tps", "p": []}"#,
            r#"{"type": "Point"}"#,
            r#"{"best": 1}"#,
            "{}",
        ] {
            assert_eq!(told(plain, &WARP), "", "{plain}");
        }
        assert!(
            told(r#"{"type": "Feature", "geometry": 1}"#, &WARP_WITH_POINTS)
                .ends_with("put it in `geojson`")
        );
        assert_eq!(told(r#"{"p": [], "candidates": []}"#, &FIT), "");
    }
}
