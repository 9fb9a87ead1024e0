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
mod chacha;
mod coefficient_request;
mod compact;
mod compiled_rest;
#[cfg(feature = "codec")]
mod coordinate_map;
mod cut_rest;
mod digest;
mod drawn_pixels;
mod error;
mod fit;
mod frame;
mod image;
mod label_image;
mod map_spec;
mod mask;
mod mesh_renderer;
mod pixel_positions;
mod plausibility;
mod posed_mesh;
mod quality;
mod quantity;
mod raster_source;
mod region;
#[cfg(feature = "codec")]
mod render_job;
mod resolved_rest;
mod rest_depth;
mod rest_parameters;
mod rest_warnings;
#[cfg(any(not(feature = "codec"), test))]
mod sha256;
mod spec;
#[cfg(feature = "codec")]
mod strip_scheduler;
mod summary;
mod target;
#[cfg(test)]
mod tests;
mod transform;
mod unfolded;
mod work;

pub use self::alignment::Alignment;
pub use self::batch::{Easing, Jitter, jitter_grid};
pub use self::coefficient_request::{CoefficientCount, CoefficientRequest};
pub use self::compact::CompactLattice;
pub use self::compiled_rest::CompiledRest;
#[cfg(feature = "codec")]
pub use self::coordinate_map::CoordinateMap;
pub use self::cut_rest::FieldBytes;
pub use self::digest::Digest;
pub use self::drawn_pixels::LabelValues;
pub(crate) use self::drawn_pixels::{DrawnPixels, reserved};
pub use self::error::{Figure, GridError, Task, Warning, WarpError};
pub use self::fit::{Candidate, Fit, Prediction, best, check_comparison, choose};
pub use self::frame::CoordinateFrame;
pub use self::image::Image;
pub use self::label_image::LabelImage;
pub use self::map_spec::{MapFormat, MapSpec};
pub use self::mask::RestMask;
pub use self::pixel_positions::MapDirection;
pub(crate) use self::pixel_positions::PixelPositions;
pub use self::plausibility::Seen;
pub use self::posed_mesh::{PosedMesh, Report};
pub use self::quality::{Quality, RemovedFolds, RoundTrip, ToleranceQuality};
pub use self::quantity::Quantity;
pub use self::raster_source::RasterSource;
pub use self::region::Region;
#[cfg(feature = "codec")]
pub use self::render_job::RenderJob;
pub use self::resolved_rest::ResolvedRest;
pub use self::rest_depth::OrderOfCells;
pub use self::spec::{
    Align, Folds, GridSpec, Holes, Limits, Metric, OutputSpec, RestSpec, Units, system_bytes,
};
#[cfg(feature = "codec")]
pub use self::strip_scheduler::{Stage, StripScheduler, WriteObserver};
pub use self::summary::RestSummary;
pub use self::target::{CanvasSpec, FARTHEST_EDGE_PX, Target};
pub use self::transform::{
    Edges, MAX_EDGE_SAMPLES, MappedOutline, Outline, Taken, Transform, samples_of,
};
pub use crate::deform::Method;
pub use crate::format::ImageLimits;
