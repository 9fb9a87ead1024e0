//! What a client probably meant by a field, a name or a colour that the contract does not have.

use super::fields::{GRID, OUTPUT, WARP};
use crate::problem::words::nearest;

/// What other programs call the handles at rest, posed, and both.
const REST: [&str; 12] = [
    "src",
    "source",
    "sources",
    "from",
    "rest",
    "original",
    "before",
    "start",
    "src_points",
    "source_points",
    "src_pts",
    "control_points",
];
const POSED: [&str; 14] = [
    "dst",
    "dest",
    "destination",
    "target",
    "targets",
    "to",
    "posed",
    "deformed",
    "moved",
    "after",
    "dst_points",
    "dest_points",
    "target_points",
    "dst_pts",
];
/// What other programs call the height of a picture, or both of its sides.
const SIZES: [&str; 6] = [
    "height",
    "size",
    "scale",
    "resize",
    "dimensions",
    "resolution",
];
const BOTH: [&str; 5] = ["points", "handles", "pins", "landmarks", "pairs"];

/// Fields of the warp object that a session does not keep.
const NOT_KEPT: [&str; 7] = [
    "output",
    "strength",
    "names",
    "format",
    "unmatched",
    "match",
    "item",
];

/// Other names of fields.
const OTHER_FIELDS: [(&str, &str); 4] = [
    ("family", "method"),
    ("background", "outside"),
    ("interpolation", "filter"),
    ("mesh", "grid"),
];
/// Fields of other requests, and where they go.
const OF_OTHERS: [(&[&str], &str); 5] = [
    (
        &["frames", "steps", "easing", "jitter"],
        "belongs to many frames in one file: POST /sessions/{id}/batch, or mlswarp batch",
    ),
    (
        &["polygons", "boxes", "geojson", "inverse", "refine"],
        "belongs to annotations: POST /points, or mlswarp points",
    ),
    (
        &["candidates"],
        "belongs to a comparison of methods: POST /fit",
    ),
    (
        &["direction"],
        "belongs to a map of coordinates: POST /map, or mlswarp map",
    ),
    (
        &["seq", "layer"],
        "belongs to a drag of a session: POST /sessions/{id}/warp",
    ),
];
/// Other names of values.
const OTHER_VALUES: [(&str, &str); 8] = [
    ("jpg", "jpeg"),
    ("pixels", "px"),
    ("relative", "normalized"),
    ("fraction", "normalized"),
    ("linear", "bilinear"),
    ("none", "transparent"),
    ("clamp", "edge"),
    ("extend", "edge"),
];
/// The colours that people write by name.
const COLOURS: [(&str, &str); 20] = [
    ("black", "#000000"),
    ("white", "#ffffff"),
    ("red", "#ff0000"),
    ("green", "#008000"),
    ("blue", "#0000ff"),
    ("yellow", "#ffff00"),
    ("orange", "#ffa500"),
    ("purple", "#800080"),
    ("pink", "#ffc0cb"),
    ("brown", "#a52a2a"),
    ("gray", "#808080"),
    ("grey", "#808080"),
    ("silver", "#c0c0c0"),
    ("cyan", "#00ffff"),
    ("magenta", "#ff00ff"),
    ("lime", "#00ff00"),
    ("navy", "#000080"),
    ("teal", "#008080"),
    ("olive", "#808000"),
    ("maroon", "#800000"),
];

fn in_table<'a>(table: &[(&str, &'a str)], name: &str) -> Option<&'a str> {
    table
        .iter()
        .find(|(other, _)| name.eq_ignore_ascii_case(other))
        .map(|(_, meant)| *meant)
}

/// A hint for a field that an object does not have; `known`: the fields that it has.
pub(crate) fn field(name: &str, known: &[&str]) -> Option<String> {
    special(name, known).or_else(|| misplaced_or_misspelt(name, known))
}

