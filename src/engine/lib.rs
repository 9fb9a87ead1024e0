//! Image deformation using moving least squares (Schaefer, McPhail, Warren, SIGGRAPH 2006).
//!
//! *Handles* (points, segments, polylines) are placed on an image at rest positions `p` and moved
//! to posed positions `q`; the image follows them smoothly. What depends on `p` alone is computed
//! once; each new pose `q` then costs milliseconds.
//!
//! ```
//! # let path = std::env::temp_dir().join(format!("longer-nose-{}.png", std::process::id()));
//! # let (p, q) = ([[168.0, 112.0], [316.0, 136.0], [262.0, 240.0]],
//! #     [[168.0, 112.0], [316.0, 136.0], [262.0, 270.0]]);
//! # let (source, target) = ("test_files/images/chelsea.png", &path);
//! let image = mlswarp::Image::open(source)?;
//! let warper = mlswarp::Warper::new(image.extent(), &p)?;
//! let posed = warper.pose(&q)?;
//! posed.render(&image)?.save(target)?;
//! # assert_eq!(mlswarp::Image::open(&path)?.extent(), image.extent());
//! # std::fs::remove_file(path)?;
//! # Ok::<(), mlswarp::FileError>(())
//! ```
//!
//! * [`Image`] comes from a file of any format, or from pixels: [`Image::from_rgba8`],
//!   [`Image::from_grey16`] and others. A [`LabelImage`] has numbers instead of colours.
//! * [`Warper`] has the handles at rest; [`Warper::builder`] has the methods and their parameters.
//! * [`PosedWarp`] is a mesh: folds, the residual and warnings ([`PosedWarp::report`]), points both
//!   ways ([`PosedWarp::map_points`], [`PosedWarp::unmap_points`]), a map for other programs
//!   ([`PosedWarp::map`]).
//! * [`Rendering`] becomes pixels of the image's own depth and channels ([`Rendering::pixels`]), or
//!   a file ([`Rendering::save`], [`Rendering::write`]). Both have the same pixels bit for bit.
//! * A [`Cancel`] ends long work from another thread: [`Warper::cancelled_by`].
//!
//! Below this door, [`warp`] has its steps one by one, for caches, quotas and streams of strips.
//! [`deform`] is the mathematics alone, [`geometry`] the grids and meshes that it moves,
//! [`topology`] the shape of what an image shows, [`render`] draws a deformed mesh, [`pixmap`]
//! holds pixels, [`format`](mod@format) is the table of file formats, and `codec` reads and writes
//! them.
//!
//! Modules depend on each other in one direction only: the door on `warp`, and
//! `warp -> { codec -> format -> pixmap; render -> pixmap, geometry; deform -> geometry;
//! topology -> geometry }`; [`level`] chooses the vector instructions of all of them.
//!
//! | feature, both default | adds |
//! |---|---|
//! | `codec` | image files. Without it, pictures come from pixels and become pixels |
//! | `parallel` | the threads of the current rayon pool; without it, the calling thread works |
//!
//! Without both, the crate depends on nothing, has neither threads nor a clock, and as WebAssembly
//! imports nothing.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))]
#![cfg_attr(optimized_for_size, feature(optimize_attribute))]

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

#[forbid(unsafe_code)]
#[cfg_attr(not(test), warn(clippy::wildcard_enum_match_arm))]
pub mod format;

#[forbid(unsafe_code)]
mod parallel;

#[cfg(feature = "codec")]
#[cfg_attr(not(test), warn(clippy::wildcard_enum_match_arm))]
pub mod codec;

#[forbid(unsafe_code)]
#[cfg_attr(not(test), warn(clippy::wildcard_enum_match_arm))]
pub mod warp;

#[forbid(unsafe_code)]
mod warper;

pub use self::warp::{Image, LabelImage};
#[cfg(feature = "codec")]
pub use self::warper::FileError;
pub use self::warper::{Cancel, PosedWarp, Rendering, Warper, WarperBuilder};
