//! The rules of a drag over a socket, without a clock, threads or I/O: which pose is drawn next, and how wide its preview is.

pub mod frame_scheduler;
pub mod preview_controller;
