//! Warps an image: the only module that uses all of `codec`, `pixmap`, `deform` and `render`.
//!
//! The steps: [`Image::decode`] (cached by content) -> [`ResolvedRest::new`] (rest handles resolved
//! against the image's size) -> [`ResolvedRest::plan`] (cached by [`ResolvedRest::plan_key`]) ->
//! [`ResolvedRest::pose`] (q alone) -> [`PosedMesh::new`] (the mesh) -> [`RenderJob::new`] (once it
//! exists, nothing in the client's input can fail) -> [`RenderJob::write`] or [`StripScheduler`]
//! (strips, rendered and encoded in parallel, in order). What is drawn is a [`RasterSource`]: a
//! picture, labels or coverage. A [`CoordinateMap`] has the positions themselves.

mod alignment;
mod batch;
pub mod blend;
mod coefficient_request;
mod compact;
mod coordinate_map;
mod cut_rest;
mod digest;
mod error;
mod fit;
mod frame;
mod image;
mod label_image;
mod mask;
mod mesh_renderer;
mod plausibility;
mod posed_mesh;
mod quality;
mod raster_source;
mod region;
mod render_job;
mod resolved_rest;
mod rest_parameters;
mod spec;
mod strip_scheduler;
mod summary;
mod target;
#[cfg(test)]
mod tests;
mod transform;
mod work;

pub use self::alignment::Alignment;
pub use self::batch::{Easing, Jitter, jitter_grid};
pub use self::coefficient_request::CoefficientRequest;
pub use self::compact::CompactLattice;
pub use self::coordinate_map::{CoordinateMap, MapDirection, MapFormat, MapSpec};
pub use self::digest::Digest;
pub use self::error::{Figure, Task, Warning, WarpError};
pub use self::fit::{Candidate, Fit, Prediction, best, check_comparison, choose};
pub use self::frame::CoordinateFrame;
pub use self::image::Image;
pub use self::label_image::LabelImage;
pub use self::mask::RestMask;
pub use self::plausibility::Seen;
pub use self::posed_mesh::{PosedMesh, Report};
pub use self::quality::{Quality, RoundTrip, ToleranceQuality};
pub use self::raster_source::RasterSource;
pub use self::region::Region;
pub use self::render_job::RenderJob;
pub use self::resolved_rest::{CompiledRest, ResolvedRest};
pub use self::spec::{
    Align, Folds, GridSpec, Holes, Limits, Metric, OutputSpec, RestSpec, Units, system_bytes,
};
pub use self::strip_scheduler::{Stage, StripScheduler, WriteObserver};
pub use self::summary::RestSummary;
pub use self::target::{CanvasSpec, FARTHEST_EDGE_PX, Target};
pub use self::transform::{Edges, MAX_EDGE_SAMPLES, MappedOutline, Outline, Transform, samples_of};
pub use crate::codec::ImageLimits;
pub use crate::deform::Method;
