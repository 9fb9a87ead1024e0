//! mlswarp bends images as if they were real objects: handles `p` are placed on a picture, moved to `q`, and the whole
//! picture follows smoothly (*Image Deformation Using Moving Least Squares*, Schaefer, McPhail, Warren, SIGGRAPH 2006).
//!
//! The modules stand in the order in which a request walks through them; arrows run one way:
//! `warp -> { codec -> pixmap; render -> pixmap, geometry; deform -> geometry }`.
//!
//! One warp, from a file's bytes to the bytes of a PNG:
//!
//! ```
//! use std::{ops::ControlFlow, sync::Arc};
//! use mlswarp::deform::Handle;
//! use mlswarp::geometry::Point;
//! use mlswarp::warp::{Folds, Image, Limits, OutputSpec, Posed, RestSpec, Setup, Warp};
//!
//! let file = include_bytes!("../../tests/images/chelsea.png");
//! let limits = Limits::default();
//! let image = Arc::new(Image::decode(file, &limits.image)?);
//!
//! let p = [(168.0, 112.0), (316.0, 136.0), (262.0, 240.0)].map(|(x, y)| Handle::Point(Point::new(x, y)));
//! let rest = RestSpec { p: p.to_vec(), ..RestSpec::default() };
//! let setup = Setup::new(&rest, image.extent(), &limits)?;
//! let plan = setup.plan(); // once for these handles and this size
//!
//! // The nose moves; the eyes stay. Only this is repeated while a hand drags.
//! let q = [(168.0, 112.0), (316.0, 136.0), (262.0, 270.0)].map(|(x, y)| Handle::Point(Point::new(x, y)));
//! let pose = setup.pose(&q)?;
//! let posed = Posed::new(&setup, &plan, &pose, Folds::Report, &|| false)?;
//! assert_eq!(posed.report().folds, 0);
//! assert!(posed.report().residual < 0.5);
//! let warp = Warp::new(&image, &posed, &OutputSpec::default(), &limits)?;
//!
//! let mut png = Vec::new();
//! let _ = warp.write(0, &(), &mut |bytes| {
//!     png.extend(bytes);
//!     ControlFlow::Continue(())
//! });
//! assert!(png.starts_with(b"\x89PNG"));
//! # Ok::<(), mlswarp::warp::WarpError>(())
//! ```

#[forbid(unsafe_code)]
pub mod level;

#[forbid(unsafe_code)]
pub mod geometry;

pub mod deform;

#[forbid(unsafe_code)]
pub mod pixmap;

pub mod render;

pub mod codec;

#[forbid(unsafe_code)]
pub mod warp;
