//! An image is warped: the only room that sees all four layers (codec, pixmap, deform, render). It knows no time, no sockets, no users.
//!
//! The walk: [`Image::decode`] (cached by content) -> [`Setup::new`] (rest handles resolved against the image's size) -> [`Setup::plan`]
//! (cached by [`Setup::plan_key`]) -> [`Setup::pose`] (q alone) -> [`Posed::new`] (the mesh) -> [`Warp::new`] (its existence proves that nothing of the
//! client's can fail any more) -> [`Warp::write`] or [`StripScheduler`] (strips of PNG, rendered and
//! encoded in parallel, handed over in order).

mod digest;
mod drawing;
mod error;
mod image;
mod posed;
mod setup;
mod spec;
mod strip_scheduler;

pub use self::digest::Digest;
pub use self::drawing::Warp;
pub use self::error::{Warning, WarpError};
pub use self::image::Image;
pub use self::posed::{Posed, Report};
pub use self::setup::{Plan, Setup};
pub use self::spec::{Folds, GridSpec, Limits, OutputSpec, RestSpec, Units};
pub use self::strip_scheduler::{Stage, StripScheduler, WriteObserver};
pub use crate::codec::Limits as ImageLimits;
