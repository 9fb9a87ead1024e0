//! The subcommands beside the server.

pub mod batch;
pub mod blend;
mod failure;
pub mod fit;
mod frames;
pub mod health;
mod images;
mod input;
pub mod map;
mod options;
mod output;
pub mod points;
pub mod report;
mod service;
pub mod warp;

pub use failure::Failure;
