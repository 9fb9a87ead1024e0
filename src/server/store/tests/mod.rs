//! Tests that every store runs.

mod layers;
pub(crate) mod model;
pub(crate) mod suite;
