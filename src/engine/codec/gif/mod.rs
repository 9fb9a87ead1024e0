//! GIF: one frame is read, animations are written.

mod palette;
pub(super) mod read;
pub(super) mod write;
