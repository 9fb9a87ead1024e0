//! What the use cases share, by concern. A part knows only those above it in this list.

pub mod admission;
pub(crate) mod drawing;
pub(crate) mod images;
pub(crate) mod plans;
pub mod sessions;
