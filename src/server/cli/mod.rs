//! The subcommands beside the server.

pub mod health;
pub mod warp;
