//! The drag.

pub mod bucket;
pub mod desk;
pub mod pace;
