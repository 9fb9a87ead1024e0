//! The rules of a drag over a socket, without a clock, threads or I/O: which pose is drawn next, and how wide its preview is.

pub mod desk;
pub mod pace;
