//! Tests that every store runs.

mod identity;
mod layers;
pub(crate) mod model;
pub(crate) mod suite;