/// The hint for a name that has one of its own.
fn special(name: &str, known: &[&str]) -> Option<String> {
    let has = |field: &str| known.contains(&field);
    let is_any = |names: &[&str]| names.iter().any(|other| name.eq_ignore_ascii_case(other));
    let hint = match (has("q"), has("p")) {
        (true, _) if is_any(&["warp"]) => "send the content of `warp`, without `warp`",
        (true, true) if is_any(&["image"]) && !has("extent") => {
            "the image is a part of its own, beside the part `warp`"
        }
        _ if has("extent") && (is_any(&SIZES) || is_any(&["width"])) => {
            "the size of the image is `extent`: [width, height]"
        }
        _ if (has("output") || has("quality")) && is_any(&SIZES) => {
            "the height follows from `output.width`"
        }
        (true, false) if has("points") && is_any(&BOTH) => "did you mean `points`?",
        (true, true) if is_any(&[&REST[..], &POSED, &BOTH].concat()) => {
            "did you mean `p` and `q`? `p` is where the handles are, `q` is where they go"
        }
        (true, false) if is_any(&POSED) => "did you mean `q`?",
        (true, false) if name == "p" || is_any(&[&REST[..], &BOTH].concat()) => OF_SESSION,
        // `NOT_KEPT` belong to each request, so no session has them.
        (true, false) if !NOT_KEPT.contains(&name) && WARP.contains(&name) => {
            return Some(format!(
                "the session has `{name}`; replace it with PUT /sessions/{{id}}/handles"
            ));
        }
        _ => {
            let (object, inner) = name.split_once('.').filter(|(object, _)| has(object))?;
            let is_field = (object == "output" && OUTPUT.contains(&inner))
                || (object == "grid" && GRID.contains(&inner));
            return is_field.then(|| format!("nest it: {{\"{object}\": {{\"{inner}\": ...}}}}"));
        }
    };
    Some(hint.to_owned())
}

fn misplaced_or_misspelt(name: &str, known: &[&str]) -> Option<String> {
    // Beside `quality`, a type is that of the file; in a warp object it could be anything.
    let is_format = name == "type" && known.contains(&"quality");
    let name = if is_format {
        "format"
    } else {
        in_table(&OTHER_FIELDS, name).unwrap_or(name)
    };
    let inside = |object: &str, fields: &[&str], name: &str| {
        (known.contains(&object) && fields.contains(&name))
            .then(|| format!("put it in `{object}`: `{object}.{name}`"))
    };
    let nested =
        |name: &str| inside("output", &OUTPUT, name).or_else(|| inside("grid", &GRID, name));
    let is_output = known.contains(&"compression");
    let outside = || {
        let object = if is_output { "output" } else { "grid" };
        let is_inner = is_output || known == GRID;
        (is_inner && WARP.contains(&name) && !known.contains(&name))
            .then(|| format!("put it beside `{object}`, not in it"))
    };
    let of_others = || {
        let (_, place) = OF_OTHERS.iter().find(|(names, _)| names.contains(&name))?;
        Some(format!("`{name}` {place}"))
    };
    // A name of another level is known only if it is spelled right: a similar one would be a guess
    // about two things.
    nested(name)
        .or_else(outside)
        .or_else(|| {
            nearest(name, known.iter().copied()).map(|meant| format!("did you mean `{meant}`?"))
        })
        .or_else(of_others)
}

const OF_SESSION: &str =
    "the session has `p`; send only `q`, or replace `p` with PUT /sessions/{id}/handles";

/// The name that was probably meant by a value that is not in `names`.
pub(crate) fn value<'a>(text: &str, names: &[&'a str]) -> Option<&'a str> {
    let other = in_table(&OTHER_VALUES, text)
        .and_then(|meant| names.iter().copied().find(|name| *name == meant));
    other.or_else(|| nearest(text, names.iter().copied()))
}

