//! The rules of a drag over a socket, without a clock, threads or I/O: which pose is drawn next,
//! how wide its preview is, and how many frames are under way.
//!
//! `frame_scheduler` decides and asks the others. `send_window` says how many frames may be under
//! way, by the queue that `link_estimate` sees in acknowledgements. With `frames=auto`,
//! `picture_ladder` says how many bytes the next picture may have, and so its width and quality;
//! otherwise `preview_controller` says how wide it is, by the times of drawing and sending. So on a
//! slow connection the next frame shows the newest pose that has arrived when the drawing starts,
//! just before an acknowledgement makes room for it; older poses are dropped.

pub mod frame_scheduler;
pub mod link_estimate;
pub mod picture_ladder;
pub mod preview_controller;
pub mod send_window;
#[cfg(test)]
mod simulation;
