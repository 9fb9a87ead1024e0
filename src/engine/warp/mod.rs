//! Warps an image: the only module that uses all of `codec`, `pixmap`, `deform` and `render`.
//!
//! The steps: [`Image::decode`] (cached by content) -> [`Setup::new`] (rest handles resolved
//! against the image's size) -> [`Setup::plan`] (cached by [`Setup::plan_key`]) -> [`Setup::pose`]
//! (q alone) -> [`Posed::new`] (the mesh) -> [`Warp::new`] (once it exists, nothing in the client's
//! input can fail) -> [`Warp::write`] or [`StripScheduler`] (strips, rendered and encoded in
//! parallel, in order). What is drawn is a [`Subject`]: a picture, labels or coverage. A
//! [`CoordinateMap`] has the positions themselves.

mod alignment;
mod batch;
mod compact;
mod coordinate_map;
mod digest;
mod drawer;
mod drawing;
mod error;
mod fit;
mod frame;
mod image;
mod label_image;
mod plausibility;
mod posed;
mod quality;
mod region;
mod setup;
mod spec;
mod strip_scheduler;
mod subject;
mod summary;
mod table;
mod target;
#[cfg(test)]
mod tests;
mod transform;
mod work;

pub use self::alignment::Alignment;
pub use self::batch::{Easing, Jitter, jitter_grid};
pub use self::compact::CompactLattice;
pub use self::coordinate_map::{CoordinateMap, MapDirection, MapFormat, MapSpec};
pub use self::digest::Digest;
pub use self::drawing::Warp;
pub use self::error::{Figure, Task, Warning, WarpError};
pub use self::fit::{Candidate, Fit, Prediction, best, check_comparison, choose};
pub use self::frame::Frame;
pub use self::image::Image;
pub use self::label_image::LabelImage;
pub use self::plausibility::Seen;
pub use self::posed::{Posed, Report};
pub use self::quality::{Quality, RoundTrip, ToleranceQuality};
pub use self::region::Region;
pub use self::setup::{Plan, Setup};
pub use self::spec::{Align, Folds, GridSpec, Holes, Limits, Method, OutputSpec, RestSpec, Units};
pub use self::strip_scheduler::{Stage, StripScheduler, WriteObserver};
pub use self::subject::Subject;
pub use self::summary::RestSummary;
pub use self::table::Table;
pub use self::target::{CanvasSpec, FARTHEST as FARTHEST_CANVAS, Target};
pub use self::transform::{Edges, MappedOutline, Outline, SAMPLES, Transform, samples_of};
pub use crate::codec::Limits as ImageLimits;
