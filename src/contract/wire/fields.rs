//! The names that fields have in the warp object and in the objects inside it.

use mlswarp::deform::METHODS;

use crate::problem::words::list;
use crate::problem::{Code, Problem};

/// Names the fields of an object once: a list for code that looks for a name, and a struct with a
/// value (`N`, a node of the JSON) for each, made of the array that is read for the list.
macro_rules! object_fields {
    ($(#[$doc:meta])* $list:ident, $fields:ident { $($field:ident = $name:literal),+ $(,)? }) => {
        $(#[$doc])*
        pub const $list: [&str; [$($name),+].len()] = [$($name),+];

        $(#[$doc])*
        #[derive(Clone, Copy)]
        pub(crate) struct $fields<N> {
            $(pub(crate) $field: Option<N>),+
        }

        impl<N> From<[Option<N>; $list.len()]> for $fields<N> {
            fn from([$($field),+]: [Option<N>; $list.len()]) -> Self {
                Self { $($field),+ }
            }
        }

        impl<N> Default for $fields<N> {
            fn default() -> Self {
                Self { $($field: None),+ }
            }
        }
    };
}

/// The fields of the warp object: those of every method, then the objects of some methods.
pub const WARP: [&str; OF_EVERY_METHOD.len() + METHOD_OBJECTS.len()] = {
    let mut fields = [""; OF_EVERY_METHOD.len() + METHOD_OBJECTS.len()];
    let (every, objects) = fields.split_at_mut(OF_EVERY_METHOD.len());
    every.copy_from_slice(&OF_EVERY_METHOD);
    objects.copy_from_slice(&METHOD_OBJECTS);
    fields
};

const OBJECT_COUNT: usize = {
    let (mut count, mut k) = (0, 0);
    while k < METHODS.len() {
        count += METHODS[k].has_object as usize;
        k += 1;
    }
    count
};

/// The objects in which methods have parameters, by the names of the methods.
pub const METHOD_OBJECTS: [&str; OBJECT_COUNT] = {
    let (mut objects, mut count, mut k) = ([""; OBJECT_COUNT], 0, 0);
    while k < METHODS.len() {
        if METHODS[k].has_object {
            objects[count] = METHODS[k].name;
            count += 1;
        }
        k += 1;
    }
    objects
};

object_fields! {
    /// The fields of the warp object that do not depend on the method.
    OF_EVERY_METHOD, WarpFields {
        p = "p",
        q = "q",
        align = "align",
        strength = "strength",
        weights = "weights",
        depth = "depth",
        method = "method",
        alpha = "alpha",
        point_mass = "point_mass",
        smoothing = "smoothing",
        coincident = "coincident",
        units = "units",
        grid = "grid",
        folds = "folds",
        metric = "metric",
        mask = "mask",
        output = "output",
        names = "names",
        format = "format",
        unmatched = "unmatched",
        matching = "match",
        item = "item",
    }
}

impl<N: Copy> WarpFields<N> {
    /// The values of the fields of [`WARP`]: those of every method, and the objects of methods.
    pub(crate) fn split(nodes: [Option<N>; WARP.len()]) -> (Self, [Option<N>; OBJECT_COUNT]) {
        let every: [_; OF_EVERY_METHOD.len()] = std::array::from_fn(|k| nodes[k]);
        let objects = std::array::from_fn(|k| nodes[OF_EVERY_METHOD.len() + k]);
        (every.into(), objects)
    }
}

/// Fields of the warp object that only the response of `POST /landmarks` has.
pub const OF_LANDMARKS: [&str; 3] = ["names", "format", "unmatched"];

/// The annotations of a request.
pub const ANNOTATIONS: [&str; 4] = ["points", "polygons", "boxes", "geojson"];

object_fields! {
    /// The fields of `/points` beside its handles: annotations, and how they are mapped.
    MAPPED, AnnotationFields {
        points = "points",
        polygons = "polygons",
        boxes = "boxes",
        geojson = "geojson",
        inverse = "inverse",
        refine = "refine",
    }
}

impl<N: Copy> AnnotationFields<N> {
    /// The values that may be large.
    pub(crate) const fn annotations(&self) -> [Option<N>; ANNOTATIONS.len()] {
        [self.points, self.polygons, self.boxes, self.geojson]
    }
}

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

object_fields! {
    /// The fields of `/fit`.
    FIT, FitFields {
        p = "p",
        q = "q",
        align = "align",
        weights = "weights",
        coincident = "coincident",
        units = "units",
        extent = "extent",
        candidates = "candidates",
        names = "names",
        format = "format",
        unmatched = "unmatched",
    }
}
/// The fields of `/sessions/{id}/fit`.
pub const FIT_OF_SESSION: [&str; 2] = ["q", "candidates"];

object_fields! {
    /// The fields of `/sessions/{id}/batch`.
    BATCH, BatchFields {
        frames = "frames",
        q = "q",
        strength = "strength",
        steps = "steps",
        easing = "easing",
        jitter = "jitter",
        delay = "delay",
        plays = "loop",
        and_back = "and_back",
        layers = "layers",
        output = "output",
        points = "points",
        polygons = "polygons",
        boxes = "boxes",
        geojson = "geojson",
        refine = "refine",
    }
}
impl<N: Copy> BatchFields<N> {
    /// The annotations of every frame.
    pub(crate) const fn mapped(&self) -> AnnotationFields<N> {
        AnnotationFields {
            points: self.points,
            polygons: self.polygons,
            boxes: self.boxes,
            geojson: self.geojson,
            inverse: None,
            refine: self.refine,
        }
    }
}

/// The fields of a frame of a batch.
pub const BATCH_FRAME: [&str; 2] = ["q", "strength"];
/// The fields of a batch's `jitter`.
pub const JITTER: [&str; 3] = ["seed", "count", "sigma"];

object_fields! {
    /// The fields of `/blend`.
    BLEND, BlendFields {
        images = "images",
        align = "align",
        reference = "reference",
        space = "space",
        matching = "match",
        steps = "steps",
        method = "method",
        alpha = "alpha",
        point_mass = "point_mass",
        smoothing = "smoothing",
        coincident = "coincident",
        grid = "grid",
        output = "output",
    }
}
/// The fields of an image of a blend.
pub const BLEND_IMAGE: [&str; 9] = [
    "image", "session", "shape", "colour", "mirror", "pairs", "p", "names", "item",
];

/// The fields of a candidate.
pub const CANDIDATE: [&str; 3] = ["method", "alpha", "smoothing"];

/// The fields of `mask`.
pub const MASK: [&str; 1] = ["threshold"];

/// The fields of `coincident`.
pub const COINCIDENT: [&str; 2] = ["policy", "within"];

/// The fields of `grid`.
pub const GRID: [&str; 4] = ["cell", "columns", "rows", "tolerance"];

object_fields! {
    /// The fields of `output`.
    OUTPUT, OutputFields {
        format = "format",
        quality = "quality",
        subsampling = "subsampling",
        compression = "compression",
        width = "width",
        filter = "filter",
        outside = "outside",
        canvas = "canvas",
        holes = "holes",
    }
}

/// The fields of `outside` as a value.
pub const OUTSIDE: [&str; 1] = ["value"];

/// The fields of a box as `canvas`.
pub const CANVAS: [&str; 4] = ["x", "y", "width", "height"];

/// The names without those that need not be sent.
pub fn useful<'a>(known: &[&'a str]) -> Vec<&'a str> {
    let is_useful = |name: &&str| !OF_LANDMARKS.contains(name);
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
