//! The names of the fields of the warp object and of the objects in it.

use crate::problem::words::list;
use crate::problem::{Code, Problem};

/// The fields of the warp object, in the order of `WarpPatch::read`.
pub const WARP: [&str; 20] = [
    "p",
    "q",
    "align",
    "strength",
    "weights",
    "method",
    "alpha",
    "point_mass",
    "smoothing",
    "coincident",
    "units",
    "grid",
    "folds",
    "metric",
    "output",
    "names",
    "format",
    "unmatched",
    "match",
    "item",
];

/// Fields of the warp object that only the response of `POST /landmarks` has.
pub const OF_LANDMARKS: [&str; 3] = ["names", "format", "unmatched"];

/// The annotations of a request.
pub const ANNOTATIONS: [&str; 4] = ["points", "polygons", "boxes", "geojson"];

/// The fields of `/points`: those of the warp object, then its own.
pub const WARP_WITH_POINTS: [&str; WARP.len() + 7] = {
    let mut fields = [""; WARP.len() + 7];
    let (warp, own) = fields.split_at_mut(WARP.len());
    warp.copy_from_slice(&WARP);
    own.copy_from_slice(&[
        "extent", "points", "polygons", "boxes", "geojson", "inverse", "refine",
    ]);
    fields
};

/// The fields of `/report`: those of the warp object, and the extent.
pub const WARP_WITH_EXTENT: [&str; WARP.len() + 1] = {
    let mut fields = ["extent"; WARP.len() + 1];
    fields.split_at_mut(WARP.len()).0.copy_from_slice(&WARP);
    fields
};

/// The fields of `/sessions/{id}/points`.
pub const POINTS_OF_SESSION: [&str; 9] = [
    "q", "strength", "output", "points", "polygons", "boxes", "geojson", "inverse", "refine",
];

/// The fields of `/map`: those of the warp object, then its own.
pub const WARP_WITH_MAP: [&str; WARP.len() + 4] = {
    let mut fields = [""; WARP.len() + 4];
    let (warp, own) = fields.split_at_mut(WARP.len());
    warp.copy_from_slice(&WARP);
    own.copy_from_slice(&["extent", "direction", "canvas", "width"]);
    fields
};

/// The fields of `/sessions/{id}/map`.
pub const MAP_OF_SESSION: [&str; 5] = ["q", "strength", "direction", "canvas", "width"];

/// The fields of `/fit` and of `/sessions/{id}/fit`.
pub const FIT: [&str; 11] = [
    "p",
    "q",
    "align",
    "weights",
    "coincident",
    "units",
    "extent",
    "candidates",
    "names",
    "format",
    "unmatched",
];
/// The fields of `/sessions/{id}/fit`.
pub const FIT_OF_SESSION: [&str; 2] = ["q", "candidates"];

/// The fields of `/sessions/{id}/batch`, of a frame and of `jitter`.
pub const BATCH: [&str; 16] = [
    "frames", "q", "strength", "steps", "easing", "jitter", "delay", "loop", "and_back", "layers",
    "output", "points", "polygons", "boxes", "geojson", "refine",
];
/// The fields of a frame of a batch.
pub const BATCH_FRAME: [&str; 2] = ["q", "strength"];
/// The fields of a batch's `jitter`.
pub const JITTER: [&str; 3] = ["seed", "count", "sigma"];

/// The fields of a candidate.
pub const CANDIDATE: [&str; 3] = ["method", "alpha", "smoothing"];

/// The fields of `coincident`.
pub const COINCIDENT: [&str; 2] = ["policy", "within"];

/// The fields of `grid`.
pub const GRID: [&str; 4] = ["cell", "columns", "rows", "tolerance"];

/// The fields of `output`, in the order of `OutputPatch::read`.
pub const OUTPUT: [&str; 9] = [
    "format",
    "quality",
    "subsampling",
    "compression",
    "width",
    "filter",
    "outside",
    "canvas",
    "holes",
];

/// The fields of `outside` as a value.
pub const OUTSIDE: [&str; 1] = ["value"];

/// The fields of a box as `canvas`.
pub const CANVAS: [&str; 4] = ["x", "y", "width", "height"];

/// Fields that this version accepts with one value only: nobody needs to send them.
const ONE_VALUED: [&str; 1] = ["metric"];

/// The names without those that nobody needs to send.
pub fn useful<'a>(known: &[&'a str]) -> Vec<&'a str> {
    let is_useful = |name: &&str| !ONE_VALUED.contains(name) && !OF_LANDMARKS.contains(name);
    // Objects of a format, such as `output`, have a field of that name too.
    let is_output = known.contains(&"compression");
    known
        .iter()
        .copied()
        .filter(|name| is_output || is_useful(name))
        .collect()
}

/// Fields and parts of the contract that this version does not support, each with a known name of
/// the objects that it belongs to.
const UNSUPPORTED: [(&str, &str); 1] = [("region", "q")];

/// Whether the contract has the name beside the `known` ones, and this version does not support it.
pub fn is_unsupported(name: &str, known: &[&str]) -> bool {
    UNSUPPORTED
        .iter()
        .any(|(unsupported, beside)| *unsupported == name && known.contains(beside))
}

/// The problem of a name that [`is_unsupported`].
pub fn unsupported(name: &str, known: &[&str]) -> Problem {
    let supported = list(&useful(known));
    // The page saves the mask with the handles: a client that sends such a file must not lose it
    // unseen.
    let instead = ". A region is a mask of its own: the part `region` of an upload, --region \
        FILE, or the layer `region` of a session. A file \
                   that the page has saved holds it as base64: `jq -r .region FILE | base64 -d > \
                   region.png` and `jq 'del(.region)' FILE`";
    let detail =
        format!("not supported by this version: `{name}`; supported: {supported}{instead}");
    Problem::new(Code::NotSupported, detail)
}
