//! The subcommands beside the server.

mod failure;
pub mod health;
mod input;
mod output;
pub mod points;
mod service;
pub mod warp;

pub use failure::Failure;
