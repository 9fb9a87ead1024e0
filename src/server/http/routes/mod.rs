//! The routes: one file for each group of paths.

pub(crate) mod batch;
pub(crate) mod blend;
#[cfg(feature = "docs")]
pub(crate) mod docs;
#[cfg(not(feature = "docs"))]
#[path = "no_docs.rs"]
pub(crate) mod docs;
pub(crate) mod fallbacks;
pub(crate) mod fit;
pub(crate) mod landmarks;
pub(crate) mod layers;
pub(crate) mod map;
pub(crate) mod mesh;
pub(crate) mod plan;
pub(crate) mod points;
pub(crate) mod problems;
pub(crate) mod report;
pub(crate) mod service;
pub(crate) mod sessions;
pub(crate) mod tokens;
pub(crate) mod warp;
