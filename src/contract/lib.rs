//! The contract of mlswarp: what clients write and read, without HTTP, clocks or I/O.
//!
//! [`wire`] turns JSON objects and landmark files into checked values of the library `mlswarp`, and
//! results back into JSON. [`problem`] has every error that a client can see: its code, its
//! sentence and the place in the request. [`layer`] has the names of a session's further images.
//! [`blend`] adds images in memory as the object of `POST /blend` says, [`mod@file`] draws a file
//! as `POST /warp` does.
//! The service adds the HTTP status line and headers; the offline tool prints the same sentences.

#![allow(
    rustdoc::private_intra_doc_links,
    reason = "the crate is read in its source"
)]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), warn(clippy::disallowed_methods))]

pub mod blend;
#[cfg(feature = "codec")]
pub mod file;
pub mod layer;
pub mod problem;
pub mod wire;