/// The colour that was probably meant: a name, a short form, or digits without `#`, of which
/// letters alone are a word.
pub(crate) fn colour(text: &str) -> Option<String> {
    if let Some(known) = in_table(&COLOURS, text) {
        return Some(known.to_owned());
    }
    let digits = text
        .strip_prefix('#')
        .or_else(|| text.strip_prefix("0x"))
        .unwrap_or(text);
    let is_word = digits == text && !text.bytes().any(|b| b.is_ascii_digit());
    if is_word || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return None;
    }
    let digits = match digits.len() {
        3 | 4 => digits.chars().flat_map(|c| [c, c]).collect(),
        6 | 8 => digits.to_owned(),
        _ => return None,
    };
    Some(format!("#{}", digits.to_ascii_lowercase()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::fields::{BATCH, POINTS_OF_SESSION, WARP_WITH_POINTS};

    #[test]
    fn fields_are_suggested_by_name_place_and_spelling() {
        let drag = ["q", "seq", "output"];
        let both = "did you mean `p` and `q`? `p` is where the handles are, `q` is where they go";
        for (name, known, hint) in [
            ("src", &WARP[..], Some(both)),
            ("dst", &WARP, Some(both)),
            ("Target", &WARP, Some(both)),
            ("points", &WARP, Some(both)),
            ("dst", &drag, Some("did you mean `q`?")),
            ("from", &drag, Some(OF_SESSION)),
            ("p", &drag, Some(OF_SESSION)),
            ("width", &WARP, Some("put it in `output`: `output.width`")),
            ("width", &drag, Some("put it in `output`: `output.width`")),
            (
                "background",
                &WARP,
                Some("put it in `output`: `output.outside`"),
            ),
            ("qualitty", &WARP, None),
            ("qualitty", &OUTPUT, Some("did you mean `quality`?")),
            ("type", &WARP, None),
            ("type", &OUTPUT, Some("did you mean `format`?")),
            ("layer", &BATCH, Some("did you mean `layers`?")),
            (
                "steps",
                &WARP,
                Some(
                    "`steps` belongs to many frames in one file: POST /sessions/{id}/batch, or \
                        mlswarp batch",
                ),
            ),
            (
                "boxes",
                &WARP,
                Some("`boxes` belongs to annotations: POST /points, or mlswarp points"),
            ),
            ("cell", &WARP, Some("put it in `grid`: `grid.cell`")),
            ("method", &OUTPUT, Some("put it beside `output`, not in it")),
            ("alpha", &GRID, Some("put it beside `grid`, not in it")),
            ("metod", &WARP, Some("did you mean `method`?")),
            ("cells", &GRID, Some("did you mean `cell`?")),
            ("width", &["q", "seq"], None),
            (
                "height",
                &WARP,
                Some("the height follows from `output.width`"),
            ),
            (
                "Size",
                &OUTPUT,
                Some("the height follows from `output.width`"),
            ),
            (
                "scale",
                &drag,
                Some("the height follows from `output.width`"),
            ),
            (
                "width",
                &WARP_WITH_POINTS,
                Some("the size of the image is `extent`: [width, height]"),
            ),
            (
                "warp",
                &WARP,
                Some("send the content of `warp`, without `warp`"),
            ),
            ("image", &POINTS_OF_SESSION, None),
            (
                "image",
                &WARP,
                Some("the image is a part of its own, beside the part `warp`"),
            ),
            (
                "output.format",
                &WARP,
                Some("nest it: {\"output\": {\"format\": ...}}"),
            ),
            (
                "grid.cell",
                &WARP,
                Some("nest it: {\"grid\": {\"cell\": ...}}"),
            ),
            ("output.nothing", &WARP, None),
            ("p.x", &WARP, None),
            (
                "method",
                &drag,
                Some("the session has `method`; replace it with PUT /sessions/{id}/handles"),
            ),
            ("strength", &["q", "candidates"], None),
            (
                "landmarks",
                &POINTS_OF_SESSION,
                Some("did you mean `points`?"),
            ),
            ("pins", &POINTS_OF_SESSION, Some("did you mean `points`?")),
            ("landmarks", &WARP_WITH_POINTS, Some(both)),
            ("frobnicate", &WARP, None),
        ] {
            assert_eq!(field(name, known).as_deref(), hint, "{name}");
        }
    }

    #[test]
    fn values_are_suggested_by_other_names_and_spelling() {
        for (text, names, meant) in [
            ("jpg", &["png", "jpeg", "webp"][..], Some("jpeg")),
            ("PNG", &["png", "jpeg", "webp"], Some("png")),
            ("tif", &["png", "jpeg", "webp"], None),
            ("pixels", &["px", "normalized"], Some("px")),
            ("normalised", &["px", "normalized"], Some("normalized")),
            ("none", &["transparent", "edge"], Some("transparent")),
            ("jpg", &["px"], None),
        ] {
            assert_eq!(value(text, names), meant, "{text}");
        }
    }

    #[test]
    fn colours_are_suggested_in_full() {
        for (text, meant) in [
            ("red", Some("#ff0000")),
            ("White", Some("#ffffff")),
            ("#fff", Some("#ffffff")),
            ("#F0a8", Some("#ff00aa88")),
            ("0A141E", Some("#0a141e")),
            ("0x0a141e80", Some("#0a141e80")),
            ("ede", None),
            ("decade", None),
            ("#ede", Some("#eeddee")),
            ("#12345", None),
            ("#xyz", None),
            ("", None),
            ("rainbow", None),
        ] {
            assert_eq!(colour(text).as_deref(), meant, "{text}");
        }
    }
}
