//! The rules of a drag over a socket, without a clock, threads or I/O: which pose is drawn next,
//! how wide its preview is, and how many frames are under way.

pub mod frame_scheduler;
pub mod link_estimate;
pub mod picture_ladder;
pub mod preview_controller;
pub mod send_window;
#[cfg(test)]
mod simulation;
