//! The routes, one file per family.

pub(crate) mod docs;
pub(crate) mod mesh;
pub(crate) mod points;
pub(crate) mod problems;
pub(crate) mod service;
pub(crate) mod sessions;
pub(crate) mod warp;
