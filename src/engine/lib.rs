//! Image deformation using moving least squares (Schaefer, McPhail, Warren, SIGGRAPH 2006).
//!
//! *Handles* (points, segments, polylines) are placed on an image at rest positions `p` and moved
//! to posed positions `q`; the image follows them smoothly. The part that depends on `p` alone is
//! computed once (a [`deform::CoefficientTable`]); each new pose `q` then costs milliseconds.
//!
//! One warp, from the bytes of an image file to the bytes of a PNG:
//!
//! ```
//! use std::{ops::ControlFlow, sync::Arc};
//! use mlswarp::deform::Handle;
//! use mlswarp::geometry::Point;
//! use mlswarp::warp::{Folds, Image, Limits, OutputSpec, PosedMesh, RestSpec};
//! use mlswarp::warp::{ResolvedRest, RasterSource, RenderJob, WarpError};
//!
//! /// Moves the third handle 30 px down; the other two keep their places.
//! fn longer_nose(file: &[u8]) -> Result<Vec<u8>, WarpError> {
//!     let limits = Limits::default();
//!     let image = Arc::new(Image::decode(file, &limits.image)?);
//!
//!     // Once for each set of rest positions and image size.
//!     let point = |(x, y)| Handle::Point(Point::new(x, y));
//!     let p = [(168.0, 112.0), (316.0, 136.0), (262.0, 240.0)].map(point);
//!     let rest = RestSpec { p: p.to_vec(), ..RestSpec::default() };
//!     let resolved = ResolvedRest::new(&rest, image.extent(), &limits)?;
//!     let compiled = resolved.plan();
//!
//!     // Once for each pose.
//!     let q = [(168.0, 112.0), (316.0, 136.0), (262.0, 270.0)].map(point);
//!     let pose = resolved.pose(&q)?;
//!     let posed = PosedMesh::new(&resolved, &compiled, &pose, Folds::Report, &|| false)?;
//!     let source = RasterSource::Image(&image);
//!     let job = RenderJob::new(source, &posed, &OutputSpec::default(), &limits)?;
//!
//!     let mut png = Vec::new();
//!     let _ = job.write(0, &(), &mut |bytes| {
//!         png.extend(bytes);
//!         ControlFlow::Continue(())
//!     });
//!     Ok(png)
//! }
//! # let file = include_bytes!("test_files/images/chelsea.png");
//! # assert!(longer_nose(file)?.starts_with(b"\x89PNG"));
//! # Ok::<(), WarpError>(())
//! ```
//!
//! Where to read next: [`warp`] has the steps of this example and their options. [`deform`] is the
//! mathematics alone, [`geometry`] the grids and meshes that it moves, [`topology`] the shape of what
//! an image shows, [`render`] draws a deformed mesh, [`pixmap`] holds pixels, and [`codec`] reads and writes files.
//!
//! Modules depend on each other in one direction only:
//! `warp -> { codec -> pixmap; render -> pixmap, geometry; deform -> geometry }` and
//! `topology -> geometry`; [`level`] chooses
//! the vector instructions of all of them.
//!
//! The feature `codec` (default) brings [`codec`] and [`warp`]. Without it the crate has the
//! mathematics and the renderer, and one dependency.

/// Every formula, with its derivation and the reason for its numerical form. Comments cite its
/// sections: "mathematics 7.1".
#[doc = include_str!("MATHEMATICS.md")]
pub mod mathematics {}

#[forbid(unsafe_code)]
pub mod level;

#[forbid(unsafe_code)]
pub mod geometry;

#[forbid(unsafe_code)]
pub mod topology;

pub mod deform;

#[forbid(unsafe_code)]
pub mod pixmap;

pub mod render;

#[cfg(feature = "codec")]
pub mod codec;

#[cfg(feature = "codec")]
#[forbid(unsafe_code)]
pub mod warp;
