//! The names of the fields of the warp object and of the objects in it.

/// The fields of the warp object, in the order of `WarpPatch::read`.
pub(crate) const WARP: [&str; 11] = ["p", "q", "weights", "method", "alpha", "point_mass", "units", "grid", "folds", "metric", "output"];

/// The fields of `/points`: those of the warp object, then its own.
pub(crate) const WARP_WITH_POINTS: [&str; 17] = {
    let mut fields = [""; 17];
    let (warp, own) = fields.split_at_mut(WARP.len());
    warp.copy_from_slice(&WARP);
    own.copy_from_slice(&["extent", "points", "polygons", "boxes", "inverse", "refine"]);
    fields
};

/// The fields of `grid`.
pub(crate) const GRID: [&str; 3] = ["cell", "columns", "rows"];

/// The fields of `output`, in the order of `OutputPatch::read`.
pub(crate) const OUTPUT: [&str; 7] = ["format", "quality", "compression", "width", "filter", "outside", "canvas"];
