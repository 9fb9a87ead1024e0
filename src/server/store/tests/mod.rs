//! Tests that every store runs.

pub(crate) mod model;
pub(crate) mod suite;
